"""What an experiment would show if a model were true, and how that depends on the numbers of the model."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
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
# Rounds of a refit, the shares of a step that are tried, and the share of the cost that a round must gain for
# another to follow.
ROUNDS, SHARES, SETTLED = 6, (1.0, 0.4, 0.15), 0.02
_cells_show = eqx.filter_jit(cells_show)
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


def outcome(
    model: OpenModel, shown: Shows, channels: Sequence[str], x: np.ndarray | None = None
) -> Outcome | None:
    """What an experiment would show under a model, with derivatives by differences; None where load steps do
    not converge.

    Args:
        model: the model.
        shown: from `shows`.
        channels: that it reads.
        x: coordinates of its numbers, (p,); at zero unless given.
    """
    x = np.zeros(len(model.numbers)) if x is None else x
    start = shown(model.at(x))
    if start is None:
        return None
    slopes = []
    for i, n in enumerate(model.numbers):
        ends = []
        for step in (-STEP, STEP):
            moved = np.array(x)
            moved[i] = np.clip(x[i] + step, *n.bounds)
            there = start if moved[i] == x[i] else shown(model.at(moved))
            if there is None:
                return None
            ends.append((moved[i], there))
        (low, before), (high, after) = ends
        slopes.append((after - before) / (high - low))
    return Outcome(tuple(channels), start, np.stack(slopes, axis=-1))


def refitted(
    model: OpenModel, shown: Shows, candidate: Candidate, target: np.ndarray, first: Outcome
) -> tuple[float, np.ndarray]:
    """How far a model stays from what another one would show, once its numbers have followed within what is
    known of them: Gauss-Newton, with shorter steps where a whole one does not help.

    Args:
        model: that is refitted.
        shown: from `shows`.
        candidate: the experiment.
        target: what the other model shows of its channels, in standard deviations of the noise, (n,).
        first: what the model shows before.

    Returns:
        The distance [standard errors], in which what is known of the numbers is counted, and the readings
        of the refitted model, SI, (C, K).
    """
    low, high = (np.asarray([n.bounds[k] for n in model.numbers]) for k in (0, 1))

    def cost(x: np.ndarray, rows: np.ndarray) -> float:
        return float(np.sum((rows - target) ** 2) + x @ model.information @ x)

    x, here = np.zeros(len(model.numbers)), first
    best = cost(x, here.weighed(candidate)[0])
    for _ in range(ROUNDS):
        rows, slopes = here.weighed(candidate)
        normal = slopes.T @ slopes + model.information
        step = -np.linalg.solve(normal, slopes.T @ (rows - target) + model.information @ x)
        before, there = best, None
        for share in SHARES:
            moved = np.clip(x + share * step, low, high)
            there = outcome(model, shown, here.channels, moved)
            if there is not None and cost(moved, there.weighed(candidate)[0]) < best:
                break
            there = None
        if there is None:
            break
        x, here, best = moved, there, cost(moved, there.weighed(candidate)[0])
        if before - best < SETTLED * best:
            break
    return float(np.sqrt(best)), here.rows


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
    shown = _cells_show(robot, jnp.asarray(base), jnp.asarray(tip), jnp.asarray(candidate.time))
    each = [
        np.asarray(values).reshape(len(candidate.time), -1)[:, 0] for values in (shown.T_base, shown.T_tip)
    ]
    return np.stack(each)
