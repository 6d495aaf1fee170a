"""CSV files of very many rows, split and turned into numbers, and written, by polars; anything odd in them is
left to `csv_text`.

Cells stay text until a column is asked for, so that messages can quote them. Where cells need a closer look,
their *forms* are looked at, of which there are few: the first digit as 0 or 1, all others as 0.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gtr_jax.errors import InputError

from .cells import BLANKS, NUMERAL, is_numeral, is_stamp, past_midnight, stamp_reader
from .csv_text import NUMBERLIKE, delimiter_of, is_data, laid_out
from .sheet import Table

if TYPE_CHECKING:
    import polars as pl

LARGE = 2_000_000  # characters from which a file is read so
_HEAD = 400  # lines in which the header and the first rows are looked for
_FIRST = 1000  # cells that are looked at before all of them
_FOREIGN = re.compile(r"(?![0-9])\d")  # a digit, but of another script
_FRACTION = r"(:\d\d:\d\d)[.,](\d+)"  # of the seconds


def read_large(path: Path, text: str, sha256: str) -> Table | None:
    """The table in the text of a large CSV file; None if it is not large, or is odd in any way: quotes or
    comments among the rows, blank lines, rows of another length or without a number, several tables, digits
    of other scripts.
    """
    if len(text) < LARGE:
        return None
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    end = 0
    for _ in range(_HEAD):
        end = text.find("\n", end) + 1
        if end == 0:
            return None
    delimiter = delimiter_of(text[:end])
    try:
        header, units, rest, numbered, notes = laid_out(path, text[:end])
    except InputError:
        return None
    if notes or len(rest) < 2 or not is_data(rest[0][1]) or len(rest[0][1]) != len(header):
        return None
    first = rest[0][0]
    begin = 0
    for _ in range(first - 1):
        begin = text.find("\n", begin) + 1
    body = text[begin:].rstrip("\n")
    del text
    if '"' in body or "#" in body or (not body.isascii() and _FOREIGN.search(body)):
        return None
    plain = delimiter == "," or "," not in body
    data = body.encode()
    del body
    if not _even(data, delimiter, len(header)):
        return None
    series = _split(data, delimiter)
    if len(series) != len(header) or (any(s.null_count() for s in series) and _blank_rows(series)):
        return None
    if _rows_of_words(data, series):
        return None
    columns = [ManyWritten(s) for s in series]
    numbers = np.arange(first, first + len(series[0]))
    return Table(path, sha256, header, columns, numbers, units, plain, numbered=numbered)


def _even(body: bytes, delimiter: str, width: int) -> bool:
    """Whether every row has so many cells."""
    characters = np.frombuffer(body, dtype=np.uint8)
    ends = np.append(np.flatnonzero(characters == ord("\n")), len(body))
    marks = np.flatnonzero(characters == ord(delimiter))
    if len(marks) != len(ends) * (width - 1):
        return False
    if not len(marks):
        return True
    first, last = marks[:: width - 1], marks[width - 2 :: width - 1]
    return bool(np.all(first[1:] > ends[:-1]) and np.all(last < ends))


def _split(body: bytes, delimiter: str) -> list[pl.Series]:
    """Columns of text; none where polars finds a fault."""
    import polars as pl

    try:
        return pl.read_csv(
            body, has_header=False, separator=delimiter, infer_schema=False, quote_char=None
        ).get_columns()
    except pl.exceptions.PolarsError:
        return []


def _blank_rows(series: list[pl.Series]) -> bool:
    """Whether all cells of a row are blank."""
    blank = series[0].is_null()
    for s in series[1:]:
        blank &= s.is_null()
    return bool(blank.any())


def _rows_of_words(body: bytes, series: list[pl.Series]) -> bool:
    """Whether in any row no cell begins as a number does: another table may begin there."""
    import polars as pl

    characters = np.frombuffer(body, dtype=np.uint8)
    firsts = characters[np.append(0, np.flatnonzero(characters == ord("\n")) + 1)]
    words = pl.Series((firsts < ord("0")) | (firsts > ord("9")))
    for s in series:
        if not words.any():
            return False
        number = s.filter(words).str.contains(NUMBERLIKE).fill_null(False).to_numpy()
        left = words.to_numpy().copy()
        left[left] = ~number
        words = pl.Series(left)
    return bool(words.any())


class ManyWritten:
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

    def plainly(self) -> np.ndarray | None:
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


def large_text(columns: Mapping[str, np.ndarray]) -> str | None:
    """Columns of numbers, (K,) each, as CSV that reads back exactly; None if any has another length, is of
    words, or holds what is not a number.
    """
    import polars as pl

    if len({len(values) for values in columns.values()}) != 1:
        return None
    if not all(values.dtype == np.float64 and np.isfinite(values).all() for values in columns.values()):
        return None
    return pl.DataFrame({name: np.ascontiguousarray(own) for name, own in columns.items()}).write_csv()
