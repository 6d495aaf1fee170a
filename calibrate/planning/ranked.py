"""An experiment and what it is worth."""

from __future__ import annotations

import dataclasses

import numpy as np

from .candidates import Candidate
from .worth import pairs


@dataclasses.dataclass(frozen=True, eq=False)
class Ranked:
    """An experiment and what it is worth.

    Attributes:
        candidate: the experiment.
        worth: by which it is ranked; see `worth`.
        separation: of each pair of the m models [standard errors], (m, m).
        sd: standard deviation of each number of the first model after it, SI, (p,).
        confirmed: whether the separation counts every rival refitted, and not only to first order; of one
            model, whether the standard deviations were checked.
    """

    candidate: Candidate
    worth: float
    separation: np.ndarray
    sd: np.ndarray
    confirmed: bool = False

    @property
    def least(self) -> float:
        """Distance of the two models that it tells apart least [standard errors]; infinite for one model."""
        return float(np.min(pairs(self.separation), initial=np.inf))
