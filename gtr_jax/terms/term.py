"""What a physics term is: an effect that the base model leaves out, dormant at its null value.

A term changes the equations through its hooks, listed below. Every hook takes the term's numbers first, works
on arrays of any shape, and has no effect at the null values.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .tried import PLAINLY, Tried

Values = Mapping[str, Float[Array, "*each"]]

# A slip [m], a speed [m/s] or a curvature [1/m] that is only rounding, while nothing moves. Laws whose
# derivative differs between the directions count it as forward, so that all programs take the same one.
STILL = 1e-13
NO_TUG = "needs one tendon, and friction that does not build up over a slip; leave presliding out"
ONE_HELD = "bends the stretch that friction holds, which in space is computed for one tendon; leave it out"
UNMOVED = "moves an end of the tendon, which is computed beside drive by tension only; leave it out"


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One number of a term.

    Attributes:
        name: its key in the robot file.
        unit: SI unit, "dimensionless" if it has none.
        null: value at which the term has no effect; for a number that is not a size (see `size`), its
            default.
        typical: a value that is common in practice.
        says: what it is, for people.
        usual: range of nine in ten values met in practice; the prior of a diagnosis.
        lower, upper: bounds in SI; None where open.
        log: whether it is estimated on a logarithmic scale.
        size: whether it sets the strength of the effect; the other numbers set its form, and have no effect
            while all sizes are null.
        assumed: whether every robot has it though its file may not state it: what it changes is then
            uncertain by its typical value.
    """

    name: str
    unit: str
    null: float
    typical: float
    says: str
    usual: tuple[float, float]
    lower: float | None = None
    upper: float | None = None
    log: bool = False
    size: bool = True
    assumed: bool = False


class Channel(NamedTuple):
    """What friction at an interval of the channel may depend on, before the load step is known.

    Attributes:
        start, end: arc length [m].
        speed: of the slip in the previous load step [m/s], non-negative.
        sense: +1 for slip towards the base, -1 towards the tip.
        time: [s] since the first sample.
        cycle: pulls and releases done since then; a pull or a release counts half.
        drawn: how far the tendon was drawn out at the base after the previous load step [m].
    """

    start: Float[Array, "..."]
    end: Float[Array, "..."]
    speed: Float[Array, "..."]
    sense: float | Float[Array, "..."]
    time: Float[Array, ""]
    cycle: Float[Array, ""]
    drawn: Float[Array, "..."]


class Passing(NamedTuple):
    """What friction at an interval of the channel may depend on while a load step is solved.

    Attributes:
        pressure: of the tendon on the channel [N/m].
        tension: ahead of the interval [N].
        channel: what was known before; None where no term `reads_channel`.
    """

    pressure: Float[Array, "..."]
    tension: Float[Array, "..."]
    channel: Channel | None


class Bent(NamedTuple):
    """What a bending law may depend on at a section, besides its curvature.

    Attributes:
        rest: natural curvature [1/m].
        before: curvature after the previous load step [1/m].
        kept: what the law remembers, (remembers, ...).
        dt: time since the previous step [s].
        compliance: one over the stiffness [1/(N m^2)], where the law is for a section in space.
        reach: distance of the outermost fibre from the neutral line [m], where a law is `by_strain`.
        place: arc length from the base [m], where a law is `by_place`.

    In space all but the time, the reach and the place are tuples of three: of twist, and of the bendings
    about y and about z.
    """

    rest: Any
    before: Any
    kept: Any
    dt: Float[Array, ""]
    compliance: Any = None
    reach: Any = None
    place: Any = None


class Clock(NamedTuple):
    """What a load cell may depend on besides the tension it measures.

    Attributes:
        time: of the samples [s], (K,).
        T_base: true base tension [N], (K, *tendons).
    """

    time: Float[Array, " K"]
    T_base: Float[Array, "K *tendons"]


Cell = Callable[[Values, Float[Array, "K *tendons"], Clock], Float[Array, "K *tendons"]]


@dataclasses.dataclass(frozen=True)
class Term:
    """One effect.

    Attributes:
        id: its `kind` in robot files.
        place: where it stands among the terms, smallest first and at equal places by name. Terms act in this
            order, those of the load cells from the true tension to the tension shown. Those that state none
            come first, as terms of users do.
        tried: what a diagnosis tries of it.
        says: one sentence for people.
        law: its equation.
        seen: what it looks like in a recording.
        told_apart: which experiment distinguishes it from effects that look alike.
        quantities: its numbers.
        across: those that only a robot in space has; without effect at their null values.
        source: where the law comes from.
        note: what else is known of it, with the numbers measured.
        timed: whether it needs the time of the samples.
        creeps: whether friction goes on changing where the tendon is locked, so that it must be held against
            the neighbouring section instead of against the base.
        relaxes: whether the body goes on bending where the tendon is locked, and carries it along; the first
            number that `bend` remembers is then its moment over EI.
        softens: whether `bend` may take away most of the stiffness; it is then tried of bodies of metal only.
        exact: whether its law holds by definition, as an offset or a delay does, and not as well as a law of
            matter can.
        by_strain: whether `bend` depends on the strain of the outermost fibre. by_place: on the arc length.
        event: whether it happens once, at a time of its own, its number `time`. It is tried only where a
            misfit is located in time, and that time is anywhere in the recording.
        loosens: whether `friction` falls with time, cycles or what is drawn out where the tendon is locked,
            so that the tension held there relaxes.
        reads_speed: whether `friction`, `by_pressure` or `drag` depends on the speed of the slip in the
            previous load step.
        reads_drawn: whether one of them depends on how far the tendon is drawn out at the base.
        reads_channel: whether `by_pressure` or `drag` depends on a `Channel`.
        friction: factor on the friction coefficient of an interval, from a `Channel`.
        by_pressure: factor on the friction coefficient, from a `Passing`.
        by_speed: addition to the friction coefficient, from the signed speed of slip towards the base [m/s].
        drag: force per length that opposes slip [N/m], from a `Passing`.
        wrap: share of the turning that counts, from the tension [N].
        mobilise: how far friction is mobilised after a slip [m], and its memory, from the slip and the
            memory (elements, ...).
        elements: how many numbers `mobilise` remembers.
        base_grip, tip_grip: friction lumped ahead of the channel and at the anchor, as mu times wrap angle.
        bend: addition to the elastic bending moment over EI [1/m], and what it remembers, from the curvature
            and a `Bent`.
        bend_in_space: the same for a section in space, from its strain and a `Bent` in tuples of three.
        remembers: how many numbers `bend` remembers, in space of each component.
        strain: of the tendon, from its tension [N].
        anchor: how far the anchor gives way [m], from the tension there [N].
        tugged: tension added to the tendon's end at the tip from outside [N], from the time [s].
        ahead: stretch of the tendon ahead of the channel [m], from the base tension [N].
        loads: the external loads, from those of the robot.
        adds_to: the dead load to which `loads` adds the numbers x, y and, in space, z: "tip_force" [N] or
            "gravity" [m/s^2]; both keep their direction where a rig is turned. "" for another load.
        stop: force of a stop on the tip [N] against `stop_angle`, from the tip's place along it [m], affine;
            none acts where that is negative.
        stop_angle: direction [rad] from the base tangent in which the stop is run into.
        stop_normal: the same in space, three components of length one in the axes of the base.
        discs_only: whether `bend` is for circular sections, with or without a hole in their middle, so that
            neither strips nor notched bodies can have it.
        round_only: whether `bend_in_space` is for sections that are as stiff in every direction.
        not_in_space: why no robot in space can have it, and the remedy; "" if one can.
        fault: what is wrong with its numbers (by name, SI, within their bounds) on a body of some length [m],
            or "".
        tip, base: what the cell at the tip, or the base, shows for true tensions.
        true_base: the true base tensions for what its cell shows; the inverse of `base`.
        read_at: of a cell at the tip that is read late, the times [s] whose tension it shows, from those of
            the samples [s] and what has passed since the first of them [s].
    """

    id: str
    says: str
    law: str
    seen: str
    told_apart: str
    quantities: tuple[Quantity, ...]
    place: int = 0
    tried: Tried = PLAINLY
    across: tuple[Quantity, ...] = ()
    source: str = ""
    note: str = ""
    timed: bool = False
    creeps: bool = False
    relaxes: bool = False
    softens: bool = False
    exact: bool = False
    by_strain: bool = False
    by_place: bool = False
    event: bool = False
    loosens: bool = False
    reads_speed: bool = False
    reads_drawn: bool = False
    reads_channel: bool = False
    friction: Callable[[Values, Channel], Array] | None = None
    by_pressure: Callable[[Values, Passing], Array] | None = None
    by_speed: Callable[[Values, Array], Array] | None = None
    drag: Callable[[Values, Passing], Array] | None = None
    wrap: Callable[[Values, Array], Array] | None = None
    mobilise: Callable[[Values, Array, Array], tuple[Array, Array]] | None = None
    elements: int = 0
    base_grip: Callable[[Values], Array] | None = None
    tip_grip: Callable[[Values], Array] | None = None
    bend: Callable[[Values, Array, Bent], tuple[Array, Array]] | None = None
    bend_in_space: Callable[[Values, Any, Bent], tuple[Any, Any]] | None = None
    remembers: int = 0
    strain: Callable[[Values, Array], Array] | None = None
    anchor: Callable[[Values, Array], Array] | None = None
    tugged: Callable[[Values, Array], Array] | None = None
    ahead: Callable[[Values, Array], Array] | None = None
    loads: Callable[[Values, Any], Any] | None = None
    adds_to: str = ""
    stop: Callable[[Values, Array], Array] | None = None
    stop_angle: Callable[[Values], Array] | None = None
    stop_normal: Callable[[Values], tuple[Array, Array, Array]] | None = None
    discs_only: bool = False
    round_only: bool = False
    not_in_space: str = ""
    fault: Callable[[Mapping[str, float], float], str] | None = None
    tip: Cell | None = None
    base: Cell | None = None
    true_base: Cell | None = None
    read_at: Callable[[Mapping[str, Any], Any, Any], Any] | None = None

    @property
    def of_cells(self) -> bool:
        """Whether it concerns only what the instruments show, not the robot between them."""
        return bool(self.tip or self.base or self.ahead)

    @property
    def numbers(self) -> tuple[Quantity, ...]:
        """All its numbers, those included that only a robot in space has."""
        return (*self.quantities, *self.across)

    @property
    def sizes(self) -> tuple[Quantity, ...]:
        """The numbers that set its strength."""
        return tuple(q for q in self.numbers if q.size)


# Spreads by which the elements of a law that has several differ from their geometric mean.
APART = (-1.5, -0.5, 0.5, 1.5)


def spread_out(middle, spread):
    """A number of each of `APART` elements, from their geometric mean and the decades between neighbours."""
    return [middle * 10.0 ** (apart * spread) for apart in APART]


def along(time: Float[Array, " K"], values: Float[Array, "K *tendons"]) -> Float[Array, "K *one"]:
    """Times of the samples, shaped to broadcast with values of one tendon or of several."""
    return time.reshape(-1, *[1] * (values.ndim - 1))


def rise(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """A smooth step from 0 at x = 0 to 1 at x = 1, continuously differentiable."""
    x = jnp.where(x > 0, jnp.where(x < 1, x, 1.0), 0.0)
    return x * x * (3.0 - 2.0 * x)
