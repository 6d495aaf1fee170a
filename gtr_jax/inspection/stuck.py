"""Readings that do not follow the tension: a cell at the end of its range, and a dead one."""

from __future__ import annotations

import dataclasses

import numpy as np

from .stretches import Stretch, runs, stretches

# Runs of equal readings so improbable in noise, over the whole recording, are no chance.
CHANCE = 1e-4
SHORTEST = 4
# A cell whose noise is narrower than its resolution may well repeat its readings. It is stuck if the other
# cell meanwhile moves by so much of its range. The tip, which friction holds while the base moves, is stuck
# if it does not follow a rise of the base by so much of the base's range.
OTHER_MOVES, BASE_RISES = 0.05, 0.5
HIDDEN = 0.5  # noise below this share of the resolution does not show


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


def stuck(
    x: np.ndarray,
    other: np.ndarray,
    *,
    white: float,
    step: float | None,
    is_tip: bool,
    time: np.ndarray | None,
) -> tuple[tuple[Stuck, ...], tuple[Stuck, ...]]:
    """Stretches at the end of the cell's range, and dead ones elsewhere.

    Args:
        x, other: readings of the cell and of the other cell [N], (K,).
        white: noise of the cell from sample to sample [N].
        step: its resolution [N], or None.
        is_tip: whether it is the cell at the tip, which friction may hold while the base moves.
        time: of the samples [s], (K,), or None.
    """
    shown = white > HIDDEN * (step or 0.0) > 0 or (step is None and white > 0)
    if shown:
        again = 0.5 if step is None else min(step / (2 * np.sqrt(np.pi) * white), 0.9)
        shortest = int(np.ceil(np.log(CHANCE / len(x)) / np.log(again))) + 1
    else:
        shortest = SHORTEST
    ends = runs(np.diff(x) == 0, max(shortest, SHORTEST) - 1)
    found: tuple[list[Stuck], list[Stuck]] = ([], [])
    high, low, reach = float(np.max(x)), float(np.min(x)), float(np.ptp(other))
    for a, b in ends:
        within = other[a : b + 2]
        moved = float(np.ptp(within))
        risen = float(within[-1] - within[0])
        if not shown and (risen < BASE_RISES * reach if is_tip else moved < OTHER_MOVES * reach):
            continue
        at_end = x[a] in (high, low) and (moved >= OTHER_MOVES * reach or shown)
        (where,) = stretches([(a, b + 1)], time)
        found[0 if at_end else 1].append(Stuck(where, float(x[a]), moved))
    return tuple(found[0]), tuple(found[1])
