"""Whether the residual of a base tension estimate is noise, and what is done where it is not."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from gtr_jax.recordings.signals.noise import FEWEST_DEGREES, correlation_time, from_differences, resolution

from .base_tension import BaseTension, exact, runs
from .knots import from_all, straighten

# Largest noise, as a share of the range: above it, the readings may jump about and are taken as exact. The
# first holds where the tip tension is unknown, the second where it is known.
LARGEST_NOISE, LARGEST_UNLIKE_TIP = 0.02, 0.2
# Noise below this share of the range does little to friction.
MATTERS = 0.001
# Shares of the first estimate that are tried for the noise: steps of the tension make that estimate too
# large.
SHARES = (1.0, 0.5, 0.25)
# Least correlation, between steps of the residual and of the tip's own residual, at which the tip follows it.
# Size of a large step of the tip, in standard deviations; and how many large steps suffice for a test on
# these alone.
ALIKE, STEP, FEWEST_STEPS = 0.2, 4.0, 8
# A residual is not noise if its chi-square is too large by this many standard errors, where the first
# estimate of the variance has a relative variance of GUESSED/K; unless it is below this many times the value
# of filtered noise.
FAR_MORE, GUESSED, MORE_THAN_FILTERED = 4.0, 8.0, 1.5
# Passes in which the noise is estimated again from the residual, and the relative change that ends them.
PASSES, SETTLED = 4, 0.05
# A better estimate may have up to this many times as many knots.
MORE_KNOTS = 2

Search = Callable[[np.ndarray, float, np.ndarray | None], BaseTension]


def is_noisy(T: np.ndarray) -> bool:
    """Whether neighbouring readings differ by more than the resolution explains, and enough to matter."""
    return (from_differences(T) or 0.0) > max(2 * resolution(T) / np.sqrt(12.0), MATTERS * np.ptp(T))


def estimate_base(
    T: np.ndarray,
    time: np.ndarray | None = None,
    sd: float | None = None,
    tip: np.ndarray | None = None,
) -> BaseTension:
    """The true base tension behind a recorded one.

    The residual of the straight runs must be noise: no larger than `sd`, unless it is correlated over a few
    samples, and not followed by the tip. Where it is not, the other search for knots and a smaller noise are
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
    for share, search in itertools.product(shares, (straighten, from_all)):
        fit = search(T, share * first, time)
        if fit.degrees >= FEWEST_DEGREES and not _only_noise(fit, T, tip):
            continue
        if sd is None and fit.degrees >= FEWEST_DEGREES:
            fit = _refined(fit, T, time, search)
        return fit.with_correlation(T)
    return exact(T) if sd is None else fit.with_correlation(T)


def _refined(fit: BaseTension, T: np.ndarray, time: np.ndarray | None, search: Search) -> BaseTension:
    """The fit with the noise estimated from its own residual."""
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
    """Whether the residual of straight runs is noise."""
    left = T - fit.T_base
    if tip is not None and _followed(fit, left, tip):
        return False
    ratio = fit.misfit / fit.degrees
    # Factor by which third differences underestimate the variance of AR(1) noise with this correlation time.
    tau = correlation_time(left)
    rho = (tau - 1) / (tau + 1)
    filtered = 20 / (20 - 30 * rho + 12 * rho**2 - 2 * rho**3)
    uncertain = np.sqrt(2 / fit.degrees + GUESSED / len(T))
    return ratio < max(1 + FAR_MORE * uncertain, MORE_THAN_FILTERED * filtered)


def _followed(fit: BaseTension, left: np.ndarray, tip: np.ndarray) -> bool:
    """Whether the tip follows the residual of straight runs of the base tension, in all steps or in large
    ones.
    """
    steps = np.diff(tip - runs(fit.t, tip, fit.knots, fit.corner, 1.0).T_base)
    large = np.abs(steps) > STEP * np.sqrt(2.0) * max(from_differences(tip) or 0.0, 1e-12)
    if _alike(np.diff(left), steps):
        return True
    return int(large.sum()) >= FEWEST_STEPS and _alike(np.diff(left)[large], steps[large])


def _alike(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two series are correlated by more than chance."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return size > 0 and float(a @ b) > max(ALIKE, min(0.9, 4 / np.sqrt(len(a)))) * size


def sharpened(base: BaseTension, recorded: np.ndarray, better: np.ndarray, sd: float) -> BaseTension:
    """The recording fitted again, with knots where a better estimate of the base tension bends.

    Args:
        recorded: base tension as recorded [N], (K,).
        better: an estimate of the true base tension that uses the tip's response too [N], (K,).
        sd: its standard deviation [N].
    """
    found = straighten(better, sd, base.t)
    if found.size > MORE_KNOTS * (base.size + 2):
        return base
    fit = runs(base.t, recorded, found.knots, found.corner, base.sd)
    fit = dataclasses.replace(fit, slow=base.slow, lasts=base.lasts)
    return fit.with_correlation(recorded) if fit.degrees >= FEWEST_DEGREES else base
