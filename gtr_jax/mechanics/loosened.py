"""What friction no longer holds: the held tension after friction has fallen where the tendon is locked.

Friction that falls leaves ln T steeper than it can hold. The tendon then slips, before the base tension of the
load step changes, until |d ln T| <= mu d(theta) everywhere, and no farther. Its slip towards the base is

    u(s) = integral over [s, L] of c (T - T_before) ds,       c = (strain per tension) + b^2/EI,

plus that of the anchor. Slip that runs in from the base ends at a front, where u = 0; beyond it the tendon
relaxes within itself and keeps its length. A profile with its front at each node, for both directions of slip
from the base, is marched towards the tip; the solution is the first whose u at the front has changed its sign,
interpolated linearly between the nodes (docs/mechanics.md).
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..terms import REGISTRY
from ..terms.term import Channel
from . import channel
from .case import Case, Load, Memory
from .mesh import increments, shifted
from .node import RIGID, clip, friction, product, total
from .sections import offset_before

LEAST = 1e-9  # N, a tension below which the tendon counts as slack


def after_loosening(case: Case, load: Load, memory: Memory) -> Float[Array, " N"]:
    """The held tension of one tendon with which a load step begins [N].

    Args:
        case: the robot; its load and memory do not count.
        load: the step.
        memory: of the step before.
    """
    case = dataclasses.replace(case, load=load, memory=memory)
    now, was = (_factor(case, time) for time in (load.time, load.time - load.dt))
    loosens = now < was
    tension = jnp.where(memory.tension > LEAST, memory.tension, LEAST)
    steep = jnp.abs(jnp.diff(jnp.log(tension), prepend=jnp.log(tension[:1])))
    left = steep * jnp.where(loosens, now / jnp.where(was > 0, was, 1.0), 1.0)
    turn = _turning(case)
    holds = [friction(case, sense) * turn for sense in (1.0, -1.0)]
    down, up = (jnp.exp(jnp.where(hold > left, hold, left)) for hold in holds)
    return jnp.where(jnp.any(loosens), _relaxed(case, tension, 1 / down, up), memory.tension)


def _factor(case: Case, time: Float[Array, ""]) -> Float[Array, " N"]:
    """Factor on friction, at a time [s], of the terms by which it may fall where the tendon is locked."""
    mesh = case.sections.mesh
    at = Channel(mesh.s - mesh.interval.length, mesh.s, jnp.zeros_like(mesh.s), 1.0, time, case.load.cycle)
    factor = jnp.ones_like(mesh.s)
    for kind, hook in case.structure.hooks("friction"):
        if REGISTRY[kind].loosens:
            factor = factor * hook(case.terms[kind], at)
    return jnp.where(factor > 0, factor, 0.0)


def _turning(case: Case) -> Float[Array, " N"]:
    """Turning of the tendon since the preceding node that counts, in the shape of the step before [rad]."""
    s, kappa = case.sections, case.memory.kappa
    turn = increments(s.mesh.weights, kappa)
    before = shifted(kappa)
    wrap = channel.wrap_increment(turn, kappa, before, s.R, offset_before(s.R), s.mesh.interval)
    return wrap * product(case, "wrap", case.memory.tension)


def _relaxed(case: Case, tension, down, up) -> Float[Array, " N"]:
    """The tension after the slip, from that before it [N], which may fall from each node to the next by no more
    than a factor `down` and rise by no more than `up`.
    """
    s, kappa, nodes = case.sections, case.memory.kappa, jnp.arange(tension.shape[0])
    gives = RIGID + total(case, "strain", tension + 1.0) - total(case, "strain", tension)
    nu = channel.metric_factor(kappa, s.R)
    compliance = gives * nu + s.compliance * channel.moment_arm(kappa, s.R) ** 2
    at_anchor = total(case, "anchor", tension[-1] + 1.0) - total(case, "anchor", tension[-1])
    # Rows: slip from the base towards the base, and towards the tip. Columns: the node of the front.
    lines = tension[0] * jnp.stack([jnp.cumprod(down), jnp.cumprod(up)])
    scale = lines / tension

    def node(carry, row):
        now, drawn, longer = carry
        at, own, line, fall, climb, weight, length = row
        held = clip(scale * own, now * fall, now * climb)
        new = jnp.where(nodes[None, :] >= at, line[:, None], held)
        more = weight * (new - own)
        drawn = drawn + jnp.where(nodes[None, :] >= at, 0.0, 0.5 * length * (more + longer))
        return (new, drawn, more), new

    rows = (nodes, tension, lines.T, down, up, compliance, s.mesh.interval.length)
    start = (jnp.zeros_like(lines) + tension[0], jnp.zeros_like(lines), jnp.zeros_like(lines))
    (last, drawn, _), profiles = jax.lax.scan(node, start, rows)
    drawn = drawn + at_anchor * (last - tension[-1])
    towards_base = drawn[0, 0] > 0
    slip = jnp.where(towards_base, drawn[0], -drawn[1])
    along = jnp.where(towards_base, profiles[:, 0], profiles[:, 1])
    over = slip <= 0
    first = over & (jnp.cumsum(jnp.where(over, 1.0, 0.0)) == 1.0)
    earlier = shifted(slip)
    gap = earlier - slip
    share = jnp.where(first & (nodes > 0), slip / jnp.where(gap > 0, gap, 1.0), 0.0)
    # Where no slip at all is needed, the front is at the base.
    return jnp.sum(along * (jnp.where(first, 1.0, 0.0) + share - shifted(share[::-1])[::-1])[None, :], axis=1)
