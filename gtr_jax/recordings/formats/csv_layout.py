"""How the rows of a table of text lie: which is the header, which names units, where another table begins."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from gtr_jax.errors import InputError, listed
from gtr_jax.units import DIMENSIONS, measures

from .cells import NOTHING, is_numeral
from .quantities import SPELLINGS, plain_name, split_unit
from .time_stamps import is_stamp

_SAMPLED = 200  # rows at either side of another header that tell whether another table begins there
_NAMED = ("N", "m", "s", "rad")  # whose units a header may end with
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
