"""Readings that do not follow the tension: a cell at the end of its range, and a dead one."""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.recordings.signals.stretches import Stretch, runs, stretches

# Runs of equal readings so improbable in noise, over the whole recording, are no chance.
CHANCE = 1e-4
SHORTEST = 4
# A cell repeats its readings where no noise shows: noise below the first share of the resolution, or below
# the second of the range, as in simulations. It is then stuck if the other cell meanwhile moves by the third
# share of its range, more than it creeps in a hold; the tip, which friction holds while the base moves, if
# the base is pulled so much farther than ever before.
HIDDEN, NOISELESS, OTHER_MOVES = 0.5, 5e-5, 0.25
# Where a logger is faster than its amplifier, it writes most rows at least so many times and at most so many,
# more being a hold; this percentile of how often it writes each is usual.
REPEATS, USUAL = (2, 8), 95


@dataclasses.dataclass(frozen=True)
class Stuck:
    """A run of equal readings that tension and noise do not explain.

    Attributes:
        where: the samples.
        value_N: what the cell shows there.
        other_N: by how much the other cell moved meanwhile [N].
    """

    where: Stretch
    value_N: float
    other_N: float


def counted_once(T_base: np.ndarray, T_tip: np.ndarray, time: np.ndarray | None) -> np.ndarray:
    """The samples, by index, without those that a logger wrote again: rows that repeat both readings and the
    stamp of the row before, and, where the logger is faster than the amplifier and most readings are written
    several times, all but one of so many as it usually writes of each.

    Args:
        T_base, T_tip: readings of both cells [N], (K,).
        time: of the samples [s], (K,), or None.
    """
    same = (np.diff(T_base) == 0) & (np.diff(T_tip) == 0)
    again = np.zeros(len(T_base), bool)
    if time is not None:
        again[1:] = same & (np.diff(time) == 0)
    first = np.flatnonzero(np.append(True, ~same))
    times = np.diff(np.append(first, len(T_base)))
    usual = int(np.percentile(times, USUAL))
    if np.median(times) >= REPEATS[0] and usual <= REPEATS[1]:
        again |= (np.arange(len(T_base)) - np.repeat(first, times)) % usual != 0
    return np.flatnonzero(~again)


def stuck(
    x: np.ndarray,
    other: np.ndarray,
    *,
    white: float,
    step: float | None,
    is_tip: bool,
    time: np.ndarray | None,
    once: np.ndarray,
) -> tuple[tuple[Stuck, ...], tuple[Stuck, ...]]:
    """Stretches at the end of the cell's range, and dead ones elsewhere.

    Args:
        x, other: readings of the cell and of the other cell [N], (K,).
        white: noise of the cell from sample to sample [N].
        step: its resolution [N], or None.
        is_tip: whether it is the cell at the tip, which friction may hold while the base moves.
        time: of the samples [s], (K,), or None.
        once: the samples that count, from `counted_once`.
    """
    shown = white > max(HIDDEN * (step or 0.0), NOISELESS * float(np.ptp(x)))
    if shown:
        again = 0.5 if step is None else min(step / (2 * np.sqrt(np.pi) * white), 0.9)
        shortest = int(np.ceil(np.log(CHANCE / len(once)) / np.log(again))) + 1
    else:
        shortest = SHORTEST
    ends = runs(np.diff(x[once]) == 0, max(shortest, SHORTEST) - 1)
    found: tuple[list[Stuck], list[Stuck]] = ([], [])
    high, low, reach = float(np.max(x)), float(np.min(x)), float(np.ptp(other))
    for first, last in ends:
        a, b = int(once[first]), int(once[last + 1])
        within = other[a : b + 1]
        moved = float(np.ptp(within))
        farther = float(within.max() - other[: a + 1].max()) if is_tip else moved
        if not shown and farther < OTHER_MOVES * reach:
            continue
        at_end = x[a] in (high, low)
        (where,) = stretches([(a, b)], time)
        found[0 if at_end else 1].append(Stuck(where, float(x[a]), moved))
    return tuple(found[0]), tuple(found[1])
