"""Noise and resolution of a cell, from its readings alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gtr_jax.recordings.signals.differences import MAD_TO_SD, from_differences, third_differences

# Samples to a piece of a still stretch, whose line is taken off, and the fewest of a piece that is used.
PIECE, SHORTEST = 64, 16
# Share of a still stretch that is left out at either end, where the signal may have begun to move.
EDGE = 0.125
# Steps up to so many times the resolution must be whole multiples of it, within this share of one, for
# nearly all of them; of readings that are not quantised 30 % would be.
MULTIPLES, OFF, NEARLY_ALL, FEWEST = 20, 0.15, 0.9, 4
# Differences between distinct readings smaller than this share of the largest reading are rounding.
ROUNDING = 1e-7


@dataclasses.dataclass(frozen=True)
class CellNoise:
    """How noisy a cell is, by its readings alone.

    Attributes:
        white_N: standard deviation [N] of what changes from sample to sample.
        slow_N: of what changes over some samples, up to 64, where the signal stands still; None where it
            nowhere does.
        moving_N: of what changes from sample to sample where the signal moves; None where it never does.
        samples: from which the noise is estimated.
        source: what these are.
    """

    white_N: float
    slow_N: float | None
    moving_N: float | None
    samples: int
    source: str

    @property
    def total_N(self) -> float:
        """Standard deviation of white and slow noise together [N]."""
        return float(np.hypot(self.white_N, self.slow_N or 0.0))


def resolution(x: np.ndarray) -> float | None:
    """The step of which all readings, (K,), are whole multiples apart; None if there is none to be seen."""
    values = np.unique(x)
    steps = np.diff(values)
    steps = steps[steps > ROUNDING * float(np.max(np.abs(values)))]
    if steps.size < FEWEST:
        return None
    step = float(steps.min())
    near = steps[steps < (MULTIPLES + 0.5) * step]
    times = np.round(near / step)
    step = float(times @ near / (times @ times))
    whole = np.abs(near / step - np.round(near / step)) < OFF
    return step if np.mean(whole) >= NEARLY_ALL and near.size >= FEWEST else None


def noise(x: np.ndarray, quiet: Sequence[tuple[int, int]]) -> CellNoise:
    """The noise of a cell.

    Args:
        x: its readings [N], (K,).
        quiet: first and last sample of each stretch in which it stands still.
    """
    moves = np.ones(len(x), bool)
    for a, b in quiet:
        moves[a : b + 1] = False
    third = third_differences(x)
    moving = third[moves[3:] & moves[:-3]]
    in_motion = MAD_TO_SD * float(np.median(np.abs(moving))) if moving.size >= SHORTEST else None
    inner = [(a + int(EDGE * (b - a)), b - int(EDGE * (b - a))) for a, b in quiet]
    found = [_of_pieces(x[a : b + 1]) for a, b in inner if b - a + 1 >= SHORTEST]
    if not found:
        return CellNoise(from_differences(x), None, in_motion, len(x), "differences of neighbouring samples")
    white, total = (np.concatenate([f[i] for f in found]) for i in (0, 1))
    counted = sum(b - a + 1 for a, b in inner)
    # The median of the pieces is not moved by the few in which the signal creeps.
    fast, all_of_it = float(np.median(white)), float(np.median(total))
    return CellNoise(
        float(np.sqrt(fast)),
        float(np.sqrt(max(all_of_it - fast, 0.0))),
        in_motion,
        counted,
        "stretches in which the cell stands still",
    )


def _of_pieces(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Variance of third differences, and about a line, in each piece of a still stretch; each scaled so that
    its median over pieces of normal noise is the variance.
    """
    size = PIECE if len(x) >= PIECE else len(x)
    pieces = x[: len(x) // size * size].reshape(-1, size)
    t = np.linspace(-1.0, 1.0, size)
    centred = pieces - pieces.mean(axis=1, keepdims=True)
    left = centred - np.outer(centred @ t / (t @ t), t)
    degrees = size - 2
    total = np.sum(left**2, axis=1) / degrees / (1 - 2 / (9 * degrees)) ** 3
    # Third differences are correlated with one another: they count for 0.43 of their number.
    count = 0.43 * (size - 3)
    white = np.mean(third_differences(pieces) ** 2, axis=1) / (1 - 2 / (9 * count)) ** 3
    return white, total
