"""Residuals weighed with the noise of both cells: the base tension's passes on to the tip wherever it slips.

While the whole tendon slips, T_tip follows the base tension of that moment with the slope g = dT_tip/dT_base;
while friction holds the tip, T_tip stays that of the sample at which it slipped last. So the simulated T_tip
of a sample depends on one true base tension, and through it on two knots (`base_tension.py`), whose values v
are known from the recording with a tridiagonal information matrix. Minimising over v,

    min_dv |r + G B dv|^2/sd_tip^2 + |B dv|^2/sd_base^2,

is linear in the residual r and costs as much as a tridiagonal solve. The errors that a plateau has in common
with the peak before it are thus counted once, and a plateau says of friction what it should: nothing, beyond
what the peak says.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from .base_tension import BaseTension
from .coordinates import Prediction


@dataclasses.dataclass(frozen=True, eq=False)
class Weighing:
    """Turns residuals of K samples into 2K that are independent and of unit variance, as far as noise goes.

    Attributes:
        base: the base tension and its knots.
        slope: dT_tip/dT_base, the latter that of sample `last`, (K,).
        last: sample at which the tip slipped last, (K,).
        weight: 1/sd of the recorded tip tension [1/N], (K,); 0 leaves a sample out.
        sd_base: standard deviation of the recorded base tension [N], to be believed; 0: it is exact.
    """

    base: BaseTension
    slope: np.ndarray
    last: np.ndarray
    weight: np.ndarray
    sd_base: float

    @staticmethod
    def plain(base: BaseTension, sd_tip: float) -> Weighing:
        """All alike, the base tension taken as it is."""
        K = len(base.T_base)
        return Weighing(base, np.zeros(K), np.arange(K), np.full(K, 1 / sd_tip), 0.0)

    @staticmethod
    def of(base: BaseTension, prediction: Prediction, sd_tip: float, sd_base: float) -> Weighing:
        """With the slopes of a simulation."""
        K = len(base.T_base)
        last = np.maximum.accumulate(np.where(prediction.slips, np.arange(K), 0))
        return Weighing(base, prediction.slope, last, np.full(K, 1 / sd_tip), sd_base)

    def only(self, inside: np.ndarray) -> Weighing:
        """The same with the other samples left out."""
        return dataclasses.replace(self, weight=np.where(inside, self.weight, 0.0))

    def shift(self, rows: np.ndarray) -> np.ndarray:
        """By how much the base tension is best corrected for residuals, (K, ...) [N], (K, ...)."""
        if self.sd_base <= 0:
            return np.zeros_like(rows)
        passed = self.slope * self.weight**2
        information = self.base.information(np.full(len(self.slope), self.sd_base**-2))
        information = information + self.base.information(passed * self.slope, self.last)
        pulled = self.base.to_knots(-self._along(passed, rows) * rows, self.last)
        return self.base.at_samples(cho_solve_banded((cholesky_banded(information), False), pulled))

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """Residuals, or columns of a Jacobian, (K, ...) [N], weighed: (2K, ...), tip and then base."""
        shift = self.shift(rows)
        tip = rows + self._along(self.slope, rows) * shift[self.last]
        base = shift / self.sd_base if self.sd_base > 0 else shift
        return np.concatenate([self._along(self.weight, rows) * tip, base])

    @staticmethod
    def _along(factor: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return factor.reshape(-1, *[1] * (rows.ndim - 1))
