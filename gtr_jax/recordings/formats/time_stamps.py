"""Time stamps of text: ISO 8601, another date with a time, or hours:minutes:seconds, which may pass
midnight.

Not read by pandas: importing it takes as long as tens of thousands of stamps do here
(benchmarks/results/reading.md), it dates a time of day today, and what is a stamp would still be told here.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable
from datetime import UTC, datetime, timedelta

import numpy as np

from gtr_jax.errors import InputError

STAMP = re.compile(r"(\d{4}-\d\d-\d\d)(?:[T ](\d\d:\d\d)(?:(:\d\d)(?:[.,](\d+))?)?\s*(Z|[+-]\d\d:?\d\d)?)?")
_HALF = r"(?:\s*([AaPp])\.?[Mm]\.?)?"  # of the day
CLOCK = re.compile(rf"(\d{{1,2}}):(\d\d):(\d\d)(?:[.,](\d+))?{_HALF}")
# Dates as loggers write them: 2026/01/31, 31.01.2026, 01/31/2026, 31-Jan-2026, each with a time or without.
DATED = re.compile(
    r"(?:(\d{4})([/.-])(\d\d?)\2(\d\d?)|(\d\d?)([/.-])(\d\d?)\6(\d{4})|(\d\d?)[ -]([A-Za-z]{3})[ -](\d{4}))"
    rf"(?:[T ]\s*(\d\d?):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?{_HALF})?"
)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_YEARS = 290  # from 1970 that nanoseconds of 64 bits reach
SECOND = 10**9  # in the nanoseconds that time stamps are counted in
_LAST_MONTH, _NOON = 12, 12
_DAY = 24 * 3600 * SECOND


def is_stamp(cell: str) -> bool:
    """Whether a cell is a time stamp."""
    cell = cell.strip()
    return bool(STAMP.fullmatch(cell) or CLOCK.fullmatch(cell) or DATED.fullmatch(cell))


def stamp_reader(cells: Iterable[str]) -> Callable[[str], int | None]:
    """What turns the time stamps of a column into nanoseconds; of what is no such stamp, it makes None.

    Args:
        cells: of the column, without blanks around them; equal ones may be left out.

    Raises InputError, without the place, if the day and the month of its dates cannot be told apart.
    """
    cells = list(cells)
    if any(CLOCK.fullmatch(cell) for cell in cells):
        return since_midnight
    if not any(DATED.fullmatch(cell) and not STAMP.fullmatch(cell) for cell in cells):
        return since_1970
    return functools.partial(since_1970, day_first=_day_first(cells))


def _day_first(cells: Iterable[str]) -> bool:
    """Whether the dates of a column, 31/01/2026 or 01/31/2026, begin with the day: where neither number is
    above 12, points and the halves of the day tell.
    """
    doubtful: dict[tuple[str, str], str] = {}
    for cell in cells:
        dated = DATED.fullmatch(cell)
        if dated is None or dated[5] is None:
            continue
        first, mark, second = dated.group(5, 6, 7)
        if int(first) > _LAST_MONTH or mark == ".":
            return True
        if int(second) > _LAST_MONTH or dated[16]:
            return False
        doubtful.setdefault((first, second), cell)
    if len(doubtful) > 1:
        cell = next(iter(doubtful.values()))
        raise InputError(
            f"'{cell}' may begin with the day or with the month; write dates as 2026-01-31, or seconds"
        )
    return True


def past_midnight(values: np.ndarray, bad: np.ndarray, cells: Iterable[str]) -> np.ndarray:
    """Time stamps, (K,), each in nanoseconds; those of the time of day go on where a day ends.

    Args:
        values: in nanoseconds.
        bad: where there is none, (K,).
        cells: as of `stamp_reader`.
    """
    if not any(CLOCK.fullmatch(cell) for cell in cells):
        return values
    good = np.flatnonzero(~bad)
    days = np.cumsum(np.diff(values[good]) < -_DAY // 2)
    out = values.copy()
    out[good[1:]] += days * _DAY
    return out


def _hours(hours: int, half: str | None) -> int | None:
    """Hours of the day of 24; None where there is no such hour."""
    if half is None:
        return hours
    if not 1 <= hours <= _NOON:
        return None
    return hours % _NOON + (_NOON if half.lower() == "p" else 0)


def since_midnight(cell: str) -> int | None:
    """Nanoseconds that hours:minutes:seconds stand for; None for what is no such time."""
    clock = CLOCK.fullmatch(cell)
    if clock is None:
        return None
    hours, minutes, seconds = map(int, clock.groups()[:3])
    hours = _hours(hours, clock[5])
    if hours is None:
        return None
    return (3600 * hours + 60 * minutes + seconds) * SECOND + nanoseconds_of(clock[4])


def since_1970(cell: str, *, day_first: bool = True) -> int | None:
    """Nanoseconds from 1970 to a time stamp, in UTC unless it says otherwise; None for what is none.

    Args:
        cell: the stamp.
        day_first: whether 01/02/2026 is the first of February.
    """
    stamp, dated = STAMP.fullmatch(cell), DATED.fullmatch(cell)
    if stamp is not None:
        date, minute, second, fraction, zone = stamp.groups()
        text = f"{date}T{minute or '00:00'}{second or ':00'}{zone or 'Z'}"
    elif dated is not None:
        year = dated[1] or dated[8] or dated[11]
        first, second = (dated[5], dated[7]) if day_first else (dated[7], dated[5])
        month = dated[3] or second or str((*_MONTHS, dated[10].lower()).index(dated[10].lower()) + 1)
        day = dated[4] or first or dated[9]
        hours, fraction = _hours(int(dated[12] or 0), dated[16]), dated[15]
        if hours is None:
            return None
        text = f"{year}-{int(month):02d}-{int(day):02d}T{hours:02d}:{dated[13] or '00'}:{dated[14] or '00'}Z"
    else:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    if abs(moment.year - 1970) > _YEARS:
        return None
    return (moment - _EPOCH) // timedelta(seconds=1) * SECOND + nanoseconds_of(fraction)


def nanoseconds_of(fraction: str | None) -> int:
    """Decimals of a second in nanoseconds; more than nine are cut off."""
    return int((fraction or "")[:9].ljust(9, "0"))
