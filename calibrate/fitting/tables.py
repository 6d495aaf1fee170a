"""The estimates of a fit as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from calibrate.inference.estimate import Estimate

if TYPE_CHECKING:
    import pandas


def estimates_frame(estimates: Sequence[Estimate], carried: Sequence[Estimate]) -> pandas.DataFrame:
    """See `FitResult.to_pandas`."""
    import pandas as pd

    names = ("key", "value", "sd", "lower95", "upper95", "initial", "unit", "detectable", "note")
    rows = [
        {name: getattr(e, name) for name in names} | {"carried": beside}
        for each, beside in ((estimates, False), (carried, True))
        for e in each
    ]
    index = pd.Index([e.name for e in (*estimates, *carried)], name="parameter")
    table = pd.DataFrame(rows, index=index, columns=[*names, "carried"])
    return table.astype({name: float for name in ("sd", "lower95", "upper95", "detectable")})
