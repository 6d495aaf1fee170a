"""CSV tables as people's programs export them.

Read are commas, semicolons or tabs; decimal points or commas; thousands separators; comments, title lines,
rows of units, no header at all, and several tables in one file. What may mean two things is refused.

`csv_layout` decides how the rows lie. They are split one by one, those of a large file all at once where they
are alike; either way cells stay text until a column is asked for.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gtr_jax.errors import InputError

from .cells import TextCells, is_numeral
from .csv_layout import Layout, Rows, is_data, layout_of
from .expansion import check_cells
from .many_cells import ManyTextCells
from .rows_alike import split_alike
from .sheet import Table

LARGE = 2_000_000  # characters from which rows are split all at once; below, importing polars takes longer
_HEAD = 400  # lines of a large file in which the header and the first rows are looked for
_SAMPLED = 200  # rows by which the separator is told
_SAID = re.compile(r'\s*"?sep=(.)"?;?,?[ \t]*\n', re.IGNORECASE)


def read_csv(path: Path, text: str, sha256: str) -> Table:
    """The table that the text of a CSV file holds.

    Cells are parted by commas, semicolons or tabs. Blank lines, comments (#), a line "sep=;" and title lines
    above the header are skipped; a header may be a comment. A row of units below the header is kept apart.
    Columns without a header are numbered from "column 1". Of several tables in the file, the longest is read.
    A last row that ends before its line does is left out.

    Raises InputError if it has a header only, a row of another length, or more cells than are read so.
    """
    cut = not text.endswith(("\n", "\r"))
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    table = _of_alike_rows(path, text, sha256) if len(text) >= LARGE else None
    if table is not None:
        return table
    check_cells(path, text, delimiter_of(text))
    return table_of(path, layout_of_text(path, text), sha256, cut=cut)


def _of_alike_rows(path: Path, text: str, sha256: str) -> Table | None:
    """The table of a text whose rows lie as the first of them do, split all at once; None if they do not, or
    the first have anything odd.
    """
    end = _after_lines(text, _HEAD)
    if end == 0:
        return None
    try:
        header, units, rest, numbered, notes = layout_of_text(path, text[:end])
    except InputError:
        return None
    if notes or len(rest) < 2 or not is_data(rest[0][1]) or len(rest[0][1]) != len(header):
        return None
    first, delimiter = rest[0][0], delimiter_of(text[:end])
    begin = _after_lines(text, first - 1)
    columns = split_alike(text, begin, delimiter=delimiter, width=len(header))
    if columns is None:
        return None
    numbers = np.arange(first, first + len(columns[0]))
    plain = delimiter == "," or text.find(",", begin) < 0
    return Table(
        path, sha256, header, [*map(ManyTextCells, columns)], numbers, units, plain, numbered=numbered
    )


def _after_lines(text: str, count: int) -> int:
    """Where so many lines of a text end; 0 if it has fewer."""
    end = 0
    for _ in range(count):
        end = text.find("\n", end) + 1
        if end == 0:
            return 0
    return end


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
    columns = [TextCells(column) for column in zip(*cells, strict=True)]
    return Table(path, sha256, header, columns, np.array(numbers), units, plain, notes, numbered)


def layout_of_text(path: Path, text: str) -> Layout:
    """How the rows of a text lie, whose lines end with "\\n"."""
    return layout_of(path, *_rows(path, text))


def _odd(header: list[str], row: list[str]) -> str:
    """The remedy for a row of another length than the header."""
    if len(row) == 2 * len(header) and all(map(is_numeral, row)):
        return "if these are decimal commas, export with semicolons between the cells, or with decimal points"
    if len(header) == 1:
        return "put one header row above the numbers, and separate its cells as those of the numbers"
    return "complete or delete the row"


def _rows(path: Path, text: str) -> tuple[Rows, Rows]:
    """Rows that are not blank and comments, without their sign, each with its number in an editor."""
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
