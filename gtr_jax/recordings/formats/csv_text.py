"""CSV tables as people's programs export them: text to cells.

Read are commas, semicolons or tabs; decimal points or commas; thousands separators; comments, title lines,
rows of units, no header at all, and several tables in one file. What may mean two things is refused.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gtr_jax.errors import InputError, listed
from gtr_jax.units import DIMENSIONS, measures

from .cells import NOTHING, Written, is_numeral, is_stamp
from .expansion import check_cells
from .quantities import SPELLINGS, plain_name, split_unit
from .sheet import Table

_SAMPLED = 200  # rows by which the separator is told
_NAMED = ("N", "m", "s", "rad")  # whose units a header may end with
_SAID = re.compile(r'\s*"?sep=(.)"?;?,?[ \t]*\n', re.IGNORECASE)
NUMBERLIKE = r"^\s*[+\-−]?[.,]?\d"  # how a number or a time stamp begins
_NUMBERLIKE = re.compile(NUMBERLIKE)

Rows = list[tuple[int, list[str]]]


class Layout(NamedTuple):
    """How the rows of a table lie.

    Attributes:
        header, units: names of the columns, and what a row of units says of each; no units where there is no
            such row.
        rest: the rows of cells, each with its number.
        numbered: whether the file names no column, so that `header` counts them.
        notes: sentences on how the rows were read.
    """

    header: list[str]
    units: list[str]
    rest: Rows
    numbered: bool = False
    notes: tuple[str, ...] = ()


def read_csv(path: Path, text: str, sha256: str) -> Table:
    """The table that the text of a CSV file holds.

    Cells are parted by commas, semicolons or tabs. Blank lines, comments (#), a line "sep=;" and title lines
    above the header are skipped; a header may be a comment. A row of units below the header is kept apart.
    Columns without a header are numbered from "column 1". Of several tables in the file, the longest is read.
    A last row that ends before its line does is left out.

    Raises InputError if it has a header only, a row of another length, or more cells than are read so.
    """
    check_cells(path, text, delimiter_of(text))
    return table_of(path, laid_out(path, text), sha256, cut=not text.endswith(("\n", "\r")))


def table_of(path: Path, layout: Layout, sha256: str, *, cut: bool = False) -> Table:
    """The table of rows that are laid out.

    Args:
        path, sha256: of the file.
        layout: of its rows.
        cut: whether the last row may be incomplete, because its line does not end.
    """
    header, units, rest, numbered, notes = layout
    cells, numbers, plain = [], [], True
    for number, row in rest:
        while len(row) > len(header) and not row[-1].strip():
            row.pop()
        if len(row) != len(header):
            if cut and cells and number == rest[-1][0] and len(row) < len(header):
                notes = (*notes, f"row {number}, the last, is incomplete and left out")
                continue
            others = "the rows above" if numbered else "the header"
            raise InputError(
                f"{path}: row {number} has {len(row)} cells and {others} {len(header)}; {_odd(header, row)}"
            )
        plain = plain and not any("," in cell for cell in row)
        cells.append(row)
        numbers.append(number)
    blanks = [row[0].split() for row in cells[:1] if len(header) == 1 and not is_numeral(row[0])]
    if any(len(parts) > 1 and all(map(is_numeral, parts)) for parts in blanks):
        raise InputError(
            f"{path}: blanks separate its numbers; separate the cells with commas, semicolons or tabs"
        )
    if not cells:
        raise InputError(f"{path}: has a header but no rows; at least one row of numbers is needed")
    columns = [Written(column) for column in zip(*cells, strict=True)]
    return Table(path, sha256, header, columns, np.array(numbers), units, plain, notes, numbered)


def laid_out(path: Path, text: str) -> Layout:
    """How the rows of a text lie."""
    return layout_of(path, *_rows(path, text))


def layout_of(path: Path, rows: Rows, comments: Rows | None = None) -> Layout:
    """How rows lie, those of the longest table where there are several.

    Args:
        path: of the file, which errors name.
        rows: each with its number.
        comments: likewise, without their sign.

    Raises InputError if another table has as many columns: it may be a part of the same recording, unless it
    has one row under other names.
    """
    tables = [_layout(block, comments or []) for block in _blocks(rows)]
    longest = max(tables, key=lambda table: len(table.rest))
    if len(tables) == 1:
        return longest
    width = len(_trimmed(longest.header))
    alike = [
        table
        for table in tables
        if len(_trimmed(table.header)) == width
        and (table is longest or table.header == longest.header or len(table.rest) > 1)
    ]
    if len(alike) > 1:
        one = all(table.header == longest.header for table in alike)
        of = "with one header" if one else f"of {width} columns"
        begun = listed([str(table.rest[0][0]) for table in alike])
        raise InputError(
            f"{path}: holds {len(alike)} tables {of}, their first rows {begun}; give each recording a file "
            "of its own"
        )
    first, last = longest.rest[0][0], longest.rest[-1][0]
    return longest._replace(
        notes=(f"holds {len(tables)} tables: the longest, rows {first} to {last}, is read",)
    )


def _layout(rows: Rows, comments: Rows) -> Layout:
    """How the rows of one table lie."""
    at = [*itertools.islice((i for i, (_, row) in enumerate(rows) if is_data(row)), 2)]
    data = at[0] if at else None
    if data == 0:
        number, first = rows[0]
        above = [row for line, row in comments if line < number and len(row) == len(first)]
        if above and not is_data(above[-1]):
            return Layout([cell.strip() for cell in above[-1]], [], rows)
        below = rows[at[1]][1] if len(at) > 1 else []
        if not _names_columns(first, below):
            return Layout(numbered_columns(_commonest(rows)), [], rows, numbered=True)
        data = at[1]
    place = _place(rows, data)
    header = [cell.strip() for cell in rows[place][1]] if rows else []
    rest = rows[place + 1 :]
    widest = max((len(row) for _, row in rest), default=len(header))
    while len(header) > widest and not header[-1]:
        header.pop()
    if not data:
        return Layout(header, [], rest)
    between = rows[place + 1 : data]
    said = next((row for _, row in between if _are_units(row)), None)
    units = [] if said is None else [re.sub(r"^[\[(]|[\])]$", "", c.strip()).strip(" -–") for c in said]
    units = (units + [""] * len(header))[: len(header)] if said is not None else []
    return Layout(header, units, [own for own in between if not _describes(own[1])] + rows[data:])


def numbered_columns(count: int) -> list[str]:
    """Names of columns that have none."""
    return [f"column {i}" for i in range(1, count + 1)]


def _commonest(rows: Rows) -> int:
    """The number of cells that most rows have."""
    counts = Counter(len(row) for _, row in rows)
    return max(counts, key=lambda width: (counts[width], width))


def _names_columns(first: Sequence[str], below: Sequence[str]) -> bool:
    """Whether a first row, most of whose cells are numbers, is a header nevertheless: it has a word above a
    number, or counts the columns, 0, 1, 2, …, while there are decimals below.
    """
    if any(_is_word(name) and is_numeral(cell) for name, cell in zip(first, below, strict=False)):
        return True
    names = [cell.strip() for cell in first]
    names = names if names[0] else names[1:]
    counted = [[str(i) for i in range(start, start + len(names))] for start in (0, 1)]
    decimals = any(is_numeral(cell) and not re.fullmatch(r"\s*[+-]?\d+\s*", cell) for cell in below)
    return len(names) > 1 and names in counted and decimals


def _place(rows: Rows, data: int | None) -> int:
    """Which row is the header: of the fullest above the data that above the units, or else the first."""
    above = range(max(1 if data is None else data, 1))
    if not rows or not data:
        return max(above, key=lambda i: _filled(rows[i][1])) if rows else 0

    def score(i: int) -> tuple[int, bool]:
        return _filled(rows[i][1]), i + 1 < data and _are_units(rows[i + 1][1])

    named = [i for i in above if _fits(rows[i][1], rows[data][1]) and not _are_units(rows[i][1])]
    # Titles and small tables are parted from it by a blank line.
    gap = max((i for i in named if i and rows[i][0] > rows[i - 1][0] + 1), default=0)
    named = [i for i in named if i >= gap] or [*above]
    return max(named, key=score)


def _fits(header: Sequence[str], row: Sequence[str]) -> bool:
    """Whether a row has a cell for each name of a header, and no more."""
    return len(_trimmed(row)) <= len(_trimmed(header)) <= len(row)


def _trimmed(row: Sequence[str]) -> Sequence[str]:
    width = len(row)
    while width and not row[width - 1].strip():
        width -= 1
    return row[:width]


def _blocks(rows: Rows) -> list[Rows]:
    """The rows parted where, below rows of data, a header stands above others."""
    blocks: list[Rows] = []
    begin = words = 0
    first = next((i for i, (_, row) in enumerate(rows) if is_data(row)), len(rows))
    headers = [_bare(row) for _, row in rows[:first]]
    for i, (_, row) in enumerate(rows):
        if _are_words(row):
            continue
        if first < words < i and is_data(row):
            below = itertools.takewhile(lambda own: not _are_words(own[1]), rows[i : i + _SAMPLED])
            other = _width(rows[max(begin, words - _SAMPLED) : words]) != _width(below)
            between = [row for _, row in rows[words:i]]
            titled = rows[words][0] > rows[words - 1][0] + 1 and any(_filled(own) == 1 for own in between)
            told = other or titled or any(map(_are_units, between))
            if any(
                _heads(names, row) and (told or _bare(names) in headers or _are_known(names))
                for names in between
            ):
                blocks.append(rows[begin:words])
                begin = words
        words = i + 1
    return [*blocks, rows[begin:]]


def _heads(names: Sequence[str], row: Sequence[str]) -> bool:
    """Whether a row of words may be a header above a row of data: names that differ, not marks of an overload
    in every cell.
    """
    least = max(2, len(_trimmed(row)) - 1)
    return _fits(names, row) and _filled(names) >= least and not _are_units(names) and _differ(names)


def _are_known(names: Iterable[str]) -> bool:
    """Whether any name is that of a quantity, or ends with a unit."""
    for name in map(str.strip, names):
        for si in _NAMED:
            own, unit = split_unit(name, si)
            if SPELLINGS.get(plain_name(own), "trial") != "trial":  # "Trial" also begins a remark
                return True
            if unit is not None and any(measures(unit, known) for known in DIMENSIONS):
                return True
    return False


def _describes(row: Sequence[str]) -> bool:
    """Whether a row right below the header says more of the columns: units, or words that differ."""
    return _are_words(row) and (_are_units(row) or (_filled(row) > 1 and _differ(row)))


def _differ(row: Sequence[str]) -> bool:
    """Whether no cell but empty ones is there twice."""
    cells = [cell.lower() for cell in _bare(row) if cell]
    return len({*cells}) == len(cells)


def _bare(row: Sequence[str]) -> list[str]:
    return [cell.strip() for cell in _trimmed(row)]


def _width(rows: Iterable[tuple[int, list[str]]]) -> int:
    """The most cells that a row of data among these has."""
    return max((len(_trimmed(row)) for _, row in rows if is_data(row)), default=0)


def _odd(header: list[str], row: list[str]) -> str:
    """The remedy for a row of another length than the header."""
    if len(row) == 2 * len(header) and all(map(is_numeral, row)):
        return "if these are decimal commas, export with semicolons between the cells, or with decimal points"
    if len(header) == 1:
        return "put one header row above the numbers, and separate its cells as those of the numbers"
    return "complete or delete the row"


def _rows(path: Path, text: str) -> tuple[Rows, Rows]:
    """Rows that are not blank and comments, without their sign, each with its number in an editor."""
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    said = _SAID.match(text)
    delimiter = delimiter_of(text)
    rows: Rows = []
    comments: Rows = []
    reader = csv.reader(_lines(text), delimiter=delimiter)
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


def _lines(text: str) -> Iterator[str]:
    """The lines of a text with their ends, one by one, as a stream would copy all of it."""
    at = 0
    while at < len(text):
        end = text.find("\n", at) + 1 or len(text)
        yield text[at:end]
        at = end


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


def _filled(row: Sequence[str]) -> int:
    return sum(bool(cell.strip()) for cell in row)


def is_data(row: Iterable[str]) -> bool:
    """Whether most cells are numbers or time stamps."""
    cells = [cell for cell in row if cell.strip()]
    known = sum(not _is_word(cell) for cell in cells)
    return known > len(cells) / 2


def _is_word(cell: str) -> bool:
    """Whether a cell is neither empty nor a number, a time stamp or a word for nothing."""
    bare = cell.strip()
    return bool(bare) and not (is_numeral(bare) or is_stamp(bare) or bare.lower() in NOTHING)


def _are_words(row: Sequence[str]) -> bool:
    """Whether no cell begins as a number does, or says that there is none."""
    return not any(_NUMBERLIKE.match(cell) or cell.strip().lower() in NOTHING for cell in row)


def _are_units(row: Iterable[str]) -> bool:
    """Whether a row names units: no number in it, nothing long, and at least one unit that is known."""
    cells = [bare for cell in row if (bare := re.sub(r"^[\[(]|[\])]$", "", cell.strip()))]
    odd = [c for c in cells if len(c) > 12 or is_numeral(c) or is_stamp(c) or c.lower() in NOTHING]
    return not odd and any(measures(cell, si) for cell in cells for si in DIMENSIONS)
