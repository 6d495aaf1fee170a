"""A model that recordings leave open: a robot, its numbers that are not known, and what is known of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from calibrate.inference.number import UNIT_SCALE, Number
from calibrate.inference.simulated_rig import friction_of, resolution_of
from gtr_jax import Robot, RobotConfig, build_robot
from gtr_jax.robot.parameters import Parameter, parameter, parameters_of
from gtr_jax.robot.stiffness import stiffness_of
from gtr_jax.terms import known_acting

# A number of which nothing is known counts as known to its own size; derivatives are taken over a change of
# at most this share of it.
NOTHING_KNOWN, SMALL = 1.0, 0.1


class Rival(Protocol):
    """A model that a diagnosis refitted, as the planner needs it: `names` of its hypotheses, free `numbers`,
    their coordinates `x`, and `values` of the free and the fixed numbers, SI, by name.
    """

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def numbers(self) -> tuple[Number, ...]: ...
    @property
    def x(self) -> np.ndarray: ...
    @property
    def values(self) -> Mapping[str, float]: ...
    def information(self) -> np.ndarray:
        """What is known about the coordinates, (p, p)."""
        ...


@dataclasses.dataclass(frozen=True, eq=False)
class OpenModel:
    """One model that may be true.

    Attributes:
        name: what it has beyond the base model, in words.
        file: the robot file that holds it, by its name.
        probability: of the model; 1 where it has no rival.
        config: its robot file.
        robot: on a coarse mesh, without what happens once.
        numbers: what is not known of it, p of them, each at its value where the coordinate is zero, in steps
            that its standard deviation or its size allows.
        information: about the coordinates, (p, p).
        asked: which of the numbers are to be known better, (p,) bool.
    """

    name: str
    file: str
    probability: float
    config: RobotConfig
    robot: Robot
    numbers: tuple[Number, ...]
    information: np.ndarray
    asked: np.ndarray

    @property
    def values(self) -> dict[str, float]:
        """Its numbers, SI, by name."""
        return {n.name: n.centre for n in self.numbers}

    @property
    def sd(self) -> np.ndarray:
        """Standard deviation of each number, SI, (p,)."""
        return np.asarray([n.sd for n in self.numbers]) * np.sqrt(np.diag(np.linalg.inv(self.information)))

    def at(self, x: np.ndarray) -> dict[str, float]:
        """Its numbers at coordinates, (p,), SI, by name."""
        return {n.name: n.value(v) for n, v in zip(self.numbers, x, strict=True)}


def open_model(
    name: str,
    file: str,
    config: RobotConfig,
    *,
    probability: float = 1.0,
    names: Sequence[str],
    information: np.ndarray,
    asked: Sequence[str] | None = None,
) -> OpenModel:
    """A model from its robot file and what is known of some of its numbers.

    Args:
        name, file, probability: as of `OpenModel`.
        config: the file.
        names: of the numbers.
        information: about them, per product of their SI units, (p, p).
        asked: which of them are to be known better; friction, stiffness and the numbers of terms unless
            given.
    """
    config = _without_events(config)
    robot = build_robot(config, resolution=resolution_of(build_robot(config)))
    once = {t.id for t in robot.catalogue.values() if t.event}
    kept = [i for i, own in enumerate(names) if own.partition(".")[0] not in once]
    entries = [parameter(robot, names[i]) for i in kept]
    values = np.asarray([float(robot.value(entry.name)) for entry in entries])
    size = np.asarray([_size(e, v) for e, v in zip(entries, values, strict=True)])
    every = information + np.diag(_least(robot, names))
    covariance = np.linalg.inv(_scaled(every))
    unit = 1 / np.sqrt(np.diag(every))
    covariance = (covariance * np.outer(unit, unit))[np.ix_(kept, kept)]
    step = np.minimum(np.sqrt(np.diag(covariance)), SMALL * size)
    numbers = tuple(
        Number(
            name=e.name,
            unit=e.unit,
            centre=float(v),
            sd=float(s),
            log=False,
            lower=-np.inf if e.lower is None else e.lower,
            upper=np.inf if e.upper is None else e.upper,
            key=e.key,
        )
        for e, v, s in zip(entries, values, step, strict=True)
    )
    told = np.linalg.inv(covariance / np.outer(step, step))
    if asked is None:
        asked = [e.name for e in entries if e.term is not None] + friction_of(robot) + stiffness_of(robot)
    counts = np.asarray([e.name in asked for e in entries], bool)
    return OpenModel(name, file, probability, config, robot, numbers, 0.5 * (told + told.T), counts)


def known_beforehand(config: RobotConfig) -> tuple[list[str], np.ndarray]:
    """The numbers of a robot file that recordings would be fitted to, and what the file says of them:
    friction, stiffness, the numbers of its terms, and whatever `[uncertainty]` names.
    """
    robot = build_robot(_without_events(config))
    acting = known_acting(robot.terms, robot.laws)
    known = parameters_of(robot)
    own = [name for name, e in known.items() if e.term is not None and e.term.id in acting]
    stated = [parameter(robot, key).name for key in config.uncertainty]
    names = list(dict.fromkeys([*friction_of(robot), *stiffness_of(robot), *own, *stated]))
    prior = [config.deviation(known[name].key) for name in names]
    return names, np.diag([0.0 if not sd else sd**-2 for sd in prior])


def _without_events(config: RobotConfig) -> RobotConfig:
    """The robot without what happens once, which a new recording does not repeat."""
    sizes = {
        f"terms.{term.id}{f':{term.tendon}' if term.tendon else ''}.{q.name}": float(q.null)
        for term in config.terms
        if config.catalogue[term.id].event
        for q in config.catalogue[term.id].sizes
    }
    return config.with_values(sizes) if sizes else config


def _size(entry: Parameter, value: float) -> float:
    """What counts as the size of a number: its value, or what is usual for its unit where that is more."""
    usual = 0.0 if entry.log else UNIT_SCALE.get(entry.unit, 0.0)
    return max(abs(value), usual) or 1.0


def _least(robot: Robot, names: Sequence[str]) -> np.ndarray:
    """The information that a number has of which nothing is known, per square of its SI unit, (p,)."""
    sizes = [_size(parameter(robot, name), float(robot.value(name))) for name in names]
    return (NOTHING_KNOWN * np.asarray(sizes)) ** -2


def _scaled(matrix: np.ndarray) -> np.ndarray:
    """A matrix with ones on its diagonal, by which the units of its numbers do not matter."""
    unit = 1 / np.sqrt(np.diag(matrix))
    return matrix * np.outer(unit, unit)
