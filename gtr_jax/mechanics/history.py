"""Load steps, one after another, from a robot that was never pulled."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float, Int

from ..terms import REGISTRY
from . import channel
from .case import Case, Load, Memory, untouched
from .mesh import cumulative
from .sections import Sections, State, at_tendons, node_first
from .solve import load_step
from .structure import March, Structure

FOREVER = 1e15  # s, in which everything that creeps has crept


class Robot(NamedTuple):
    """What the mechanics needs to know of a robot.

    Attributes:
        sections: the robot at the nodes.
        mu: friction coefficient [-], (*tendons,).
        preload: tension before the first load [N], (*tendons,).
        tip_moment: external moment at the tip [N m].
        terms: numbers of the physics terms, by term and name.
    """

    sections: Sections
    mu: Float[Array, "*tendons"]
    preload: Float[Array, "*tendons"]
    tip_moment: Float[Array, ""]
    terms: dict[str, dict[str, Float[Array, ""]]]


class Step(eqx.Module):
    """One load step solved, the nodes first.

    Attributes:
        state: at the nodes; its wrap is the turning since the node before.
        tension, slip, mobilised: along the tendons, (N, *tendons); the last two None in the base model.
        before: tension and slip that were remembered.
        T_tip: tension at the anchor [N], (*tendons,).
        met: whether it met its tolerance.
        error: largest residual, see `Solved`.
        marches: taken.
    """

    state: State
    tension: Float[Array, "N *tendons"]
    slip: Float[Array, "N *tendons"] | None
    mobilised: Float[Array, "N *tendons"] | None
    before: tuple[Float[Array, "N *tendons"], Float[Array, "N *tendons"] | None]
    T_tip: Float[Array, "*tendons"]
    met: Bool[Array, ""]
    error: Float[Array, ""]
    marches: Int[Array, ""]


class Settled(eqx.Module):
    """The robot before its first load.

    Attributes:
        memory: what is remembered.
        metric: nu of the channels with slack tendons, (N, *tendons).
        preload: tension at which the tendons' strain counts as none [N], (*tendons,).
        kappa: curvature with slack tendons [1/m], (N,).
    """

    memory: Memory
    metric: Float[Array, "N *tendons"]
    preload: Float[Array, "*tendons"]
    kappa: Float[Array, " N"]


def rest_state(s: Sections) -> State:
    """The stress-free shape, with the moment the external load would have on a straight arm."""
    phi = cumulative(s.mesh.weights, s.rest)
    lever = jnp.sum(s.mesh.interval.length * (s.force_y * jnp.cos(phi) - s.force_x * jnp.sin(phi)))
    moment = jnp.where(jnp.any(s.compliance > 0), lever, 0.0)
    return State(s.rest, phi, jnp.zeros_like(s.R.value), jnp.broadcast_to(moment, s.rest.shape))


def metric_of(s: Sections, kappa: Float[Array, " N"]) -> Float[Array, "N *tendons"]:
    """nu = ds_c/ds of the channels, the nodes first."""
    return node_first(channel.metric_factor(at_tendons(kappa, s.R), s.R))


def _case(robot: Robot, structure: Structure, memory: Memory) -> Case:
    one, slack = jnp.ones_like(robot.tip_moment), jnp.zeros_like(robot.preload)
    return Case(
        sections=robot.sections,
        mu=robot.mu,
        preload=slack,
        tip_moment=robot.tip_moment,
        terms=robot.terms,
        metric=jnp.ones_like(memory.tension) if structure.terms else None,
        load=Load(slack, FOREVER * one, 0 * one, 0 * one),
        memory=memory,
        against=one,
        structure=structure,
    )


def _without_friction(robot: Robot) -> dict[str, dict[str, Array]]:
    """The numbers of the terms, those that are friction at null."""
    hooks = ("drag", "base_grip", "tip_grip", "by_speed")

    def values(term):
        if all(getattr(term, hook) is None for hook in hooks):
            return robot.terms[term.id]
        return {q.name: jnp.full_like(robot.terms[term.id][q.name], q.null) for q in term.quantities}

    return {term.id: values(term) for term in REGISTRY.values()}


def steps(
    robot: Robot,
    structure: Structure,
    loads: Load,
    how: March,
    before: Callable[[State, Memory], Memory] | None = None,
) -> tuple[Step, Memory, Settled]:
    """Solve load steps, one after another.

    The robot first settles with slack tendons, which are then strung to their preloads without friction:
    steps like any other, so that one program does all. Without external loads and without terms both are
    known and cost nothing.

    Args:
        robot: at its nodes.
        structure: which equations act.
        loads: K of them.
        how: far a search goes.
        before: what is remembered at the first load, from the settled state and what a robot remembers that
            was never pulled; that unless given.

    Returns:
        The steps, with a leading axis K; what is remembered after the last; the robot before the first. A
        step that does not converge leaves the memory as it was.
    """
    s, strung_to = robot.sections, robot.preload
    start = jax.lax.stop_gradient(rest_state(s))
    slack = jnp.zeros((s.rest.shape[0], *strung_to.shape))
    one, zero = jnp.ones_like(robot.tip_moment), jnp.zeros_like(robot.tip_moment)
    strung = jnp.broadcast_to(strung_to, slack.shape)
    prefix = 2 if structure.terms else 1 if structure.bends else 0
    # What bends the body has bent it from its natural shape; only the search starts from `start`.
    memory = dataclasses.replace(untouched(structure, start, slack, zero), kappa=s.rest)
    case = _case(robot, structure, memory)

    def settled_at(state: State, memory: Memory) -> Settled:
        return Settled(memory, metric_of(s, state.kappa), strung_to, state.kappa)

    if not prefix:
        kappa = s.rest + s.compliance * robot.tip_moment
        at_rest = dataclasses.replace(rest_state(s), kappa=kappa)
        memory = untouched(structure, at_rest, strung, one)
        memory = memory if before is None else before(at_rest, memory)
        settled = settled_at(at_rest, memory)
    else:
        settled = Settled(memory, jnp.ones_like(slack), case.preload, s.rest)

    def step(settled: Settled, at):
        load, settling, stringing = at
        now = case
        if structure.terms:
            now = dataclasses.replace(now, metric=settled.metric, preload=settled.preload)
        if prefix == 2:
            none = {kind: _without_friction(robot)[kind] for kind in structure.terms}
            own = {kind: robot.terms[kind] for kind in structure.terms}
            terms = robot.terms | jtu.tree_map(lambda a, b: jnp.where(stringing, a, b), none, own)
            now = dataclasses.replace(now, mu=jnp.where(stringing, 0.0, case.mu), terms=terms)
        done = load_step(now, load, settled.memory, how)
        met = (
            (done.error <= how.atol) & jnp.all(jnp.isfinite(load.T_base)) & jnp.isfinite(load.dt + load.time)
        )
        out = Step(
            state=done.state,
            tension=done.memory.tension,
            slip=done.memory.slip,
            mobilised=done.memory.mobilised,
            before=(settled.memory.tension, settled.memory.slip),
            T_tip=done.memory.T_tip,
            met=met,
            error=done.error,
            marches=done.marches,
        )
        after = _where(met, dataclasses.replace(settled, memory=done.memory), settled)
        if prefix:
            fresh = untouched(structure, done.state, slack if prefix == 2 else strung, one)
            found = done.memory.unknowns
            if structure.seeks_slip:
                found = found.at[: strung_to.size].set(0.0)
            fresh = dataclasses.replace(fresh, bent=done.memory.bent, unknowns=found)
            if prefix == 1 and before is not None:
                fresh = before(done.state, fresh)
            after = _where(settling, settled_at(done.state, fresh), after)
        if prefix == 2:
            # The tendons are strung, and nothing has slipped.
            names = [n for n in ("speed", "mobilised", "elements") if getattr(done.memory, n) is not None]
            memory = dataclasses.replace(done.memory, **{n: 0 * getattr(done.memory, n) for n in names})
            memory = memory if before is None else before(done.state, memory)
            after = _where(stringing, dataclasses.replace(settled, memory=memory), after)
        return after, out

    first = jtu.tree_map(lambda a: jnp.broadcast_to(a, (prefix, *a.shape)), case.load)
    if prefix == 2:
        first = dataclasses.replace(first, T_base=jnp.stack([case.load.T_base, strung_to]))
    loads = jtu.tree_map(lambda a, b: jnp.concatenate([a, b]), first, loads)
    at = jnp.arange(loads.time.shape[0])
    settling, stringing = at < min(prefix, 1), (at == 1) & (prefix == 2)
    last, out = jax.lax.scan(step, settled, (loads, settling, stringing))
    return jtu.tree_map(lambda a: a[prefix:], out), last.memory, last


def _where(holds: Bool[Array, ""], this, that):
    return jtu.tree_map(lambda a, b: jnp.where(holds, a, b), this, that)
