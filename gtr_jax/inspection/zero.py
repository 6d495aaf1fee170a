"""What the cells show when the tendon is slack: before the first pull and after the last release."""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.recordings.signals.stretches import Stretch, stretches

NEAR = 0.03
"""A still stretch is unloaded if both cells show less than this share of their range above their least."""


@dataclasses.dataclass(frozen=True)
class Zero:
    """The mean reading of a cell over an unloaded stretch.

    Attributes:
        value_N, sd_N: the mean and its standard error.
        where: the stretch.
    """

    value_N: float
    sd_N: float
    where: Stretch


def unloaded(
    T_base: np.ndarray,
    T_tip: np.ndarray,
    time: np.ndarray | None,
    *,
    quiet: list[tuple[int, int]],
    pulls: tuple[int, int],
) -> tuple[Stretch | None, Stretch | None]:
    """The last unloaded stretch before the first pull, and the first after the last release; None where there
    is none.

    Args:
        T_base, T_tip: [N], (K,).
        time: [s], (K,), or None.
        quiet: first and last sample of the stretches in which both cells stand still.
        pulls: first sample of the first pull's peak, and of the last's.
    """
    limits = [float(np.min(T)) + NEAR * float(np.ptp(T)) for T in (T_base, T_tip)]
    low = [
        (a, b)
        for a, b in quiet
        if all(np.median(T[a : b + 1]) <= limit for T, limit in zip((T_base, T_tip), limits, strict=True))
    ]
    before = [ends for ends in low if ends[1] <= pulls[0]]
    after = [ends for ends in low if ends[0] >= pulls[1]]
    first = stretches(before[-1:], time)
    last = stretches(after[-1:], time)
    return (first[0] if first else None), (last[0] if last else None)


def zero(x: np.ndarray, where: Stretch | None, noise: float) -> Zero | None:
    """The zero of a cell.

    Args:
        x: its readings [N], (K,).
        where: an unloaded stretch, or None.
        noise: standard deviation of the cell where it stands still [N], which counts as if 64 neighbouring
            samples had one error in common: the slow part is not averaged out.
    """
    if where is None:
        return None
    own = x[where.rows]
    return Zero(float(np.mean(own)), noise / np.sqrt(max(len(own) / 64, 1.0)), where)
