"""A set of hypotheses as a model with free numbers, and what a refit of it finds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calibrate.inference.number import Number
from calibrate.inference.simulated_readings import SimulatedReadings

from .hypotheses import Hypothesis

# Each load step that fails adds this many variances to the cost.
FAILED = 1e3


class Model(NamedTuple):
    """Names of the hypotheses that act, the free numbers, mu and E first, and the fixed numbers."""

    names: tuple[str, ...]
    numbers: tuple[Number, ...]
    fixed: Mapping[str, float]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the coordinates, (p,) each."""
        low, high = (np.asarray([n.bounds[k] for n in self.numbers]) for k in (0, 1))
        return low, high

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Values at coordinates, SI, by name."""
        return dict(self.fixed) | {n.name: n.value(v) for n, v in zip(self.numbers, x, strict=True)}


def model_of(base: tuple[Number, ...], hypotheses: Sequence[Hypothesis]) -> Model:
    """The base numbers, and those of some hypotheses."""
    fixed = {name: value for h in hypotheses for name, value in h.fixed.items()}
    numbers = (*base, *(n for h in hypotheses for n in h.numbers))
    return Model(names=tuple(h.name for h in hypotheses), numbers=numbers, fixed=fixed)


class Point(NamedTuple):
    """A model at coordinates: values by name [SI], simulations, and white residuals (n,)."""

    values: Mapping[str, float]
    seen: tuple[SimulatedReadings, ...]
    rows: np.ndarray

    @property
    def failed(self) -> int:
        """Load steps that did not converge."""
        return sum(s.failed for s in self.seen)

    @property
    def penalty(self) -> float:
        """What failed load steps add to the sum of squares."""
        return FAILED * self.failed


@dataclasses.dataclass(frozen=True, eq=False)
class Fitted:
    """A set of hypotheses refitted.

    Attributes:
        names: of the hypotheses; none for the base model.
        numbers: free ones, mu and E first.
        x: their coordinates.
        values: of the free and the fixed numbers, SI, by name.
        rows: white residuals at the solution.
        jacobian: of the rows by x.
        chi2: sum of squares of the rows.
        prior: sum of squares of the coordinates under their priors.
        seen: the simulations, with the uncertain dimensions moved to fit best.
        failed: steps that did not converge.
        dimensions: values of the uncertain dimensions [SI], by name.
    """

    names: tuple[str, ...]
    numbers: tuple[Number, ...]
    x: np.ndarray
    values: Mapping[str, float]
    rows: np.ndarray
    jacobian: np.ndarray
    chi2: float
    prior: float
    seen: tuple[SimulatedReadings, ...]
    failed: int
    dimensions: Mapping[str, float]

    @property
    def cost(self) -> float:
        """What is minimised; load steps that failed count against it."""
        return self.chi2 + self.prior + FAILED * self.failed

    def volume(self, scale: float = 1.0) -> float:
        """Log of the Occam factor, by Laplace's approximation: of the share of the prior that the data leave,
        and of the prior's density there; for rows whose variance is `scale`.
        """
        # The prior of a size that cannot be negative is half a normal distribution, twice as dense.
        halves = sum(n.size and not n.log and n.bounds[0] > -0.5 for n in self.numbers)
        logdet = np.linalg.slogdet(self.information(scale))[1]
        return float(-0.5 * self.prior - 0.5 * logdet + halves * np.log(2.0))

    def information(self, scale: float = 1.0) -> np.ndarray:
        """Fisher information of data and priors about the coordinates, (p, p)."""
        return self.jacobian.T @ self.jacobian / scale + np.eye(len(self.x))
