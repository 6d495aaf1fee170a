"""A load history, step by step: base tension in; tip tension, pose and the state of the tendon out."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from .equilibrium import describe, problem_of, rest_state, solve_problem, tendon_length
from .march import March
from .problem import tension_of
from .robot import Robot, sections


class Simulation(eqx.Module):
    """A load history of K steps on N nodes, SI units.

    Attributes:
        T_base: as given, (K,).
        T_tip: tension at the anchor, (K,).
        tip_pose: x, y, angle of the midline's tip, (K, 3).
        displacement: tendon drawn out at the base since the robot settled with a slack tendon, (K,).
        slip_direction: +1 where the tendon at the base slips towards the base in the step, -1 towards the
            tip, 0 at rest, (K,).
        slip_front: the tendon slips on [0, slip_front] and is locked beyond, (K,); L when all of it slips.
        s: nodes, (N,).
        tension, curvature, angle: along the robot, (K, N).
        result: optimistix result per step.
        residual_norm, iterations: per step, (K,).
    """

    T_base: Float[Array, " K"]
    T_tip: Float[Array, " K"]
    tip_pose: Float[Array, "K 3"]
    displacement: Float[Array, " K"]
    slip_direction: Float[Array, " K"]
    slip_front: Float[Array, " K"]
    s: Float[Array, " N"]
    tension: Float[Array, "K N"]
    curvature: Float[Array, "K N"]
    angle: Float[Array, "K N"]
    result: optx.RESULTS
    residual_norm: Float[Array, " K"]
    iterations: Int[Array, " K"]

    @property
    def converged(self) -> Bool[Array, " K"]:
        """True for each step that met the tolerance."""
        return self.result == optx.RESULTS.successful


SLIP_TOLERANCE = 1e-8


def _slip(s, tension, memory, scale):
    """Direction of slip at the base and arc length up to which it reaches."""
    change = tension - memory
    sign = jnp.where(jnp.abs(change) > SLIP_TOLERANCE * scale, jnp.sign(change), 0.0)
    locked = sign != sign[0]
    front = jnp.where(jnp.any(locked), s[jnp.maximum(jnp.argmax(locked) - 1, 0)], s[-1])
    return sign[0], jnp.where(sign[0] == 0.0, 0.0, front)


def padded_length(steps: int) -> int:
    """Length a history is padded to, at most a quarter more, so that a few compiled programs serve all."""
    if steps <= 16:
        return 16
    unit = 2 ** ((steps - 1).bit_length() - 3)
    return -(-steps // unit) * unit


@eqx.filter_jit
def _run(robot: Robot, T_base: Float[Array, " K"], solver: optx.AbstractRootFinder) -> Simulation:
    s = sections(robot)
    nodes = s.rest.shape
    zero = jnp.zeros((), s.rest.dtype)
    slack = problem_of(robot, s, zero, jnp.zeros(nodes))
    settled = solve_problem(slack, rest_state(s), solver)
    scale = jnp.maximum(jnp.max(T_base), jnp.maximum(robot.tendon.preload, 1e-6))

    def step(carry, T_now):
        memory, start = carry
        p = problem_of(robot, s, T_now, memory)
        sol = solve_problem(p, start, solver)
        tension = tension_of(sol.value, p)
        ok = sol.result == optx.RESULTS.successful
        start = jtu.tree_map(lambda new, old: jnp.where(ok, new, old), sol.value, start)
        return (jnp.where(ok, tension, memory), jax.lax.stop_gradient(start)), (sol, tension, memory)

    memory = jnp.broadcast_to(robot.tendon.preload, nodes)
    _, (sol, tension, memory) = jax.lax.scan(step, (memory, jax.lax.stop_gradient(settled.value)), T_base)
    # What is read off the states is computed for all steps at once, outside the loop.
    eq = jax.vmap(lambda sol, tension: describe(s, sol, tension))(sol, tension)
    direction, front = jax.vmap(lambda now, before: _slip(s.mesh.s, now, before, scale))(tension, memory)
    return Simulation(
        T_base=T_base,
        T_tip=eq.T_tip,
        tip_pose=eq.tip_pose,
        displacement=tendon_length(s, settled.value) - eq.tendon_length,
        slip_direction=direction,
        slip_front=front,
        s=s.mesh.s,
        tension=eq.tension,
        curvature=eq.curvature,
        angle=eq.angle,
        result=eq.result,
        residual_norm=eq.residual_norm,
        iterations=eq.iterations,
    )


def simulate(
    robot: Robot,
    T_base: ArrayLike | Sequence[float],
    *,
    solver: optx.AbstractRootFinder = March(),  # noqa: B008
) -> Simulation:
    """Run a robot through a load history; any sequence of pulls, releases, re-pulls and holds.

    The tendon starts at its preload (slack unless the robot file says otherwise), the robot settled under its
    external loads. Differentiable in every number of the robot and in T_base.

    Args:
        robot: from `load_robot`, or built in Python.
        T_base: base tension at each step [N], (K,), K >= 1; negative values count as slack.
        solver: as for `equilibrium`.

    Returns:
        One entry per step. A step that does not converge is flagged in `result` and leaves the tendon's
        memory as it was.

    Raises:
        ValueError: T_base is not a row of at least one tension.
    """
    history = jnp.asarray(T_base, dtype=float)
    if history.ndim != 1 or history.size == 0:
        raise ValueError(f"T_base: a history is one row of at least one tension, not shape {history.shape}")
    steps = history.shape[0]
    fill = jnp.broadcast_to(history[-1], (padded_length(steps) - steps,))
    run = _run(robot, jnp.concatenate([history, fill]), solver)
    return Simulation(
        **{k: v if k == "s" else jtu.tree_map(lambda a: a[:steps], v) for k, v in vars(run).items()}
    )
