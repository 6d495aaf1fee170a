"""Very many cells of text, turned into numbers by polars.

Where cells need a closer look, their *forms* are looked at, of which there are few: the first digit as 0 or
1, all others as 0.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .cells import BLANKS, NUMERAL, is_numeral
from .time_stamps import is_stamp, past_midnight, stamp_reader

if TYPE_CHECKING:
    import polars as pl

_FIRST = 1000  # cells that are looked at before all of them
_FRACTION = r"(:\d\d:\d\d)[.,](\d+)"  # of the seconds


class ManyTextCells:
    """Very many cells of a text file, as `cells.Cells`."""

    def __init__(self, series: pl.Series) -> None:
        self.series = series

    def text(self, i: int) -> str:
        """The cell of sample `i` as it was written."""
        return self.series[i] or ""

    def has_numbers(self) -> bool:
        """Whether any cell is a number."""
        return self._any(is_numeral)

    def has_times(self) -> bool:
        """Whether any cell is a time stamp."""
        return self._any(is_stamp)

    def _any(self, holds: Callable[[str], bool]) -> bool:
        first = (cell or "" for cell in self.series.head(_FIRST))
        return any(map(holds, first)) or any(holds(form.cell) for form in self._forms)

    def samples(self) -> tuple[Iterable[str], bool]:
        """A cell of each form, in their order, and whether most cells are numbers."""
        forms = [form for form in self._forms if form.cell]
        numerals = sum(form.number for form in forms if is_numeral(form.cell))
        return [form.cell for form in forms], numerals > sum(form.number for form in forms) / 2

    def plain_numbers(self) -> np.ndarray | None:
        """The numbers as polars reads them, (K,), NaN where a cell is empty; None if a cell is none."""
        import polars as pl

        values = self.series.cast(pl.Float64, strict=False)
        if values.null_count() > self.series.null_count():
            cells = self.series.str.strip_chars()
            values = cells.cast(pl.Float64, strict=False)
            if values.null_count() > cells.null_count() + int((cells == "").sum()):
                return None
        return np.array(values.fill_null(float("nan")).to_numpy())

    def numbers(self, mark: str) -> np.ndarray:
        """The numbers, (K,), with this decimal mark; NaN where a cell holds none."""
        import polars as pl

        other = "." if mark == "," else ","
        valid = [form.form for form in self._forms if NUMERAL[mark].fullmatch(form.form)]
        tidied = _tidied(self.series)
        cells = tidied.str.replace_all(f"[{BLANKS}{other}]", "").str.replace(mark, ".", literal=True)
        values = cells.cast(pl.Float64, strict=False).fill_null(float("nan")).to_numpy()
        if len(valid) == len(self._forms):
            return np.array(values)
        return np.where(_form(tidied).is_in(valid).fill_null(False).to_numpy(), values, np.nan)

    def nanoseconds(self) -> tuple[np.ndarray, np.ndarray]:
        """Time stamps in nanoseconds, and where a cell is none, (K,) each."""
        import polars as pl

        cells = self.series.fill_null("").str.strip_chars()
        whole = cells.str.replace(_FRACTION, "${1}")
        decimals = cells.str.extract(_FRACTION, 2).str.slice(0, 9).str.pad_end(9, "0")
        known = whole.unique(maintain_order=True).to_list()
        read = stamp_reader(known)
        seconds = {w: None if re.search(_FRACTION, w) else read(w) for w in known}
        values = whole.replace_strict(seconds, return_dtype=pl.Int64)
        fraction = decimals.cast(pl.Int64, strict=False).fill_null(0)
        bad = values.is_null().to_numpy()
        return past_midnight((values.fill_null(0) + fraction).to_numpy(), bad, known), bad

    @functools.cached_property
    def _forms(self) -> list[_Form]:
        """The forms of the cells, in their order."""
        import polars as pl

        cells = _tidied(self.series).fill_null("")
        frame = pl.DataFrame({"form": _form(cells), "cell": cells}).group_by("form", maintain_order=True)
        return [_Form(*row) for row in frame.agg(pl.col("cell").first(), pl.len().alias("count")).iter_rows()]


class _Form(NamedTuple):
    """A form of cells, the first cell that has it, and how many have."""

    form: str
    cell: str
    number: int


def _tidied(series: pl.Series) -> pl.Series:
    return series.str.strip_chars().str.replace_all("−", "-", literal=True)


def _form(tidied: pl.Series) -> pl.Series:
    marked = tidied.str.replace(r"^([+-]?)[1-9]", "${1}\x01").str.replace_all("[0-9]", "0")
    return marked.str.replace("\x01", "1", literal=True)
