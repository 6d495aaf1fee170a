"""Which way a tendon slips in a load step, where friction grows with the speed of the slip.

Where the base tension turns back, the tendon beyond goes on slipping for a while: the friction that its speed
added falls, and the tension that this friction held flows apart. Tension then falls at points that slip
towards the base, and friction holds less there than a held point could. That a point's tension may stay,
because friction could hold it, says nothing: the slip decides. So the slip is predicted, and the equations of
a node (`node.Equations`) take friction as whole wherever the tendon is told to slip.

With the compliance c = (strain per tension) + b^2/EI of the shape before the step, the slip u(s) in it, its
duration dt and y = ln T,

    c (T - T_before) + du/ds = 0,  u(L) = 0,        dy = -(mu tanh(u/w) + g(u/dt)) d(theta),  T(0) = T_base,

where g is what the speed adds and w a slip at which friction is whole. For w = 0 these are the conditions for
the least of a convex function, unless g falls. Newton's method solves for y and u together, a system of three
diagonals in y, while w narrows: with y alone, and friction either whole or none, it cycles. Used are the
direction of u and, in the interval in which u changes it, where friction is neither whole nor the tension
kept, how far it is mobilised. Where u begins, the kept tension gives way as the change of T grows: without a
jump, so that a tendon driven by displacement has a base tension. How the body's stiffness
changes as it bends, loads, and creep of the body do not count in c. Checked in
`tests/mechanics/test_sliding.py`.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..terms.term import Passing
from .bodies import turning_of
from .case import FOREVER, Case, Load, Memory, Sliding
from .events import give_of_nodes, taut, turning_before
from .mesh import following, shifted
from .node import channel_rows, clip, friction, product, rise_per_newton, total

# Newton's iterations at most, largest step of ln T, and by how much the slip at which friction is whole
# narrows in each until it is this share of the largest slip of the step before. It waits while ln T still
# changes by more than `NEAR`: otherwise one load step in some hundreds goes round in a cycle.
ITERATIONS, FARTHEST, NARROWER, NARROWEST, NEAR = 120, 1.0, 0.5, 1e-6, 1e-2
# Least compliance of a node, of the whole one, and least resistance to slip, in place of none.
LIGHT, EASY = 1e-9, 1e-6
WHOLE = 4.0  # widths of slip at which friction is whole
# Share of sliding friction that speed has to add in the step before; with less, nothing is predicted. Shares
# of itself by which a tension that is predicted to change begins to give way, and is as predicted.
FAINT, CLEAR, SURE = 1e-4, 1e-5, 1e-4
SETTLED, EXACT = 1e-5, 1e-12  # last step of ln T: above the first nothing is known, below the second it ends


def predicted_slip(case: Case, load: Load, memory: Memory) -> Sliding:
    """What is predicted of the slip of one tendon in a load step: nothing unless the base tension turns back
    while the tendon slips.

    Args:
        case: the robot; its load and memory do not count.
        load: the step.
        memory: of the step before.
    """
    case = dataclasses.replace(case, load=load, memory=memory)
    assert memory.speed is not None
    turned = jnp.where(load.T_base < memory.T_base, memory.speed, -memory.speed) > 0
    felt = total(case, "by_speed", jnp.abs(memory.speed)) > FAINT * case.mu
    asked = jnp.any(turned & felt) & (load.dt < FOREVER)
    none = jnp.zeros_like(memory.tension)
    return jax.lax.cond(asked, lambda: _told(case, asked), lambda: Sliding(none, none))


def _told(case: Case, asked: Bool[Array, ""]) -> Sliding:
    """As `predicted_slip`, of a load step that asks for it: of several side by side (`jax.vmap`) some may
    not, and nobody waits for them.
    """
    start, improved, _ = _problem(jax.lax.stop_gradient(case))
    found = _root(improved, start, asked)
    # Newton's step from the root has its derivatives.
    _, improved, bounds = _problem(case)
    y, slip, width, last = improved(jax.lax.stop_gradient(found))
    low, high = bounds(y, slip)
    apart = jnp.where(high > low, high - low, 1.0)
    way = 1.0 - 2.0 * clip((y - low) / apart, 0.0, 1.0)
    way = jnp.where(slip > WHOLE * width, 1.0, jnp.where(slip < -WHOLE * width, -1.0, way))
    change = jnp.abs(jnp.expm1(y - jnp.log(taut(case.memory.tension))))
    confidence = jnp.maximum(
        _between(change, CLEAR, SURE), _between(jnp.abs(slip) / width, WHOLE, WHOLE * 10)
    )
    return Sliding(way, jnp.where(last < SETTLED, confidence, 0.0))


def _root(improved, start, asked):
    """Where Newton's method ends: the slip of held points converges long after the tensions."""

    def unfinished(now):
        count, (_, _, _, last), narrower = now
        return asked & (count < ITERATIONS) & (narrower | (last > EXACT))

    def again(now):
        count, at, _ = now
        new = improved(at)
        return count + 1, new, new[2] < at[2]

    return jax.lax.while_loop(unfinished, again, (0, start, True))[1]


def _between(value, low, high):
    """How far a value has come from one to another, from 0 to 1."""
    return clip((value - low) / (high - low), 0.0, 1.0)


def _problem(case: Case):
    """Where Newton's method starts, one step of it, and the bounds of ln T at an answer. Both are of ln T and
    the slip [m], (N,) each; the step is of the slip at which friction is whole, too, and of its own largest
    change of ln T.
    """
    memory = case.memory
    assert memory.speed is not None
    before = taut(memory.tension)
    weight = give_of_nodes(case)
    # Friction lumped at the anchor holds it.
    gripped = case.structure.has("tip_grip")
    anchor = 0.0 if gripped else rise_per_newton(case, "anchor", memory.T_tip)
    weight = weight + LIGHT * (jnp.sum(weight) + anchor)
    last = jnp.arange(before.shape[0]) == before.shape[0] - 1
    weight = jnp.where(last, weight + anchor, weight)
    # As the equations of a node take it where the tendon is held against its neighbour.
    turn = turning_before(case)
    if memory.stencil is not None:
        compact = turning_of(case.sections, memory.kappa, compact=True) + memory.stencil
        turn = jnp.where(memory.tension > 0, compact * product(case, "wrap", memory.tension), turn)
    first, grip = jnp.arange(before.shape[0]) == 0, total(case, "base_grip")
    base = jnp.log(taut(case.load.T_base))
    dt = case.load.dt

    def by_speed(slip):
        """How far ln T falls by the speed of a slip past each interval."""
        return total(case, "by_speed", slip / dt) * turn

    def holds(tension):
        """How far sliding friction lets ln T fall, or rise, past each interval."""
        found = (_hold(case, sense, tension, turn) for sense in (1.0, -1.0))
        return [jnp.where(first, hold + grip, hold) for hold in found]

    def improved(at):
        y, slip, width, _ = at
        down, up = holds(jnp.exp(y))
        hold, sense = jnp.where(slip > 0, down, up), jnp.tanh(slip / width)
        fast, slope = jax.jvp(by_speed, (slip,), (jnp.ones_like(slip),))
        left = shifted(y, fill=base) - y - hold * sense - fast
        slope = jnp.where(slope > 0, slope, 0.0)
        gives = 1 / (hold * (1 - sense * sense) / width + slope + easy)
        tension, behind = jnp.exp(y), following(gives)
        flow = slip + gives * left
        wrong = weight * (tension - before) - flow + following(flow)
        change = _solved(weight * tension + gives + behind, -gives, -wrong)
        change = clip(change, -FARTHEST, FARTHEST)
        moved = slip + gives * (shifted(change) - change + left)
        # A slip that would turn stops first, where friction has a slope.
        moved = jnp.where((slip * moved < 0) & (jnp.abs(slip) > width), 0.0, moved)
        farthest = jnp.max(jnp.abs(change))
        less = jnp.where(width * NARROWER > narrow, width * NARROWER, narrow)
        return y + change, moved, jnp.where(farthest > NEAR, width, less), farthest

    def bounds(y, slip):
        """Least and largest ln T that friction allows past each interval, given that at its other end."""
        down, up = holds(jnp.exp(y))
        ahead = shifted(y, fill=base) - by_speed(slip)
        return ahead - down, ahead + up

    before_slip = memory.speed * dt
    widest = jnp.max(jnp.abs(before_slip))
    widest = jnp.where(widest > 0, widest, 1.0)
    narrow = NARROWEST * widest
    easy = EASY / jnp.sum(weight * before)
    down, up = holds(before)
    more = jnp.abs(by_speed(before_slip))
    y = _clipped(jnp.log(before), base, down + more, up + more)
    start = y, before_slip, widest, jnp.asarray(jnp.inf)
    return start, improved, bounds


def _hold(case: Case, sense: float, tension, turn) -> Float[Array, " N"]:
    """How far sliding friction lets ln T fall or rise past the interval ahead of each node."""
    length = case.sections.mesh.interval.length
    there = length > 0
    pressure = tension * turn / jnp.where(there, length, 1.0)
    channel = channel_rows(case)._replace(sense=sense) if case.structure.reads_channel else None
    passing = Passing(pressure, tension, channel)
    hold = friction(case, sense) * turn
    if case.structure.has("by_pressure"):
        hold = hold * jnp.where(there, product(case, "by_pressure", passing), 1.0)
    return hold + total(case, "drag", passing) * length / tension


def _clipped(y, base, down, up):
    """The logarithm of a tension, held against its neighbours from the base on."""

    def node(ahead, row):
        own, fall, climb = row
        own = clip(own, ahead - fall, ahead + climb)
        return own, own

    return jax.lax.scan(node, base, (y, down, up))[1]


def _solved(diagonal, ahead, right):
    """Of a symmetric system of three diagonals, `ahead` the one below the diagonal."""

    def forward(carry, row):
        pivot, found = carry
        own, off, wanted = row
        factor = off / pivot
        now = own - factor * off, wanted - factor * found
        return now, now

    first = jnp.ones_like(diagonal[0]), jnp.zeros_like(right[0])
    start = jnp.where(jnp.arange(diagonal.shape[0]) == 0, 0.0, ahead)
    _, (pivot, found) = jax.lax.scan(forward, first, (diagonal, start, right))

    def back(after, row):
        pivot, found, off = row
        now = (found - off * after) / pivot
        return now, now

    rows = tuple(x[::-1] for x in (pivot, found, following(start)))
    return jax.lax.scan(back, jnp.zeros_like(right[0]), rows)[1][::-1]
