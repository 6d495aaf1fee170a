"""The robot behind the page: its numbers as they are set, simulated by programs that are compiled once."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.config.sections import TermConfig
from gtr_jax.errors import InputError
from gtr_jax.robot.build import build_robot, check_built
from gtr_jax.robot.parameters import parameter, parameters_of
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.displacement import by_tension
from gtr_jax.simulation.history import Simulation, simulate
from gtr_jax.simulation.programs import every_for
from gtr_jax.simulation.sensing import true_base
from gtr_jax.terms import Term, catalogue_of

from .drawn import base_tensions
from .histories import History


@dataclasses.dataclass(frozen=True, eq=False)
class Setting:
    """A robot with its numbers as they are set.

    Attributes:
        config: the robot file that it began from.
        robot: as the file has it.
        changed: the robot with its numbers as they are set.
        values: of the numbers that were changed [SI], by the names of `gtr_jax.parameters_of`.
        terms: names of the physics terms that are on the page, whether they act or not.
    """

    config: RobotConfig
    robot: Robot
    changed: Robot
    values: Mapping[str, float]
    terms: tuple[str, ...]

    @classmethod
    def of(cls, config: RobotConfig) -> Setting:
        """As a robot file has it."""
        robot = build_robot(config)
        return cls(config, robot, robot, {}, tuple(dict.fromkeys(term.id for term in config.terms)))

    @property
    def catalogue(self) -> Mapping[str, Term]:
        """Every term that the robot may have, by name."""
        return catalogue_of(self.robot.laws)

    @property
    def addable(self) -> list[Term]:
        """The terms that can be added to those on the page."""
        carried = every_for(self.robot)
        return [
            term
            for term in self.catalogue.values()
            if term.id not in self.terms
            and (term.of_cells or term.id in carried)
            and not (self.robot.space and term.not_in_space)
        ]

    def with_value(self, name: str, value: float) -> Setting:
        """One number set to a value [SI].

        Raises:
            InputError: it is out of its bounds.
        """
        return self._with({name: value})

    def _with(self, values: Mapping[str, float]) -> Setting:
        changed = self.changed.with_values(**values)
        return dataclasses.replace(self, changed=changed, values={**self.values, **values})

    def with_term(self, term: str) -> Setting:
        """One term more on the page, at its null values."""
        return dataclasses.replace(self, terms=(*self.terms, term))

    def without_term(self, term: str) -> Setting:
        """One term fewer on the page, its numbers at their null values."""
        own = {q.name: float(q.null) for q in self.catalogue[term].numbers}
        known = parameters_of(self.robot).items()
        null = {name: own[name.split(".")[1]] for name, p in known if p.term and p.term.id == term}
        kept = tuple(name for name in self.terms if name != term)
        return dataclasses.replace(self._with(null), terms=kept)

    def written(self, free: Collection[str] = ()) -> RobotConfig:
        """The robot file with the numbers as they are set, checked as commands check it. Terms that are on
        the page without effect are left out: added ones of which no number was moved, and those that a file
        may not have at null values, of several sizes.

        Args:
            free: names of numbers that are to be fitted; terms that have one stand in the file at their null
                values too, where it may have them.

        Raises:
            InputError: no command would take it; the line with which they refuse it.
        """
        in_file = {term.id for term in self.config.terms}
        gone = self._idle({name.partition(".")[0] for name in free})
        kept = {*self.terms, *in_file}
        entries = {name: parameter(self.robot, name) for name in self.values}
        keys = {
            entry.key: self.values[name]
            for name, entry in entries.items()
            if entry.term is None or entry.term.id in kept
        }
        for term in self.terms:  # those that were added and not moved
            for q in () if term in in_file else self.catalogue[term].sizes:
                key = f"terms.{term}.{q.name}"
                keys.setdefault(key, float(self.robot.terms[term][q.name]))
        keys = {key: value for key, value in keys.items() if not key.startswith(gone)}
        config = _with_vectors(_without(self.config, gone), keys).with_values(keys)
        check_built(config, self.changed)
        return config

    def _idle(self, wanted: Collection[str]) -> tuple[str, ...]:
        """The tables of physics terms without effect that are left out of the file, as their keys begin.

        Args:
            wanted: names of terms that stand in it all the same, where it may have them.
        """
        names, several = self.config.tendon_names, {t.id for t in self.catalogue.values() if len(t.sizes) > 1}
        gone = []
        for own in self.config.terms:
            place = None if own.tendon is None else names.index(own.tendon)
            if own.id in several and self._at_null(own.id, place, sizes=True):
                gone.append(_table(own))
        for term in set(self.terms) - {own.id for own in self.config.terms}:
            if self._at_null(term, sizes=term in several) and (term in several or term not in wanted):
                gone.append(f"terms.{term}.")
        return tuple(gone)

    def _at_null(self, term: str, tendon: int | None = None, *, sizes: bool) -> bool:
        """Whether the numbers of a term, or only its sizes, are at their null values, as set; of one tendon,
        by its place, or of all.
        """
        known, values = self.catalogue[term], self.changed.terms[term]
        for q in known.sizes if sizes else known.numbers:
            value = np.asarray(values[q.name])
            if np.any((value if tendon is None or not value.ndim else value[tendon]) != q.null):
                return False
        return True


def _table(term: TermConfig) -> str:
    """How the keys of a term of the file begin."""
    return f"terms.{term.id}." if term.tendon is None else f"terms.{term.id}:{term.tendon}."


def _without(config: RobotConfig, gone: tuple[str, ...]) -> RobotConfig:
    """The robot file without the terms of these tables, and what it says of how well they are known."""
    kept = tuple(term for term in config.terms if _table(term) not in gone)
    said = [key for key in config.uncertainty if key.startswith(gone)]
    return config.without_deviations(said).model_copy(update={"terms": kept})


def _with_vectors(config: RobotConfig, keys: Mapping[str, float]) -> RobotConfig:
    """The robot file with the loads written out in space where one of their numbers is to be set that it does
    not have.
    """
    loads, update = config.loads, {}
    for name in ("tip_force", "tip_moment", "gravity"):
        given = getattr(loads, name)
        places = [int(key.rpartition(".")[2]) for key in keys if key.startswith(f"loads.{name}.")]
        if not config.in_space or all(isinstance(given, tuple) and i < len(given) for i in places):
            continue
        numbers = given if isinstance(given, tuple) else (0.0, 0.0, given or 0.0)  # a moment is about z
        update[name] = (*numbers, *[0.0] * (3 - len(numbers)))
    return config.model_copy(update={"loads": loads.model_copy(update=update)}) if update else config


@dataclasses.dataclass(frozen=True, eq=False)
class Curves:
    """A robot along a history of K steps, on the host.

    Attributes:
        robot, run: as simulated.
        history: that it went through.
        time: [s], (K,).
        T_base, T_tip: as the load cells show them [N], (K, tendons).
        recorded_base, recorded_tip: as recorded [N], (K, tendons); None where they were not.
        displacement: drawn out at the base [m], (K, tendons).
        tip_angle: against the base tangent [rad], in space between the tangents, (K,).
        most: largest tension anywhere along the tendons [N].
        failed: how many steps did not converge; numbers outside physics are a fault of the robot instead.
    """

    robot: Robot
    run: Simulation
    history: History
    time: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray
    recorded_base: np.ndarray | None
    recorded_tip: np.ndarray | None
    displacement: np.ndarray
    tip_angle: np.ndarray
    most: float
    failed: int

    @property
    def largest(self) -> int:
        """The step of the largest tension at the base, of all tendons together."""
        return int(np.argmax(np.asarray(self.run.T_base).reshape(len(self.time), -1).sum(axis=1)))


def simulated(setting: Setting, history: History) -> Curves:
    """A robot through a history. The program holds the terms that are on the page: as their numbers move,
    through zero too, none is compiled again.

    Raises:
        InputError: the robot cannot have its terms together.
    """
    robot = setting.changed
    there = [setting.catalogue[term] for term in setting.terms]
    held, recording = [term.id for term in there if not term.of_cells], history.recording
    T_base, met = history.T_base, None
    try:
        if recording is not None and any(term.true_base for term in there):
            T_base = np.asarray(true_base(robot, T_base, history.time))
        if history.displacement is not None:
            T_base, met = base_tensions(robot, T_base, history.displacement, history.time, held)
        run = simulate(by_tension(robot), T_base, time=history.time, with_terms=held)
    except InputError:
        raise
    except ValueError as fault:
        raise InputError(f"{fault}; take a term off the page, or set its numbers to zero") from None
    return Curves(
        robot=robot,
        run=run,
        history=history,
        time=history.time,
        T_base=_columns(run.reading.T_base),
        T_tip=_columns(run.reading.T_tip),
        recorded_base=None if recording is None else _columns(recording.T_base),
        recorded_tip=None if recording is None or recording.T_tip is None else _columns(recording.T_tip),
        displacement=_columns(run.displacement),
        tip_angle=_tip_angle(run),
        most=float(np.nanmax(np.asarray(run.tension))),
        failed=int(np.sum(~(np.asarray(run.solved) & (True if met is None else met)))),
    )


def _columns(values: Any) -> np.ndarray:
    """Values of one tendon or of several, (K, tendons)."""
    values = np.asarray(values)
    return values.reshape(len(values), -1)


def _tip_angle(run: Simulation) -> np.ndarray:
    if run.shape is None:
        return np.asarray(run.tip_pose)[:, 2]
    rotation = np.asarray(run.shape.rotation)
    cosine = np.einsum("ki,ki->k", rotation[:, 0, :, 0], rotation[:, -1, :, 0])
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def names_of(robot: Robot) -> Sequence[str]:
    """Names of the tendons; of an only one ""."""
    return robot.tendon_names or ("",)
