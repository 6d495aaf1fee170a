"""One equilibrium of rod and tendon, and what is read off it."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from . import channel
from .adjoint import CausalAdjoint
from .march import March
from .mesh import cumulative, increments
from .problem import Problem, Sections, State, residual, tension_of
from .robot import Robot, sections

MAX_STEPS = 256


class Equilibrium(eqx.Module):
    """Solution of one equilibrium, SI units; N nodes from base to tip, panel ends twice. May carry batch axes
    in front.

    Attributes:
        s: arc length of the nodes, (N,).
        curvature, angle: of the midline, (N,).
        tension: of the tendon, (N,).
        external_moment: moment of the external loads, (N,).
        x, y: midline, (N,).
        wrap: total turning of the tendon since the base, (N,).
        metric: nu = ds_c/ds of the channel, (N,).
        R: channel offset, (N,).
        tendon_length: length of the channel, ().
        result: optimistix result; compare with `optimistix.RESULTS.successful`.
        residual_norm: dimensionless, see `problem.residual_norm`; ().
        iterations: marches taken, ().
    """

    s: Float[Array, " N"]
    curvature: Float[Array, " N"]
    angle: Float[Array, " N"]
    tension: Float[Array, " N"]
    external_moment: Float[Array, " N"]
    x: Float[Array, " N"]
    y: Float[Array, " N"]
    wrap: Float[Array, " N"]
    metric: Float[Array, " N"]
    R: Float[Array, " N"]
    tendon_length: Float[Array, ""]
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]

    @property
    def T_tip(self) -> Float[Array, "*batch"]:
        """Tension at the tip anchor [N]."""
        return self.tension[..., -1]

    @property
    def tip_pose(self) -> Float[Array, "*batch 3"]:
        """Midline tip: x [m], y [m], angle [rad]."""
        return jnp.stack([self.x[..., -1], self.y[..., -1], self.angle[..., -1]], axis=-1)

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """True where the solver met its tolerance."""
        return self.result == optx.RESULTS.successful


def rest_state(s: Sections) -> State:
    """Start for the solver: the stress-free shape, with the moment the external load would have on a straight
    arm.
    """
    phi = cumulative(s.mesh.weights, s.rest)
    lever = jnp.sum(s.mesh.interval.length * (s.force_y * jnp.cos(phi) - s.force_x * jnp.sin(phi)))
    return State(
        s.rest,
        phi,
        jnp.zeros_like(s.rest),
        jnp.broadcast_to(jnp.where(jnp.any(s.compliance > 0), lever, 0.0), s.rest.shape),
    )


def solve_problem(p: Problem, start: State, solver: optx.AbstractRootFinder) -> optx.Solution:
    """Solve one problem from a start, with the implicit adjoint through the structured linear solver; never
    raises.
    """
    return optx.root_find(
        residual,
        solver,
        jax.lax.stop_gradient(start),
        args=p,
        adjoint=CausalAdjoint(),
        max_steps=MAX_STEPS,
        throw=False,
    )


def tendon_length(s: Sections, y: State) -> Float[Array, ""]:
    """Length of the channel from base to tip [m]."""
    return jnp.sum(increments(s.mesh.weights, channel.metric_factor(y.kappa, s.R)))


def describe(s: Sections, sol: optx.Solution, tension: Float[Array, " N"]) -> Equilibrium:
    """Everything an equilibrium offers, from the solved state."""
    y = sol.value
    return Equilibrium(
        s=s.mesh.s,
        curvature=y.kappa,
        angle=y.phi,
        tension=tension,
        external_moment=y.moment,
        x=cumulative(s.mesh.weights, jnp.cos(y.phi)),
        y=cumulative(s.mesh.weights, jnp.sin(y.phi)),
        wrap=y.wrap,
        metric=channel.metric_factor(y.kappa, s.R),
        R=s.R.value,
        tendon_length=tendon_length(s, y),
        result=sol.result,
        residual_norm=sol.stats["residual_norm"],
        iterations=sol.stats["num_steps"],
    )


def problem_of(robot: Robot, s: Sections, T_base: Float[Array, ""], memory: Float[Array, " N"]) -> Problem:
    """One load step of the robot as a problem; a base tension below zero counts as slack."""
    return Problem(
        sections=s,
        mu=robot.tendon.friction_coefficient,
        T_base=jnp.where(T_base < 0.0, 0.0, T_base),  # not maximum: its derivative at 0 is one half
        memory=memory,
        tip_moment=robot.loads.tip_moment,
        loaded=robot.loaded,
    )


@eqx.filter_jit
def _solve(
    robot: Robot, T_base: Float[Array, ""], memory: Float[Array, " N"] | None, solver: optx.AbstractRootFinder
) -> Equilibrium:
    s = sections(robot)
    before = jnp.broadcast_to(robot.tendon.preload, s.rest.shape) if memory is None else memory
    p = problem_of(robot, s, T_base, before)
    sol = solve_problem(p, rest_state(s), solver)
    return describe(s, sol, tension_of(sol.value, p))


def equilibrium(
    robot: Robot,
    T_base: ArrayLike,
    *,
    memory: Float[Array, " N"] | None = None,
    solver: optx.AbstractRootFinder = March(),  # noqa: B008
) -> Equilibrium:
    """Equilibrium of the robot under a base tension.

    Without `memory` the tendon is pulled once from its preload (slack unless the robot says otherwise).
    Differentiable in every number of the robot and in T_base, by the implicit function theorem; one-sided at
    stick fronts.

    Args:
        robot: from `load_robot`, or built in Python.
        T_base: tension at the base [N], scalar.
        memory: tension along the tendon before this load [N], (N,), as `Equilibrium.tension` of the step
            before.
        solver: any optimistix root finder that takes a `Problem`; tolerances live there.

    Returns:
        The solution. It never raises on non-convergence: look at `result`, `converged` and `residual_norm`.

    Raises:
        ValueError: T_base is not a scalar.
    """
    load = jnp.asarray(T_base, dtype=float)
    if load.ndim != 0:
        raise ValueError(
            f"T_base: one base tension, not shape {load.shape}; jax.vmap over several, or simulate"
        )
    return _solve(robot, load, memory, solver)
