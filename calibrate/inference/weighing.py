"""Residuals weighed by the noise of both cells: that of the base cell passes on to the tip wherever it slips.

While the whole tendon slips, T_tip follows the base tension of that moment with the slope g = dT_tip/dT_base;
while friction holds the tip, T_tip keeps the value of the sample at which it slipped last. So the simulated
T_tip of a sample depends on one true base tension, and through it on a few knots (`base_tension/`), whose
values v are known from the recording with a banded information matrix. Minimising over v,

    min_dv |r + G B dv|^2/sd_tip^2 + |B dv/sd_base|^2,

is linear in the residual r and costs as much as a banded solve. Errors that a plateau has in common with the
peak before it are thus counted once, and the plateau adds no information about friction to that of the peak.
The tip's pose and the tendon's displacement, which follow the base tension of their own sample, come into the
sum likewise.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gtr_jax.recordings.base_tension import BaseTension

from .channels import quantity_of


@dataclasses.dataclass(frozen=True, eq=False)
class Weighing:
    """Turns residuals of one recording, C channels of K samples, into (C+1) K rows that are independent and
    of unit variance as far as noise goes: those of the channels and then of the base tension.

    Attributes:
        base: the base tension and its knots.
        slope: change of each channel per change of the base tension at sample `last`, (C, K).
        last: sample whose base tension a value depends on, (C, K).
        weight: 1/sd, in 1/(unit of the channel), (C, K); 0 leaves a sample out.
        floating: channels whose zero is unknown, so that a constant offset does not count, (C,).
        stretch: uncertain stretch of the tendon in these channels, one standard deviation [m], (K,), or of
            the tendon of each channel, (C, K); zero where the stretch is known.
        sd_base: effective standard deviation of the recorded base tension at each sample [N], (K,), or of
            all; 0 if it is exact.
        tau: samples per independent one, of each channel, (C,).
        since: number of the stretch of the recording that each sample lies in, (K,), where channels may have
            another unknown zero in each; None for one stretch.
    """

    base: BaseTension
    slope: np.ndarray
    last: np.ndarray
    weight: np.ndarray
    floating: np.ndarray
    stretch: np.ndarray
    sd_base: np.ndarray | float
    tau: np.ndarray
    since: np.ndarray | None = None

    @staticmethod
    def plain(base: BaseTension, channels: tuple[str, ...], sd: np.ndarray) -> Weighing:
        """Equal weights for all samples of a channel, and an exact base tension."""
        C, K = len(channels), len(base.T_base)
        return Weighing(
            base=base,
            slope=np.zeros((C, K)),
            last=np.broadcast_to(np.arange(K), (C, K)),
            weight=np.broadcast_to(1 / np.asarray(sd, float)[:, None], (C, K)),
            floating=np.asarray([quantity_of(name) == "displacement" for name in channels]),
            stretch=np.zeros(K),
            sd_base=0.0,
            tau=np.ones(C),
        )

    @staticmethod
    def of(
        base: BaseTension,
        slips: np.ndarray,
        slope: np.ndarray | None,
        channels: tuple[str, ...],
        sd: np.ndarray,
        stretch: np.ndarray,
    ) -> Weighing:
        """Weighing with what a simulation shows.

        Args:
            base: the base tension.
            slips: whether slip reaches the anchor, (K,).
            slope: change of the channels by the base tension, (C, K); None takes that as exact.
            channels: their names, C of them.
            sd: their standard deviations, (C,).
            stretch: uncertain stretch of the tendon of each channel [m], (C, K).
        """
        K = len(base.T_base)
        plain = dataclasses.replace(Weighing.plain(base, channels, sd), stretch=stretch)
        if slope is None:
            return plain
        slipped = np.maximum.accumulate(np.where(slips, np.arange(K), 0))
        last = [slipped if name == "T_tip" else np.arange(K) for name in channels]
        return dataclasses.replace(plain, slope=slope, last=np.stack(last), sd_base=base.believed)

    @property
    def passed(self) -> np.ndarray:
        """Signed standard deviation of the channels due to the base tension's noise, (C, K)."""
        return self.slope * np.minimum(self.sd_base, self.base.error)

    def only(self, inside: np.ndarray) -> Weighing:
        """A copy that counts only the samples inside, (K,) bool."""
        return dataclasses.replace(self, weight=np.where(inside, self.weight, 0.0))

    def trusted(self, share: np.ndarray) -> Weighing:
        """A copy with each weight multiplied by a share, (C, K)."""
        return dataclasses.replace(self, weight=self.weight * share)

    def shift(self, rows: np.ndarray) -> np.ndarray:
        """Best correction of the base tension [N], (K, ...), for residuals, (C, K, ...)."""
        K = len(self.base.T_base)
        if self.exact:
            return np.zeros((K, *rows.shape[2:]))
        pulled = np.zeros((self.base.size, *rows.shape[2:]))
        for each, last, row in zip(self.slope * self.weight**2, self.last, rows, strict=True):
            pulled = pulled + self.base.to_knots(-along(each, row) * row, last)
        return self.base.at_samples(cho_solve_banded((self.factor, False), pulled))

    @property
    def exact(self) -> bool:
        """Whether the base tension is taken as recorded."""
        return not np.any(self.sd_base)

    @functools.cached_property
    def _alone(self) -> np.ndarray:
        """Information of the base cell alone about the knots, banded."""
        return self.base.information(np.broadcast_to(np.square(1 / self.sd_base), len(self.base.T_base)))

    @functools.cached_property
    def factor(self) -> np.ndarray:
        """Cholesky factor of the information of both cells about the knots, banded, as
        `BaseTension.information`.
        """
        found = self._alone
        for passed, last in zip(self.slope**2 * self.weight**2, self.last, strict=True):
            found = found + self.base.information(passed, last)
        return cholesky_banded(found)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the covariance of the channels' rows beside that without the noise
        of the base tension: what the sum of squares lacks for models of other slopes to be compared.
        """
        if self.exact:
            return 0.0
        alone = cholesky_banded(self._alone)
        return 2 * float(np.sum(np.log(self.factor[-1] / alone[-1])))

    @functools.cached_property
    def unknown(self) -> tuple[np.ndarray, np.ndarray]:
        """For channels whose zero is unknown, shares of the samples in their mean, and the stretch of the
        tendon less its own mean, in the units of the channels, (C, K) each; zero in the others.
        """
        share = np.where(self.floating[:, None], self.weight**2, 0.0)
        total = self._summed(share)
        share = share / np.where(total > 0, total, 1.0)
        stretch = np.broadcast_to(self.stretch, share.shape)
        return share, np.where(self.floating[:, None], stretch - self._summed(share * stretch), 0.0)

    def _summed(self, values: np.ndarray) -> np.ndarray:
        """Sums over each stretch with one zero, for all its samples, (C, K, ...)."""
        if self.since is None:
            return np.sum(values, axis=1, keepdims=True)
        found = np.empty_like(values)
        for number in np.unique(self.since):
            inside = self.since == number
            found[:, inside] = np.sum(values[:, inside], axis=1, keepdims=True)
        return found

    def centred(self, rows: np.ndarray) -> np.ndarray:
        """Residuals without the constant of channels whose zero is unknown and, as far as its prior allows,
        without a stretch of the tendon: in units of the noise rows r become r - (1 - 1/sqrt(1 + |g|^2)) g
        (g'r)/|g|^2, the square of which is the least that a stretch and its prior leave.
        """
        if not self.floating.any():
            return rows
        share, g = self.unknown
        rows = rows - self._summed(along(share, rows) * rows)
        if not self.stretch.any():
            return rows
        power = np.sum((self.weight * g) ** 2, axis=1, keepdims=True)
        part = (1 - 1 / np.sqrt(1 + power)) / np.where(power > 0, power, 1.0)
        pulled = np.sum(along(part * self.weight**2 * g, rows) * rows, axis=1, keepdims=True)
        return rows - along(g, rows) * pulled

    def left(self, rows: np.ndarray) -> np.ndarray:
        """Residuals in the units of the channels, (C, K), less the zero and the stretch that fit best."""
        share, g = self.unknown
        rows, squared = rows - self._summed(share * rows), self.weight**2 * g
        pulled, power = (np.sum(squared * x, axis=1, keepdims=True) for x in (rows, g))
        return rows - g * pulled / (1 + power)

    def split(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals, or columns of a Jacobian, (C, K, ...), weighed: those of the channels, (C, K, ...), and
        those of the base tension, (K, ...).
        """
        rows = self.centred(rows)
        shift = self.shift(rows)
        moved = rows + along(self.slope, rows) * shift[self.last]
        if self.exact:
            return along(self.weight, rows) * moved, shift
        sd = np.broadcast_to(self.sd_base, len(shift))
        return along(self.weight, rows) * moved, shift / along(sd, shift)

    def __call__(self, rows: np.ndarray) -> np.ndarray:
        """All weighed rows in one array, (C K + K, ...), scaled to independent samples."""
        channels, base = self.split(rows)
        counted = channels / np.sqrt(self.tau).reshape(-1, *[1] * (rows.ndim - 1))
        return np.concatenate([counted.reshape(-1, *rows.shape[2:]), base / np.sqrt(self.tau[0])])


def along(factor: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A factor of each sample, shaped to multiply rows with further axes."""
    return factor.reshape(*factor.shape, *[1] * (rows.ndim - factor.ndim))
