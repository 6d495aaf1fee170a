"""The true base tension behind a noisy one: straight runs, or smooth curves, with as few knots as the noise
allows.

A tendon with friction remembers extremes, so noise in the base tension does not average out: taken as exact,
every noisy peak ratchets the simulated tip tension up, and friction with it. The true base tension is
therefore an unknown of the fit. Actuators ramp, hold and swing: between corners it is straight in time, or
a cubic spline where it bends on and on in one sense. A knot is set wherever the recording contradicts that
beyond its noise, first of all at every turning point; nothing is smoothed across a corner. What is left must
not be followed by the tip, which follows true changes and no noise: else steps are looked for, and where
nothing helps the readings are taken as they are.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from .noise import FEWEST_DEGREES, correlation_time, from_differences, resolution

# A reversal smaller than so many standard deviations is noise.
HYSTERESIS = 5.0
# A bend must lower the sum of squares, in variances, by more than this, and by 2 ln(K/1000) more in
# recordings longer than 1000 samples: the best place of a run does so by chance in fewer than 1 of 100 runs.
BEND, SHORT = 14.0, 1000
ROUNDS, REFINEMENTS = 40, 4
# Noise above this share of the range may be readings that jump about, if nothing is known of the tip; and is
# in any case.
LARGEST_NOISE, LARGEST_UNLIKE_TIP = 0.02, 0.2
# Noise below this share of the range does little to friction.
MATTERS = 0.001
# Shares of the first guess that are tried for the noise: steps of the tension make it too large.
SHARES = (1.0, 0.5, 0.25)
# Correlation of what is left with the tip's own remainder, at least: the tip does not follow noise. And how
# many steps of the tip, of so many standard deviations, tell.
ALIKE, STEP, FEWEST_STEPS = 0.2, 4.0, 8
BLOCK = 400
# Knots below which nothing is smoothed; a bend this many times its neighbours' is a corner; and what a smooth
# knot must be worth, in variances, and how many samples it takes.
FEWEST_SMOOTH, SUDDEN, WORTH, ROOM = 8, 4.0, 6.0, 2
DENSITIES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.2)
# Standard errors by which a sum of squares is too large, the first guess of the variance having a relative
# variance of GUESSED per sample; unless it is that of a filtered noise: so many times what that has.
FAR_MORE, GUESSED, MORE_THAN_FILTERED = 4.0, 8.0, 1.5
PASSES, SETTLED = 4, 0.05
# A lone spike is so many standard deviations off all that its neighbours say, and so many times as far as
# they differ among each other.
SPIKE, SPIKE_APART = 10.0, 3.0
# Least that samples must say of a number of the base tension, as a share of one sample; and how many times as
# many knots a better estimate may ask for.
LEAST_SAID, MORE_KNOTS = 1e-3, 2
MOST_PRUNED = 3000  # knots beyond which none is taken out again


@dataclasses.dataclass(frozen=True, eq=False)
class BaseTension:
    """A base tension of K samples, straight between knots.

    Attributes:
        t: time of the samples, in any unit, (K,).
        T_base: estimate of the true base tension [N], (K,).
        knots: samples at which it may bend, increasing, first 0 and last K-1, (M,).
        corner: knots at which the slope may jump, (M,); between others the curve is a smooth cubic.
        near: the four numbers that each sample depends on, (K, 4); of straight runs the values at the knots.
        weights: how much it depends on them, (K, 4).
        size: how many numbers there are, M.
        sd: standard deviation of the recorded base tension [N].
        misfit: sum of squares of what the recording is off, in units of `sd`.
        tau: samples per independent one of what it is off.
        counted: samples that each of these stands for.
    """

    t: np.ndarray
    T_base: np.ndarray
    knots: np.ndarray
    corner: np.ndarray
    near: np.ndarray
    weights: np.ndarray
    size: int
    sd: float
    misfit: float
    tau: float = 1.0
    counted: float = 1.0

    @property
    def believed(self) -> float:
        """Standard deviation [N] that one sample counts with, its neighbours being as wrong."""
        return self.sd * float(np.sqrt(self.tau / self.counted))

    @property
    def degrees(self) -> int:
        """Degrees of freedom of `misfit`."""
        return len(self.T_base) - self.size

    def at_samples(self, values: np.ndarray) -> np.ndarray:
        """From values at the knots, (M, ...), to the samples, (K, ...)."""
        weights = self.weights.reshape(*self.weights.shape, *[1] * (np.ndim(values) - 1))
        return np.sum(weights * values[self.near], axis=1)

    def to_knots(self, values: np.ndarray, samples: np.ndarray | None = None) -> np.ndarray:
        """The transpose of `at_samples`: sums of values at samples, (S, ...), weighted by their shares, (M,
        ...).

        Args:
            values: at the samples.
            samples: which they are, (S,); all unless given. One may stand several times.
        """
        near, weights = (a if samples is None else a[samples] for a in (self.near, self.weights))
        out = np.zeros((self.size, *values.shape[1:]))
        for knot, weight in zip(near.T, weights.T, strict=True):
            np.add.at(out, knot, weight.reshape(-1, *[1] * (values.ndim - 1)) * values)
        return out

    def only(self, samples: np.ndarray) -> BaseTension:
        """The same at some samples, increasing, (S,), which count for all of them; taken as exact where these
        do not say enough of every number.
        """
        K, S = len(self.T_base), len(samples)
        if self.sd == 0 or S == K:
            return exact(self.T_base[samples]) if self.sd == 0 else self
        near, weights = self.near[samples], self.weights[samples]
        kept = np.searchsorted(samples, self.knots)
        found = dataclasses.replace(
            self,
            t=self.t[samples],
            T_base=self.T_base[samples],
            knots=np.minimum(kept, S - 1),
            near=near,
            weights=weights,
            counted=self.counted * K / S,
        )
        said = found.information(np.ones(S))
        try:
            factor = cholesky_banded(said)
        except np.linalg.LinAlgError:
            return exact(self.T_base[samples])
        return found if np.min(factor[-1]) ** 2 > LEAST_SAID else exact(self.T_base[samples])

    def sharpened(self, recorded: np.ndarray, better: np.ndarray, sd: float) -> BaseTension:
        """The same with knots where a better estimate bends; the values are still the recording's.

        Args:
            recorded: base tension as recorded [N], (K,).
            better: an estimate of the true one that knows more, of the tip's answer to it, (K,).
            sd: its standard deviation [N].
        """
        found = straighten(better, sd, self.t)
        if found.size > MORE_KNOTS * (self.size + 2):
            return self
        fit = _runs(self.t, recorded, found.knots, found.corner, self.sd)
        return _with_correlation(fit, recorded) if fit.degrees >= FEWEST_DEGREES else self

    def nodes(self, spacing: float) -> np.ndarray:
        """Samples that carry the history: all knots and turning points, and between them as many as keep the
        base tension from changing by more than about `spacing` [N] from one to the next, (J,), increasing.
        """
        steps = np.diff(self.T_base)
        turns = 1 + np.flatnonzero(steps[1:] * steps[:-1] < 0)
        travel = np.floor(np.concatenate([[0.0], np.cumsum(np.abs(steps))]) / spacing)
        return np.unique(np.concatenate([self.knots, turns, 1 + np.flatnonzero(np.diff(travel) > 0)]))

    def information(self, weight: np.ndarray, samples: np.ndarray | None = None) -> np.ndarray:
        """Sum of weighted outer products of the shares: a symmetric banded matrix of the knots, its diagonal
        the last row, its upper bands above, (4, M).
        """
        near, weights = (a if samples is None else a[samples] for a in (self.near, self.weights))
        bands = np.zeros((4, self.size))
        for c in range(4):
            for d in range(c, 4):
                np.add.at(bands[3 - (d - c)], near[:, d], weight * weights[:, c] * weights[:, d])
        return bands


Search = Callable[[np.ndarray, float, np.ndarray | None], BaseTension]


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


def _runs(
    t: np.ndarray, T: np.ndarray, knots: np.ndarray, corner: np.ndarray | None, sd: float
) -> BaseTension:
    """Least squares with given knots; all are corners unless it is said which."""
    corner = np.ones(len(knots), bool) if corner is None else corner
    near, weights, size = _shares(t, knots, corner)
    fit = BaseTension(t, T, knots, corner, near, weights, size, sd, 0.0)
    bands = fit.information(np.ones(len(T)))
    values = cho_solve_banded((cholesky_banded(bands), False), fit.to_knots(T))
    smooth = fit.at_samples(values)
    return dataclasses.replace(fit, T_base=smooth, misfit=float(np.sum(((T - smooth) / sd) ** 2)))


def _shares(t: np.ndarray, knots: np.ndarray, corner: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The numbers that the curve depends on: which four of them each sample does, how much, (K, 4) each, and
    how many there are. They are the values at the corners, and between two of these, where there are other
    knots, the coefficients of a cubic spline; straight where there are none.
    """
    ends = np.flatnonzero(corner)
    inner = np.diff(ends) - 1
    sizes = np.where(inner > 0, inner + 3, 1)  # numbers of each piece but for the last, which the next has
    first = np.concatenate([[0], np.cumsum(sizes)])
    at, stops = np.arange(len(t)), knots[ends]
    piece = np.clip(np.searchsorted(stops, at, side="right") - 1, 0, len(inner) - 1)
    start, end = t[stops[piece]], t[stops[piece + 1]]
    share = (t - start) / (end - start)
    near = first[piece][:, None] + np.arange(4)
    weights = np.stack([1 - share, share, np.zeros_like(share), np.zeros_like(share)], axis=1)
    for j in np.flatnonzero(inner > 0):
        inside = piece == j
        x = t[knots[ends[j] : ends[j + 1] + 1]]
        design = BSpline.design_matrix(t[inside], np.pad(x, 3, mode="edge"), 3)
        near[inside] = first[j] + design.indices.reshape(-1, 4)
        weights[inside] = design.data.reshape(-1, 4)
    size = int(first[-1]) + 1
    return np.minimum(near, size - 1), weights, size


def _smoothed(fit: BaseTension, T: np.ndarray) -> BaseTension:
    """The same with smooth knots where the base tension bends on and on in one sense, as a sinusoid does,
    and with fewer of them; the fit as it is where that is no better for the knots it takes.
    """
    if len(fit.knots) < FEWEST_SMOOTH:
        return fit
    slopes = np.diff(fit.T_base[fit.knots]) / np.diff(fit.t[fit.knots])
    bend = np.concatenate([[0.0], np.diff(slopes), [0.0]])
    beside = np.stack([np.roll(bend, 1), np.roll(bend, -1)])
    like = (beside * bend > 0) & (np.abs(bend) < SUDDEN * np.abs(beside))
    corner = np.logical_not(like.any(axis=0))
    corner[[0, -1]] = True
    best, least = fit, fit.misfit + WORTH * fit.size
    for share in DENSITIES:
        found = _runs(fit.t, T, *_resampled(fit.knots, corner, share), fit.sd)
        if found.misfit + WORTH * found.size < least:
            best, least = found, found.misfit + WORTH * found.size
    return best


def _resampled(knots: np.ndarray, corner: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Knots of which a share is left between each two corners, evenly, and which of them are corners. A
    stretch with too few samples stays as it is, straight.
    """
    stops = np.flatnonzero(corner)
    chosen, corners = [knots[stops]], [knots[stops]]
    for a, b in itertools.pairwise(stops.tolist()):
        count = max(1, round(share * (b - a)))
        if b - a > 1 and knots[b] - knots[a] >= ROOM * (count + 2):
            chosen.append(np.round(np.linspace(knots[a], knots[b], count + 1)).astype(int))
        else:
            corners.append(knots[a : b + 1])
    found = np.unique(np.concatenate([*chosen, *corners]))
    return found, np.isin(found, np.concatenate(corners))


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
    return _smoothed(_runs(t, T, knots, None, sd), T)


def _clock(T: np.ndarray, time: np.ndarray | None) -> np.ndarray:
    """Time of the samples; their number where they have none that increases."""
    numbers = np.arange(len(T), dtype=float)
    return numbers if time is None or np.any(np.diff(time) <= 0) else np.asarray(time, float)


def _threshold(K: int) -> float:
    return BEND + 2.0 * max(0.0, float(np.log(K / SHORT)))


def _from_all(T: np.ndarray, sd: float, time: np.ndarray | None = None) -> BaseTension:
    """The same found the other way round: every sample a knot, and needless ones taken out. Slower, but it
    sees a staircase, in which no single bend helps.
    """
    t, threshold, K = _clock(T, time), _threshold(len(T)), len(T)
    edges = np.unique(np.linspace(0, K - 1, max(2, 1 + -(-K // BLOCK))).astype(int))
    kept = [
        a + _without_needless(t[a : b + 1], T[a : b + 1], np.arange(b - a + 1), sd, threshold)
        for a, b in itertools.pairwise(edges.tolist())
    ]
    knots = _without_needless(t, T, np.unique(np.concatenate(kept)), sd, threshold)
    return _runs(t, T, knots, None, sd)


def _with_bends(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float, threshold: float) -> np.ndarray:
    settled: set[tuple[int, int]] = set()
    for _ in range(ROUNDS):
        residual = (T - _runs(t, T, knots, None, sd).T_base) / sd
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


def _merged(t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float, threshold: float) -> np.ndarray:
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
        if _left(times, values, [at]) - two < threshold * sd**2:
            found[m : m + 2] = [a + at]
        else:
            m += 1
    return np.asarray(found)


def _without_needless(
    t: np.ndarray, T: np.ndarray, knots: np.ndarray, sd: float, threshold: float
) -> np.ndarray:
    if len(knots) > MOST_PRUNED:
        return knots
    for _ in range(ROUNDS):
        fit = _runs(t, T, knots, None, sd)
        loss = _removable(fit, fit.T_base[knots])
        least = (loss < threshold) & (
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


def is_noisy(T: np.ndarray) -> bool:
    """Whether neighbouring readings differ by more than the resolution explains, and enough to matter."""
    return (from_differences(T) or 0.0) > max(2 * resolution(T) / np.sqrt(12.0), MATTERS * np.ptp(T))


def exact(T: np.ndarray) -> BaseTension:
    """The base tension taken as recorded."""
    K = len(T)
    at, near = np.arange(K), np.minimum(np.arange(K)[:, None] + np.arange(4), K - 1)
    weights = np.broadcast_to(np.asarray([1.0, 0.0, 0.0, 0.0]), (K, 4))
    return BaseTension(at.astype(float), T, at, np.ones(K, bool), near, weights, K, 0.0, 0.0)


def estimate(
    T: np.ndarray,
    time: np.ndarray | None = None,
    sd: float | None = None,
    tip: np.ndarray | None = None,
) -> BaseTension:
    """The true base tension behind a recorded one.

    What straight runs leave must be noise: no larger than `sd` unless its errors hang together over a few
    samples, and nothing that the tip follows. Where it is not, more bends are set and a smaller noise is
    tried; where nothing helps, the readings are taken as exact.

    Args:
        T: recorded base tension [N], (K,), K >= 2.
        time: of the samples [s], (K,), or None.
        sd: its standard deviation [N]; 0 takes it as exact; unless given it is estimated, first from
            differences of neighbours, then from what the straight runs leave.
        tip: recorded tip tension [N], (K,), which tells noise from changes of the tension.
    """
    first = sd if sd is not None else from_differences(T) or 0.0
    largest = LARGEST_NOISE if tip is None else LARGEST_UNLIKE_TIP
    if first == 0 or (sd is None and first > largest * np.ptp(T)):
        return exact(T)
    shares = (1.0,) if sd is not None else SHARES
    for share, search in itertools.product(shares, (straighten, _from_all)):
        fit = search(T, share * first, time)
        if fit.degrees >= FEWEST_DEGREES and not _only_noise(fit, T, tip):
            continue
        if sd is None and fit.degrees >= FEWEST_DEGREES:
            fit = _refined(fit, T, time, search)
        return _with_correlation(fit, T)
    return exact(T) if sd is None else _with_correlation(fit, T)


def _refined(fit: BaseTension, T: np.ndarray, time: np.ndarray | None, search: Search) -> BaseTension:
    """The fit with the noise that it leaves itself."""
    floor, found = resolution(T) / np.sqrt(12.0), fit.sd
    for _ in range(PASSES):
        before, found = found, max(fit.sd * np.sqrt(fit.misfit / fit.degrees), floor)
        if found == 0 or abs(found / before - 1) < SETTLED:
            break
        again = search(T, found, time)
        if again.degrees < FEWEST_DEGREES:
            break
        fit = again
    scale = (fit.sd / found) ** 2 if found > 0 else 1.0
    return dataclasses.replace(fit, sd=found, misfit=fit.misfit * scale)


def _only_noise(fit: BaseTension, T: np.ndarray, tip: np.ndarray | None) -> bool:
    """Whether what straight runs leave of a base tension is noise."""
    left = T - fit.T_base
    if tip is not None and _followed(fit, left, tip):
        return False
    ratio = fit.misfit / fit.degrees
    # How much third differences underestimate a noise that is filtered (AR(1)) and so has this memory.
    tau = correlation_time(left)
    rho = (tau - 1) / (tau + 1)
    filtered = 20 / (20 - 30 * rho + 12 * rho**2 - 2 * rho**3)
    uncertain = np.sqrt(2 / fit.degrees + GUESSED / len(T))
    return ratio < max(1 + FAR_MORE * uncertain, MORE_THAN_FILTERED * filtered)


def _followed(fit: BaseTension, left: np.ndarray, tip: np.ndarray) -> bool:
    """Whether the tip follows what straight runs leave of the base tension, in all steps or in large ones."""
    steps = np.diff(tip - _runs(fit.t, tip, fit.knots, fit.corner, 1.0).T_base)
    large = np.abs(steps) > STEP * np.sqrt(2.0) * max(from_differences(tip) or 0.0, 1e-12)
    if _alike(np.diff(left), steps):
        return True
    return int(large.sum()) >= FEWEST_STEPS and _alike(np.diff(left)[large], steps[large])


def _alike(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two series go together by more than chance."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return size > 0 and float(a @ b) > max(ALIKE, min(0.9, 4 / np.sqrt(len(a)))) * size


def _with_correlation(fit: BaseTension, T: np.ndarray) -> BaseTension:
    return dataclasses.replace(fit, tau=correlation_time(T - fit.T_base))
