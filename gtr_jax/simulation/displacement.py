"""Tendons driven by displacement: the base tensions that draw them out as far as they are.

Each load step has one more unknown for each such tendon, its base tension, and one more equation: what the
body and friction take up of the tendon, and its own stretch, is what is drawn out at the base. A tendon that
would have to push is slack.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..mechanics import Load, ProgramSpec, SolverOptions
from ..mechanics.small_matrices import inverse, times
from ..robot.parts import Tendon
from ..robot.robot import Robot, sections
from ..terms import REGISTRY, known_on
from ..terms.term import UNMOVED
from .equilibrium import solved
from .programs import structure_of
from .solution import Equilibrium, drawn_out, stretch_of

LEAST_GIVE = 1e-9  # m/N, of a tendon in a rigid sheath that does not stretch
MOST_TRIALS = 60  # of a load step
TOLERANCE = 1e-12  # of the length, by which a displacement may be missed
FIRST, LEAST, MOST = 1e-2, 1e-12, 1e12  # damping of a trial, relative to the tendon's compliance
EASIER, HARDER = 0.1, 10.0  # change of the damping after a trial that came nearer, or did not
# Of one tendon: how far the first trials reach, of what its compliance would need, by how much farther each
# next one may, and what of a miss a trial may leave before the next one halves what encloses the answer.
REACH, FARTHER, SLOW = 10.0, 4.0, 0.5


class Driven(NamedTuple):
    """What drives the tendons along a history.

    Attributes:
        T_base: base tension [N], (K, *tendons).
        met: whether every displacement is met, (K,).
        trials: taken, (K,).
    """

    T_base: Float[Array, "K *tendons"]
    met: Bool[Array, " K"]
    trials: Int[Array, " K"]


class TensionSearch(NamedTuple):
    """A search for base tensions: the next trial, the best one, its miss and derivative, the damping, and how
    many were taken.
    """

    trial: Float[Array, " tendons"]
    x: Float[Array, " tendons"]
    miss: Float[Array, " tendons"]
    slope: Float[Array, "tendons tendons"]
    damping: Float[Array, ""]
    trials: Int[Array, ""]


def by_tension(robot: Robot) -> Robot:
    """The same robot with all its tendons driven by tension."""
    tendons = tuple(dataclasses.replace(tendon, drive="tension") for tendon in robot.tendons)
    return dataclasses.replace(robot, tendons=tendons)


def displacement_drives(robot: Robot, T_base: Array, displacement: ArrayLike | None) -> bool:
    """Whether displacement drives any tendon of a robot.

    Args:
        robot: to be simulated.
        T_base: its history of base tensions, (K, *tendons).
        displacement: that of displacements, if there is one.

    Raises:
        ValueError: it does, and there is none, or a term moves a tendon's end; or there is one without a
            tendon that it drives.
    """
    drawn = [tendon.name for tendon in robot.tendons if tendon.drive == "displacement"]
    if displacement is None and drawn:
        raise ValueError(f"displacement: drives the tendon {drawn[0]}".rstrip() + "; give its history")
    if displacement is not None and not drawn:
        raise ValueError('displacement: drives no tendon; set drive = "displacement", or leave it out')
    if displacement is not None and jnp.shape(displacement) != T_base.shape:
        raise ValueError(
            f"displacement: of the shape of T_base, {T_base.shape}, not {jnp.shape(displacement)}"
        )
    for term in REGISTRY.values() if drawn else ():
        if term.tugged and known_on(term, robot.terms[term.id]):
            raise ValueError(f"{term.id}: {UNMOVED}")
    return bool(drawn)


@eqx.filter_jit
def driven(
    robot: Robot,
    loads: Load,
    displacement: Float[Array, "K *tendons"],
    how: SolverOptions,
    structure: ProgramSpec,
) -> Driven:
    """Base tensions along a history; differentiable in every number of the robot and in the history.

    Args:
        robot: its tendons' drives count.
        loads: K of them; the base tensions of those tendons that displacement drives are ignored.
        displacement: drawn out at the base since the tendons were strung [m], of the tendons that
            displacement drives; ignored of the others.
        how, structure: as for an equilibrium.
    """
    shape = loads.T_base.shape
    T_base, displacement = (given.reshape(shape[0], -1) for given in (loads.T_base, displacement))
    preload = jnp.atleast_1d(robot.per_tendon(lambda tendon: tendon.preload))
    give = compliance(robot)

    def step(carry, given):
        before, x = carry
        load, tension, wanted = given
        x, close, trials = _met(robot, Trying(before, load, how, structure, give), x, tension, wanted)
        _, eq = _out(robot, Trying(before, load, how, structure, give), x)
        return (eq, x), (jnp.where(x > 0, x, 0.0), close, trials)

    _, strung = _out(robot, Trying(None, None, how, structure, give), preload)
    tension, met, trials = jax.lax.scan(step, (strung, preload), (loads, T_base, displacement))[1]
    return Driven(tension.reshape(shape), met, trials)


def drawn_at_once(
    robot: Robot,
    T_base: Float[Array, "*tendons"],
    displacement: Float[Array, "*tendons"],
    how: SolverOptions,
    *,
    sloped: bool = True,
) -> tuple[Float[Array, "*tendons"], Bool[Array, ""]]:
    """Base tensions [N] of one load step from the preloads that comes to rest, as of `equilibrium`, and
    whether every displacement is met; arguments as of `driven`, without the steps.

    Args:
        sloped: whether it will be differentiated, which takes one more equilibrium.
    """
    preload = jnp.atleast_1d(robot.per_tendon(lambda tendon: tendon.preload))
    tension, wanted = (jnp.atleast_1d(given) for given in (T_base, displacement))
    at = Trying(None, None, how, structure_of(robot, None), compliance(robot))
    x, close, _ = _met(robot.for_any_terms(), at, preload, tension, wanted, sloped=sloped)
    return jnp.where(x > 0, x, 0.0).reshape(T_base.shape), close


class Trying(NamedTuple):
    """From where and how base tensions are tried: the state before, the load step, how far the search for an
    equilibrium goes, its equations, and the tendons' typical compliance [m/N], (tendons,).
    """

    before: Equilibrium | None
    load: Load | None
    how: SolverOptions
    structure: ProgramSpec
    give: Float[Array, " tendons"]


def _out(robot: Robot, at: Trying, x: Float[Array, " tendons"]) -> tuple[Array, Equilibrium]:
    """How far the tendons are drawn out at base tensions x [m], (tendons,); below zero, where they would have
    to push, as if they were as soft as they typically are. And the equilibrium.
    """
    tension = jnp.where(x > 0, x, 0.0)
    one = tension if robot.tendon_names else tension[0]
    eq = solved(robot, one, at.before, at.how, at.structure, at.load)
    strung = robot.per_tendon(lambda tendon: tendon.preload)
    out = drawn_out(robot.terms, eq.slip[..., 0], one, strung)
    out = jnp.atleast_1d(out + stretch_of(robot.tendons, eq.s, eq.tension, eq.metric))
    return out + at.give * jnp.where(x > 0, 0.0, x), eq


def _met(
    robot: Robot,
    at: Trying,
    x: Float[Array, " tendons"],
    tension: Float[Array, " tendons"],
    wanted: Float[Array, " tendons"],
    *,
    sloped: bool = True,
) -> tuple[Float[Array, " tendons"], Bool[Array, ""], Int[Array, ""]]:
    """Base tensions at which the tendons are drawn out as far as is wanted, whether they are, and the trials
    taken.

    Args:
        robot: its tendons' drives count.
        at: from where and how.
        x: where to start [N]; negative where a tendon would have to push.
        tension: base tensions of the tendons that these drive [N]; of the others ignored.
        wanted: displacements of the others [m].
        sloped: whether the answer has its derivative.
    """
    drawn = jnp.array([tendon.drive == "displacement" for tendon in robot.tendons])
    tension, wanted = jnp.where(drawn, 0.0, tension), jnp.where(drawn, wanted, 0.0)
    still, wall, goal = jax.lax.stop_gradient(
        (robot, (at.before, at.load), jnp.where(drawn, wanted, tension))
    )
    held = at._replace(before=wall[0], load=wall[1])

    def miss(x):
        out, _ = _out(still, held, x)
        missed = jnp.where(drawn, out - goal, at.give * (x - goal))
        return missed, missed

    def tried(x):
        slope, value = jax.jacfwd(miss, has_aux=True)(x)
        return value, slope

    least = TOLERANCE * robot.backbone.length
    found = search(tried, jnp.where(drawn, jax.lax.stop_gradient(x), goal), at.give, least)
    close = jnp.max(jnp.abs(found.miss)) <= least
    if not sloped:
        return found.x, close, found.trials
    # One step of Newton's method, of no length, has the derivative of the solution.
    out, _ = _out(robot, at, found.x)
    left = jnp.where(drawn, out - wanted, at.give * (found.x - tension))
    # At the edge of a hold the slope may be none on the side that was tried: then the typical one.
    back = inverse(found.slope)
    back = jnp.where(jnp.all(jnp.isfinite(back)), back, jnp.diag(1.0 / at.give))
    moved = times(back, left)
    return found.x - jnp.where(close, moved, 0.0), close, found.trials


class Enclosed(NamedTuple):
    """A search for the base tension of one tendon, as `TensionSearch`, with tensions that draw it out too
    little and too far, how far the next trial may reach while there are not both, and what the last one
    missed.
    """

    trial: Float[Array, " 1"]
    x: Float[Array, " 1"]
    miss: Float[Array, " 1"]
    slope: Float[Array, "1 1"]
    low: Float[Array, " 1"]
    high: Float[Array, " 1"]
    reach: Float[Array, " 1"]
    last: Float[Array, " 1"]
    trials: Int[Array, ""]


def search(tried, x, give, least) -> TensionSearch | Enclosed:
    """Where displacements are met, or the nearest trial.

    Args:
        tried: how far displacements are missed [m] at unknown tensions, (tendons,), and its derivative.
        x: where to start.
        give: typical compliance of each tendon [m/N], (tendons,).
        least: when it is met [m].
    """
    return (_enclosed if x.size == 1 else _damped)(tried, x, give, least)


def _enclosed(tried, x, give, least) -> Enclosed:
    """Newton's method for one tendon, between tensions known to be too small and too large: where friction
    holds a tendon its displacement hardly answers to its tension, and friction that depends on the speed may
    let it fall a little while the tension rises.
    """

    def going(now: Enclosed):
        return (jnp.abs(now.miss) > least)[0] & (now.trials < MOST_TRIALS)

    def once(now: Enclosed) -> Enclosed:
        at = now.trial
        value, slope = tried(at)
        low, high = jnp.where(value > 0, now.low, at), jnp.where(value > 0, at, now.high)
        slow = jnp.abs(value) > SLOW * jnp.abs(now.last)
        step = -value / jnp.maximum(slope[0], LEAST * give)
        reach = jnp.maximum(now.reach, REACH * jnp.abs(value) / give)
        far = jnp.where(slow, reach, jnp.minimum(jnp.abs(step), reach))
        newton = at + step
        inside = (low < newton) & (newton < high) & ~slow
        both = jnp.isfinite(low) & jnp.isfinite(high)
        middle = 0.5 * (jnp.where(both, low, at) + jnp.where(both, high, at))
        trial = jnp.where(both, jnp.where(inside, newton, middle), at + jnp.sign(step) * far)
        nearer = jnp.abs(value) < jnp.abs(now.miss)
        x, miss = jnp.where(nearer, at, now.x), jnp.where(nearer, value, now.miss)
        best = jnp.where(nearer, slope, now.slope)
        reach = jnp.where(both, reach, reach * FARTHER)
        told = Enclosed(trial, x, miss, best, low, high, reach, value, now.trials + 1)
        # A load step that breaks down says nothing: the next one is nearer to the best, or to slack.
        back = jnp.where(jnp.isfinite(now.miss), now.x, 0.0)
        untold = now._replace(trial=0.5 * (at + back), trials=now.trials + 1)
        broken = ~(jnp.isfinite(value) & jnp.isfinite(slope[0]))[0]
        return jax.tree_util.tree_map(lambda a, b: jnp.where(broken, a, b), untold, told)

    far, none = jnp.full_like(x, jnp.inf), jnp.zeros_like(x)
    start = Enclosed(x, x, far, jnp.diag(give), -far, far, none, far, jnp.asarray(0))
    return jax.lax.while_loop(going, once, start)


def _damped(tried, x, give, least) -> TensionSearch:
    """Newton's method for several tendons, damped as Levenberg and Marquardt do it: where friction holds a
    tendon its displacement hardly answers to its tension. Arguments as of `search`.
    """

    def going(now: TensionSearch):
        near = jnp.max(jnp.abs(now.miss)) <= least
        return ~near & (now.trials < MOST_TRIALS) & (now.damping < MOST)

    def once(now: TensionSearch) -> TensionSearch:
        value, slope = tried(now.trial)
        nearer = jnp.linalg.norm(value / give) < jnp.linalg.norm(now.miss / give)
        eased = jnp.maximum(now.damping * EASIER, LEAST)
        better = now._replace(x=now.trial, miss=value, slope=slope, damping=eased)
        worse = now._replace(damping=now.damping * HARDER)
        best = jax.tree_util.tree_map(lambda a, b: jnp.where(nearer, a, b), better, worse)
        damped = best.slope + best.damping * jnp.diag(give)
        return best._replace(trial=best.x - times(inverse(damped), best.miss), trials=now.trials + 1)

    # The first trial is nearer than none.
    far, slope = jnp.full_like(x, jnp.inf), jnp.diag(give)
    start = TensionSearch(x, x, far, slope, jnp.asarray(FIRST / EASIER), jnp.asarray(0))
    return jax.lax.while_loop(going, once, start)


def compliance(robot: Robot) -> Float[Array, " tendons"]:
    """About how far each tendon is drawn out per tension [m/N], (tendons,), by bending and by its stretch."""
    s = sections(robot)
    nodes = len(s.mesh.s)
    # In space a body bends about two axes, and twists and stretches besides; in the plane it bends about one.
    bending = jnp.max(s.compliance.reshape(nodes, -1)[:, slice(1, 3) if robot.space else slice(1)], axis=-1)
    arms = jnp.sum(s.R.value.reshape(len(robot.tendons), nodes, -1) ** 2, axis=-1)
    bends = jnp.max(arms * bending[None, :], axis=-1) * robot.backbone.length
    one = jnp.ones(2)
    ends = jnp.stack([jnp.zeros(()), robot.backbone.length])
    stretch = [stretch_of((_strung(t),), ends, one, one) for t in robot.tendons]
    return jax.lax.stop_gradient(bends + jnp.stack(stretch) + LEAST_GIVE)


def _strung(tendon: Tendon) -> Tendon:
    """The tendon without a preload."""
    return dataclasses.replace(tendon, preload=jnp.zeros(()))
