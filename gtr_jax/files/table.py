"""CSV tables as people's programs export them: bytes to text, text to cells, cells to numbers.

Read are UTF-8, UTF-16 and Latin-1; commas, semicolons or tabs; decimal points or commas; thousands
separators; comments, title lines and a row of units. What may mean two things is refused.
"""

from __future__ import annotations

import csv
import functools
import hashlib
import io
import os
import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from gtr_jax.errors import InputError, excerpt

from .units import DIMENSIONS, convert, measures

WORKBOOKS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")  # how .xlsx and .xls files begin
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f]")
_SAMPLED = 200  # rows by which the separator is told
_BLANKS = "   '’"
_EXPONENT = r"(?:[eE][+-]?\d+)?"
_NUMERAL = {
    mark: re.compile(rf"[+-]?(?:(?:[1-9]\d{{0,2}}(?:([{other}{_BLANKS}])\d{{3}})(?:\1\d{{3}})*|\d+)"
                     rf"(?:{re.escape(mark)}\d*)?|{re.escape(mark)}\d+){_EXPONENT}")
    for mark, other in ((".", ","), (",", "."))
}  # fmt: skip
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")  # 1,234: a decimal mark or a thousands separator
_STAMP = re.compile(r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d)(?:(:\d\d)(?:[.,](\d+))?)?\s*(Z|[+-]\d\d:?\d\d)?)?")
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d)(?:[.,](\d+))?")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
SECOND = 10**9  # in the nanoseconds that time stamps are counted in
_ABSENT = frozenset({"", "nan"})  # cells of samples that are left out
_NOTHING = frozenset({"nan", "inf", "n/a", "na", "none", "null"})


@dataclass(frozen=True)
class Table:
    """A CSV file as text.

    Attributes:
        path, sha256: of the file.
        header: names of the columns.
        rows: the cells below it.
        numbers: the row number that an editor shows for each of them.
        units: what a row of units below the header says of each column; "" where it says nothing.
        plain: whether no cell holds a comma, or a stroke between digits, which Python reads over.
    """

    path: Path
    sha256: str
    header: list[str]
    rows: list[list[str]]
    numbers: list[int]
    units: list[str] = field(default_factory=list)
    plain: bool = False

    def cells(self, index: int) -> list[str]:
        """The cells of column `index`."""
        return [row[index] for row in self.rows]

    def unit(self, index: int) -> str | None:
        """What the row of units says of column `index`; None if it, or there, is none."""
        return self.units[index] or None if self.units else None

    def has_numbers(self, index: int) -> bool:
        """Whether any cell of column `index` is a number."""
        return any(_is_numeral(row[index]) for row in self.rows)

    def has_times(self, index: int) -> bool:
        """Whether any cell of column `index` is a time stamp."""
        return any(_is_stamp(row[index]) for row in self.rows)

    @functools.cached_property
    def decimal(self) -> str:
        """The decimal mark, by what all columns of numbers show.

        Raises InputError if they show both, or nothing but numbers such as 1,234.
        """
        marks: dict[str, str] = {}
        doubtful = ""
        for index in range(len(self.header)):
            cells = [cell for row in self.rows if (cell := _tidy(row[index]))]
            if sum(map(_is_numeral, cells)) <= len(cells) / 2:
                continue
            for cell in cells:
                mark = _mark(cell)
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

        Raises InputError naming row and column of another cell that is no number.
        """
        cells = self.cells(index)
        try:
            if not self.plain and (self.decimal == "," or any("," in c or "_" in c for c in cells)):
                raise ValueError
            values = np.array(cells, dtype=np.float64)
        except ValueError:
            values = np.array([_number(cell, self.decimal) for cell in cells])
        bad = ~np.isfinite(values)
        if np.any(bad):
            absent = np.array([cells[i].strip().lower() in _ABSENT for i in np.flatnonzero(bad)])
            share = float(np.mean(bad)) if absent.all() else 1.0
            if share > most_absent:
                if most_absent and not absent.all():
                    bad[np.flatnonzero(bad)[absent]] = False
                few = f"; up to {100 * most_absent:g} % of a column may be empty, not {100 * share:.2g} %"
                self._refuse(index, bad, "a number", few if most_absent and absent.all() else "")
        return values

    def times(self, index: int) -> np.ndarray:
        """Column `index`, time stamps, in seconds since the first of them: ISO 8601 or hours:minutes:seconds.

        Raises InputError naming row and column of a cell that is none.
        """
        cells = [cell.strip() for cell in self.cells(index)]
        of_day = any(_CLOCK.fullmatch(cell) for cell in cells)
        found = [_of_day(cell) if of_day else _since_1970(cell) for cell in cells]
        self._refuse(
            index,
            np.array([value is None for value in found]),
            "seconds or a time stamp such as 2026-01-31T14:05:00.25",
        )
        values = np.array(found, dtype=np.int64)
        return (values - values[0]) / float(SECOND)

    def quantity(
        self,
        index: int,
        unit: str | None,
        si: str,
        *,
        remedy: Callable[[], str],
        most_absent: float = 0.0,
    ) -> np.ndarray:
        """Column `index` converted from `unit` (None: what the row of units says, or SI) to the SI unit `si`,
        read-only. Times may be time stamps. `remedy` says what to do about a unit that is not understood;
        `most_absent` is as of `column`.
        """
        if si == "s" and not self.has_numbers(index):
            values = self.times(index)
        else:
            values, unit = self.column(index, most_absent), unit or self.unit(index)
            try:
                values = values if unit in (None, si) else convert(values, unit, si)
            except InputError as fault:
                raise InputError(f"{self.path}: column '{self.header[index]}': {fault}; {remedy()}") from None
        values.setflags(write=False)
        return values

    def _refuse(self, index: int, bad: np.ndarray, wanted: str, more: str = "") -> None:
        if np.any(bad):
            i = int(np.flatnonzero(bad)[0])
            cell = self.rows[i][index]
            what = f"found '{excerpt(cell)}'" if cell.strip() else "found an empty cell"
            raise InputError(
                f"{self.path}: row {self.numbers[i]}, column '{self.header[index]}': "
                f"expected {wanted}, {what}; correct the cell or delete the row{more}"
            )


def _tidy(cell: str) -> str:
    return cell.strip().replace("−", "-")


def _is_numeral(cell: str) -> bool:
    cell = _tidy(cell)
    return any(numeral.fullmatch(cell) for numeral in _NUMERAL.values())


def _is_stamp(cell: str) -> bool:
    cell = cell.strip()
    return bool(_STAMP.fullmatch(cell) or _CLOCK.fullmatch(cell))


def _mark(cell: str) -> str:
    """The decimal mark that a numeral gives away, or ""; "?" if its only mark may part thousands."""
    if _EITHER.fullmatch(cell):
        return "?"
    if "." not in cell and "," not in cell:
        return ""
    return next((mark for mark, numeral in _NUMERAL.items() if numeral.fullmatch(cell)), "")


def _number(cell: str, mark: str) -> float:
    """The number a cell holds; NaN if it holds none."""
    cell = _tidy(cell)
    if not _NUMERAL[mark].fullmatch(cell):
        return float("nan")
    return float(re.sub(rf"[{_BLANKS}{'.' if mark == ',' else ','}]", "", cell).replace(mark, "."))


def _of_day(cell: str) -> int | None:
    """Nanoseconds that hours:minutes:seconds stand for; None for what is no such time."""
    clock = _CLOCK.fullmatch(cell)
    if clock is None:
        return None
    hours, minutes, seconds = map(int, clock.groups()[:3])
    return (3600 * hours + 60 * minutes + seconds) * SECOND + _nanoseconds(clock[4])


def _since_1970(cell: str) -> int | None:
    """Nanoseconds from 1970 to a time stamp, in UTC unless it says otherwise; None for what is none."""
    stamp = _STAMP.fullmatch(cell)
    if stamp is None:
        return None
    date, minute, second, fraction, zone = stamp.groups()
    try:
        moment = datetime.fromisoformat(f"{date}T{minute or '00:00'}{second or ':00'}{zone or 'Z'}")
    except ValueError:
        return None
    return (moment - _EPOCH) // timedelta(seconds=1) * SECOND + _nanoseconds(fraction)


def _nanoseconds(fraction: str | None) -> int:
    """Decimals of a second in nanoseconds; more than nine are cut off."""
    return int((fraction or "")[:9].ljust(9, "0"))


def read_text(path: str | os.PathLike[str]) -> tuple[str, str]:
    """Text of a file in UTF-8, UTF-16 or Latin-1 and the SHA-256 of its bytes; InputError if it is absent,
    empty or not text.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or fault
        raise InputError(f"{path}: cannot be read ({reason}); name a readable file") from None
    if data.startswith(WORKBOOKS):
        raise InputError(f"{path}: not a text file but a workbook or an archive; export the sheet as CSV")
    text = _decoded(data)
    if _CONTROL.search(text):
        raise InputError(f"{path}: not a text file; save it as plain text in UTF-8")
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    return text, hashlib.sha256(data).hexdigest()


def _decoded(data: bytes) -> str:
    """Text of bytes; with a control character in it if they are no text."""
    odd, even = data[1:200:2], data[0:200:2]
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encodings = ("utf-16",)
    elif odd and not any(odd) and all(even):  # UTF-16 without a mark, of a language in Latin letters
        encodings = ("utf-16-le",)
    elif len(data) > 1 and not any(even) and all(odd):
        encodings = ("utf-16-be",)
    else:
        encodings = ("utf-8-sig", "cp1252", "latin-1")
    for encoding in encodings:
        try:
            return data.decode(encoding)
        except UnicodeDecodeError:
            continue
    return "\0"


def read_table(path: str | os.PathLike[str]) -> Table:
    """A CSV file with a header row.

    Cells are parted by commas, semicolons or tabs. Blank lines, comments (#), a line "sep=;" and title lines
    above the header are skipped; a header may be a comment. A row of units below the header is kept apart.

    Raises InputError if it is no text file, empty, has a header only, or a row of another length.
    """
    path = Path(path)
    text, sha256 = read_text(path)
    rows, comments = _rows(path, text)
    header, rest = _header(rows, comments)
    units: list[str] = []
    if len(rest) > 1 and _are_units(rest[0][1]) and is_data(rest[1][1]):
        units = [re.sub(r"^[\[(]|[\])]$", "", cell.strip()).strip(" -–") for cell in rest.pop(0)[1]]
        units = (units + [""] * len(header))[: len(header)]
    cells, numbers, plain = [], [], True
    for number, row in rest:
        while len(row) > len(header) and not row[-1].strip():
            row.pop()
        if len(row) != len(header):
            raise InputError(
                f"{path}: row {number} has {len(row)} cells and the header {len(header)}; {_odd(header, row)}"
            )
        joined = "".join(row)
        plain = plain and "," not in joined and "_" not in joined
        cells.append(row)
        numbers.append(number)
    blanks = [row[0].split() for row in cells[:1] if len(header) == 1 and not _is_numeral(row[0])]
    if any(len(parts) > 1 and all(map(_is_numeral, parts)) for parts in blanks):
        raise InputError(f"{path}: blanks part its numbers; part the cells with commas, semicolons or tabs")
    if not cells:
        raise InputError(f"{path}: has a header but no rows; at least one row of numbers is needed")
    return Table(path, sha256, header, cells, numbers, units, plain)


def _odd(header: list[str], row: list[str]) -> str:
    """The remedy for a row of another length than the header."""
    if len(row) == 2 * len(header) and all(map(_is_numeral, row)):
        return "if these are decimal commas, export with semicolons between the cells, or with decimal points"
    if len(header) == 1:
        return "put one header row above the numbers, and part its cells as those of the numbers"
    return "complete or delete the row"


_Rows = list[tuple[int, list[str]]]


def _rows(path: Path, text: str) -> tuple[_Rows, _Rows]:
    """Rows that are not blank and comments, without their sign, each with its number in an editor."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    said = re.match(r'\s*"?sep=(.)"?;?,?[ \t]*\n', text, re.IGNORECASE)
    delimiter = said[1] if said else _delimiter(text)
    rows: _Rows = []
    comments: _Rows = []
    reader = csv.reader(io.StringIO(text), delimiter=delimiter)
    try:
        for row in reader:
            if said and reader.line_num <= text[: said.end()].count("\n"):
                continue
            if not any(cell.strip() for cell in row):
                continue
            if row[0].lstrip().startswith("#"):
                comments.append((reader.line_num, [row[0].lstrip().lstrip("#").strip(), *row[1:]]))
            else:
                rows.append((reader.line_num, row))
    except csv.Error as fault:
        raise InputError(f"{path}: row {reader.line_num}: not CSV ({fault}); export it again") from None
    return rows, comments


def _delimiter(text: str) -> str:
    """What parts the cells: what cuts most of the first rows into equally many, at least two."""
    lines = [line for line in text.split("\n", _SAMPLED)[:_SAMPLED] if line.strip() and line[0] != "#"]

    def alike(delimiter: str) -> int:
        try:
            widths = [len(row) for row in csv.reader(lines, delimiter=delimiter)]
        except csv.Error:
            return 0
        return max((n for width, n in Counter(widths).items() if width > 1), default=0)

    return max("\t;,", key=alike) if any(map(alike, "\t;,")) else ","


def _header(rows: _Rows, comments: _Rows) -> tuple[list[str], _Rows]:
    """The header, and the rows below it."""
    data = next((i for i, (_, row) in enumerate(rows) if is_data(row)), 1)
    if data == 0:
        number, first = rows[0]
        above = [row for line, row in comments if line < number and len(row) == len(first)]
        if above and not is_data(above[-1]):
            return [cell.strip() for cell in above[-1]], rows
    place = max(range(max(data, 1)), key=lambda i: _filled(rows[i][1])) if rows else 0
    header = [cell.strip() for cell in rows[place][1]] if rows else []
    widest = max((len(row) for _, row in rows[place + 1 :]), default=len(header))
    while len(header) > widest and not header[-1]:
        header.pop()
    return header, rows[place + 1 :]


def _filled(row: list[str]) -> int:
    return sum(bool(cell.strip()) for cell in row)


def is_data(row: Iterable[str]) -> bool:
    """Whether most cells are numbers or time stamps."""
    cells = [cell for cell in row if cell.strip()]
    known = sum(_is_numeral(cell) or _is_stamp(cell) or cell.strip().lower() in _NOTHING for cell in cells)
    return known > len(cells) / 2


def _are_units(row: Iterable[str]) -> bool:
    """Whether a row names units: no number in it, nothing long, and at least one unit that is known."""
    cells = [bare for cell in row if (bare := re.sub(r"^[\[(]|[\])]$", "", cell.strip()))]
    odd = [c for c in cells if len(c) > 12 or _is_numeral(c) or _is_stamp(c) or c.lower() in _NOTHING]
    return not odd and any(measures(cell, si) for cell in cells for si in DIMENSIONS)
