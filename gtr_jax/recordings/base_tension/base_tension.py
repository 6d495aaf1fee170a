"""A base tension as its values at knots: how samples depend on them, and how well samples determine them."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gtr_jax.recordings.signals.noise import correlation_time

# Least information that samples must hold about a number of the base tension, as a share of one sample's.
LEAST_SAID = 1e-3


@dataclasses.dataclass(frozen=True, eq=False)
class BaseTension:
    """A base tension of K samples, straight between knots.

    Attributes:
        t: time of the samples, in any unit, (K,).
        T_base: estimate of the true base tension [N], (K,).
        knots: samples at which it may bend, increasing, first 0 and last K-1, (M,).
        corner: knots at which the slope may jump, (M,); between others the curve is a smooth cubic.
        near: the four numbers that each sample depends on, (K, 4); for straight runs, the values at the
            knots.
        weights: how much it depends on them, (K, 4).
        size: how many numbers there are, M.
        sd: standard deviation of the recorded base tension [N].
        misfit: sum of squared residuals of the recording, in units of `sd`.
        tau: samples per independent residual.
        counted: recorded samples that each sample stands for, (K,); None where each is one.
        slow: standard deviation of noise that lasts for many samples [N].
        lasts: how long that lasts, in recorded samples.
        spans: recorded samples of the run that each sample lies in, (K,); None for those between its knots.
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
    counted: np.ndarray | None = None
    slow: float = 0.0
    lasts: float = 1.0
    spans: np.ndarray | None = None

    @property
    def believed(self) -> np.ndarray:
        """Effective standard deviation of each sample [N], (K,), which allows for correlated neighbours and
        for the recorded samples that it stands for.
        """
        variance = self._quick
        if self.slow > 0:
            # Variance of the mean of an Ornstein-Uhlenbeck process over a run, to which all its samples come.
            x = np.maximum(self.run_lengths / self.lasts, 1e-3)
            mean = self.slow**2 * 2 * (x - 1 + np.exp(-x)) / x**2
            variance = variance + mean * np.maximum(self.run_lengths / self.stands_for, 1.0)
        return np.sqrt(variance)

    @property
    def error(self) -> np.ndarray:
        """Standard deviation of what each sample alone may be off by [N], (K,)."""
        return np.minimum(self.believed, np.sqrt(self._quick + self.slow**2))

    @property
    def _quick(self) -> np.ndarray:
        """Variance of each sample by all but slow noise [N^2], (K,)."""
        return self.sd**2 * self.tau / self.stands_for

    @property
    def run_lengths(self) -> np.ndarray:
        """Recorded samples of the run between two knots that each sample lies in, (K,)."""
        if self.spans is not None:
            return self.spans
        run = np.clip(np.searchsorted(self.knots, np.arange(len(self.T_base)), side="right") - 1, 0, None)
        return np.append(np.diff(self.knots), 1)[np.minimum(run, len(self.knots) - 2)].astype(float)

    @property
    def stands_for(self) -> np.ndarray:
        """Recorded samples that each sample stands for, (K,)."""
        return np.ones(len(self.T_base)) if self.counted is None else self.counted

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
            samples: their indices, (S,), which may repeat; all samples unless given.
        """
        near, weights = (a if samples is None else a[samples] for a in (self.near, self.weights))
        out = np.zeros((self.size, *values.shape[1:]))
        for knot, weight in zip(near.T, weights.T, strict=True):
            np.add.at(out, knot, weight.reshape(-1, *[1] * (values.ndim - 1)) * values)
        return out

    def only(self, samples: np.ndarray) -> BaseTension:
        """The base tension at some samples, increasing, (S,), which stand for all of them; where these do not
        determine every number well enough, each with an error of its own, of the size that all samples leave.
        """
        K, S = len(self.T_base), len(samples)
        if self.sd == 0 or S == K:
            return exact(self.T_base[samples]) if self.sd == 0 else self
        near, weights = self.near[samples], self.weights[samples]
        kept = np.searchsorted(samples, self.knots)
        nearest = np.searchsorted(0.5 * (samples[1:] + samples[:-1]), np.arange(K))
        found = dataclasses.replace(
            self,
            t=self.t[samples],
            T_base=self.T_base[samples],
            knots=np.minimum(kept, S - 1),
            near=near,
            weights=weights,
            counted=np.bincount(nearest, weights=self.stands_for, minlength=S),
            spans=self.run_lengths[samples],
        )
        information = found.information(np.ones(S))
        try:
            factor = cholesky_banded(information)
        except np.linalg.LinAlgError:
            return self._each(samples)
        return found if np.min(factor[-1]) ** 2 > LEAST_SAID else self._each(samples)

    def _each(self, samples: np.ndarray) -> BaseTension:
        """The base tension at some samples, each a number of its own with the error that all samples leave;
        larger where a run has several, so that together they tell no more than one.
        """
        columns = np.zeros((self.size, len(samples)))
        at = np.arange(len(samples))
        for knot, weight in zip(self.near[samples].T, self.weights[samples].T, strict=True):
            np.add.at(columns, (knot, at), weight)
        factor = cholesky_banded(self.information(self.believed**-2))
        left = np.sum(columns * cho_solve_banded((factor, False), columns), axis=0)
        # Those of one run have their error in common.
        run = np.searchsorted(self.knots, samples, side="right")
        left = left * np.bincount(run)[run]
        each = exact(self.T_base[samples])
        counted = self.sd**2 * self.tau / np.maximum(left, np.finfo(float).tiny)
        return dataclasses.replace(each, t=self.t[samples], sd=self.sd, tau=self.tau, counted=counted)

    def nodes(self, spacing: float) -> np.ndarray:
        """Samples that carry the history: all knots and turning points, and between them as many as keep the
        base tension from changing by more than about `spacing` [N] from one to the next, (J,), increasing.
        """
        steps = np.diff(self.T_base)
        turns = 1 + np.flatnonzero(steps[1:] * steps[:-1] < 0)
        travel = np.floor(np.concatenate([[0.0], np.cumsum(np.abs(steps))]) / spacing)
        return np.unique(np.concatenate([self.knots, turns, 1 + np.flatnonzero(np.diff(travel) > 0)]))

    def with_correlation(self, recorded: np.ndarray) -> BaseTension:
        """A copy with `tau` from the residual of the recorded tension [N], (K,)."""
        return dataclasses.replace(self, tau=correlation_time(recorded - self.T_base))

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


def exact(T: np.ndarray) -> BaseTension:
    """The base tension taken as recorded."""
    K = len(T)
    at, near = np.arange(K), np.minimum(np.arange(K)[:, None] + np.arange(4), K - 1)
    weights = np.broadcast_to(np.asarray([1.0, 0.0, 0.0, 0.0]), (K, 4))
    return BaseTension(
        t=at.astype(float),
        T_base=T,
        knots=at,
        corner=np.ones(K, bool),
        near=near,
        weights=weights,
        size=K,
        sd=0.0,
        misfit=0.0,
    )


def runs(
    t: np.ndarray, T: np.ndarray, knots: np.ndarray, corner: np.ndarray | None, sd: float
) -> BaseTension:
    """Least squares fit with given knots; all are corners unless `corner` is given."""
    corner = np.ones(len(knots), bool) if corner is None else corner
    near, weights, size = shares(t, knots, corner)
    fit = BaseTension(
        t=t,
        T_base=T,
        knots=knots,
        corner=corner,
        near=near,
        weights=weights,
        size=size,
        sd=sd,
        misfit=0.0,
    )
    bands = fit.information(np.ones(len(T)))
    values = cho_solve_banded((cholesky_banded(bands), False), fit.to_knots(T))
    smooth = fit.at_samples(values)
    return dataclasses.replace(fit, T_base=smooth, misfit=float(np.sum(((T - smooth) / sd) ** 2)))


def shares(t: np.ndarray, knots: np.ndarray, corner: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """For each sample, the four numbers of the curve that it depends on and their weights, (K, 4) each; and
    how many numbers there are. The numbers are the values at the corners, and between two of these, where
    there are other knots, the coefficients of a cubic spline; straight where there are none.
    """
    ends = np.flatnonzero(corner)
    inner = np.diff(ends) - 1
    sizes = np.where(inner > 0, inner + 3, 1)  # numbers of each piece but the last, which the next one has
    first = np.concatenate([[0], np.cumsum(sizes)])
    at, stops = np.arange(len(t)), knots[ends]
    piece = np.clip(np.searchsorted(stops, at, side="right") - 1, 0, len(inner) - 1)
    start, end = t[stops[piece]], t[stops[piece + 1]]
    share = (t - start) / (end - start)
    near = first[piece][:, None] + np.arange(4)
    weights = np.stack([1 - share, share, np.zeros_like(share), np.zeros_like(share)], axis=1)
    smooth = np.flatnonzero(inner > 0)
    if len(smooth):  # few recordings need it, and it takes a quarter of a second to import
        from scipy.interpolate import BSpline
    for j in smooth:
        inside = piece == j
        x = t[knots[ends[j] : ends[j + 1] + 1]]
        design = BSpline.design_matrix(t[inside], np.pad(x, 3, mode="edge"), 3)
        near[inside] = first[j] + design.indices.reshape(-1, 4)
        weights[inside] = design.data.reshape(-1, 4)
    size = int(first[-1]) + 1
    return np.minimum(near, size - 1), weights, size
