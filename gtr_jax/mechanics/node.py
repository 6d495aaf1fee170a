"""The equations of a node, which give its curvature from the state at its predecessors.

Given the tension, the angle, the external moment and, where a law needs it, the slip at the preceding node,
everything at a node follows from its curvature. One scalar equation remains, the balance of moments

    kappa - kappa_0 + (bending laws) = (sum of T b(kappa) + M_ext)/EI,     b = R (1 - R kappa)/nu.

Friction holds a tendon by one of three laws.

*Held* against the base: T = clip(T_before, P, Q), where T_before is the tension after the previous step, and
P and Q are the tensions if the whole tendon slipped towards the base or towards the tip. Where a stop or
creep of the body bends the held stretch, it is *carried along*: (1 + level) T_before replaces T_before, with
the level at which the channel there is as long as the tendon in it (docs/mechanics.md).

*Creeping*, where friction goes on changing while the tendon is locked: the same, with P and Q computed from
the tension at the preceding node.

*Presliding*: friction follows the slip, u(s) = u(0) - integral over [0, s] of (nu_0 - nu + nu_0
strain), T' = -mu z(u) T |psi'|.
"""

from __future__ import annotations

import functools
import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..terms import REGISTRY, is_on
from ..terms.term import STILL, Bent, Channel
from . import channel
from .case import Case
from .mesh import STENCIL, Interval
from .offset import Offset
from .sections import State, at_tendons, moment_slope, node_first, offset_before, over_tendons
from .structure import PRESLIDING, carried, mobilise

FLOOR = 1e-4  # of the length: least presliding length of several tendons with terms
FRICTION = ("friction", "by_pressure", "by_speed", "drag", "wrap")  # hooks that change an interval's friction
HIGHEST = 10.0  # times the largest known tension: upper limit while the slip is only a guess
Asked = Any  # an array, or None where no law of the structure needs it
RIGID = 1e-6  # 1/N, strain per tension of a tendon whose stretch no term states: almost rigid


class Modes(NamedTuple):
    """Which law holds the tendon: `by_slip` presliding, `neighbour` creeping, neither of them held against
    the base; and whether a held stretch is `carried` along. Plain False where the structure rules it out.
    """

    by_slip: Bool[Array, ""] | bool
    neighbour: Bool[Array, ""] | bool
    carried: Bool[Array, ""] | bool


class Row(NamedTuple):
    """What a node's equations need, nodes along the first axis; None where no law needs it."""

    R: Offset
    R_before: Offset
    compliance: Float[Array, " N"]
    rest: Float[Array, " N"]
    force: Asked
    weights: Float[Array, "N 4"]
    interval: Interval
    metric: Asked
    mu: Asked
    tension: Float[Array, "N *tendons"]
    middle: Asked
    stencil: Asked
    elements: Asked
    bent: dict[str, Float[Array, "N _"]]
    kappa: Asked
    nu: Asked


class Held(NamedTuple):
    """What a march accumulates along the stretch that friction holds.

    Attributes:
        longer: growth of the channel there since the previous step, minus that of the tendon in it [m].
        length: of the midline of the held stretch [m].
        change: growth as in `longer`, at the last node, per length of midline [-].
        margin: distance of the held tension from the nearer limit of friction at the last node [N]; negative
            where the tendon slips.
        share: held tension at the last node, over the tension there after the previous step [-].
    """

    longer: Float[Array, ""]
    length: Float[Array, ""]
    change: Float[Array, ""]
    margin: Float[Array, ""]
    share: Float[Array, ""]


class Carry(NamedTuple):
    """What a node's equations need of its predecessors, latest first where a stencil needs several."""

    kappas: tuple
    drawn: tuple
    slopes: tuple
    ways: tuple
    phi: Float[Array, ""]
    tension: Float[Array, "*tendons"]
    pulled: Asked
    released: Asked
    slip: Asked
    moment: Float[Array, ""]
    place: Asked
    held: Held | None


class Node(NamedTuple):
    """What a march leaves at each node; None where no law needs it."""

    state: State
    tension: Float[Array, "N *tendons"]
    slip: Asked
    middle: Asked
    speed: Asked
    mobilised: Asked
    stencil: Asked
    elements: Asked
    bent: dict[str, Float[Array, "N _"]]


def clip(value, low, high):
    """In place of jnp.clip: where the bounds coincide, derivatives must follow the bound that is met."""
    return jnp.where(value <= low, low, jnp.where(value >= high, high, value))


def product(case: Case, name: str, *args) -> Any:
    """Product of the factors of all terms that have the hook `name`; 1.0 without any."""
    factors = [hook(case.terms[kind], *args) for kind, hook in case.structure.hooks(name)]
    return functools.reduce(operator.mul, factors) if factors else 1.0


def total(case: Case, name: str, *args) -> Any:
    """Sum of the additions of all terms that have the hook `name`; 0.0 without any."""
    added = [hook(case.terms[kind], *args) for kind, hook in case.structure.hooks(name)]
    return functools.reduce(operator.add, added) if added else 0.0


class Equations(eqx.Module):
    """The equations of a node, given a case and what is unknown at its base.

    Attributes:
        case: the load step.
        stop: force of the stop on the tip [N].
        stop_angle: direction in which the tip runs into the stop [rad].
        level: relative rise of the tension of the held stretch [-].
        modes: which law holds the tendon.
        presliding: numbers of the presliding law.
        highest: upper limit of the tension while the slip is a guess [N].
    """

    case: Case
    stop: Asked
    stop_angle: Asked
    level: Asked
    modes: Modes
    presliding: Asked
    highest: Asked

    def passed(self, tension, sense, turn, speed, row: Row):
        """Tension past an interval whose friction is mobilised to `sense`, in [-1, 1]."""
        case, length = self.case, row.interval.length
        wrap = turn * product(case, "wrap", tension)
        mu = case.mu
        if row.mu is not None:
            pulling, releasing = row.mu
            mu = jnp.where(sense >= 0, pulling, releasing)
        if case.structure.has("by_pressure"):
            there = length > 0
            pressure = tension * wrap / jnp.where(there, length, 1.0)
            mu = mu * jnp.where(there, product(case, "by_pressure", pressure), 1.0)
        held = sense * mu
        if case.structure.has("by_speed"):
            # The coefficient depends on the magnitude of the slip speed v. The branch of |v| on which the
            # tendon slips opposite to `sense` has to be approached from the other branch (`Case.against`).
            fast = jnp.where(speed * sense >= -STILL, speed, -case.against * speed)
            fast = jnp.where(self.modes.by_slip, speed, fast)
            held = held + total(case, "by_speed", fast)
        left = tension * jnp.exp(-held * wrap)
        if case.structure.has("drag"):
            left = left - sense * total(case, "drag") * length
            left = jnp.where(left > 0, left, 0.0)
        return left if self.highest is None else jnp.where(left < self.highest, left, self.highest)

    def __call__(self, carry: Carry, row: Row, kappa) -> tuple[Array, Carry, Node]:
        """Residual of the moment balance at a curvature [1/m], the carry to the next node, and the node's
        outputs.
        """
        case, what, w = self.case, self.case.structure, row.weights
        by_slip, neighbour, _ = self.modes

        def increment(now, before):
            return w[0] * now + w[1] * before[0] + w[2] * before[1] + w[3] * before[2]

        def later(now, before):
            return (now, *before[: STENCIL - 2])

        turn = increment(kappa, carry.kappas)
        phi = carry.phi + turn
        midline = at_tendons((turn, kappa, carry.kappas[0]), row.R)
        between = at_tendons(row.interval, row.R)
        wrap = channel.wrap_increment(*midline, row.R, row.R_before, between)
        gripped: Asked = wrap
        compact: Asked = None
        if what.creeping:
            trapezoid = at_tendons(0.5 * row.interval.length * (kappa + carry.kappas[0]), row.R)
            compact = channel.wrap_increment(trapezoid, *midline[1:], row.R, row.R_before, between)
            # Not from slack: no held tension is there that the wider stencil could disturb, and the first
            # pull may be long.
            lags = jnp.logical_and(neighbour, jnp.logical_not(by_slip)) & (row.tension > 0)
            gripped = jnp.where(lags, compact + row.stencil, wrap)

        known: Asked = None
        shortened: Asked = None
        middle: Asked = None
        speed: Asked = None
        z: Asked = None
        elements = row.elements
        if what.follows_slip:
            # First the slip without the tendon's strain at this node, which is added below, once its tension
            # is known.
            shortened = row.metric - channel.metric_factor(midline[1], row.R)
            known = carry.slip - w[1] * carry.drawn[0] - w[2] * carry.drawn[1] - w[3] * carry.drawn[2]
            # The strain at this node is taken at the preceding node's tension: a second-order error.
            near = known - w[0] * self.strained(shortened, carry.tension, row)
            middle = 0.5 * (carry.slip + near)
            speed = (middle - row.middle) / case.load.dt
            if what.presliding:
                z, elements = mobilise(self.presliding, middle - row.middle, row.elements)

        def behind(sense, bound):
            """Tension past the interval if friction is mobilised to `sense`."""
            tension = carry.tension if bound is None else bound
            if what.creeping or what.presliding:
                tension = jnp.where(jnp.logical_or(by_slip, neighbour), carry.tension, tension)
            if what.presliding:
                sense = jnp.where(by_slip, z, sense)
            return self.passed(tension, sense, gripped, speed, row)

        grip: Asked = None
        stencil: Asked = row.stencil
        if by_slip is True:
            low = high = tension = self.passed(carry.tension, z, gripped, speed, row)
            grip = z
        else:
            low, high = self.bounds(behind, gripped, carry)
            kept = row.tension if self.level is None else (1.0 + self.level) * self.remembered(row)
            tension = clip(kept, low, high)
            if what.terms:
                grip = jnp.where(tension <= low, 1.0, jnp.where(tension >= high, -1.0, 0.0))
            if what.creeping:
                stencil = jnp.where(grip == 0.0, row.stencil, wrap - compact)
            if what.presliding:
                tension, grip = jnp.where(by_slip, low, tension), jnp.where(by_slip, z, grip)
        drawn, slip = carry.drawn, None
        if what.follows_slip:
            now = self.strained(shortened, tension, row)
            drawn, slip = later(now, carry.drawn), known - w[0] * now

        moment, slopes, ways, place = carry.moment, carry.slopes, carry.ways, carry.place
        if what.bends:
            force_x, force_y = row.force
            if what.has_stop:
                angle = self.stop_angle
                force_x, force_y = force_x - self.stop * jnp.cos(angle), force_y - self.stop * jnp.sin(angle)
                way = jnp.cos(phi - angle)
                place, ways = carry.place + increment(way, carry.ways), later(way, carry.ways)
            slope = moment_slope(phi, force_x, force_y)
            moment, slopes = carry.moment + increment(slope, carry.slopes), later(slope, carry.slopes)

        held = None
        if what.carries:
            assert carry.held is not None
            margin = jnp.minimum(kept - low, high - kept)
            held = self.held(carry.held, row, midline[1], tension, kept, margin)

        bent, more = {}, 0.0
        for kind, bend in what.hooks("bend"):
            at = Bent(row.rest, row.kappa, row.bent[kind], case.load.dt)
            extra, bent[kind] = bend(case.terms[kind], kappa, at)
            more = more + extra
        pulls = over_tendons(tension * channel.moment_arm(midline[1], row.R), 0)
        error = kappa - row.rest - row.compliance * (pulls + moment)
        error = error + more if bent else error

        new = Carry(
            kappas=later(kappa, carry.kappas),
            drawn=drawn,
            slopes=slopes,
            ways=ways,
            phi=phi,
            tension=tension,
            pulled=None if carry.pulled is None else low,
            released=None if carry.released is None else high,
            slip=slip,
            moment=moment,
            place=place,
            held=held,
        )
        state = State(kappa, phi, wrap, moment)
        return error, new, Node(state, tension, slip, middle, speed, grip, stencil, elements, bent)

    def bounds(self, behind, turn, carry: Carry):
        """Tension past the interval if the whole tendon slipped towards the base, and towards the tip."""
        what = self.case.structure
        if any(what.has(hook) for hook in FRICTION) or what.creeping or what.presliding:
            return behind(1.0, carry.pulled), behind(-1.0, carry.released)
        left = jnp.exp(-self.case.mu * turn)
        return carry.pulled * left, carry.released / left

    def remembered(self, row: Row):
        """Tension after the previous step [N]. Where the body relaxes, the tension that keeps its bend: the
        tendon takes over the moment that the body has lost, less what the tendon's own stretch gives up.
        """
        case, lost = self.case, 0.0
        for kind, bend in case.structure.hooks("bend"):
            if REGISTRY[kind].relaxes:
                at = Bent(row.rest, row.kappa, row.bent[kind], case.load.dt)
                lost = lost + row.bent[kind][0] - bend(case.terms[kind], row.kappa, at)[0]
        arm = channel.moment_arm(at_tendons(row.kappa, row.R), row.R)
        gives = self.strain(row.tension + 1.0, row.tension)
        return row.tension - arm * lost / (gives + row.compliance * arm**2)

    def strain(self, tension, before):
        """Change of the tendon's strain from the tension `before` to `tension` [N]; almost zero where no term
        states it.
        """
        return RIGID * (tension - before) + self.stated(tension, before)

    def stated(self, tension, before):
        """The part of this change that terms state; 0.0 without any."""
        return total(self.case, "strain", tension) - total(self.case, "strain", before)

    def held(self, before: Held, row: Row, kappa, tension, kept, margin) -> Held:
        """The held stretch up to this node. Where only one end of an interval is held, the interval counts as
        far as the margin, interpolated linearly between its ends, stays positive.
        """
        margin = jnp.where(self.modes.carried, margin, -1.0)
        change = channel.metric_factor(kappa, row.R) - (1.0 + self.strain(tension, row.tension)) * row.nu
        span = jnp.abs(margin) + jnp.abs(before.margin)
        each = row.interval.length / jnp.where(span > 0, span, 1.0)
        here, there = (each * jnp.where(m > 0, m, 0.0) for m in (margin, before.margin))
        longer = before.longer + here * change + there * before.change
        share = jnp.where(row.tension > 0, kept / jnp.where(row.tension > 0, row.tension, 1.0), 1.0)
        return Held(longer, before.length + here + there, change, margin, share)

    def strained(self, shortened, tension, row: Row):
        """The channel's loss of length plus the tendon's gain by strain, per length of midline."""
        if not self.case.structure.has("strain"):
            return shortened
        return shortened + self.stated(tension, self.case.preload) * row.metric


def prepared(case: Case, x) -> tuple[Equations, Carry, Row]:
    """The node equations, their carry at the base, and their rows.

    Args:
        case: the load step.
        x: the unknowns at the base, a `march.Closing`.
    """
    s, memory, load, what = case.sections, case.memory, case.load, case.structure
    terms, mesh, R = case.terms, s.mesh, node_first(s.R)
    by_slip, neighbour, presliding = False, False, None
    if what.presliding:
        presliding = terms[PRESLIDING]
        by_slip = True
        if case.mu.ndim:
            least = FLOOR * mesh.s[-1]
            length = presliding["length"]
            presliding = presliding | {"length": jnp.where(length > least, length, least)}
        elif not (what.acting and PRESLIDING in what.terms):
            by_slip = is_on(REGISTRY[PRESLIDING], presliding)
    creeping = [kind for kind in what.terms if REGISTRY[kind].creeps]
    neighbour, along = (_any_on(case, kinds) for kinds in (creeping, carried(what.terms)))
    if what.carries:
        along = jnp.logical_and(along, jnp.logical_not(jnp.logical_or(by_slip, neighbour)))

    row = Row(
        R=R,
        R_before=node_first(offset_before(s.R)),
        compliance=s.compliance,
        rest=s.rest,
        force=(s.force_x, s.force_y) if what.bends else None,
        weights=mesh.weights,
        interval=mesh.interval,
        metric=case.metric if what.follows_slip else None,
        mu=(friction(case, 1.0), friction(case, -1.0)) if what.has("friction") else None,
        tension=memory.tension,
        middle=memory.middle,
        stencil=memory.stencil,
        elements=memory.elements,
        bent=memory.bent,
        kappa=memory.kappa if what.has("bend") or what.carries else None,
        nu=node_first(channel.metric_factor(at_tendons(memory.kappa, s.R), s.R)) if what.carries else None,
    )
    low = high = entry = load.T_base
    if what.has("base_grip"):
        base_grip = total(case, "base_grip")
        low, high = load.T_base * jnp.exp(-base_grip), load.T_base * jnp.exp(base_grip)
        entry = clip(memory.entry, low, high)
    zero, none = jnp.zeros_like(case.tip_moment), jnp.zeros_like(case.mu)
    back = STENCIL - 1
    local = what.presliding and bool(case.mu.ndim)  # only the preceding node's tension counts
    carry = Carry(
        kappas=(zero,) * back,
        drawn=(none,) * back if what.follows_slip else (),
        slopes=(zero,) * back if what.bends else (),
        ways=(zero,) * back if what.has_stop else (),
        phi=zero,
        tension=entry,
        pulled=None if local else low,
        released=None if local else high,
        slip=x.slip if what.follows_slip else None,
        moment=x.moment,
        place=zero if what.has_stop else None,
        held=Held(zero, zero, zero, zero - 1.0, zero + 1.0) if what.carries else None,
    )
    highest = None
    if what.seeks_slip:
        # While the guess of the slip is too low, its speed may raise the tension without bound.
        highest = HIGHEST * jnp.maximum(jnp.max(load.T_base), jnp.max(memory.tension))
        highest = jax.lax.stop_gradient(highest)
    stop = angle = None
    if what.has_stop:
        ((kind, find),) = what.hooks("stop_angle")
        stop, angle = pressing(x.stop), find(terms[kind])
    return (
        Equations(case, stop, angle, x.level, Modes(by_slip, neighbour, along), presliding, highest),
        carry,
        row,
    )


def friction(case: Case, sense: float):
    """Friction coefficient of the intervals for slip towards the base (`sense` 1) or the tip (-1), (N,
    *tendons).
    """
    mesh, memory, load = case.sections.mesh, case.memory, case.load
    over = (-1, *[1] * case.mu.ndim)
    start = (mesh.s - mesh.interval.length).reshape(over)
    speed = jnp.zeros(()) if memory.speed is None else jnp.abs(memory.speed)
    at = Channel(start, mesh.s.reshape(over), speed, sense, load.time, load.cycle)
    factor = jnp.broadcast_to(product(case, "friction", at), memory.tension.shape)
    factor = jnp.where(factor > 0, factor, 0.0)  # friction that wears or drifts below zero counts as zero
    return jnp.broadcast_to(case.mu, memory.tension.shape) * factor


def _any_on(case: Case, kinds: list[str]) -> Bool[Array, ""] | bool:
    """Whether any of these terms acts; known without their numbers if all terms of the program act."""
    if not kinds or case.structure.acting:
        return bool(kinds)
    on = [is_on(REGISTRY[kind], case.terms[kind]) for kind in kinds]
    return functools.reduce(jnp.logical_or, on)


def pressing(stop: Float[Array, ""]) -> Float[Array, ""]:
    """Force of the stop [N] from its unknown: the unknown itself where positive. A negative unknown is the
    distance from the stop, scaled so that the residual at the tip has about the same slope on both sides of
    contact. Newton's method would otherwise jump between contact and none.
    """
    return jnp.where(stop > 0, stop, 0.0)
