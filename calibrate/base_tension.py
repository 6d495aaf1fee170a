"""The true base tension behind a noisy one: straight runs between knots, as few as the noise allows.

A tendon with friction remembers extremes, so noise in the base tension does not average out: taken as exact,
every noisy peak ratchets the simulated tip tension up, and friction with it. The true base tension is
therefore an unknown of the fit. Actuators ramp and hold: between knots it is straight in time, and a knot is
set wherever the recording contradicts that beyond its noise, first of all at every turning point. Nothing is
smoothed across a knot; a coarse staircase whose readings do not lie on straight runs keeps every reading.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from .noise import FEWEST_DEGREES, correlation_time, from_differences, resolution

# A reversal smaller than so many standard deviations is noise.
HYSTERESIS = 5.0
# A bend must lower the sum of squares, in variances, by more than this, and by 2 ln(K/1000) more in
# recordings longer than 1000 samples: the best place of a run does so by chance in fewer than 1 of 100 runs.
BEND, SHORT = 14.0, 1000
ROUNDS, REFINEMENTS = 40, 4
# Noise above this share of the range is no noise of a load cell, but readings that jump about.
LARGEST_NOISE = 0.02
PASSES, SETTLED = 4, 0.05
# A lone spike is so many standard deviations off all that its neighbours say, and so many times as far as
# they differ among each other.
SPIKE, SPIKE_APART = 10.0, 3.0
MOST_PRUNED = 3000  # knots beyond which none is taken out again


@dataclasses.dataclass(frozen=True, eq=False)
class BaseTension:
    """A base tension of K samples, straight between knots.

    Attributes:
        t: time of the samples, in any unit, (K,).
        T_base: estimate of the true base tension [N], (K,).
        knots: samples at which it may bend, increasing, first 0 and last K-1, (M,).
        run: index of the knot before each sample, (K,), at most M-2.
        share: how far on the way to the next knot each sample lies, (K,), in [0, 1].
        sd: standard deviation of the recorded base tension [N].
        misfit: sum of squares of what the recording is off, in units of `sd`.
        tau: samples per independent one of what it is off.
    """

    t: np.ndarray
    T_base: np.ndarray
    knots: np.ndarray
    run: np.ndarray
    share: np.ndarray
    sd: float
    misfit: float
    tau: float = 1.0

    @property
    def believed(self) -> float:
        """Standard deviation [N] that one sample counts with, its neighbours being as wrong."""
        return self.sd * float(np.sqrt(self.tau))

    @property
    def degrees(self) -> int:
        """Degrees of freedom of `misfit`."""
        return len(self.T_base) - len(self.knots)

    def at_samples(self, values: np.ndarray) -> np.ndarray:
        """From values at the knots, (M, ...), to the samples, (K, ...)."""
        share = self.share.reshape(-1, *[1] * (np.ndim(values) - 1))
        return (1 - share) * values[self.run] + share * values[self.run + 1]

    def to_knots(self, values: np.ndarray, samples: np.ndarray | None = None) -> np.ndarray:
        """The transpose of `at_samples`: sums of values at samples, (S, ...), weighted by their shares, (M,
        ...).

        Args:
            values: at the samples.
            samples: which they are, (S,); all unless given. One may stand several times.
        """
        run, share = (a if samples is None else a[samples] for a in (self.run, self.share))
        share = share.reshape(-1, *[1] * (np.ndim(values) - 1))
        out = np.zeros((len(self.knots), *values.shape[1:]))
        np.add.at(out, run, (1 - share) * values)
        np.add.at(out, run + 1, share * values)
        return out

    def nodes(self, spacing: float) -> np.ndarray:
        """Samples that carry the history: all knots, and between them as many as keep the base tension from
        changing by more than `spacing` [N] from one to the next, (J,), increasing.
        """
        values = self.T_base[self.knots]
        chosen = [self.knots]
        for a, b, change in zip(self.knots[:-1], self.knots[1:], np.abs(np.diff(values)), strict=True):
            count = min(int(np.ceil(change / spacing)), b - a)
            chosen.append(np.round(np.linspace(a, b, count + 1)).astype(int))
        return np.unique(np.concatenate(chosen))

    def information(self, weight: np.ndarray, samples: np.ndarray | None = None) -> np.ndarray:
        """Sum of weighted outer products of the shares: a symmetric tridiagonal matrix of the knots, its
        upper band over its diagonal, (2, M).
        """
        run, share = (a if samples is None else a[samples] for a in (self.run, self.share))
        bands = np.zeros((2, len(self.knots)))
        np.add.at(bands[1], run, weight * (1 - share) ** 2)
        np.add.at(bands[1], run + 1, weight * share**2)
        np.add.at(bands[0], run + 1, weight * share * (1 - share))
        return bands


def turning_points(T: np.ndarray, hysteresis: float) -> np.ndarray:
    """Samples at which a signal turns, with those at both ends; reversals smaller than `hysteresis` are none.

    Args:
        T: the signal, (K,), K >= 1.
        hysteresis: in the unit of the signal.
    """
    turns, low, high, rising = [0], 0, 0, 0
    for k in range(1, len(T)):
        low = k if T[k] < T[low] else low
        high = k if T[k] > T[high] else high
        if rising >= 0 and T[high] - T[k] > hysteresis:
            turns.append(high)
            rising, low = -1, k
        elif rising <= 0 and T[k] - T[low] > hysteresis:
            turns.append(low)
            rising, high = 1, k
        if rising > 0:
            low = k
        elif rising < 0:
            high = k
    return np.unique([*turns, len(T) - 1])


def _straight_runs(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float) -> BaseTension:
    """Least squares with given knots."""
    run = np.clip(np.searchsorted(knots, np.arange(len(T)), side="right") - 1, 0, len(knots) - 2)
    start, end = t[knots[run]], t[knots[run + 1]]
    fit = BaseTension(t, T, knots, run, (t - start) / (end - start), sd, 0.0)
    bands = fit.information(np.ones(len(T)))
    values = cho_solve_banded((cholesky_banded(bands), False), fit.to_knots(T))
    smooth = fit.at_samples(values)
    return dataclasses.replace(fit, T_base=smooth, misfit=float(np.sum(((T - smooth) / sd) ** 2)))


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
    steps = np.arange(len(T), dtype=float)
    t = steps if time is None or np.any(np.diff(time) <= 0) else np.asarray(time, float)
    knots = _with_bends(t, T, turning_points(T, HYSTERESIS * sd), sd)
    for _ in range(REFINEMENTS):
        before = knots
        knots = _without_needless(t, T, _merged(t, T, _moved(t, T, knots), sd), sd)
        knots = _with_bends(t, T, knots, sd)
        if np.array_equal(knots, before):
            break
    return _straight_runs(t, T, knots, sd)


def _threshold(K: int) -> float:
    return BEND + 2.0 * max(0.0, float(np.log(K / SHORT)))


def _with_bends(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float) -> np.ndarray:
    settled: set[tuple[int, int]] = set()
    for _ in range(ROUNDS):
        residual = (T - _straight_runs(t, T, knots, sd).T_base) / sd
        more = []
        for a, b in zip(knots[:-1].tolist(), knots[1:].tolist(), strict=True):
            if b - a < 2 or (a, b) in settled:
                continue
            at, gain = _best_bend(t[a : b + 1], residual[a : b + 1])
            if gain > _threshold(len(T)):
                more.append(a + at)
            else:
                settled.add((a, b))
        if not more:
            return knots
        knots = np.union1d(knots, more)
    return knots


def _moved(t: np.ndarray, T: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Every second knot, and then the others, put where it bends best between its neighbours."""
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


def _merged(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float) -> np.ndarray:
    """Two neighbouring knots made one where one, put where it is best, does as well: a corner missed by a
    sample is otherwise held by a second knot beside it.
    """
    found = knots.tolist()
    m = 1
    while m + 2 < len(found):
        a, b = found[m - 1], found[m + 2]
        times, values = t[a : b + 1], T[a : b + 1]
        at = _best_bend(times, values)[0]
        two = _left(times, values, [found[m] - a, found[m + 1] - a])
        if _left(times, values, [at]) - two < _threshold(len(T)) * sd**2:
            found[m : m + 2] = [a + at]
        else:
            m += 1
    return np.asarray(found)


def _without_needless(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float) -> np.ndarray:
    if len(knots) > MOST_PRUNED:
        return knots
    for _ in range(ROUNDS):
        fit = _straight_runs(t, T, knots, sd)
        loss = _removable(fit, fit.T_base[knots])
        least = (loss < _threshold(len(T))) & (
            loss <= np.minimum(np.roll(loss, 1), np.roll(loss, -1))
        )  # no two neighbours
        if not least.any():
            return knots
        knots = knots[~least]
    return knots


def without_spikes(T: np.ndarray) -> tuple[np.ndarray, int]:
    """A base tension without lone spikes, and how many there were.

    A spike is a sample far from where the two before it point to, from where the two after it point to, and
    from between its neighbours; where a tension turns, one side points at the turn. Spikes are put between
    their neighbours.
    """
    sd = from_differences(T)
    if not sd or len(T) < 5:
        return T, 0
    k = np.arange(2, len(T) - 2)
    forward, backward = 2 * T[k - 1] - T[k - 2], 2 * T[k + 1] - T[k + 2]
    between = 0.5 * (T[k - 1] + T[k + 1])
    off = np.stack([T[k] - forward, T[k] - backward, T[k] - between])
    apart = np.max(np.abs(np.stack([forward, backward]) - between), axis=0)
    far = np.min(np.abs(off), axis=0)
    lone = k[(far > SPIKE * sd) & (far > SPIKE_APART * apart) & (np.abs(np.sum(np.sign(off), axis=0)) == 3)]
    clean = np.array(T)
    clean[lone] = 0.5 * (T[lone - 1] + T[lone + 1])
    return clean, len(lone)


def exact(T: np.ndarray) -> BaseTension:
    """The base tension taken as recorded."""
    K = len(T)
    at = np.arange(K)
    return BaseTension(
        at.astype(float), T, at, np.minimum(at, K - 2), np.where(at == K - 1, 1.0, 0.0), 0.0, 0.0
    )


def estimate(T: np.ndarray, time: np.ndarray | None = None, sd: float | None = None) -> BaseTension:
    """The true base tension behind a recorded one.

    Args:
        T: recorded base tension [N], (K,), K >= 2.
        time: of the samples [s], (K,), or None.
        sd: its standard deviation [N]; 0 takes it as exact; unless given it is estimated, first from
            differences of neighbours, then from what the straight runs leave. Where readings jump about so
            that noise cannot be told from them, they are taken as exact.
    """
    if sd == 0:
        return exact(T)
    if sd is not None:
        return _with_correlation(straighten(T, sd, time), T)
    floor = resolution(T) / np.sqrt(12.0)
    found = from_differences(T) or 0.0
    for _ in range(PASSES):
        if not 0 < found <= LARGEST_NOISE * np.ptp(T):
            return exact(T)
        fit = straighten(T, found, time)
        if fit.degrees < FEWEST_DEGREES:
            return _with_correlation(fit, T)
        before, found = found, max(found * np.sqrt(fit.misfit / fit.degrees), floor)
        if abs(found / before - 1) < SETTLED:
            break
    return _with_correlation(dataclasses.replace(fit, sd=found, misfit=fit.misfit * (before / found) ** 2), T)


def _with_correlation(fit: BaseTension, T: np.ndarray) -> BaseTension:
    return dataclasses.replace(fit, tau=correlation_time(T - fit.T_base))
