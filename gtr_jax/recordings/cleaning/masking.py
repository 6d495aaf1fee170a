"""Samples that are left out of a recording: glitches, cells without a number, stretches a user drops."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gtr_jax.errors import InputError, excerpt, listed
from gtr_jax.units import parse_quantity

from .glitches import find_glitches

DROPPED = "dropped"
_PLACES = 6  # that a message lists


class Masked(NamedTuple):
    """Neighbouring samples that are left out of a recording.

    Attributes:
        rows: numbers of the first and the last of their rows in the file.
        time: of both [s]; None without a time column.
        channel: the quantity they were left out for, as "T_tip" or "T_tip.left"; "" of a dropped stretch.
        kind: "glitch", "dropout" (of which a cell without a number is one) or "dropped".
        size: how far a glitch or dropout is from the line through its neighbours, in `unit`, with its sign;
            NaN where there is no number.
        unit: of the size; "" of a dropped stretch.
    """

    rows: tuple[int, int]
    time: tuple[float, float] | None
    channel: str
    kind: str
    size: float
    unit: str

    @property
    def says(self) -> str:
        """Where it is and what it is, in words."""
        at = "" if self.time is None or not math.isfinite(self.time[0]) else f" ({_seconds(self.time)})"
        if self.kind == DROPPED:
            return f"{_rows(self.rows)}{at}: dropped"
        if math.isnan(self.size):
            return f"{_rows(self.rows)}{at}: {self.channel} has no number"
        unit = "" if self.unit == "dimensionless" else f" {self.unit}"
        what = "drops out by" if self.kind == "dropout" else "jumps by"
        return f"{_rows(self.rows)}{at}: {self.channel} {what} {self.size:+.4g}{unit}"


def _rows(rows: tuple[int, int]) -> str:
    return f"row {rows[0]}" if rows[0] == rows[1] else f"rows {rows[0]} to {rows[1]}"


def _seconds(time: tuple[float, float]) -> str:
    first, last = (f"{t:.6g} s" for t in time)
    return first if first == last else f"{first} to {last}"


def masked_says(masked: Sequence[Masked]) -> str:
    """What is left out of a recording, in one sentence; "" for nothing."""
    said = []
    glitches = [m for m in masked if m.kind != DROPPED and not math.isnan(m.size)]
    absent = [m for m in masked if math.isnan(m.size) and m.kind != DROPPED]
    dropped = [m for m in masked if m.kind == DROPPED]
    if glitches:
        said.append(
            f"{_counted(glitches)} masked as glitches ({_listed(glitches)}); --keep-glitches keeps them"
        )
    if absent:
        said.append(f"{_counted(absent)} without a number left out ({_listed(absent)})")
    if dropped:
        said.append(f"{_counted(dropped)} dropped ({_listed(dropped)})")
    return "; ".join(said)


def _places(masked: Sequence[Masked]) -> list[tuple[int, int]]:
    """Rows of what is left out, those in one another's way put together."""
    found: list[tuple[int, int]] = []
    for first, last in sorted(m.rows for m in masked):
        if found and first <= found[-1][1]:
            found[-1] = (found[-1][0], max(last, found[-1][1]))
        else:
            found.append((first, last))
    return found


def _counted(masked: Sequence[Masked]) -> str:
    places = _places(masked)
    samples = sum(last - first + 1 for first, last in places)
    return f"{samples} sample{'s' * (samples != 1)} at {len(places)} place{'s' * (len(places) != 1)}"


def _listed(masked: Sequence[Masked]) -> str:
    places = _places(masked)
    texts = [str(a) if a == b else f"{a} to {b}" for a, b in places]
    return f"row{'s' * (len(places) > 1 or places[0][0] != places[0][1])} {listed(texts, _PLACES)}"


def masks(
    data: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    numbers: Sequence[int] | np.ndarray,
    *,
    glitches: bool,
    drop: Sequence[str],
) -> tuple[np.ndarray, tuple[Masked, ...]]:
    """Which samples are kept, (K,) bool, and what is left out, in the order of the rows.

    Args:
        data: columns by quantity, SI, (K,) each, NaN where a cell has no number; "time" and "trial" are no
            channels.
        units: SI unit of each column.
        numbers: row number of each sample in the file, (K,).
        glitches: whether glitches are looked for.
        drop: stretches of time to leave out, as "12.5 s:13 s".

    Raises InputError, without the place, if a stretch cannot be read or holds no sample.
    """
    time = data.get("time")
    keep = np.ones(len(next(iter(data.values()))), dtype=bool)
    found: list[Masked] = []

    def leave_out(first: int, last: int, channel: str, kind: str, size: float, unit: str) -> None:
        keep[first : last + 1] = False
        times = None if time is None else (float(time[first]), float(time[last]))
        found.append(Masked((int(numbers[first]), int(numbers[last])), times, channel, kind, size, unit))

    for text in drop:
        first, last = _stretch(text, time)
        leave_out(first, last, "", DROPPED, math.nan, "")
    channels = {name: values for name, values in data.items() if glitches or np.isnan(values).any()}
    for own in find_glitches({n: v for n, v in channels.items() if n not in ("time", "trial")}, time):
        if (glitches or math.isnan(own.size)) and keep[own.first : own.last + 1].any():
            leave_out(own.first, own.last, own.channel, own.kind, own.size, units[own.channel])
    for name in ("time", "trial"):
        for i in np.flatnonzero(np.isnan(data[name])) if name in data else ():
            leave_out(int(i), int(i), name, "dropout", math.nan, units[name])
    return keep, tuple(sorted(found, key=lambda m: (m.rows, m.channel)))


def _stretch(text: str, time: np.ndarray | None) -> tuple[int, int]:
    """Indices of the first and last sample of a stretch "FROM:TO"; either end may be left out."""
    where = f"--drop '{excerpt(text)}'"
    if time is None:
        raise InputError(
            f"{where}: needs the time of the samples; map a column with --columns 'time=NAME[s]'"
        )
    low, high = times_of(text, where)
    inside = np.flatnonzero((time >= low) & (time <= high))
    if not inside.size:
        begin, end = np.nanmin(time), np.nanmax(time)
        raise InputError(f"{where}: holds no sample; the recording goes from {begin:.6g} s to {end:.6g} s")
    return int(inside[0]), int(inside[-1])


def times_of(text: str, where: str) -> tuple[float, float]:
    """First and last time [s] of a stretch "FROM:TO"; infinite where an end is left out.

    Args:
        text: as the user wrote it, such as "12.5 s:13 s".
        where: the option, which the error names.

    Raises InputError if it cannot be read.
    """
    example = "write for example '12.5 s:13 s'"
    ends = text.split(":")
    if len(ends) != 2 or not any(end.strip() for end in ends):
        raise InputError(f"{where}: is not a stretch FROM:TO; {example}")
    low, high = (
        _time(end.strip(), other, where) for end, other in zip(ends, (-math.inf, math.inf), strict=True)
    )
    if low > high:
        raise InputError(f"{where}: ends before it begins; {example}")
    return low, high


def _time(text: str, absent: float, where: str) -> float:
    if not text:
        return absent
    bare = re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", text)
    try:
        return float(text) if bare else parse_quantity(text, "s")
    except InputError as fault:
        raise InputError(f"{where}: {fault}") from None
