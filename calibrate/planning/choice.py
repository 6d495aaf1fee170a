"""Experiments with what they are worth, in the order in which they are chosen."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from .candidates import Candidate
from .worth import pairs


@dataclasses.dataclass(frozen=True, eq=False)
class Ranked:
    """An experiment and what it is worth.

    Attributes:
        candidate: the experiment.
        worth: by which it is ranked; see `worth`.
        separation: of each pair of the m models [standard errors], (m, m).
        sd: standard deviation of each number of the first model after it, SI, (p,); of none where a
            diagnosis proposes it.
        confirmed: whether the separation counts every rival refitted, and not only to first order; of one
            model, whether the standard deviations were checked.
    """

    candidate: Candidate
    worth: float
    separation: np.ndarray
    sd: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    confirmed: bool = False

    @property
    def least(self) -> float:
        """Distance of the two models that it tells apart least [standard errors]; infinite for one model."""
        return float(np.min(pairs(self.separation), initial=np.inf))


def by_worth(
    ranked: Sequence[Ranked], tie: Callable[[Candidate], str] = lambda candidate: candidate.in_words
) -> list[Ranked]:
    """Experiments by worth, and where as much is enough, by how far the models are apart.

    Args:
        ranked: in any order.
        tie: text by which those are ordered that are worth the same.
    """
    return sorted(ranked, key=lambda r: (-r.worth, -r.least, tie(r.candidate)))
