"""What became of the rivals of an earlier diagnosis."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Rivalry:
    """One of the rivals of an earlier diagnosis.

    Attributes:
        terms: that it holds.
        before, after: probability in the earlier diagnosis and in the new one.
        status: "named", "still open" or "ruled out".
        behind: by how many standard errors it is behind the best of the new models; None where it was given
            up before it was refitted to all samples.
    """

    terms: tuple[str, ...]
    before: float
    after: float
    status: str
    behind: float | None


@dataclasses.dataclass(frozen=True)
class Settled:
    """What became of the rivals of an earlier diagnosis.

    Attributes:
        folder: of the earlier diagnosis.
        says: the answer in a sentence.
        rivals: one by one.
    """

    folder: str
    says: str
    rivals: tuple[Rivalry, ...]
