"""How late the tip's cell shows what the base's cell shows, where the tendon slips."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from scipy.signal import correlate

from gtr_jax.files.numbers import number

# Longest delay that is looked for: so many steps of time, and at least so many seconds.
STEPS, SECONDS = 6, 0.06
# A stretch is used from so many times the longest delay on, and cut into pieces of twice as many.
LONG = 6
# Neighbouring samples are averaged until noise is at most this share of how the changes of either tension
# vary, and at most so many.
NOISE_SHARE, MOST_AVERAGED = 0.3, 256
# A delay is told from a peak of at least this correlation, from at least so many pieces, to within this many
# steps.
LEAST, FEWEST, CERTAIN = 0.4, 4, 1.0


@dataclasses.dataclass(frozen=True, eq=False)
class Delay:
    """Delay of the tip's cell behind the base's.

    Attributes:
        seconds: positive if the tip is late; None where it is not determined.
        sd_s: standard error, from leaving out one piece after another; None as above.
        samples: the same in samples.
        correlation: of the rates at the peak.
        pieces: number of pieces of slipping stretches.
        why_not: why it is not determined; "" if it is.
        lags_s, correlations: the correlation of the rates by lag, (n,) each.
    """

    seconds: float | None = None
    sd_s: float | None = None
    samples: float | None = None
    correlation: float | None = None
    pieces: int = 0
    why_not: str = ""
    lags_s: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    correlations: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))


def delay(
    T_base: np.ndarray,
    T_tip: np.ndarray,
    time: np.ndarray,
    *,
    slipping: list[tuple[int, int]],
    noise: tuple[float, float],
) -> Delay:
    """The delay between the cells.

    In slip the tip follows the base in a fixed ratio, so that the rates of both have the same shape. The
    correlation of the rates, each without its mean, is summed over pieces of the slipping stretches for every
    lag; a parabola through its peak gives the delay.

    Args:
        T_base, T_tip: [N], (K,).
        time: [s], (K,), increasing.
        slipping: first and last sample of each stretch in which the tendon slips in one direction.
        noise: standard deviations of both cells from sample to sample [N].
    """
    usual = float(np.median(np.diff(time)))
    even = [_evenly(T_base, T_tip, time, a, b, usual) for a, b in slipping if b > a + 1]
    averaged = _averaging(even, noise)
    step = averaged * usual
    reach = max(STEPS, int(np.ceil(SECONDS / step)))
    changes = [tuple(np.diff(_mean_of(x, averaged)) for x in pair) for pair in even]
    pieces = [piece for base, tip in changes for piece in _pieces(base, tip, reach)]
    if len(pieces) < FEWEST:
        return Delay(
            pieces=len(pieces),
            why_not=f"{len(pieces)} pieces of steady slip last for {number(LONG * reach * step, 's', 2)} or "
            f"more, and {FEWEST} are needed",
        )
    parts = np.stack([_products(base, tip, reach) for base, tip in pieces])
    total = parts.sum(axis=0)
    curve = _curve(total)
    lags = np.arange(-reach, reach + 1) * step
    peak, at = float(curve.max()), _peak(curve)
    shown = {"pieces": len(pieces), "correlation": peak, "lags_s": lags, "correlations": curve}
    if peak < LEAST:
        return Delay(
            **shown,
            why_not=f"the rates of the two cells correlate by {peak:.2f} at best, and {LEAST} is needed: the "
            "tension changes too evenly, or the noise is too large",
        )
    if at is None:
        return Delay(**shown, why_not="the correlation of the rates has no peak within the lags tried")
    left_out = [_peak(_curve(total - part)) for part in parts]
    if any(value is None for value in left_out):
        return Delay(**shown, why_not="the peak of the correlation hangs on one stretch of slip")
    values = np.asarray(left_out, float)
    n = len(values)
    sd = float(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)))
    if sd > CERTAIN:
        return Delay(**shown, why_not=f"its standard error is {number(sd * step, 's', 2)}")
    offset = at - reach
    return Delay(seconds=offset * step, sd_s=sd * step, samples=offset * averaged, **shown)


def _evenly(
    T_base: np.ndarray, T_tip: np.ndarray, time: np.ndarray, a: int, b: int, usual: float
) -> tuple[np.ndarray, np.ndarray]:
    """Both tensions of a stretch at equal steps of time."""
    even = np.arange(time[a], time[b], usual)
    own = slice(a, b + 1)
    return np.interp(even, time[own], T_base[own]), np.interp(even, time[own], T_tip[own])


def _mean_of(x: np.ndarray, count: int) -> np.ndarray:
    """Means of so many neighbouring samples each."""
    return x[: len(x) // count * count].reshape(-1, count).mean(axis=1)


def _averaging(even: list[tuple[np.ndarray, np.ndarray]], noise: tuple[float, float]) -> int:
    """How many samples are averaged: the fewest that make noise a small share of how the changes of both
    tensions vary.
    """
    for count in (2**k for k in range(int(np.log2(MOST_AVERAGED)) + 1)):
        small = True
        for sd, own in zip(noise, zip(*even, strict=True), strict=True):
            changes = [np.diff(_mean_of(x, count)) for x in own if len(x) > 2 * count]
            if not changes:
                return count
            spread = float(np.sqrt(np.mean(np.concatenate([c - c.mean() for c in changes]) ** 2)))
            small &= np.sqrt(2.0 / count) * sd <= NOISE_SHARE * spread
        if small:
            return count
    return MOST_AVERAGED


def _pieces(base: np.ndarray, tip: np.ndarray, reach: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pieces of the changes of a stretch, none shorter than LONG times the longest delay."""
    if len(base) < LONG * reach:
        return []
    count = max(len(base) // (2 * LONG * reach), 1)
    ends = np.linspace(0, len(base), count + 1).astype(int)
    return [(base[a:b], tip[a:b]) for a, b in itertools.pairwise(ends.tolist())]


def _products(base: np.ndarray, tip: np.ndarray, reach: int) -> np.ndarray:
    """Sums of products and of squares at each lag, (3, 2 reach + 1), of a piece without its means: the base
    stays, and the tip is shifted over it.
    """
    middle = base[reach : len(base) - reach]
    middle = middle - middle.mean()
    n = len(middle)
    products = correlate(tip, middle, mode="valid", method="auto")
    sums = np.concatenate([[0.0], np.cumsum(tip)])
    squares = np.concatenate([[0.0], np.cumsum((tip - tip.mean()) ** 2)])
    own = sums[n:] - sums[:-n] - n * tip.mean()
    return np.stack(
        [products, np.full(len(products), float(middle @ middle)), squares[n:] - squares[:-n] - own**2 / n]
    )


def _curve(sums: np.ndarray) -> np.ndarray:
    """Correlation by lag."""
    return sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-300))


def _peak(curve: np.ndarray) -> float | None:
    """Place of the largest value, between samples by a parabola; None at an end."""
    i = int(np.argmax(curve))
    if not 0 < i < len(curve) - 1:
        return None
    before, at, after = curve[i - 1 : i + 2]
    bend = before - 2 * at + after
    return i + float(0.5 * (before - after) / bend) if bend < 0 else None
