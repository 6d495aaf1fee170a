"""Where a recorded channel leaves and comes back within a few samples: what may be a glitch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gtr_jax.recordings.signals.differences import from_differences

WIDEST, LONGEST = 3, 20  # samples of a glitch, and of a dropout to exactly 0
MOST = 4  # samples of a glitch with the smaller deviations beside it
NOISES, BENDS, SHARE = 6.0, 3.0, 0.006
GAP = 5.0
RARE = 0.01  # share of samples up to which dropouts of more than WIDEST samples are rare
_MEDIAN = 7  # samples to each side of an excursion that the median is of
_ROUNDING = 1e-9  # of the largest reading, by which numbers that were written as decimals may be off


class Channel(NamedTuple):
    """A channel's samples that are numbers.

    Attributes:
        x: their values, (n,).
        at: their indices among all samples, (n,).
        clocks: when they were read, in intervals: by even steps, and by the stamps; (n,) each.
        limit: what a deviation must exceed by 1. of the rule, the noise around it apart.
        noisy: whether it has noise.
    """

    x: np.ndarray
    at: np.ndarray
    clocks: tuple[np.ndarray, ...]
    limit: float
    noisy: bool


def channel(values: np.ndarray, time: np.ndarray | None) -> Channel:
    """A channel of readings, (K,), NaN where a number is missing, at times [s], (K,)."""
    at = np.flatnonzero(np.isfinite(values))
    x = values[at]
    even = at.astype(float)
    if len(x) < 5:
        return Channel(x, at, (even,), np.inf, False)
    bends = np.abs(x[2:] - 2 * x[1:-1] + x[:-2])
    bent = bends[bends > _ROUNDING * np.abs(x).max()]
    noise = from_differences(x)
    low, high = np.percentile(x, [1.0, 99.0])
    bend = float(np.median(bent)) if bent.size else 0.0
    limit = max(NOISES * noise, BENDS * bend, SHARE * float(high - low))
    return Channel(x, at, (even, *_stamped(at, time)), limit, noise > 0)


def _stamped(at: np.ndarray, time: np.ndarray | None) -> tuple[np.ndarray, ...]:
    """When samples were read by their stamps, in median intervals; nothing where there is no telling."""
    steps = np.diff(time[at]) if time is not None else np.zeros(0)
    finite = np.isfinite(steps)
    usual = float(np.median(steps[finite])) if finite.any() else 0.0
    if not usual > 0:
        return ()
    steps = np.clip(np.where(finite, steps / usual, 1.0), 1 / GAP, GAP)
    return (np.concatenate([[0.0], np.cumsum(steps)]),)


def runs(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last index of each run of true values."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1


def chord(x: np.ndarray, first: np.ndarray | int, last: np.ndarray | int, k: np.ndarray) -> np.ndarray:
    """The line through the neighbours of samples first to last, at samples k."""
    left, right = x[first - 1], x[last + 1]
    return left + (right - left) * (k - first + 1) / (last - first + 2)


def beyond(value: np.ndarray, ways: list[np.ndarray]) -> np.ndarray:
    """How far values are outside what several others span; 0 inside."""
    low, high = ways[0], ways[0]
    for way in ways[1:]:
        low, high = np.minimum(low, way), np.maximum(high, way)
    return np.maximum(np.maximum(value - high, low - value), 0.0)


def excursions(own: Channel) -> tuple[np.ndarray, np.ndarray]:
    """First and last samples of what may be a glitch, (m,) each; some may share samples, see `apart`."""
    found = [_of_width(own, width) for width in range(1, WIDEST + 1) if len(own.x) >= width + 2]
    if own.noisy:
        found.append(_at_zero(own))
    first, last = np.concatenate(found, axis=1) if found else np.zeros((2, 0), dtype=int)
    return first, last


def _of_width(own: Channel, width: int) -> np.ndarray:
    """First and last samples of excursions of so many samples, (2, m): they return to the level that they
    left, or to where the samples before lead, or the samples after come from.
    """
    x, n = own.x, len(own.x)
    left, right = x[: n - width - 1], x[width + 1 :]
    slope = (right - left) / (width + 1)
    off = np.abs(x[1 : n - width] - (left + slope))
    for j in range(2, width + 1):
        np.minimum(off, np.abs(x[j : n - width - 1 + j] - (left + j * slope)), out=off)
    a = np.flatnonzero(off > own.limit) + 1
    b, off = a + width - 1, off[a - 1]
    left, right = x[a - 1], x[b + 1]
    rise, fall = left - x[np.maximum(a - 2, 0)], right - x[np.minimum(b + 2, n - 1)]
    across, lasts = right - left, width + 1
    allowed = np.full(len(a), np.inf)
    for j in range(width):
        ways = [left, right, left + (j + 1) * rise, right + (width - j) * fall]
        np.minimum(allowed, beyond(x[a + j], ways), out=allowed)
    goes_on = np.minimum(np.abs(across - lasts * rise), np.abs(across + lasts * fall)) < 0.5 * off
    fits = (np.abs(across) < 0.5 * off) | ((allowed > own.limit) & goes_on)
    return np.stack([a[fits], b[fits]])


def _at_zero(own: Channel) -> np.ndarray:
    """First and last samples of longer stretches at exactly 0, (2, m); none where they are not rare."""
    x, n = own.x, len(own.x)
    a, b = runs(x == 0.0)
    inside = (b - a >= WIDEST) & (b - a < LONGEST) & (a > 0) & (b < n - 1)
    a, b = a[inside], b[inside]
    least = np.minimum(np.abs(x[a - 1]), np.abs(x[b + 1]))
    fits = (least > own.limit) & (np.abs(x[b + 1] - x[a - 1]) < 0.5 * least)
    a, b = a[fits], b[fits]
    return np.stack([a, b]) if np.sum(b - a + 1) <= max(RARE * n, LONGEST) else np.zeros((2, 0), dtype=int)


def apart(x: np.ndarray, first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of excursions that share a sample, or of which one is the other's neighbour, those that return to the
    level that they left and, among these, stand out farther from the median of the samples around than their
    neighbours do.
    """
    if not first.size:
        return first, last
    spread = np.arange(-_MEDIAN, _MEDIAN + 1)
    reach = np.where(spread < 0, first[:, None], last[:, None]) + spread
    middle = np.median(x[np.clip(reach, 0, len(x) - 1)], axis=1)
    far = np.min(np.abs(np.stack([x[first], x[(first + last) // 2], x[last]]) - middle), axis=0)
    far -= np.max(np.abs(np.stack([x[first - 1], x[last + 1]]) - middle), axis=0)
    level = np.abs(x[last + 1] - x[first - 1]) < 0.5 * np.abs(x[first] - chord(x, first, last, first))
    taken = np.zeros(len(x) + 2, dtype=bool)
    kept = np.zeros(len(first), dtype=bool)
    for i in np.lexsort((first, -far, ~level)).tolist():
        a, b = first[i], last[i]
        if not taken[a : b + 3].any():
            taken[a + 1 : b + 2] = True
            kept[i] = True
    first, last = first[kept], last[kept]
    order = np.argsort(first)
    return first[order], last[order]
