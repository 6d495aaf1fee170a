"""One equilibrium of rod and tendon, and what is read off it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from . import channel, slip
from .adjoint import CausalAdjoint
from .march import March
from .mesh import cumulative, increments
from .problem import Problem, Sections, State, at_tendons, residual, tension_of
from .robot import Robot, sections

MAX_STEPS = 256


class Equilibrium(eqx.Module):
    """Solution of one equilibrium, SI units; N nodes from base to tip, panel ends twice. May carry batch axes
    in front. What belongs to a tendon has a tendon axis where the robot has several.

    Attributes:
        s: arc length of the nodes, (N,).
        curvature, angle: of the midline, (N,).
        tension: of the tendon, (*tendons, N).
        external_moment: moment of the external loads, (N,).
        x, y: midline, (N,).
        wrap: total turning of the tendon since the base, (*tendons, N).
        tendon_angle: psi of the tendon's tangent from the x axis [rad], (*tendons, N).
        metric: nu = ds_c/ds of the channel, (*tendons, N).
        R: channel offset, (*tendons, N).
        tendon_length: length of the channel, (*tendons,).
        mobilisation: of friction between each node and the one before it, +1 slipping towards the base, -1
            towards the tip, between where locked, (tendons, N); None for one tendon.
        result: optimistix result; compare with `optimistix.RESULTS.successful`.
        residual_norm: dimensionless, see `problem.residual_norm`; ().
        iterations: marches taken, ().
    """

    s: Float[Array, " N"]
    curvature: Float[Array, " N"]
    angle: Float[Array, " N"]
    tension: Float[Array, "*tendons N"]
    external_moment: Float[Array, " N"]
    x: Float[Array, " N"]
    y: Float[Array, " N"]
    wrap: Float[Array, "*tendons N"]
    tendon_angle: Float[Array, "*tendons N"]
    metric: Float[Array, "*tendons N"]
    R: Float[Array, "*tendons N"]
    tendon_length: Float[Array, "*tendons"]
    mobilisation: Float[Array, "tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]

    @property
    def T_tip(self) -> Float[Array, "*batch_tendons"]:
        """Tension at the tip anchor [N], (*tendons,)."""
        return self.tension[..., -1]

    @property
    def tip_pose(self) -> Float[Array, "*batch 3"]:
        """Midline tip: x [m], y [m], angle [rad]."""
        return jnp.stack([self.x[..., -1], self.y[..., -1], self.angle[..., -1]], axis=-1)

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """True where the solver met its tolerance."""
        return self.result == optx.RESULTS.successful

    def of_tendon(self, index: int) -> Equilibrium:
        """What this solution is for one of several tendons: the same, without the tendon axis."""
        own = ("tension", "wrap", "tendon_angle", "metric", "R", "tendon_length")
        taken = {name: getattr(self, name)[index] for name in own}
        return dataclasses.replace(self, **taken, mobilisation=None)


def rest_state(s: Sections) -> State:
    """Start for the solver: the stress-free shape, with the moment the external load would have on a straight
    arm.
    """
    phi = cumulative(s.mesh.weights, s.rest)
    lever = jnp.sum(s.mesh.interval.length * (s.force_y * jnp.cos(phi) - s.force_x * jnp.sin(phi)))
    return State(
        s.rest,
        phi,
        jnp.zeros_like(s.R.value),
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


def metric_of(s: Sections, y: State) -> Float[Array, "*tendons N"]:
    """nu = ds_c/ds of the channels, (*tendons, N)."""
    return channel.metric_factor(at_tendons(y.kappa, s.R), s.R)


def tendon_length(s: Sections, y: State) -> Float[Array, "*tendons"]:
    """Length of the channels from base to tip [m], (*tendons,)."""

    def length(metric):
        return jnp.sum(increments(s.mesh.weights, metric))

    metric = metric_of(s, y)
    return length(metric) if metric.ndim == 1 else jax.vmap(length)(metric)


class Loaded(eqx.Module):
    """A load step solved: the state, the tension, and how far the solvers came. `xi` is the unknown of the
    friction law by slip (`slip.py`), None for one tendon.
    """

    state: State
    tension: Float[Array, "*tendons N"]
    wrap: Float[Array, "*tendons N"]
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]
    xi: Float[Array, "*tendons N"] | None = None

    @property
    def mobilisation(self) -> Float[Array, "*tendons N"] | None:
        """Mobilisation of friction, (*tendons, N); None for one tendon."""
        return None if self.xi is None else slip.mobilisation(self.xi)

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether everything met its tolerance."""
        return self.result == optx.RESULTS.successful


def load_step(
    robot: Robot,
    s: Sections,
    T_base: Float[Array, "*tendons"],
    kept: slip.Kept,
    start: State,
    solver: optx.AbstractRootFinder,
    xi: Float[Array, "*tendons N"] | None = None,
) -> Loaded:
    """Solve one load step: by tension against the base for one tendon, by slip for several.

    Args:
        robot, s: the robot, and it at its nodes.
        T_base: base tension [N], (*tendons,).
        kept: what the tendons remember of the step before.
        start: state to start from.
        solver: see `equilibrium`.
        xi: for several tendons, unknown of the friction law to start from; zero if None.
    """
    if not robot.tendon_names:
        p = problem_of(robot, s, T_base, kept.tension)
        sol = solve_problem(p, start, solver)
        norm, count = sol.stats["residual_norm"], sol.stats["num_steps"]
        return Loaded(sol.value, tension_of(sol.value, p), sol.value.wrap, sol.result, norm, count)
    p = problem_of(robot, s, T_base, None)
    first = jnp.zeros_like(kept.tension) if xi is None else xi
    grip = slip.hold(p, kept, start, first, solver, MAX_STEPS)
    p = dataclasses.replace(p, mobilisation=slip.mobilisation(grip.xi))
    sol = solve_problem(p, start, solver)
    held = optx.RESULTS.where(grip.converged, sol.result, optx.RESULTS.nonlinear_max_steps_reached)
    norm = jnp.maximum(sol.stats["residual_norm"], grip.error)
    wrap = jnp.cumsum(slip.turning(sol.value, p), axis=-1)
    return Loaded(sol.value, tension_of(sol.value, p), wrap, held, norm, grip.steps, grip.xi)


def at_preload(robot: Robot, s: Sections, solver: optx.AbstractRootFinder) -> tuple[State, slip.Kept]:
    """The robot before its first load: settled with its tendons slack, then strung to their preloads without
    friction.
    """
    slack = jnp.zeros_like(preload_of(robot, s))
    p = problem_of(robot, s, slack[..., 0], slack)
    settled = solve_problem(p, rest_state(s), solver).value
    if not robot.tendon_names:
        return settled, slip.Kept(preload_of(robot, s), metric_of(s, settled), None)
    p = problem_of(robot, s, preload_of(robot, s)[..., 0], None, slack)
    strung = solve_problem(p, settled, solver).value
    return settled, slip.Kept(preload_of(robot, s), metric_of(s, strung), slack)


def describe(s: Sections, loaded: Loaded) -> Equilibrium:
    """Everything an equilibrium offers, from the solved state."""
    y = loaded.state
    return Equilibrium(
        s=s.mesh.s,
        curvature=y.kappa,
        angle=y.phi,
        tension=loaded.tension,
        external_moment=y.moment,
        x=cumulative(s.mesh.weights, jnp.cos(y.phi)),
        y=cumulative(s.mesh.weights, jnp.sin(y.phi)),
        wrap=loaded.wrap,
        tendon_angle=at_tendons(y.phi, s.R) + channel.tangent_lead(at_tendons(y.kappa, s.R), s.R),
        metric=metric_of(s, y),
        R=s.R.value,
        tendon_length=tendon_length(s, y),
        mobilisation=loaded.mobilisation,
        result=loaded.result,
        residual_norm=loaded.residual_norm,
        iterations=loaded.iterations,
    )


def problem_of(
    robot: Robot,
    s: Sections,
    T_base: Float[Array, "*tendons"],
    memory: Float[Array, "*tendons N"] | None,
    mobilisation: Float[Array, "*tendons N"] | None = None,
) -> Problem:
    """One load step of the robot as a problem; a base tension below zero counts as slack."""
    return Problem(
        sections=s,
        mu=robot.per_tendon(lambda tendon: tendon.friction_coefficient),
        T_base=jnp.where(T_base < 0.0, 0.0, T_base),  # not maximum: its derivative at 0 is one half
        memory=memory,
        mobilisation=mobilisation,
        tip_moment=robot.loads.tip_moment,
        loaded=robot.loaded,
    )


def preload_of(robot: Robot, s: Sections) -> Float[Array, "*tendons N"]:
    """Tension along the tendons before the first load [N], (*tendons, N)."""
    return jnp.broadcast_to(robot.per_tendon(lambda tendon: tendon.preload)[..., None], s.R.value.shape)


@eqx.filter_jit
def _solve(
    robot: Robot,
    T_base: Float[Array, "*tendons"],
    kept: slip.Kept | None,
    solver: optx.AbstractRootFinder,
) -> Equilibrium:
    s = sections(robot)
    if kept is None:
        kept = at_preload(robot, s, solver)[1]
    return describe(s, load_step(robot, s, T_base, kept, rest_state(s), solver))


def equilibrium(
    robot: Robot,
    T_base: ArrayLike | Sequence[float],
    *,
    memory: Equilibrium | Float[Array, " N"] | None = None,
    solver: optx.AbstractRootFinder = March(),  # noqa: B008
) -> Equilibrium:
    """Equilibrium of the robot under a base tension.

    Without `memory` the tendon is pulled once from its preload (slack unless the robot says otherwise);
    several tendons are pulled together, in one step.
    Differentiable in every number of the robot and in T_base, by the implicit function theorem; one-sided at
    stick fronts.

    Args:
        robot: from `load_robot`, or built in Python.
        T_base: tension at the base [N], scalar; with several tendons one each, (tendons,).
        memory: the equilibrium before this load; for one tendon its tension [N], (N,), will do.
        solver: any optimistix root finder that takes a `Problem`; tolerances live there.

    Returns:
        The solution. It never raises on non-convergence: look at `result`, `converged` and `residual_norm`.

    Raises:
        ValueError: T_base has another shape, or the memory of several tendons is no equilibrium.
    """
    load, names = jnp.asarray(T_base, dtype=float), robot.tendon_names
    if names and load.shape != (len(names),):
        raise ValueError(
            f"T_base: one base tension for each of the tendons {', '.join(names)}, not shape {load.shape}"
        )
    if not names and load.ndim != 0:
        raise ValueError(
            f"T_base: one base tension, not shape {load.shape}; jax.vmap over several, or simulate"
        )
    if memory is None:
        return _solve(robot, load, None, solver)
    if isinstance(memory, Equilibrium):
        return _solve(robot, load, slip.Kept(memory.tension, memory.metric, memory.mobilisation), solver)
    if names:
        raise ValueError(
            "memory: several tendons remember more than their tension; give the equilibrium before"
        )
    return _solve(robot, load, slip.Kept(memory, jnp.zeros_like(memory), None), solver)
