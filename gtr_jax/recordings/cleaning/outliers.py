"""What the sound samples around an excursion allow, and how far the excursion is outside of it."""

from __future__ import annotations

import numpy as np

from gtr_jax.recordings.signals.differences import MAD_TO_SD, third_differences

from .excursions import MOST, WIDEST, Channel, beyond

LOCAL, LOCALLY = 25, 5.0
AROUND, JERKS = 10, 2.0
BESIDE, SLOPES = 3, 0.25
TOGETHER = 1.5


def outliers(
    own: Channel, first: np.ndarray, last: np.ndarray, kept: np.ndarray, shared: np.ndarray, ease: float = 1.0
) -> np.ndarray:
    """Whether 1. to 4. of the rule of `glitches` hold for excursions, (m,) bool.

    Args:
        own: their channel.
        first, last: their samples, (m,).
        kept: which of them are taken for glitches, (m,) bool; all other samples are sound.
        shared: whether another channel may have moved with them, (m,) bool.
        ease: share of the limits of 1. that is enough.
    """
    x, n = own.x, len(own.x)
    edges = np.zeros(n + 1, dtype=np.int64)
    np.add.at(edges, first[kept], 1)
    np.add.at(edges, last[kept] + 1, -1)
    sound = np.flatnonzero(np.cumsum(edges[:-1]) == 0)
    if len(sound) < 2 * AROUND:
        return np.zeros(len(first), dtype=bool)
    # The two sound samples before each excursion and the two after it; at an end, one of them twice.
    after, before = np.searchsorted(sound, last, side="right"), np.searchsorted(sound, first) - 1
    inside = (before >= 0) & (after < len(sound))
    before, after = np.maximum(before, 0), np.minimum(after, len(sound) - 1)
    left = sound[before], sound[np.maximum(before - 1, 0)]
    right = sound[after], sound[np.minimum(after + 1, len(sound) - 1)]
    off = _outside(own, first, last, left, right)
    returns = _returns(own, first, last, left, right)
    # How far sound samples around are outside of what their own neighbours allow.
    k = np.clip(before[:, None] + np.arange(-AROUND, AROUND + 2), 2, len(sound) - 3)
    sides = (sound[k - 1], sound[k - 2]), (sound[k + 1], sound[k + 2])
    jerk = beyond(x[sound[k]], _ways(own, sound[k], *sides)).max(axis=1)
    steps = np.abs(np.diff(x[sound]))
    k = np.clip(before[:, None] + np.arange(-BESIDE, BESIDE + 1), 0, len(steps) - 1)
    fastest = steps[k].max(axis=1)
    third = np.abs(third_differences(x[sound]))
    k = np.clip(before[:, None] + np.arange(-LOCAL, LOCAL + 1) - 1, 0, len(third) - 1)
    noise = MAD_TO_SD * np.median(third[k], axis=1)
    return (
        inside
        & returns
        & (off > ease * own.limit)
        & (off > ease * LOCALLY * noise)
        & (off > JERKS * jerk)
        & (off > SLOPES * fastest)
        & (~shared | (off > TOGETHER * steps.max()))
    )


Pair = tuple[np.ndarray, np.ndarray]  # samples next to an excursion, and those one farther


def _line(x: np.ndarray, clock: np.ndarray, pair: Pair, k: np.ndarray) -> np.ndarray:
    """The line through both samples of a pair, at samples k; level where both are the same."""
    near, far = pair
    apart = np.where(near == far, 1.0, clock[near] - clock[far])
    return x[near] + (x[near] - x[far]) * (clock[k] - clock[near]) / apart


def _ways(own: Channel, k: np.ndarray, *sides: Pair) -> list[np.ndarray]:
    """Where samples k may be: at the level of the nearest sound sample of each side, or on a line through two
    of them.
    """
    found = [own.x[near] for near, _ in sides]
    return found + [_line(own.x, clock, side, k) for clock in own.clocks for side in sides]


def _outside(own: Channel, first: np.ndarray, last: np.ndarray, left: Pair, right: Pair) -> np.ndarray:
    """The smallest distance of an excursion's samples from what is allowed; of a long one at exactly 0 that
    of its first sample from what is allowed from before, and of its last from after.
    """
    x = own.x
    off = np.full(len(first), np.inf)
    for offset in range(MOST):
        k = np.minimum(first + offset, last)
        np.minimum(off, beyond(x[k], _ways(own, k, left, right)), out=off)
    ends = np.minimum(beyond(x[first], _ways(own, first, left)), beyond(x[last], _ways(own, last, right)))
    long = (last - first >= WIDEST) & (x[first] == 0.0) & (x[last] == 0.0)
    return np.where(long, ends, off)


def _returns(own: Channel, first: np.ndarray, last: np.ndarray, left: Pair, right: Pair) -> np.ndarray:
    """Whether excursions return to the level that they left, or to where the two samples before lead, or the
    two after come from: to less than half of their distance from the line through their neighbours.
    """
    x, even = own.x, own.clocks[0]
    ends = left[0], right[0]
    off = np.full(len(first), np.inf)
    for offset in range(MOST):
        k = np.minimum(first + offset, last)
        np.minimum(off, np.abs(x[k] - _line(x, even, ends, k)), out=off)
    missed = [np.abs(x[ends[1]] - x[ends[0]])]
    for clock in own.clocks:
        missed += [np.abs(x[ends[1]] - _line(x, clock, left, ends[1]))]
        missed += [np.abs(x[ends[0]] - _line(x, clock, right, ends[0]))]
    return np.min(missed, axis=0) < 0.5 * off
