"""A physics term that a robot file states as an expression: what it may act on, its checks, its equations."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax.dimension import NONE, Dimension, dimension_of_unit
from gtr_jax.errors import did_you_mean

from .expression import dimension_of, evaluate
from .grammar import CONSTANTS, FUNCTIONS, ExpressionError, Node, names_in, parsed
from .response import is_readable, shown_with, true_behind
from .term import Quantity, Term, along


@dataclasses.dataclass(frozen=True)
class Variable:
    """What a law may depend on: its SI unit, what it is, and the range in which laws are checked."""

    unit: str
    says: str
    range: tuple[float, float]


VARIABLES = {
    "p": Variable("N/m", "line pressure of the tendon on its channel, tension times curvature", (0, 500)),
    "T": Variable("N", "tension", (0, 100)),
    "v": Variable("m/s", "speed of the slip, never negative", (0, 0.05)),
    "s": Variable("m", "arc length from the base", (0, 0.5)),
    "k": Variable("1/m", "curvature beyond the natural one", (-20, 20)),
    "t": Variable("s", "time since the first sample", (0, 1000)),
    "n": Variable("dimensionless", "pulls and releases done, each half a cycle", (0, 20)),
    "d": Variable("m", "length of tendon drawn out of the channel at its base", (0, 0.05)),
    "l": Variable("s", "time since a change of the tension", (0, 10)),
}


@dataclasses.dataclass(frozen=True)
class Place:
    """Where a law acts.

    Attributes:
        says: what the expression gives.
        unit: SI unit of the expression.
        variables: names of those it may have.
        neutral: value at which nothing changes, a number or the name of a variable.
        equation: what is made of the law, for people.
        one_sided: whether its size cannot be negative, unless the file says so.
    """

    says: str
    unit: str
    variables: tuple[str, ...]
    neutral: float | str
    equation: str
    one_sided: bool = False


ACTS = {
    "friction": Place(
        "factor on the friction coefficient; below 0 it counts as 0",
        "dimensionless",
        ("p", "T", "v", "s", "t", "n", "d"),
        1.0,
        "μ·({law})",
    ),
    "viscous": Place(
        "addition to the friction coefficient, from the speed of the load step itself",
        "dimensionless",
        ("v",),
        0.0,
        "μ + ({law})",
        one_sided=True,
    ),
    "drag": Place(
        "force per length that opposes slip; below 0 it counts as 0",
        "N/m",
        ("p", "T", "v", "s", "t", "n", "d"),
        0.0,
        "dT/ds lowered by ({law}) while pulling, raised while releasing; T never below 0",
        one_sided=True,
    ),
    "bending": Place(
        "addition to the bending moment over EI",
        "1/m",
        ("k", "s"),
        0.0,
        "M = EI (k + ({law})); in space along the vector of both bendings, with k its length",
    ),
    "strain": Place(
        "strain of the tendon",
        "dimensionless",
        ("T",),
        0.0,
        "strain of the tendon ({law})",
        one_sided=True,
    ),
    "tip_cell": Place(
        "tension that the cell at the tip shows for a true tension T",
        "N",
        ("T", "t"),
        "T",
        "T_tip shown = {law}",
    ),
    "base_cell": Place(
        "tension that the cell at the base shows for a true tension T",
        "N",
        ("T", "t"),
        "T",
        "T_base shown = {law}",
    ),
    "tip_response": Place(
        "what the cell at the tip shows beyond the true tension, at the time l after a step of one newton",
        "dimensionless",
        ("l",),
        0.0,
        "T_tip shown = T + integral of ({law}) dT over all changes before",
    ),
    "base_response": Place(
        "what the cell at the base shows beyond the true tension, at the time l after a step of one newton",
        "dimensionless",
        ("l",),
        0.0,
        "T_base shown = T + integral of ({law}) dT over all changes before",
    ),
}
CELLS = ("tip_cell", "base_cell", "tip_response", "base_response")
NOT_ODD = "does not change its sign with k, and in space no direction is the positive one; write it odd in k"
SAMPLES = 96  # at which a law is checked, with the ends of all ranges among them
FARTHER = 1.5  # beyond the largest of its own numbers of a variable's unit a law is checked too
DENSE = 8192  # at which it is asked whether it has any effect: it may be a narrow bump
ALONG, SOFTEST = 401, 0.04  # places along a body, and the least share of its stiffness that a law leaves
FLATTEST = 0.1  # least rise of what the base cell shows with the true tension
INVERTING = 12  # steps of Newton's method from what the base cell shows to the true tension


@dataclasses.dataclass(frozen=True)
class Law:
    """A law as a robot file states it, without the values of its parameters.

    Attributes:
        name: of the term.
        acts: where, a key of `ACTS`.
        text: the expression.
        numbers: its parameters; the one that is a size is null at zero.
        says: one sentence for people; "" for none.
    """

    name: str
    acts: str
    text: str
    numbers: tuple[Quantity, ...]
    says: str = ""

    @property
    def place(self) -> Place:
        """Where it acts."""
        return ACTS[self.acts]

    @property
    def tree(self) -> Node:
        """Its expression."""
        return parsed(self.text)

    @property
    def variables(self) -> frozenset[str]:
        """The variables it has."""
        return names_in(self.tree) & VARIABLES.keys()

    @property
    def size(self) -> Quantity:
        """Its size."""
        return next(q for q in self.numbers if q.size)

    @property
    def equation(self) -> Law:
        """What equations have of it: its expression and the names of its parameters, without their ranges and
        usual values, so that laws that differ in these have one compiled program.
        """
        bare = [
            Quantity(q.name, q.unit, 0.0 if q.size else 1.0, 1.0, "", (0.0, 1.0), size=q.size)
            for q in self.numbers
        ]
        return Law(self.name, self.acts, self.text, tuple(bare))


def check_law(law: Law, values: Mapping[str, float]) -> None:
    """Refuse a law that has unknown names, does not fit in its units, or is not null where its size is zero.

    Args:
        law: the law.
        values: of its parameters [SI].

    Raises:
        ExpressionError: what is wrong and the remedy, in one line.
    """
    known = {q.name for q in law.numbers}
    for name in sorted(known & (VARIABLES.keys() | FUNCTIONS.keys() | CONSTANTS.keys())):
        raise ExpressionError(f"a parameter cannot be called {name}, which laws know already; rename it")
    names = names_in(law.tree)
    for name in sorted(names - known - {*law.place.variables}):
        if name in VARIABLES:
            have = ", ".join(law.place.variables)
            raise ExpressionError(f"{name} is not known to {law.acts}, which knows {have}; leave it out")
        raise ExpressionError(
            f"unknown name '{name}'; {did_you_mean(name, [*law.place.variables, *known])} Or add it to the "
            "parameters"
        )
    for name in sorted(known - names):
        raise ExpressionError(f"does not contain its parameter {name}; use it, or leave it out")
    _check_units(law)
    _check_null(law, values)
    _check_form(law, values)


def _check_units(law: Law) -> None:
    units = {name: variable.unit for name, variable in VARIABLES.items()} | {
        q.name: q.unit for q in law.numbers
    }
    found = dimension_of(law.tree, {name: _dimension(unit) for name, unit in units.items()})
    wanted = _dimension(law.place.unit)
    if found != wanted:
        raise ExpressionError(
            f"is in {found.unit}, but {law.acts} needs {wanted.unit}; correct the units of its parameters"
        )


def _dimension(unit: str) -> Dimension:
    found = dimension_of_unit(unit)
    return NONE if found is None else found


def _check_null(law: Law, values: Mapping[str, float]) -> None:
    size = law.size
    for given in _corners(law, values):
        acting = values[size.name] or size.typical
        (at, found), (_, moved) = (sampled(law, {**given, size.name: value}) for value in (0.0, acting))
        if not np.all(np.isfinite([found, moved])):
            raise ExpressionError("is not finite at some values of its variables; keep it from growing so")
        neutral = at["T"] if law.place.neutral == "T" else np.full(SAMPLES, law.place.neutral)
        wrong = found != neutral
        if np.any(wrong):
            i = int(np.argmax(wrong))
            where = ", ".join(f"{n} = {at[n][i]:.3g}" for n in law.place.variables if n in law.variables)
            raise ExpressionError(
                f"with {size.name} = 0 gives {found[i]:.4g} {f'at {where} ' if where else ''}instead of "
                f"{'T' if law.place.neutral == 'T' else f'{law.place.neutral:g}'}, its value without effect; "
                f"multiply what it changes by {size.name}"
            )
    acting = values[size.name] or size.typical
    at, found = sampled(law, {**values, size.name: acting}, DENSE)
    if np.all(found == (at["T"] if law.place.neutral == "T" else law.place.neutral)):
        raise ExpressionError(f"has no effect at {size.name} = {acting:g}; multiply more by {size.name}")


def _corners(law: Law, values: Mapping[str, float]) -> list[Mapping[str, float]]:
    """The values, and those with each other number at an end of its usual range."""
    ends = [{**values, q.name: end} for q in law.numbers if not q.size for end in q.usual]
    return [values, *ends]


def _check_form(law: Law, values: Mapping[str, float]) -> None:
    """What some places ask of a law beyond its units."""
    if law.acts == "viscous":
        own = {**values, law.size.name: values[law.size.name] or law.size.typical}
        still = float(evaluate(law.tree, {**own, "v": 0.0}, np))
        if still != 0.0:
            raise ExpressionError(
                f"gives {still:.4g} at v = 0, where viscous friction vanishes; multiply it by v, or let it "
                "act on friction"
            )
    fault = _fault(law, values)
    if fault:
        raise ExpressionError(fault)


def sampled(
    law: Law, values: Mapping[str, float], count: int = SAMPLES
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Variables over their ranges, and the law there, (count,) each."""
    draw = np.random.default_rng(0)
    at = {}
    for name, variable in VARIABLES.items():
        low, high = variable.range
        # A larger rig, or a longer recording, has numbers of its own in the variable's unit.
        own = [abs(values[q.name]) for q in law.numbers if q.unit == variable.unit and q.name in values]
        high = max([high, *(FARTHER * value for value in own if np.isfinite(value))])
        inner = draw.uniform(low, high, count - 3)
        at[name] = np.concatenate([[0.0, low, high], inner])
    with np.errstate(all="ignore"):
        found = evaluate(law.tree, at | {name: np.float64(value) for name, value in values.items()}, np)
    return at, np.broadcast_to(np.asarray(found, float), (count,))


def is_odd(law: Law) -> bool:
    """Whether a law of k changes its sign with k, at whatever parameters are usual."""
    values = {q.name: q.typical for q in law.numbers}
    k, s = np.meshgrid(*(np.linspace(0.0, VARIABLES[name].range[1], 33) for name in ("k", "s")))
    for given in _corners(law, values):
        with np.errstate(all="ignore"):
            left, right = (
                np.broadcast_to(evaluate(law.tree, {**given, "k": x, "s": s}, np), k.shape) for x in (-k, k)
            )
        if not np.allclose(left, -right, rtol=1e-12, atol=1e-300):
            return False
    return True


def _too_soft(law: Law, values: Mapping[str, float], length: float | None) -> str:
    """Why a law that is proportional to k leaves a body of this length no stiffness somewhere; "" if it
    leaves some, is another, or the length is not known.
    """
    if length is None:
        return ""
    s = np.linspace(0.0, length, ALONG)
    with np.errstate(all="ignore"):
        once, twice = (
            np.broadcast_to(evaluate(law.tree, {**values, "k": k, "s": s}, np), s.shape) for k in (1.0, 2.0)
        )
    share = 1.0 + once
    if not np.allclose(twice, 2 * once) or np.all(share >= SOFTEST):
        return ""
    i = int(np.argmin(share))
    return (
        f"leaves {share[i]:.2g} of the stiffness at s = {1e3 * s[i]:.3g} mm, where {SOFTEST:g} must be left; "
        f"make {law.size.name} smaller"
    )


def _fault(law: Law, values: Mapping[str, float], length: float | None = None) -> str:
    """Why a law cannot have these numbers; "" if it can."""
    if law.acts == "base_response":
        times = [abs(values[q.name]) for q in law.numbers if q.unit == "s"] or [1.0]
        with np.errstate(all="ignore"):
            if is_readable(lambda lag: evaluate(law.tree, {**values, "l": lag}, np), times):
                return ""
        return (
            "turns a step of the tension about, or undoes it later, so that the true tension cannot be read "
            f"off the cell; make {law.size.name} smaller"
        )
    if law.acts == "bending" and "s" in law.variables:
        return _too_soft(law, values, length)
    if law.acts != "base_cell":
        return ""
    T = np.linspace(0.0, VARIABLES["T"].range[1], 401)
    with np.errstate(all="ignore"):
        shown = np.broadcast_to(evaluate(law.tree, {**values, "T": T, "t": 0.0}, np), T.shape)
    rise = np.diff(shown) / np.diff(T)
    if np.all(rise >= FLATTEST):
        return ""
    at = float(T[int(np.argmax(~(rise >= FLATTEST)))])
    return (
        f"rises by less than {FLATTEST:g} N per N at T = {at:.3g} N, so that the true tension cannot be read "
        f"off the cell; make {law.size.name} smaller"
    )


@functools.lru_cache(maxsize=256)
def term_of_law(law: Law) -> Term:
    """The physics term of a law."""
    names = law.variables
    slip = law.acts in ("friction", "drag") and "v" in names
    place = ", ".join(f"{name} the {VARIABLES[name].says}" for name in law.place.variables if name in names)
    return Term(
        id=law.name,
        says=law.says or f"A law of the robot file: {law.place.says.partition(';')[0]}.",
        law=law.place.equation.format(law=law.text) + (f"; {place}" if place else ""),
        seen="As `gtr terms --law` draws it.",
        told_apart=_experiment(law),
        source="the robot file",
        quantities=law.numbers,
        timed=bool(names & {"t", "v", "l"}),
        creeps=slip or law.acts == "viscous",
        loosens=law.acts == "friction" and bool(names & {"t", "n", "d"}) and not names & {"p", "T", "v"},
        reads_speed=slip,
        reads_drawn="d" in names,
        reads_channel=law.acts != "bending" and bool(names & _IN_CHANNEL),
        by_place=law.acts == "bending" and "s" in names,
        fault=lambda values, length: _fault(law, values, length),
        **_hooks(law),
    )


_IN_CHANNEL = {"s", "v", "t", "n", "d"}  # variables that a `Channel` holds

# Which experiment shows a variable by itself.
_EXPERIMENTS = {
    "p": "loops up to different tensions",
    "T": "loops up to different tensions",
    "v": "loops at different rates",
    "s": "channels that turn elsewhere",
    "k": "the tip's pose over the whole range of tensions",
    "t": "one loop again after a long rest",
    "n": "one loop many times",
    "d": "loops with the tendon anchored at other places of it",
    "l": "steps of the tension, recorded fast, and then at another rate",
}


def _experiment(law: Law) -> str:
    known = _EXPERIMENTS | ({"s": "markers along the body"} if law.acts == "bending" else {})
    wanted = dict.fromkeys(known[name] for name in law.place.variables if name in law.variables)
    said = "; ".join(wanted) or "loops up to different tensions"
    cell = law.acts in CELLS
    return (f"{said}; hang known weights on the cell" if cell else said).capitalize() + "."


def _hooks(law: Law) -> dict[str, Any]:
    """The hooks of `Term` through which a law acts."""
    names = law.variables

    def value(values, **at):
        return evaluate(law.tree, {**values, **at})

    def passing(values, at):
        """From a `Passing`."""
        own = {"p": at.pressure, "T": at.tension}
        if names & _IN_CHANNEL:
            own |= _of_channel(at.channel)
        return _not_below_zero(value(values, **own))

    def by_speed(values, speed):
        ahead = speed >= 0
        found = value(values, v=jnp.where(ahead, speed, -speed))
        return jnp.where(ahead, found, -found)

    def cell(values, T, at):
        return value(values, T=T, t=along(at.time, T))

    if law.acts == "friction":
        if names & {"p", "T"}:
            return {"by_pressure": passing}
        return {"friction": lambda values, at: value(values, **_of_channel(at))}
    if law.acts == "drag":
        return {"drag": passing}
    if law.acts == "viscous":
        return {"by_speed": by_speed}
    if law.acts == "strain":
        return {"strain": lambda values, tension: value(values, T=tension)}
    if law.acts == "bending":
        return _bending(value) | {"round_only": True, "not_in_space": "" if is_odd(law) else NOT_ODD}
    if law.acts in ("tip_response", "base_response"):
        return _responses(law.acts, value)
    if law.acts == "tip_cell":
        return {"tip": cell}
    return {"base": cell, "true_base": lambda values, shown, at: _inverse(cell, values, shown, at)}


def _responses(acts: str, value: Callable) -> dict[str, Any]:
    def cell(values, T, at):
        return shown_with(lambda lag: value(values, l=lag), T, at.time)

    def true(values, shown, at):
        return true_behind(lambda lag: value(values, l=lag), shown, at.time)

    return {"tip": cell} if acts == "tip_response" else {"base": cell, "true_base": true}


def _of_channel(at: Any) -> dict[str, Any]:
    """Variables from a `Channel`; the place is the middle of the interval."""
    return {"s": 0.5 * (at.start + at.end), "v": at.speed, "t": at.time, "n": at.cycle, "d": at.drawn}


def _not_below_zero(value: Any) -> Any:
    return jnp.where(jnp.asarray(value) > 0, value, 0.0)


def _bending(value: Callable) -> dict[str, Any]:
    def bend(values, kappa, at):
        return value(values, k=kappa - at.rest, s=at.place) + 0.0 * kappa, at.kept

    def bend_in_space(values, strain, at):
        """Along the vector of both bendings; twist stays linear."""
        _, y, z = (u - rest for u, rest in zip(strain, at.rest, strict=True))
        square = y**2 + z**2
        bent = square > 0
        size = jnp.sqrt(jnp.where(bent, square, 1.0))
        # Next to the straight section the law is its slope times k.
        own = functools.partial(value, values, s=at.place)
        _, slope = jax.jvp(lambda k: own(k=k) + 0.0 * k, (0.0 * size,), (jnp.ones_like(size),))
        share = jnp.where(bent, own(k=size) / size, slope)
        return (0.0 * y, share * y, share * z), at.kept

    return {"bend": bend, "bend_in_space": bend_in_space}


def _inverse(cell: Callable, values: Any, shown: Any, at: Any) -> Any:
    """True tensions for what the cell shows, by Newton's method."""
    T = shown
    for _ in range(INVERTING):
        now, slope = jax.jvp(lambda T: cell(values, T, at), (T,), (jnp.ones_like(T),))
        T = T - (now - shown) / jnp.where(slope > FLATTEST, slope, FLATTEST)
    return T
