"""The tension at which release begins at the tip."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float

from ..robot.robot import Robot
from .equilibrium import equilibrium
from .programs import known_to_act

ALL_RELEASED = 1e4  # times the pull: a remembered tension so high that the whole tendon releases


class Switch(NamedTuple):
    """Where the transition after a pull ends, N.

    Attributes:
        T_base: T_base_switch, the base tension at which slip towards the tip reaches the tip, ().
        T_tip: T_tip_max, the tip tension held through the transition, ().
        converged: whether all solves met their tolerance, ().
    """

    T_base: Float[Array, ""]
    T_tip: Float[Array, ""]
    converged: Bool[Array, ""]


def release_switch(robot: Robot, T_base_max: Float[ArrayLike, ""]) -> Switch:
    """T_base_switch of Algorithm 1, solved for: the base tension whose fully releasing state has the tip
    tension of the pull.

    Args:
        robot: the robot, of one tendon; it is pulled once from its preload to `T_base_max`, then released.
        T_base_max: largest base tension [N].

    Returns:
        The switch; differentiable in the robot's numbers and in T_base_max.

    Raises:
        ValueError: the robot has several tendons, whose transitions depend on the paths of all, or a physics
            term acts: both need the whole history.
    """
    if known_to_act(robot):
        raise ValueError("release_switch: only without physics terms; simulate the history")
    if robot.tendon_names:
        raise ValueError("release_switch: only for robots of one tendon; simulate the history of all tendons")
    return _switch(robot, jnp.asarray(T_base_max, dtype=float))


@eqx.filter_jit
def _switch(robot: Robot, T_max: Float[Array, ""]) -> Switch:
    pulled = equilibrium(robot, T_max, with_terms=False)
    high = jnp.full_like(pulled.tension, ALL_RELEASED) * T_max

    def excess(T_base, args):
        robot, high, T_tip = args
        released = equilibrium(robot, T_base, memory=high, with_terms=False)
        return released.T_tip - T_tip, released.converged

    found = optx.root_find(
        excess,
        optx.Bisection(rtol=1e-13, atol=1e-13, flip=False),
        0.5 * T_max,
        args=(robot, high, pulled.T_tip),
        options={"lower": jnp.zeros_like(T_max), "upper": T_max * (1 + 1e-9) + 1e-12},
        max_steps=100,
        has_aux=True,
        throw=False,
    )
    solved = pulled.converged & (found.result == optx.RESULTS.successful) & found.aux
    return Switch(found.value, pulled.T_tip, solved)
