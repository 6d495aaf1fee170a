"""A table in memory: header, units, and columns whose cells become numbers when they are asked for."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gtr_jax.errors import InputError, excerpt
from gtr_jax.units import convert

from .cells import ABSENT, Cells, mark_of
from .time_stamps import SECOND


@dataclass(frozen=True)
class Table:
    """A table of C columns and K rows.

    Attributes:
        path, sha256: of the file.
        header: names of the columns, (C,).
        columns: the cells of each, (C,).
        numbers: the row number that an editor shows for each row, (K,); counted from 1 where none does.
        units: what a row of units below the header says of each column; "" where it says nothing.
        plain: whether no cell has a comma in it.
        notes: sentences on how the file was read.
        numbered: whether the file names no column, so that the header counts them.
    """

    path: Path
    sha256: str
    header: list[str]
    columns: Sequence[Cells]
    numbers: np.ndarray
    units: list[str] = field(default_factory=list)
    plain: bool = False
    notes: tuple[str, ...] = ()
    numbered: bool = False

    def unit(self, index: int) -> str | None:
        """What the row of units says of column `index`; None if it, or there, is none."""
        return self.units[index] or None if self.units else None

    def has_numbers(self, index: int) -> bool:
        """Whether any cell of column `index` is a number."""
        return self.columns[index].has_numbers()

    def refuse_unless_numbers(self) -> None:
        """InputError if no cell is a number: what is not a table of numbers is not to be quoted, as it is
        where another file named it.
        """
        if not any(map(self.has_numbers, range(len(self.header)))):
            raise InputError(
                f"{self.path}: holds no column of numbers; name a table of numbers with a header"
            )

    def has_times(self, index: int) -> bool:
        """Whether any cell of column `index` is a time stamp."""
        return self.columns[index].has_times()

    @functools.cached_property
    def decimal(self) -> str:
        """The decimal mark, by what all columns of numbers show.

        Raises InputError if they show both, or nothing but numbers such as 1,234.
        """
        marks: dict[str, str] = {}
        doubtful = ""
        for column in self.columns:
            cells, mostly = column.samples()
            for cell in cells if mostly else ():
                mark = mark_of(cell)
                if mark == "?":
                    doubtful = doubtful or (cell if "," in cell else "")
                elif mark:
                    marks.setdefault(mark, cell)
        remedy = "export it again with decimal points and without thousands separators"
        if len(marks) > 1:
            raise InputError(
                f"{self.path}: decimals take both marks, '{marks['.']}' and '{marks[',']}'; {remedy}"
            )
        if not marks and doubtful:
            plain = doubtful.replace(",", "")
            raise InputError(
                f"{self.path}: '{doubtful}' may be {doubtful.replace(',', '.')} or {plain}; {remedy}"
            )
        return next(iter(marks), ".")

    def column(self, index: int, most_absent: float = 0.0) -> np.ndarray:
        """Column `index` as float64; cells that are empty or NaN are NaN.

        Args:
            index: of the column.
            most_absent: share of the cells that may be empty or NaN.

        Raises InputError naming row and column of another cell that is not a number.
        """
        cells = self.columns[index]
        values = cells.plain_numbers() if self.plain or self.decimal != "," else None
        if values is None:
            values = cells.numbers(self.decimal)
        bad = ~np.isfinite(values)
        if np.any(bad):
            absent = np.array([cells.text(i).strip().lower() in ABSENT for i in np.flatnonzero(bad).tolist()])
            share = float(np.mean(bad)) if absent.all() else 1.0
            if share > most_absent:
                if most_absent and not absent.all():
                    bad[np.flatnonzero(bad)[absent]] = False
                found = f"{100 * share:.1f}".removesuffix(".0")
                few = f"; up to {100 * most_absent:g} % of a column may be empty, not {found} %"
                self._refuse(index, bad, "a number", few if most_absent and absent.all() else "")
        return values

    def times(self, index: int) -> np.ndarray:
        """Column `index`, time stamps, in seconds since the first of them: ISO 8601, other dates with a time,
        or hours:minutes:seconds, which go on past midnight.

        Raises InputError naming row and column of a cell that is none, or the column if its days and months
        cannot be told apart.
        """
        try:
            values, bad = self.columns[index].nanoseconds()
        except InputError as fault:
            raise InputError(f"{self.path}: column '{self.header[index]}': {fault}") from None
        self._refuse(index, bad, "seconds or a time stamp such as 2026-01-31T14:05:00.25")
        return (values - values[0]) / float(SECOND)

    def quantity(
        self,
        index: int,
        unit: str | None,
        si: str,
        *,
        remedy: Callable[[], str],
        most_absent: float = 0.0,
        scale: float = 1.0,
        offset: float = 0.0,
    ) -> np.ndarray:
        """Column `index`, times `scale` plus `offset`, converted from `unit` (None: what the row of units
        says, or SI) to the SI unit `si`, read-only. Times may be time stamps. `remedy` says what to do about
        a unit that is not understood; `most_absent` is as of `column`.
        """
        if si == "s" and not self.has_numbers(index):
            values = self.times(index)
        else:
            values, unit = self.column(index, most_absent), unit or self.unit(index)
            if scale != 1.0 or offset:
                values = values * scale + offset
            try:
                values = values if unit in (None, si) else convert(values, unit, si)
            except InputError as fault:
                raise InputError(f"{self.path}: column '{self.header[index]}': {fault}; {remedy()}") from None
        values.setflags(write=False)
        return values

    def _refuse(self, index: int, bad: np.ndarray, wanted: str, more: str = "") -> None:
        if np.any(bad):
            i = int(np.flatnonzero(bad)[0])
            cell = self.columns[index].text(i)
            what = f"found '{excerpt(cell)}'" if cell.strip() else "found an empty cell"
            raise InputError(
                f"{self.path}: row {self.numbers[i]}, column '{self.header[index]}': "
                f"expected {wanted}, {what}; correct the cell or delete the row{more}"
            )
