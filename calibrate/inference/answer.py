"""The errors that the residuals at the end of a descent show, and the parameters' uncertainty from them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gtr_jax.recordings.signals.noise import Noise, correlation_time

from .coordinates import Coordinates
from .descent import Descent
from .estimate import UNKNOWN, UNKNOWN_WITHOUT_SCALE, Uncertainty, shares_of_variance, uncertainty
from .objective import Objective
from .setup import Observation, Setup
from .simulated_readings import Prediction
from .weighing import Weighing

# Rounds, at most, of scaling the errors until chi-square per degree of freedom is 1.
LEVELLING = 12
# Threshold of Huber's estimator, in standard deviations, at which it is 95 % as efficient as least squares
# for normal errors; and the mean square of normal errors clipped there.
HUBER, HUBER_SQUARES = 1.345, 0.7102
# Least factor on a variance in one round of a robust fit; share of its weight below which a sample is an
# outlier.
LEAST_STEP, HALF = 0.25, 0.5
# Sources of the variance of an estimate, besides the uncertain numbers.
TIP_CELL, OTHERS, BASE_CELL, DRAWN = (
    "noise of the tip cell",
    "noise of pose and displacement",
    "noise of the base cell",
    "noise of the displacement that drives",
)


def together(noises: Sequence[Noise]) -> Noise:
    """The noise of the tip tensions of several tendons as one: its root mean square; unknown for none."""
    if not noises:
        return Noise(np.nan)
    if len(noises) == 1:
        return noises[0]
    return Noise(
        sd=float(np.sqrt(np.mean([noise.sd**2 for noise in noises]))),
        source=", ".join(dict.fromkeys(noise.source for noise in noises)),
        degrees=sum(noise.degrees for noise in noises),
    )


def by_source(rows: np.ndarray, parts: Sequence[Observation]) -> dict[str, np.ndarray]:
    """Split the weighed rows of all recordings, (D, ...), by the source of their noise. Each recording has C
    channels of K rows, the tip tensions that it has first, and then K rows of what drives each tendon.
    """
    found: dict[str, list[np.ndarray]] = {}
    start = 0
    for part in parts:
        C, K, tips = len(part.channels), part.samples, part.tips
        drives = [(BASE_CELL if tendon.drive == "tension" else DRAWN, K) for tendon in part.robot.tendons]
        for label, n in ((TIP_CELL, tips * K), (OTHERS, (C - tips) * K), *drives):
            found.setdefault(label, []).append(rows[start : start + n])
            start += n
    return {label: np.concatenate(of) for label, of in found.items()}


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """The errors of one recording, as its residual shows them.

    Attributes:
        residual: simulated minus recorded, (C, K).
        phases: (K, *tendons).
        noises: of each recorded tip tension.
        weigh: weighing by errors with the size and correlation time that the residual shows.
        by_noise: weighing by the noise alone.
        chi2_per_n: sum of squares of the tensions per degree of freedom, in units of the noise; None if that
            is unknown.
        sd: standard deviation that each channel's errors are given, (C,).
        least: least standard deviation of each channel, from its noise or its neighbouring samples, (C,).
        kept: samples that count at least half, (K,); all of them unless the fit is robust.
    """

    residual: np.ndarray
    phases: np.ndarray
    noises: tuple[Noise, ...]
    weigh: Weighing
    by_noise: Weighing
    chi2_per_n: float | None
    sd: np.ndarray
    least: np.ndarray
    kept: np.ndarray

    @property
    def rms(self) -> float:
        """Root mean square of the residual of the tip tensions, over kept samples [N]."""
        return self.rms_of(self.residual[: len(self.noises)])

    def rms_of(self, rows: np.ndarray) -> float:
        """Root mean square of rows, (..., K), over kept samples; over all where none is kept."""
        return float(np.sqrt(np.mean((rows[..., self.kept] if self.kept.any() else rows) ** 2)))

    @property
    def noise(self) -> Noise:
        """Noise of the recorded tip tensions, of all tendons together."""
        return together(self.noises)


@dataclasses.dataclass(frozen=True, eq=False)
class Answer:
    """The point where a descent ended, and the errors that the residuals there show.

    Attributes:
        at: coordinates of each recording.
        problem: the least squares problem, weighed by the errors as the residuals show them.
        descent: where its descent ended.
        judged: errors of each recording.
    """

    at: tuple[Coordinates, ...]
    problem: Objective
    descent: Descent
    judged: tuple[Judged, ...]

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """The simulations there."""
        assert self.descent.predictions is not None  # `of` has seen to it
        return self.descent.predictions

    @functools.cached_property
    def jacobian(self) -> np.ndarray:
        """Derivatives of the weighed residuals there, (D, p)."""
        return self.problem.jacobian(self.predictions)

    def known(self, setup: Setup) -> Uncertainty:
        """Uncertainty from data and priors at this point; a coordinate at the end of its range counts as
        unknown.
        """
        log = np.asarray(self.at[0].log)
        unknown = np.where(log | (setup.initial != 0), UNKNOWN, UNKNOWN_WITHOUT_SCALE)
        unknown = np.where(self.descent.at_edge | self.at[0].stopped(self.descent.u), 0.0, unknown)
        return uncertainty(self.jacobian, 1.0, self.problem.precision, unknown)

    def spread(self, setup: Setup) -> np.ndarray:
        """Covariance of the coordinates, (p, p): of the fit where it is known, else of the prior, else 0."""
        covariance, precision = self.known(setup).covariance, self.problem.precision
        seen = np.isfinite(np.diag(covariance))
        alone = np.where(precision > 0, 1 / np.where(precision > 0, precision, 1.0), 0.0) ** 2
        return np.where(np.outer(seen, seen), covariance, 0.0) + np.diag(np.where(seen, 0.0, alone))

    def sources(self, setup: Setup) -> tuple[list[str], np.ndarray]:
        """Shares of the variance of each coordinate by source: noise of the tip cell, of the other channels,
        of the base cell, and each prior; see `shares_of_variance`.
        """
        precision = self.problem.precision
        priors = {f.name: row for f, row in zip(setup.free, np.diag(precision), strict=True) if row.any()}
        return shares_of_variance(by_source(self.jacobian, setup.parts), priors)

    def information_about(self, asked: int) -> np.ndarray:
        """Marginal Fisher information about the first `asked` coordinates, (asked, asked)."""
        whole = self.information()
        cross, rest = whole[:asked, asked:], whole[asked:, asked:]
        return whole[:asked, :asked] - cross @ np.linalg.solve(rest, cross.T)

    def information(self) -> np.ndarray:
        """Fisher information of data and priors in the coordinates, (p, p)."""
        return self.jacobian.T @ self.jacobian + np.diag(self.problem.precision**2)

    def information_at(
        self, values: np.ndarray, predictions: tuple[Prediction, ...] | None = None
    ) -> np.ndarray:
        """The same about the numbers themselves, per product of their SI units, where they have some values,
        (p,): (p, p). Where the simulations at these values are given, with the derivatives there: what cannot
        be told apart is another combination in another place.
        """
        at = self.at[0]
        unit = np.where(np.asarray(at.log), values, np.asarray(at.scale))
        slopes = self.jacobian if predictions is None else self.problem.jacobian(predictions)
        known = slopes.T @ slopes + np.diag(self.problem.precision**2)
        return known / np.outer(unit, unit)

    @staticmethod
    def of(setup: Setup, at: tuple[Coordinates, ...], problem: Objective, descent: Descent) -> Answer:
        """Judge the point where a descent ended."""
        assert descent.predictions is not None  # the start was simulated before the descent began
        judged = tuple(map(functools.partial(_judged, setup), setup.parts, descent.predictions))
        weighed = dataclasses.replace(problem, weighs=tuple(j.weigh for j in judged))
        return Answer(at=at, problem=weighed, descent=descent, judged=judged)


def _judged(setup: Setup, part: Observation, prediction: Prediction) -> Judged:
    residual, noises = part.residual(prediction), part.noises(prediction)
    found = _levelled(setup, part, prediction, noises)
    kept = np.all(found.share >= HALF, axis=0)
    if not kept.all():
        noises = part.noises(prediction, kept)
        found = _levelled(setup, part, prediction, noises)
        kept = np.all(found.share >= HALF, axis=0)
    tau = np.asarray([correlation_time(row) for row in found.weigh.split(residual)[0]])
    return Judged(
        residual=residual,
        phases=prediction.phases,
        noises=noises,
        weigh=dataclasses.replace(found.weigh, tau=tau),
        by_noise=found.by_noise,
        chi2_per_n=found.chi2 if together(noises).sd_if_known else None,
        sd=found.sd,
        least=part.least(noises),
        kept=kept,
    )


class _Levelled(NamedTuple):
    """Weighing by errors scaled to the residual; weighing by the noise alone; chi-square of the tensions per
    degree of freedom, in units of the noise; errors, (C,); and the share of its weight that each residual
    keeps, (C, K).
    """

    weigh: Weighing
    by_noise: Weighing
    chi2: float
    sd: np.ndarray
    share: np.ndarray


def _levelled(setup: Setup, part: Observation, prediction: Prediction, noises: Sequence[Noise]) -> _Levelled:
    """Weigh the residual by the noise of each channel; where the noise does not explain it, by an error
    scaled up until it does.
    """
    residual, least, n = part.residual(prediction), part.least(noises), part.tips
    degrees, among = np.full(len(least), float(part.samples)), n or len(least)
    degrees[:among] = max(part.samples - len(setup.free) * part.samples / (among * setup.samples), 1.0)
    share = np.ones_like(residual)

    def weighed(sd: np.ndarray) -> tuple[Weighing, np.ndarray]:
        weigh = part.weighing(prediction.slips, prediction.slopes, sd, part.stretch(prediction.T_tip))
        return weigh, part.pooled_squares(_squares(setup, weigh, residual, share, n) / degrees)

    weigh, chi2 = weighed(least)
    by_noise, sd = weigh, least
    for _ in range(LEVELLING):
        if setup.robust:
            share = _trust(weigh.trusted(np.sqrt(share)).split(residual)[0], share)
            sd = np.maximum(sd * np.sqrt(np.maximum(chi2, LEAST_STEP)), least)
        elif np.all(chi2 <= 1.0):
            break
        else:
            sd = sd * np.sqrt(np.maximum(chi2, 1.0))
        weigh, chi2 = weighed(sd)
    root = np.sqrt(share)
    in_noise = np.nan
    if n:
        in_noise = float(np.sum(_squares(setup, by_noise, residual, share, n)[:n]) / np.sum(degrees[:n]))
    return _Levelled(
        weigh=weigh.trusted(root), by_noise=by_noise.trusted(root), chi2=in_noise, sd=sd, share=share
    )


def _trust(rows: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Shares of their weight that Huber's estimator gives residuals; the rows are weighed with the present
    shares.
    """
    size = np.abs(rows) / np.sqrt(np.maximum(share, 1e-12))
    return np.minimum(1.0, HUBER / np.maximum(size, 1e-12))


def _squares(setup: Setup, weigh: Weighing, residual: np.ndarray, share: np.ndarray, tips: int) -> np.ndarray:
    """Sum of squares of each channel, (C,); the rows of what drives a tendon count with its tip tension, and
    where there are none with all channels, as their errors draw on the drives. In a robust fit, residuals are
    clipped and compared with clipped normal errors.
    """
    weigh = weigh.trusted(np.sqrt(share))
    rows, base = weigh.split(residual)
    if not setup.robust:
        rows = rows**2
    else:
        rows = np.minimum(np.abs(rows) / np.sqrt(np.maximum(share, 1e-12)), HUBER) ** 2 / HUBER_SQUARES
    total = np.sum(rows, axis=1)
    if tips:
        total[:tips] += np.sum(base.reshape(tips, -1) ** 2, axis=1)
    else:
        drawn = np.sum((weigh.weight * weigh.passed) ** 2, axis=1)
        total += np.sum(base**2) * drawn / max(float(np.sum(drawn)), 1e-300)
    return total
