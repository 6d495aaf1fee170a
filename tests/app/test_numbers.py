"""Numbers as people read them: two digits of the error, one unit, a name for how a solution ended."""

import math

import numpy as np
import optimistix as optx
import pytest

import gtr_jax as gtr
from calibrate.report.fit import detectable, interval
from gtr_jax.examples import SIMULATED
from gtr_jax.numbers import measured, measured_quantity, number, quantity
from gtr_jax.terms import REGISTRY


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (0.36, 4.4e-6, "0.3600000 ± 0.0000044"),  # was "(3.600000 ± 0.000044)e−1"
        (0.2767, 0.00204, "0.2767 ± 0.0020"),
        (-8.684, 0.49, "−8.68 ± 0.49"),
        (9.996, 0.0996, "10.00 ± 0.10"),  # an error that rounds up to the next power of ten
        (123456.0, 5600.0, "123500 ± 5600"),
        (3.2e6, 5e4, "(3.200 ± 0.050)·10⁶"),
        (1e-9, 2.0, "0.0 ± 2.0"),
        (-1e-9, 2.0, "0.0 ± 2.0"),
        (10.002687422019243, None, "10"),
        (1.5, math.nan, "1.5"),
        (math.nan, 1.0, "–"),
    ],
)
def test_a_value_with_its_error(value, sd, text):
    assert measured(value, sd) == text


def test_what_is_printed_is_within_the_rounding_of_two_digits():
    rng = np.random.default_rng(3)
    for value, sd in zip(rng.normal(size=300), 10 ** rng.uniform(-4, 2, 300), strict=True):
        said, error = (float(part) for part in measured(value, sd).replace("−", "-").split(" ± "))
        assert abs(error / sd - 1) <= 0.051 and abs(said - value) <= 0.051 * sd


def test_a_quantity_has_one_unit_and_a_pure_number_none():
    assert measured_quantity(0.000405, 5e-6, "m") == "0.4050 ± 0.0050 mm"  # was "0.000405 ± 5e-06 m"
    assert measured_quantity(1.441e6, 6.8e3, "Pa") == "1.4410 ± 0.0068 MPa"
    assert quantity(0.0, "dimensionless") == "0" and quantity(0.0, "") == "0"  # was "0 dimensionless"
    assert quantity(0.25, "m") == "250 mm" and number(None) == "–"
    assert interval(0.0088, 0.0092, 1e-4, "m") == "8.80 to 9.20 mm"
    assert interval(0.26, 0.29, 0.0074, "") == "0.2600 to 0.2900"


def test_an_effect_beyond_its_usual_range_is_said_not_to_be_visible():
    usual = REGISTRY["tendon-stretch"].quantities[0]
    assert usual.unit == "1/N" and usual.usual[1] < 1.0
    absurd = detectable("tendon-stretch.compliance", 1.8e9, usual.unit)
    assert absurd.startswith("not visible at any usual size") and "10⁹" not in absurd
    assert detectable("tendon-stretch.compliance", 0.5 * usual.usual[1], usual.unit).endswith("1/N")
    assert detectable("tip-gain.gain", 0.02, "dimensionless") == "0.02"  # from a null of 1
    assert detectable("mu", 1e3, "") == "1000"


def test_a_result_prints_its_name():
    robot = gtr.load_robot(SIMULATED)
    eq = gtr.equilibrium(robot, 5.0)
    assert str(eq.result) == "successful" and bool(eq.result == optx.RESULTS.successful)
    run = gtr.simulate(robot, [0.0, 2.0, 5.0])
    assert str(run.result) == "3 successful"
    from gtr_jax.simulation.outcome import outcome

    assert str(outcome(optx.RESULTS.nonlinear_divergence)).startswith("nonlinear_divergence: ")
