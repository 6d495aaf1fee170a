"""Exponential, logarithm, power and trigonometric functions as LLVM instructions.

The C library's functions take one number at a time: in four lanes, more than half of the time of a load
history with physics terms went into them. These take all lanes at once. They reduce
the argument as usual (Muller, Elementary Functions, 3rd ed. 2016, ch. 11: to |r| < ln 2 / 2 and |r| < pi / 4
by constants in parts whose products are exact; to a mantissa within sqrt(2) of 1; to |t| < tan(pi / 8)) and
use polynomials through the Chebyshev nodes of the rest, computed with 60 digits. Errors are below 3 units in
the last place; of a power below 2 + 2 |y ln x|, which counts the rounding of its exponent. Only `tanh` and
`atan2` keep the sign of zero, and powers and angles of two infinite numbers are NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir

from .values import DOUBLE, LONG, Writer

# (e^r - 1 - r - r^2/2) / r^3 on |r| < ln 2 / 2, relative error 5e-17.
EXP = (
    0.16666666666666669,
    0.041666666666666664,
    0.008333333333330065,
    0.0013888888888886554,
    0.00019841269863040545,
    2.4801587317135164e-05,
    2.7557268480310024e-06,
    2.755728298405588e-07,
    2.5100375832561234e-08,
    2.091122972975856e-09,
)
# (sin(r)/r - 1)/z and (cos r - 1 + z/2)/z^2 by z = r^2 on |r| < pi / 4, relative errors 7e-20 and 2e-20.
SIN = (
    -0.16666666666666666,
    0.008333333333333331,
    -0.00019841269841265065,
    2.7557319219339167e-06,
    -2.5052106232447578e-08,
    1.6058531618986147e-10,
    -7.586697117706918e-13,
)
COS = (
    0.041666666666666664,
    -0.0013888888888888887,
    2.4801587301584645e-05,
    -2.7557319221402824e-07,
    2.087675579108042e-09,
    -1.1470460887609959e-11,
    4.7458719020432915e-14,
)
# (atan(t)/t - 1)/z by z = t^2 on |t| < tan(pi / 8), relative error 1e-16.
ATAN = (
    -0.3333333333333333,
    0.1999999999999552,
    -0.14285714284666542,
    0.11111111015256361,
    -0.09090904578123903,
    0.07692183190826087,
    -0.06664511447381948,
    0.0585814891280221,
    -0.0508544973794026,
    0.03923165829558719,
    -0.01917688711906226,
)
# (atanh(s)/s - 1)/z by z = s^2 on |s| < (sqrt 2 - 1) / (sqrt 2 + 1), relative error 3e-18.
ATANH = (
    0.3333333333333333,
    0.2000000000000044,
    0.14285714285401807,
    0.11111111195856958,
    0.09090897820066453,
    0.07693119851407329,
    0.06634386569328443,
    0.06543313073920051,
)
# ln 2 and pi / 2 in parts, of which all but the last have 33 bits.
LN2 = (0.6931471804855391, 7.440617109802979e-11 + 2.0941744292700725e-21)
HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
# What lies beyond pi / 4, pi / 2 and pi as doubles.
BEYOND_PI = 1.2246467991473532e-16
# Added to a number of up to 2^51, it rounds to an integer, which then stands in the last bits.
ROUND = 1.5 * 2.0**52
ROUND_BITS = 0x4338000000000000
# Angles up to here are reduced by `HALF_PI` [rad].
FAR = 1e6


class _Scribe:
    """Arithmetic on elements of one type, whose numbers may be given as such."""

    def __init__(self, w: Writer, kind: ir.Type):
        self.w, self.kind, self.whole = w, kind, w.wide(LONG) if isinstance(kind, ir.VectorType) else LONG

    def value(self, a: Any) -> Any:
        return self.w.spread(DOUBLE(float(a)), self.kind) if isinstance(a, int | float) else a

    def long(self, a: int) -> Any:
        return self.w.spread(LONG(a), self.whole)

    def _done(self, name: str, a: Any, b: Any) -> Any:
        return getattr(self.w.at, name)(self.value(a), self.value(b), flags=("contract",))

    def add(self, a: Any, b: Any) -> Any:
        return self._done("fadd", a, b)

    def sub(self, a: Any, b: Any) -> Any:
        return self._done("fsub", a, b)

    def mul(self, a: Any, b: Any) -> Any:
        return self._done("fmul", a, b)

    def div(self, a: Any, b: Any) -> Any:
        return self.w.at.fdiv(self.value(a), self.value(b))

    def polynomial(self, z: Any, factors: Sequence[float]) -> Any:
        """Sum of factors[k] z^k, by Estrin's scheme, whose chain of operations is short."""
        terms: list[Any] = list(factors)
        while len(terms) > 1:
            pairs = [self.add(terms[k], self.mul(terms[k + 1], z)) for k in range(0, len(terms) - 1, 2)]
            terms = pairs + terms[2 * len(pairs) :]
            z = self.mul(z, z) if len(terms) > 1 else z
        return terms[0]

    def test(self, sign: str, a: Any, b: Any) -> Any:
        return self.w.at.fcmp_ordered(sign, self.value(a), self.value(b))

    def select(self, which: Any, yes: Any, no: Any) -> Any:
        return self.w.at.select(which, self.value(yes), self.value(no))

    def magnitude(self, a: Any) -> Any:
        return self.w.call("llvm.fabs", a)

    def with_sign(self, a: Any, of: Any) -> Any:
        return self.w.call("llvm.copysign", self.value(a), of)

    def bits(self, a: Any) -> Any:
        return self.w.at.bitcast(a, self.whole)

    def number(self, bits: Any) -> Any:
        return self.w.at.bitcast(bits, self.kind)

    def rounded(self, a: Any) -> tuple[Any, Any]:
        """The nearest integer as a number, and as an integer that is right in its last 52 bits."""
        lifted = self.add(a, ROUND)
        return self.sub(lifted, ROUND), self.bits(lifted)

    def power_of_two(self, k: Any) -> Any:
        """2^k of integers from -1022 to 1023."""
        return self.number(self.w.at.shl(self.w.at.add(k, self.long(1023)), self.long(52)))


def _exp_parts(s: _Scribe, x: Any) -> tuple[Any, Any, Any]:
    """e^x as (1 + p) times two powers of two."""
    x = s.select(s.test("<", x, -746.0), -746.0, x)
    x = s.select(s.test(">", x, 710.0), 710.0, x)
    k, bits = s.rounded(s.mul(x, 1 / math.log(2)))
    r = s.sub(s.sub(x, s.mul(k, LN2[0])), s.mul(k, LN2[1]))
    p = s.add(r, s.mul(s.mul(r, r), s.add(0.5, s.mul(r, s.polynomial(r, EXP)))))
    k = s.w.at.sub(bits, s.long(ROUND_BITS))
    half = s.w.at.ashr(k, s.long(1))
    return p, s.power_of_two(half), s.power_of_two(s.w.at.sub(k, half))


def _exp(s: _Scribe, x: Any) -> Any:
    p, one, other = _exp_parts(s, x)
    return s.mul(s.mul(s.add(1.0, p), one), other)


def _expm1(s: _Scribe, x: Any) -> Any:
    p, one, other = _exp_parts(s, s.select(s.test(">", x, 709.0), 709.0, x))
    scale = s.mul(one, other)
    near = s.add(s.mul(scale, p), s.sub(scale, 1.0))
    return s.select(s.test(">", x, 709.0), _exp(s, x), near)


def _log(s: _Scribe, x: Any) -> Any:
    w = s.w
    small = s.test("<", x, 2.0**-1022)
    bits = s.bits(s.select(small, s.mul(x, 2.0**54), x))
    root = s.long(0x3FE6A09E667F3BCD)  # the bits of sqrt(1/2)
    k = w.at.ashr(w.at.sub(bits, root), s.long(52))
    f = s.sub(s.number(w.at.sub(bits, w.at.shl(k, s.long(52)))), 1.0)
    k = s.sub(s.number(w.at.add(k, s.long(ROUND_BITS))), ROUND)
    k = s.select(small, s.sub(k, 54.0), k)
    q = s.div(f, s.add(2.0, f))
    z = s.mul(q, q)
    half = s.mul(s.mul(0.5, f), f)
    rest = s.mul(q, s.add(half, s.mul(2.0, s.mul(z, s.polynomial(z, ATANH)))))
    low = s.sub(half, s.add(rest, s.mul(k, LN2[1])))
    out = s.sub(s.mul(k, LN2[0]), s.sub(low, f))
    out = s.select(s.test("==", x, math.inf), math.inf, out)
    out = s.select(s.test("<", x, 0.0), math.nan, out)
    out = s.select(s.test("==", x, 0.0), -math.inf, out)
    return s.select(w.at.fcmp_unordered("uno", x, x), x, out)


def _log1p(s: _Scribe, x: Any) -> Any:
    u = s.add(1.0, x)
    out = s.sub(_log(s, u), s.div(s.sub(s.sub(u, 1.0), x), u))
    out = s.select(s.test("==", x, math.inf), math.inf, out)
    return s.select(s.test("==", x, -1.0), -math.inf, out)


def _tanh(s: _Scribe, x: Any) -> Any:
    size = s.magnitude(x)
    e = _expm1(s, s.mul(2.0, s.select(s.test(">", size, 22.0), 22.0, size)))
    return s.with_sign(s.div(e, s.add(e, 2.0)), x)


def _pow(s: _Scribe, x: Any, y: Any) -> Any:
    w, place = s.w, s.w.slot(s.kind)
    w.at.store(s.value(1.0), place)
    # Exponents at which a law does nothing are common.
    with w.at.if_then(w.any_lane(w.at.fcmp_unordered("!=", y, s.value(0.0)))):
        out = _exp(s, s.mul(y, _log(s, s.magnitude(x))))
        whole, half = (s.w.call("llvm.rint", a) for a in (y, s.mul(0.5, y)))
        odd = w.at.fcmp_unordered("!=", half, s.mul(0.5, y))
        negative = s.select(s.test("==", whole, y), s.select(odd, w.at.fneg(out), out), math.nan)
        out = s.select(s.test("<", x, 0.0), negative, out)
        one = w.at.or_(s.test("==", y, 0.0), s.test("==", x, 1.0))
        w.at.store(s.select(one, 1.0, out), place)
    return w.at.load(place, typ=s.kind)


def _turned(shift: int, name: str) -> Callable[[_Scribe, Any], Any]:
    """The sine of an angle, or of it and `shift` quarter turns."""

    def write(s: _Scribe, x: Any) -> Any:
        w = s.w
        n, bits = s.rounded(s.mul(x, 2 / math.pi))
        r = x
        for part in HALF_PI:
            r = s.sub(r, s.mul(n, part))
        z = s.mul(r, r)
        sine = s.add(r, s.mul(s.mul(r, z), s.polynomial(z, SIN)))
        cosine = s.sub(1.0, s.sub(s.mul(0.5, z), s.mul(s.mul(z, z), s.polynomial(z, COS))))
        quarter = w.at.add(bits, s.long(shift))

        def has(bit: int) -> Any:
            return w.at.icmp_signed("!=", w.at.and_(quarter, s.long(bit)), s.long(0))

        near = s.select(has(1), cosine, sine)
        near = s.select(has(2), w.at.fneg(near), near)
        far = w.at.fcmp_unordered(">", s.magnitude(x), s.value(FAR))
        place = w.slot(s.kind)
        w.at.store(near, place)
        with w.at.if_then(w.any_lane(far), likely=False):
            w.at.store(s.select(far, w.of_library(name, x), near), place)
        return w.at.load(place, typ=s.kind)

    return write


def _atan2(s: _Scribe, y: Any, x: Any) -> Any:
    w = s.w
    up, along = s.magnitude(y), s.magnitude(x)
    steep = s.test(">", up, along)
    most, least = s.select(steep, up, along), s.select(steep, along, up)
    wide = s.test(">", least, s.mul(math.tan(math.pi / 8), most))
    above = s.select(wide, s.sub(least, most), least)
    below = s.select(wide, s.add(least, most), s.select(s.test("==", most, 0.0), 1.0, most))
    t = s.div(above, below)
    z = s.mul(t, t)
    angle = s.add(t, s.mul(s.mul(t, z), s.polynomial(z, ATAN)))
    angle = s.select(wide, s.add(math.pi / 4, s.add(BEYOND_PI / 4, angle)), angle)
    angle = s.select(steep, s.sub(math.pi / 2, s.sub(angle, BEYOND_PI / 2)), angle)
    back = w.at.icmp_signed("<", s.bits(x), s.long(0))
    angle = s.select(back, s.sub(math.pi, s.sub(angle, BEYOND_PI)), angle)
    return s.with_sign(angle, y)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "exp": _exp,
    "expm1": _expm1,
    "log": _log,
    "log1p": _log1p,
    "sin": _turned(0, "sin"),
    "cos": _turned(1, "cos"),
    "tanh": _tanh,
    "atan2": _atan2,
    "pow": _pow,
}


def function(w: Writer, name: str, *args: Any) -> Any:
    """A function of `FUNCTIONS`, written once in a module for each type.

    Args:
        w: of the function that calls it.
        name: of the function.
        args: its arguments, all with lanes or none.
    """
    kind = args[0].type
    own = f"{name}.{w.lanes if isinstance(kind, ir.VectorType) else 1}"
    known = w.module.globals.get(own)
    if known is None:
        known = ir.Function(w.module, ir.FunctionType(kind, [kind] * len(args)), own)
        known.linkage = "internal"
        inside = Writer(w.module, known, None, w.lanes)
        inside.at.ret(FUNCTIONS[name](_Scribe(inside, kind), *known.args))
    return w.at.call(known, args)
