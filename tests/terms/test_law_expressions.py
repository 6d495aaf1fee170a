"""The expressions of laws: grammar, units, values and derivatives, and what is refused, in one line."""

import math
import string
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import numbers

from gtr_jax.dimension import NONE, Dimension, dimension_of_unit
from gtr_jax.errors import InputError
from gtr_jax.terms.expression import FLOOR, dimension_of, evaluate
from gtr_jax.terms.grammar import MOST_CHARACTERS, ExpressionError, names_in, parsed
from gtr_jax.terms.law import ACTS, CELLS, VARIABLES, Law, check_law, is_odd, term_of_law
from gtr_jax.units import parse_any

X = {"x": 0.7, "y": -1.3, "a": 2.5}


@pytest.mark.parametrize(
    ("text", "python"),
    [
        ("1 + 2*3", "1 + 2*3"),
        ("2 - 3 - 4", "2 - 3 - 4"),
        ("8 / 4 / 2", "8 / 4 / 2"),
        ("2^3^2", "2**3**2"),
        ("-x^2", "-(x**2)"),
        ("2^-1", "2**-1"),
        ("a ** 2 * y", "a**2 * y"),
        ("(x + y) * a", "(x + y) * a"),
        ("- - x", "x"),
        ("+x·a − y", "x*a - y"),
        ("1.5e-3 + .5 + 2.", "1.5e-3 + .5 + 2."),
        ("exp(-x) * sqrt(a) / log(a)", "math.exp(-x) * math.sqrt(a) / math.log(a)"),
        ("abs(y) + sign(y) + step(y) + step(x)", "abs(y) - 1 + 0 + 1"),
        ("sin(x) + cos(y) + tanh(a) + atan(y)", "math.sin(x) + math.cos(y) + math.tanh(a) + math.atan(y)"),
        ("min(x, y) - max(x, max(y, a))", "min(x, y) - max(x, y, a)"),
        ("a^x", "a**x"),
        ("sin(2 * pi * x)", "math.sin(2 * math.pi * x)"),
    ],
)
def test_an_expression_has_the_value_of_python(text, python):
    expected = eval(python, {"math": math, "min": min, "max": max, "abs": abs} | X)
    for xp in (np, jnp):
        assert float(evaluate(parsed(text), X, xp)) == pytest.approx(expected, rel=1e-14)
    assert names_in(parsed(text)) <= X.keys()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("   ", "is empty"),
        ("x +", "expected a number, a name or '(' after 'x +', found its end"),
        ("x y", "expected an operator before 'y' after 'x'"),
        ("(x", "expected ')' after '(x', found its end"),
        ("x)", "expected an operator before ')'"),
        ("exp(x, y)", "exp takes 1 argument, not 2"),
        ("max(x)", "max takes 2 arguments, not 1"),
        ("exq(x)", "no function 'exq'; did you mean 'exp'"),
        ("exp", "exp is a function; write exp(...)"),
        ("x % 2", "cannot read '% 2'"),
        ("x.real", "cannot read '.real'"),
        ("__import__('os')", "cannot read ''os')'"),
        ("__import__(x)", "no function '__import__'"),
        ("x[0]", "cannot read '[0]'"),
        ("lambda: x", "cannot read ': x'"),
        ("x == 1", "cannot read '== 1'"),
        ("x; y", "cannot read '; y'"),
        ("x\n= 3", "cannot read '= 3'"),
        ("1e400 * x", "1e400 is above 1e"),
        ("9" * 390, "is above 1e"),
        ("(" * 150 + "x" + ")" * 150, "is nested deeper than 25 levels"),
        ("-" * 300 + "x", "is nested deepe"),
        ("x" + "^x" * 150, "is nested deepe"),
        ("exp(" * 90 + "x" + ")" * 3, "is nested deepe"),
        ("x" * (MOST_CHARACTERS + 1), f"has {MOST_CHARACTERS + 1} characters"),
        ("x\0", "cannot read"),
        ("é", "cannot read 'é'"),
    ],
)
def test_what_is_no_expression_is_refused(text, says):
    with pytest.raises(ExpressionError) as caught:
        parsed(text)
    assert says in str(caught.value)


def test_random_texts_are_read_or_refused():
    draw = np.random.default_rng(5)
    letters = [*"xyT+-*/^(),.0123456789 e", *string.punctuation, "exp(", "max(", "**", "é"]
    read = 0
    for _ in range(3000):
        text = "".join(draw.choice(letters, draw.integers(1, 40)))
        try:
            tree = parsed(text)
        except ExpressionError as fault:
            assert "\n" not in str(InputError(str(fault)))
        else:
            with np.errstate(all="ignore"):
                assert np.shape(evaluate(tree, dict.fromkeys(names_in(tree), 0.5), np)) == ()
            read += 1
    assert read > 20


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        ("N", (1, 0, 0)),
        ("N/m", (1, -1, 0)),
        ("1/s", (0, 0, -1)),
        ("kg/m^3", (1, -4, 2)),
        ("N s/m^2", (1, -2, 1)),
        ("Pa m", (1, -1, 0)),
        ("rad/m", (0, -1, 0)),
        ("m^0.5", (0, 0.5, 0)),
        ("dimensionless", (0, 0, 0)),
    ],
)
def test_a_unit_is_its_exponents_and_back(unit, expected):
    found = dimension_of_unit(unit)
    assert found is not None
    assert found == Dimension(*(Fraction(power) for power in expected))
    assert dimension_of_unit(found.unit) == found


@pytest.mark.parametrize("unit", ["bogus", "N^^2", "N/", "m^9999", "N)", "__import__"])
def test_what_is_no_unit_has_no_exponents(unit):
    assert dimension_of_unit(unit) is None


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("2 N/m", "N/m", 2.0),
        ("0.1 N/mm", "N/m", 100.0),
        ("3 mm/s", "m/s", 3e-3),
        ("30 deg", "rad", math.pi / 6),
        ("2 kN s/m^2", "N s/m^2", 2000.0),
        ("1 gf/cm", "N/m", 0.980665),
        (0.3, "dimensionless", 0.3),
        ("0.3", "dimensionless", 0.3),
    ],
)
def test_any_quantity_is_read_with_its_unit(text, unit, value):
    found, number = parse_any(text)
    assert found == unit
    assert number == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("2 bogus", "unknown unit 'bogus'"),
        ("2 K", "'K' is not made of force, length and time"),
        ("2 9**9**9", "unknown unit"),
        ("two", "cannot read 'two'"),
        (True, "expected a pure numbe"),
        ([1], "expected a pure numbe"),
        (float("nan"), "not a finite numbe"),
        ("1e31 N", "more than can be computed with"),
    ],
)
def test_what_is_no_quantity_of_force_length_and_time_is_refused(text, says):
    with pytest.raises(InputError) as caught:
        parse_any(text)
    assert says in str(caught.value)


UNITS = {"p": "N/m", "T": "N", "v": "m/s", "s": "m", "c": "dimensionless", "q": "N/m"}
KNOWN = {name: dimension_of_unit(unit) or NONE for name, unit in UNITS.items()}


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("T / s", "N/m"),
        ("p + T / s", "N/m"),
        ("max(p, 0) - 0", "N/m"),
        ("exp(-p / q)", "dimensionless"),
        ("sqrt(T * p * s)", "N"),
        ("T^(1/2)", "N^0.5"),
        ("v^-2", "s^2/m^2"),
        ("(p / q)^c", "dimensionless"),
        ("step(T) + sign(s)", "dimensionless"),
        ("abs(-v)", "m/s"),
        ("T * 0", "N"),
    ],
)
def test_units_of_expressions(text, unit):
    assert dimension_of(parsed(text), KNOWN) == dimension_of_unit(unit)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("p + T", "'p + T' adds N/m and N"),
        ("1 + p", "'1 + p' adds dimensionless and N/m"),
        ("max(p, 1)", "compares N/m and dimensionless"),
        ("exp(p)", "exp takes a pure number, and 'exp(p)' gives it one in N/m"),
        ("sin(s)", "sin takes a pure numbe"),
        ("p^c", "raises N/m to a power that may vary"),
        ("c^p", "the exponent in 'c^p' is in N/m"),
        ("T^99", "the exponent in 'T^99' exceeds 12"),
        ("c^1e9", "the exponent in 'c^1e9' exceeds 12"),
    ],
)
def test_units_that_do_not_fit_are_refused(text, says):
    with pytest.raises(ExpressionError) as caught:
        dimension_of(parsed(text), KNOWN)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        *("sqrt(x)", "log(x)", "x^0.5", "x^-1", "1/x", "abs(x)", "x^c", "x/x", "sin(x)/x"),
        *("sqrt(x)/x", "exp(1/x)", "x^2.5", "1/x^3", "max(x, 0)^0.5", "exp(1e3*x)", "sign(x)"),
    ],
)
def test_values_and_gradients_are_finite_where_solvers_go(text):
    tree = parsed(text)

    def value(x, c):
        return evaluate(tree, {"x": x, "c": c}) + 0.0 * c

    both = jax.jit(jax.vmap(jax.value_and_grad(value, (0, 1))))
    x = jnp.asarray([0.0, -0.0, FLOOR, 1e-300, -1.0, 1e-12, 1.0, 1e6])
    for each in jax.tree_util.tree_leaves(both(x, jnp.full_like(x, 0.5))):
        assert bool(jnp.all(jnp.isfinite(each)))


@pytest.mark.parametrize(
    "text",
    [
        *("x^c", "x^3 - 2*x", "sqrt(x)*exp(-x/c)", "tanh(x/c)", "log(1 + x^2)", "min(x, c)*max(x, c)"),
        *("atan(x)/x", "abs(x - c)", "cos(x)^2"),
    ],
)
def test_gradients_of_expressions_against_differences(text):
    tree, at, step = parsed(text), jnp.asarray([0.8, 1.7]), 1e-6

    def value(z):
        return evaluate(tree, {"x": z[0], "c": z[1]})

    found = jax.grad(value)(at)
    ways = step * jnp.eye(2)
    expected = [(value(at + way) - value(at - way)) / (2 * step) for way in ways]
    np.testing.assert_allclose(found, jnp.asarray(expected), rtol=1e-7, atol=1e-9)


def law(acts, text, name="own", **given):
    return Law(name, acts, text, numbers(acts, **given))


GOOD = [
    ("friction", "1 + size * exp(-p / q)", {"size": "dimensionless", "q": "N/m"}),
    ("friction", "exp(size * sin(2 * pi * s / period))", {"size": "dimensionless", "period": "m"}),
    (
        "friction",
        "1 + size * tanh(T / soft) * (1 - exp(-t / late)) * n",
        dict.fromkeys(["size"], "dimensionless") | {"soft": "N", "late": "s"},
    ),
    ("viscous", "size * v^(1/2)", {"size": "s^0.5/m^0.5"}),
    ("drag", "size * (1 + v / fast)", {"size": "N/m", "fast": "m/s"}),
    ("bending", "size * k * abs(k)", {"size": "m"}),
    ("strain", "size * sqrt(T / soft)", {"size": "dimensionless", "soft": "N"}),
    ("tip_cell", "T + size * sin(T / period)", {"size": "N", "period": "N"}),
    ("base_cell", "T * (1 + size * T)", {"size": "1/N"}),
    (
        "tip_response",
        "size * exp(-l / late) * sin(l / swing)",
        {"size": "dimensionless", "late": "s", "swing": "s"},
    ),
    ("base_response", "-size * exp(-l / late)", {"size": "dimensionless", "late": "s"}),
]


@pytest.mark.parametrize(("acts", "text", "given"), GOOD, ids=[f"{g[0]}: {g[1]}" for g in GOOD])
def test_a_law_that_can_be_one_is_a_term(acts, text, given):
    own = law(acts, text, **given)
    check_law(own, {q.name: q.typical for q in own.numbers} | {"size": 0.01})
    term = term_of_law(own)
    assert term is term_of_law(law(acts, text, **given))
    assert [q.name for q in term.sizes] == ["size"]
    assert text in term.law
    assert term.of_cells == (acts in CELLS)
    assert term.timed == bool(own.variables & {"t", "v", "l"})


@pytest.mark.parametrize(
    ("acts", "text", "given", "says"),
    [
        ("friction", "1 + size * k", {"size": "m"}, "k is not known to friction, which knows p, T, v"),
        ("bending", "size * T", {"size": "1/(N m)"}, "T is not known to bending, which knows k"),
        ("friction", "1 + sise * n", {"size": "dimensionless"}, "unknown name 'sise'; did you mean 'size'"),
        ("friction", "1 + size * n", {"size": "dimensionless", "q": "N"}, "does not contain its parameter q"),
        ("friction", "1 + size * T * T0", {"size": "1/N", "T0": "N"}, "adds dimensionless and N"),
        ("drag", "size * T", {"size": "N/m"}, "is in N^2/m, but drag needs N/m"),
        ("friction", "size * n", {"size": "dimensionless"}, "with size = 0 gives 0 at n = 0 instead of 1"),
        ("drag", "q + size", {"size": "N/m", "q": "N/m"}, "with size = 0 gives 1 instead of 0"),
        ("tip_cell", "size", {"size": "N"}, "with size = 0 gives 0 instead of T"),
        ("friction", "1 + 0 * size * n", {"size": "dimensionless"}, "has no effect at size = 1"),
        ("viscous", "size * exp(-v / q)", {"size": "dimensionless", "q": "m/s"}, "gives 1 at v = 0"),
        ("base_cell", "T - size * T", {"size": "dimensionless"}, "rises by less than 0.1 N per N"),
        ("drag", "size * T", {"size": "1/m", "T": "N"}, "a parameter cannot be called T"),
        ("drag", "size * exp", {"size": "N/m"}, "exp is a function"),
        ("drag", "size * exp(q * 1e30)^12", {"size": "N/m", "q": "dimensionless"}, "not finite"),
    ],
)  # fmt: skip
def test_a_law_that_cannot_be_one_is_refused(acts, text, given, says):
    with pytest.raises(ExpressionError) as caught:
        own = law(acts, text, **given)
        check_law(own, {q.name: q.typical for q in own.numbers})
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_every_place_says_what_is_neutral_and_knows_its_variables():
    for acts, place in ACTS.items():
        assert {*place.variables} <= {*VARIABLES}
        assert dimension_of_unit(place.unit) is not None
        assert place.neutral in (0.0, 1.0, "T"), acts


@pytest.mark.parametrize(
    ("text", "odd"),
    [("size * k^3", True), ("size * k * abs(k)", True), ("size * k^2", False), ("size * max(k, 0)", False)],
)
def test_whether_a_bending_law_is_odd(text, odd):
    assert is_odd(law("bending", text, size="m")) == odd
