"""What an experiment would show if a model were true, and how that depends on the numbers of the model."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from gtr_jax.robot.parameters import with_values
from gtr_jax.simulation.sensing import cells_show

from ..channels import of_tendons, quantity_of
from ..diagnosis.rig import Rig
from ..diagnosis.ways_to_drive import Values
from ..readings import exact
from ..setup import Part
from .candidates import Candidate
from .model import OpenModel

# Change of a coordinate to each side by which derivatives are taken: wide enough to cross kinks of friction.
STEP = 0.5
Shows = Callable[[Values], np.ndarray | None]


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """What an experiment would show under one model.

    Attributes:
        channels: what is read, C of them.
        rows: the readings, SI, (C, K).
        slopes: their derivatives by the coordinates of the model's numbers, (C, K, p).
    """

    channels: tuple[str, ...]
    rows: np.ndarray
    slopes: np.ndarray

    def weighed(self, candidate: Candidate) -> tuple[np.ndarray, np.ndarray]:
        """The readings that an experiment takes in standard deviations of their noise, (n,), and the
        derivatives, (n, p).
        """
        at = [self.channels.index(name) for name in candidate.sd]
        sd = np.asarray(list(candidate.sd.values()))
        rows, slopes = self.rows[at] / sd[:, None], self.slopes[at] / sd[:, None, None]
        return rows.ravel(), slopes.reshape(rows.size, -1)


def shows(model: OpenModel, candidate: Candidate, channels: Sequence[str]) -> Shows:
    """A function from values of the model's numbers, SI, to the readings, SI, (C, K); None where load steps
    do not converge.
    """
    if candidate.weight is not None:
        return lambda values: _cells(model, candidate, values)
    rig = Rig(_part(model, candidate, channels), model.robot, [n.name for n in model.numbers])
    at = [rig.channels.index(name) for name in channels]

    def shown(values: Values) -> np.ndarray | None:
        seen = rig(candidate.changed(values))
        return None if seen is None or seen.failed else seen.values[at]

    return shown


def outcome(model: OpenModel, shown: Shows, channels: Sequence[str]) -> Outcome | None:
    """What an experiment would show under a model, with derivatives by differences; None where load steps do
    not converge.

    Args:
        model: the model.
        shown: from `shows`.
        channels: that it reads.
    """
    start = shown(model.values)
    if start is None:
        return None
    slopes = []
    for i in range(len(model.numbers)):
        ends = []
        for step in (-STEP, STEP):
            x = np.zeros(len(model.numbers))
            x[i] = np.clip(step, *model.numbers[i].bounds)
            there = shown(model.at(x)) if x[i] else start
            if there is None:
                return None
            ends.append((x[i], there))
        (low, before), (high, after) = ends
        slopes.append((after - before) / (high - low))
    return Outcome(tuple(channels), start, np.stack(slopes, axis=-1))


def refitted(
    model: OpenModel, shown: Shows, candidate: Candidate, channels: Sequence[str], target: np.ndarray
) -> tuple[float, np.ndarray] | None:
    """How far a model stays from what another one would show, once its numbers have followed within what is
    known of them: Gauss-Newton, halving steps that do not help.

    Args:
        model: that is refitted.
        shown, channels: as of `outcome`.
        candidate: the experiment.
        target: what the other model shows of its channels, in standard deviations of the noise, (n,).

    Returns:
        The distance [standard errors], what is known of the numbers counted in, and the readings of the
        refitted model in standard deviations of the noise, (n,); None where load steps do not converge.
    """
    at = [channels.index(name) for name in candidate.sd]
    sd = np.asarray(list(candidate.sd.values()))[:, None]
    first = outcome(model, shown, channels)
    if first is None:
        return None
    low, high = (np.asarray([n.bounds[k] for n in model.numbers]) for k in (0, 1))
    x = np.zeros(len(model.numbers))
    rows, slopes = first.weighed(candidate)

    def cost(x: np.ndarray, rows: np.ndarray) -> float:
        return float(np.sum((rows - target) ** 2) + x @ model.information @ x)

    best = cost(x, rows)
    for _ in range(ROUNDS):
        normal = slopes.T @ slopes + model.information
        step = -np.linalg.solve(normal, slopes.T @ (rows - target) + model.information @ x)
        for share in (1.0, 0.5, 0.25, 0.1):
            there = np.clip(x + share * step, low, high)
            seen = shown(model.at(there))
            if seen is None:
                continue
            moved = (seen[at] / sd).ravel()
            if cost(there, moved) < best:
                break
        else:
            break
        gained = best - cost(there, moved)
        x, rows, best = there, moved, cost(there, moved)
        if gained < SETTLED * best:
            break
        slopes = _slopes_at(model, shown, x, (at, sd), slopes)
    return float(np.sqrt(best)), rows


# Rounds of a refit, and share of the cost that a round must gain for another to follow.
ROUNDS, SETTLED = 6, 0.02


def _slopes_at(
    model: OpenModel, shown: Shows, x: np.ndarray, of: tuple[list[int], np.ndarray], before: np.ndarray
) -> np.ndarray:
    """Derivatives of the weighed readings at coordinates, (n, p); those before where load steps fail."""
    at, sd = of
    found = np.array(before)
    for i, n in enumerate(model.numbers):
        ends = []
        for step in (-STEP, STEP):
            moved = np.array(x)
            moved[i] = np.clip(x[i] + step, *n.bounds)
            seen = shown(model.at(moved))
            if seen is not None:
                ends.append((moved[i], (seen[at] / sd).ravel()))
        if len(ends) == 2 and ends[1][0] > ends[0][0]:
            found[:, i] = (ends[1][1] - ends[0][1]) / (ends[1][0] - ends[0][0])
    return found


def _part(model: OpenModel, candidate: Candidate, channels: Sequence[str]) -> Part:
    """The experiment as a recording without readings."""
    robot = model.robot
    drives = [exact(column) for column in candidate.drive.T]
    tips = of_tendons("T_tip", robot)
    read = (*tips, *(name for name in channels if quantity_of(name) != "T_tip"))
    return Part(
        name="next",
        path="",
        robot=robot,
        config=None,
        T_base=drives[0],
        channels=read,
        recorded=np.zeros((len(read), len(candidate.time))),
        time=candidate.time,
        trial=None,
        noise_N=None,
        others=tuple(drives[1:]),
    )


def _cells(model: OpenModel, candidate: Candidate, values: Values) -> np.ndarray:
    """What the load cells show of known weights [N], (2, K)."""
    assert candidate.weight is not None
    robot = with_values(model.robot, dict(values))
    several = robot.tendon_names
    tip = np.tile(candidate.weight[:, None], (1, len(several))) if several else candidate.weight
    base = candidate.drive if several else candidate.drive[:, 0]
    shown = cells_show(robot, jnp.asarray(base), jnp.asarray(tip), jnp.asarray(candidate.time))
    each = [np.asarray(values).reshape(len(candidate.time), -1)[:, 0] for values in (shown.T_base, shown.T_tip)]
    return np.stack(each)
