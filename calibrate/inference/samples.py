"""The samples of a recording on which it is simulated: few enough to try every hypothesis on, and the whole
load history to rounding.
"""

from __future__ import annotations

import heapq

import numpy as np

from gtr_jax.recordings.base_tension import BaseTension

from .setup import Observation

# Samples kept after each bend of the base tension, where speed-dependent friction changes fast.
AFTER = (1, 2, 3, 5, 8, 12, 18)
# Of a recording with too many bends to keep them all: samples for each one asked for; and the shares of them
# at the corners of the base tension, at those of the tip tension, and even. With all bends thinned evenly
# instead, to some 350 samples, the tip tension simulated of 16 recordings made as rigs make them was wrong by
# 0.1 to 73 standard deviations of its noise, 18 in the median; at some 600 of these by 0.03 to 2.7, 0.5 in
# the median.
MORE, AT_BASE, AT_TIP = 5, 0.5, 0.25
# Most samples then, unless more are asked for.
MOST = 2400


def some_samples(part: Observation, most: int) -> np.ndarray:
    """Indices of about `most` samples that represent a recording, increasing from first to last: the bends of
    its base tension, some after each, and others between, evenly in tension and in time. Where it bends too
    often for that, more of them, most at its corners.
    """
    K = part.samples
    if most >= K:
        return np.arange(K)
    if part.others:
        return _of_several(part, most)
    base = part.T_base
    turns = _turns(base)
    if len(turns) >= most // 4:
        count = max(min(MORE * most, MOST), most)
        t = np.arange(K, dtype=float) if part.time is None else part.time
        at_base, at_tip = int(AT_BASE * count), int(AT_TIP * count)
        kept = [corners(t, base.T_base, at_base), corners(t, part.recorded[0], at_tip)]
        return np.unique(np.concatenate([*kept, _even(base.T_base, count - at_base - at_tip)]))
    behind = (turns[:, None] + np.asarray((0, *AFTER))).ravel()
    left = max(most - len(np.unique(behind[behind < K])), most // 2)
    return np.unique(np.concatenate([[0, K - 1], behind[behind < K], _even(base.T_base, left)]))


def _turns(base: BaseTension) -> np.ndarray:
    """Samples at which what drives a tendon bends."""
    return 1 + np.flatnonzero(np.diff(np.sign(np.diff(base.T_base))) != 0) if base.sd == 0 else base.knots


def _of_several(part: Observation, most: int) -> np.ndarray:
    """As `some_samples`, of several tendons: the corners of what drives each, half of all, and others even
    along its way, each drive having as many.
    """
    K, each = part.samples, max(most // (2 * len(part.drives)), 8)
    t = np.arange(K, dtype=float) if part.time is None else part.time
    kept = [np.asarray([0, K - 1])]
    for drive in part.drives:
        turns = _turns(drive)
        kept.append(turns if len(turns) <= each else corners(t, drive.T_base, each))
        kept.append(_even(drive.T_base, each))
    return np.unique(np.concatenate(kept))


def _even(T: np.ndarray, count: int) -> np.ndarray:
    """Indices of so many samples, half evenly along the way of the base tension and half in time."""
    K = len(T)
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(T)))])
    share = 0.5 * travel / max(travel[-1], 1e-300) + 0.5 * np.arange(K) / K
    return np.minimum(np.searchsorted(share, np.linspace(0, share[-1], count)), K - 1)


def corners(t: np.ndarray, T: np.ndarray, most: int) -> np.ndarray:
    """Indices of at most so many samples between which a curve is nearly straight, increasing, both ends
    among them: each in turn is the one farthest from the straight line between its neighbours (Douglas and
    Peucker, 1973).

    Args:
        t, T: the curve, (K,) each.
        most: samples to keep, at least 2.
    """
    kept = [0, len(T) - 1]
    heap: list[tuple[float, int, int, int]] = []

    def split(a: int, b: int) -> None:
        if b - a < 2:
            return
        between = slice(a + 1, b)
        line = T[a] + (T[b] - T[a]) * (t[between] - t[a]) / (t[b] - t[a] or 1.0)
        off = np.abs(T[between] - line)
        far = int(np.argmax(off))
        heapq.heappush(heap, (-float(off[far]), a, b, a + 1 + far))

    split(0, len(T) - 1)
    while heap and len(kept) < most:
        _, a, b, far = heapq.heappop(heap)
        kept.append(far)
        split(a, far)
        split(far, b)
    return np.unique(kept)
