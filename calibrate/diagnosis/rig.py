"""A recording that is simulated again and again, small and fast enough to try every hypothesis on it."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Iterable, Mapping
from importlib.metadata import version

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from gtr_jax import Robot
from gtr_jax.robot.parameters import places_of
from gtr_jax.simulation.programs import known_to_act
from gtr_jax.terms import REGISTRY

from ..number import values_in
from ..predictor import History, Seen, padded_history, shown
from ..setup import Part
from .cache import SimulationCache

# Numbers that may differ from the robot's own in one simulation.
PLACES = 24
# Intervals of the mesh that hypotheses are tried on, and least share of the robot's own.
INTERVALS, COARSEST = 22, 0.35
# Simulations that a rig has at hand: a number of one recording leaves those of the others as they were.
AT_HAND = 64
# Samples kept behind each bend of the base tension: there friction that depends on the speed changes fast.
AFTER = (1, 2, 3, 5, 8, 12, 18)


@eqx.filter_jit
def _shown(robot: Robot, places: Int[Array, " P"], values: Float[Array, " P"], history: History):
    flat, unravel = ravel_pytree(robot)
    changed = unravel(jnp.append(flat, 0.0).at[places].set(values)[:-1])
    seen, run = shown(changed, history)
    return seen, run.converged, run.slip_front, run.slip_direction


def resolution_of(robot: Robot) -> float:
    """Mesh resolution to search with, of a robot meshed finely."""
    return float(np.clip(INTERVALS / sum(robot.intervals), COARSEST, 1.0))


def some_samples(part: Part, most: int) -> np.ndarray:
    """About so many samples that carry a recording, increasing from first to last: the bends of its base
    tension, some behind each, and others between, evenly in tension and in time.
    """
    base, K = part.T_base, part.samples
    if most >= K:
        return np.arange(K)
    turns = 1 + np.flatnonzero(np.diff(np.sign(np.diff(base.T_base))) != 0) if base.sd == 0 else base.knots
    turns = turns if len(turns) < most // 4 else turns[:: max(1, 4 * len(turns) // most)]
    behind = (turns[:, None] + np.asarray((0, *AFTER))).ravel()
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(base.T_base)))])
    share = 0.5 * travel / max(travel[-1], 1e-300) + 0.5 * np.arange(K) / K
    left = max(most - len(np.unique(behind[behind < K])), most // 2)
    even = np.searchsorted(share, np.linspace(0, share[-1], left))
    return np.unique(np.concatenate([[0, K - 1], behind[behind < K], np.minimum(even, K - 1)]))


class Rig:
    """One recording, and the robot it is of, coarsely meshed.

    Per robot structure and padded length, one compiled program serves every hypothesis of the load cells, and
    a second, ten times slower, all others: without physics terms the two agree to 1e-9 N on any mesh.

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
        self._acting = bool(known_to_act(robot))
        names = [*robot_names(robot), *self.more]
        places = np.asarray(places_of(robot, names))
        self._places = dict(zip(names, places.tolist(), strict=True))
        self._none = int(ravel_pytree(robot)[0].shape[0])
        self._at_hand = functools.lru_cache(AT_HAND)(self._remembered)

    def __call__(self, values: Mapping[str, float], more_base: float = 0.0) -> Seen | None:
        """The recording with some numbers of the robot changed; None where the simulation breaks down.

        Args:
            values: SI, by name of the parameter; at most PLACES of this recording.
            more_base: by how much the base tension is higher throughout [N].
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

    @functools.cached_property
    def mark(self) -> bytes:
        """What tells this rig from others."""
        part, flat = self.part, ravel_pytree(self.robot)[0]
        whole = hashlib.blake2b(digest_size=32)
        for array in (part.T_base.T_base, part.time, part.trial, np.asarray(flat)):
            whole.update(b"-" if array is None else np.ascontiguousarray(array, float).tobytes())
        whole.update(repr((version("gtr-jax"), self.robot.intervals, self._places)).encode())
        return whole.digest()

    def _simulated(self, values: Mapping[str, float], more_base: float) -> Seen | None:
        part = self.part
        acting = any(
            not REGISTRY[kind].of_cells
            for name in values
            for kind in [name.partition(".")[0]]
            if kind in REGISTRY
        )
        history = padded_history(
            part.T_base.T_base + more_base, part.time, part.trial, with_terms=self._acting or acting
        )
        places, numbers = np.full(PLACES, self._none), np.zeros(PLACES)
        for i, (name, value) in enumerate(values.items()):
            places[i], numbers[i] = self._places[name], value
        try:
            seen, converged, front, direction = jax.block_until_ready(
                _shown(self.robot, jnp.asarray(places), jnp.asarray(numbers), history)
            )
        except RuntimeError as fault:  # a linear solve given NaN raises, from within the compiled program
            if "non-finite" not in str(fault):
                raise
            return None
        K = part.samples
        shown = np.asarray(seen)[:, :K]
        if not np.all(np.isfinite(shown)):
            return None
        whole = np.asarray(front)[:K] >= float(self.robot.backbone.length) * (1 - 1e-12)
        return Seen(shown, int(np.sum(~np.asarray(converged)[:K])), whole, np.asarray(direction)[:K])


def robot_names(robot: Robot) -> list[str]:
    """Names of all numbers of a robot that a hypothesis may change."""
    terms = [f"{kind}.{name}" for kind, values in robot.terms.items() for name in values]
    return ["mu", *([] if robot.backbone.rigid else ["E"]), *terms]
