"""Diagnoses as tables and datasets: the columns of `diagnosis.csv`, and the numbers before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calibrate.inference.channels import unit_of

if TYPE_CHECKING:
    import pandas

    from .result import Diagnosis, Loop


def loop_columns(loop: Loop) -> dict[str, np.ndarray]:
    """The columns of `diagnosis.csv` by header, (K,) each: what drives each tendon, what is explained as
    recorded, by the base model and by the model that is shown, and the phase of each tendon.
    """
    columns: dict[str, np.ndarray] = {} if loop.time is None else {"time_s": loop.time}
    for i, pull in enumerate(loop.pulls):
        ending = f".{pull.tendon}" if pull.tendon else ""
        columns[("displacement_m" if pull.by_displacement else "T_base_N") + ending] = pull.drive
        for c, channel in enumerate(loop.channels[: loop.explained]):
            if loop.of[c] == i:
                quantity, _, tendon = channel.partition(".")
                rows = {"": loop.recorded, "_before": loop.before, "_after": loop.after}
                for which, each in rows.items():
                    name = f"{quantity}{which}_{unit_of(channel)}"
                    columns[f"{name}.{tendon}" if tendon else name] = each[c]
        columns[f"phase{ending}"] = pull.phases
    return columns


def changes_frame(diagnosis: Diagnosis) -> pandas.DataFrame:
    """See `Diagnosis.to_pandas`."""
    import pandas as pd

    names = ("before", "after", "sd", "lower95", "upper95", "unit")
    rows = [
        {name: getattr(c, name) for name in names}
        | dict(zip(("averaged_lower95", "averaged_upper95"), c.averaged95 or (None, None), strict=True))
        for c in diagnosis.parameters
    ]
    index = pd.Index([c.name for c in diagnosis.parameters], name="parameter")
    table = pd.DataFrame(rows, index=index, columns=[*names, "averaged_lower95", "averaged_upper95"])
    return table.astype({name: float for name in table.columns if name != "unit"})
