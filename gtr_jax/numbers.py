"""Numbers for people: a value to as many digits as mean something, in the unit people write it in."""

from __future__ import annotations

import math

from .units import display_of

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
PLAIN = (1e-3, 1e6)  # sizes that are written without a power of ten


def number(value: float | None, unit: str = "", digits: int = 4) -> str:
    """A number with so many digits; a dash where there is none."""
    if value is None or value != value:
        return "–"
    text = f"{value:.{digits}g}"
    if "e+" in text and abs(value) < PLAIN[1]:
        text = f"{float(text):.0f}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa}·{_ten(int(exponent))}"
    return _with_unit(text, unit)


def measured(value: float | None, sd: float | None, unit: str = "", *, error: bool = True) -> str:
    """A value to the second digit of its standard error, and the error to two: 0.2767 ± 0.0020 N.

    Args:
        value, sd: in `unit`; without a standard error four digits of the value.
        error: whether to write the error too; without it the ends of an interval match its middle.
    """
    if value is None or value != value or sd is None or not math.isfinite(sd) or sd <= 0:
        return number(value, unit)
    power = 0
    if not PLAIN[0] <= max(abs(value), sd) < PLAIN[1]:
        power = math.floor(math.log10(max(abs(value), sd)))
    value, sd = value / 10.0**power, sd / 10.0**power
    places = 1 - math.floor(math.log10(float(f"{sd:.1e}")))
    parts = [f"{round(v, places):.{max(places, 0)}f}" for v in ((value, sd) if error else (value,))]
    if float(parts[0]) == 0.0:
        parts[0] = parts[0].lstrip("-")
    text = " ± ".join(parts)
    if power:
        text = f"({text})·{_ten(power)}" if error else f"{text}·{_ten(power)}"
    return _with_unit(text, unit)


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """An SI quantity in the unit people write it in; `unit` as in `gtr_jax.units.DIMENSIONS`, or ""."""
    display, size = display_unit(unit)
    return number(None if value is None else value / size, display, digits)


def measured_quantity(value: float | None, sd: float | None, unit: str, *, error: bool = True) -> str:
    """An SI quantity with its standard error, as `measured`, in the unit people write it in."""
    display, size = display_unit(unit)
    scaled, error_of_it = (None if v is None else v / size for v in (value, sd))
    return measured(scaled, error_of_it, display, error=error)


def display_unit(unit: str) -> tuple[str, float]:
    """The unit people write an SI unit in, "" for none, and its size in SI."""
    return ("", 1.0) if unit == "dimensionless" else display_of(unit)


def _ten(power: int) -> str:
    return "10" + str(power).translate(SUPERSCRIPT)


def _with_unit(text: str, unit: str) -> str:
    return f"{text} {unit}".strip().replace("-", "−")
