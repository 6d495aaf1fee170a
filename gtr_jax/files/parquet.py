"""Parquet files, read by polars."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from gtr_jax.errors import InputError, excerpt

from .cells import Cells, Numbers
from .large_csv import ManyWritten
from .sheet import Table

MAGIC = b"PAR1"


def read_parquet(path: Path, data: bytes, sha256: str) -> Table:
    """The table of a Parquet file: its columns of numbers, of text and of times; others are left out.

    Dates with times become seconds since the first of their column, durations become seconds.

    Raises InputError naming the file if it is damaged, or holds no rows or no such columns.
    """
    import polars as pl

    try:
        frame = pl.read_parquet(io.BytesIO(data))
    except (Exception, pl.exceptions.PanicException) as fault:
        raise InputError(f"{path}: not a whole Parquet file ({excerpt(fault)}); export it again") from None
    header: list[str] = []
    columns: list[Cells] = []
    for series in frame.get_columns():
        kind = series.dtype
        if kind.is_numeric() or kind == pl.Boolean:
            values = series.cast(pl.Float64, strict=False).fill_null(float("nan")).to_numpy()
        elif kind in (pl.Datetime, pl.Duration):
            values = _seconds(series)
        elif kind == pl.String:
            header.append(series.name.strip())
            columns.append(ManyWritten(series))
            continue
        else:
            continue
        header.append(series.name.strip())
        columns.append(Numbers(values))
    if not columns or not frame.height:
        raise InputError(f"{path}: holds no rows of numbers; at least one column and one row are needed")
    return Table(path, sha256, header, columns, np.arange(1, frame.height + 1), plain=True)


def _seconds(series) -> np.ndarray:
    """Times in seconds, (K,): dates since the first of them; NaN where there is none."""
    import polars as pl

    nanoseconds = series.dt.cast_time_unit("ns").to_physical()
    if series.dtype == pl.Datetime:
        known = nanoseconds.drop_nulls()
        nanoseconds = nanoseconds - (known[0] if len(known) else 0)
    return nanoseconds.cast(pl.Float64).fill_null(float("nan")).to_numpy() / 1e9
