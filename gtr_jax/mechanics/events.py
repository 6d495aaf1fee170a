"""Events between load steps, and what they leave of the tension that friction holds.

*Loosened*: friction that falls leaves ln T steeper than it can hold. The tendon then slips, before the base
tension of the load step changes, until |d ln T| <= mu d(theta) everywhere, and no farther. Its slip towards
the base is

    u(s) = integral over [s, L] of c (T - T_before) ds,       c = (strain per tension) + b^2/EI,

plus that of the anchor. Slip towards the base goes with d ln T = -mu d(theta), slip towards the tip with the
opposite, and no slip with anything between. These are the conditions for the least of

    integral of c (T - T_before ln T) ds + (the anchor's),        |d ln T| <= mu d(theta),  T(0) = T_base,

which is convex in ln T, with u as multiplier: what relaxes is unique, however many peaks and valleys ln T
has. Friction that is lumped ahead of the channel and at the anchor holds as much as before; the tension
beyond it is one more node. The least is found by dynamic programming: from the tip to the base, the tension
that each node would have if nothing held it from the base's side; then, from the base, that tension clipped
against the preceding node.

*Tugged*: the end at the tip is moved until its tension has changed by as much as is asked, and slip runs in
from there,

    T(s) = clip(T_before, T_tip exp(-mu (theta(L) - theta)), T_tip exp(+mu (theta(L) - theta))),

which the end follows by the integral of -c (T - T_before) over the tendon. The base's bounds then clip T as
in any load step (docs/mechanics.md).
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..terms import called
from ..terms.term import Channel
from .bodies import geometry_of, metric_of, offset_of, turning_of
from .case import FOREVER, Case, Load, Memory
from .mesh import following, shifted
from .node import RIGID, any_on, clip, drawn_before, friction, product, rise_per_newton, total

LEAST = 1e-9  # N, a tension below which the tendon counts as slack
SMALL = 1e-12  # share of the whole compliance that every node has
FAR, HIGH = 1e4, 100.0  # logarithms of a tension beyond any, and of one that exp still knows


def after_loosening(case: Case, load: Load, memory: Memory) -> Memory:
    """The memory of one tendon after friction has fallen.

    Args:
        case: the robot; its load and memory do not count.
        load: the step that follows.
        memory: of the step before.
    """
    case = dataclasses.replace(case, load=load, memory=memory)
    earlier = jnp.zeros(()) if memory.drawn_earlier is None else memory.drawn_earlier
    now = _factor(case, load.time, load.cycle, drawn_before(case))
    was = _factor(case, load.time - load.dt, load.cycle - load.turned, earlier)
    # A step without a clock is far from any other: only the base tension changes in it.
    was = jnp.where(load.dt < FOREVER, was, now)
    # Friction that follows the slip relaxes by itself.
    by_slip = any_on(case, [kind for kind in case.structure.terms if case.structure.catalogue[kind].mobilise])
    loosens = (now < was) & jnp.logical_not(by_slip)
    held = (memory.entry, memory.tension, memory.T_tip)
    entry, tension, T_tip = jax.lax.cond(jnp.any(loosens), lambda: _after(case, now, was), lambda: held)
    return dataclasses.replace(memory, entry=entry, tension=tension, T_tip=T_tip)


def taut(tension: Float[Array, "..."]) -> Float[Array, "..."]:
    """A tension [N], `LEAST` where it is less."""
    return jnp.where(tension > LEAST, tension, LEAST)


def _after(case: Case, now: Float[Array, " N"], was: Float[Array, " N"]):
    """The tension past the friction lumped ahead of the channel, at the nodes and at the anchor [N], after
    friction has fallen to a share `now`, from a share `was`, of what it is without.
    """
    memory, loosens = case.memory, now < was
    tension = taut(memory.tension)
    steep = jnp.abs(jnp.diff(jnp.log(tension), prepend=jnp.log(tension[:1])))
    left = steep * jnp.where(loosens, now / jnp.where(was > 0, was, 1.0), 1.0)
    turn = turning_before(case)
    holds = [friction(case, sense) * turn for sense in (1.0, -1.0)]
    down, up = (jnp.where(hold > left, hold, left) for hold in holds)
    return _relaxed(case, tension, down, up)


def after_tug(case: Case, load: Load, memory: Memory) -> tuple[Memory, Float[Array, ""]]:
    """The memory of one tendon after its end at the tip was moved, and how far towards the base [m];
    arguments as for `after_loosening`.
    """
    case = dataclasses.replace(case, load=load, memory=memory)
    tension = memory.tension
    gripped = case.structure.has("tip_grip")
    end = memory.T_tip if gripped else tension[-1]
    added = sum(
        called(hook, case.terms[kind], load.time) - called(hook, case.terms[kind], load.time - load.dt)
        for kind, hook in case.structure.hooks("tugged")
    )
    end = jnp.where(end + added > 0, end + added, 0.0)
    grip = total(case, "tip_grip")
    turn = turning_before(case)

    def bound(sense: float):
        """What friction makes of the tension at the end, for slip towards the base or the tip."""
        hold = friction(case, sense) * turn
        return end * jnp.exp(sense * (grip + jnp.sum(hold) - jnp.cumsum(hold)))

    held = jnp.where(added != 0, clip(tension, bound(-1.0), bound(1.0)), tension)
    more = _compliance(case) * (held - tension)
    length = case.sections.mesh.interval.length
    moved = (
        -jnp.sum(0.5 * length * (more + shifted(more)))
        - rise_per_newton(case, "anchor", tension[-1]) * (held - tension)[-1]
    )
    return dataclasses.replace(memory, tension=held, T_tip=jnp.where(added != 0, end, memory.T_tip)), moved


def _factor(
    case: Case, time: Float[Array, ""], cycle: Float[Array, ""], drawn: Float[Array, ""]
) -> Float[Array, " N"]:
    """Factor on friction, at a time [s], after some cycles and with some of the tendon drawn out [m], of the
    terms by which it may fall where the tendon is locked.
    """
    mesh = case.sections.mesh
    none = jnp.zeros_like(mesh.s)
    at = Channel(mesh.s - mesh.interval.length, mesh.s, none, 1.0, time, cycle, drawn)
    factor = jnp.ones_like(mesh.s)
    for kind, hook in case.structure.hooks("friction"):
        if case.structure.catalogue[kind].loosens:
            factor = factor * called(hook, case.terms[kind], at)
    return jnp.where(factor > 0, factor, 0.0)


def turning_before(case: Case) -> Float[Array, " N"]:
    """Turning of the tendon since the preceding node that counts, in the shape of the step before [rad]."""
    wrap = turning_of(case.sections, case.memory.kappa)
    return wrap * product(case, "wrap", case.memory.tension)


def _compliance(case: Case) -> Float[Array, " N"]:
    """How much of the tendon slips out of each length of channel, per tension: 1/N, (N,)."""
    s, kappa = case.sections, case.memory.kappa
    gives = RIGID + rise_per_newton(case, "strain", case.memory.tension)
    body = geometry_of(s).give(s.compliance, kappa, offset_of(s, kappa))
    return gives * metric_of(s, kappa) + s.ended(body)


def give_of_nodes(case: Case) -> Float[Array, " N"]:
    """How much of the tendon slips out of the channel about each node, per tension: m/N, (N,)."""
    length = case.sections.mesh.interval.length
    return _compliance(case) * 0.5 * (length + following(length))


def _relaxed(case: Case, tension, down, up):
    """The tension after the slip, as `_after`, from that before it [N], where friction can hold that its
    logarithm falls by `down` or rises by `up` since the preceding node, (N,) each.
    """
    what, memory = case.structure, case.memory
    nodes = tension.shape[0]
    weight = give_of_nodes(case)
    last = jnp.arange(nodes) == nodes - 1
    anchor = rise_per_newton(case, "anchor", memory.T_tip)
    # A node between two others at its place has no length of its own.
    small = SMALL * (jnp.sum(weight) + anchor)
    weight = weight + small
    # Friction that is lumped ahead of the channel and at the anchor holds as much as before.
    ahead, behind = what.has("base_grip"), what.has("tip_grip")
    if not behind:
        weight = jnp.where(last, weight + anchor, weight)
    rows = [(tension, weight, down, up)]
    if ahead:
        first = jnp.arange(nodes) == 0
        grip = total(case, "base_grip")
        down, up = (jnp.where(first, grip, hold) for hold in (down, up))
        rows = [(memory.T_base, small, 0.0, 0.0), (tension, weight, down, up)]
    if behind:
        grip = total(case, "tip_grip")
        rows.append((memory.T_tip, small + anchor, grip, grip))
    tension, weight, down, up = (
        jnp.concatenate([jnp.atleast_1d(jnp.asarray(x, tension.dtype)) for x in column])
        for column in zip(*rows, strict=True)
    )
    found = least(taut(tension), weight, down, up)
    held = found[1 if ahead else 0 :][:nodes]
    return held[0], held, found[-1]


def least(
    tension: Float[Array, " N"], weight: Float[Array, " N"], down: Float[Array, " N"], up: Float[Array, " N"]
) -> Float[Array, " N"]:
    """The tension T, (N,), that makes the sum of weight (T - tension ln T) least, where ln T falls by at most
    `down` and rises by at most `up` from one node to the next, and the first is kept.
    """
    nodes = tension.shape[0]
    # The slope of the least energy of all from a node to the end, over the logarithm y of the tension at the
    # node: a exp(y) + b in each piece, from its edge to the next one's.
    place = jnp.arange(2 * nodes)
    edge = jnp.where(place == 0, -FAR, FAR)

    def node(carry, row):
        edge, a, b = carry
        own, more, fall, climb = row
        a, b = a + more, b - more * own
        below = (a * jnp.exp(jnp.where(edge < HIGH, edge, HIGH)) + b < 0) | (place == 0)
        root = jnp.sum(jnp.where(below, 1, 0)) - 1
        at = place == root
        # Rounding may put it beyond a piece that is no wider than that.
        start, end = (jnp.sum(jnp.where(place == k, edge, 0.0)) for k in (root, root + 1))
        free = jnp.log(-jnp.sum(jnp.where(at, b, 0.0)) / jnp.sum(jnp.where(at, a, 0.0)))
        free = clip(free, start, end)
        # Of the preceding node: below, friction holds a rise to this one, above, a fall; between, nothing.
        above = [shifted(x, 2) for x in (jnp.where(at, free, edge) + fall, a * jnp.exp(-fall), b)]
        under = (edge - climb, a * jnp.exp(climb), b)
        none = (free - climb, 0.0, 0.0)
        joined = [
            jnp.where(place <= root, x, jnp.where(place == root + 1, y, z))
            for x, y, z in zip(under, none, above, strict=True)
        ]
        return tuple(joined), free

    rows = tuple(x[:0:-1] for x in (tension, weight, down, up))
    nothing = jnp.zeros(2 * nodes)
    _, free = jax.lax.scan(node, (edge, nothing, nothing), rows)

    def along(before, row):
        free, fall, climb = row
        now = clip(free, before - fall, before + climb)
        return now, now

    start = jnp.log(tension[0])
    _, rest = jax.lax.scan(along, start, (free[::-1], down[1:], up[1:]))
    return jnp.exp(jnp.concatenate([start[None], rest]))
