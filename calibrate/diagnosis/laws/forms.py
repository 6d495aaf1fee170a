"""Forms that a law may have: a small grammar of one variable, and a sum of cosines that may be anything
smooth.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis
from calibrate.inference.number import Number
from gtr_jax.terms import Law

from .places import LawPlace

# Cosines of a smooth law, and of one of the place and of the time.
SMOOTH, SMOOTH_ALONG = 6, 9
SIZE, SPAN, LOW = "size", "span", "low"
# Widths, periods and places that are tried of each form, as shares of the range.
WIDTHS = (0.02, 0.05, 0.12, 0.3)
PERIODS = np.geomspace(0.045, 1.2, 110)
PLACES = np.linspace(0.02, 0.98, 25)
PHASES = np.arange(8) * np.pi / 8
# Forms that have a minimum beside each of many periods; and those that, of the time, tell of what happens
# once and have one beside each of many times.
SWINGING, TRANSIENT = ("wave", "ringing"), ("stretch", "bump", "step")
# The hook of how a cell responds, and periods of its ringing, as shares of the range; hooks whose laws have
# only the forms that name them, and those whose smooth law starts with a wave of no length, because no other
# number takes it.
RESPONSE, RINGS = "tip_response", np.geomspace(0.053, 0.6, 24)
OWN_FORMS, ALONE = (RESPONSE, "viscous"), (RESPONSE, "viscous", "drag")
# What the cosines of a smooth law are multiplied by, as text and of u: how a cell responds fades over the
# range, since no longer lag is felt, and viscous friction grows from zero.
ENVELOPES = {
    RESPONSE: ("max(0,1-{along})*", lambda u: 1 - u),
    "viscous": ("{along}*", lambda u: u),
}
PLAIN = ("", np.ones_like)
# Width of the edges of a stretch, as a share of the range, from which a fit starts and which is usual; and
# the least, at which it is a jump.
SUDDEN, JUMP = 0.01, 2e-4


class Shape(NamedTuple):
    """A number of a form beside its size.

    Attributes:
        name: of it.
        says_unit: "of" if it has the variable's unit, else an SI unit.
        log: whether its prior is logarithmic, about a share of the range; else it lies in the range, or is no
            share of it (`PHASE`, `POWER`).
    """

    name: str
    says_unit: str
    log: bool


class Form(NamedTuple):
    """A form.

    Attributes:
        name: for people.
        text: expression with {x} for the variable; zero where size is.
        shapes: its numbers beside the size.
        value: of the form at size 1, from u in [0, 1] and the shapes as shares of the range.
        grid: shapes to try, as shares of the range.
        for_: hooks that it is for; if empty all but `OWN_FORMS`.
        of: variables that it is for; all if empty.
        but: hook and variable that it is not for.
        slope: whether its size is a slope, usually one; `value` takes the change over the whole range.
    """

    name: str
    text: str
    shapes: tuple[Shape, ...]
    value: Callable[..., np.ndarray]
    grid: Sequence[tuple[float, ...]]
    for_: tuple[str, ...] = ()
    of: tuple[str, ...] = ()
    but: tuple[str, str] | None = None
    slope: bool = False


AT, WIDTH, SCALE = Shape("at", "of", False), Shape("width", "of", True), Shape("scale", "of", True)
FIRST, LAST = Shape("first", "of", False), Shape("last", "of", False)
EDGE = Shape("edge", "of", True)
PERIOD, PHASE = Shape("period", "of", True), Shape("phase", "dimensionless", False)
POWER = Shape("power", "dimensionless", False)
# Share of the range below which a power is linear.
SLOW = 0.02


def _beyond(u: np.ndarray, at: float) -> np.ndarray:
    """What u is beyond a place; nothing before it."""
    return np.maximum(0.0, u - at)


FORMS = (
    Form(
        "constant",
        "size",
        (),
        lambda u: np.ones_like(u),
        [()],
        for_=("drag",),
    ),
    Form(
        "linear",
        "size*{x}/reach",
        (),
        lambda u: u,
        [()],
        for_=("friction", "drag", "strain", "viscous"),
    ),
    Form(
        "power",
        f"size*{{x}}/reach*({{x}}/reach+{SLOW})^(power-1)",
        (POWER,),
        lambda u, power: u * (u + SLOW) ** (power - 1),
        [(p,) for p in (0.4, 0.55, 0.7, 0.85, 1.2, 1.5, 2.0)],
        for_=("viscous",),
    ),
    Form(
        "saturating",
        "size*(1-exp(-{x}/scale))",
        (SCALE,),
        lambda u, scale: -np.expm1(-u / scale),
        [(w,) for w in (0.05, 0.1, 0.2, 0.4)],
        for_=("viscous",),
    ),
    Form(
        "quadratic",
        "size*({x}/reach)^2",
        (),
        lambda u: u**2,
        [()],
    ),
    Form(
        "step",
        "size*(1+tanh(({x}-at)/width))/2",
        (AT, WIDTH),
        lambda u, at, width: 0.5 * (1 + np.tanh((u - at) / width)),
        list(itertools.product(PLACES, WIDTHS)),
    ),
    Form(
        "bump",
        "size*exp(-(({x}-at)/width)^2)",
        (AT, WIDTH),
        lambda u, at, width: np.exp(-(((u - at) / width) ** 2)),
        list(itertools.product(PLACES, WIDTHS)),
    ),
    Form(
        "decay",
        "size*exp(-{x}/scale)",
        (SCALE,),
        lambda u, scale: np.exp(-u / scale),
        [(w,) for w in (0.02, 0.05, 0.1, 0.2, 0.4)],
        for_=("friction", "tip_cell", "base_cell", RESPONSE),
    ),
    Form(
        "kneed",
        "size*max(0,{x}-at)/reach",
        (AT,),
        _beyond,
        [(p,) for p in PLACES],
        but=("tip_cell", "T"),
    ),
    # A cell at its end shows what it showed there, however much is added.
    Form(
        "bent",
        "size*max(0,{x}-at)",
        (AT,),
        _beyond,
        [(p,) for p in PLACES],
        for_=("tip_cell",),
        of=("T",),
        slope=True,
    ),
    Form(
        "stretch",
        "size*(tanh(({x}-first)/edge)-tanh(({x}-last)/edge))/2",
        (FIRST, LAST, EDGE),
        lambda u, first, last, edge: 0.5 * (np.tanh((u - first) / edge) - np.tanh((u - last) / edge)),
        [(a, b, SUDDEN) for a, b in itertools.combinations(PLACES, 2)],
        of=("s", "t", "n", "d"),
    ),
    Form(
        "wave",
        "size*sin(2*pi*{x}/period+phase)",
        (PERIOD, PHASE),
        lambda u, period, phase: np.sin(2 * np.pi * u / period + phase),
        [(float(p), f) for p in PERIODS for f in PHASES],
        of=("T", "s", "t", "p", "d"),
    ),
    Form(
        "ringing",
        "size*exp(-{x}/scale)*sin(2*pi*{x}/period+phase)",
        (SCALE, PERIOD, PHASE),
        lambda u, scale, period, phase: np.exp(-u / scale) * np.sin(2 * np.pi * u / period + phase),
        [(s, float(p), f) for s in (0.03, 0.06, 0.12, 0.25, 0.5) for p in RINGS for f in PHASES],
        for_=(RESPONSE,),
    ),
)


def forms_for(place: LawPlace) -> list[Form]:
    """The forms that a law may have there."""
    return [
        form
        for form in FORMS
        if (place.acts in form.for_ or (not form.for_ and place.acts not in OWN_FORMS))
        and (not form.of or place.of in form.of)
        and form.but != (place.acts, place.of)
    ]


def law_of(place: LawPlace, form: Form) -> tuple[Law, dict[str, float]]:
    """The law of a form at a place, and those of its numbers that stay."""
    name = f"{place.name}-{form.name}"
    unit = "dimensionless" if form.slope else place.unit
    numbers = [place.quantity(SIZE, unit, usual_size(place, form) / _per_size(place, form), size=True)]
    stays: dict[str, float] = {}
    if "reach" in form.text:
        numbers.append(place.quantity("reach", place.of_unit, place.high))
        stays[f"{name}.reach"] = place.high
    for shape in form.shapes:
        unit = place.of_unit if shape.says_unit == "of" else shape.says_unit
        numbers.append(place.quantity(shape.name, unit, _usual(place, shape)))
    return place.law(name, form.text.format(x=place.argument), tuple(numbers)), stays


def hypothesis_of(place: LawPlace, form: Form) -> Hypothesis:
    """A form at a place with all its numbers free."""
    law, stays = law_of(place, form)
    of_size = law.numbers[0]
    size = _number(f"{law.name}.{SIZE}", of_size.unit, 0.0, of_size.typical, size=True, lower=place.least)
    shapes = [_of_shape(place, law.name, shape) for shape in form.shapes]
    numbers = (size, *shapes)
    return Hypothesis(law.name, law.name, numbers, starts=(), fixed=stays, dated=place.of == "t")


def coordinates(place: LawPlace, form: Form, size: float, shapes: Sequence[float]) -> np.ndarray:
    """Coordinates of the numbers of `hypothesis_of` for a size in `place.unit`, and shapes as in a grid."""
    h = hypothesis_of(place, form)
    values = [
        size / _per_size(place, form),
        *(_in_units(place, s, v) for s, v in zip(form.shapes, shapes, strict=True)),
    ]
    return np.asarray([n.at(v) for n, v in zip(h.numbers, values, strict=True)])


def usual_size(place: LawPlace, form: Form) -> float:
    """Usual size of a form, in `place.unit`: of a slope over the whole range."""
    return place.span if form.slope else place.size


def _per_size(place: LawPlace, form: Form) -> float:
    """By how much a form changes over the range for a size of one, in `place.unit`."""
    return place.span if form.slope else 1.0


def _in_units(place: LawPlace, shape: Shape, share: float) -> float:
    return share if shape in (PHASE, POWER) else share * place.span


def _usual(place: LawPlace, shape: Shape) -> float:
    if shape is POWER:
        return 1.0
    return {PHASE: 0.0, EDGE: SUDDEN}.get(shape, 0.1 if shape.log else 0.5) * place.span


def _of_shape(place: LawPlace, law: str, shape: Shape) -> Number:
    name = f"{law}.{shape.name}"
    if shape is PHASE:
        return _number(name, "dimensionless", 0.0, np.pi)
    if shape is POWER:
        return _number(name, "dimensionless", 1.0, 0.4, log=True, lower=0.2)
    if shape is EDGE:
        usual, lower = _usual(place, shape), JUMP * place.span
        return _number(name, place.of_unit, usual, 1.0, log=True, lower=lower)
    if shape.log:
        return _number(name, place.of_unit, 0.15 * place.span, 1.0, log=True, lower=0.004 * place.span)
    middle = place.low + 0.5 * place.span
    return _number(name, place.of_unit, middle, 0.35 * place.span)


def _number(
    name: str,
    unit: str,
    centre: float,
    sd: float,
    *,
    log: bool = False,
    size: bool = False,
    lower: float = -np.inf,
) -> Number:
    return Number(name=name, unit=unit, centre=centre, sd=sd, log=log, size=size, lower=lower)


def waves(place: LawPlace) -> range:
    """Waves over the range, in halves, of the cosines of the smooth law at a place: what does not change
    with the variable is left to the friction coefficient, to E and to the cells, but a drag and a response
    have it to themselves, and of viscous friction it is what grows with the speed.
    """
    many = SMOOTH_ALONG if place.of in ("s", "t", "d", "l") else SMOOTH
    first = 0 if place.acts in ALONE else 1
    return range(first, first + many)


def cosines(place: LawPlace, u: np.ndarray) -> np.ndarray:
    """The cosines of the smooth law at a place, (U, waves), at u in [0, 1], within their envelope."""
    envelope = ENVELOPES.get(place.acts, PLAIN)[1](u)
    return np.cos(np.pi * np.outer(u, waves(place))) * envelope[:, None]


def smooth_of(place: LawPlace) -> tuple[Law, Hypothesis]:
    """A law that may be any smooth function: a sum of `cosines` over the range, the j-th with a prior of one
    over j of the usual size.
    """
    name = f"{place.name}-smooth"
    along = f"({place.argument}-{LOW})/{SPAN}"
    sum_of = "+".join(f"c{j}*cos({j}*pi*{along})" for j in waves(place))
    envelope = ENVELOPES.get(place.acts, PLAIN)[0].format(along=along)
    size = place.quantity(SIZE, place.unit, 1.0, size=True)
    ends = [place.quantity(LOW, place.of_unit, place.low), place.quantity(SPAN, place.of_unit, place.span)]
    numbers, free = [size, *ends], []
    for j in waves(place):
        numbers.append(place.quantity(f"c{j}", "dimensionless", 0.0))
        free.append(_number(f"{name}.c{j}", "dimensionless", 0.0, place.size / max(j, 1), size=True))
    law = place.law(name, f"{SIZE}*{envelope}({sum_of})", tuple(numbers))
    fixed = {f"{name}.{SIZE}": 1.0, f"{name}.{LOW}": place.low, f"{name}.{SPAN}": place.span}
    return law, Hypothesis(name, name, tuple(free), starts=(), fixed=fixed)
