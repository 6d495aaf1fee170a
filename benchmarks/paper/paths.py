"""The eight routings of Table I on the cone of Figs. 2 and 3.

The modulus and the friction coefficient behind the figures are not published; two tension losses are. Two
numbers determine one material (mu, E), and everything else about the eight paths is then a prediction.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from gtr_jax.config.config import RobotConfig, load_config
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.equilibrium import equilibrium
from gtr_jax.simulation.forces import ChannelForces, channel_forces
from gtr_jax.simulation.solution import Equilibrium

from .study import ROBOTS

WAVES = (1, 2, 3, 4)  # Fig. 2
SEGMENTS = (5, 6, 7, 8)  # Fig. 3: straight, sine, straight
PATHS = WAVES + SEGMENTS
SAME_STRUCTURE = ((1, 2, 3), (4,), SEGMENTS)  # one compiled program each
T_BASE: dict[int, float] = {path: 60.0 if path in WAVES else 40.0 for path in PATHS}  # N
PUBLISHED_LOSS = {1: 0.692, 3: 0.995}  # at 60 N
PUBLISHED_LOST = {1: 41.5, 3: 59.7}  # the same in newtons
HALF_DIGIT = 0.0005
FIRST_GUESS = (0.3, 0.5e6)
STARTS = tuple((mu, E) for mu in (0.1, 0.3, 0.8) for E in (0.1e6, 0.5e6, 2e6))


@functools.cache
def config_of(path: int) -> RobotConfig:
    """The robot file of a path."""
    return load_config(ROBOTS / f"path-{path}.toml")


def dimension(path: int, name: str) -> float:
    """A number of a path's routing: n_sine, or w1 or w2 [m]."""
    return config_of(path).numbers()[f"routing.{name}"]


@functools.cache
def robots() -> dict[int, Robot]:
    """The paths on the cone. Those of one structure share a mesh, and so a compiled program."""
    built = {path: build_robot(config_of(path)) for path in PATHS}
    for group in SAME_STRUCTURE:
        intervals = tuple(max(counts) for counts in zip(*(built[p].intervals for p in group), strict=True))
        for path in group:
            built[path] = dataclasses.replace(built[path], intervals=intervals, name="")
    return built


class Material(NamedTuple):
    """Friction coefficient [-] and modulus [Pa] that meet two losses; `error` is what the search left,
    relative to the tip tensions; `settled` whether that is nothing.
    """

    mu: Any
    E: Any
    error: Any
    settled: Any


@eqx.filter_jit
def fit_material(
    fitted: tuple[Robot, Robot], losses: Float[Array, "lanes 2"], starts: Float[Array, "lanes 2"]
):
    """(mu, E) for each pair of losses of paths 1 and 3 at 60 N: Levenberg and Marquardt's method in their
    logarithms, with derivatives through the equilibrium.

    Args:
        fitted: paths 1 and 3.
        losses: share of the base tension lost.
        starts: (mu, E) to start from.

    Returns:
        A `Material` of (lanes,).
    """

    def missed(logs, aims):
        mu, E = jnp.exp(logs)
        states = [equilibrium(robot.with_values(mu=mu, E=E), T_BASE[1], with_terms=False) for robot in fitted]
        return jnp.stack([jnp.log(state.T_tip / T_BASE[1]) for state in states]) - jnp.log1p(-aims)

    def one(aims, start):
        solver = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
        found = optx.least_squares(missed, solver, jnp.log(start), args=aims, max_steps=80, throw=False)
        error = jnp.max(jnp.abs(missed(found.value, aims)))
        mu, E = jnp.exp(found.value)
        return Material(mu, E, error, error < 1e-8)

    return jax.vmap(one)(losses, starts)


class Solved(NamedTuple):
    """The material, and how well two losses determine it.

    material: from the published losses. starts: the same from each of STARTS, (starts,). corners: with the
    losses at the ends of their rounding, (4,).
    """

    material: Material
    starts: Material
    corners: Material


@functools.cache
def solved() -> Solved:
    """The material behind the paper's figures, in numpy."""
    published = np.asarray([PUBLISHED_LOSS[1], PUBLISHED_LOSS[3]])
    ends = [published + HALF_DIGIT * np.asarray([a, b]) for a in (-1, 1) for b in (-1, 1)]
    losses = np.stack([published] * len(STARTS) + ends)
    starts = np.asarray(list(STARTS) + [FIRST_GUESS] * len(ends))
    pair = (robots()[1], robots()[3])
    found = jax.tree_util.tree_map(np.asarray, fit_material(pair, jnp.asarray(losses), jnp.asarray(starts)))
    first = Material(*(field[: len(STARTS)] for field in found))
    best = int(np.argmin(np.where(first.settled, first.error, np.inf)))
    return Solved(
        Material(*(field[best] for field in first)),
        first,
        Material(*(field[len(STARTS) :] for field in found)),
    )


def of_material(path: int, material: Material, *, mu: float | None = None) -> Robot:
    """A path in a material, or with another friction coefficient."""
    mu = float(material.mu) if mu is None else mu
    return robots()[path].with_values(mu=mu, E=float(material.E))


class State(NamedTuple):
    """A path pulled to its base tension: robot, equilibrium, forces, and the equilibrium without friction."""

    robot: Robot
    pulled: Equilibrium
    forces: ChannelForces
    frictionless: Equilibrium


@functools.cache
def states() -> dict[int, State]:
    """All eight, in the fitted material."""
    out = {}
    for path in PATHS:
        robot = of_material(path, solved().material)
        pulled = equilibrium(robot, T_BASE[path])
        slippery = equilibrium(robot.with_values(mu=0.0), T_BASE[path])
        out[path] = State(robot, pulled, channel_forces(pulled), slippery)
    return out
