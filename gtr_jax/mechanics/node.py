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
the tension at the preceding node. Where friction grows with the speed, and the tendon is predicted to slip on
after its base tension has turned back (`sliding`), T is P or Q, whatever it was before.

*Presliding*: friction follows the slip, u(s) = u(0) - integral over [0, s] of (nu_0 - nu + nu_0
strain), T' = -mu z(u) T |psi'|.

Tendons that share a body in the plane follow the slip too; there xi of each interval gives z and u (`grip`).
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float

from ..terms import called, is_on
from ..terms.term import STILL, Bent, Channel, Passing
from .bodies import geometry_of, metric_of
from .case import Case, Grip, Sliding
from .coulomb import PRESLIDING as SHORTEST
from .coulomb import STRETCH, mobilisation, slip_of_law, unit_tension
from .geometry import Geometry
from .guides import Strung, corner, direction_of, either, entering, offset_on
from .loop_lanes import in_lanes_of
from .mesh import STENCIL, Interval
from .offset import Offset, SpatialOffset
from .program_spec import PRESLIDING, carried, mobilise
from .sections import State, either_of, node_first
from .vector import Vector, applied, columns_of

FRICTION = ("friction", "by_pressure", "by_speed", "drag", "wrap")  # hooks that change an interval's friction
HIGHEST = 10.0  # times the largest known tension: upper limit while the slip is only a guess
Asked = Any  # an array, or None where no law of the structure needs it
# Change of the slip, as a share of the shortest presliding, at which it is found from xi, and the most steps.
SEARCHED, MOST_SEARCHED = 1e-9, 60
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

    R: Offset | SpatialOffset
    R_before: Offset | SpatialOffset
    compliance: Any
    rest: Any
    force: Asked
    weights: Float[Array, "N 4"]
    rates: Asked
    interval: Interval
    metric: Asked
    mu: Asked
    channel: Channel | None
    tension: Float[Array, "N *tendons"]
    middle: Asked
    stencil: Asked
    elements: Asked
    bent: dict[str, Float[Array, "N _"]]
    kappa: Asked
    nu: Asked
    begins: Asked
    chord: Asked
    reach: Asked
    place: Asked
    shift: Asked
    closing: Asked
    beyond: Asked
    sliding: Asked
    grip: Asked


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
    phi: Any
    tension: Float[Array, "*tendons"]
    pulled: Asked
    released: Asked
    slip: Asked
    moment: Any
    place: Asked
    held: Held | None
    strung: Strung | None


class Turned(NamedTuple):
    """State of a node, as of `State`; in space by components, which `joined_state` joins."""

    kappa: Any
    phi: Any
    wrap: Float[Array, "*tendons"]
    moment: Any


def joined_state(geometry: Geometry, at: Turned) -> State:
    """The arrays of a state."""
    kappa, moment = geometry.join(at.kappa), geometry.join(at.moment)
    return State(kappa, geometry.join_direction(at.phi), at.wrap, moment)


class Node(NamedTuple):
    """What a march leaves at each node; None where no law needs it. Inside it the state is `Turned`."""

    state: Any
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
    factors = _given(case, name, 1.0, args)
    return functools.reduce(operator.mul, factors) if factors else 1.0


def total(case: Case, name: str, *args) -> Any:
    """Sum of the additions of all terms that have the hook `name`; 0.0 without any."""
    added = _given(case, name, 0.0, args)
    return functools.reduce(operator.add, added) if added else 0.0


def _given(case: Case, name: str, neutral: float, args: tuple) -> list[Any]:
    """What the terms give that have the hook `name`."""
    laws = {
        kind: functools.partial(called, hook, case.terms[kind], *args)
        for kind, hook in case.structure.hooks(name)
    }
    return _alike([_where_on(case, kind, neutral, law) for kind, law in laws.items()])


def _where_on(case: Case, kind: str, neutral: float, law: Callable[[], Any]) -> Any:
    """What the law of a term gives. Where programs skip, a term that does not act gives the neutral number,
    and its law is not computed.
    """
    if not case.structure.skips:
        return law()
    none = jtu.tree_map(lambda leaf: jnp.full(leaf.shape, neutral, leaf.dtype), jax.eval_shape(law))
    return jax.lax.cond(is_on(case.structure.catalogue[kind], case.terms[kind]), law, lambda: none)


def _alike(values: list[Any]) -> list[Any]:
    """Values of one shape, but for scalars; some may be one number for each tendon."""
    shapes = {jnp.shape(value) for value in values} - {()}
    if len(shapes) < 2:
        return values
    shape = jnp.broadcast_shapes(*shapes)
    return [jnp.broadcast_to(value, shape) if jnp.ndim(value) else value for value in values]


def _as_told(told: Sliding, by_slip, kept, low, high):
    """The tension [N] that friction keeps, or to which slip takes it between its bounds."""
    confidence = jnp.where(by_slip, 0.0, told.confidence)
    start = clip(kept, low, high)
    low, high = (jnp.where(confidence > 0, bound, start) for bound in (low, high))
    # Friction adds up in the logarithm of the tension.
    apart = jnp.log(jnp.where(low > 0, high, 1.0) / jnp.where(low > 0, low, 1.0))
    share = 0.5 * (1.0 - told.way)
    slips = jnp.where(low > 0, low * jnp.exp(share * apart), 0.0)
    slips = jnp.where(share <= 0, low, jnp.where(share >= 1, high, slips))
    return jnp.where(
        confidence <= 0, kept, jnp.where(confidence < 1, start + confidence * (slips - start), slips)
    )


class Equations(eqx.Module):
    """The equations of a node, given a case and what is unknown at its base.

    Attributes:
        case: the load step.
        stop: force of the stop on the tip [N].
        stop_way: direction in which the tip runs into the stop, of `Geometry.way_of`.
        level: relative rise of the tension of the held stretch [-].
        modes: which law holds the tendon.
        presliding: numbers of the presliding law.
        highest: upper limit of the tension while the slip is a guess [N].
        gives: strain per tension that tendons which share their slip have at least [1/N].
    """

    case: Case
    stop: Asked
    stop_way: Asked
    level: Asked
    modes: Modes
    presliding: Asked
    highest: Asked
    gives: Asked

    @property
    def geometry(self) -> Geometry:
        """That of the robot."""
        return geometry_of(self.case.sections)

    def passed(self, tension, sense, turn, speed, row: Row):
        """Tension past an interval whose friction is mobilised to `sense`, in [-1, 1]."""
        case, length = self.case, row.interval.length
        wrap = turn * product(case, "wrap", tension)
        mu = case.mu
        if row.mu is not None:
            pulling, releasing = row.mu
            mu = jnp.where(sense >= 0, pulling, releasing)
        there = length > 0
        pressure = tension * wrap / jnp.where(there, length, 1.0)
        channel = None if row.channel is None else row.channel._replace(sense=sense)
        passing = Passing(pressure, tension, channel)
        if case.structure.has("by_pressure"):
            mu = mu * jnp.where(there, product(case, "by_pressure", passing), 1.0)
        held = sense * mu
        if case.structure.has("by_speed"):
            # The coefficient depends on the magnitude of the slip speed v. The branch of |v| on which the
            # tendon slips opposite to `sense` has to be approached from the other branch (`Case.against`),
            # unless the way it slips is predicted.
            fast = jnp.where(speed * sense >= -STILL, speed, -case.against * speed)
            known = (
                self.modes.by_slip
                if row.sliding is None
                else self.modes.by_slip | (row.sliding.confidence > 0)
            )
            fast = jnp.where(known, speed, fast)
            held = held + total(case, "by_speed", fast)
        left = tension * jnp.exp(-held * wrap)
        if case.structure.has("drag"):
            left = left - sense * total(case, "drag", passing) * length
            left = jnp.where(left > 0, left, 0.0)
        return left if self.highest is None else jnp.where(left < self.highest, left, self.highest)

    def __call__(self, carry: Carry, row: Row, kappa) -> tuple[Any, Carry, Node]:
        """Residual of the moment balance at a curvature [1/m], the carry to the next node, and the node's
        outputs.
        """
        case, what, w = self.case, self.case.structure, row.weights
        by_slip, neighbour, _ = self.modes

        def increment(now, before):
            return w[0] * now + w[1] * before[0] + w[2] * before[1] + w[3] * before[2]

        def later(now, before):
            return (now, *before[: STENCIL - 2])

        geometry, before, between = self.geometry, carry.kappas[0], row.interval
        turn = geometry.turn(increment(kappa, carry.kappas), kappa, before, between.length)
        phi = geometry.onward(carry.phi, turn)
        rates: Asked = None
        if row.rates is not None:
            nearest = (kappa, *carry.kappas)
            rates = [sum(row.rates[end, j] * u for j, u in enumerate(nearest)) for end in (0, 1)]
        wrap = geometry.wrap(turn, kappa, before, rates, row.R, row.R_before, between)
        own, strung, corners = row, None, wrap
        if case.sections.guides is not None:
            assert carry.strung is not None
            line = self.onward(row, kappa, geometry.line(phi))
            place = carry.strung.place + increment(line, carry.strung.lines)
            strung, corners, offset = self.strung(carry.strung, row, kappa, phi, place)
            strung = strung._replace(lines=later(line, carry.strung.lines))
            row = row._replace(R=offset)
            wrap = either(case.sections.guides.held, corners, wrap)
        gripped: Asked = wrap
        compact: Asked = None
        if what.creeping:
            trapezoid = geometry.turn(0.5 * between.length * (kappa + before), kappa, before, between.length)
            compact = geometry.wrap(trapezoid, kappa, before, rates, own.R, own.R_before, between)
            if case.sections.guides is not None:
                compact = either(case.sections.guides.held, corners, compact)
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
        if what.shares_slip:
            z, elements = row.grip.mobilised, row.grip.elements
            middle, speed = row.middle + row.grip.slipped, row.grip.slipped / case.load.dt
        elif what.follows_slip:
            # First the slip without the tendon's strain at this node, which is added below, once its tension
            # is known.
            shortened = row.metric - self.metric(row, kappa)
            known = carry.slip - w[1] * carry.drawn[0] - w[2] * carry.drawn[1] - w[3] * carry.drawn[2]
            # The strain at this node is taken at the preceding node's tension: a second-order error.
            near = known - w[0] * self.strained(shortened, carry.tension, row)
            middle = 0.5 * (carry.slip + near)
            speed = (middle - row.middle) / case.load.dt
            if what.presliding:
                slipped = middle - row.middle
                z, elements = called(mobilise, self.presliding, slipped, row.elements)

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
            if row.sliding is not None:
                kept = _as_told(row.sliding, by_slip, kept, low, high)
            tension = clip(kept, low, high)
            if what.terms:
                grip = jnp.where(tension <= low, 1.0, jnp.where(tension >= high, -1.0, 0.0))
            if what.creeping:
                slides = 0.0 if row.sliding is None else row.sliding.confidence
                fresh = wrap - compact
                stencil = jnp.where(grip == 0.0, row.stencil + slides * (fresh - row.stencil), fresh)
            if what.presliding:
                tension, grip = jnp.where(by_slip, low, tension), jnp.where(by_slip, z, grip)
        drawn, slip = carry.drawn, None
        if what.follows_slip and not what.shares_slip:
            now = self.strained(shortened, tension, row)
            drawn, slip = later(now, carry.drawn), known - w[0] * now

        moment, slopes, ways, place = carry.moment, carry.slopes, carry.ways, carry.place
        if what.bends:
            force = row.force
            if what.has_stop:
                towards = geometry.components(self.stop_way)
                force = tuple(f - self.stop * c for f, c in zip(force, towards, strict=True))
                way = self.onward(row, kappa, geometry.advance(phi, self.stop_way))
                place, ways = carry.place + increment(way, carry.ways), later(way, carry.ways)
            slope = self.onward(row, kappa, geometry.moment_slope(phi, force))
            moment, slopes = carry.moment + increment(slope, carry.slopes), later(slope, carry.slopes)

        held = None
        if what.carries:
            assert carry.held is not None
            margin = jnp.minimum(kept - low, high - kept)
            held = self.held(carry.held, row, kappa, tension, kept, margin)

        more, bent = self.bending(row, kappa)
        acting = tension if row.beyond is None else jnp.where(row.beyond, 0.0, tension)
        pulls = geometry.pull(acting, kappa, row.R)
        if what.bends:
            pulls = geometry.pushed(pulls, phi, force, row.shift)
        if what.bends or not what.space:  # in space, a moment that acts makes the external moment unknown
            pulls = pulls + geometry.felt(phi, moment)
        error = kappa - row.rest - row.compliance * pulls
        error = error if isinstance(more, float) else error + more
        bent = {kind: geometry.join(kept) for kind, kept in bent.items()}

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
            strung=strung,
        )
        state = Turned(kappa, phi, wrap, moment)
        return error, new, Node(state, tension, slip, middle, speed, grip, stencil, elements, bent)

    def bounds(self, behind, turn, carry: Carry):
        """Tension past the interval if the whole tendon slipped towards the base, and towards the tip."""
        what = self.case.structure
        if any(what.has(hook) for hook in FRICTION) or what.creeping or what.presliding:
            return behind(1.0, carry.pulled), behind(-1.0, carry.released)
        left = jnp.exp(-self.case.mu * turn)
        return carry.pulled * left, carry.released / left

    def onward(self, row: Row, kappa, each):
        """What there is of something for each length of the axis, for each length that it has unbent."""
        stretch = self.geometry.stretch(kappa, row.shift)
        return each if stretch is None else each * stretch

    def metric(self, row: Row, kappa):
        """nu of the tendons, zero past an anchor."""
        nu = self.geometry.metric(kappa, row.R)
        return nu if row.beyond is None else jnp.where(row.beyond, 0.0, nu)

    def bending(self, row: Row, kappa) -> tuple[Any, dict[str, Any]]:
        """What the bending laws add to the moment over EI [1/m], 0.0 without any, and what they remember."""
        added, kept = [], {}
        for kind, _ in self.case.structure.hooks("bend"):
            extra, kept[kind] = self.bends(kind, row, kappa)
            added.append(extra)
        if row.closing is not None:
            added.append(row.closing.moment(kappa))
        return functools.reduce(operator.add, added) if added else 0.0, kept

    def bends(self, kind: str, row: Row, kappa) -> tuple[Any, Any]:
        """One bending law at a strain."""
        kept = self.geometry.split(row.bent[kind])
        at = Bent(row.rest, row.kappa, kept, self.case.load.dt, row.compliance, row.reach, row.place)
        term, values = self.case.structure.catalogue[kind], self.case.terms[kind]
        return _where_on(self.case, kind, 0.0, lambda: self.geometry.bent(term, values, kappa, at))

    def near(self, carry: Carry, row: Row, kappa) -> Any:
        """Derivative of the residual by the strain if nothing but the strain changes over the interval; None
        where the geometry needs none.
        """
        geometry = self.geometry
        slope = geometry.near(row.compliance, self.in_channels(carry.tension), kappa, row.R)
        if slope is None or not self.case.structure.has("bend"):
            return slope
        more = geometry.bending_slope(lambda k: self.bending(row, k)[0], kappa)
        return jtu.tree_map(operator.add, slope, more)

    def strung(self, before: Strung, row: Row, kappa, direction, place):
        """Guided tendons at a node: what the march carries on of them, the corners they turn by there, and
        the offset of all tendons.

        Args:
            before: at the predecessor.
            kappa, direction: strain and direction of the section.
            place: of the midline.
        """
        guides = self.case.sections.guides
        assert guides is not None and isinstance(row.R, SpatialOffset)
        R, inward = row.R, columns_of(direction)
        y, z = R.value[..., 0], R.value[..., 1]
        guide = place + applied(direction, Vector(jnp.zeros_like(y), y, z))
        out = direction_of(row.chord, direction)
        came = either_of(row.interval.joined > 0, before.chord, entering(kappa, R))
        chord, point = either(row.begins, (out, guide), (before.chord, before.point))
        corners = jnp.where(row.begins, corner(came, out), 0.0)
        on = offset_on(applied(inward, point - place), applied(inward, chord), kappa)
        return Strung(place, (), chord, point), corners, either(guides.held, on, R)

    def in_channels(self, tension):
        """Tensions, zero of those tendons that are guided."""
        guides = self.case.sections.guides
        return tension if guides is None else jnp.where(guides.held, 0.0, tension)

    def expected(self, carry: Carry, row: Row):
        """Moment in the axes of the section at a node, about, besides that of tendons in channels [N m]: of
        external loads, and of guided tendons as at the predecessor.
        """
        geometry, guides = self.geometry, self.case.sections.guides
        moment = geometry.felt(carry.phi, carry.moment)
        if guides is None:
            return moment
        assert carry.strung is not None
        place, strain = carry.strung.place, carry.kappas[0]
        _, _, offset = self.strung(carry.strung, row, strain, carry.phi, place)
        return moment + geometry.pull(jnp.where(guides.held, carry.tension, 0.0), strain, offset)

    def remembered(self, row: Row):
        """Tension after the previous step [N]. Where the body relaxes, the tension that keeps its bend: the
        tendon takes over the moment that the body has lost, less what the tendon's own stretch gives up.
        """
        geometry, lost = self.geometry, self.geometry.zero()
        for kind, _ in self.case.structure.hooks("bend"):
            if self.case.structure.catalogue[kind].relaxes:
                first = jtu.tree_map(lambda kept: kept[0], geometry.split(row.bent[kind]))
                lost = lost + first - self.bends(kind, row, row.kappa)[0]
        arm = geometry.pull(jnp.ones_like(row.tension), row.kappa, row.R)
        gives = self.strain(row.tension + 1.0, row.tension)
        return row.tension - geometry.inner(arm, lost) / (gives + geometry.inner(row.compliance, arm * arm))

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
        change = self.metric(row, kappa) - (1.0 + self.strain(tension, row.tension)) * row.nu
        span = jnp.abs(margin) + jnp.abs(before.margin)
        each = row.interval.length / jnp.where(span > 0, span, 1.0)
        here, there = (each * jnp.where(m > 0, m, 0.0) for m in (margin, before.margin))
        longer = before.longer + here * change + there * before.change
        share = jnp.where(row.tension > 0, kept / jnp.where(row.tension > 0, row.tension, 1.0), 1.0)
        return Held(longer, before.length + here + there, change, margin, share)

    def gains(self, row: Row, kappa, tension):
        """What the channel of tendons that share their slip loses of its length in the load step plus what
        they gain by strain, per length of midline.
        """
        before = row.tension
        stated = self.stated(before + 1.0, before)
        more = jnp.where(stated < self.gives, self.gives - stated, 0.0) * (tension - before)
        return row.nu - self.metric(row, kappa) + self.stated(tension, before) * row.metric + more

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
    terms, mesh, geometry = case.terms, s.mesh, geometry_of(s)
    by_slip: Any = what.shares_slip
    presliding: Any = None
    if what.presliding:
        presliding = terms[PRESLIDING]
        by_slip = what.shares_slip or what.acting or is_on(what.catalogue[PRESLIDING], presliding)
    creeping = [kind for kind in what.terms if what.catalogue[kind].creeps]
    neighbour, along = (any_on(case, kinds) for kinds in (creeping, carried(what.terms, what.catalogue)))
    if what.carries:
        along = jnp.logical_and(along, jnp.logical_not(jnp.logical_or(by_slip, neighbour)))

    row = Row(
        R=s.R.rows(),
        R_before=s.R.before().rows(),
        compliance=geometry.split(s.compliance),
        rest=geometry.split(s.rest),
        force=s.force if what.bends else None,
        weights=mesh.weights,
        rates=mesh.rates,
        interval=mesh.interval,
        metric=case.metric if what.follows_slip else None,
        mu=(friction(case, 1.0), friction(case, -1.0)) if what.has("friction") else None,
        channel=channel_rows(case) if what.reads_channel else None,
        tension=memory.tension,
        middle=memory.middle,
        stencil=memory.stencil,
        elements=memory.elements,
        bent=memory.bent,
        kappa=geometry.split(memory.kappa) if what.has("bend") or what.carries else None,
        nu=node_first(metric_of(s, memory.kappa)) if what.carries or what.shares_slip else None,
        begins=None if s.guides is None else node_first(s.guides.begins()),
        chord=None if s.guides is None else jnp.moveaxis(s.guides.along(), -2, 0),
        reach=s.reach if what.by_strain else None,
        place=mesh.s if what.by_place else None,
        shift=s.shift,
        closing=s.closing,
        beyond=None if s.beyond is None else node_first(s.beyond),
        sliding=case.sliding,
        grip=case.grip,
    )
    low = high = entry = load.T_base
    if what.has("base_grip"):
        base_grip = total(case, "base_grip")
        low, high = load.T_base * jnp.exp(-base_grip), load.T_base * jnp.exp(base_grip)
        entry = memory.entry
        if case.sliding is not None:
            entry = _as_told(Sliding(*(told[0] for told in case.sliding)), by_slip, entry, low, high)
        entry = clip(entry, low, high)
    zero, none = jnp.zeros(()), jnp.zeros_like(case.mu)
    back = STENCIL - 1
    local = what.shares_slip  # only the preceding node's tension counts
    carry = Carry(
        kappas=(geometry.unstrained(),) * back,
        drawn=(none,) * back if what.follows_slip and not local else (),
        slopes=(geometry.zero(),) * back if what.bends else (),
        ways=(zero,) * back if what.has_stop else (),
        phi=geometry.start(),
        tension=entry,
        pulled=None if local else low,
        released=None if local else high,
        slip=x.slip if what.follows_slip and not local else None,
        moment=geometry.split(x.moment),
        place=zero if what.has_stop else None,
        held=Held(zero, zero, zero, zero - 1.0, zero + 1.0) if what.carries else None,
        strung=None if s.guides is None else _unstrung(case),
    )
    highest = None
    if what.seeks_slip or local:
        # While the guess of the slip is too low, its speed may raise the tension without bound.
        highest = HIGHEST * jnp.maximum(jnp.max(load.T_base), jnp.max(memory.tension))
        highest = jax.lax.stop_gradient(highest)
    gives = STRETCH / unit_tension(s) if local else None
    stop = way = None
    if what.has_stop:
        ((kind, _),) = what.hooks("stop")
        stop, way = pressing(x.stop), geometry.way_of(what.catalogue[kind], terms[kind])
    return (
        Equations(case, stop, way, x.level, Modes(by_slip, neighbour, along), presliding, highest, gives),
        carry,
        row,
    )


def grip_of(case: Case, xi: Float[Array, "N *tendons"]) -> tuple[Grip, tuple[Any, Any]]:
    """How friction grips tendons that share their slip, in every interval, and the derivatives by xi of the
    slip and of what is mobilised.

    Args:
        case: the load step.
        xi: see `coulomb.mobilisation`.
    """
    length, memory = case.sections.mesh.s[-1], case.memory
    assert memory.mobilised is not None
    slipped, z = length * slip_of_law(xi, memory.mobilised), mobilisation(xi)
    held = jnp.where(jnp.abs(xi) > 1.0, 0.0, 1.0)
    by_xi = (length * (SHORTEST * held + 1.0 - held), held)
    if not case.structure.presliding:
        return Grip(xi, slipped, z, memory.elements), by_xi
    values = case.terms[PRESLIDING]
    on = case.structure.acting or is_on(case.structure.catalogue[PRESLIDING], values)
    assert memory.elements is not None
    least = SHORTEST * length
    values = values | {"length": jnp.where(values["length"] > least, values["length"], least)}
    elements = jnp.moveaxis(memory.elements, 1, 0)

    def law(u):
        """xi at a slip over the length, and what is mobilised there."""
        found = called(mobilise, values, u * length, elements)
        return found[0] + u, found

    # Its slope falls with the slip, so that Newton's method from no slip does not overshoot.
    target = jax.lax.stop_gradient(xi)
    way = jnp.where(target >= memory.mobilised, 1.0, -1.0)

    def nearer(at):
        u, _, steps = at
        value, slope, _ = jax.jvp(law, (u,), (jnp.ones_like(u),), has_aux=True)
        change = (value - target) / slope
        return u - change, jnp.max(jnp.abs(change)), steps + 1

    def far(at):
        return jnp.logical_and(on, at[1] > SEARCHED * SHORTEST) & (at[2] < MOST_SEARCHED)

    begin = (way * 2 * STILL / length, jnp.full_like(length, jnp.inf), jnp.asarray(0))
    u, _, _ = jax.lax.stop_gradient(jax.lax.while_loop(far, nearer, in_lanes_of((*case.varied, xi), begin)))
    value, slope, _ = jax.jvp(law, (u,), (jnp.ones_like(u),), has_aux=True)
    # One step more has the derivatives of the slip by everything.
    slope = jax.lax.stop_gradient(slope)
    u = u - (value - xi) / slope
    _, (there, kept) = law(u)
    found = Grip(xi, length * u, there, jnp.moveaxis(kept, 0, 1))
    grip = either_of(on, found, Grip(xi, slipped, z, memory.elements))
    return grip, either_of(on, (length / slope, 1.0 - 1.0 / slope), by_xi)


def _unstrung(case: Case) -> Strung:
    """What a march carries of guided tendons ahead of the base."""
    none = Vector(*(jnp.zeros_like(case.mu),) * 3)
    ahead = Vector(jnp.ones_like(case.mu), none.y, none.z)
    zero = Vector(*jnp.zeros(3))
    return Strung(zero, (zero,) * (STENCIL - 1), ahead, none)


def friction(case: Case, sense: float):
    """Friction coefficient of the intervals for slip towards the base (`sense` 1) or the tip (-1), (N,
    *tendons).
    """
    mesh, memory, load = case.sections.mesh, case.memory, case.load
    over = (-1, *[1] * case.mu.ndim)
    start = (mesh.s - mesh.interval.length).reshape(over)
    speed, drawn = _speed_before(case), drawn_before(case)
    at = Channel(start, mesh.s.reshape(over), speed, sense, load.time, load.cycle, drawn)
    factor = jnp.broadcast_to(product(case, "friction", at), memory.tension.shape)
    factor = jnp.where(factor > 0, factor, 0.0)  # friction that wears or drifts below zero counts as zero
    return jnp.broadcast_to(case.mu, memory.tension.shape) * factor


def _speed_before(case: Case):
    """Speed of the slip in the previous load step [m/s], (N, *tendons); zero, (), where it is not known."""
    speed = case.memory.speed
    return jnp.zeros(()) if speed is None else jnp.abs(speed)


def rise_per_newton(case: Case, name: str, tension):
    """Change of the sum of the terms' hook `name` with the tension [N], per newton."""
    return total(case, name, tension + 1.0) - total(case, name, tension)


def drawn_before(case: Case):
    """How far the tendons were drawn out at the base after the previous load step [m], (*tendons,); zero, (),
    where no law depends on it.
    """
    slip = case.memory.slip
    return jnp.zeros(()) if slip is None or not case.structure.reads_drawn else slip[0]


def channel_rows(case: Case) -> Channel:
    """The intervals of the channel, nodes along the first axis."""
    mesh, load, shape = case.sections.mesh, case.load, case.memory.tension.shape
    speed, drawn = (jnp.broadcast_to(x, shape) for x in (_speed_before(case), drawn_before(case)))
    each = jnp.ones_like(mesh.s)
    clock, cycle = load.time * each, load.cycle * each
    return Channel(mesh.s - mesh.interval.length, mesh.s, speed, each, clock, cycle, drawn)


def any_on(case: Case, kinds: list[str]) -> Bool[Array, ""] | bool:
    """Whether any of these terms acts; known without their numbers if all terms of the program act."""
    if not kinds or case.structure.acting:
        return bool(kinds)
    on = [is_on(case.structure.catalogue[kind], case.terms[kind]) for kind in kinds]
    return functools.reduce(jnp.logical_or, on)


def pressing(stop: Float[Array, ""]) -> Float[Array, ""]:
    """Force of the stop [N] from its unknown: the unknown itself where positive. A negative unknown is the
    distance from the stop, scaled so that the residual at the tip has about the same slope on both sides of
    contact. Newton's method would otherwise jump between contact and none.
    """
    return jnp.where(stop > 0, stop, 0.0)
