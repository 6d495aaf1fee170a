"""The numbers of a robot as sliders: where each lies, its unit, its range and its group."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence

from gtr_jax.config.config import RobotConfig
from gtr_jax.config.schema import says_of
from gtr_jax.numbers import display_unit
from gtr_jax.robot.parameters import Parameter, parameters_of
from gtr_jax.robot.robot import Robot
from gtr_jax.terms import Quantity

# How far a slider reaches, of a number that is not zero: to this many times its value, and back to as much
# below zero; one that must be positive to this share of it.
FARTHEST, NEAREST = 3.0, 0.2
# How far to each side, of a number that is zero, by SI unit; others reach one unit.
REACH = {
    "N": 2.0,
    "N m": 0.05,
    "m": 0.02,
    "rad/m": 20.0,
    "m/s^2": 9.80665,
    "kg": 0.1,
    "kg/m^3": 2000.0,
}
# Names of numbers of channels that say nothing to who does not know the equations.
SYMBOLS = ("r1", "r2", "w1", "w2", "R_max", "r_min", "n_sine", "sigma")
STEPS = 400  # of a slider from end to end
GROUPS = ("Tendon", "Channel", "Body", "Loads", "Base")
_TABLES = {"tendon": "Tendon", "routing": "Channel", "backbone": "Body", "loads": "Loads", "base": "Base"}


@dataclasses.dataclass(frozen=True)
class Knob:
    """One number of a robot as a slider.

    Attributes:
        name: of the parameter, as `gtr_jax.parameters_of` lists it.
        key: in the robot file.
        group: what it stands under: one of GROUPS, or "terms".
        label: what people call it, without the unit.
        says: what it is, as its physics term or the table of the robot file says, without the SI unit.
        unit: that it is shown in; "" if it has none.
        size: of that unit in SI.
        value: [SI].
        low, high: ends of the slider [SI].
        lower, upper: bounds [SI]; None where open.
        term: the physics term that it belongs to; "" if it belongs to none.
    """

    name: str
    key: str
    group: str
    label: str
    says: str
    unit: str
    size: float
    value: float
    low: float
    high: float
    lower: float | None
    upper: float | None
    term: str

    @property
    def title(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label

    @property
    def step(self) -> float:
        """Step of the slider [SI]: of one, two or five in the last digit."""
        return rounded((self.high - self.low) / STEPS / self.size) * self.size

    def shown(self, value: float) -> float:
        """A value [SI] in the unit that is shown, without the rounding of the conversion."""
        return float(f"{value / self.size:.12g}")


def rounded(amount: float) -> float:
    """The next of 1, 2, 5, 10, ... above a positive amount."""
    power = 10.0 ** math.floor(math.log10(amount))
    digit = next(d for d in (1.0, 2.0, 5.0, 10.0) if d * power >= amount * (1 - 1e-9))
    return float(f"{digit * power:.12g}")


def knobs_of(robot: Robot, terms: Sequence[str], *, config: RobotConfig) -> list[Knob]:
    """A slider for every number of a robot that is finite, those of some physics terms included, in the order
    of `parameters_of`.

    Args:
        robot: the robot.
        terms: names of the terms.
        config: the robot file, whose tables say what the numbers are.
    """
    found = []
    for entry in parameters_of(robot).values():
        value = float(robot.value(entry.name))
        if math.isfinite(value) and (entry.term is None or entry.term.id in terms):
            found.append(_knob(entry, value, config))
    return found


def _knob(entry: Parameter, value: float, config: RobotConfig) -> Knob:
    unit, size = display_unit(entry.unit)
    quantity = _quantity(entry)
    low, high = _range(entry, value) if quantity is None else _usual(quantity, value)
    low = low if entry.lower is None else max(low, entry.lower)
    high = high if entry.upper is None else min(high, entry.upper)
    if entry.positive and low <= 0:
        low = min(value, high) * 1e-2
    says = _plain(says_of(config, entry.key) if quantity is None else quantity.says)
    group, label = _place(entry, says)
    term = "" if entry.term is None else entry.term.id
    return Knob(
        entry.name,
        entry.key,
        group,
        label,
        says,
        unit,
        size,
        value,
        float(f"{low / size:.4g}") * size,
        float(f"{high / size:.4g}") * size,
        entry.lower,
        entry.upper,
        term,
    )


def _quantity(entry: Parameter) -> Quantity | None:
    """What the term of a parameter says of it."""
    if entry.term is None:
        return None
    return next(q for q in entry.term.numbers if q.name == entry.name.split(".")[1])


def _range(entry: Parameter, value: float) -> tuple[float, float]:
    """Ends of the slider of a number of the robot itself."""
    if entry.lower is not None and entry.upper is not None:
        return entry.lower, entry.upper
    if entry.unit == "rad":
        turn = math.pi if abs(value) <= math.pi else abs(value)
        return -turn, turn
    if value == 0:
        reach = REACH.get(entry.unit, 1.0)
        return -reach, reach
    if entry.positive:
        return NEAREST * value, FARTHEST * value
    ends = -value, FARTHEST * value
    return min(ends), max(ends)


def _usual(quantity: Quantity, value: float) -> tuple[float, float]:
    """Ends of the slider of a number of a term: from its null value over twice what is usual."""
    low, high = quantity.usual
    reach = [quantity.null, value, low, high, quantity.typical]
    if low < quantity.null:
        reach.append(2 * low - quantity.null)
    if high > quantity.null:
        reach.append(2 * high - quantity.null)
    low, high = min(reach), max(reach)
    return (low, high) if high > low else (low - 1.0, high + 1.0)


def _place(entry: Parameter, says: str) -> tuple[str, str]:
    """The group and the label of a number, of which its table says this."""
    if entry.term is not None:
        return "terms", " of ".join(entry.name.split(".")[1:]).replace("_", " ")
    table, *rest = entry.key.split(".")
    group = _TABLES.get(table, "Tendon")
    if table == "tendons" and rest[1] == "routing":
        group = "Channel"
    tendon = f" of {rest[0]}" if table == "tendons" else ""
    name = entry.name.removesuffix(f".{rest[0]}") if tendon else entry.name
    if group == "Channel" and (name in SYMBOLS or "knots" in rest):
        return group, f"{_words(name, says)}{tendon}"
    words = {"mu": "friction coefficient", "E": "Young's modulus", "nu": "Poisson's ratio"}
    return group, f"{words.get(name, name.replace('_', ' '))}{tendon}"


def _plain(says: str) -> str:
    """What a table or a term says of a number, on one line and without the SI unit: the slider's title has
    the unit that is shown. Brackets of lists, as in [s, curvature], stay.
    """
    return re.sub(r" \[[^],]*\]", "", " ".join(says.split()))


def _words(name: str, says: str) -> str:
    """A number of a channel that only has a symbol, in words: of a knot its offset, of others what their
    table says.
    """
    knot = re.fullmatch(r"knot(_[yz])?_(\d+)", name)
    if knot:
        return f"offset{(knot[1] or '').replace('_', ' ')} at knot {knot[2]}"
    text = says.rstrip(".")
    return f"{text[:1].lower()}{text[1:]} ({name})"
