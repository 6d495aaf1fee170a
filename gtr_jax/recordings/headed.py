"""Columns under headers with their units, as CSV files, pandas tables and xarray datasets show them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .formats.quantities import COLUMNS, DRIVES, column_of

if TYPE_CHECKING:
    import pandas
    import xarray

# Endings of headers, and the units that they mean.
ENDINGS = {
    "N_per_m": "N/m",
    "per_m": "1/m",
    "N": "N",
    "m": "m",
    "rad": "rad",
    "s": "s",
}
_ENDING = re.compile(rf"(.+?)_({'|'.join(ENDINGS)})")
TENDON = "tendon"


def headed(
    named: Mapping[str, Any], *, tendons: Sequence[str] = (), markers: Iterable[str] = ()
) -> dict[str, np.ndarray]:
    """Columns under their headers, (rows,) each: the quantities of COLUMNS, SI, come first.

    Further columns follow under the names they are given, which should carry their unit. None is left out,
    and so is a tendon's drive that is all NaN. A quantity of several tendons, (rows, tendons), becomes a
    column for each, ending with its name.

    Args:
        named: values by quantity or header.
        tendons: names of several tendons.
        markers: names in `named` that are quantities of markers.
    """
    columns = {}
    for name in (*(c for c in COLUMNS if c in named), *(n for n in named if n not in COLUMNS)):
        values = named[name]
        if values is None:
            continue
        known = name in COLUMNS or name in markers
        header, table = column_of(name).header if known else name, np.asarray(values)
        if table.ndim == 1 and name == "T_base" and _not_recorded(table):
            continue
        if table.ndim == 1:
            columns[header] = table
        else:
            columns |= {
                f"{header}.{t}": own
                for t, own in zip(tendons, table.T, strict=True)
                if name not in DRIVES or not _not_recorded(own)
            }
    return columns


def _not_recorded(values: np.ndarray) -> bool:
    """Whether a column holds nothing but NaN."""
    return values.dtype.kind == "f" and bool(np.all(np.isnan(values)))


def named_and_unit(header: str) -> tuple[str, str]:
    """The name and the unit of a header: "T_base" and "N" of "T_base_N"; "1" where it states none."""
    found = _ENDING.fullmatch(header)
    return (found[1], ENDINGS[found[2]]) if found else (header, "1")


def frame_of(columns: Mapping[str, np.ndarray], along: str) -> pandas.DataFrame:
    """Columns as a pandas table, under the same headers.

    Args:
        columns: (rows,) each.
        along: name of the index, which counts rows from 0.
    """
    import pandas as pd

    rows = len(next(iter(columns.values()), ()))
    return pd.DataFrame(dict(columns), index=pd.RangeIndex(rows, name=along))


def dataset_of(
    columns: Mapping[str, np.ndarray], along: str, *, tendons: Sequence[str] = ()
) -> xarray.Dataset:
    """Columns as an xarray dataset: their names without the unit, which is the attribute `units`; columns
    that end with the name of a tendon side by side, with NaN or "" for a tendon without one.

    Args:
        columns: (rows,) each, by header.
        along: name of the dimension, which counts rows from 0.
        tendons: names of several tendons.
    """
    import xarray as xr

    apart: dict[str, dict[str, np.ndarray]] = {}
    for header, values in columns.items():
        name, dot, tendon = header.partition(".")
        own = bool(dot) and tendon in tendons
        apart.setdefault(name if own else header, {})[tendon if own else ""] = np.asarray(values)
    rows = len(next(iter(columns.values()), ()))
    variables: dict[str, xr.Variable] = {}
    for header, each in apart.items():
        name, unit = named_and_unit(header)
        if "" in each:
            dims, values = (along,), each[""]
        else:
            some = next(iter(each.values()))
            absent = np.full(rows, np.nan) if some.dtype.kind == "f" else np.full(rows, "")
            dims = (along, TENDON)
            values = np.stack([each.get(tendon, absent) for tendon in tendons], axis=1)
        variables[name] = xr.Variable(dims, values, {} if values.dtype.kind == "U" else {"units": unit})
    coords: dict[str, Any] = {along: np.arange(rows)}
    coords |= {name: variables.pop(name) for name in ("time", "phase", "trial") if name in variables}
    if any(TENDON in v.dims for v in (*variables.values(), *coords.values()) if isinstance(v, xr.Variable)):
        coords[TENDON] = list(tendons)
    return xr.Dataset(variables, coords)
