"""Operations of JAX on one element, whose arguments all have lanes or none has, as LLVM instructions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from llvmlite import ir

from .functions import function
from .values import BOOL, DOUBLE, LONG, Untranslatable, Writer, kind_of, plain


def _is(a: Any, kind: ir.Type) -> bool:
    return plain(a.type) == kind


def _as(w: Writer, number: Any, a: Any) -> Any:
    """A number, in all lanes of another value."""
    return w.spread(number, a.type)


def _arithmetic(of_doubles: str, of_longs: str | None) -> Callable[..., Any]:
    def write(w: Writer, params: Any, a: Any, b: Any) -> Any:
        if _is(a, DOUBLE):
            return getattr(w.at, of_doubles)(a, b, flags=("contract",))
        if of_longs is None or not _is(a, LONG):
            raise Untranslatable(f"{of_doubles} of {a.type}")
        return getattr(w.at, of_longs)(a, b)

    return write


def _comparison(sign: str) -> Callable[..., Any]:
    def write(w: Writer, params: Any, a: Any, b: Any) -> Any:
        if _is(a, DOUBLE):
            compare = w.at.fcmp_unordered if sign == "!=" else w.at.fcmp_ordered
            return compare(sign, a, b)
        return w.at.icmp_signed(sign, a, b) if _is(a, LONG) else w.at.icmp_unsigned(sign, a, b)

    return write


def _function(name: str) -> Callable[..., Any]:
    """The C library's, faster for a single number, or one that takes all lanes at once."""

    def write(w: Writer, params: Any, *args: Any) -> Any:
        return w.of_library(name, *args) if w.lanes == 1 else function(w, name, *args)

    return write


def _larger(sign: str) -> Callable[..., Any]:
    """max or min; NaN if either argument is NaN."""

    def write(w: Writer, params: Any, a: Any, b: Any) -> Any:
        if not _is(a, DOUBLE):
            compare = w.at.icmp_unsigned if _is(a, BOOL) else w.at.icmp_signed
            return w.at.select(compare(sign, a, b), a, b)
        first = w.at.or_(w.at.fcmp_ordered(sign, a, b), w.at.fcmp_unordered("uno", a, a))
        return w.at.select(first, a, b)

    return write


def _sign(w: Writer, params: Any, a: Any) -> Any:
    zero, one, other = (_as(w, DOUBLE(k), a) for k in (0.0, 1.0, -1.0))
    negative = w.at.select(w.at.fcmp_ordered("<", a, zero), other, a)
    return w.at.select(w.at.fcmp_ordered(">", a, zero), one, negative)


def _power(w: Writer, params: Any, a: Any) -> Any:
    exponent = abs(params["y"])
    one = _as(w, DOUBLE(1.0), a)
    out, square = None, a
    while exponent:
        if exponent & 1:
            out = square if out is None else w.at.fmul(out, square)
        exponent >>= 1
        square = w.at.fmul(square, square) if exponent else square
    out = one if out is None else out
    return w.at.fdiv(one, out) if params["y"] < 0 else out


def _converted(w: Writer, params: Any, a: Any) -> Any:
    to = kind_of(params["new_dtype"])
    if _is(a, to):
        return a
    whole = w.wide(to) if isinstance(a.type, ir.VectorType) else to
    if to == DOUBLE:
        return w.at.uitofp(a, whole) if _is(a, BOOL) else w.at.sitofp(a, whole)
    if to == LONG:
        return w.at.zext(a, whole) if _is(a, BOOL) else w.at.fptosi(a, whole)
    if _is(a, DOUBLE):
        return w.at.fcmp_unordered("!=", a, _as(w, DOUBLE(0.0), a))
    return w.at.icmp_signed("!=", a, _as(w, LONG(0), a))


def _selected(w: Writer, params: Any, which: Any, *cases: Any) -> Any:
    if len(cases) != 2 or not _is(which, BOOL):
        raise Untranslatable("select_n of more than two")
    return w.at.select(which, cases[1], cases[0])


def _negated(w: Writer, params: Any, a: Any) -> Any:
    return w.at.fneg(a) if _is(a, DOUBLE) else w.at.neg(a)


def _finite(w: Writer, params: Any, a: Any) -> Any:
    return w.at.fcmp_ordered("<", w.call("llvm.fabs", a), _as(w, DOUBLE(math.inf), a))


def _absolute(w: Writer, params: Any, a: Any) -> Any:
    if _is(a, DOUBLE):
        return w.call("llvm.fabs", a)
    return w.at.select(w.at.icmp_signed("<", a, _as(w, LONG(0), a)), w.at.neg(a), a)


ELEMENTWISE: dict[str, Callable[..., Any]] = {
    "add": _arithmetic("fadd", "add"),
    "add_any": _arithmetic("fadd", "add"),
    "sub": _arithmetic("fsub", "sub"),
    "mul": _arithmetic("fmul", "mul"),
    "div": _arithmetic("fdiv", None),
    "rem": _arithmetic("frem", "srem"),
    "max": _larger(">"),
    "min": _larger("<"),
    "neg": _negated,
    "abs": _absolute,
    "sign": _sign,
    "square": lambda w, params, a: w.at.fmul(a, a, flags=("contract",)),
    "integer_pow": _power,
    "sqrt": lambda w, params, a: w.call("llvm.sqrt", a),
    "exp": _function("exp"),
    "expm1": _function("expm1"),
    "log": _function("log"),
    "log1p": _function("log1p"),
    "sin": _function("sin"),
    "cos": _function("cos"),
    "tanh": _function("tanh"),
    "atan2": _function("atan2"),
    "pow": _function("pow"),
    "eq": _comparison("=="),
    "ne": _comparison("!="),
    "lt": _comparison("<"),
    "le": _comparison("<="),
    "gt": _comparison(">"),
    "ge": _comparison(">="),
    "and": lambda w, params, a, b: w.at.and_(a, b),
    "or": lambda w, params, a, b: w.at.or_(a, b),
    "xor": lambda w, params, a, b: w.at.xor(a, b),
    "not": lambda w, params, a: w.at.not_(a),
    "is_finite": _finite,
    "select_n": _selected,
    "convert_element_type": _converted,
    "stop_gradient": lambda w, params, a: a,
    "copy": lambda w, params, a: a,
}
