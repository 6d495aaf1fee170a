"""How late the tip's cell shows what the base's cell shows, where the tendon slips."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from gtr_jax.numbers import number

# Longest delay that is looked for: so many steps of time, and at least so many seconds.
STEPS, SECONDS = 6, 0.06
# A stretch is used from so many times the longest delay on; where there are fewer than so many stretches they
# are cut into pieces, by which the error is told.
LONG, ENOUGH = 6, 8
# Neighbouring samples are averaged until noise is at most this share of how the changes of either tension
# vary, and at most so many.
NOISE_SHARE, MOST_AVERAGED = 0.3, 256
# A delay is told from a peak of at least this correlation, from at least so many pieces, to within this many
# steps.
LEAST, FEWEST, CERTAIN = 0.4, 4, 1.0
LEAST_SD = 0.1  # of a step: simulated loops are found this far off where nothing else is uncertain
DROP = 0.05  # of the correlation from the peak to the longest lags


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
    lag; a parabola through the upper half of its peak gives the delay.

    Args:
        T_base, T_tip: [N], (K,).
        time: [s], (K,), increasing.
        slipping: first and last sample of each stretch in which the tendon slips in one direction.
        noise: standard deviations of both cells from sample to sample [N].
    """
    usual = float(np.median(np.diff(time)))
    if usual <= 0:
        return Delay(why_not="most stamps repeat")
    even = [_evenly(T_base, T_tip, time, a, b, usual) for a, b in slipping if b > a + 1]
    if not even:
        return Delay(why_not="there is no stretch of steady slip")
    averaged = _averaging(even, noise)
    step = averaged * usual
    reach = max(STEPS, int(np.ceil(SECONDS / step)))
    means = [
        (_farthest(_mean_of(base, averaged)), _mean_of(tip, averaged))
        for base, tip in even
        if len(base) > LONG * reach * averaged
    ]
    changes = [tuple(np.diff(x) for x in pair) for pair in means]
    pieces = _pieces(changes, LONG * reach)
    if averaged == MOST_AVERAGED:
        return Delay(
            why_not="the tension changes too evenly where the tendon slips, for the noise of the cells"
        )
    if len(pieces) < FEWEST:
        return Delay(
            pieces=len(pieces),
            why_not=f"{len(pieces)} pieces of steady slip last for {number(LONG * reach * step, 's', 2)} or "
            f"more, and {FEWEST} are needed",
        )
    variances = 2 * noise[0] ** 2 / averaged, 2 * noise[1] ** 2 / averaged
    parts = np.stack([_products(base, tip, reach, variances) for base, tip in pieces])
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
    if peak - max(curve[0], curve[-1]) < DROP:
        return Delay(
            **shown,
            why_not=f"the correlation of the rates falls by less than {DROP:g} over the lags tried: the "
            "rates change too slowly",
        )
    if at is None:
        return Delay(**shown, why_not="the correlation of the rates has no peak within the lags tried")
    left_out = [_peak(_curve(total - part)) for part in parts]
    if any(value is None for value in left_out):
        return Delay(**shown, why_not="the peak of the correlation hangs on one stretch of slip")
    values = np.asarray(left_out, float)
    n = len(values)
    sd = float(np.hypot(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)), LEAST_SD))
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


def _farthest(base: np.ndarray) -> np.ndarray:
    """How far a pull or release has got: while the base falls back a little, friction holds the tip until it
    has come forth again.
    """
    return np.maximum.accumulate(base) if base[-1] > base[0] else np.minimum.accumulate(base)


def _averaging(even: list[tuple[np.ndarray, np.ndarray]], noise: tuple[float, float]) -> int:
    """How many samples are averaged: the fewest that make noise a small share of how the changes of both
    tensions vary.
    """
    for count in (2**k for k in range(int(np.log2(MOST_AVERAGED)) + 1)):
        small = True
        for sd, own in zip(noise, zip(*even, strict=True), strict=True):
            changes = [np.diff(_mean_of(x, count)) for x in own if len(x) > 2 * count]
            if not changes:
                return MOST_AVERAGED
            spread = float(np.sqrt(np.mean(np.concatenate([c - c.mean() for c in changes]) ** 2)))
            small &= np.sqrt(2.0 / count) * sd <= NOISE_SHARE * spread
        if small:
            return count
    return MOST_AVERAGED


def _pieces(changes: list[tuple[np.ndarray, ...]], shortest: int) -> list[tuple[np.ndarray, ...]]:
    """The changes of both tensions in each stretch; cut, where the stretches are few, into pieces no shorter
    than so many steps.
    """
    if len(changes) >= ENOUGH:
        return changes
    found = []
    for pair in changes:
        ends = np.linspace(0, len(pair[0]), len(pair[0]) // shortest + 1).astype(int)
        found += [tuple(x[a:b] for x in pair) for a, b in itertools.pairwise(ends.tolist())]
    return found


def _products(base: np.ndarray, tip: np.ndarray, reach: int, variances: tuple[float, float]) -> np.ndarray:
    """Sums of products and of squares at each lag of the tip, (3, 2 reach + 1), each tension without its mean
    and the squares without what noise adds.

    Once the base's middle part stays and the tip is shifted over it, once the tip's stays and the base is
    shifted: where rates grow along the piece, either alone draws the peak towards where they are large.
    """
    forth, back = (
        _shifted(base, tip, reach, variances),
        _shifted(tip, base, reach, (variances[1], variances[0]))[:, ::-1],
    )
    return forth + back[[0, 2, 1]]


def _shifted(fixed: np.ndarray, moved: np.ndarray, reach: int, variances: tuple[float, float]) -> np.ndarray:
    """Sums of products, and of squares of either, at each lag of what is moved, (3, 2 reach + 1)."""
    middle = fixed[reach : len(fixed) - reach]
    middle = middle - middle.mean()
    n = len(middle)
    centred = moved - moved.mean()
    sums, squares = (np.concatenate([[0.0], np.cumsum(x)]) for x in (centred, centred**2))
    own = squares[n:] - squares[:-n] - (sums[n:] - sums[:-n]) ** 2 / n
    products = np.correlate(centred, middle, "valid")
    noise_of_fixed, noise_of_moved = (n * variance for variance in variances)
    return np.stack(
        [products, np.full(len(products), middle @ middle - noise_of_fixed), own - noise_of_moved]
    )


def _curve(sums: np.ndarray) -> np.ndarray:
    """Correlation by lag."""
    return sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-300))


def _peak(curve: np.ndarray) -> float | None:
    """Place of the peak, by a parabola through its upper half; None at an end."""
    i, least = int(np.argmax(curve)), max(curve[0], curve[-1])
    below = np.flatnonzero(curve < 0.5 * (curve[i] + least))
    first = int(np.max(below[below < i], initial=-1)) + 1
    last = int(np.min(below[below > i], initial=len(curve))) - 1
    first, last = min(first, i - 1), max(last, i + 1)
    if first < 0 or last >= len(curve):
        return None
    at = np.arange(first, last + 1) - i
    bend, slope, _ = np.polyfit(at, curve[first : last + 1], 2)
    return i - float(slope / (2 * bend)) if bend < 0 else None
