"""Sizes that no such robot has: most often a number that was written without its unit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from gtr_jax.units import DIMENSIONS, parse_quantity

from .robot_tables import RobotTables
from .toml_file import dotted


class Range(NamedTuple):
    """Sizes that such robots have, in SI, and the unit that a number without one is likely to mean.

    They are wide: from a vine of metres to a wrist of a needle, from a gel to diamond.
    """

    least: float
    most: float
    meant: str


LENGTH = Range(1e-3, 10.0, "mm")  # of the body, base to tip
FRICTION = SHARE = Range(0.0, 3.0, "%")  # a share of a deviation
OF_UNIT = {
    "m": Range(0.0, 1.0, "mm"),  # across the body; along it at most its length
    "Pa": Range(1e3, 1e12, "MPa"),
    "kg/m^3": Range(10.0, 25e3, "g/cm^3"),
    "N m^2": Range(1e-10, 1e3, "N mm^2"),
    "rad": Range(0.0, 2 * math.pi, "deg"),
}


def implausible(config: RobotTables) -> Iterator[str]:
    """What is implausible in a robot file, a line each with its key and a remedy; its terms left out, whose
    numbers have ranges of their own.
    """
    data = config.model_dump(
        mode="json", by_alias=True, exclude_none=True, context={"unit_strings": True}, exclude={"terms"}
    )
    numbers, longest = config.numbers(), config.backbone.length
    for key, text in dotted(data):
        value = numbers.get(key)
        if not value:
            continue
        shown = text.partition(" ")[2] if isinstance(text, str) else ""
        unit = next((si for si, d in DIMENSIONS.items() if shown in (d.display, si)), shown)
        known = OF_UNIT.get(unit)
        if key == "backbone.length":
            known = LENGTH
        elif key.endswith(".friction_coefficient"):
            known = FRICTION
        if known is None:
            continue
        most = max(known.most, longest) if unit == "m" and known is not LENGTH else known.most
        if not known.least <= abs(value) <= most * (1 + 1e-9):
            yield f"{key}: {_says(value, unit if shown else '', known)}"
    for key, said in config.uncertainty.items():
        if not isinstance(said, str) and said > SHARE.most:
            yield f"uncertainty.{key}: {_says(said, '', SHARE)}"


def _says(value: float, unit: str, known: Range) -> str:
    si = unit or "dimensionless"
    here = f"{value:.6g} {unit}".strip()
    much = "small" if abs(value) < known.least else "large"
    other = f"{value:.6g} {known.meant}"
    likely = known.least <= abs(parse_quantity(other, si)) <= known.most
    remedy = f'if {other} is meant, write "{other}"' if likely else "correct it, or its unit"
    return f"{here} is very {much} for such a robot; {remedy}"
