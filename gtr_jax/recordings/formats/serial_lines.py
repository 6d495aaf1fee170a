"""Lines that a serial monitor, a terminal or a sketch wrote: cells after the time at which a line came,
`14:05:00.000 -> 4.1,0.7`, or numbers after their names, `base: 4.1 g  tip: 0.7 g`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from gtr_jax.errors import InputError, excerpt, listed

from .csv_layout import Layout, Rows, is_data, numbered_columns
from .csv_text import delimiter_of, layout_of_text, table_of
from .expansion import check_cells
from .quantities import SPELLINGS, plain_name
from .sheet import Table

_HEAD = 200_000  # characters in which the first lines are looked for
_SAMPLED = 200  # lines by which such a file is told
MOST_ODD = 0.05
"""Share of the lines that may not be readings: a monitor shows whatever a device says."""
_LISTED = 6
_LONGEST = 500  # characters of a line whose numbers are named
_DATE = r"(?:(?:\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4})[T ])?"
_STAMPED = re.compile(
    rf"\s*\[?({_DATE}\d{{1,2}}:\d\d:\d\d(?:[.,]\d+)?(?: ?[AaPp]\.?[Mm]\.?)?)"
    r"(?:\]?\s*(?:->|→|>|\|)\s*|\]:?\s*| +(?![AaPp]\.?[Mm]\b|[+-]\d\d:?\d\d\b))(?=[^\s,;])"
)
_NUMBER = r"[+\-−]?(?:\d+(?:[.,]\d+)?|[.,]\d+)(?:[eE][+-]?\d+)?"
_NUMBERS = re.compile(rf"\s*{_NUMBER}(?:\s+{_NUMBER})+\s*")
_UNITS = "mN|kN|N|kgf|gf|kg|g|lbf|lbs?|ms|us|µs|s|mm|cm|m|deg|rad|mV|V|counts?"
_UNIT = rf"(?: ?({_UNITS})(?=[\s,;|}}\])]|$)(?!\s*[:=]))?"
_END = rf"\s*({_NUMBER}){_UNIT}(?=[\s,;|}}\])]|$)"
_NAMED = (
    re.compile(r"(?<!\w)([^\W\d][^:=,;|\t{}\[\]]*?)[\s\"']*[:=]" + _END),
    re.compile(r"(?<!\w)([^\W\d][^:=,;|\t{}\[\]\d]*?)\s+(?=[+\-−.,\d])" + _END),
)
_LEADING = re.compile(rf"\s*({_NUMBER})(?:\s*[,;\t|]|\s)\s*(?=[^\d\s])")


class _Log(NamedTuple):
    """The lines of a log.

    Attributes:
        stamps: the time of each line, by its number; none where the lines carry no times.
        lines: what they say after it, by number.
        odd: numbers of lines without a time among others that have one.
    """

    stamps: dict[int, str]
    lines: dict[int, str]
    odd: list[int]


def read_lines(path: Path, text: str, sha256: str) -> Table | None:
    """The table of lines that carry the time at which they came, or the names of their numbers; None if most
    of the first lines of a text do neither.

    The time becomes the column `time`. Lines that are not readings are left out and reported.

    Raises InputError if they are more than MOST_ODD of all.
    """
    head = text[:_HEAD].replace("\r\n", "\n").replace("\r", "\n").split("\n")[: _SAMPLED + 1]
    first = [line for line in head if line.strip() and not line.startswith("#")]
    stamped = [found for line in first if (found := _STAMPED.match(line))]
    timed = len(stamped) > len(first) / 2
    named = _naming([line[found.end() :] for line, found in _cut(first)] if timed else first)
    if not timed and named is None:
        return None
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    check_cells(path, text, "\t;,:=| ")
    log = _log(text, timed=timed)
    layout = _cells(path, log) if named is None else _named(log, *named)
    if layout is None:
        return None
    rest = [(number, row) for number, row in layout.rest if len(row) == len(layout.header)]
    known = {number for number, _ in rest}
    begin = min(known, default=0)
    odd = sorted({n for n in (*log.odd, *log.lines) if n >= begin} - known)
    last = next(reversed(log.lines), 0) if not text.endswith("\n") else 0
    cut = last in odd
    odd = [number for number in odd if number != last] if cut else odd
    if len(odd) > MOST_ODD * (len(odd) + len(rest)):
        line = text.split("\n")[odd[0] - 1]
        raise InputError(
            f"{path}: row {odd[0]} reads '{excerpt(line.strip())}', {len(odd)} of {len(odd) + len(rest)} "
            "lines are not like the others; delete them, or log nothing but the readings"
        )
    notes = list(layout.notes)
    if odd:
        lines = (
            "1 line that is not a reading is"
            if len(odd) == 1
            else f"{len(odd)} lines that are not readings are"
        )
        notes.append(f"{lines} left out: {listed(map(str, odd), _LISTED)}")
    if cut:
        notes.append(f"row {last}, the last, is incomplete and left out")
    return table_of(path, layout._replace(rest=rest, notes=tuple(notes)), sha256)


def _cut(lines: list[str]) -> Iterator[tuple[str, re.Match[str]]]:
    """The lines that carry a time, each with where that stands."""
    return ((line, found) for line in lines if (found := _STAMPED.match(line)))


def _log(text: str, *, timed: bool) -> _Log:
    """The lines that are not blank, parted from their times where they carry any."""
    log = _Log({}, {}, [])
    for number, line in enumerate(text.split("\n"), 1):
        found = _STAMPED.match(line) if timed else None
        if found is not None:
            log.stamps[number] = found[1]
            log.lines[number] = line[found.end() :]
        elif timed and line.strip():
            log.odd.append(number)
        elif line.strip():
            log.lines[number] = line
    if timed and log.odd and not text.endswith("\n") and log.odd[-1] > max(log.lines, default=0):
        log.lines[log.odd.pop()] = ""  # the last line, cut off
    return log


def _naming(lines: list[str]) -> tuple[re.Pattern[str], tuple[str, ...]] | None:
    """How the numbers of most lines are named, and their names; None if they are not, or are cells."""
    delimiter = delimiter_of("\n".join(lines))
    if sum(is_data(line.split(delimiter)) for line in lines) > len(lines) / 2:
        return None
    for pattern in _NAMED:
        shapes = Counter(shape for line in lines if (shape := tuple(_pairs(line, pattern))))
        shape, count = shapes.most_common(1)[0] if shapes else ((), 0)
        if count > len(lines) / 2 and (
            pattern is _NAMED[0] or all(len(ln.split(delimiter)) == 1 for ln in lines)
        ):
            return pattern, shape
    return None


def _pairs(line: str, pattern: re.Pattern[str]) -> Mapping[str, tuple[str, str]]:
    """The numbers of a line by name, each with its unit; a number before the first name is "column 1". Empty
    where no number has a name.
    """
    found: dict[str, tuple[str, str]] = {}
    if len(line) > _LONGEST:
        return found
    leading = _LEADING.match(line)
    if leading:
        found["column 1"] = (leading[1], "")
    for pair in pattern.finditer(line, leading.end() if leading else 0):
        name = pair[1].strip(" \"'")
        if name in found:
            name = f"{name} {1 + sum(other.startswith(name) for other in found)}"
        found[name] = (pair[2], pair[3] or "")
    return found if len(found) > bool(leading) else {}


def _named(log: _Log, pattern: re.Pattern[str], names: tuple[str, ...]) -> Layout:
    """The rows of lines that name their numbers."""
    rest: Rows = []
    units = [""] * len(names)
    for number, line in log.lines.items():
        pairs = _pairs(line, pattern)
        if tuple(pairs) != names:
            continue
        units = [old or unit for old, (_, unit) in zip(units, pairs.values(), strict=True)]
        rest.append((number, [cell for cell, _ in pairs.values()]))
    return _timed(Layout([*names], units if any(units) else [], rest), log)


def _cells(path: Path, log: _Log) -> Layout | None:
    """The rows of lines of cells; None if they have none."""
    lines = [*log.lines.values()]
    blank = sum(bool(_NUMBERS.fullmatch(line)) for line in lines) > len(lines) / 2
    text = [""] * max(log.lines)
    for number, line in log.lines.items():
        text[number - 1] = re.sub(r"\s+", "\t", line.strip()) if blank else line
    return _timed(layout_of_text(path, "\n".join(text)), log)


def _timed(layout: Layout, log: _Log) -> Layout:
    """Rows with their times in a first column, where they have any."""
    if not log.stamps:
        return layout
    own = any(SPELLINGS.get(plain_name(name)) == "time" for name in layout.header)
    header = numbered_columns(len(layout.header) + 1)[1:] if layout.numbered else layout.header
    rest = [(n, [log.stamps[n], *row]) for n, row in layout.rest if n in log.stamps]
    return layout._replace(
        header=["stamp" if own else "time", *header],
        units=["", *layout.units] if layout.units else [],
        rest=rest,
    )
