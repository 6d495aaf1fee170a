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
from gtr_jax.simulation.shape import Shape

from .pose import in_space


class States(NamedTuple):
    """S states of one robot on its N nodes, SI.

    s: nodes, (N,), of each state the same. x, y, angle: midline, (S, N); in space angles of its projection.
    T_base, T_tip: (S, *tendons). converged: whether all, and what came before them, met the tolerance, ().
    shape: in space; None in the plane.
    """

    s: Float[Array, " N"]
    x: Float[Array, "S N"]
    y: Float[Array, "S N"]
    angle: Float[Array, "S N"]
    T_base: Float[Array, "S *tendons"]
    T_tip: Float[Array, "S *tendons"]
    converged: Bool[Array, ""]
    shape: Shape | None = None

    @property
    def pose(self) -> Float[Array, "S pose"]:
        """Pose of the tip, as `pose` has it."""
        if self.shape is not None:
            return in_space(self.shape.position[:, -1], self.shape.rotation[:, -1])
        return jnp.stack([self.x[:, -1], self.y[:, -1], self.angle[:, -1]], axis=-1)

    @property
    def midline(self) -> Float[Array, "S N axes"]:
        """Places of the midline [m]: x, y, and z in space."""
        return jnp.stack([self.x, self.y], axis=-1) if self.shape is None else self.shape.position

    @property
    def tangent(self) -> Float[Array, "S N axes"]:
        """Directions of the midline."""
        if self.shape is not None:
            return self.shape.rotation[..., 0]
        return jnp.stack([jnp.cos(self.angle), jnp.sin(self.angle)], axis=-1)


def states_of(
    robot: Robot, T_base: Float[Array, "S *tendons"], released: tuple[bool, ...], largest
) -> States:
    """Solve the states.

    Each is reached in one step: pulled from the preload, or pulled to the largest tension and from there
    released. For a single tendon with friction and no physics terms, any number of steps gives the same
    result. Several tendons are pulled together.

    Args:
        robot: the design.
        T_base: base tension of each state [N], (S, *tendons).
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
        ok = before.solved
    for at, memory in ((on_pull, None), (on_release, before)):
        if at:

            def one(T, memory=memory):
                eq = equilibrium(robot, T, memory=memory)
                return States(eq.s, eq.x, eq.y, eq.angle, T, eq.T_tip, eq.solved, eq.shape)

            # Not vmap with terms: lanes of a search would wait for the slowest.
            over = jax.lax.map if terms_act(robot) else lambda fn, T: jax.vmap(fn)(T)
            parts.append(over(one, T_base[jnp.asarray(at)]))
    order = jnp.argsort(jnp.asarray(on_pull + on_release))
    joined = jtu.tree_map(lambda *a: jnp.concatenate(a)[order], *parts)
    return joined._replace(s=joined.s[0], converged=ok & jnp.all(joined.converged))
