"""What the residual at the end of a descent says of the errors, and what these leave of the parameters."""

from __future__ import annotations

import dataclasses

import numpy as np

from .coordinates import Coordinates, Prediction
from .descent import Descent, Objective
from .estimate import UNKNOWN, Uncertainty, uncertainty
from .noise import Noise, correlation_time
from .task import Part, Task
from .weighing import Weighing

LEVELLING = 12
# Huber's estimator: 95 % as efficient as least squares for normal errors; and what their squares, cut off
# there, are on average.
HUBER, HUBER_SQUARES = 1.345, 0.7102
LEAST_STEP = 0.25
# A parameter that is zero in the robot file has no size to compare its error with: so many of its units.
UNKNOWN_WITHOUT_SCALE = 10.0


@dataclasses.dataclass(frozen=True, eq=False)
class Judged:
    """What the residual of one recording says of its errors.

    Attributes:
        residual: simulated minus recorded, (C, K).
        phases: (K,).
        noise: of the recorded tip tension.
        weigh: residuals weighed with errors as large, and as long, as they show.
        by_noise: weighed with the noise alone.
        chi2_per_n: sum of squares per degree of freedom, in units of the noise; None if that cannot be told.
        sd: error that each channel is given, (C,).
        least: error of each channel that its neighbouring samples, or its noise, show, (C,).
        outliers: samples that count less than half, of a robust fit.
    """

    residual: np.ndarray
    phases: np.ndarray
    noise: Noise
    weigh: Weighing
    by_noise: Weighing
    chi2_per_n: float | None
    sd: np.ndarray
    least: np.ndarray
    outliers: int

    @property
    def rms(self) -> float:
        """Of the tip tension [N]."""
        return float(np.sqrt(np.mean(self.residual[0] ** 2)))


@dataclasses.dataclass(frozen=True, eq=False)
class Answer:
    """A point and what the residuals there say of the errors.

    Attributes:
        at: coordinates of each recording.
        problem: the least squares problem, weighed by the errors as the residuals show them.
        descent: where its descent ended.
        judged: of each recording.
    """

    at: tuple[Coordinates, ...]
    problem: Objective
    descent: Descent
    judged: tuple[Judged, ...]

    @property
    def predictions(self) -> tuple[Prediction, ...]:
        """The simulations there."""
        assert self.descent.predictions is not None  # the start was simulated before the descent began
        return self.descent.predictions

    def known(self, task: Task) -> Uncertainty:
        """What data and priors say at this point; nothing of what ran to the end of its range."""
        log = np.asarray(self.at[0].log)
        unknown = np.where(log | (task.initial != 0), UNKNOWN, UNKNOWN_WITHOUT_SCALE)
        unknown = np.where(self.descent.at_edge, 0.0, unknown)
        return uncertainty(self.problem.jacobian(self.predictions), 1.0, self.problem.precision, unknown)

    def information(self) -> np.ndarray:
        """Fisher information of data and priors in the coordinates, (p, p)."""
        jacobian = self.problem.jacobian(self.predictions)
        return jacobian.T @ jacobian + np.diag(self.problem.precision**2)

    def with_judgement(self, task: Task) -> Answer:
        """The same, weighed anew."""
        judged = tuple(
            _judged(task, part, prediction)
            for part, prediction in zip(task.parts, self.predictions, strict=True)
        )
        problem = dataclasses.replace(self.problem, weighs=tuple(j.weigh for j in judged))
        return dataclasses.replace(self, judged=judged, problem=problem)

    @staticmethod
    def of(task: Task, at: tuple[Coordinates, ...], problem: Objective, descent: Descent) -> Answer:
        """Judge the point where a descent ended."""
        return Answer(at, problem, descent, ()).with_judgement(task)


def _judged(task: Task, part: Part, prediction: Prediction) -> Judged:
    """The weighing that the residual asks for, with the noise of each channel or, where that does not explain
    it, with as much as does.
    """
    base, residual, noise = part.T_base, part.residual(prediction), part.noise(prediction)
    least = part.least(noise.sd)
    used = len(task.free) * part.samples / task.samples
    degrees = np.full(len(least), float(part.samples))
    degrees[0] = max(part.samples - used, 1.0)
    share = np.ones_like(residual)

    def weighed(sd: np.ndarray) -> tuple[Weighing, np.ndarray]:
        weigh = Weighing.of(base, prediction, part.channels, sd, base.believed)
        return weigh, _chi2(task, weigh, residual, share, degrees)

    weigh, chi2 = weighed(least)
    by_noise = weigh
    first = float(chi2[0]) if noise.sd else None
    sd = least
    for _ in range(LEVELLING):
        if task.robust:
            share = _trust(weigh.trusted(np.sqrt(share)).split(residual)[0], share)
        elif np.all(chi2 <= 1.0):
            break
        sd = (
            np.maximum(sd * np.sqrt(np.maximum(chi2, LEAST_STEP)), least)
            if task.robust
            else (sd * np.sqrt(np.maximum(chi2, 1.0)))
        )
        weigh, chi2 = weighed(sd)
    weigh = weigh.trusted(np.sqrt(share))
    rows = weigh.split(residual)[0]
    tau = np.asarray([correlation_time(row) for row in rows])
    outliers = int(np.sum(np.any(share < 0.5, axis=0)))
    weigh = dataclasses.replace(weigh, tau=tau)
    by_noise = by_noise.trusted(np.sqrt(share))
    return Judged(residual, prediction.phases, noise, weigh, by_noise, first, sd, least, outliers)


def _trust(rows: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Shares of the weight that Huber's estimator gives residuals, from those weighed so far."""
    size = np.abs(rows) / np.sqrt(np.maximum(share, 1e-12))
    return np.minimum(1.0, HUBER / np.maximum(size, 1e-12))


def _chi2(
    task: Task, weigh: Weighing, residual: np.ndarray, share: np.ndarray, degrees: np.ndarray
) -> np.ndarray:
    """Sum of squares per degree of freedom of each channel, the base tension's with the first, (C,); of a
    robust fit that of residuals cut off, in units of what normal ones have.
    """
    rows, base = weigh.trusted(np.sqrt(share)).split(residual)
    if not task.robust:
        rows = rows**2
    else:
        rows = np.minimum(np.abs(rows) / np.sqrt(np.maximum(share, 1e-12)), HUBER) ** 2 / HUBER_SQUARES
    total = np.sum(rows, axis=1)
    total[0] += np.sum(base**2)
    return total / degrees
