"""The states that a design is judged by: the robot pulled, or pulled and released, to the base tensions of
the targets.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float

from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.equilibrium import equilibrium
from gtr_jax.simulation.programs import terms_act


class States(NamedTuple):
    """S states of one robot on its N nodes, SI.

    s: nodes, (N,), of each state the same. x, y, angle: midline, (S, N). T_base, T_tip: (S,). converged:
    whether all, and what came before them, met the tolerance, ().
    """

    s: Float[Array, " N"]
    x: Float[Array, "S N"]
    y: Float[Array, "S N"]
    angle: Float[Array, "S N"]
    T_base: Float[Array, " S"]
    T_tip: Float[Array, " S"]
    converged: Bool[Array, ""]

    @property
    def pose(self) -> Float[Array, "S 3"]:
        """Tip: x [m], y [m], angle [rad]."""
        return jnp.stack([self.x[:, -1], self.y[:, -1], self.angle[:, -1]], axis=-1)


def states_of(robot: Robot, T_base: Float[Array, " S"], released: tuple[bool, ...], largest) -> States:
    """Solve the states.

    Each is reached in one step: pulled from the preload, or pulled to the largest tension and from there
    released. For a single tendon with friction and no physics terms, any number of steps gives the same
    result.

    Args:
        robot: of one tendon.
        T_base: base tension of each state [N], (S,).
        released: for each state, whether it lies on the releasing branch (static).
        largest: base tension before release [N], ().

    Returns:
        The states; `converged` is False if any failed.
    """
    on_release = [i for i, r in enumerate(released) if r]
    on_pull = [i for i, r in enumerate(released) if not r]
    parts, before = [], None
    ok = jnp.asarray(True)
    if on_release:
        before = equilibrium(robot, largest)
        ok = before.converged
    for at, memory in ((on_pull, None), (on_release, before)):
        if at:

            def one(T, memory=memory):
                eq = equilibrium(robot, T, memory=memory)
                return States(eq.s, eq.x, eq.y, eq.angle, T, eq.T_tip, eq.converged)

            # Not vmap with terms: lanes of a search would wait for the slowest.
            over = jax.lax.map if terms_act(robot) else lambda fn, T: jax.vmap(fn)(T)
            parts.append(over(one, T_base[jnp.asarray(at)]))
    order = jnp.argsort(jnp.asarray(on_pull + on_release))
    joined = jtu.tree_map(lambda *a: jnp.concatenate(a)[order], *parts)
    return joined._replace(s=joined.s[0], converged=ok & jnp.all(joined.converged))
