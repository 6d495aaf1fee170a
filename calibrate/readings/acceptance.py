"""Whether what an estimate leaves of a recorded base tension is noise, and what is done where it is not."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np

from .base_tension import BaseTension, exact, runs
from .knots import from_all, straighten
from .noise import FEWEST_DEGREES, correlation_time, from_differences, resolution

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
# Standard errors by which a sum of squares is too large, the first guess of the variance having a relative
# variance of GUESSED per sample; unless it is that of a filtered noise: so many times what that has.
FAR_MORE, GUESSED, MORE_THAN_FILTERED = 4.0, 8.0, 1.5
# Passes in which the noise is taken anew from what is left, and the relative change that ends them.
PASSES, SETTLED = 4, 0.05
# How many times as many knots a better estimate may ask for.
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
    for share, search in itertools.product(shares, (straighten, from_all)):
        fit = search(T, share * first, time)
        if fit.degrees >= FEWEST_DEGREES and not _only_noise(fit, T, tip):
            continue
        if sd is None and fit.degrees >= FEWEST_DEGREES:
            fit = _refined(fit, T, time, search)
        return fit.with_correlation(T)
    return exact(T) if sd is None else fit.with_correlation(T)


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
    steps = np.diff(tip - runs(fit.t, tip, fit.knots, fit.corner, 1.0).T_base)
    large = np.abs(steps) > STEP * np.sqrt(2.0) * max(from_differences(tip) or 0.0, 1e-12)
    if _alike(np.diff(left), steps):
        return True
    return int(large.sum()) >= FEWEST_STEPS and _alike(np.diff(left)[large], steps[large])


def _alike(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two series go together by more than chance."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return size > 0 and float(a @ b) > max(ALIKE, min(0.9, 4 / np.sqrt(len(a)))) * size


def sharpened(base: BaseTension, recorded: np.ndarray, better: np.ndarray, sd: float) -> BaseTension:
    """The same with knots where a better estimate bends; the values are still the recording's.

    Args:
        recorded: base tension as recorded [N], (K,).
        better: an estimate of the true one that knows more, of the tip's answer to it, (K,).
        sd: its standard deviation [N].
    """
    found = straighten(better, sd, base.t)
    if found.size > MORE_KNOTS * (base.size + 2):
        return base
    fit = runs(base.t, recorded, found.knots, found.corner, base.sd)
    return fit.with_correlation(recorded) if fit.degrees >= FEWEST_DEGREES else base
