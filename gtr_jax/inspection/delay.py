"""How late the tip's cell shows what the base's cell shows, where the tendon slips."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from scipy.signal import correlate

# Longest delay that is looked for: so many samples, and at least so many seconds.
SAMPLES, SECONDS = 6, 0.06
# A stretch is used from so many times the longest delay on, and cut into pieces of twice as many.
LONG = 6
# Rates are taken over as few samples as leave the noise this share of what varies in them, and at most over
# so many.
NOISE_SHARE, WIDEST = 0.3, 33
# A delay is told from a peak of at least this correlation, from at least so many pieces, to within this many
# samples.
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
    reach = max(SAMPLES, int(np.ceil(SECONDS / usual)))
    even = [_evenly(T_base, T_tip, time, a, b, usual) for a, b in slipping if b - a >= LONG * reach]
    if not even:
        longest = max((b - a + 1 for a, b in slipping), default=0)
        return Delay(
            why_not=f"the longest stretch of slip has {longest} samples, and {LONG * reach + 1} are needed"
        )
    width = _smoothing(even, noise)
    pieces = [p for base, tip in even for p in _pieces(_rate(base, width), _rate(tip, width), reach)]
    if len(pieces) < FEWEST:
        return Delay(pieces=len(pieces), why_not=f"slip lasts for {len(pieces)} of {FEWEST} pieces needed")
    parts = np.stack([_products(base, tip, reach) for base, tip in pieces])
    curve = _curve(parts.sum(axis=0))
    lags = np.arange(-reach, reach + 1) * usual
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
    total = parts.sum(axis=0)
    left_out = [_peak(_curve(total - part)) for part in parts]
    if any(value is None for value in left_out):
        return Delay(**shown, why_not="the peak of the correlation hangs on one stretch of slip")
    values = np.asarray(left_out, float)
    n = len(values)
    sd = float(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)))
    if sd > CERTAIN:
        return Delay(**shown, why_not=f"its standard error is {sd:.1f} samples")
    offset = at - reach
    return Delay(seconds=offset * usual, sd_s=sd * usual, samples=offset, **shown)


def _evenly(
    T_base: np.ndarray, T_tip: np.ndarray, time: np.ndarray, a: int, b: int, usual: float
) -> tuple[np.ndarray, np.ndarray]:
    """Both tensions of a stretch at equal steps of time."""
    even = np.arange(time[a], time[b], usual)
    own = slice(a, b + 1)
    return np.interp(even, time[own], T_base[own]), np.interp(even, time[own], T_tip[own])


def _rate(x: np.ndarray, width: int) -> np.ndarray:
    """Change from sample to sample of the mean over `width` samples: the change over them, up to a factor."""
    return x[width:] - x[:-width]


def _smoothing(even: list[tuple[np.ndarray, np.ndarray]], noise: tuple[float, float]) -> int:
    """Samples over which rates are taken: the fewest over which noise makes up no more than NOISE_SHARE of
    how the changes of either tension vary.
    """
    width = 1
    while width < WIDEST:
        spread = [
            float(np.sqrt(np.mean(np.concatenate([_rate(pair[i], width) - _rate(pair[i], width).mean()
                                                  for pair in even if len(pair[i]) > width]) ** 2)))
            for i in (0, 1)
        ]  # fmt: skip
        if all(np.sqrt(2.0) * sd <= NOISE_SHARE * s for sd, s in zip(noise, spread, strict=True)):
            break
        width += 2
    return width


def _pieces(base: np.ndarray, tip: np.ndarray, reach: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pieces of rates, of LONG times the longest delay."""
    count = max(len(base) // (2 * LONG * reach), 1)
    ends = np.linspace(0, len(base), count + 1).astype(int)
    cut = [(base[a:b], tip[a:b]) for a, b in itertools.pairwise(ends.tolist())]
    return [pair for pair in cut if len(pair[0]) > 3 * reach]


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
