"""Quantities with units: strings such as "250 mm" become SI numbers; bare numbers are SI already.

Everything behind this file computes in SI units and radians.
"""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from gtr_jax.dimension import Dimension as UnitPowers
from gtr_jax.dimension import dimension_of_unit
from gtr_jax.errors import InputError, excerpt

if TYPE_CHECKING:
    import pint

Number = TypeVar("Number", float, np.ndarray)

_NUMBER = r"[+−-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
LARGEST = 1e30  # in SI: the fourth power of a radius has to stay within the floats
MOST_LETTERS = 60  # of a unit
_POWER_OF_A_NUMBER = re.compile(r"[\d)]\s*(\*\*|\^)")  # pint would compute 9**9**9
_QUANTITY = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")


@dataclass(frozen=True)
class Dimension:
    """How people call a quantity, the unit files are written in, an example of it, and the unit's size in SI.

    The size is what pint says of it, which a test holds it to: a file in these units is read without pint,
    whose registry takes 0.6 s to import and build.
    """

    noun: str
    display: str
    example: str
    size: float = 1.0


DIMENSIONS = {
    "m": Dimension("a length", "mm", "250 mm", 1e-3),
    "s": Dimension("a time", "s", "20 ms"),
    "rad": Dimension("an angle", "deg", "-90 deg", math.pi / 180),
    "N": Dimension("a force", "N", "5 N"),
    "Pa": Dimension("a pressure", "MPa", "1.06 MPa", 1e6),
    "N m": Dimension("a moment", "N m", "0.1 N m"),
    "N m^2": Dimension("a bending stiffness", "N m^2", "0.01 N m^2"),
    "kg/m^3": Dimension("a density", "kg/m^3", "1070 kg/m^3"),
    "kg": Dimension("a mass", "g", "20 g", 1e-3),
    "rad/m": Dimension("a curvature", "rad/m", "11.7 rad/m"),
    "m/s": Dimension("a speed", "mm/s", "2 mm/s", 1e-3),
    "s/m": Dimension("a coefficient per speed", "s/m", "20 s/m"),
    "m/s^2": Dimension("an acceleration", "m/s^2", "9.8 m/s^2"),
    "N/m": Dimension("a force per length", "N/m", "2 N/m"),
    "m/N": Dimension("a displacement per force", "mm/N", "0.01 mm/N", 1e-3),
    "1/N": Dimension("a strain per force", "1/N", "5e-5 1/N"),
    "N/s": Dimension("a force per time", "N/s", "0.002 N/s"),
    "1/s": Dimension("a rate", "1/s", "2e-4 1/s"),
    "m^2": Dimension("an area", "m^2", "0.01 m^2"),
    "dimensionless": Dimension("a pure number", "dimensionless", "0.36"),
}


def _about(si: str) -> Dimension:
    """What there is to say of an SI unit, one that is not a key of DIMENSIONS included."""
    return DIMENSIONS.get(si) or Dimension(f"a quantity in {si}", si, f"2 {si}")


@functools.cache
def registry() -> pint.UnitRegistry:
    """The unit registry (pint), built on first use because that takes half a second."""
    import pint

    return pint.UnitRegistry()


def measures(unit: str, si: str) -> bool:
    """Whether a text is a unit of the SI unit `si`'s kind (a key of DIMENSIONS)."""
    try:
        return bool(unit) and _factor(unit, si) > 0
    except InputError:
        return False


@functools.cache
def _factor(unit: str, si: str) -> float:
    """Size of one `unit` in `si`; InputError if it is unknown or measures something else."""
    dimension = _about(si)
    if unit in (si, dimension.display):
        return 1.0 if unit == si else dimension.size
    import pint

    spelled = re.sub(r"\bNm\b", "N m", unit)  # pint reads "Nm" as a number of metres
    if len(unit) > MOST_LETTERS or _POWER_OF_A_NUMBER.search(unit):
        raise InputError(f"unknown unit '{excerpt(unit)}'")
    try:
        return registry().Quantity(1.0, registry().parse_units(spelled)).to(si).magnitude
    except pint.DimensionalityError:
        hint = "; grams-force are written gf" if si == "N" and unit in ("g", "kg") else ""
        raise InputError(f"'{unit}' is not a unit of {dimension.noun}{hint}") from None
    except Exception:  # pint's tokenizer raises whatever its parts raise on malformed text
        if unit.isalpha() and unit.istitle() and measures(unit.lower(), si):  # Newtons
            return _factor(unit.lower(), si)
        raise InputError(f"unknown unit '{excerpt(unit)}'") from None


def convert(value: Number, unit: str, si: str) -> Number:
    """Convert a number or an array from `unit` to the SI unit `si` (a key of DIMENSIONS).

    Raises InputError, without the place, if the unit is unknown or of another dimension.
    """
    factor = _factor(unit, si)
    divisor = round(1 / factor) if 0 < factor < 1 else 0
    if divisor and abs(divisor * factor - 1) < 1e-12:
        return value / divisor  # 300 mm is then exactly 0.3 m, as 0.3 typed in
    return value * factor


def display_of(unit: str) -> tuple[str, float]:
    """The unit people write an SI quantity in, and its size in SI; the unit itself if it is none of
    DIMENSIONS, as "" is.
    """
    if unit not in DIMENSIONS:
        return unit, 1.0
    display = DIMENSIONS[unit].display
    return display, convert(1.0, display, unit)


def parse_quantity(value: object, si: str) -> float:
    """One quantity in the SI unit `si`: a string with its unit, or a bare number taken as SI.

    Raises InputError without the place; `to_si` adds it.
    """
    dimension = _about(si)
    example = f'"{dimension.example}"' if si != "dimensionless" else dimension.example
    if isinstance(value, str):
        match = _QUANTITY.fullmatch(value)
        if match is None:
            said = excerpt(value)
            raise InputError(f"cannot read '{said}' as {dimension.noun}; write for example {example}")
        number, unit = match.groups()
        if re.match(r"±|\+/?-", unit):
            raise InputError(
                f"'{excerpt(value)}' holds a deviation; write the value here and the deviation under "
                "[uncertainty]"
            )
        if re.match(r"[-+–−]?\s*[\d.]+(?![\d.]*\s*[/*(])", unit):
            raise InputError(f"'{excerpt(value)}' holds two numbers; write one, for example {example}")
        if not unit and si != "dimensionless":
            raise InputError(f"'{excerpt(value)}' carries no unit; write for example {example}")
        try:
            result = convert(float(number.replace("−", "-")), unit or "dimensionless", si)
        except InputError as fault:
            raise InputError(f"{fault}; write for example {example}") from None
    elif isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        try:
            result = float(value)
        except OverflowError:
            result = math.inf
    else:
        found = excerpt(repr(value))
        raise InputError(f"expected {dimension.noun}, found {found}; write for example {example}")
    if not math.isfinite(result):
        raise InputError(f"{excerpt(value)} is not a finite number; write for example {example}")
    if abs(result) > LARGEST:
        raise InputError(
            f"{excerpt(value)} is more than can be computed with ({LARGEST:g} in SI units); "
            f"write for example {example}"
        )
    return result


def parse_any(value: object) -> tuple[str, float]:
    """SI unit and value of a quantity whose kind is not known: a string with any unit of force, length and
    time, or a bare number, which is one without a unit.

    Raises InputError without the place.
    """
    match = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    unit = match[2] if match else ""
    si = _si_unit(unit) if unit else "dimensionless"
    return si, parse_quantity(value, si)


@functools.cache
def _si_unit(unit: str) -> str:
    """The SI unit of what another unit measures; InputError if no law can have it."""
    own = next((si for si, dimension in DIMENSIONS.items() if unit in (si, dimension.display)), None)
    if own is not None:
        return own
    found = dimension_of_unit(unit)
    if found is None:
        if len(unit) > MOST_LETTERS or _POWER_OF_A_NUMBER.search(unit):
            raise InputError(f"unknown unit '{excerpt(unit)}'; write for example N/m")
        try:
            powers: dict[str, Any] = dict(
                registry().parse_units(re.sub(r"\bNm\b", "N m", unit)).dimensionality
            )
        except Exception:  # whatever pint's tokenizer raises on malformed text
            raise InputError(f"unknown unit '{excerpt(unit)}'; write for example N/m") from None
        mass, length, time = (
            Fraction(float(powers.pop(f"[{name}]", 0))).limit_denominator(100)
            for name in ("mass", "length", "time")
        )
        if powers:
            raise InputError(
                f"'{excerpt(unit)}' is not made of force, length and time; write for example N/m"
            )
        found = UnitPowers(mass, length - mass, time + 2 * mass)
    return found.unit


def to_si(value: object, unit: str, where: str) -> float:
    """One quantity in the SI unit `unit` ("m", "N", "Pa", "rad", "N m", ...; the keys of DIMENSIONS).

    Args:
        value: a string with its unit ("250 mm", "-90 deg", "5 gf"), or a bare number, which is SI.
        unit: the SI unit wanted.
        where: file and key, which the error names.

    Raises InputError naming `where`, what is wrong with the value, and an example of a right one.
    """
    try:
        return parse_quantity(value, unit)
    except InputError as fault:
        raise InputError(f"{where}: {fault}") from None


def quantity_text(value: float, si: str) -> str | float:
    """The quantity as a string with a handy unit that `parse_quantity` reads back to the equal float."""
    if si == "dimensionless":
        return value
    display = _about(si).display
    for digits in (15, 16, 17):
        text = f"{value / convert(1.0, display, si):.{digits}g} {display}"
        if parse_quantity(text, si) == value:
            return text
    return f"{value!r} {si}"


@dataclass(frozen=True)
class Unit:
    """Marks a pydantic float, `Annotated[float, Unit("m")]`, as a quantity in that SI unit.

    Validation takes unit strings and bare SI numbers; `model_dump(context={"unit_strings": True})` gives
    unit strings back; the JSON Schema admits both.
    """

    si: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            lambda value: parse_quantity(value, self.si),
            serialization=core_schema.plain_serializer_function_ser_schema(self._serialise, info_arg=True),
        )

    def __get_pydantic_json_schema__(self, schema: Any, handler: Any) -> dict[str, Any]:
        dimension = _about(self.si)
        unit = r"\s*\S*\s*" if self.si == "dimensionless" else r"\s*[^\s\d].*"
        text = {"type": "string", "pattern": rf"^\s*{_NUMBER}{unit}$"}
        return {
            "anyOf": [
                {"type": "number", "description": f"{dimension.noun} in {self.si}"},
                text | {"examples": [dimension.example]},
            ]
        }

    def _serialise(self, value: float, info: Any) -> str | float:
        return quantity_text(value, self.si) if (info.context or {}).get("unit_strings") else value
