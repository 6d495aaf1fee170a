"""Expressions of laws: their unit and their value.

Values and derivatives stay finite wherever a solver may go: next to zero, roots, logarithms, powers and
quotients go on as at `FLOOR`.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from types import ModuleType
from typing import Any

import jax.numpy as jnp

from gtr_jax.dimension import NONE, Dimension

from .grammar import Apply, ExpressionError, Name, Node, Number

FLOOR = 1e-30  # in SI: what is smaller counts as zero
STEEPEST = 60.0  # largest argument of exp, and largest logarithm of a power
LARGEST_POWER = 12


def dimension_of(node: Node, known: Mapping[str, Dimension]) -> Dimension:
    """The dimension of an expression, from those of its variables and parameters.

    Raises:
        ExpressionError: its parts do not fit, or a name is not known.
    """
    return _dimension(node, known) or NONE


def _dimension(node: Node, known: Mapping[str, Dimension]) -> Dimension | None:
    """As `dimension_of`; None for the number 0, which has any."""
    if isinstance(node, Number):
        return NONE if node.value else None
    if isinstance(node, Name):
        return known[node.name]
    if node.op == "^":
        return _of_power(node, known)
    parts = [_dimension(part, known) for part in node.parts]
    if node.op in ("*", "/"):
        left, right = (NONE if part is None else part for part in parts)
        return left.times(right, 1 if node.op == "*" else -1)
    if node.op in ("+", "-", "min", "max"):
        return _common(node, parts)
    if node.op in ("neg", "abs"):
        return parts[0]
    if node.op in ("sign", "step"):
        return NONE
    (part,) = (NONE if part is None else part for part in parts)
    if node.op == "sqrt":
        return part.to(Fraction(1, 2))
    if part != NONE:
        raise ExpressionError(
            f"{node.op} takes a pure number, and '{node.text}' gives it one in {part.unit}; divide by a "
            "parameter of this unit"
        )
    return NONE


def _common(node: Apply, parts: list[Dimension | None]) -> Dimension | None:
    """The dimension that both parts have."""
    left, right = parts
    if left is not None and right is not None and left != right:
        word = "compares" if node.op in ("min", "max") else "adds"
        raise ExpressionError(
            f"'{node.text}' {word} {left.unit} and {right.unit}; bring both to one unit with a parameter"
        )
    return right if left is None else left


def _of_power(node: Apply, known: Mapping[str, Dimension]) -> Dimension:
    base, power = node.parts
    of_base, of_power = dimension_of(base, known), dimension_of(power, known)
    number = fixed(power)
    if of_power != NONE:
        raise ExpressionError(f"the exponent in '{node.text}' is in {of_power.unit}; make it a pure number")
    if number is not None and abs(number) > LARGEST_POWER:
        raise ExpressionError(
            f"the exponent in '{node.text}' exceeds {LARGEST_POWER}; write a smaller one, or use exp"
        )
    if of_base == NONE:
        return NONE
    if number is None:
        raise ExpressionError(
            f"'{node.text}' raises {of_base.unit} to a power that may vary; divide the base by a parameter "
            "of this unit"
        )
    return of_base.to(Fraction(number).limit_denominator(1000))


def fixed(node: Node) -> float | None:
    """The number that an expression without names of at most a sign and a quotient is; None for others."""
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return None
    parts = [fixed(part) for part in node.parts]
    if node.op == "neg" and parts[0] is not None:
        return -parts[0]
    if node.op == "/" and parts[0] is not None and parts[1]:
        return parts[0] / parts[1]
    return None


def evaluate(node: Node, values: Mapping[str, Any], xp: ModuleType = jnp) -> Any:
    """The value of an expression; arrays broadcast.

    Args:
        node: the expression.
        values: of its variables and parameters [SI].
        xp: jax.numpy, or numpy.
    """
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        return values[node.name]
    if node.op == "^" and (whole := fixed(node.parts[1])) is not None and whole == int(whole):
        power = _whole_power(evaluate(node.parts[0], values, xp), abs(int(whole)))
        one, power = xp.asarray(1.0), xp.asarray(power, dtype=float)
        return power if whole >= 0 else _joined("/", one, power, xp)
    return _applied(node.op, [evaluate(part, values, xp) for part in node.parts], xp)


def _whole_power(base: Any, power: int) -> Any:
    """A power by products, which has its derivatives at zero and below."""
    product = 1.0
    for _ in range(power):
        product = product * base
    return product


def _applied(op: str, parts: list[Any], xp: ModuleType) -> Any:
    a = xp.asarray(parts[0], dtype=float)
    if op in ("+", "-", "*", "/", "^", "min", "max"):
        return _joined(op, a, xp.asarray(parts[1], dtype=float), xp)
    if op == "neg":
        return -a
    if op == "exp":
        return xp.exp(xp.where(a < STEEPEST, a, STEEPEST))
    if op == "step":
        return xp.where(a > 0, 1.0, 0.0)
    if op == "atan":
        return xp.arctan2(a, xp.ones_like(a))
    if op in ("sqrt", "log"):
        safe = xp.where(a > FLOOR, a, FLOOR)
        return xp.log(safe) if op == "log" else xp.where(a > FLOOR, xp.sqrt(safe), 0.0)
    return getattr(xp, op)(a)  # abs, sign, sin, cos, tanh


def _joined(op: str, a: Any, b: Any, xp: ModuleType) -> Any:
    if op == "+":
        return a + b
    if op == "-":
        return a - b
    if op == "*":
        return a * b
    if op == "min":
        return xp.where(a < b, a, b)
    if op == "max":
        return xp.where(a > b, a, b)
    if op == "/":
        small = xp.abs(b) < FLOOR
        return a / xp.where(small, xp.where(b < 0, -FLOOR, FLOOR), b)
    positive = a > FLOOR
    steps = b * xp.log(xp.where(positive, a, FLOOR))
    there = xp.exp(xp.where(steps < STEEPEST, steps, STEEPEST))
    return xp.where(positive | (b <= 0), there, 0.0)
