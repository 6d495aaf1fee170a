"""Residuals of a robot of several tendons weighed by the noise of all its cells.

As in `weighing.py`, but each channel depends on the base tensions of all tendons, or on their displacements
where these drive them: the tip tension of a tendon on all of them at the sample where it slipped last, every
other channel on those of its own sample. Minimising over the values v_i at the knots of each of them,

    min_dv |r + sum_i G_i B_i dv_i|^2/sd^2 + sum_i |B_i dv_i|^2/sd_i^2,

the matrix of the knots is sparse rather than banded, because a tendon may be held for long while others move.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from gtr_jax.recordings.base_tension import BaseTension

from .channels import quantity_of
from .weighing import Weighing, along


@dataclasses.dataclass(frozen=True, eq=False)
class SeveralWeighing(Weighing):
    """`Weighing` of one recording with n tendons: `slope` and `last` are (C, K, n), and n K rows of what
    drives the tendons, tendon by tendon, follow those of the channels.

    Attributes:
        drives: what drives each tendon, and its knots, n of them.
        sds: effective standard deviation of each at each sample, (K,), or of all; 0 where it is exact.
    """

    drives: tuple[BaseTension, ...] = ()
    sds: tuple[np.ndarray | float, ...] = ()

    @staticmethod
    def of_all(
        drives: Sequence[BaseTension],
        slips: np.ndarray,
        slopes: Sequence[np.ndarray | None],
        channels: tuple[str, ...],
        sd: np.ndarray,
        stretch: np.ndarray,
    ) -> SeveralWeighing:
        """Weighing with what a simulation shows.

        Args:
            drives: what drives each of n tendons.
            slips: whether slip reaches their anchors, (K, n).
            slopes: change of the channels by what drives each tendon, (C, K) each; None takes that as exact.
            channels: their names, those of the n tip tensions first where they were recorded.
            sd: their standard deviations, (C,).
            stretch: uncertain stretch of the tendon of each channel [m], (C, K).
        """
        K, n = slips.shape
        slipped = np.maximum.accumulate(np.where(slips, np.arange(K)[:, None], 0), axis=0)
        own = np.broadcast_to(np.arange(K)[:, None], (len(channels), K, n)).copy()
        tips = sum(quantity_of(name) == "T_tip" for name in channels)
        own[:tips] = slipped.T[:tips, :, None]
        plain = Weighing.plain(drives[0], channels, sd)
        fields = {f.name: getattr(plain, f.name) for f in dataclasses.fields(plain)}
        known = [np.zeros((len(channels), K)) if slope is None else slope for slope in slopes]
        fields |= {"slope": np.stack(known, axis=-1), "last": own, "stretch": stretch}
        sds = tuple(
            0.0 if slope is None else drive.believed for slope, drive in zip(slopes, drives, strict=True)
        )
        return SeveralWeighing(**fields, drives=tuple(drives), sds=sds)

    @functools.cached_property
    def _follows(self) -> list[sparse.csr_array]:
        """How each channel depends on the numbers of all drives, (K, numbers) each, less what is exact."""
        return [
            sparse.csr_array(
                sparse.hstack([_shares(self.drives[i], slope[:, i], last[:, i]) for i in self._free])
            )
            for slope, last in zip(self.slope, self.last, strict=True)
        ]

    @functools.cached_property
    def _curves(self) -> sparse.csr_array:
        """Drives in their standard deviations at all samples, (n K, numbers)."""
        at = np.arange(self.weight.shape[1])
        each = [_shares(self.drives[i], np.broadcast_to(1 / self.sds[i], len(at)), at) for i in self._free]
        return sparse.csr_array(sparse.block_diag(each))

    @property
    def _free(self) -> list[int]:
        return [i for i, sd in enumerate(self.sds) if np.any(sd)]

    @functools.cached_property
    def solver(self) -> SuperLU:
        """Factors of the information of all cells about the numbers of the drives."""
        whole = self._curves.T @ self._curves
        for follows, weight in zip(self._follows, self.weight, strict=True):
            scaled = follows.multiply(weight[:, None])
            whole = whole + scaled.T @ scaled
        return splu(sparse.csc_array(whole))

    @property
    def passed(self) -> np.ndarray:
        """Standard deviation of the channels due to the noise of all that drives the tendons, (C, K)."""
        sds = [np.minimum(sd, drive.error) for sd, drive in zip(self.sds, self.drives, strict=True)]
        return np.sqrt(np.sum((self.slope * np.stack(sds, axis=-1)) ** 2, axis=-1))

    @property
    def log_determinant(self) -> float:
        """Of the covariance of the channels' rows beside that without the noise of the drives."""
        if not self._free:
            return 0.0
        alone = splu(sparse.csc_array(self._curves.T @ self._curves))
        return sum(
            sign * float(np.sum(np.log(np.abs(lu.U.diagonal()))))
            for sign, lu in ((1, self.solver), (-1, alone))
        )

    def split(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals, or columns of a Jacobian, (C, K, ...), weighed: those of the channels, (C, K, ...), and
        those of the drives, (n K, ...).
        """
        rows = self.centred(rows)
        C, K, *more = rows.shape
        drive = np.zeros((len(self.drives), K, *more))
        if not self._free:
            return along(self.weight, rows) * rows, drive.reshape(-1, *more)
        flat = rows.reshape(C, K, -1)
        pulled = sum(
            -(follows.T @ (weight[:, None] ** 2 * row))
            for follows, weight, row in zip(self._follows, self.weight, flat, strict=True)
        )
        numbers = self.solver.solve(np.asarray(pulled))
        moved = flat + np.stack([follows @ numbers for follows in self._follows])
        drive[self._free] = (self._curves @ numbers).reshape(-1, K, *more)
        return along(self.weight, rows) * moved.reshape(rows.shape), drive.reshape(-1, *more)


def _shares(drive: BaseTension, factor: np.ndarray, last: np.ndarray) -> sparse.csr_array:
    """How a factor times a drive at given samples, (K,) each, depends on the numbers of its knots."""
    K = len(last)
    values = factor[:, None] * drive.weights[last]
    columns = drive.near[last]
    return sparse.csr_array(
        (values.ravel(), (np.repeat(np.arange(K), 4), columns.ravel())), shape=(K, drive.size)
    )
