"""Where a base tension bends: knots set where they help, moved, merged, and taken out where they do not."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gtr_jax.recordings.signals.turning import turning_points

from .base_tension import BaseTension, runs
from .smooth import smoothed

# A reversal smaller than so many standard deviations is noise.
HYSTERESIS = 5.0
# A bend must lower the sum of squares, in variances, by more than this, and by 2 ln(K/1000) more in
# recordings longer than 1000 samples: the best place of a run does so by chance in fewer than 1 of 100 runs.
BEND, SHORT = 14.0, 1000
# Rounds of setting, or taking out, knots, and of moving them: what has not settled by then gains little.
ROUNDS, REFINEMENTS = 40, 4
# Samples of each block in which needless knots are removed first, if every sample starts as a knot.
BLOCK = 400
# Number of knots above which none are taken out again: the work grows with their square.
MOST_PRUNED = 3000
# Knots between samples (`_bent_between`). A bend is sharp if it changes the step from one sample to the next
# by more than SHARP standard deviations; the BESIDE samples on either side of it may then be knots, too. All
# of them together have to lower the sum of squares by CLEARLY standard errors more than chance would, each
# that stays by PAYS variances: twice what it adds to the variance of the curve. Fewer than FEWEST tell
# nothing. Of nine recordings as rigs make them (benchmarks/blind, seed 26112781) the base tension was wrong
# by 0.43 to 1.1 standard deviations of its reading, one aside that was taken as exact, and with these knots
# by 0.39 to 0.86.
SHARP, BESIDE, CLEARLY, PAYS, FEWEST = 2.0, 2, 4.0, 2.0, 50


def _best_bend(t: np.ndarray, T: np.ndarray) -> tuple[int, float]:
    """Sample at which one bend lowers the sum of squares of a straight line most, and by how much.

    Args:
        t, T: times and values of a run, (n,), n >= 3.
    """
    t = t - t.mean()
    spread = np.sqrt(np.sum(t**2))
    ones, slope = np.full(len(t), 1 / np.sqrt(len(t))), t / spread
    residual = T - ones * (ones @ T) - slope * (slope @ T)

    def after(values):
        """Sum over the samples after each."""
        return np.append(np.cumsum(values[:0:-1])[::-1], 0.0)

    n, first, second = after(np.ones(len(t))), after(t), after(t**2)
    ramp = second - 2 * t * first + n * t**2  # sums of ((t - t_k)+)^2, and of its products below
    ramp = ramp - ((first - n * t) / np.sqrt(len(t))) ** 2 - ((second - t * first) / spread) ** 2
    moment = after(residual * t) - t * after(residual)
    inside = np.arange(1, len(t) - 1)
    gain = moment[inside] ** 2 / np.maximum(ramp[inside], 1e-12 * np.maximum(second[0], 1e-300))
    best = int(np.argmax(gain))
    return int(inside[best]), float(gain[best])


def _removable(fit: BaseTension, values: np.ndarray) -> np.ndarray:
    """By how much the sum of squares, in variances, would rise without each knot, (M,); inf at the ends."""
    M = len(values)
    bands = fit.information(np.full(len(fit.T_base), fit.sd**-2))
    inverse = cho_solve_banded((cholesky_banded(bands), False), np.eye(M))
    t = fit.t[fit.knots]
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    weights = np.stack([share - 1, np.ones(M - 2), -share])
    at = np.arange(M - 2) + np.arange(3)[:, None]
    bend = np.sum(weights * values[at], axis=0)
    variance = np.einsum("am,bm,abm->m", weights, weights, inverse[at[:, None], at[None]])
    return np.concatenate([[np.inf], bend**2 / variance, [np.inf]])


def straighten(T: np.ndarray, sd: float, time: np.ndarray | None = None) -> BaseTension:
    """Estimate the true base tension.

    Knots are set one by one in each run where they help most, then moved to where they help most between
    their neighbours, and taken out again where they no longer help.

    Args:
        T: recorded base tension [N], (K,), K >= 2.
        sd: its standard deviation [N], positive.
        time: of the samples [s], (K,); equal steps unless given and increasing.
    """
    t, threshold = _clock(T, time), _threshold(len(T))
    knots = _with_bends(t, T, turning_points(T, HYSTERESIS * sd), sd, threshold)
    for _ in range(REFINEMENTS):
        before = knots
        knots = _merged(t, T, _moved(t, T, knots), sd, threshold)
        knots = _with_bends(t, T, _without_needless(t, T, knots, sd, threshold), sd, threshold)
        if np.array_equal(knots, before):
            break
    fit = smoothed(runs(t, T, knots, None, sd), T)
    return _bent_between(fit, T) if fit.corner.all() else fit


def _bent_between(fit: BaseTension, T: np.ndarray) -> BaseTension:
    """The fit with more knots beside its sharp bends, where the readings say that the base tension bends
    between samples: a motor or a hand that turns round within a few samples. The fit unchanged where they do
    not: in a load history that is set point by point it bends at samples. The noise is taken as even: where
    it is larger at high tension, knots may be added that only follow it.
    """
    bends = np.abs(np.diff(np.diff(fit.T_base[fit.knots]) / np.diff(fit.t[fit.knots])))
    sharp = fit.knots[1:-1][bends * np.median(np.diff(fit.t)) > SHARP * fit.sd]
    beside = (sharp[:, None] + np.arange(-BESIDE, BESIDE + 1)).ravel()
    every = np.union1d(fit.knots, beside[(beside > 0) & (beside < len(T) - 1)])
    more = len(every) - len(fit.knots)
    if more < FEWEST or len(every) > min(MOST_PRUNED, len(T) - 1):
        return fit
    found = runs(fit.t, T, every, None, fit.sd)
    if fit.misfit - found.misfit < more + CLEARLY * np.sqrt(2.0 * more):
        return fit
    kept = _without_needless(fit.t, T, every, fit.sd, PAYS, fit.knots)
    return runs(fit.t, T, kept, None, fit.sd)


def _clock(T: np.ndarray, time: np.ndarray | None) -> np.ndarray:
    """Time of the samples; their number where they have none that increases."""
    numbers = np.arange(len(T), dtype=float)
    return numbers if time is None or np.any(np.diff(time) <= 0) else np.asarray(time, float)


def _threshold(K: int) -> float:
    return BEND + 2.0 * max(0.0, float(np.log(K / SHORT)))


def from_all(T: np.ndarray, sd: float, time: np.ndarray | None = None) -> BaseTension:
    """The same estimate found the other way round: every sample starts as a knot, and needless ones are taken
    out. Slower, but it finds a staircase, in which no single bend helps.
    """
    t, threshold, K = _clock(T, time), _threshold(len(T)), len(T)
    edges = np.unique(np.linspace(0, K - 1, max(2, 1 + -(-K // BLOCK))).astype(int))
    kept = [
        a + _without_needless(t[a : b + 1], T[a : b + 1], np.arange(b - a + 1), sd, threshold)
        for a, b in itertools.pairwise(edges.tolist())
    ]
    knots = _without_needless(t, T, np.unique(np.concatenate(kept)), sd, threshold)
    return runs(t, T, knots, None, sd)


def _with_bends(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float, threshold: float) -> np.ndarray:
    settled: set[tuple[int, int]] = set()
    for _ in range(ROUNDS):
        residual = (T - runs(t, T, knots, None, sd).T_base) / sd
        more = []
        for a, b in zip(knots[:-1].tolist(), knots[1:].tolist(), strict=True):
            if b - a < 2 or (a, b) in settled:
                continue
            at, gain = _best_bend(t[a : b + 1], residual[a : b + 1])
            if gain > threshold:
                more.append(a + at)
            else:
                settled.add((a, b))
        if not more:
            return knots
        knots = np.union1d(knots, more)
    return knots


def _moved(t: np.ndarray, T: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Move every second knot, and then the others, to the best bend between its neighbours."""
    knots = knots.copy()
    for first in (1, 2):
        for m in range(first, len(knots) - 1, 2):
            a, b = int(knots[m - 1]), int(knots[m + 1])
            knots[m] = a + _best_bend(t[a : b + 1], T[a : b + 1])[0]
    return knots


def _left(t: np.ndarray, T: np.ndarray, bends: list[int]) -> float:
    """Sum of squares that a line with bends at some samples leaves of a run."""
    columns = [np.ones(len(t)), t - t[0], *(np.maximum(t - t[k], 0.0) for k in bends)]
    scaled = np.stack([c / max(np.linalg.norm(c), 1e-300) for c in columns], axis=1)
    q, _ = np.linalg.qr(scaled)
    return float(np.sum((T - q @ (q.T @ T)) ** 2))


def _merged(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float, threshold: float) -> np.ndarray:
    """Merge two neighbouring knots where one knot at the best place fits as well. Otherwise a knot that
    misses a corner by one sample keeps a second knot beside it.
    """
    found = knots.tolist()
    m = 1
    while m + 2 < len(found):
        a, b = found[m - 1], found[m + 2]
        times, values = t[a : b + 1], T[a : b + 1]
        at = _best_bend(times, values)[0]
        two = _left(times, values, [found[m] - a, found[m + 1] - a])
        if _left(times, values, [at]) - two < threshold * sd**2:
            found[m : m + 2] = [a + at]
        else:
            m += 1
    return np.asarray(found)


def _without_needless(
    t: np.ndarray,
    T: np.ndarray,
    knots: np.ndarray,
    sd: float,
    threshold: float,
    needed: np.ndarray | None = None,
) -> np.ndarray:
    """The knots without those that lower the sum of squares by less than the threshold, in variances; all
    that are `needed` stay.
    """
    if len(knots) > MOST_PRUNED:
        return knots
    for _ in range(ROUNDS):
        fit = runs(t, T, knots, None, sd)
        loss = _removable(fit, fit.T_base[knots])
        if needed is not None:
            loss[np.isin(knots, needed)] = np.inf
        least = (loss < threshold) & (
            loss <= np.minimum(np.roll(loss, 1), np.roll(loss, -1))
        )  # no two neighbours
        if not least.any():
            return knots
        knots = knots[~least]
    return knots
