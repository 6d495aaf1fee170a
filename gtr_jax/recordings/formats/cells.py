"""The cells of a column, whatever holds them: text as it was written, or numbers.

A number may have decimal points or commas and thousands separators; `time_stamps` reads time stamps.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from .time_stamps import is_stamp, past_midnight, stamp_reader

BLANKS = "   '’"
_EXPONENT = r"(?:[eE][+-]?\d+)?"
NUMERAL = {
    mark: re.compile(rf"[+-]?(?:(?:[1-9]\d{{0,2}}(?:([{other}{BLANKS}])\d{{3}})(?:\1\d{{3}})*|\d+)"
                     rf"(?:{re.escape(mark)}\d*)?|{re.escape(mark)}\d+){_EXPONENT}")
    for mark, other in ((".", ","), (",", "."))
}  # fmt: skip
EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")  # 1,234: a decimal mark or a thousands separator
ABSENT = frozenset({"", "nan"})  # cells of samples that are left out
NOTHING = frozenset({"nan", "inf", "n/a", "na", "none", "null"})


class Cells(Protocol):
    """The cells of one column."""

    def text(self, i: int) -> str:
        """The cell of sample `i` as it was written."""
        ...

    def has_numbers(self) -> bool:
        """Whether any cell is a number."""
        ...

    def has_times(self) -> bool:
        """Whether any cell is a time stamp."""
        ...

    def samples(self) -> tuple[Iterable[str], bool]:
        """A cell of each form that occurs, and whether most cells are numbers."""
        ...

    def plain_numbers(self) -> np.ndarray | None:
        """The numbers, (K,), as they are where no cell has a decimal comma or a thousands separator, NaN
        where a cell is empty; None if a cell cannot be read so.
        """
        ...

    def numbers(self, mark: str) -> np.ndarray:
        """The numbers, (K,), with this decimal mark; NaN where a cell holds none."""
        ...

    def nanoseconds(self) -> tuple[np.ndarray, np.ndarray]:
        """Time stamps in nanoseconds, and where a cell is none, (K,) each.

        Raises InputError, without the place, if they may mean two things.
        """
        ...


class TextCells:
    """Cells of a text file."""

    def __init__(self, cells: Sequence[str]) -> None:
        self.cells = cells

    def text(self, i: int) -> str:
        """The cell of sample `i` as it was written."""
        return self.cells[i]

    def has_numbers(self) -> bool:
        """Whether any cell is a number."""
        return any(map(is_numeral, self.cells))

    def has_times(self) -> bool:
        """Whether any cell is a time stamp."""
        return any(map(is_stamp, self.cells))

    def samples(self) -> tuple[Iterable[str], bool]:
        """The cells that are not empty, and whether most are numbers."""
        cells = [cell for raw in self.cells if (cell := tidy(raw))]
        return cells, sum(map(is_numeral, cells)) > len(cells) / 2

    def plain_numbers(self) -> np.ndarray | None:
        """The numbers as Python reads them, (K,); None if a cell is none."""
        if any("," in cell or "_" in cell for cell in self.cells):
            return None
        try:
            return np.array(self.cells, dtype=np.float64)
        except ValueError:
            return None

    def numbers(self, mark: str) -> np.ndarray:
        """The numbers, (K,), with this decimal mark; NaN where a cell holds none."""
        return np.array([number_in(cell, mark) for cell in self.cells])

    def nanoseconds(self) -> tuple[np.ndarray, np.ndarray]:
        """Time stamps in nanoseconds, and where a cell is none, (K,) each."""
        cells = [cell.strip() for cell in self.cells]
        read = stamp_reader(cells)
        found = [read(cell) for cell in cells]
        bad = np.array([value is None for value in found])
        return past_midnight(np.array([value or 0 for value in found], dtype=np.int64), bad, cells), bad


class NumberCells:
    """Cells of a file that holds numbers."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = np.asarray(values, dtype=np.float64)

    def text(self, i: int) -> str:
        """The number of sample `i` as Python writes it."""
        return repr(float(self.values[i]))

    def has_numbers(self) -> bool:
        """Whether any cell is a number."""
        return bool(np.isfinite(self.values).any())

    def has_times(self) -> bool:
        """Numbers are not time stamps."""
        return False

    def samples(self) -> tuple[Iterable[str], bool]:
        """Nothing: numbers have no decimal marks."""
        return (), False

    def plain_numbers(self) -> np.ndarray | None:
        """The numbers, (K,), the caller's own."""
        return self.values.copy()

    def numbers(self, mark: str) -> np.ndarray:
        """The numbers, (K,)."""
        return self.values.copy()

    def nanoseconds(self) -> tuple[np.ndarray, np.ndarray]:
        """No time stamps."""
        return np.zeros(len(self.values), dtype=np.int64), np.ones(len(self.values), dtype=bool)


def tidy(cell: str) -> str:
    """A cell without blanks around it, with a plain minus sign."""
    return cell.strip().replace("−", "-")


def is_numeral(cell: str) -> bool:
    """Whether a cell is a number, with either decimal mark."""
    cell = tidy(cell)
    return any(numeral.fullmatch(cell) for numeral in NUMERAL.values())


def mark_of(cell: str) -> str:
    """The decimal mark that a numeral gives away, or ""; "?" if its only mark may part thousands."""
    if EITHER.fullmatch(cell):
        return "?"
    if "." not in cell and "," not in cell:
        return ""
    return next((mark for mark, numeral in NUMERAL.items() if numeral.fullmatch(cell)), "")


def number_in(cell: str, mark: str) -> float:
    """The number a cell holds; NaN if it holds none."""
    cell = tidy(cell)
    if not NUMERAL[mark].fullmatch(cell):
        return float("nan")
    return float(re.sub(rf"[{BLANKS}{'.' if mark == ',' else ','}]", "", cell).replace(mark, "."))
