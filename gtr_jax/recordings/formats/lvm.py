"""Measurement files of LabVIEW (.lvm): text with a header of its own, and one for each stretch of samples."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gtr_jax.errors import InputError, excerpt, listed

from .cells import NumberCells, number_in, tidy
from .expansion import check_cells
from .sheet import Table

MAGIC = "LabVIEW Measurement"
_END = "***End_of_Header***"
_SPECIAL = ("***Start_Special***", "***End_Special***")
_SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}
_EXPORT = "write it with one header and one time column, or export it as CSV"


class _Segment(NamedTuple):
    """One stretch of samples: its header by key, the names of its columns, its rows with their numbers."""

    said: dict[str, list[str]]
    names: list[str]
    rows: list[tuple[int, list[str]]]


class _Stretch(NamedTuple):
    """The numbers of a segment: time and channels, (K,) each, units by channel, and the rows' numbers."""

    time: np.ndarray
    channels: dict[str, np.ndarray]
    units: dict[str, str]
    numbers: np.ndarray


def is_lvm(text: str) -> bool:
    """Whether a text is a measurement file of LabVIEW."""
    return text.lstrip("\ufeff").startswith(MAGIC)


def read_lvm(path: Path, text: str, sha256: str) -> Table:
    """The table of a LabVIEW measurement: `time`, from its X column or else from the interval that its header
    states, and the channels under their names, with the units that the header states.

    Channels without samples, and those with a clock that is not that of the first, are left out. Several
    stretches of samples of the same channels follow one another as their dates say.

    Raises InputError naming file, row and remedy if it holds no samples, a cell is not a number, or its
    stretches do not fit together.
    """
    check_cells(path, text, "\t;,")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    file, at = _header(lines, 1)
    separator = _SEPARATORS.get((file.get("Separator") or ["Tab"])[0].strip(), "\t")
    if separator != "\t":
        file, at = _header(lines, 1, separator)
    mark = (file.get("Decimal_Separator") or [""])[0].strip()
    segments = _segments(path, lines, at, separator)
    if not any(segment.rows for segment in segments):
        raise InputError(f"{path}: a LabVIEW measurement without samples; at least one row is needed")
    mark = mark if mark in (".", ",") else _mark(segments)
    notes: list[str] = []
    stretches = [_numbers(path, file, segment, mark, notes) for segment in segments if segment.rows]
    names = [*stretches[0].channels]
    if any([*other.channels] != names for other in stretches):
        raise InputError(f"{path}: its stretches of samples have different channels; {_EXPORT}")
    starts = [0.0] * len(stretches) if len(stretches) == 1 else _starts(path, segments)
    times = [stretch.time + start for stretch, start in zip(stretches, starts, strict=True)]
    columns = [np.concatenate(times)]
    columns += [np.concatenate([stretch.channels[name] for stretch in stretches]) for name in names]
    return Table(
        path,
        sha256,
        ["time", *names],
        [NumberCells(values) for values in columns],
        np.concatenate([stretch.numbers for stretch in stretches]),
        ["s", *(stretches[0].units[name] for name in names)],
        plain=True,
        notes=tuple(dict.fromkeys(notes)),
    )


def _header(lines: list[str], at: int, separator: str = "\t") -> tuple[dict[str, list[str]], int]:
    """The keys of a header with their values, and the line after it."""
    said: dict[str, list[str]] = {}
    special = False
    for i in range(at, len(lines)):
        line = lines[i].strip(" ")
        if line.startswith(_END):
            return said, i + 1
        special = line.startswith(_SPECIAL[0]) or (special and not line.startswith(_SPECIAL[1]))
        key, *values = line.split(separator)
        if not special and key:
            said[key.strip()] = values
    return said, len(lines)


def _segments(path: Path, lines: list[str], at: int, separator: str) -> list[_Segment]:
    """The stretches of samples, in their order."""
    segments: list[_Segment] = []
    while at < len(lines):
        if not lines[at].strip():
            at += 1
            continue
        if not lines[at].startswith("X_Value"):
            begun = at
            said, at = _header(lines, at, separator)
            if at >= len(lines):
                raise InputError(
                    f"{path}: row {begun + 1}: expected a stretch's header that ends with {_END}; write "
                    "the file again"
                )
        else:
            said = {}
        names = [name.strip() for name in lines[at].split(separator)]
        rows: list[tuple[int, list[str]]] = []
        at += 1
        while at < len(lines) and lines[at].strip():
            rows.append((at + 1, lines[at].split(separator)))
            at += 1
        segments.append(_Segment(said, names, rows))
    return segments


def _mark(segments: list[_Segment]) -> str:
    """The decimal mark of a file that does not state it."""
    cells = (cell for segment in segments for _, row in segment.rows for cell in row)
    marked = (cell for cell in cells if re.fullmatch(r"[+-]?\d*[.,]\d+(?:[eE][+-]?\d+)?", tidy(cell)))
    return "," if "," in next(marked, ".") else "."


def _numbers(
    path: Path, file: dict[str, list[str]], segment: _Segment, mark: str, notes: list[str]
) -> _Stretch:
    """The numbers of a segment."""
    multi = (file.get("X_Columns") or ["One"])[0].strip() == "Multi"
    names = segment.names[: -1 if segment.names[-1:] == ["Comment"] else None]
    places = [i for i in range(1, len(names)) if not (multi and i % 2 == 0) and names[i]]
    said = segment.said

    def value(key: str, channel: int) -> str:
        """What the header says of a channel; its cells stand beside those of the channel, or as many."""
        values = said.get(key, [])
        place = 2 * channel if multi else channel
        return values[place].strip() if place < len(values) else ""

    columns: dict[int, np.ndarray] = {}
    for place in {0, *places, *(p - 1 for p in places if multi)}:
        columns[place] = _column(path, segment, place, mark)
    filled = [place for place in places if np.isfinite(columns[place]).any()]
    if not filled:
        raise InputError(f"{path}: row {segment.rows[0][0]}: no channel holds numbers; write them again")
    count = len(segment.rows)
    first = filled[0]
    x = columns[first - 1 if multi else 0]
    if not np.isfinite(x).any():
        step, start = (_of(path, key, value(key, places.index(first)), mark) for key in ("Delta_X", "X0"))
        x = start + step * np.arange(count)
    kept = [place for place in filled if not multi or np.array_equal(columns[place - 1], x, equal_nan=True)]
    if len(kept) < len(filled):
        others = listed([f"'{names[place]}'" for place in filled if place not in kept])
        notes.append(f"{others} left out, whose clock is not that of '{names[first]}'")
    used = np.isfinite(x)
    units = {names[place]: value("Y_Unit_Label", places.index(place)) for place in kept}
    if len(units) < len(kept):
        raise InputError(f"{path}: row {segment.rows[0][0] - 1}: two channels have one name; rename one")
    return _Stretch(
        x[used],
        {names[place]: columns[place][used] for place in kept},
        units,
        np.array([number for number, _ in segment.rows])[used],
    )


def _column(path: Path, segment: _Segment, place: int, mark: str) -> np.ndarray:
    """The numbers of a column, (K,), NaN where a cell is empty; InputError where it is not a number."""
    cells = [row[place] if place < len(row) else "" for _, row in segment.rows]
    values = np.array([number_in(cell, mark) for cell in cells])
    bad = [i for i in np.flatnonzero(np.isnan(values)) if tidy(cells[i]).lower() not in ("", "nan")]
    if bad:
        row, name = segment.rows[bad[0]][0], segment.names[place]
        raise InputError(
            f"{path}: row {row}, column '{name}': expected a number, found "
            f"'{excerpt(cells[bad[0]].strip())}'; correct the cell or delete the row"
        )
    return values


def _of(path: Path, key: str, text: str, mark: str) -> float:
    value = number_in(text, mark)
    if not np.isfinite(value) and key == "X0" and not text:
        return 0.0
    if not np.isfinite(value):
        raise InputError(f"{path}: {key}: expected a number, found '{excerpt(text)}'; {_EXPORT}")
    return value


def _starts(path: Path, segments: list[_Segment]) -> list[float]:
    """When each stretch of samples begins after the first [s]."""
    found: list[datetime] = []
    for segment in segments:
        if not segment.rows:
            continue
        date, time = (next(iter(segment.said.get(key, [])), "").strip() for key in ("Date", "Time"))
        time = re.sub(r"[.,](\d{1,6})\d*$", r".\1", time)
        try:
            found.append(datetime.strptime(f"{date} {time}", "%Y/%m/%d %H:%M:%S" + ".%f" * ("." in time)))
        except ValueError:
            raise InputError(
                f"{path}: row {segment.rows[0][0]}: no date and time say when this further stretch of "
                f"samples begins; {_EXPORT}"
            ) from None
    return [(moment - found[0]).total_seconds() for moment in found]
