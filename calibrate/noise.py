"""How noisy a recording is, before and after a fit, and how far its errors hang together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

MAD_TO_SD = 1.4826
SHORTEST_LOCK = 6
FEWEST_DEGREES = 12
# Locked stretches that scatter this much more than neighbours differ are not straight: friction creep, not
# noise.
CREEP = 2.0


class Noise(NamedTuple):
    """How noisy a recording is.

    Attributes:
        sd: standard deviation of the recorded tip tension [N]; None if it cannot be told.
        source: where it was seen.
        base: standard deviation of the recorded base tension [N] that `sd` does not contain; 0 if it does.
    """

    sd: float | None
    source: str
    base: float = 0.0

    def passed_on(self, slope: np.ndarray) -> np.ndarray | None:
        """Standard deviation expected of each residual [N], (K,): that of the tip, and that of the base as
        the model passes it on.

        Args:
            slope: dT_tip/dT_base within the step, (K,); 0 where the tip is locked.
        """
        return None if not self.sd else np.sqrt(self.sd**2 + (slope * self.base) ** 2)


def resolution(x: np.ndarray) -> float:
    """Smallest step between distinct readings."""
    steps = np.diff(np.unique(x))
    return float(steps.min()) if steps.size else 0.0


def from_differences(x: np.ndarray) -> float | None:
    """Noise from third differences of neighbouring samples, by the median: reversals are too few to count.

    Third differences cancel a smooth signal up to quadratic. Noise correlated between neighbours is
    underestimated, and a coarsely sampled loop is mistaken for noise.
    """
    if len(x) < 8:
        return None
    third = np.convolve(x, [1, -3, 3, -1], "valid") / np.sqrt(20.0)
    sd = MAD_TO_SD * float(np.median(np.abs(third)))
    return max(sd, resolution(x) / np.sqrt(12.0))


def from_locked(x: np.ndarray, locked: np.ndarray) -> tuple[float, int] | None:
    """Noise from stretches in which the tip is held by friction: scatter about each stretch's own straight
    line.

    Args:
        x: recorded tip tension [N], (K,).
        locked: where the model says that the tip tension does not change, (K,) bool.

    Returns:
        Standard deviation and degrees of freedom; None without a stretch long enough.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], locked.astype(int), [0]])))
    squares, degrees = 0.0, 0
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        a, b = a + 1, b - 1  # the ends touch slip
        if b - a < SHORTEST_LOCK:
            continue
        t = np.arange(b - a)
        squares += float(np.sum((x[a:b] - np.polyval(np.polyfit(t, x[a:b], 1), t)) ** 2))
        degrees += b - a - 2
    return (float(np.sqrt(squares / degrees)), degrees) if degrees else None


def from_repeats(T_base: np.ndarray, T_tip: np.ndarray, trial: np.ndarray | None) -> tuple[float, int] | None:
    """Noise from trials that repeat one load history: scatter of T_tip between them, sample by sample.

    The first trial is left out where there are three or more: it starts from another state. Contains what
        noise in T_base does.
    """
    if trial is None:
        return None
    parts = [np.flatnonzero(trial == k) for k in np.unique(trial)]
    parts = parts[1:] if len(parts) > 2 else parts
    length = min(len(p) for p in parts)
    if len(parts) < 2 or length < 3 or max(len(p) for p in parts) - length > 1:
        return None
    base = np.stack([T_base[p[-length:]] for p in parts])
    if np.max(np.std(base, axis=0)) > 0.01 * np.max(np.abs(T_base)):
        return None
    tip = np.stack([T_tip[p[-length:]] for p in parts])
    return float(np.sqrt(np.mean(np.var(tip, axis=0, ddof=1)))), length * (len(parts) - 1)


def estimate(
    T_base: np.ndarray, T_tip: np.ndarray, trial: np.ndarray | None, locked: np.ndarray | None
) -> Noise:
    """The best estimate the recording offers: repeats, else locked stretches, else differences of neighbours.

    Args:
        T_base, T_tip: as recorded [N], (K,).
        trial: number of the trial, (K,); None if there is one.
        locked: where the fitted model holds the tip, (K,) bool; None before a fit.
    """
    near, base = from_differences(T_tip), from_differences(T_base) or 0.0
    repeats = from_repeats(T_base, T_tip, trial)
    if repeats is not None and repeats[1] >= FEWEST_DEGREES:
        return Noise(max(repeats[0], resolution(T_tip) / np.sqrt(12.0)), "repeated trials")
    held = None if locked is None else from_locked(T_tip, locked)
    if held is not None and held[1] >= FEWEST_DEGREES and (near is None or held[0] <= CREEP * near):
        return Noise(
            max(held[0], resolution(T_tip) / np.sqrt(12.0)), "stretches in which friction holds the tip", base
        )
    return Noise(near, "differences of neighbouring samples" if near is not None else "too few samples", base)


def correlation_time(residual: np.ndarray) -> float:
    """Samples per independent one: 1 + 2 sum of autocorrelations, up to where pairs of them cease to be
    positive.

    Geyer's initial positive sequence. At least 1 (alternating errors get no credit), at most a third of the
    samples.
    """
    x = np.asarray(residual) - np.mean(residual)
    n, power = len(x), float(np.sum(np.square(x)))
    if n < 4 or power == 0:
        return 1.0
    spectrum = np.abs(np.fft.rfft(x, 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[:n] / power
    pairs = rho[: n // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    last = negative[0] if negative.size else len(pairs)
    return float(np.clip(2 * np.sum(pairs[:last]) - 1, 1.0, max(n / 3, 1.0)))
