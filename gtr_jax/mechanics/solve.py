"""One load step solved, with its derivatives by the implicit function theorem.

optimistix's own `ImplicitAdjoint` solves through lineax, which reports failures by calling back into Python:
such programs cannot be kept in JAX's compilation cache, and pay for the call. Here the Jacobian with respect
to the unknowns at the base is small, and the march does the rest.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Float, Int

from .bodies import chords_of, metric_of
from .case import Case, Load, Memory
from .grip import left_of, march_gripped, solved_linear
from .march import Passed, described
from .mesh import increments
from .node import drawn_before, grip_of, total
from .program_spec import SolverOptions
from .search import Found, scales, search, with_grip, with_sliding, with_slopes
from .sections import State, node_first
from .small_matrices import inverse as inverse_of
from .small_matrices import times
from .tangents import split_tangents


class Solved(NamedTuple):
    """A load step solved.

    Attributes:
        memory: what the next step remembers of it.
        state: nodes along the first axis; its wrap is the turning since the preceding node.
        error: largest residual, dimensionless: slip over length; all others as curvature times length.
        marches: number of marches taken.
    """

    memory: Memory
    state: State
    error: Float[Array, ""]
    marches: Int[Array, ""]


def _left(case: Case, marched: Passed, unknowns: Float[Array, " n"]) -> tuple[Memory, State]:
    """Memory and state after a march."""
    nodes, what = marched.nodes, case.structure
    slip, middle, speed = nodes.slip, nodes.middle, nodes.speed
    if what.follows_slip and not (what.seeks_slip or what.shares_slip):
        # No law depends on the slip of this step, so the march counted it from the base; count it from the
        # anchor.
        away = marched.slip - total(case, "anchor", marched.T_tip) + total(case, "anchor", case.preload)
        slip, middle = slip - away[None], middle - away[None]
        speed = (middle - case.memory.middle) / case.load.dt
    if what.shares_slip or (what.terms and not what.follows_slip):
        slip = slip_of(case, nodes.state.kappa, nodes.tension, marched.T_tip)
    if what.carries:
        unknowns = jnp.concatenate([unknowns[:-1], jnp.zeros(1)])
    memory = Memory(
        tension=nodes.tension,
        kappa=nodes.state.kappa,
        slip=slip,
        drawn_earlier=drawn_before(case) if what.reads_drawn else None,
        middle=middle,
        speed=speed,
        mobilised=nodes.mobilised,
        stencil=nodes.stencil,
        elements=nodes.elements,
        bent=nodes.bent,
        entry=marched.entry,
        T_tip=marched.T_tip,
        T_base=case.load.T_base,
        carried=jnp.ones(()),
        unknowns=jax.lax.stop_gradient(unknowns) if what.unknowns else None,
        xi=None if case.grip is None else jax.lax.stop_gradient(case.grip.xi),
    )
    return memory, nodes.state


def _in_one_batch(tree, marches: Int[Array, ""]):
    """The tree itself; under `vmap`, with the batch in the first axis of every array.

    JAX 0.10 confuses the axes of values and tangents when a function with a custom derivative is compiled
    inside a differentiated batch and its arrays have the batch in different axes or not at all. Adding a zero
    that has the batch, and a reshape, give all arrays the same batch axis.
    """
    zero = jnp.where(marches >= 0, 0.0, 1.0)

    def first(a):
        a = a + zero
        return jax.lax.squeeze(jax.lax.reshape(a, (1, *a.shape)), (0,)) if a.ndim else a

    return jtu.tree_map(first, tree)


def slip_of(
    case: Case,
    kappa: Float[Array, "N *strain"],
    tension: Float[Array, "N *tendons"],
    T_tip: Float[Array, "*tendons"],
) -> Float[Array, "N *tendons"]:
    """Slip of the tendons towards the base since the robot settled [m], (N, *tendons), from the shape: loss
    of length of the channel beyond the node, plus gain of the tendon there by strain, plus displacement of
    the anchor.

    Args:
        case: the robot, whose metric is that of the settled robot.
        kappa: curvature, in space strain [1/m], (N, *strain).
        tension, T_tip: along the tendons and at the anchor [N].
    """
    s = case.sections
    assert case.metric is not None
    gone = case.metric - node_first(metric_of(s, kappa))
    away = jnp.zeros_like(T_tip)
    if case.structure.has("strain"):
        strung = total(case, "strain", case.preload)[None]
        gone = gone + (total(case, "strain", tension) - strung) * case.metric
    if case.structure.has("anchor"):
        away = total(case, "anchor", T_tip) - total(case, "anchor", case.preload)
    along = jnp.moveaxis(gone, 0, -1)
    step = increments if along.ndim == 1 else jax.vmap(increments, in_axes=(None, 0))
    drawn = jnp.moveaxis(jnp.cumsum(step(s.mesh.weights, along), axis=-1), -1, 0)
    return drawn[-1:] - drawn + away[None]


@eqx.filter_custom_jvp
def _solve(inputs) -> Solved:
    case, how = inputs
    found = search(case, how)
    case = with_grip(with_sliding(case, found.told), found.grip)
    memory, state = _in_one_batch(_left(case, found.passed, found.unknowns), found.marches)
    return Solved(memory, state, found.error, found.marches)


@_solve.def_jvp
def _solve_jvp(primals, tangents):
    """Derivative of the march; that of the unknowns at the base follows from the conditions at the tip by the
    implicit function theorem.
    """
    case, how = primals[0]
    case_dot = tangents[0][0]
    found = search(case, how)
    if found.grip is not None:
        return _gripped_jvp(case, case_dot, found)
    case = with_sliding(case, found.told)
    moving, fixed = split_tangents(case, case_dot)

    slopes = found.slopes

    def at(moving, unknowns):
        now, flat = eqx.combine(moving, fixed), unknowns[: found.unknowns.shape[0]]
        if slopes is not None:
            tried = unknowns[flat.shape[0] :].reshape(slopes.shape)
            now = with_slopes(now, tried)
        marched = described(now, flat, found.kappa)
        left = marched.left
        if slopes is not None:
            own = chords_of(now.sections, marched.nodes.state.kappa).slopes
            left = jnp.concatenate([left, (own - tried).ravel()])
        return left, _left(now, marched, flat)

    unknowns = found.unknowns
    if slopes is not None:
        unknowns = jnp.concatenate([unknowns, slopes.ravel()])
    if unknowns.shape[0]:
        # One linearisation for all directions: where nothing slips the laws have a kink, and two
        # linearisations might be on different sides of it.
        (_, out), linear = jax.linearize(at, moving, unknowns)
        zero, still = jnp.zeros_like(unknowns), jtu.tree_map(jnp.zeros_like, moving)
        left_dot, out_dot = linear(case_dot, zero)
        by_unknowns, out_by = jax.vmap(lambda d: linear(still, d), out_axes=-1)(jnp.eye(zero.shape[0]))
        sizes, lefts = (jnp.pad(v, (0, zero.size - v.size), constant_values=1.0) for v in scales(case))
        scaled = by_unknowns / lefts[:, None] * sizes[None, :]
        flat_dot = -times(inverse_of(scaled), left_dot / lefts) * sizes
        out_dot = jtu.tree_map(lambda d, by: d + by @ flat_dot, out_dot, out_by)
    else:
        out, out_dot = jax.jvp(lambda moving: at(moving, unknowns)[1], (moving,), (case_dot,))
    return _with_tangents(found, out, out_dot)


def _gripped_jvp(case: Case, case_dot: Case, found: Found):
    """As `_solve_jvp`, of tendons that share their slip: xi of all intervals follows from what is left of the
    friction law there.
    """
    moving, fixed = split_tangents(case, case_dot)

    def at(moving, xi, unknowns):
        now = eqx.combine(moving, fixed)
        now = with_grip(now, grip_of(now, xi)[0])
        marched = described(now, unknowns, found.kappa)
        return (left_of(now, marched), marched.left), _left(now, marched, unknowns)

    assert found.grip is not None
    point = (found.grip.xi, found.unknowns)
    (_, out), linear = jax.linearize(at, moving, *point)
    still = jtu.tree_map(jnp.zeros_like, point)
    (left, at_tip), _ = linear(case_dot, *still)
    grip, by_xi = grip_of(case, found.grip.xi)
    march = march_gripped(with_grip(case, grip), by_xi, found.unknowns, found.kappa, True)
    m = jax.lax.stop_gradient(march)
    _, out_dot = linear(case_dot, *solved_linear(m.linear, left, at_tip))
    return _with_tangents(found, out, out_dot)


def _with_tangents(found: Found, out: tuple[Memory, State], out_dot: tuple[Memory, State]):
    """A solved load step and its derivative."""
    memory, state = _in_one_batch(out, found.marches)
    solved = Solved(memory, state, found.error, found.marches)
    zeros = jax.custom_derivatives.zero_from_primal(solved, symbolic_zeros=True)
    memory_dot, state_dot = _in_one_batch(out_dot, found.marches)
    return solved, zeros._replace(memory=memory_dot, state=state_dot)


def load_step(case: Case, load: Load, memory: Memory, how: SolverOptions) -> Solved:
    """Solve one load step; differentiable in everything, through any number of steps.

    Args:
        case: the robot; its load and memory are replaced.
        load: the load; a base tension below zero counts as slack.
        memory: of the previous step.
        how: when the search stops.
    """
    slack = jnp.where(load.T_base < 0.0, 0.0, load.T_base)  # not maximum: its derivative at 0 is one half
    load = dataclasses.replace(load, T_base=slack)
    return _solve((dataclasses.replace(case, load=load, memory=memory), how))
