"""What an experiment would show if a model were true, and how that depends on the numbers of the model."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from calibrate.inference.channels import ORIENTATION, Orientation, of_tendons, quantity_of
from calibrate.inference.number import values_in
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_rig import SimulatedRig, valued
from calibrate.inference.simulation_cache import SimulationCache
from gtr_jax import Robot
from gtr_jax.recordings.base_tension import exact
from gtr_jax.simulation.sensing import cells_show

from .candidates import Candidate
from .disturbed import White, disturbances, whitening
from .model import OpenModel, Rival
from .ways_to_drive import Values

# Change of a coordinate to each side by which derivatives are taken: wide enough to cross kinks of friction.
STEP = 0.5
# Change of a coordinate to one side by which a diagnosis takes derivatives of its rivals.
FORWARD_STEP = 0.05
# The same for a check of what the wide one says: over a kink the readings seem to depend on combinations of
# numbers on which they do not.
FINE_STEP = 0.005
# Rounds of a refit, the shares of a step that are tried, and the share of the cost that a round must gain for
# another to follow.
ROUNDS, SHARES, SETTLED = 6, (1.0, 0.4, 0.15), 0.02
_compiled_cells_show = eqx.filter_jit(cells_show)


class Weighed(NamedTuple):
    """Readings in standard deviations of their noise, (n,), their derivatives by the coordinates of the
    model's numbers, (n, p), and what makes such rows independent of each other.
    """

    rows: np.ndarray
    slopes: np.ndarray
    white: White


@dataclasses.dataclass(frozen=True, eq=False)
class Outcome:
    """What an experiment would show under one model.

    Attributes:
        channels: what is read, C of them.
        rows: the readings, SI, (C, K).
        slopes: their derivatives by the coordinates of the model's numbers, (C, K, p).
        disturbed: their changes by one standard deviation of what disturbs many at once, SI, (C, K, q).
    """

    channels: tuple[str, ...]
    rows: np.ndarray
    slopes: np.ndarray
    disturbed: np.ndarray

    def weighed(self, candidate: Candidate) -> Weighed:
        """The readings that an experiment takes, in standard deviations of their noise."""
        rows = _weighed_rows(self.rows, self.channels, candidate)
        at = [self.channels.index(name) for name in candidate.sd]
        sd = np.asarray(list(candidate.sd.values()))
        slopes, beside = (
            (columns[at] / sd[:, None, None]).reshape(rows.size, -1)
            for columns in (self.slopes, self.disturbed)
        )
        return Weighed(rows, slopes, whitening(beside))


def _weighed_rows(rows: np.ndarray, channels: Sequence[str], candidate: Candidate) -> np.ndarray:
    """Those of the readings of all channels, SI, (C, K), that an experiment takes, in standard deviations of
    their noise, (n,).
    """
    at = [channels.index(name) for name in candidate.sd]
    sd = np.asarray(list(candidate.sd.values()))
    return (rows[at] / sd[:, None]).ravel()


class SimulatedExperiment:
    """An experiment, to be simulated with any values of a robot's numbers.

    Args:
        candidate: the experiment.
        channels: that are read, C of them.
        robot: with which it is simulated, on a coarse mesh.
        more: names of further numbers that may change, as of `SimulatedRig`.
        name: of the recording; a number that such a recording has to itself has it after an @.
        cache: of simulations done before.

    Attributes:
        part: the experiment as a recording without readings.
    """

    def __init__(
        self,
        candidate: Candidate,
        channels: Sequence[str],
        robot: Robot,
        more: Sequence[str] = (),
        *,
        name: str = "next",
        cache: SimulationCache | None = None,
    ) -> None:
        self.candidate, self.channels, self.robot = candidate, tuple(channels), robot
        self.part = _part(robot, candidate, channels, name)
        self._more, self._cache = tuple(more), cache

    # What the cells show of true tensions; compiled it differs in the last bit.
    _cells_show = staticmethod(cells_show)

    @functools.cached_property
    def _rig(self) -> SimulatedRig:
        return SimulatedRig(self.part, self.robot, self._more, self._cache)

    def __call__(self, values: Values) -> np.ndarray | None:
        """The readings, SI, (C, K), of a check of the cells those of all tendons, (C, K tendons); None where
        load steps do not converge.

        Args:
            values: of numbers of the robot, SI, by name.
        """
        if self.candidate.weight is not None:
            return self._cells(values)
        seen = self._rig(self.candidate.changed(values))
        if seen is None or seen.failed:
            return None
        return seen.values[[self._rig.channels.index(name) for name in self.channels]]

    def _cells(self, values: Values) -> np.ndarray:
        """What the load cells show of known weights [N], (2, K tendons)."""
        candidate = self.candidate
        assert candidate.weight is not None
        robot = valued(self.robot, values_in(values, self.part.name))
        several = robot.tendon_names
        tip = np.tile(candidate.weight[:, None], (1, len(several))) if several else candidate.weight
        base = candidate.drive if several else candidate.drive[:, 0]
        shown = self._cells_show(robot, jnp.asarray(base), jnp.asarray(tip), jnp.asarray(candidate.time))
        return np.stack([np.asarray(values).ravel() for values in (shown.T_base, shown.T_tip)])


class Trial(SimulatedExperiment):
    """An experiment under one model of a plan. Of a check of the cells it takes those of the first tendon,
    where a diagnosis takes all.

    Args:
        model: that is true.
        candidate: the experiment.
        channels: that are read, C of them.
        noise: standard deviation of a reading of what drives the tendons, SI.
    """

    _cells_show = staticmethod(_compiled_cells_show)

    def __init__(self, model: OpenModel, candidate: Candidate, channels: Sequence[str], noise: float) -> None:
        super().__init__(candidate, channels, model.robot, [n.name for n in model.numbers])
        self.model, self._noise = model, noise

    def _cells(self, values: Values) -> np.ndarray:
        every = super()._cells(values)
        return every.reshape(len(every), len(self.candidate.time), -1)[:, :, 0]

    def disturbed(self, rows: np.ndarray) -> np.ndarray:
        """Changes of readings, SI, (C, K), by what disturbs many at once, SI, (C, K, q)."""
        if self.candidate.weight is not None:
            return np.zeros((*rows.shape, 0))
        return disturbances(self.candidate, self.part, self.channels, rows, self._noise)


def outcome(trial: Trial, x: np.ndarray | None = None, width: float = STEP) -> Outcome | None:
    """What an experiment would show under a model, with derivatives by differences; None where load steps do
    not converge.

    Args:
        trial: the experiment under the model.
        x: coordinates of the model's numbers, (p,); at zero unless given.
        width: change of a coordinate to each side by which derivatives are taken.
    """
    model = trial.model
    x = np.zeros(len(model.numbers)) if x is None else x
    start = trial(model.at(x))
    if start is None:
        return None
    slopes = []
    for i, n in enumerate(model.numbers):
        ends = []
        for step in (-width, width):
            moved = np.array(x)
            moved[i] = np.clip(x[i] + step, *n.bounds)
            there = start if moved[i] == x[i] else trial(model.at(moved))
            if there is None:
                return None
            ends.append((moved[i], there))
        (low, before), (high, after) = ends
        slopes.append((after - before) / (high - low))
    return Outcome(trial.channels, start, np.stack(slopes, axis=-1), trial.disturbed(start))


def weighed_forward(
    experiment: SimulatedExperiment, rival: Rival, candidates: Sequence[Candidate]
) -> list[Weighed] | None:
    """What each of some candidates that differ in what they record would show under a rival of a diagnosis,
    without what disturbs many readings; None where load steps do not converge.

    Derivatives are over one small step from where the rival was fitted, of readings in standard deviations:
    those of `outcome`, over a wide step to both sides, would propose other experiments.
    """
    start = experiment(rival.values)
    if start is None:
        return None
    moved = []
    for i, n in enumerate(rival.numbers):
        there = experiment(dict(rival.values) | {n.name: n.value(rival.x[i] + FORWARD_STEP)})
        if there is None:
            return None
        moved.append(there)
    found = []
    for candidate in candidates:
        rows, *ends = (_weighed_rows(own, experiment.channels, candidate) for own in (start, *moved))
        slopes = np.stack([(there - rows) / FORWARD_STEP for there in ends], axis=1)
        found.append(Weighed(rows, slopes, whitening(np.zeros((rows.size, 0)))))
    return found


def refitted(
    trial: Trial, candidate: Candidate, target: np.ndarray, first: Outcome
) -> tuple[float, np.ndarray]:
    """How far a model stays from what another one would show, once its numbers have followed within what is
    known of them: Gauss-Newton, with shorter steps where a whole one does not help. This is no
    use of `least_squares.py`, because a damping in place of these shares would lead to other plans.

    Args:
        trial: the experiment under the model that is refitted.
        candidate: the same with the instruments that are read.
        target: what the other model shows of them, in standard deviations of the noise, (n,).
        first: what the model shows before.

    Returns:
        The distance [standard errors], in which what is known of the numbers is counted, and the readings
        of the refitted model, SI, (C, K).
    """
    model = trial.model
    low, high = (np.asarray([n.bounds[k] for n in model.numbers]) for k in (0, 1))
    white = first.weighed(candidate).white

    def cost(x: np.ndarray, rows: np.ndarray) -> float:
        return float(np.sum(white(rows - target) ** 2) + x @ model.information @ x)

    x, here = np.zeros(len(model.numbers)), first
    best = cost(x, here.weighed(candidate).rows)
    for _ in range(ROUNDS):
        rows, slopes, _ = here.weighed(candidate)
        slopes = white(slopes)
        normal = slopes.T @ slopes + model.information
        step = -np.linalg.solve(normal, slopes.T @ white(rows - target) + model.information @ x)
        before, there = best, None
        for share in SHARES:
            moved = np.clip(x + share * step, low, high)
            there = outcome(trial, moved)
            if there is not None and cost(moved, there.weighed(candidate).rows) < best:
                break
            there = None
        if there is None:
            break
        x, here, best = moved, there, cost(moved, there.weighed(candidate).rows)
        if before - best < SETTLED * best:
            break
    return float(np.sqrt(best)), here.rows


def _part(robot: Robot, candidate: Candidate, channels: Sequence[str], name: str) -> Observation:
    """The experiment as a recording without readings, whose base does not turn."""
    drives = [exact(column) for column in candidate.drive.T]
    tips = of_tendons("T_tip", robot)
    read = (*tips, *(name for name in channels if quantity_of(name) != "T_tip"))
    K, orientation = len(candidate.time), None
    if any(channel.startswith(ORIENTATION) for channel in channels):
        orientation = Orientation(np.broadcast_to(np.eye(3), (K, 3, 3)), np.zeros((K, 3)))
    return Observation(
        name=name,
        path="",
        robot=robot,
        config=None,
        T_base=drives[0],
        channels=read,
        recorded=np.zeros((len(read), K)),
        time=candidate.time,
        trial=None,
        noise_N=None,
        others=tuple(drives[1:]),
        orientation=orientation,
    )
