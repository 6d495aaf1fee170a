"""Glitches and dropouts of a recorded channel: samples that the amplifier made, not the tendon.

A tension goes where it goes through the samples between. What leaves and is back after one to WIDEST
samples, farther than anything around it moves, did not happen. Samples a..b of a channel x are a *glitch* if
all of these hold, where a sample's deviation is its distance from the line through the neighbours x[a-1] and
x[b+1], and D is the smallest deviation of a..b:

1. D is above the noise and the resolution: above NOISES standard deviations of the noise (from third
   differences of the channel, by the median), STEPS times the median step between samples that differ, and
   SHARE of the channel's range (between its 1st and 99th percentile). So the flicker of a quantised cell,
   whose steps are mostly zero, is none.
2. It returns: x[b+1] and x[a-1] differ by less than half of D. So a step is none.
3. Its samples are farther from the median of the samples around them than the neighbours are. So the one
   good sample between two glitches is none.
4. Nothing around it moves so fast: D is above the largest step between samples up to AROUND before and after
   it and above SLOPES times the second largest, glitches left out. The corner of a turning point deviates by
   one such step, so it is none, and neither is a fast pull, which takes several steps.
5. If another channel deviates at the same samples beyond its own limits of 1., both may have moved truly: D
   has to be above TOGETHER times the largest step of the whole channel, glitches left out.
6. It is isolated: of the NEARBY samples before and after it, glitches are no more than CROWDED and WIDEST
   samples. So a channel that bursts all the time has none.
7. No gap of the time stamps, GAP times the median interval, lies between its neighbours.

A glitch down to exactly 0, or to a lowest value that the channel reaches more than once, is a *dropout*. In a
channel with noise that is hardly ever exactly 0, dropouts to 0 may last up to LONGEST samples, and 5. does
not apply to them: a supply that fails takes all cells along. Samples without a number (NaN) are dropouts too.
At both ends of a channel, where a neighbour is missing, nothing is a glitch.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

WIDEST, LONGEST = 3, 20  # samples of a glitch, and of a dropout to exactly 0
NOISES, STEPS, SHARE = 10.0, 4.0, 0.01
AROUND, SLOPES = 10, 4.0
TOGETHER = 1.5
NEARBY, CROWDED = 50, 0.15
GAP = 5.0
RARE = 0.01  # share of samples at exactly 0 up to which a channel is hardly ever there
_MEDIAN = 7  # samples to each side that the median of 3. is of
_ROUNDS = 10  # of leaving out what turned out to be no glitch
_MAD_TO_SD = 1.4826 / np.sqrt(20.0)  # of third differences of white noise


class Glitch(NamedTuple):
    """Samples that did not happen.

    Attributes:
        channel: its name.
        first, last: the samples' indices, both included.
        size: the deviation that is largest, with its sign, in the channel's unit; NaN of missing numbers.
        kind: "glitch" or "dropout".
    """

    channel: str
    first: int
    last: int
    size: float
    kind: str


class _Channel(NamedTuple):
    """A channel's samples that are numbers.

    Attributes:
        x: their values, (n,).
        at: their indices among all samples, (n,).
        limit: what a deviation must exceed by 1. of the rule.
        noisy: whether it has noise and is hardly ever exactly 0.
    """

    x: np.ndarray
    at: np.ndarray
    limit: float
    noisy: bool


def find_glitches(channels: Mapping[str, np.ndarray], time: np.ndarray | None) -> list[Glitch]:
    """Glitches and dropouts by the rule above, in the order of the samples.

    Args:
        channels: readings by name, (K,) each, in any unit; NaN where a number is missing.
        time: of the samples [s], (K,), or None.
    """
    arrays = {name: np.asarray(values, dtype=float) for name, values in channels.items()}
    read = {name: _channel(values) for name, values in arrays.items()}
    found = [glitch for name, values in arrays.items() for glitch in _missing(name, values)]
    for name, channel in read.items():
        others = [(arrays[other], read[other].limit) for other in arrays if other != name]
        found += _of_channel(name, channel, others, time)
    return sorted(found, key=lambda glitch: (glitch.first, glitch.channel))


def _channel(values: np.ndarray) -> _Channel:
    at = np.flatnonzero(np.isfinite(values))
    x = values[at]
    if len(x) < 5:
        return _Channel(x, at, np.inf, False)
    steps = np.abs(np.diff(x))
    moved = steps[steps > 0]
    third = np.abs(x[3:] - 3 * x[2:-1] + 3 * x[1:-2] - x[:-3])
    noise = _MAD_TO_SD * float(np.median(third))
    low, high = np.percentile(x, [1.0, 99.0])
    step = float(np.median(moved)) if moved.size else 0.0
    limit = max(NOISES * noise, STEPS * step, SHARE * float(high - low))
    return _Channel(x, at, limit, noise > 0 and bool(np.mean(x == 0.0) <= RARE))


def _missing(name: str, values: np.ndarray) -> list[Glitch]:
    first, last = _runs(~np.isfinite(values))
    return [Glitch(name, int(a), int(b), float("nan"), "dropout") for a, b in zip(first, last, strict=True)]


def _runs(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last index of each run of true values."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1


def _of_channel(
    name: str, channel: _Channel, others: list[tuple[np.ndarray, float]], time: np.ndarray | None
) -> list[Glitch]:
    x, at = channel.x, channel.at
    first, last = _excursions(channel)
    if time is not None and first.size:
        first, last = _without_gaps(first, last, at, np.asarray(time, dtype=float))
    if not first.size:
        return []
    zero = (x[first] == 0.0) & (x[last] == 0.0) & channel.noisy
    deviation = _smallest(x, first, last)
    shared = np.zeros(len(first), dtype=bool)
    for values, limit in others:
        shared |= _moves(values, at[first], at[last], at[first - 1], at[last + 1]) > limit
    kept = np.ones(len(first), dtype=bool)
    for _ in range(_ROUNDS):
        sound = _allowed(x, first, last, kept, deviation, shared & ~zero)
        sound &= ~_crowded(first, last, kept & sound, len(x))
        if np.array_equal(sound & kept, kept):
            break
        kept &= sound
    first, last = first[kept], last[kept]
    lowest = x.min()
    again = np.count_nonzero(x == lowest) > 1
    found = []
    for a, b in zip(first, last, strict=True):
        off = x[a : b + 1] - _line(x, a, b, np.arange(a, b + 1))
        down = np.all(x[a : b + 1] == 0.0) or (again and np.all(x[a : b + 1] == lowest))
        size = float(off[np.argmax(np.abs(off))])
        kind = "dropout" if down and abs(x[a - 1]) > abs(x[a]) else "glitch"
        found.append(Glitch(name, int(at[a]), int(at[b]), size, kind))
    return found


def _line(x: np.ndarray, first: np.ndarray, last: np.ndarray, k: np.ndarray) -> np.ndarray:
    """The line through the neighbours of samples first..last, at samples k."""
    left, right = x[first - 1], x[last + 1]
    return left + (right - left) * (k - first + 1) / (last - first + 2)


def _smallest(x: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """The smallest deviation of each excursion."""
    smallest = np.full(len(first), np.inf)
    for offset in range(int(np.max(last - first, initial=-1)) + 1):
        k = np.minimum(first + offset, last)
        np.minimum(smallest, np.abs(x[k] - _line(x, first, last, k)), out=smallest)
    return smallest


def _excursions(channel: _Channel) -> tuple[np.ndarray, np.ndarray]:
    """First and last samples of what fulfils 1. to 3. of the rule; none shares a sample with another."""
    x = channel.x
    n = len(x)
    found = [np.zeros((2, 0), dtype=int)]
    for width in range(1, WIDEST + 1):
        if n < width + 2:
            break
        left, right = x[: n - width - 1], x[width + 1 :]
        slope = (right - left) / (width + 1)
        least = np.abs(x[1 : n - width] - (left + slope))
        for j in range(1, width):
            np.minimum(least, np.abs(x[1 + j : n - width + j] - (left + (j + 1) * slope)), out=least)
        a = np.flatnonzero((least > channel.limit) & (np.abs(right - left) < 0.5 * least)) + 1
        found.append(np.stack([a, a + width - 1]))
    if channel.noisy:
        a, b = _runs(x == 0.0)
        fits = (b - a >= WIDEST) & (b - a < LONGEST) & (a > 0) & (b < n - 1)
        a, b = a[fits], b[fits]
        least = np.minimum(np.abs(x[a - 1]), np.abs(x[b + 1]))
        fits = (least > channel.limit) & (np.abs(x[b + 1] - x[a - 1]) < 0.5 * least)
        found.append(np.stack([a[fits], b[fits]]))
    first, last = np.concatenate(found, axis=1)
    if not first.size:
        return first, last
    order = np.lexsort((last, first))
    first, last = first[order], last[order]
    # The median around each, and how far its samples and its neighbours are from it.
    spread = np.arange(-_MEDIAN, _MEDIAN + 1)
    reach = np.where(spread[None, :] < 0, first[:, None], last[:, None]) + spread[None, :]
    middle = np.median(x[np.clip(reach, 0, n - 1)], axis=1)
    far = np.min(np.abs(np.stack([x[first], x[(first + last) // 2], x[last]]) - middle), axis=0)
    near = np.max(np.abs(np.stack([x[first - 1], x[last + 1]]) - middle), axis=0)
    first, last, far = first[far > near], last[far > near], (far - near)[far > near]
    # Of those that share a sample, or of which one is the other's neighbour, the one farther off.
    keep = np.ones(len(first), dtype=bool)
    for i in np.flatnonzero(first[1:] <= last[:-1]):
        keep[i if far[i] < far[i + 1] else i + 1] = False
    return first[keep], last[keep]


def _without_gaps(
    first: np.ndarray, last: np.ndarray, at: np.ndarray, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Those of which no gap of the time stamps cuts off a neighbour."""
    intervals = np.diff(time)
    usual = np.nanmedian(intervals) if np.any(np.isfinite(intervals)) else np.nan
    steps = (at[last + 1] - at[first - 1]).astype(float)
    whole = ~(time[at[last + 1]] - time[at[first - 1]] > (GAP - 1 + steps) * usual)
    return first[whole], last[whole]


def _moves(
    values: np.ndarray, first: np.ndarray, last: np.ndarray, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """The largest deviation of another channel at the same samples; 0 where it has no numbers."""
    largest = np.zeros(len(first))
    middle = 0.5 * (values[before] + values[after])
    half = 0.5 * np.abs(values[before] - values[after])
    for offset in range(int(np.max(last - first, initial=-1)) + 1):
        off = np.abs(values[np.minimum(first + offset, last)] - middle) - half
        np.fmax(largest, off, out=largest)
    return largest


def _allowed(
    x: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    kept: np.ndarray,
    deviation: np.ndarray,
    shared: np.ndarray,
) -> np.ndarray:
    """Whether 4. and 5. of the rule hold, with the excursions that are kept left out."""
    out = np.zeros(len(x) + 1, dtype=np.int64)
    np.add.at(out, first[kept], 1)
    np.add.at(out, last[kept] + 1, -1)
    good = np.flatnonzero(np.cumsum(out[:-1]) == 0)
    steps = np.abs(np.diff(x[good]))
    if not steps.size:
        return np.zeros(len(first), dtype=bool)
    # Steps around the place of each excursion among the good samples; that across it is one of them.
    place = np.searchsorted(good, first) - 1
    around = place[:, None] + np.arange(-AROUND, AROUND + 1)[None, :]
    near = np.where((around >= 0) & (around < len(steps)), steps[np.clip(around, 0, len(steps) - 1)], 0.0)
    second, largest = np.partition(near, (-2, -1), axis=1)[:, -2:].T
    return (
        (deviation > largest)
        & (deviation > SLOPES * second)
        & (~shared | (deviation > TOGETHER * steps.max()))
    )


def _crowded(first: np.ndarray, last: np.ndarray, kept: np.ndarray, n: int) -> np.ndarray:
    """Whether more than CROWDED of the samples around each excursion lie in those that are kept."""
    ends = np.concatenate([[0], np.cumsum((last - first + 1) * kept)])
    low, high = np.maximum(first - NEARBY, 0), np.minimum(last + NEARBY, n - 1)
    inside = ends[np.searchsorted(first, high, side="right")] - ends[np.searchsorted(last, low, side="left")]
    return inside > CROWDED * (high - low + 1) + WIDEST
