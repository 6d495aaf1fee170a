"""A number before and after, and the table of all that a diagnosis gives."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas


@dataclasses.dataclass(frozen=True)
class Change:
    """A number before and after: SI; None where it is not in that model.

    Attributes:
        name, unit: of it.
        before, after: values.
        sd: standard deviation of `after`, with all other uncertainty counted in.
        lower95, upper95: ends of its 95 % interval.
        made_of: share of its variance by source: noise, uncertain numbers of the robot file, the law, the
            mesh.
        averaged95: ends of the 95 % interval averaged over models; see `averaged`.
    """

    name: str
    unit: str
    before: float | None
    after: float | None
    sd: float | None
    lower95: float | None = None
    upper95: float | None = None
    made_of: Mapping[str, float] = dataclasses.field(default_factory=dict)
    averaged95: tuple[float, float] | None = None

    @property
    def widened(self) -> float:
        """Width of the averaged interval over that under the model shown; 1 where there is none."""
        if self.averaged95 is None or self.lower95 is None or self.upper95 is None:
            return 1.0
        narrow = self.upper95 - self.lower95
        return (self.averaged95[1] - self.averaged95[0]) / narrow if narrow > 0 else 1.0


def changes_frame(changes: Sequence[Change]) -> pandas.DataFrame:
    """See `Diagnosis.to_pandas`."""
    import pandas as pd

    names = ("before", "after", "sd", "lower95", "upper95", "unit")
    rows = [
        {name: getattr(c, name) for name in names}
        | dict(zip(("averaged_lower95", "averaged_upper95"), c.averaged95 or (None, None), strict=True))
        for c in changes
    ]
    index = pd.Index([c.name for c in changes], name="parameter")
    table = pd.DataFrame(rows, index=index, columns=[*names, "averaged_lower95", "averaged_upper95"])
    return table.astype({name: float for name in table.columns if name != "unit"})
