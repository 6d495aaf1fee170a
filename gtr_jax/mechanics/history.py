"""Load steps, one after another, from a robot that was never pulled."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..terms import Term
from .bodies import directions_of, geometry_of, metric_of
from .case import Case, Load, Memory, untouched
from .events import after_loosening, after_tug
from .loop_lanes import in_lanes_of
from .program_spec import ProgramSpec, SolverOptions
from .sections import Sections, State, either_of, node_first
from .sliding import predicted_slip
from .solve import load_step


class NodalRobot(NamedTuple):
    """What the mechanics needs to know of a robot.

    Attributes:
        sections: the robot at the nodes.
        mu: friction coefficient [-], (*tendons,).
        preload: tension before the first load [N], (*tendons,).
        tip_moment: external moment at the tip [N m], (); in space (3,).
        terms: numbers of the physics terms, by term and name.
    """

    sections: Sections
    mu: Float[Array, "*tendons"]
    preload: Float[Array, "*tendons"]
    tip_moment: Float[Array, "*moment"]
    terms: dict[str, dict[str, Float[Array, "*each"]]]


class Step(eqx.Module):
    """A solved load step, nodes along the first axis.

    Attributes:
        state: at the nodes; its wrap is the turning since the preceding node.
        tension, slip, mobilised: along the tendons, (N, *tendons); the last two None where no slip is
            counted.
        xi: how friction grips tendons that share their slip, (N, *tendons); None of others.
        before: tension and slip after the previous step.
        T_tip: tension at the anchor [N], (*tendons,).
        moved: how far the tendon's end at the tip was moved towards the base from outside [m]; None where no
            term moves it.
        met: whether it met its tolerance.
        error: largest residual, see `Solved`.
        marches: number of marches taken.
    """

    state: State
    tension: Float[Array, "N *tendons"]
    slip: Float[Array, "N *tendons"] | None
    mobilised: Float[Array, "N *tendons"] | None
    xi: Float[Array, "N *tendons"] | None
    before: tuple[Float[Array, "N *tendons"], Float[Array, "N *tendons"] | None]
    T_tip: Float[Array, "*tendons"]
    moved: Float[Array, ""] | None
    met: Bool[Array, ""]
    error: Float[Array, ""]
    marches: Int[Array, ""]


class Unloaded(eqx.Module):
    """The robot before its first load.

    Attributes:
        memory: what is remembered.
        metric: nu of the channels with slack tendons, (N, *tendons).
        preload: tension at which the tendons' strain counts as zero [N], (*tendons,).
        kappa: curvature, in space strain, with slack tendons [1/m], (N, *strain).
    """

    memory: Memory
    metric: Float[Array, "N *tendons"]
    preload: Float[Array, "*tendons"]
    kappa: Float[Array, "N *strain"]


def rest_state(s: Sections) -> State:
    """The stress-free shape, with the moment the external load would have on a straight arm."""
    phi = directions_of(s, s.rest)
    lever = geometry_of(s).lever(phi, s.force, s.mesh.interval.length)
    moment = jnp.where(jnp.any(s.compliance > 0), lever, 0.0)
    along = jnp.broadcast_to(moment, (*s.mesh.s.shape, *moment.shape))
    return State(s.rest, phi, jnp.zeros_like(metric_of(s, s.rest)), along)


def _case(robot: NodalRobot, structure: ProgramSpec, memory: Memory) -> Case:
    one, slack = jnp.ones(()), jnp.zeros_like(robot.preload)
    return Case(
        sections=robot.sections,
        mu=robot.mu,
        preload=slack,
        tip_moment=robot.tip_moment,
        terms=robot.terms,
        metric=jnp.ones_like(memory.tension) if structure.counts_slip else None,
        load=Load.without_clock(slack),
        memory=memory,
        sliding=None,
        grip=None,
        against=one,
        structure=structure,
    )


def _without_friction(robot: NodalRobot, catalogue: Mapping[str, Term]) -> dict[str, dict[str, Array]]:
    """The numbers of the terms, with those terms that are friction set to null."""
    hooks = ("drag", "base_grip", "tip_grip", "by_speed")

    def values(term):
        if all(getattr(term, hook) is None for hook in hooks):
            return robot.terms[term.id]
        return {q.name: jnp.full_like(robot.terms[term.id][q.name], q.null) for q in term.quantities}

    # Programs leave out the numbers of terms of users that they do not have.
    return {kind: values(catalogue[kind]) for kind in robot.terms}


Before = Callable[[State, Memory], Memory]


def steps_before(structure: ProgramSpec) -> int:
    """Number of load steps before the first load: the robot settles with slack tendons under its external
    loads, then the tendons are strung. Where no slip is counted, stringing takes no step, because tendons
    remember their tension only; without external loads settling takes none either, because the settled shape
    is known.
    """
    return 2 if structure.counts_slip else int(structure.bends)


def loads_before(structure: ProgramSpec, preload: Any) -> list[tuple[Any, bool, bool]]:
    """Base tension of each step of `steps_before`, whether the robot settles in it, and whether the tendons
    are strung.
    """
    return [(0.0 * preload, True, False), (preload, False, True)][: steps_before(structure)]


def begin(robot: NodalRobot, structure: ProgramSpec, before: Before | None = None) -> Unloaded:
    """The robot before the steps of `steps_before`.

    Args:
        robot: at its nodes.
        structure: which equations act.
        before: as for `steps`.
    """
    s, strung_to = robot.sections, robot.preload
    one, zero = jnp.ones(()), jnp.zeros(())
    slack = jnp.zeros((s.rest.shape[0], *strung_to.shape))
    at_rest = rest_state(s)
    if not steps_before(structure):
        moment = robot.tip_moment
        if moment.ndim:  # a moment does not stretch the axis
            moment = jnp.pad(moment, (0, s.rest.shape[-1] - moment.shape[0]))
        moment = jnp.broadcast_to(moment, s.rest.shape)
        kappa = s.rest + s.compliance * moment
        kappa = kappa if s.closing is None else s.closing.settled(kappa)
        at_rest = dataclasses.replace(at_rest, kappa=kappa)
        memory = untouched(structure, at_rest, jnp.broadcast_to(strung_to, slack.shape), one)
        memory = memory if before is None else before(at_rest, memory)
        return Unloaded(memory, node_first(metric_of(s, at_rest.kappa)), strung_to, at_rest.kappa)
    # Bending laws start from the natural shape; the moment of `at_rest` is a starting point of the search
    # only.
    memory = untouched(structure, jax.lax.stop_gradient(at_rest), slack, zero)
    memory = dataclasses.replace(memory, kappa=s.rest)
    straight = node_first(s.ended(jnp.moveaxis(jnp.ones_like(slack), 0, -1)))
    return Unloaded(memory, straight, jnp.zeros_like(strung_to), s.rest)


def advance(
    robot: NodalRobot,
    structure: ProgramSpec,
    how: SolverOptions,
    settled: Unloaded,
    load: Load,
    at: tuple[Bool[Array, ""], Bool[Array, ""]],
    before: Before | None = None,
) -> tuple[Unloaded, Step]:
    """One load step.

    Args:
        robot, structure, how, before: as for `steps`.
        settled: what is remembered, and the robot as it settled.
        load: the load.
        at: whether the robot settles in this step, and whether its tendons are strung.
    """
    settling, stringing = at
    s, strung_to, prefix = robot.sections, robot.preload, steps_before(structure)
    one = jnp.ones(())
    now = _case(robot, structure, settled.memory)
    if structure.counts_slip:
        now = dataclasses.replace(now, metric=settled.metric, preload=settled.preload)
    if prefix == 2:
        still = _without_friction(robot, structure.catalogue)
        none = {kind: still[kind] for kind in structure.terms}
        own = {kind: robot.terms[kind] for kind in structure.terms}
        terms = robot.terms | jtu.tree_map(lambda a, b: jnp.where(stringing, a, b), none, own)
        now = dataclasses.replace(now, mu=jnp.where(stringing, 0.0, robot.mu), terms=terms)
    begun = settled.memory
    if structure.loosens:
        begun = after_loosening(now, load, begun)
    moved = None
    if structure.tugged:
        begun, moved = after_tug(now, load, begun)
    if structure.slides:
        now = dataclasses.replace(now, sliding=predicted_slip(now, load, begun))
    done = load_step(now, load, begun, how)
    met = (done.error <= how.atol) & jnp.all(jnp.isfinite(load.T_base)) & jnp.isfinite(load.dt + load.time)
    out = Step(
        state=done.state,
        tension=done.memory.tension,
        slip=done.memory.slip,
        mobilised=done.memory.mobilised,
        xi=done.memory.xi,
        before=(settled.memory.tension, settled.memory.slip),
        T_tip=done.memory.T_tip,
        moved=moved,
        met=met,
        error=done.error,
        marches=done.marches,
    )
    after = either_of(met, dataclasses.replace(settled, memory=done.memory), settled)
    if prefix:
        slack = jnp.zeros_like(settled.metric)
        tension = slack if prefix == 2 else jnp.broadcast_to(strung_to, slack.shape)
        found = done.memory.unknowns
        if structure.seeks_slip:
            assert found is not None
            found = jnp.concatenate([jnp.zeros(strung_to.size), found[strung_to.size :]])
        fresh = untouched(structure, done.state, tension, one)
        fresh = dataclasses.replace(fresh, bent=done.memory.bent, unknowns=found)
        if prefix == 1 and before is not None:
            fresh = before(done.state, fresh)
        fresh = Unloaded(fresh, node_first(metric_of(s, done.state.kappa)), strung_to, done.state.kappa)
        after = either_of(settling, fresh, after)
    if prefix == 2:
        # The tendons are strung, and nothing has slipped.
        names = [n for n in ("speed", "mobilised", "elements", "xi") if getattr(done.memory, n) is not None]
        memory = dataclasses.replace(done.memory, **{n: 0 * getattr(done.memory, n) for n in names})
        memory = memory if before is None else before(done.state, memory)
        after = either_of(stringing, dataclasses.replace(settled, memory=memory), after)
    return after, out


def with_steps_before(robot: NodalRobot, structure: ProgramSpec, loads: Load):
    """Loads with those of `steps_before` ahead, and the two flags `at` of `advance` for each, (K,) bool."""
    first = loads_before(structure, robot.preload)
    if first:
        each = [Load.without_clock(T_base) for T_base, _, _ in first]
        ahead = jtu.tree_map(lambda *a: jnp.stack(a), *each)
        loads = jtu.tree_map(lambda a, b: jnp.concatenate([a, b]), ahead, loads)
    flags = np.zeros((2, loads.time.shape[0]), bool)
    flags[:, : len(first)] = [[settling for _, settling, _ in first], [strung for _, _, strung in first]]
    return loads, (jnp.asarray(flags[0]), jnp.asarray(flags[1]))


def steps(
    robot: NodalRobot, structure: ProgramSpec, loads: Load, how: SolverOptions, before: Before | None = None
) -> tuple[Step, Memory, Unloaded]:
    """Solve load steps, one after another.

    The robot first settles with slack tendons, which are then strung to their preloads without friction. Both
    are load steps like any other, so that one program does everything.

    Args:
        robot: at its nodes.
        structure: which equations act.
        loads: K of them.
        how: when a search stops.
        before: gives the memory at the first load from the settled state and the memory of a robot that was
            never pulled; the latter unless given.

    Returns:
        The steps, with a leading axis K; what is remembered after the last; the robot before the first. A
        step that does not converge leaves the memory as it was.
    """
    loads, flags = with_steps_before(robot, structure, loads)

    def step(settled: Unloaded, x):
        load, at = x
        return advance(robot, structure, how, settled, load, at, before)

    s = robot.sections
    given = (robot.mu, s.compliance, s.R.value, loads.T_base)
    start = in_lanes_of(given, begin(robot, structure, before))
    last, out = jax.lax.scan(step, start, (loads, flags))
    return jtu.tree_map(lambda a: a[steps_before(structure) :], out), last.memory, last


def one_step(
    robot: NodalRobot, structure: ProgramSpec, load: Load, how: SolverOptions, before: Before | None = None
) -> tuple[Step, Memory, Unloaded]:
    """As `steps`, for one load step and without the axis K."""
    loads, flags = with_steps_before(robot, structure, jtu.tree_map(lambda a: a[None], load))
    start = begin(robot, structure, before)

    def step(settled: Unloaded, load: Load, at):
        return advance(robot, structure, how, settled, load, at, before)

    if not steps_before(structure):
        last, out = step(start, load, (jnp.asarray(False), jnp.asarray(False)))
        return out, last.memory, last
    # The last step is carried on, not stacked: indexing a stack whose tangents are constant fails in a batch.
    shape = jax.eval_shape(step, start, load, (jnp.asarray(False), jnp.asarray(False)))[1]
    nothing = jtu.tree_map(lambda a: jnp.zeros(a.shape, a.dtype), shape)
    (last, out), _ = jax.lax.scan(
        lambda carry, x: (step(carry[0], *x), None), (start, nothing), (loads, flags)
    )
    return out, last.memory, last
