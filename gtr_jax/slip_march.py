"""The equilibrium with physics beyond the paper: a march in which the slip of the tendons is known.

Friction that builds up over a slip, or depends on its speed, couples a place with all that lies between it
and the tip. But given the displacement of the tendon at the base, u(0), the slip

    u(s) = u(0) - integral over [0, s] of (nu_0 - nu + nu strain)

is known from the base on, so that every law is local: one march, one scalar equation per node, gives the
state. What is left at the tip closes it: the anchor does not slip, u(L) = 0 (or as far as it gives way), the
external moment there is the tip's, and a stop pushes back as far as it is pressed. Unknown are u(0) of every
tendon, the external moment at the base and the force of the stop: Newton's method finds them, with their
derivatives carried along the march.

Where no presliding is wanted, friction holds one tendon by its tension, as `friction.tension` does: T =
clip(memory, P, Q) with P and Q the tensions if all of it slipped towards the base, or the tip. Where the body
or friction goes on changing while the tendon is locked (`Term.creeps`) that would let friction hold more
than it can, and the bounds are taken from the neighbouring node's tension instead; otherwise not, because a
front that passes a node then leaves an error of the mesh behind (some 1e-4 of the tension). Several tendons
slide because the body bends under the others: they always have presliding, of at least FLOOR times the
length.
"""

from __future__ import annotations

import dataclasses
import functools
import operator
from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float, Int

from gtr_jax.mechanics.offset import Offset

from . import channel
from .adjoint import split_tangents
from .linear_solver import node_first
from .mesh import STENCIL, Interval
from .problem import Sections, State, at_tendons, largest, moment_slope, offset_before, over_tendons
from .small_matrices import inverse as inverse_of
from .small_matrices import times
from .terms import REGISTRY, any_on
from .terms.term import STILL, Bent, Channel, Values

NEWTON_AT_NODE = 3
FLATTEST = 0.3
FLOOR = 1e-4
HIGHEST = 10.0
MAX_MARCHES = 60
SHORTEST = 2.0**-12
REACH = 4e-3  # of the length: by how much the displacement is searched at a time
MOST_BRACKETED, MOST_PARTS = 16, 64
ELEMENTS = sum(term.elements for term in REGISTRY.values())
BENDING = {term.id: term for term in REGISTRY.values() if term.bend}


class Load(eqx.Module):
    """One step of a load history.

    Attributes:
        T_base: base tension [N], (*tendons,).
        dt: time since the step before [s].
        time: since the first sample [s].
        cycle: pulls and releases done, half a cycle each.
    """

    T_base: Float[Array, "*tendons"]
    dt: Float[Array, ""]
    time: Float[Array, ""]
    cycle: Float[Array, ""]


class Memory(eqx.Module):
    """What is left of the step before, the nodes first.

    Attributes:
        tension: at the nodes [N], (N, *tendons).
        slip: towards the base, at the nodes [m], (N, *tendons).
        middle: the same in the middle between each node and the one before it, (N, *tendons).
        speed: of the slip there [m/s], (N, *tendons).
        mobilised: how far friction is, there, in [-1, 1], (N, *tendons).
        stencil: turning since the node before [rad], less that by the trapezoidal rule, when the tendon
            slipped there last, (N, *tendons).
        elements: what presliding remembers, (N, ELEMENTS, *tendons).
        bent: what the bending laws remember, (N, numbers) each.
        kappa: curvature [1/m], (N,).
        entry: tension behind what grips ahead of the channel [N], (*tendons,).
        T_tip: tension at the anchor [N], (*tendons,).
        T_base: base tension [N], (*tendons,).
        unknowns: what the march was closed with, (n,): see `Closing`.
    """

    tension: Float[Array, "N *tendons"]
    slip: Float[Array, "N *tendons"]
    middle: Float[Array, "N *tendons"]
    speed: Float[Array, "N *tendons"]
    mobilised: Float[Array, "N *tendons"]
    stencil: Float[Array, "N *tendons"]
    elements: Float[Array, "N elements *tendons"]
    bent: dict[str, Float[Array, "N _"]]
    kappa: Float[Array, " N"]
    entry: Float[Array, "*tendons"]
    T_tip: Float[Array, "*tendons"]
    T_base: Float[Array, "*tendons"]
    unknowns: Float[Array, " n"]


class Case(eqx.Module):
    """One load step: the robot at its nodes, the load, and what is remembered.

    Attributes:
        sections: the robot at the nodes.
        mu: friction coefficient [-], (*tendons,).
        preload: tension at which the tendon's strain counts as none [N], (*tendons,).
        tip_moment: external moment at the tip [N m].
        terms: the numbers of all physics terms.
        metric: nu of the channels before the first load, (N, *tendons).
        load: the load.
        memory: of the step before.
        against: share of the speed that counts where the tendon slips against the friction that holds it: 1,
            but less on the way to the solution.
    """

    sections: Sections
    mu: Float[Array, "*tendons"]
    preload: Float[Array, "*tendons"]
    tip_moment: Float[Array, ""]
    terms: dict[str, dict[str, Float[Array, ""]]]
    metric: Float[Array, "N *tendons"]
    load: Load
    memory: Memory
    against: Float[Array, ""]


class Closing(NamedTuple):
    """What is unknown at the base, and what must vanish at the tip, in the same order: displacement of every
    tendon [m] and its anchor's slip; external moment at the base and error of that at the tip [N m]; force of
    the stop (`_pressing`) and its error [N].
    """

    slip: Float[Array, "*tendons"]
    moment: Float[Array, ""]
    stop: Float[Array, ""]

    def flat(self) -> Float[Array, " n"]:
        """As one vector."""
        return jnp.concatenate([self.slip.ravel(), self.moment[None], self.stop[None]])


def _pressing(stop: Float[Array, ""]) -> Float[Array, ""]:
    """Force of the stop [N] from its unknown: that where positive. Where negative, the unknown is the
    distance from the stop, in such units that what is left at the tip falls evenly through zero: Newton's
    method would otherwise hop between touching and not.
    """
    return jnp.where(stop > 0, stop, 0.0)


def _closing(flat: Float[Array, " n"], like: Float[Array, "*tendons"]) -> Closing:
    return Closing(flat[:-2].reshape(like.shape), flat[-2], flat[-1])


def hooked(name: str):
    """Terms with a hook, and the hook."""
    return [(term.id, getattr(term, name)) for term in REGISTRY.values() if getattr(term, name)]


def _product(terms, name: str, *args):
    """Factors of all terms with a hook, multiplied."""
    return functools.reduce(operator.mul, [hook(terms[kind], *args) for kind, hook in hooked(name)])


def _sum(terms, name: str, *args):
    """Additions of all terms with a hook."""
    return functools.reduce(operator.add, [hook(terms[kind], *args) for kind, hook in hooked(name)])


def _stop(terms: Mapping[str, Values]):
    """The one term that is a stop."""
    ((kind, stop),) = hooked("stop")
    ((_, angle),) = hooked("stop_angle")
    return angle(terms[kind]), functools.partial(stop, terms[kind])


def _clip(value, low, high):
    """Not jnp.clip: where the bounds coincide, derivatives must follow the bound that is met."""
    return jnp.where(value <= low, low, jnp.where(value >= high, high, value))


class _Modes(NamedTuple):
    """Which law holds the tendon: by slip, or by tension against the neighbour instead of the base."""

    by_slip: Bool[Array, ""]
    neighbour: Bool[Array, ""]


class _Row(NamedTuple):
    """What a node's equations need, the nodes first."""

    R: Offset
    R_before: Offset
    compliance: Float[Array, " N"]
    rest: Float[Array, " N"]
    force_x: Float[Array, " N"]
    force_y: Float[Array, " N"]
    weights: Float[Array, "N 4"]
    interval: Interval
    metric: Float[Array, "N *tendons"]
    pulling: Float[Array, "N *tendons"]
    releasing: Float[Array, "N *tendons"]
    tension: Float[Array, "N *tendons"]
    middle: Float[Array, "N *tendons"]
    stencil: Float[Array, "N *tendons"]
    elements: Float[Array, "N elements *tendons"]
    bent: dict[str, Float[Array, "N _"]]
    kappa: Float[Array, " N"]


class _Carry(NamedTuple):
    """What a node's equations need of its predecessors, latest first where a stencil needs several."""

    kappas: tuple
    drawn: tuple
    slopes: tuple
    ways: tuple
    phi: Float[Array, ""]
    tension: Float[Array, "*tendons"]
    pulled: Float[Array, "*tendons"]
    released: Float[Array, "*tendons"]
    slip: Float[Array, "*tendons"]
    moment: Float[Array, ""]
    place: Float[Array, ""]


class _Node(NamedTuple):
    """What a march leaves at each node."""

    state: State
    tension: Float[Array, "N *tendons"]
    slip: Float[Array, "N *tendons"]
    middle: Float[Array, "N *tendons"]
    speed: Float[Array, "N *tendons"]
    mobilised: Float[Array, "N *tendons"]
    stencil: Float[Array, "N *tendons"]
    elements: Float[Array, "N elements *tendons"]
    bent: dict[str, Float[Array, "N _"]]


class _NodeEquations(eqx.Module):
    """The equations of a node, given a case and what is unknown at its base."""

    case: Case
    stop: Float[Array, ""]
    stop_angle: Float[Array, ""]
    modes: _Modes
    presliding: dict[str, Float[Array, ""]]
    highest: Float[Array, ""]

    def passed(self, tension, sense, turn, speed, row: _Row):
        """Tension behind an interval whose friction is mobilised by `sense`, in [-1, 1]."""
        terms = self.case.terms
        wrap = turn * _product(terms, "wrap", tension)
        length = row.interval.length
        there = length > 0
        pressure = tension * wrap / jnp.where(there, length, 1.0)
        mu = jnp.where(sense >= 0, row.pulling, row.releasing)
        mu = mu * jnp.where(there, _product(terms, "by_pressure", pressure), 1.0)
        # The coefficient depends on how fast the slip is, whichever way. Of the two branches of |v| the one
        # where slip opposes the friction that holds it has to be approached from the other.
        fast = jnp.where(speed * sense >= -STILL, speed, -self.case.against * speed)
        fast = jnp.where(self.modes.by_slip, speed, fast)
        lost = jnp.exp(-(sense * mu + _sum(terms, "by_speed", fast)) * wrap)
        left = tension * lost - sense * _sum(terms, "drag") * length
        left = jnp.where(left > 0, left, 0.0)
        return jnp.where(left < self.highest, left, self.highest)

    def __call__(self, carry: _Carry, row: _Row, kappa) -> tuple[Array, _Carry, _Node]:
        """Error of the moment balance at a curvature [1/m], what goes on to the next node, and what stays."""
        case, terms, w = self.case, self.case.terms, row.weights

        def increment(now, before):
            return w[0] * now + w[1] * before[0] + w[2] * before[1] + w[3] * before[2]

        turn = increment(kappa, carry.kappas)
        phi = carry.phi + turn
        midline = at_tendons((turn, kappa, carry.kappas[0]), row.R)
        between = at_tendons(row.interval, row.R)
        wrap = channel.wrap_increment(*midline, row.R, row.R_before, between)
        trapezoid = at_tendons(0.5 * row.interval.length * (kappa + carry.kappas[0]), row.R)
        compact = channel.wrap_increment(trapezoid, *midline[1:], row.R, row.R_before, between)
        local = self.modes.by_slip | self.modes.neighbour
        # From slack the first pull may be long: nothing was laid down that a stencil could shake loose.
        lags = self.modes.neighbour & ~self.modes.by_slip & (row.tension > 0)
        gripped = jnp.where(lags, compact + row.stencil, wrap)
        # Slip first as if the tendon did not stretch here; its strain follows its tension below.
        shortened = row.metric - channel.metric_factor(midline[1], row.R)
        known = carry.slip - w[1] * carry.drawn[0] - w[2] * carry.drawn[1] - w[3] * carry.drawn[2]

        def strained(tension):
            strain = _sum(terms, "strain", tension) - _sum(terms, "strain", case.preload)
            return shortened + strain * row.metric

        # The strain of this node counts with the tension before it: an error of second order in the interval.
        slip_near = known - w[0] * strained(carry.tension)
        middle = 0.5 * (carry.slip + slip_near)
        slipped = middle - row.middle
        speed = slipped / case.load.dt

        ((_, mobilise),) = hooked("mobilise")
        z, elements = mobilise(self.presliding, slipped, row.elements)
        by_slip = self.modes.by_slip
        low = self.passed(
            jnp.where(local, carry.tension, carry.pulled), jnp.where(by_slip, z, 1.0), gripped, speed, row
        )
        high = self.passed(
            jnp.where(local, carry.tension, carry.released), jnp.where(by_slip, z, -1.0), gripped, speed, row
        )
        held = _clip(row.tension, low, high)
        tension = jnp.where(by_slip, low, held)
        grip = jnp.where(held <= low, 1.0, jnp.where(held >= high, -1.0, 0.0))
        drawn = strained(tension)
        slip = known - w[0] * drawn

        angle = self.stop_angle
        slope = moment_slope(
            phi,
            row.force_x - self.stop * jnp.cos(angle),
            row.force_y - self.stop * jnp.sin(angle),
        )
        moment = carry.moment + increment(slope, carry.slopes)
        way = jnp.cos(phi - angle)
        place = carry.place + increment(way, carry.ways)

        bent, more = {}, jnp.zeros_like(kappa)
        for term_id, term in BENDING.items():
            assert term.bend is not None
            at = Bent(row.rest, row.kappa, row.bent[term_id], case.load.dt)
            extra, bent[term_id] = term.bend(terms[term_id], kappa, at)
            more = more + extra
        pulls = over_tendons(tension * channel.moment_arm(midline[1], row.R), 0)
        error = kappa - row.rest + more - row.compliance * (pulls + moment)

        def later(now, before):
            return (now, *before[: STENCIL - 2])

        new = _Carry(
            later(kappa, carry.kappas),
            later(drawn, carry.drawn),
            later(slope, carry.slopes),
            later(way, carry.ways),
            phi,
            tension,
            low,
            high,
            slip,
            moment,
            place,
        )
        node = _Node(
            State(kappa, phi, wrap, moment),
            tension,
            slip,
            middle,
            speed,
            jnp.where(by_slip, z, grip),
            jnp.where(grip == 0.0, row.stencil, wrap - compact),
            elements,
            bent,
        )
        return error, new, node


def _prepared(case: Case, x: Closing) -> tuple[_NodeEquations, _Carry, _Row]:
    """The node equations, what they start from, and their rows."""
    s, memory, terms, load = case.sections, case.memory, case.terms, case.load
    by_slip = any_on(terms, lambda term: term.mobilise is not None)
    neighbour = any_on(terms, lambda term: term.creeps)
    ((kind, _),) = hooked("mobilise")
    presliding = terms[kind]
    if case.mu.ndim:
        least = FLOOR * s.mesh.s[-1]
        length = presliding["length"]
        presliding = presliding | {"length": jnp.where(length > least, length, least)}
        by_slip = jnp.ones_like(by_slip)
    mesh, R = s.mesh, node_first(s.R)
    over = (-1, *[1] * case.mu.ndim)

    def grip(sense):
        start = (mesh.s - mesh.interval.length).reshape(over)
        at = Channel(start, mesh.s.reshape(over), jnp.abs(memory.speed), sense, load.time, load.cycle)
        factor = jnp.broadcast_to(_product(terms, "friction", at), R.value.shape)
        factor = jnp.where(factor > 0, factor, 0.0)  # friction that wears or drifts away is gone
        return jnp.broadcast_to(case.mu, R.value.shape) * factor

    row = _Row(
        R=R,
        R_before=node_first(offset_before(s.R)),
        compliance=s.compliance,
        rest=s.rest,
        force_x=s.force_x,
        force_y=s.force_y,
        weights=mesh.weights,
        interval=mesh.interval,
        metric=case.metric,
        pulling=grip(1.0),
        releasing=grip(-1.0),
        tension=memory.tension,
        middle=memory.middle,
        stencil=memory.stencil,
        elements=memory.elements,
        bent=memory.bent,
        kappa=memory.kappa,
    )
    base_grip = _sum(terms, "base_grip")
    low, high = load.T_base * jnp.exp(-base_grip), load.T_base * jnp.exp(base_grip)
    entry = _clip(memory.entry, low, high)
    zero, none = jnp.zeros_like(x.moment), jnp.zeros_like(case.mu)
    angle, _ = _stop(terms)
    back = STENCIL - 1
    carry = _Carry(
        kappas=(zero,) * back,
        drawn=(none,) * back,
        slopes=(zero,) * back,
        ways=(zero,) * back,
        phi=zero,
        tension=entry,
        pulled=low,
        released=high,
        slip=x.slip,
        moment=x.moment,
        place=zero,
    )
    # While the slip is guessed too low, a speed may raise the tension without end.
    known = jnp.maximum(jnp.max(load.T_base), jnp.max(memory.tension))
    highest = jax.lax.stop_gradient(HIGHEST * known)
    modes = _Modes(by_slip, neighbour)
    equations = _NodeEquations(case, _pressing(x.stop), angle, modes, presliding, highest)
    return equations, carry, row


def _closed(case: Case, x: Closing, end: _Carry, modes: _Modes) -> tuple[Closing, Float[Array, "*tendons"]]:
    """What is left at the tip, and the tension at the anchor."""
    terms = case.terms
    grip = jnp.exp(-_sum(terms, "tip_grip"))
    local = modes.by_slip | modes.neighbour
    low = jnp.where(local, end.tension, end.pulled) * grip
    high = jnp.where(local, end.tension, end.released) / grip
    T_tip = _clip(case.memory.T_tip, low, high)
    _, stop = _stop(terms)
    pushed, stiffness = jax.jvp(stop, (end.place,), (jnp.ones_like(end.place),))
    length = case.sections.mesh.s[-1]
    eased = 1.0 + stiffness * jnp.max(case.sections.compliance) * length**3 / 3
    left = Closing(
        end.slip - _sum(terms, "anchor", T_tip) + _sum(terms, "anchor", case.preload),
        end.moment - case.tip_moment,
        (_pressing(x.stop) + eased * (x.stop - _pressing(x.stop)) - pushed) / eased,
    )
    return left, T_tip


class _Marched(NamedTuple):
    left: Float[Array, " n"]
    by_unknowns: Float[Array, "n n"]
    kappa: Float[Array, " N"]
    error: Float[Array, ""]


def _march(case: Case, flat: Float[Array, " n"], guess: Float[Array, " N"], use_guess) -> _Marched:
    """One pass base to tip, with its derivatives by what is unknown at the base."""
    like = case.mu

    def start(flat):
        return _prepared(case, _closing(flat, like))

    equations, carry, rows = start(flat)
    directions = jnp.eye(flat.shape[0])

    def moved(direction):
        def of_base(flat):
            equations, carry, _ = start(flat)
            return equations.stop, carry

        return jax.jvp(of_base, (flat,), (direction,))[1]

    stop_dot, carry_dot = jax.vmap(moved)(directions)

    def node(state, x):
        carry, carry_dot = state
        row, guess = x

        near = row.rest
        for _ in range(2):
            arm = channel.moment_arm(at_tendons(near, row.R), row.R)
            near = row.rest + row.compliance * (over_tendons(carry.tension * arm, 0) + carry.moment)
        kappa = jnp.where(use_guess, guess, near)

        def improved(_, kappa):
            error, slope = jax.jvp(lambda k: equations(carry, row, k)[0], (kappa,), (jnp.ones_like(kappa),))
            return kappa - error / jnp.where(slope > FLATTEST, slope, FLATTEST)

        kappa = jax.lax.fori_loop(0, NEWTON_AT_NODE, improved, kappa)

        def at(kappa, carry, stop):
            now = eqx.tree_at(lambda e: e.stop, equations, stop)
            error, new, _ = now(carry, row, kappa)
            return error, new

        one, nothing = jnp.ones_like(kappa), jtu.tree_map(jnp.zeros_like, (carry, stop_dot[0]))
        point = (kappa, carry, equations.stop)
        (error, new), (slope, by_kappa) = jax.jvp(at, point, (one, *nothing))

        def along(carry_dot, stop_dot):
            error_dot, new_dot = jax.jvp(at, point, (jnp.zeros_like(kappa), carry_dot, stop_dot))[1]
            return jtu.tree_map(lambda d, k: d - error_dot / slope * k, new_dot, by_kappa)

        new_dot = jax.vmap(along)(carry_dot, stop_dot)
        return (new, new_dot), (kappa, error)

    (end, end_dot), (kappa, error) = jax.lax.scan(node, (carry, carry_dot), (rows, guess))

    def closed(flat, end):
        return _closed(case, _closing(flat, like), end, equations.modes)[0].flat()

    left = closed(flat, end)
    by_unknowns = jax.vmap(lambda d, e: jax.jvp(closed, (flat, end), (d, e))[1], out_axes=1)(
        directions, end_dot
    )
    return _Marched(left, by_unknowns, kappa, largest(error) * case.sections.mesh.s[-1])


def _described(case: Case, flat: Float[Array, " n"], kappa: Float[Array, " N"]):
    """What is left at the tip and what a march leaves, differentiable in all: each node's curvature follows
    what lies before it by one step of Newton's method from `kappa`, which is its root.

    The slope of that step is taken here, not from the march: where nothing slips the laws have a kink, and
    rounding may have put the march on the other side of it.
    """
    x = _closing(flat, case.mu)
    equations, carry, rows = _prepared(case, x)

    def node(carry, at):
        row, kappa = at
        error, slope = jax.jvp(lambda k: equations(carry, row, k)[0], (kappa,), (jnp.ones_like(kappa),))
        _, new, out = equations(carry, row, kappa - error / jax.lax.stop_gradient(slope))
        return new, out

    end, nodes = jax.lax.scan(node, carry, (rows, kappa))
    left, T_tip = _closed(case, x, end, equations.modes)
    memory = Memory(
        tension=nodes.tension,
        slip=nodes.slip,
        middle=nodes.middle,
        speed=nodes.speed,
        mobilised=nodes.mobilised,
        stencil=nodes.stencil,
        elements=nodes.elements,
        bent=nodes.bent,
        kappa=nodes.state.kappa,
        entry=carry.tension,
        T_tip=T_tip,
        T_base=case.load.T_base,
        unknowns=jax.lax.stop_gradient(flat),
    )
    return left.flat(), (memory, nodes.state)


class Solved(NamedTuple):
    """A load step solved.

    Attributes:
        memory: what is left of it.
        state: at the nodes first; its wrap is the turning since the node before.
        error: largest residual, dimensionless: slip by length, the rest as curvature times length.
        marches: taken.
    """

    memory: Memory
    state: State
    error: Float[Array, ""]
    marches: Int[Array, ""]


class _Search(NamedTuple):
    """Where the search stands: the next point to try; the displacements at the base known to be too small and
    too large; the last point that Newton's method accepted, its step from there, the length and share of it.
    """

    trial: Float[Array, " n"]
    low: Float[Array, ""]
    high: Float[Array, ""]
    point: Float[Array, " n"]
    step: Float[Array, " n"]
    inverse: Float[Array, "n n"]
    level: Float[Array, ""]
    share: Float[Array, ""]
    kappa: Float[Array, " N"]
    error: Float[Array, ""]
    marches: Int[Array, ""]


def _scales(case: Case) -> Float[Array, " n"]:
    """Sizes of the unknowns and of what is left: length; moment and force that bend by about a radian."""
    length = case.sections.mesh.s[-1]
    compliance = jnp.max(case.sections.compliance) * length
    bends = compliance > 0
    moment = 1.0 / jnp.where(bends, compliance, 1.0)
    return Closing(jnp.broadcast_to(length, case.mu.shape), moment, moment / length).flat()


def _bracketed(at: _Search, left: Float[Array, " n"], inverse, by_unknowns) -> _Search:
    """The next point for one tendon: Newton's, with the displacement kept between those known to be too small
    and too large. What is left of the slip rises with it, but so unevenly, where friction builds up over a
    short slip, that Newton's method alone would not find the root.
    """
    u = at.trial[0]
    low = jnp.where(left[0] < 0, jnp.maximum(at.low, u), at.low)
    high = jnp.where(left[0] > 0, jnp.minimum(at.high, u), at.high)
    # Moments and forces found meanwhile may have moved the root out of the bracket.
    lost = high - low < 1e-15
    low, high = jnp.where(lost, -jnp.inf, low), jnp.where(lost, jnp.inf, high)
    step = -times(inverse, left)
    new = u + step[0]
    both = jnp.isfinite(low) & jnp.isfinite(high)
    farther = jnp.where(left[0] < 0, u + REACH, u - REACH)
    within = jnp.where(both, 0.5 * (low + high), farther)
    known = both | (jnp.abs(step[0]) > REACH) | ~jnp.isfinite(new)
    cut = known & ~((new > low) & (new < high))
    new = jnp.where(cut, within, new)
    # With the displacement cut short, the others do what they can.
    others = -times(inverse_of(by_unknowns[1:, 1:]), left[1:] + by_unknowns[1:, 0] * (new - u))
    step = jnp.where(cut, jnp.concatenate([(new - u)[None], others]), step)
    return at._replace(trial=at.trial + step, low=low, high=high)


def _damped(at: _Search, left: Float[Array, " n"], inverse, by_unknowns) -> _Search:
    """The next point for several tendons: Newton's, so far that every step brings the next one closer
    (Deuflhard's natural monotonicity test).
    """
    del by_unknowns
    good = largest(times(at.inverse, left)) <= (1.0 - 0.25 * at.share) * at.level
    step = -times(inverse, left)
    share = jnp.where(good, jnp.minimum(1.0, 2.0 * at.share), 0.5 * at.share)
    share = jnp.where(at.marches == 0, 1.0, share)
    point, step = jnp.where(good, at.trial, at.point), jnp.where(good, step, at.step)
    return at._replace(
        trial=point + share * step,
        point=point,
        step=step,
        inverse=jnp.where(good, inverse, at.inverse),
        level=jnp.where(good, largest(step), at.level),
        share=share,
    )


def _newton(
    case: Case, start: Float[Array, " n"], kappa: Float[Array, " N"], atol: float, near: Bool[Array, ""]
) -> _Search:
    """Newton's method in the scaled unknowns, held on its way; `trial` ends at the last point tried. From a
    start that is `near`, every step has to bring the next one closer, for one tendon too.
    """
    scales = _scales(case)

    def next_point(*at):
        damped = _damped(*at)
        return damped if case.mu.ndim else _where(near, damped, _bracketed(*at))

    def unfinished(at: _Search):
        return (at.error > atol) & (at.marches < MAX_MARCHES) & (at.share > SHORTEST)

    def improved(at: _Search):
        m = _march(case, at.trial * scales, at.kappa, at.marches > 0)
        left = m.left / scales
        error = jnp.maximum(largest(left), m.error)
        by_unknowns = m.by_unknowns / scales[:, None] * scales[None, :]
        on = next_point(at, left, inverse_of(by_unknowns), by_unknowns)
        error = jnp.where(jnp.isnan(error), jnp.inf, error)
        return on._replace(
            trial=jnp.where(error <= atol, at.trial, on.trial),
            kappa=jnp.where(jnp.isfinite(m.kappa), m.kappa, at.kappa),
            error=error,
            marches=at.marches + 1,
        )

    first = start / scales
    one = jnp.ones_like(case.tip_moment)
    begin = _Search(
        trial=first,
        low=-jnp.inf * one,
        high=jnp.inf * one,
        point=first,
        step=jnp.zeros_like(first),
        inverse=jnp.eye(first.shape[0]),
        level=jnp.inf * one,
        share=one,
        kappa=kappa,
        error=jnp.inf * one,
        marches=jnp.asarray(0),
    )
    done = jax.lax.while_loop(unfinished, improved, begin)
    return done._replace(trial=done.trial * scales)


class _Found(NamedTuple):
    unknowns: Float[Array, " n"]
    kappa: Float[Array, " N"]
    error: Float[Array, ""]
    marches: Int[Array, ""]


def _search(case: Case, atol: float) -> _Found:
    """Newton's method from the step before; where it fails, again by way of base tensions in between. Where
    friction depends on the speed, `against` then goes from 0 to 1 in as many parts.
    """
    before, after = case.memory.T_base, case.load.T_base

    speedy = any_on(case.terms, lambda term: term.by_speed is not None)

    def by_way_of(parts):
        def closer(i, found: _Found):
            share = jnp.minimum((i + 1.0) / parts, 1.0)
            between = jnp.where(i + 1 >= parts, after, before + share * (after - before))
            now = eqx.tree_at(lambda c: c.load.T_base, case, between)
            now = eqx.tree_at(lambda c: c.against, now, jnp.clip((i + 1.0 - parts) / parts, 0.0, 1.0))
            at = _newton(now, found.unknowns, found.kappa, atol, parts > MOST_BRACKETED)
            return _Found(at.trial, at.kappa, at.error, at.marches + found.marches)

        return closer

    def unsolved(carry):
        found, parts = carry
        return (found.error > atol) & (parts <= MOST_PARTS)

    def again(carry):
        found, parts = carry
        first = untried._replace(marches=found.marches)
        return jax.lax.fori_loop(0, jnp.where(speedy, 2 * parts, parts), by_way_of(parts), first), parts * 4

    kappa = case.memory.kappa
    one = jnp.ones_like(case.tip_moment)
    untried = _Found(case.memory.unknowns, kappa, one * jnp.inf, jnp.asarray(0))
    return jax.lax.while_loop(unsolved, again, (untried, jnp.asarray(1)))[0]


@eqx.filter_custom_jvp
def _solve(inputs) -> Solved:
    case, atol = inputs
    found = _search(case, atol)
    memory, state = _described(case, found.unknowns, found.kappa)[1]
    return Solved(memory, state, found.error, found.marches)


@_solve.def_jvp
def _solve_jvp(primals, tangents):
    """Of the march, closed at the tip by the implicit function theorem in what is unknown at the base."""
    case, atol = primals[0]
    case_dot = tangents[0][0]
    found = _search(case, atol)
    moving, fixed = split_tangents(case, case_dot)

    def at(moving, flat):
        return _described(eqx.combine(moving, fixed), flat, found.kappa)

    # One linearisation for all directions: where nothing slips the laws have a kink, and two of them might
    # be of different sides.
    (_, out), linear = jax.linearize(at, moving, found.unknowns)
    zero, still = jnp.zeros_like(found.unknowns), jtu.tree_map(jnp.zeros_like, moving)
    left_dot, out_dot = linear(case_dot, zero)
    by_unknowns, out_by = jax.vmap(lambda d: linear(still, d), out_axes=-1)(jnp.eye(zero.shape[0]))
    scales = _scales(case)
    scaled = by_unknowns / scales[:, None] * scales[None, :]
    flat_dot = -times(inverse_of(scaled), left_dot / scales) * scales
    out_dot = jtu.tree_map(lambda d, by: d + by @ flat_dot, out_dot, out_by)
    memory, state = out
    solved = Solved(memory, state, found.error, found.marches)
    zeros = jax.custom_derivatives.zero_from_primal(solved, symbolic_zeros=True)
    memory_dot, state_dot = out_dot
    return solved, zeros._replace(memory=memory_dot, state=state_dot)


def slip_step(case: Case, load: Load, memory: Memory, atol: float) -> Solved:
    """Solve one load step; differentiable in everything, through any number of steps.

    Args:
        case: the robot; its load and memory are replaced.
        load: the load; a base tension below zero counts as slack.
        memory: what is left of the step before.
        atol: largest error at which the search stops.
    """
    slack = jnp.where(load.T_base < 0.0, 0.0, load.T_base)  # not maximum: its derivative at 0 is one half
    load = dataclasses.replace(load, T_base=slack)
    return _solve((dataclasses.replace(case, load=load, memory=memory), atol))


def _where(holds: Bool[Array, ""], this, that):
    return jtu.tree_map(lambda a, b: jnp.where(holds, a, b), this, that)


def untouched(s: Sections, state: State, preload: Float[Array, "*tendons N"]) -> Memory:
    """What a robot remembers that was never pulled, from its state without load."""
    tension = node_first(preload)
    none, at_base = jnp.zeros_like(tension), tension[0]
    moment = state.moment[0]
    return Memory(
        tension=tension,
        slip=none,
        middle=none,
        speed=none,
        mobilised=none,
        stencil=none,
        elements=jnp.zeros((tension.shape[0], ELEMENTS, *at_base.shape)),
        bent={kind: jnp.zeros((tension.shape[0], term.remembers)) for kind, term in BENDING.items()},
        kappa=state.kappa,
        entry=at_base,
        T_tip=at_base,
        T_base=jnp.zeros_like(at_base),
        unknowns=Closing(jnp.zeros_like(at_base), moment, jnp.zeros_like(moment)).flat(),
    )
