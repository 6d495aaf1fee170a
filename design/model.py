"""The states that a design is judged by: the robot pulled, or pulled and released, to the base tensions of
the targets.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Bool, Float

from gtr_jax.equilibrium import equilibrium, preload_of, problem_of, solve_problem
from gtr_jax.march import March
from gtr_jax.mechanics import rest_state
from gtr_jax.mesh import cumulative
from gtr_jax.problem import tension_of
from gtr_jax.robot.robot import Robot, sections

SOLVER = March()


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


def states_of(
    robot: Robot, T_base: Float[Array, " S"], released: tuple[bool, ...], largest, with_terms: bool
) -> States:
    """Solve the states.

    Each is reached in one step: pulled from the preload, or pulled to the largest tension and from there
    released. For a tendon alone, friction without physics terms gives the same as any number of steps.

    Args:
        robot: of one tendon.
        T_base: base tension of each state [N], (S,).
        released: for each state, whether it lies on the releasing branch (static).
        largest: base tension before release [N], ().
        with_terms: whether the robot's physics terms act (static).

    Returns:
        The states; `converged` is False if any failed.
    """
    solve = _with_terms if with_terms else _plain
    on_release = [i for i, r in enumerate(released) if r]
    on_pull = [i for i, r in enumerate(released) if not r]
    parts, before = [], None
    s = sections(robot)
    ok = jnp.asarray(True)
    if on_release:
        first, before = solve(robot, s, largest, None)
        ok = first.converged
    for at, memory in ((on_pull, None), (on_release, before)):
        if at:

            def one(T, memory=memory):
                return solve(robot, s, T, memory)[0]

            # Not vmap with terms: their march has arrays of no size, which jax 0.10 cannot lower in a batch.
            over = jax.lax.map if with_terms else lambda fn, T: jax.vmap(fn)(T)
            solved = over(one, T_base[jnp.asarray(at)])
            parts.append(solved)
    order = jnp.argsort(jnp.asarray(on_pull + on_release))
    joined = jtu.tree_map(lambda *a: jnp.concatenate(a)[order], *parts)
    return joined._replace(s=joined.s[0], converged=ok & jnp.all(joined.converged))


def _plain(robot: Robot, s, T_base, memory):
    p = problem_of(robot, s, T_base, preload_of(robot, s) if memory is None else memory)
    found = solve_problem(p, rest_state(s), SOLVER)
    y, weights = found.value, s.mesh.weights
    tension = tension_of(y, p)
    x, across = cumulative(weights, jnp.cos(y.phi)), cumulative(weights, jnp.sin(y.phi))
    state = States(s.mesh.s, x, across, y.phi, T_base, tension[-1], found.result == optx.RESULTS.successful)
    return state, tension


def _with_terms(robot: Robot, s, T_base, memory):
    eq = equilibrium(robot, T_base, memory=memory, with_terms=True, solver=SOLVER)
    return States(eq.s, eq.x, eq.y, eq.angle, T_base, eq.T_tip, eq.converged), eq
