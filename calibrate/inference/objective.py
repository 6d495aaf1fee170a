"""The least squares problem of a fit."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeGuard

import numpy as np

from gtr_jax.recordings.base_tension import exact

from .coordinates import Coordinates
from .predictor import Predictor
from .setup import Observation, Setup
from .simulated_readings import Prediction, simulate_all
from .weighing import Weighing

# Range searched: this factor up and down for a positive parameter; this many scales to each side for others.
LARGEST_FACTOR = 30.0
LARGEST_SHIFT = 2.0
# Standard deviations of a prior to each side that are searched, where they are more than these scales.
FARTHEST = 4.0
# Steps up to which a thinned recording is simulated by the program of the whole one: to simulate held steps
# takes 0.03 ms each, to trace and read another program 1.5 s, and to compile it 8 s.
SHARED = 1024


@dataclasses.dataclass(frozen=True)
class Objective:
    """What is minimised: sum of squares of weighed residuals, and of prior rows ((u - centre) precision)^2.

    Attributes:
        predictors: simulate the recordings.
        parts: the recordings.
        weighs: how the residuals of each are weighed.
        centre: prior means of the coordinates, (p,).
        precision: 1/sd of the priors, (p,); 0 without prior.
        reach: largest |u|, (p,).
    """

    predictors: tuple[Predictor, ...]
    parts: tuple[Observation, ...]
    weighs: tuple[Weighing, ...]
    centre: np.ndarray
    precision: np.ndarray
    reach: np.ndarray

    @staticmethod
    def of(setup: Setup, at: Sequence[Coordinates], parts: Sequence[Observation] | None = None) -> Objective:
        """The least squares problem: residuals of recordings, with one error for each channel, and priors.

        Args:
            setup: what is fitted to what.
            at: coordinates of each recording.
            parts: the recordings; those of the setup unless given.
        """
        parts = setup.parts if parts is None else parts
        log, scale = np.asarray(at[0].log), np.asarray(at[0].scale)
        has = np.asarray([p is not None for p in setup.priors])
        sd = np.asarray([p or 1.0 for p in setup.priors])
        spread = sd / np.where(log, np.where(setup.initial > 0, setup.initial, 1.0), scale)
        far = FARTHEST * spread
        start = at[0].at(np.where(has, setup.initial, np.asarray(at[0].reference)))
        return Objective(
            predictors=tuple(
                Predictor(
                    p.robot,
                    a,
                    p.drive,
                    p.time,
                    p.nodes(),
                    p.trial,
                    channels=p.channels,
                    length=whole.steps if whole.steps <= SHARED else 0,
                    orientation=p.orientation,
                )
                for p, whole, a in zip(parts, setup.parts, at, strict=True)
            ),
            parts=tuple(parts),
            weighs=tuple(Weighing.plain(exact(p.T_base.T_base), p.channels, p.rough()) for p in parts),
            centre=np.where(has, start, 0.0),
            precision=np.where(has, 1 / np.where(has, spread, 1.0), 0.0),
            reach=np.where(
                log, np.log(LARGEST_FACTOR), np.where(has, np.maximum(LARGEST_SHIFT, far), LARGEST_SHIFT)
            ),
        )

    def predict(self, u: np.ndarray) -> tuple[Prediction, ...] | None:
        """The recordings at coordinates u, (p,); None where the simulator breaks down."""
        return simulate_all(self.predictors, [u], in_threads=True)[0]

    def residuals(self, predictions: tuple[Prediction, ...]) -> np.ndarray:
        """Weighed residuals of all recordings, (D,)."""
        return np.concatenate(
            [
                weigh(part.residual(prediction))
                for part, weigh, prediction in zip(self.parts, self.weighs, predictions, strict=True)
            ]
        )

    def jacobian(self, predictions: tuple[Prediction, ...]) -> np.ndarray:
        """Derivatives of the weighed residuals with respect to the coordinates, (D, p)."""
        return np.concatenate(
            [weigh(prediction.jacobian) for weigh, prediction in zip(self.weighs, predictions, strict=True)]
        )

    def prior(self, u: np.ndarray) -> np.ndarray:
        """Residuals of the priors, (p,), at u."""
        return (u - self.centre) * self.precision

    def rows(self, u: np.ndarray, predictions: tuple[Prediction, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of data and priors, (D+p,), and their Jacobian, (D+p, p), at u."""
        data, slopes = self.residuals(predictions), self.jacobian(predictions)
        return np.concatenate([data, self.prior(u)]), np.concatenate([slopes, np.diag(self.precision)])

    def cost(self, u: np.ndarray, predictions: tuple[Prediction, ...] | None) -> float:
        """Sum of squares; infinite where a simulation failed."""
        if not all_converged(predictions):
            return np.inf
        return float(np.sum(self.residuals(predictions) ** 2) + np.sum(self.prior(u) ** 2))


def all_converged(predictions: tuple[Prediction, ...] | None) -> TypeGuard[tuple[Prediction, ...]]:
    """Whether every load step of every recording met its tolerance."""
    return predictions is not None and all(p.converged for p in predictions)
