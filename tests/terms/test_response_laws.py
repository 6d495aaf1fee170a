"""Laws of how a load cell responds in time: the catalogue's lag, a closed form, and backwards."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import table

from gtr_jax.errors import InputError
from gtr_jax.simulation.sensing import cells_show, true_base
from gtr_jax.terms.expression import ExpressionError
from gtr_jax.terms.law import check_law
from tests.terms.test_law_expressions import law

T_BASE = np.concatenate([np.linspace(0, 30, 16), np.linspace(30, 4, 16)[1:], np.linspace(4, 16, 9)[1:]])
TIME = np.cumsum(np.random.default_rng(2).uniform(0.1, 0.3, len(T_BASE)))
TIME -= TIME[0]
LAG = {"law": "-size*exp(-l/time)", "size": 1.0, "time": "0.4 s"}
RINGING = {
    "law": "size*exp(-l/scale)*sin(2*pi*l/period)",
    "size": 0.6,
    "scale": "0.8 s",
    "period": "1.1 s",
}


def test_a_law_restates_the_lag_of_both_cells(make_robot):
    lag = make_robot(terms=[{"kind": "low-pass", "tip": "0.4 s", "base": "0.4 s"}])
    laws = [table(name=acts, acts=f"{acts}_response", **LAG) for acts in ("tip", "base")]
    ours = make_robot(terms=laws)
    T_tip = jnp.asarray(0.6 * T_BASE)
    expected, found = (
        cells_show(robot, jnp.asarray(T_BASE), T_tip, jnp.asarray(TIME)) for robot in (lag, ours)
    )
    assert float(jnp.max(jnp.abs(expected.T_tip - T_tip))) > 1.0
    for i in (0, 1):
        np.testing.assert_allclose(found[i], expected[i], atol=1e-5)
    np.testing.assert_allclose(true_base(ours, found.T_base, TIME), T_BASE, atol=1e-10)


def test_a_cell_that_rings_has_its_closed_form(make_robot):
    """The tension rises evenly within the first interval, and the cell swings as the integral says."""
    robot = make_robot(terms=[table(acts="tip_response", **RINGING)])
    time = np.concatenate([[0.0], 0.2 + 0.15 * np.arange(20)])
    T = np.where(time > 0, 5.0, 0.0)
    shown = cells_show(robot, jnp.asarray(T), jnp.asarray(T), jnp.asarray(time)).T_tip
    rate = -1 / 0.8 + 2j * np.pi / 1.1
    ends = [np.exp(rate * np.maximum(time - at, 0.0)) / rate for at in (0.0, 0.2)]
    expected = T + 0.6 * 5.0 * np.imag(ends[0] - ends[1]) / 0.2
    assert np.max(np.abs(expected - T)[1:]) > 1.0
    np.testing.assert_allclose(shown, expected, atol=1e-4)


def test_the_base_is_read_backwards_of_several_tendons_with_gradients(make_robot):
    tendons = [
        {"name": name, "friction_coefficient": 0.2, "routing": {"kind": "parallel", "offset": r}}
        for name, r in (("up", 0.008), ("down", -0.008))
    ]
    robot = make_robot(tendons=tendons, terms=[table(acts="base_response", **RINGING)])
    T = jnp.stack([jnp.asarray(T_BASE), 0.5 * jnp.asarray(T_BASE)[::-1]], axis=1)

    def shown(size):
        return cells_show(robot.with_values(**{"law.size": size}), T, T, jnp.asarray(TIME)).T_base

    def back(size):
        return true_base(robot.with_values(**{"law.size": size}), seen, TIME)

    seen = shown(0.6)
    assert float(jnp.max(jnp.abs(seen - T))) > 0.5
    np.testing.assert_allclose(back(0.6), T, atol=1e-10)
    slopes = [jax.jvp(f, (0.6,), (1.0,))[1] for f in (shown, back)]
    for f, slope in zip((shown, back), slopes, strict=True):
        differences = (f(0.6 + 1e-5) - f(0.6 - 1e-5)) / 2e-5
        np.testing.assert_allclose(slope, differences, atol=1e-6)


def test_a_response_without_lag_is_a_gain(make_robot):
    robot = make_robot(terms=[table(acts="tip_response", law="size*exp(0*l/late)", size=0.1, late="1 s")])
    T = jnp.asarray(T_BASE) + 3.0  # the cell starts settled
    shown = cells_show(robot, T, T, jnp.asarray(TIME)).T_tip
    np.testing.assert_allclose(shown, T + 0.1 * (T - 3.0), rtol=1e-12)


def test_one_sample_and_jumps_of_no_time(make_robot):
    robot = make_robot(terms=[table(acts="base_response", **RINGING)])
    for T, time in (([5.0], [0.0]), ([0.0, 2.0, 2.0, 3.0], [0.0, 0.5, 0.5, 1.0])):
        shown = cells_show(robot, jnp.asarray(T), jnp.asarray(T), jnp.asarray(time)).T_base
        np.testing.assert_allclose(true_base(robot, shown, np.asarray(time)), T, atol=1e-12)


@pytest.mark.parametrize("size", [-0.6, 0.6])
def test_a_cell_that_can_be_read_does_not_let_errors_grow(make_robot, size):
    """The same ringing about the other way would: it is refused."""
    ringing = {**RINGING, "size": size}
    if size < 0:
        with pytest.raises(InputError, match="cannot be read off the cell"):
            make_robot(terms=[table(acts="base_response", **ringing)])
        return
    robot = make_robot(terms=[table(acts="base_response", **ringing)])
    time = 0.05 * np.arange(600)
    T = 10.0 + 5.0 * np.sin(time)
    shown = cells_show(robot, jnp.asarray(T), jnp.asarray(T), jnp.asarray(time)).T_base
    noise = np.random.default_rng(1).normal(0.0, 5e-3, len(T))
    assert np.max(np.abs(true_base(robot, shown + noise, time) - T)) < 0.1


@pytest.mark.parametrize(
    ("acts", "text", "given", "says"),
    [
        (
            "tip_response",
            "size*t/late",
            {"size": "dimensionless", "late": "s"},
            "t is not known to tip_response",
        ),
        ("tip_cell", "T+size*l/late", {"size": "N", "late": "s"}, "l is not known to tip_cell"),
        ("base_response", "-2*size*exp(-l/a)", {"size": "dimensionless", "a": "s"}, "turns a step"),
        ("base_response", "-1.5*size*(1-exp(-l/a))", {"size": "dimensionless", "a": "s"}, "undoes it later"),
    ],
)
def test_responses_that_cannot_be_are_refused(acts, text, given, says):
    own = law(acts, text, **given)
    with pytest.raises(ExpressionError, match=says):
        check_law(own, {q.name: q.typical for q in own.numbers})
