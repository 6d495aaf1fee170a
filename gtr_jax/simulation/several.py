"""The base model of several tendons, whose friction follows the slip; see `mechanics.several`."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Float

from ..mechanics import metric_of, rest_state
from ..mechanics.coulomb import mobilisation
from ..mechanics.sections import Sections, State
from ..mechanics.several import slip
from ..mechanics.several.adjoint import CausalAdjoint
from ..mechanics.several.problem import Problem, residual, tension_of
from ..robot.robot import Robot
from .solution import Loaded, slip_without_stretch

MAX_STEPS = 256  # most marches of one equilibrium with known mobilisation


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


def load_step(
    robot: Robot,
    s: Sections,
    T_base: Float[Array, "*tendons"],
    kept: slip.Kept,
    start: State,
    settled: State,
    solver: optx.AbstractRootFinder,
    xi: Float[Array, "tendons N"],
) -> tuple[Loaded, Float[Array, "tendons N"]]:
    """Solve one load step.

    Args:
        robot, s: the robot, and its values at the nodes.
        T_base: base tension [N], (tendons,).
        kept: what the tendons remember of the previous step.
        start: state to start from.
        settled: state with slack tendons, from which slip is counted.
        solver: of the equilibrium with known mobilisation.
        xi: unknown of the friction law to start from.

    Returns:
        The step, and that unknown.
    """
    p = problem_of(robot, s, T_base, None)
    grip = slip.hold(p, kept, start, xi, solver, MAX_STEPS)
    p = dataclasses.replace(p, mobilisation=mobilisation(grip.xi))
    sol = solve_problem(p, start, solver)
    held = optx.RESULTS.where(grip.converged, sol.result, optx.RESULTS.nonlinear_max_steps_reached)
    tension = tension_of(sol.value, p)
    done = Loaded(
        state=sol.value,
        tension=tension,
        T_tip=tension[..., -1],
        slip=slip_without_stretch(s, settled, sol.value),
        wrap=jnp.cumsum(slip.turning(sol.value, p), axis=-1),
        mobilisation=mobilisation(grip.xi),
        result=held,
        residual_norm=jnp.maximum(sol.stats["residual_norm"], grip.error),
        iterations=grip.steps,
    )
    return done, grip.xi


def at_preload(robot: Robot, s: Sections, solver: optx.AbstractRootFinder) -> tuple[State, slip.Kept]:
    """The robot before its first load: settled with its tendons slack, then strung to their preloads without
    friction.
    """
    slack = jnp.zeros(s.R.value.shape)
    p = problem_of(robot, s, slack[..., 0], slack)
    settled = solve_problem(p, rest_state(s), solver).value
    preload = jnp.broadcast_to(robot.per_tendon(lambda tendon: tendon.preload)[..., None], slack.shape)
    p = problem_of(robot, s, preload[..., 0], None, slack)
    strung = solve_problem(p, settled, solver).value
    return settled, slip.Kept(preload, metric_of(s, strung.kappa), slack)
