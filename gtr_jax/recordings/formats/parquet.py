"""Parquet files, read by polars."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gtr_jax.errors import InputError

from .cells import NumberCells
from .expansion import check_bytes, check_numbers
from .many_cells import ManyTextCells
from .sheet import Table
from .subprocess_reader import read_in_subprocess

if TYPE_CHECKING:
    import polars as pl

MAGIC, ENDINGS = b"PAR1", (".parquet", ".pq")


def read_parquet(path: Path, data: bytes, sha256: str) -> Table:
    """The table of a Parquet file: its columns of numbers, of text and of times; others are left out.

    Dates with times become seconds since the first of their column, durations become seconds.

    Raises InputError naming the file if it is damaged, or holds no rows or no such columns.
    """
    rows, found = read_in_subprocess(
        columns_of, data, path=path, intact="a complete Parquet file", remedy="export it again"
    )
    if not found or not rows:
        raise InputError(f"{path}: holds no rows of numbers; at least one column and one row are needed")
    header = [name.strip() for name, _ in found]
    columns = [
        NumberCells(cells) if isinstance(cells, np.ndarray) else ManyTextCells(cells) for _, cells in found
    ]
    return Table(path, sha256, header, columns, np.arange(1, rows + 1), plain=True)


def columns_of(data: bytes) -> tuple[int, list[tuple[str, np.ndarray | pl.Series]]]:
    """The number of rows, and the columns of numbers, as float64, and of text, by name.

    Raises InputError if they would be too many cells, or too long texts.
    """
    import polars as pl

    kinds = pl.read_parquet_schema(io.BytesIO(data))
    wanted = [name for name, kind in kinds.items() if _read(kind)]
    rows = pl.scan_parquet(io.BytesIO(data)).select(pl.len()).collect().item()
    check_numbers(rows * len(wanted), f"has {rows:,} rows of {len(wanted)} columns")
    texts = [
        pl.col(name).str.len_bytes().cast(pl.UInt64).sum() for name in wanted if kinds[name] == pl.String
    ]
    if texts:
        check_bytes(sum(pl.scan_parquet(io.BytesIO(data)).select(texts).collect().row(0)))
    frame = pl.read_parquet(io.BytesIO(data), columns=wanted)
    found: list[tuple[str, np.ndarray | pl.Series]] = []
    for series in frame.get_columns():
        kind = series.dtype
        if kind in (pl.Datetime, pl.Duration):
            found.append((series.name, _seconds(series)))
        elif kind == pl.String:
            found.append((series.name, series))
        else:
            values = series.cast(pl.Float64, strict=False).fill_null(float("nan")).to_numpy()
            found.append((series.name, values))
    return rows, found


def _read(kind: pl.DataType) -> bool:
    """Whether columns of this kind are read."""
    import polars as pl

    return kind.is_numeric() or kind in (pl.Boolean, pl.Datetime, pl.Duration, pl.String)


def _seconds(series: pl.Series) -> np.ndarray:
    """Times in seconds, (K,): dates since the first of them; NaN where there is none."""
    import polars as pl

    nanoseconds = series.dt.cast_time_unit("ns").to_physical()
    if series.dtype == pl.Datetime:
        known = nanoseconds.drop_nulls()
        nanoseconds = nanoseconds - (known[0] if len(known) else 0)
    return nanoseconds.cast(pl.Float64).fill_null(float("nan")).to_numpy() / 1e9
