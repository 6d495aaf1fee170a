"""Rows that are all alike, split into columns by polars, all at once."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from .csv_layout import NUMBERLIKE

if TYPE_CHECKING:
    import polars as pl

_FOREIGN = re.compile(r"(?![0-9])\d")  # a digit, but of another script


def split_alike(text: str, begin: int, *, delimiter: str, width: int) -> list[pl.Series] | None:
    """The columns of a text's rows, texts of (K,) each; None if anything in them is odd: quotes or comments,
    blank lines, rows of another length or without a number, digits of other scripts.

    Args:
        text: whose lines end with "\\n".
        begin: where the rows begin.
        delimiter: parts their cells.
        width: how many cells each should have.
    """
    if text.find('"', begin) >= 0 or text.find("#", begin) >= 0:
        return None
    body = text[begin:].rstrip("\n").encode()
    if not body.isascii() and _FOREIGN.search(text, begin):
        return None
    if not _even(body, delimiter, width):
        return None
    columns = _split(body, delimiter)
    if len(columns) != width or (any(s.null_count() for s in columns) and _blank_rows(columns)):
        return None
    return None if _rows_of_words(body, columns) else columns


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
