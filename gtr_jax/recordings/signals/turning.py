"""Where a signal turns."""

from __future__ import annotations

import numpy as np

MOST = 40_000
"""Samples beyond which the turning points are found among the extremes of blocks."""


def turning_points(T: np.ndarray, hysteresis: float) -> np.ndarray:
    """Samples at which a signal turns, and both ends; reversals smaller than `hysteresis` are ignored.

    Args:
        T: the signal, (K,), K >= 1.
        hysteresis: in the unit of the signal.
    """
    turns, low, high, rising = [0], 0, 0, 0
    values = T.tolist()
    for k in range(1, len(values)):
        value = values[k]
        low = k if value < values[low] else low
        high = k if value > values[high] else high
        if rising >= 0 and values[high] - value > hysteresis:
            turns.append(high)
            rising, low = -1, k
        elif rising <= 0 and value - values[low] > hysteresis:
            turns.append(low)
            rising, high = 1, k
        if rising > 0:
            low = k
        elif rising < 0:
            high = k
    return np.unique([*turns, len(values) - 1])


def extremes(x: np.ndarray, blocks: int) -> np.ndarray:
    """Samples of the smallest and the largest value of each of so many blocks, and both ends, increasing.

    Args:
        x: the signal, (K,).
        blocks: at most.
    """
    K = len(x)
    size = -(-K // max(blocks, 1))
    if size <= 2:
        return np.arange(K)
    whole = x[: K // size * size].reshape(-1, size)
    begins = np.arange(len(whole)) * size
    rest = K // size * size
    last = [rest + int(np.argmin(x[rest:])), rest + int(np.argmax(x[rest:]))] if rest < K else []
    found = [begins + whole.argmin(axis=1), begins + whole.argmax(axis=1)]
    return np.unique(np.concatenate([*found, np.asarray([0, *last, K - 1])]))


def turns_of_long(T: np.ndarray, hysteresis: float) -> np.ndarray:
    """`turning_points` of a signal of any length, in linear time with a small constant.

    Reversals within one block of a signal of more than MOST samples are found only at its two extremes.
    """
    among = extremes(T, MOST // 2)
    return among[turning_points(T[among], hysteresis)]
