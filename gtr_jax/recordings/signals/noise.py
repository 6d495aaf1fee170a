"""How noisy a recording is, before and after a fit, and how its errors are correlated."""

from __future__ import annotations

import dataclasses

import numpy as np

from . import differences
from .differences import MAD_TO_SD
from .stretches import runs

# Samples, without both ends, from which a locked stretch is used.
SHORTEST_LOCK = 6
# Degrees of freedom, and samples, from which a noise estimate is used.
FEWEST_DEGREES, FEWEST_SAMPLES = 12, 16
# Locked stretches that scatter this much more than neighbouring samples differ are not straight: that is
# friction creep, not noise.
CREEP = 2.0
# Correlations of neighbouring samples that are tried.
CORRELATIONS = np.linspace(0.0, 0.95, 20)
# Differences beyond this many standard deviations count as jumps.
TRIMMED = 3.5
# Expected correlation of neighbouring readings, and the number of samples that this prior counts for. With
# the correlation taken as zero below 120 samples, the estimated variance of slow noise was half the true one
# in the median over 190 recordings of the blind benchmark (0.07 of it in one of fifty); with this prior it is
# within 10 % (0.3).
USUAL_RHO, SAID = 0.25, 60


@dataclasses.dataclass(frozen=True)
class Noise:
    """How noisy a recorded channel is: a process whose neighbouring errors are correlated (AR(1)).

    Attributes:
        sd: standard deviation, in the unit of the channel, of the noise and the mesh's error together; NaN if
            unknown.
        rho: correlation between neighbouring samples; 0 unless it was estimated.
        mesh: standard deviation of the mesh's error; 0 unless it was estimated.
        source: what the noise was estimated from.
        degrees: effective degrees of freedom of the estimate; infinite if it was given.
    """

    sd: float
    rho: float = 0.0
    mesh: float = 0.0
    source: str = ""
    degrees: float = np.inf

    @property
    def sd_if_known(self) -> float | None:
        """The standard deviation; None if unknown."""
        return None if np.isnan(self.sd) else self.sd

    @property
    def cell(self) -> float:
        """Standard deviation of the noise alone."""
        return float(np.sqrt(max(self.sd**2 - self.mesh**2, 0.0)))


def resolution(x: np.ndarray) -> float:
    """Smallest step between distinct readings."""
    steps = np.diff(np.unique(x))
    return float(steps.min()) if steps.size else 0.0


def from_differences(x: np.ndarray) -> float | None:
    """Noise from third differences of neighbouring samples (see `differences`), and at least that of the
    resolution; None for fewer than FEWEST_SAMPLES.
    """
    if len(x) < FEWEST_SAMPLES:
        return None
    return max(differences.from_differences(x), resolution(x) / np.sqrt(12.0))


def from_locked(x: np.ndarray, locked: np.ndarray) -> tuple[float, float] | None:
    """Noise from stretches in which the tip is held by friction: scatter about each stretch's own straight
    line, by restricted maximum likelihood with errors that are correlated from sample to sample (AR(1)).

    Args:
        x: recorded tip tension [N], (K,).
        locked: where the model says that the tip tension does not change, (K,) bool.

    Returns:
        Standard deviation and effective degrees of freedom; None without a stretch long enough.
    """
    stretches = [x[a + 1 : b] for a, b in runs(locked, SHORTEST_LOCK + 2)]  # the ends touch slip
    if not stretches:
        return None
    degrees = sum(len(y) - 2 for y in stretches)
    best, likeliest, at = 0.0, -np.inf, 0.0
    for rho in CORRELATIONS:
        squares, determinants = 0.0, 0.0
        for y in stretches:
            t = np.linspace(-1, 1, len(y))
            white = whitened(np.stack([y, np.ones(len(y)), t], axis=1), rho)
            q, r = np.linalg.qr(white[:, 1:])
            squares += float(np.sum((white[:, 0] - q @ (q.T @ white[:, 0])) ** 2))
            determinants += (len(y) - 1) * np.log1p(-(rho**2)) + 2 * np.sum(np.log(np.abs(np.diag(r))))
        if squares == 0:
            return 0.0, degrees
        likelihood = -degrees * np.log(squares) - determinants
        if likelihood > likeliest:
            best, likeliest, at = squares, likelihood, rho
    return float(np.sqrt(best / degrees)), degrees * (1 - at**2) / (1 + at**2)


def whitened(rows: np.ndarray, rho: float) -> np.ndarray:
    """Turn AR(1) errors of unit variance, (n, ...), into independent ones of unit variance."""
    return np.concatenate([rows[:1], (rows[1:] - rho * rows[:-1]) / np.sqrt(1 - rho**2)])


def from_repeats(T_base: np.ndarray, T_tip: np.ndarray, trial: np.ndarray | None) -> tuple[float, int] | None:
    """Noise from trials that repeat one load history: scatter of T_tip between them, sample by sample.

    The first trial is left out where there are three or more: it starts from another state.
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
    T_base: np.ndarray,
    T_tip: np.ndarray,
    trial: np.ndarray | None,
    locked: np.ndarray | None,
) -> Noise:
    """The best estimate the recording offers: repeats and locked stretches, else differences of neighbours.

    The noise of the base cell enters none of these, because the tip follows the true tension.

    Args:
        T_base, T_tip: as recorded [N], (K,).
        trial: number of the trial, (K,); None if there is only one.
        locked: where the fitted model holds the tip, (K,) bool; None before a fit.
    """
    floor = resolution(T_tip) / np.sqrt(12.0)
    near = from_differences(T_tip)
    found: dict[str, tuple[float, float]] = {}
    repeats = from_repeats(T_base, T_tip, trial)
    if repeats is not None:
        found["repeated trials"] = max(repeats[0], floor), repeats[1]
    held = None if locked is None else from_locked(T_tip, locked)
    if held is not None and (near is None or held[0] <= CREEP * near):
        found["stretches in which friction holds the tip"] = max(held[0], floor), held[1]
    degrees = sum(d for _, d in found.values())
    if degrees >= FEWEST_DEGREES:
        sd = float(np.sqrt(sum(d * sd**2 for sd, d in found.values()) / degrees))
        return Noise(sd, source=", ".join(found), degrees=degrees)
    if near is None:
        return Noise(np.nan, source="too few samples")
    return Noise(near, source="differences of neighbouring samples", degrees=len(T_tip) / 3)


def _spread(x: np.ndarray) -> float:
    """Standard deviation without outliers."""
    rough = MAD_TO_SD * float(np.median(np.abs(x)))
    inside = np.abs(x) < TRIMMED * rough
    return float(np.sqrt(np.mean(x[inside] ** 2))) if inside.any() else rough


def of_residual(residual: np.ndarray, least: float) -> Noise:
    """Noise from the differences of a residual between samples one and two apart.

    A misfit varies slowly from sample to sample and hardly enters; its jumps are left out. Few samples
    determine the correlation of neighbours poorly, so the estimate is drawn towards `USUAL_RHO`.
    """
    near, far = (_spread(residual[k:] - residual[:-k]) for k in (1, 2))
    if near <= 0 or len(residual) < 16:
        return Noise(max(float(near) / np.sqrt(2), least))
    K = len(residual)
    rho = float(np.clip((K * ((far / near) ** 2 - 1) + SAID * USUAL_RHO) / (K + SAID), 0.0, 0.8))
    return Noise(max(float(near) / np.sqrt(2 * (1 - rho)), least), rho)


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
