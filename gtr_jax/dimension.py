"""Units as exponents of newton, metre and second, in which the expressions of laws are checked."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import NamedTuple


class Dimension(NamedTuple):
    """Exponents of N, m and s; an angle has none."""

    force: Fraction = Fraction(0)
    length: Fraction = Fraction(0)
    time: Fraction = Fraction(0)

    def times(self, other: Dimension, power: Fraction | int = 1) -> Dimension:
        """That of a product with a power of another."""
        return Dimension(*(a + power * b for a, b in zip(self, other, strict=True)))

    def to(self, power: Fraction | int) -> Dimension:
        """That of a power."""
        return Dimension(*(power * a for a in self))

    @property
    def unit(self) -> str:
        """Its SI unit: "N/m", "1/s", "dimensionless"."""
        parts = list(zip(("N", "m", "s"), self, strict=True))
        above = [_power(symbol, n) for symbol, n in parts if n > 0]
        below = [f"/{_power(symbol, -n)}" for symbol, n in parts if n < 0]
        return (" ".join(above) or "1") + "".join(below) if above or below else "dimensionless"


NONE = Dimension()
_SYMBOLS = {
    "N": Dimension(Fraction(1)),
    "m": Dimension(length=Fraction(1)),
    "s": Dimension(time=Fraction(1)),
    "kg": Dimension(Fraction(1), Fraction(-1), Fraction(2)),
    "Pa": Dimension(Fraction(1), Fraction(-2)),
    "J": Dimension(Fraction(1), Fraction(1)),
    "rad": NONE,
    "1": NONE,
    "dimensionless": NONE,
    "": NONE,
}
_PART = re.compile(r"\s*([*/·]?)\s*([A-Za-z]+|1)(?:(?:\^|\*\*)([-+]?\d{1,2}(?:\.\d{1,3})?))?")


def _power(symbol: str, n: Fraction) -> str:
    return symbol if n == 1 else f"{symbol}^{float(n):.4g}"


def dimension_of_unit(unit: str) -> Dimension | None:
    """The dimension of a text such as "N/m^2", of SI units without prefixes; None if it is something else."""
    found, at, text = NONE, 0, unit.strip()
    while at < len(text):
        part = _PART.match(text, at)
        if part is None or part[2] not in _SYMBOLS:
            return None
        power = Fraction(part[3] or 1)
        found = found.times(_SYMBOLS[part[2]], -power if part[1] == "/" else power)
        at = part.end()
    return found
