"""A recording that is simulated again and again, small and fast enough to try every hypothesis on it."""

from __future__ import annotations

import copy
import functools
import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from gtr_jax import Robot, true_base
from gtr_jax.robot.parameters import parameters_of, places_of
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import Native, Ready, ready, sources
from gtr_jax.simulation.programs import every, structure_of, structure_with
from gtr_jax.simulation.sensing import cells_differ, cells_show
from gtr_jax.terms import REGISTRY

from ..number import values_in
from ..predictor import Seen, padded_history
from ..setup import Part
from .cache import SimulationCache

# Mesh intervals with which hypotheses are tried, and their least share of the robot's own intervals.
INTERVALS, COARSEST = 22, 0.35
# Simulations that a rig keeps in memory: a change in a number of one recording leaves those of the others
# valid.
AT_HAND = 64


# Terms in each program that simulates a recording, from the fastest to the slowest program: a hypothesis uses
# the first that has all its terms. Load steps a second on the demo's mesh: 90,000, 40,000, 23,000, 20,000 and
# 11,000; each compiles in 0.7 to 1.8 s. A program of its own for every hypothesis would take 0.7 s each.
EVERY = every()
_BESIDE_LOADS = [kind for kind in EVERY if not REGISTRY[kind].loads and REGISTRY[kind].stop is None]
_BY_SLIP = ("presliding", "viscous-friction")
PROGRAMS = (
    (),
    tuple(kind for kind in _BESIDE_LOADS if kind not in (*_BY_SLIP, "viscoelastic-body")),
    tuple(kind for kind in EVERY if kind not in _BY_SLIP),
    tuple(kind for kind in EVERY if kind != "viscous-friction"),
    EVERY,
)


def program_for(kinds: Collection[str]) -> tuple[str, ...]:
    """Names of the physics terms of the fastest program that has all of these; laws of the robot file, which
    no program has from the start, are added to it.
    """
    laws = tuple(sorted(set(kinds) - set(EVERY)))
    return (*next(held for held in PROGRAMS if set(kinds) <= {*held, *laws}), *laws)


class _Traced(NamedTuple):
    """What is compiled for all robots of a structure, given their numbers as `ravel_pytree` flattens them.

    Attributes:
        begin: maps a robot, the base tension that its cell shows [N], time and cycles, (P,) each, to the
            inputs of the native programs.
        tip_cell: maps a robot, its load steps and true tip tensions [N], (P,), to the tensions that the tip
            cell shows [N].
    """

    begin: Callable[..., tuple[Ready, Any]]
    tip_cell: Callable[..., Float[Array, " P"]]


@functools.lru_cache(maxsize=16)
def _traced(tree, shapes: tuple[tuple[int, ...], ...]) -> _Traced:
    unravel = ravel_pytree(jtu.tree_unflatten(tree, [jnp.zeros(shape) for shape in shapes]))[1]

    def begin(flat, T_base, time, cycle):
        robot = unravel(flat)
        T_base = true_base(robot, T_base, time)
        return ready(robot, T_base), loads_of(T_base, time, cycle)

    def tip_cell(flat, loads, T_tip):
        return cells_show(unravel(flat), loads.T_base, T_tip, loads.time).T_tip

    return _Traced(jax.jit(begin), jax.jit(tip_cell))


def resolution_of(robot: Robot) -> float:
    """Mesh resolution for the search, from a robot on its own fine mesh."""
    return float(np.clip(INTERVALS / sum(robot.intervals), COARSEST, 1.0))


class _Run(NamedTuple):
    """What a native program needs, and a key that says which of them give the same."""

    key: tuple
    ready: Ready
    structure: Any
    steps: Any

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Run) and self.key == other.key


class Rig:
    """One recording, and its robot on a coarse mesh.

    The native programs of `PROGRAMS` serve all hypotheses and recordings of a robot structure: where two of
    them hold the terms of a hypothesis, they agree to the tolerance of the solver on any mesh.

    Args:
        part: the recording.
        robot: the robot to simulate it with.
        more: names of further numbers that may change, beside mu, E and those of the terms.
        cache: of simulations done before.
    """

    def __init__(
        self, part: Part, robot: Robot, more: Iterable[str] = (), cache: SimulationCache | None = None
    ):
        self.part, self.robot, self.cache, self.more = part, robot, cache, tuple(more)
        self._acting, self._cells = set(structure_of(robot, None).terms), bool(cells_differ(robot))
        leaves, tree = jtu.tree_flatten(robot)
        self._traced = _traced(tree, tuple(jnp.shape(leaf) for leaf in leaves))
        self._native, self._flat = Native(robot), np.asarray(ravel_pytree(robot)[0])
        names = [*robot_names(robot), *self.more]
        places = np.asarray(places_of(robot, names))
        self._places = dict(zip(names, places.tolist(), strict=True))
        self._at_hand = functools.lru_cache(AT_HAND)(self._remembered)
        # What the cell at the tip adds changes what it shows, not what is simulated.
        self._run = functools.lru_cache(AT_HAND)(lambda of: self._native(of.ready, of.structure, of.steps))

    def __call__(self, values: Mapping[str, float], more_base: float = 0.0) -> Seen | None:
        """The recording with some numbers of the robot changed; None where the simulation breaks down.

        Args:
            values: SI, by name of the parameter.
            more_base: shift added to the base tension throughout [N].
        """
        own = values_in(values, self.part.name)
        return self._at_hand(tuple(sorted(own.items())), more_base)

    def _remembered(self, items: tuple[tuple[str, float], ...], more_base: float) -> Seen | None:
        values = dict(items)
        if self.cache is None:
            return self._simulated(values, more_base)
        said = [f"{name}={float(value).hex()}" for name, value in items]
        key = hashlib.blake2b("|".join([*said, float(more_base).hex()]).encode(), key=self.mark).digest()
        known = self.cache.get(key)
        if known is not None:
            return Seen.of(known, self.part.samples)
        seen = self._simulated(values, more_base)
        self.cache.put(key, np.zeros(0) if seen is None else seen.flat())
        return seen

    def of(self, part: Part) -> Rig:
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
        for array in (part.T_base.T_base, part.time, part.trial, self._flat):
            whole.update(b"-" if array is None else np.ascontiguousarray(array, float).tobytes())
        whole.update(repr((sources(), self.robot.intervals, self.robot.laws, self._places)).encode())
        return whole.digest()

    def _simulated(self, values: Mapping[str, float], more_base: float) -> Seen | None:
        part, K = self.part, self.part.samples
        known = self.robot.catalogue
        asked = {name.partition(".")[0] for name in values} & known.keys()
        kinds = {kind for kind in asked if not known[kind].of_cells} | self._acting
        history = padded_history(part.T_base.T_base, part.time, part.trial)
        flat = self._flat.copy()
        for name, value in values.items():
            flat[self._places[name]] = value
        shown_base = np.asarray(history.T_base) + more_base
        ready, loads = self._traced.begin(flat, shown_base, history.time, history.cycle)
        structure = structure_with(self.robot, program_for(kinds))
        # The padding of the history is not simulated.
        steps = jtu.tree_map(lambda column: np.asarray(column)[:K], loads)
        own = tuple(sorted((n, v) for n, v in values.items() if not self._only_shown(n)))
        run = self._run(_Run((own, structure, steps.T_base.tobytes()), ready, structure, steps))
        T_tip = run.T_tip
        if self._cells or any(known[kind].of_cells for kind in asked):
            held_on = np.concatenate([T_tip, np.full(len(loads.time) - K, T_tip[-1])])
            T_tip = np.asarray(self._traced.tip_cell(flat, loads, held_on))[:K]
        shown = np.stack([T_tip, *run.tip_pose.T, run.displacement])
        if not np.all(np.isfinite(shown)):
            return None
        whole = run.slip_front >= float(self.robot.backbone.length) * (1 - 1e-12)
        return Seen(shown, int(np.sum(~run.converged)), whole, run.slip_direction)

    def _only_shown(self, name: str) -> bool:
        """Whether a number is one of a term that acts on what the load cells show and on nothing else."""
        term = self.robot.catalogue.get(name.partition(".")[0])
        return term is not None and term.of_cells and term.ahead is None


def robot_names(robot: Robot) -> list[str]:
    """Names of all numbers of a robot that a hypothesis may change."""
    terms = [name for name, entry in parameters_of(robot).items() if entry.term is not None]
    return ["mu", *([] if robot.backbone.rigid else ["E"]), *terms]
