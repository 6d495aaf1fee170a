"""Workbooks of Excel and LibreOffice (.xlsx, .xlsm, .xlsb, .xls, .ods), read by python-calamine."""

from __future__ import annotations

import datetime
import io
from pathlib import Path
from typing import Any

from gtr_jax.errors import InputError

from .csv_layout import Rows, layout_of
from .csv_text import table_of
from .expansion import ZIP, archive_members
from .sheet import Table
from .subprocess_reader import read_in_subprocess

OLE = b"\xd0\xcf\x11\xe0"  # how .xls files begin
MAGICS = (ZIP, OLE)
_OF_EXCEL, _OF_LIBREOFFICE = "xl/workbook.", "content.xml"
_WHOLE = 1e15  # numbers below it that are whole are written without decimals

_Cells = list[list[str]]


def read_workbook(path: Path, data: bytes, sha256: str) -> Table:
    """The table of a workbook: of the sheet with most rows of numbers, laid out as a CSV file may be.

    Its rows are numbered as the sheet shows them; dates and times of day are time stamps.

    Raises InputError naming the file if it is damaged, is an archive and no workbook, holds no numbers, or
    takes more memory than a recording should.
    """
    if data.startswith(ZIP):
        names = archive_members(path, data)
        if not any(name.startswith(_OF_EXCEL) or name == _OF_LIBREOFFICE for name in names):
            raise InputError(f"{path}: an archive and no workbook; unpack it and name the file in it")
    sheets = read_in_subprocess(
        sheets_of,
        data,
        path=path,
        intact="a complete workbook, or one of too many cells",
        remedy="export the sheet as CSV",
    )
    found = []
    for name, first, cells in sheets:
        rows, comments = _parted(first, cells)
        if rows:
            found.append((name, layout_of(path, rows, comments)))
    found = [(name, layout) for name, layout in found if layout.rest]
    if not found:
        raise InputError(
            f"{path}: no sheet of this workbook holds rows of numbers; at least one row is needed"
        )
    name, layout = max(found, key=lambda own: len(own[1].rest))
    if len(found) > 1:
        layout = layout._replace(notes=(*layout.notes, f"of {len(found)} sheets, '{name}' is read"))
    return table_of(path, layout, sha256)


def _parted(first: int, cells: _Cells) -> tuple[Rows, Rows]:
    """Rows that are not blank and comments, without their sign, each with its number."""
    rows: Rows = []
    comments: Rows = []
    for number, row in enumerate(cells, first + 1):
        if not any(cell.strip() for cell in row):
            continue
        if row[0].lstrip().startswith("#"):
            comments.append((number, [row[0].lstrip().lstrip("#").strip(), *row[1:]]))
        else:
            rows.append((number, row))
    return rows, comments


def sheets_of(data: bytes) -> list[tuple[str, int, _Cells]]:
    """The sheets of a workbook: their names, the rows above the first that is used, and their cells."""
    from python_calamine import CalamineWorkbook

    found = []
    with CalamineWorkbook.from_filelike(io.BytesIO(data)) as book:
        for about in book.sheets_metadata:
            if "WorkSheet" not in str(about.typ):
                continue
            sheet = book.get_sheet_by_name(about.name)
            cells = [[_text(cell) for cell in row] for row in sheet.to_python(skip_empty_area=True)]
            found.append((about.name, (sheet.start or (0, 0))[0], cells))
    return found


def _text(cell: Any) -> str:
    """A cell as a CSV file has it."""
    if isinstance(cell, str):
        return cell
    if isinstance(cell, bool):
        return str(int(cell))
    if isinstance(cell, float):
        return str(int(cell)) if abs(cell) < _WHOLE and cell == int(cell) else repr(cell)
    if isinstance(cell, datetime.timedelta):
        return repr(cell.total_seconds())
    if isinstance(cell, datetime.datetime | datetime.date | datetime.time):
        return cell.isoformat()
    return str(cell)
