"""Events between load steps, and what they leave of the tension that friction holds.

*Loosened*: friction that falls leaves ln T steeper than it can hold. The tendon then slips, before the base
tension of the load step changes, until |d ln T| <= mu d(theta) everywhere, and no farther. Its slip towards
the base is

    u(s) = integral over [s, L] of c (T - T_before) ds,       c = (strain per tension) + b^2/EI,

plus that of the anchor. Slip that runs in from the base ends at a front, where u = 0; beyond it the tendon
relaxes within itself and keeps its length. A profile with its front at each node, for both directions of
slip from the base, is marched towards the tip; the solution is the first whose u at the front has changed
its sign, interpolated linearly between the nodes.

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
from .case import Case, Load, Memory
from .mesh import shifted
from .node import RIGID, clip, friction, product, total

LEAST = 1e-9  # N, a tension below which the tendon counts as slack


def after_loosening(case: Case, load: Load, memory: Memory) -> Float[Array, " N"]:
    """The held tension of one tendon after friction has fallen [N].

    Args:
        case: the robot; its load and memory do not count.
        load: the step that follows.
        memory: of the step before.
    """
    case = dataclasses.replace(case, load=load, memory=memory)
    now, was = (_factor(case, time) for time in (load.time, load.time - load.dt))
    loosens = now < was
    return jax.lax.cond(jnp.any(loosens), lambda: _after(case, now, was), lambda: memory.tension)


def _after(case: Case, now: Float[Array, " N"], was: Float[Array, " N"]) -> Float[Array, " N"]:
    """The tension after friction has fallen to a share `now`, from a share `was`, of what it is without."""
    memory, loosens = case.memory, now < was
    tension = jnp.where(memory.tension > LEAST, memory.tension, LEAST)
    steep = jnp.abs(jnp.diff(jnp.log(tension), prepend=jnp.log(tension[:1])))
    left = steep * jnp.where(loosens, now / jnp.where(was > 0, was, 1.0), 1.0)
    turn = _turning(case)
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
    turn = _turning(case)

    def bound(sense: float):
        """What friction makes of the tension at the end, for slip towards the base or the tip."""
        hold = friction(case, sense) * turn
        return end * jnp.exp(sense * (grip + jnp.sum(hold) - jnp.cumsum(hold)))

    held = jnp.where(added != 0, clip(tension, bound(-1.0), bound(1.0)), tension)
    more = _compliance(case) * (held - tension)
    length = case.sections.mesh.interval.length
    moved = (
        -jnp.sum(0.5 * length * (more + shifted(more)))
        - _give(case, "anchor", tension[-1]) * (held - tension)[-1]
    )
    return dataclasses.replace(memory, tension=held, T_tip=jnp.where(added != 0, end, memory.T_tip)), moved


def _factor(case: Case, time: Float[Array, ""]) -> Float[Array, " N"]:
    """Factor on friction, at a time [s], of the terms by which it may fall where the tendon is locked."""
    mesh = case.sections.mesh
    at = Channel(mesh.s - mesh.interval.length, mesh.s, jnp.zeros_like(mesh.s), 1.0, time, case.load.cycle)
    factor = jnp.ones_like(mesh.s)
    for kind, hook in case.structure.hooks("friction"):
        if case.structure.catalogue[kind].loosens:
            factor = factor * called(hook, case.terms[kind], at)
    return jnp.where(factor > 0, factor, 0.0)


def _turning(case: Case) -> Float[Array, " N"]:
    """Turning of the tendon since the preceding node that counts, in the shape of the step before [rad]."""
    wrap = turning_of(case.sections, case.memory.kappa)
    return wrap * product(case, "wrap", case.memory.tension)


def _compliance(case: Case) -> Float[Array, " N"]:
    """How much of the tendon slips out of each length of channel, per tension: 1/N, (N,)."""
    s, kappa = case.sections, case.memory.kappa
    gives = RIGID + _give(case, "strain", case.memory.tension)
    body = geometry_of(s).give(s.compliance, kappa, offset_of(s, kappa))
    return gives * metric_of(s, kappa) + s.ended(body)


def _give(case: Case, name: str, tension):
    """Change of the sum of the terms' hook `name` with the tension [N], per newton."""
    return total(case, name, tension + 1.0) - total(case, name, tension)


def _relaxed(case: Case, tension, down, up) -> Float[Array, " N"]:
    """The tension after the slip, from that before it [N], where friction can hold that its logarithm falls
    by `down` or rises by `up` since the preceding node, (N,) each.
    """
    s, nodes = case.sections, jnp.arange(tension.shape[0])[None, :]
    # Rows: slip from the base towards the base, and towards the tip. Columns: the node of the front.
    lines = tension[0] * jnp.exp(jnp.stack([-jnp.cumsum(down), jnp.cumsum(up)]))
    scale = lines / tension[None, :]

    def node(carry, row):
        now, slip, longer = carry
        at, own, line, fall, climb, weight, length = row
        held = clip(scale * own, now * jnp.exp(-fall), now * jnp.exp(climb))
        new = jnp.where(nodes >= at, line[:, None], held)
        more = weight * (new - own)
        slip = slip + jnp.where(nodes >= at, 0.0, 0.5 * length * (more + longer))
        return (new, slip, more), new

    nothing = jnp.zeros_like(lines)
    rows = (nodes[0], tension, lines.T, down, up, _compliance(case), s.mesh.interval.length)
    (last, slip, _), profiles = jax.lax.scan(node, (nothing + tension[0], nothing, nothing), rows)
    slip = slip + _give(case, "anchor", tension[-1]) * (last - tension[-1])
    pulls = slip[0, 0] > 0
    left = jnp.where(pulls, slip[0], -slip[1])
    profiles = jnp.where(pulls, profiles[:, 0], profiles[:, 1])
    # The first front whose slip has changed its sign, and the share of the front before it.
    turned = left <= 0
    first = turned & (jnp.cumsum(jnp.where(turned, 1.0, 0.0)) == 1.0)
    gap = shifted(left) - left
    earlier = jnp.where(first & (nodes[0] > 0), -left / jnp.where(gap > 0, gap, 1.0), 0.0)
    shares = jnp.where(first, 1.0, 0.0) - earlier + shifted(earlier[::-1])[::-1]
    return jnp.sum(profiles * shares[None, :], axis=1)
