"""A recording that is simulated again and again, small and fast enough to try every hypothesis on it."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import functools
import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from gtr_jax import Robot, true_base
from gtr_jax.robot.parameters import parameters_of, places_of, with_values
from gtr_jax.robot.robot import lay_out
from gtr_jax.robot.stiffness import stiffness_of
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.markers import markers_on, shape_in_plane
from gtr_jax.simulation.natively import Brief, Native, ProgramSpec, Ready, Run, ready, sources
from gtr_jax.simulation.programs import every, every_for, structure_of, structure_with
from gtr_jax.simulation.sensing import Reading, cells_differ, cells_show
from gtr_jax.simulation.shape import Shape
from gtr_jax.terms import OWN, REGISTRY, Term, own_mark

from .channel_rows import channel_rows, shows_markers
from .channels import turned_by
from .instruments import instruments
from .load_history import LoadHistory, padded_history
from .number import values_in
from .setup import Observation
from .side_by_side import simulated
from .simulated_readings import SimulatedReadings
from .simulation_cache import SimulationCache

Known = TypeVar("Known")
_turned_by = jax.jit(turned_by)

# Mesh intervals with which hypotheses are tried, and their least share of the robot's own intervals.
INTERVALS, COARSEST = 22, 0.35
# Simulations that a rig keeps in memory, as the channels show them and as the native program leaves them: a
# change in a number of one recording leaves those of the others valid.
AT_HAND, RUNS_AT_HAND = 256, 64
# Load steps for each sample where the speed of the slip adds to friction. One takes the speed as even:
# where the base tension turns back, friction of the speed may then pass for another effect. In the labelled
# recording 5, of friction that differs between the directions, viscous friction leaves 56, 68, 124 and 154 of
# 55 rows with 1, 2, 4 and 16 steps for each sample, the asymmetry 61 with any. Friction of the speed in the
# step before (Stribeck) takes one: its law is of the steps. And most steps that this makes of a recording,
# for the time that it takes.
STEPS_BY_SPEED, MOST_STEPS = 4, 600

# Terms in each program that simulates a recording, from the fastest to the slowest program: a hypothesis uses
# the first that has all its terms. Load steps a second in lanes: 200,000, 80,000, 40,000, 30,000 and 18,000;
# they compile in 0.3 to 6 s (benchmarks/results/native.md). A program of its own for every hypothesis would
# take 0.3 to 1.5 s each. Terms of a user's own are added to them, as laws are.
EVERY = tuple(kind for kind in every() if kind not in OWN)
_LOADS = tuple(kind for kind in EVERY if REGISTRY[kind].loads)
_BY_SPEED = tuple(kind for kind in EVERY if REGISTRY[kind].by_speed)
_BY_SLIP = (*(kind for kind in EVERY if REGISTRY[kind].mobilise), *_BY_SPEED)
_ALONE = (*_BY_SLIP, *(kind for kind in EVERY if REGISTRY[kind].relaxes or REGISTRY[kind].stop))
PROGRAMS = (
    (),
    tuple(kind for kind in EVERY if kind not in (*_LOADS, *_ALONE)),
    tuple(kind for kind in EVERY if kind not in _BY_SLIP),
    tuple(kind for kind in EVERY if kind not in _BY_SPEED),
    EVERY,
)
# In space, terms that load the body, or follow the slip, cost more: 200 steps of examples/helix.toml on 25
# nodes take 2.3 ms without terms, 8 ms with the second set and 60 to 70 ms with the third. So each of them
# has a program of its own, tried before those that hold several.
IN_SPACE = (*PROGRAMS[:2], _LOADS, *((kind,) for kind in _ALONE), *PROGRAMS[2:])


def programs_of(robot: Robot) -> list[tuple[str, ...]]:
    """Names of the physics terms in each program that may simulate a robot, the fastest first."""
    may = every_for(robot)
    programs = IN_SPACE if robot.space else PROGRAMS
    held = [tuple(kind for kind in kinds if kind in may) for kinds in programs]
    return list(dict.fromkeys(held))


def program_for(robot: Robot, kinds: Collection[str]) -> tuple[str, ...]:
    """Names of the physics terms of the fastest program of a robot that has all of these; laws of the robot
    file and terms of a user's own, which no program has from the start, are added to it.
    """
    laws = tuple(sorted(set(kinds) - set(EVERY)))
    return (*next(held for held in programs_of(robot) if set(kinds) <= {*held, *laws}), *laws)


class _Traced(NamedTuple):
    """What is compiled for all robots of a structure, given their numbers as `ravel_pytree` flattens them.

    Attributes:
        begin: maps a robot and a load history of P steps to the inputs of the native programs.
        cells: maps a robot, true tensions at base and tip [N], (P, *tendons) each, and time, (P,), to what
            the load cells show.
        places: maps a robot and where its body is at P steps to what `markers_on` gives, (P, markers, 4).
    """

    begin: Callable[..., tuple[Ready, Any]]
    cells: Callable[..., Reading]
    places: Callable[..., Float[Array, "P markers 4"]]


@functools.lru_cache(maxsize=16)
def _traced(tree, shapes: tuple[tuple[int, ...], ...]) -> _Traced:
    unravel = ravel_pytree(jtu.tree_unflatten(tree, [jnp.zeros(shape) for shape in shapes]))[1]

    def begin(flat, history: LoadHistory):
        robot, time = unravel(flat), history.time
        T_base = true_base(robot, history.T_base, time)
        return ready(robot, T_base, history.displacement), loads_of(T_base, time, history.cycle)

    def cells(flat, T_base, T_tip, time):
        return cells_show(unravel(flat), T_base, T_tip, time)

    def places(flat, body):
        robot = unravel(flat)
        shape = Shape(*body) if robot.space else shape_in_plane(robot, *body)
        return markers_on(robot, lay_out(robot).mesh.s, shape)

    return _Traced(*map(jax.jit, (begin, cells, places)))


def resolution_of(robot: Robot) -> float:
    """Mesh resolution for the search, from a robot on its own fine mesh."""
    return float(np.clip(INTERVALS / sum(robot.intervals), COARSEST, 1.0))


class _Asked(NamedTuple):
    """A simulation that is asked for.

    Attributes:
        flat: the numbers of the robot, as `ravel_pytree` flattens them.
        kinds: names of the physics terms that are given.
        loads: the history with its padding.
        structure: which equations act.
        run: what the native program needs.
        key: tells what the program gives from what it gives for others.
        parts: load steps of `run` for each sample.
    """

    flat: np.ndarray
    kinds: set[str]
    loads: Any
    structure: ProgramSpec
    run: Run
    key: tuple
    parts: int


class _Recent(Generic[Known]):
    """The last values by key; threads may share it."""

    def __init__(self, most: int):
        self._most, self._lock = most, threading.Lock()
        self._held: OrderedDict[Any, Known] = OrderedDict()

    def get(self, key: Any) -> Known:
        """The value under a key; KeyError if there is none."""
        with self._lock:
            self._held.move_to_end(key)
            return self._held[key]

    def put(self, key: Any, value: Known) -> None:
        """Keep a value in place of the oldest."""
        with self._lock:
            self._held[key] = value
            self._held.move_to_end(key)
            while len(self._held) > self._most:
                self._held.popitem(last=False)


class SimulatedRig:
    """One recording, and its robot on a coarse mesh.

    The native programs of `PROGRAMS` serve all hypotheses and recordings of a robot structure: where two of
    them hold the terms of a hypothesis, they agree to the tolerance of the solver on any mesh.

    Args:
        part: the recording.
        robot: the robot to simulate it with.
        more: names of further numbers that may change, beside friction, stiffness and those of the terms.
        cache: of simulations done before.

    Attributes:
        channels: what a simulation shows; see `instruments`.
        where: places of the recording's channels among them.
        drawn: which tendons displacement drives.
    """

    def __init__(
        self, part: Observation, robot: Robot, more: Iterable[str] = (), cache: SimulationCache | None = None
    ):
        self.part, self.robot, self.cache, self.more = part, robot, cache, tuple(more)
        self.channels = instruments(robot, part.channels)
        self.where = [self.channels.index(name) for name in part.channels]
        self.drawn = tuple(tendon.drive == "displacement" for tendon in robot.tendons)
        self._acting, self._cells = set(structure_of(robot, None).terms), bool(cells_differ(robot))
        own = of_each_tendon(robot)
        ends = robot.per_tendon(lambda tendon: robot.backbone.length if tendon.to is None else tendon.to)
        self._anchored = np.asarray(ends) * (1 - 1e-12)
        leaves, tree = jtu.tree_flatten(own)
        self._traced = _traced(tree, tuple(jnp.shape(leaf) for leaf in leaves))
        self._native, self._flat = Native(own), np.asarray(ravel_pytree(own)[0])
        names = [*robot_names(own), *self.more]
        places = np.asarray(places_of(own, names))
        self._places: dict[str, Any] = dict(zip(names, places.tolist(), strict=True))
        for name in sorted({*robot_names(robot)} - self._places.keys()):  # of all tendons at once
            self._places[name] = [self._places[f"{name}.{tendon}"] for tendon in robot.tendon_names]
        self._at_hand: _Recent[SimulatedReadings | None] = _Recent(AT_HAND)
        # What the cell at the tip adds changes what it shows, not what is simulated.
        self._runs: _Recent[Brief] = _Recent(RUNS_AT_HAND)

    def __call__(self, values: Mapping[str, float], more: tuple[float, ...] = ()) -> SimulatedReadings | None:
        """The recording with some numbers of the robot changed; None where the simulation breaks down.

        Args:
            values: SI, by name of the parameter.
            more: shift added throughout to what drives each tendon, base tension [N] or displacement [m];
                none unless given.
        """
        return self.many([values], more)[0]

    def many(
        self, many: Sequence[Mapping[str, float]], more: tuple[float, ...] = ()
    ) -> list[SimulatedReadings | None]:
        """As calls, simulated side by side."""
        keys = [(tuple(sorted(values_in(values, self.part.name).items())), more) for values in many]
        found: dict[Any, SimulatedReadings | None] = {}
        for key in keys:
            with contextlib.suppress(KeyError):
                found[key] = self._known(key)
        new = [key for key in dict.fromkeys(keys) if key not in found]
        for key, seen in zip(new, self._simulated(new), strict=True):
            found[key] = seen
            self._at_hand.put(key, seen)
            if self.cache is not None:
                self.cache.put(self._said(key), np.zeros(0) if seen is None else seen.flat())
        return [found[key] for key in keys]

    def _known(
        self, key: tuple[tuple[tuple[str, float], ...], tuple[float, ...]]
    ) -> SimulatedReadings | None:
        """What was simulated before; KeyError if it was not."""
        with contextlib.suppress(KeyError):
            return self._at_hand.get(key)
        known = None if self.cache is None else self.cache.get(self._said(key))
        if known is None:
            raise KeyError
        seen = SimulatedReadings.of(known, self.part.samples)
        self._at_hand.put(key, seen)
        return seen

    def _said(self, key: tuple[tuple[tuple[str, float], ...], tuple[float, ...]]) -> bytes:
        """Key of a simulation in the cache's file."""
        items, more = key
        said = [f"{name}={float(value).hex()}" for name, value in items]
        said += [float(shift).hex() for shift in more]
        return hashlib.blake2b("|".join(said).encode(), key=self.mark).digest()

    def of(self, part: Observation) -> SimulatedRig:
        """The same with another part of the same samples, of which others are compared; what was simulated is
        known to both.
        """
        other = copy.copy(self)
        other.part = part
        return other

    @functools.cached_property
    def mark(self) -> bytes:
        """A hash that tells this rig from others in the cache."""
        part = self.part
        whole = hashlib.blake2b(digest_size=32)
        turned = () if part.orientation is None else part.orientation
        for array in (part.drive, part.time, part.trial, self._flat, *turned):
            whole.update(b"-" if array is None else np.ascontiguousarray(array, float).tobytes())
        whole.update(
            repr(
                (
                    sources(),
                    (STEPS_BY_SPEED, MOST_STEPS),
                    own_mark(),
                    self.robot.intervals,
                    self.robot.laws,
                    self._places,
                    self.channels,
                    self.drawn,
                )
            ).encode()
        )
        return whole.digest()

    def _simulated(self, keys: Sequence[tuple]) -> list[SimulatedReadings | None]:
        """Values with their shifts, simulated side by side."""
        every = [self._asked(dict(items), more) for items, more in keys]
        runs: dict[tuple, Brief] = {}
        for asked in every:
            with contextlib.suppress(KeyError):
                runs[asked.key] = self._runs.get(asked.key)
        new = {asked.key: asked for asked in every if asked.key not in runs}
        for structure in dict.fromkeys(asked.structure for asked in new.values()):
            own = {key: asked.run for key, asked in new.items() if asked.structure == structure}
            for key, run in zip(own, simulated(self._native, structure, list(own.values())), strict=True):
                runs[key] = at_samples(run, new[key].parts)
                self._runs.put(key, runs[key])
        return [self._seen(asked, runs[asked.key]) for asked in every]

    def _asked(self, values: Mapping[str, float], more: tuple[float, ...]) -> _Asked:
        part, K = self.part, self.part.samples
        known = self.robot.catalogue
        asked = {name.partition(".")[0] for name in values} & known.keys()
        kinds = {kind for kind in asked if not known[kind].of_cells} | self._acting
        history = padded_history(part.drive, part.time, part.trial, drawn=self.drawn)
        history = history.driven_by(jnp.asarray(more)) if more else history
        flat = self._flat.copy()
        for name, value in values.items():
            flat[self._places[name]] = value
        ready, loads = self._traced.begin(flat, history)
        structure = structure_with(self.robot, program_for(self.robot, kinds))
        # The padding of the history is not simulated.
        steps = jtu.tree_map(lambda column: np.asarray(column)[:K], loads)
        drawn = None if history.displacement is None else np.asarray(history.displacement)[:K]
        by_speed = any(known[kind].by_speed is not None for kind in kinds)
        parts = min(STEPS_BY_SPEED, max(1, MOST_STEPS // K)) if by_speed else 1
        steps, drawn = in_parts(steps, parts), None if drawn is None else between(drawn, parts)
        own = tuple(sorted((n, v) for n, v in values.items() if not self._only_shown(n)))
        driven = (steps.T_base.tobytes(), None if drawn is None else drawn.tobytes())
        key = (own, structure, *driven)
        return _Asked(flat, asked, loads, structure, Run(ready, steps, drawn), key, parts)

    def _seen(self, asked: _Asked, run: Brief) -> SimulatedReadings | None:
        """What the channels show of a simulation; None where it breaks down."""
        part, K, loads = self.part, self.part.samples, asked.loads
        T_base, T_tip = run.T_base, run.T_tip
        if self._cells or any(self.robot.catalogue[kind].of_cells for kind in asked.kinds):
            held = (_held_on(T_base, loads), _held_on(T_tip, loads))
            shows = self._traced.cells(asked.flat, *held, loads.time)
            T_base, T_tip = (np.asarray(tension)[:K] for tension in shows)
        place, angle, turned = run.tip_pose[:, :2], run.tip_pose[:, 2], None
        if run.shape is not None:
            place, angle = run.shape.position[:, -1], None
            if part.orientation is not None:
                turned = np.asarray(_turned_by(jnp.asarray(run.shape.rotation[:, -1]), part.orientation))
        rows = channel_rows(
            self.robot,
            self.channels,
            place=place,
            angle=angle,
            turned=turned,
            markers=self._marked(asked.flat, run, loads),
            ends={"T_base": T_base, "T_tip": T_tip, "displacement": run.displacement},
        )
        values = np.stack(rows)
        if not np.all(np.isfinite(values)):
            return None
        whole = run.slip_front >= self._anchored
        return SimulatedReadings(values, int(np.sum(~run.converged)), whole, run.slip_direction)

    def _only_shown(self, name: str) -> bool:
        """Whether a number is one of a term that acts on what the load cells show and on nothing else."""
        term = self.robot.catalogue.get(name.partition(".")[0])
        return term is not None and term.of_cells and term.ahead is None

    def _marked(self, flat: np.ndarray, run: Brief, loads: Any) -> np.ndarray | None:
        """What `markers_on` gives, (K, markers, 4), where it is compared."""
        if not shows_markers(self.robot, self.channels):
            return None
        body = run.along if run.shape is None else run.shape
        assert body is not None
        held = tuple(None if values is None else _held_on(values, loads) for values in body)
        return np.asarray(self._traced.places(flat, held))[: len(run.T_tip)]


def between(values: np.ndarray, parts: int) -> np.ndarray:
    """Values at K samples, (K, ...), and those on straight lines between them, ((K - 1) parts + 1, ...)."""
    share = (np.arange(parts) / parts).reshape(-1, *[1] * (values.ndim - 1))
    lines = values[:-1, None] + share * np.diff(values, axis=0)[:, None]
    return np.concatenate([lines.reshape(-1, *values.shape[1:]), values[-1:]])


def in_parts(steps: Any, parts: int) -> Any:
    """Load steps, of `Load` with leading axis K, in so many parts each, but for the first."""
    if parts == 1:
        return steps
    dt = np.concatenate([steps.dt[:1], np.repeat(steps.dt[1:] / parts, parts)])
    T_base, time, cycle = (between(v, parts) for v in (steps.T_base, steps.time, steps.cycle))
    divided = (T_base, dt, time, cycle, np.diff(cycle, prepend=cycle[:1]))
    return jtu.tree_unflatten(jtu.tree_structure(steps), divided)


def at_samples(run: Brief, parts: int) -> Brief:
    """A run whose steps are parts of those between samples, at the samples; a sample has converged if all of
    its parts have.
    """
    if parts == 1:
        return run
    each = run.converged[1:].reshape(-1, parts).all(axis=1)
    sampled = jtu.tree_map(lambda values: values[::parts], run)
    return sampled._replace(converged=np.concatenate([run.converged[:1], each]))


def of_each_tendon(robot: Robot) -> Robot:
    """The robot with the numbers of its physics terms that may belong to a tendon given for each of several,
    so that one may differ.
    """
    if not robot.tendon_names:
        return robot
    count = len(robot.tendon_names)
    terms = {
        kind: {n: jnp.broadcast_to(v, (count,)) for n, v in values.items()}
        if acts_on_tendon(robot.catalogue[kind])
        else values
        for kind, values in robot.terms.items()
    }
    return dataclasses.replace(robot, terms=terms)


def valued(robot: Robot, values: Mapping[str, float]) -> Robot:
    """The robot with numbers changed, of a term that acts on one of several tendons as well."""
    known = parameters_of(robot)
    shared = {name: value for name, value in values.items() if name in known}
    robot, own = with_values(robot, shared), {n: v for n, v in values.items() if n not in shared}
    return with_values(of_each_tendon(robot), own) if own else robot


def acts_on_tendon(term: Term) -> bool:
    """Whether a term acts on a tendon, and not on the body, and goes on."""
    return not (term.bend or term.loads or term.stop or term.event)


def _held_on(values: np.ndarray, loads: Any) -> np.ndarray:
    """Values of K steps, (K, ...), held to the length of padded loads."""
    more = np.broadcast_to(values[-1], (len(loads.time) - len(values), *values.shape[1:]))
    return np.concatenate([values, more])


def robot_names(robot: Robot) -> list[str]:
    """Names of all numbers of a robot that a hypothesis may change."""
    known = parameters_of(robot)
    terms = [name for name, entry in known.items() if entry.term is not None]
    return [*friction_of(robot), *stiffness_of(robot), *terms]


def friction_of(robot: Robot) -> list[str]:
    """Names of the friction coefficients, one for each tendon."""
    return [f"mu.{name}" if name else "mu" for name in robot.tendon_names or ("",)]
