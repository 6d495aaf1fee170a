"""One equilibrium of rod and tendons."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .. import mechanics
from ..mechanics import Load, ProgramSpec, SolverOptions, untouched
from ..mechanics.sections import node_first
from ..robot.robot import Robot, sections
from ..robot.validity import is_robot
from .outcome import unless_outside
from .programs import at_nodes, structure_of
from .solution import Equilibrium, describe, loaded_of


@eqx.filter_jit
def solved(
    robot: Robot,
    T_base: Float[Array, "*tendons"],
    before: Equilibrium | Float[Array, " N"] | None,
    how: SolverOptions,
    structure: ProgramSpec,
    clock: Load | None = None,
) -> Equilibrium:
    """As `equilibrium`, with a structure that is decided; at a load step's time and pace, if given one."""
    s, valid = sections(robot), is_robot(robot)
    one = jnp.ones(())

    def remembered(settled, never_pulled):
        if isinstance(before, Equilibrium) and before.memory is not None:
            return mechanics.part_of(before.memory, structure)
        if before is None:
            return never_pulled
        tension = before.tension if isinstance(before, Equilibrium) else before
        kept = untouched(structure, settled, node_first(tension), one)
        same = ("slip", "middle", "bent", "unknowns")
        kept = dataclasses.replace(kept, **{name: getattr(never_pulled, name) for name in same})
        if not (isinstance(before, Equilibrium) and structure.shares_slip):
            return kept
        # A step of a history, whose memory is not kept: the slip from there decides.
        mobilised = node_first(before.mobilisation)
        return dataclasses.replace(
            kept, kappa=before.curvature, mobilised=mobilised, T_base=kept.entry, T_tip=before.T_tip
        )

    load = Load.without_clock(T_base) if clock is None else dataclasses.replace(clock, T_base=T_base)
    done, memory, settled = mechanics.one_step(at_nodes(robot, s), structure, load, how, remembered)
    step = loaded_of(s, structure, settled, done)
    whole = mechanics.complete(memory, structure, step.state, node_first(step.slip))
    found = describe(s, robot.base, step, whole)
    return dataclasses.replace(found, result=unless_outside(found.result, valid))


def equilibrium(
    robot: Robot,
    T_base: ArrayLike | Sequence[float],
    *,
    memory: Equilibrium | Float[Array, " N"] | None = None,
    with_terms: bool | Collection[str] | None = None,
    solver: SolverOptions = SolverOptions(),  # noqa: B008
) -> Equilibrium:
    """Equilibrium of the robot under a base tension.

    Physics terms act as at rest: nothing moves, and all creep has ended.

    Without `memory` the tendon is pulled once from its preload (slack unless the robot says otherwise);
    several tendons are pulled together, in one step.
    Differentiable in T_base and in every number of the robot but those of terms that the program does not
    hold (`with_terms` of `simulate`), by the implicit function theorem; one-sided at
    stick fronts.

    Args:
        robot: from `load_robot`, or built in Python.
        T_base: tension at the base [N], scalar; with several tendons one each, (tendons,).
        memory: the equilibrium before this load; for one tendon its tension [N], (N,), is enough.
        with_terms: as for `simulate`.
        solver: how far the search goes; its tolerance.

    Returns:
        The solution. It never raises on non-convergence: check `result`, `converged` and `residual_norm`.
        Where it is solved for the numbers of no robot (a negative modulus, a channel outside the body),
        `result` is `outside_physics`, under `jit` too.

    Raises:
        ValueError: T_base has another shape, or the memory of several tendons is not an equilibrium.
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
    if names and memory is not None and not isinstance(memory, Equilibrium):
        raise ValueError(
            "memory: several tendons remember more than their tension; give the equilibrium before"
        )
    return solved(robot.for_any_terms(), load, memory, solver, structure_of(robot, with_terms))
