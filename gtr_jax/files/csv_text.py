"""CSV tables as people's programs export them: text to cells.

Read are commas, semicolons or tabs; decimal points or commas; thousands separators; comments, title lines and
a row of units. What may mean two things is refused.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gtr_jax.errors import InputError

from .cells import NOTHING, Written, is_numeral, is_stamp
from .sheet import Table
from .units import DIMENSIONS, measures

_SAMPLED = 200  # rows by which the separator is told
_SAID = re.compile(r'\s*"?sep=(.)"?;?,?[ \t]*\n', re.IGNORECASE)

_Rows = list[tuple[int, list[str]]]


def read_csv(path: Path, text: str, sha256: str) -> Table:
    """The table that the text of a CSV file holds.

    Cells are parted by commas, semicolons or tabs. Blank lines, comments (#), a line "sep=;" and title lines
    above the header are skipped; a header may be a comment. A row of units below the header is kept apart.

    Raises InputError if it has a header only, or a row of another length.
    """
    header, units, rest = laid_out(path, text)
    cells, numbers, plain = [], [], True
    for number, row in rest:
        while len(row) > len(header) and not row[-1].strip():
            row.pop()
        if len(row) != len(header):
            raise InputError(
                f"{path}: row {number} has {len(row)} cells and the header {len(header)}; {_odd(header, row)}"
            )
        plain = plain and not any("," in cell for cell in row)
        cells.append(row)
        numbers.append(number)
    blanks = [row[0].split() for row in cells[:1] if len(header) == 1 and not is_numeral(row[0])]
    if any(len(parts) > 1 and all(map(is_numeral, parts)) for parts in blanks):
        raise InputError(f"{path}: blanks part its numbers; part the cells with commas, semicolons or tabs")
    if not cells:
        raise InputError(f"{path}: has a header but no rows; at least one row of numbers is needed")
    columns = [Written(column) for column in zip(*cells, strict=True)]
    return Table(path, sha256, header, columns, np.array(numbers), units, plain)


def laid_out(path: Path, text: str) -> tuple[list[str], list[str], _Rows]:
    """Header, units below it (none where there is no such row), and the rows below, each with its number."""
    header, rest = _header(*_rows(path, text))
    units: list[str] = []
    if len(rest) > 1 and _are_units(rest[0][1]) and is_data(rest[1][1]):
        units = [re.sub(r"^[\[(]|[\])]$", "", cell.strip()).strip(" -–") for cell in rest.pop(0)[1]]
        units = (units + [""] * len(header))[: len(header)]
    return header, units, rest


def _odd(header: list[str], row: list[str]) -> str:
    """The remedy for a row of another length than the header."""
    if len(row) == 2 * len(header) and all(map(is_numeral, row)):
        return "if these are decimal commas, export with semicolons between the cells, or with decimal points"
    if len(header) == 1:
        return "put one header row above the numbers, and part its cells as those of the numbers"
    return "complete or delete the row"


def _rows(path: Path, text: str) -> tuple[_Rows, _Rows]:
    """Rows that are not blank and comments, without their sign, each with its number in an editor."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    said = _SAID.match(text)
    delimiter = delimiter_of(text)
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


def delimiter_of(text: str) -> str:
    """What parts the cells: what the first line says, or what cuts most of the first rows into equally many,
    at least two.
    """
    if said := _SAID.match(text):
        return said[1]
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
    known = sum(is_numeral(cell) or is_stamp(cell) or cell.strip().lower() in NOTHING for cell in cells)
    return known > len(cells) / 2


def _are_units(row: Iterable[str]) -> bool:
    """Whether a row names units: no number in it, nothing long, and at least one unit that is known."""
    cells = [bare for cell in row if (bare := re.sub(r"^[\[(]|[\])]$", "", cell.strip()))]
    odd = [c for c in cells if len(c) > 12 or is_numeral(c) or is_stamp(c) or c.lower() in NOTHING]
    return not odd and any(measures(cell, si) for cell in cells for si in DIMENSIONS)
