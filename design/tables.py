"""Designs as a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .option import Option
from .space import Space

if TYPE_CHECKING:
    import pandas


def options_frame(options: Sequence[Option], space: Space) -> pandas.DataFrame:
    """See `Design.to_pandas`."""
    import pandas as pd

    units = {v.name: v.unit for v in space.all if v.key}  # a base tension has no key: they all follow
    names = space.config.tendon_names
    rows = []
    for option in options:
        row: dict[str, Any] = {_header(n, units[n]): x for n, x in option.values.items() if n in units}
        loads = np.asarray(option.tensions)
        for i, load in enumerate(loads):
            header = "T_base_N" if len(loads) == 1 else f"T_base_{i + 1}_N"
            each = zip(names, load, strict=True) if names else [("", load)]
            row |= {f"{header}.{name}".rstrip("."): float(T) for name, T in each}
        row |= {"worst_error_in_tolerances": option.miss, "tension_loss": option.loss}
        rows.append(row | {"reached": option.reached, "limits_kept": option.kept})
    return pd.DataFrame(rows, index=pd.RangeIndex(len(rows), name="option"))


def _header(name: str, unit: str) -> str:
    """A name with its SI unit, "r1_m"; in brackets where the unit is made of several."""
    if not unit:
        return name
    return f"{name}_{unit}" if unit.isalpha() else f"{name} [{unit}]"
