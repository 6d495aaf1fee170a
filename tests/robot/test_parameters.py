"""Named parameters: read, replaced, refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.robot.parameters import parameter
from tests.conftest import ROUTINGS


@pytest.mark.parametrize("name", list(ROUTINGS))
def test_every_parameter_reads_back_and_matches_the_file(name, make_config):
    config = make_config(
        routing=ROUTINGS[name], backbone={"bores": [{"from": 0.0, "to": 0.02, "diameter": 0.01}]}
    )
    robot = gtr.build_robot(config)
    numbers = config.numbers()
    for entry in gtr.parameters_of(robot).values():
        if entry.key in numbers:
            assert float(robot.value(entry.name)) == pytest.approx(numbers[entry.key])
        value = max(0.0123, entry.lower or 0.0)
        changed = robot.with_values(**{entry.name: value})
        assert float(changed.value(entry.name)) == pytest.approx(value), entry.name


def test_a_tip_force_switches_the_loads_on(make_robot):
    robot = make_robot()
    assert not robot.loaded and robot.with_values(tip_force_y=0.1).loaded
    assert not robot.with_values(mu=0.1).loaded


def test_unknown_name_names_the_nearest(make_robot):
    with pytest.raises(gtr.InputError, match=r"'ofset' does not exist.*did you mean 'offset'"):
        make_robot().with_values(ofset=0.01)


def test_the_modulus_of_a_rigid_sheath_is_refused(make_robot):
    robot = make_robot(
        routing={"kind": "parallel", "offset": 0.0}, backbone={"rigid": True, "natural_curvature": 3.0}
    )
    with pytest.raises(gtr.InputError, match="rigid"):
        parameter(robot, "E")


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"E": -1e6}, "parameter 'E': must be above 0 Pa, is -1e+06"),
        ({"backbone.youngs_modulus": 0}, "parameter 'E': must be above 0 Pa, is 0"),
        ({"mu": -0.1}, "parameter 'mu': must be at least 0, is -0.1"),
        ({"length": np.array([0.2, -0.2])}, "parameter 'length': must be above 0 m, is"),
        ({"E": float("nan")}, "parameter 'E': must be above 0 Pa, is nan"),
        ({"offset": float("nan")}, "parameter 'offset': is not a number"),
        ({"E": 10**400}, "parameter 'E': expected a number, found 1000"),
        ({"E": "1 MPa"}, "parameter 'E': expected a number, found 1 MPa"),
        ({"tip-gain.gain": -1.5}, "parameter 'tip-gain.gain': must be"),
    ],
)
def test_values_that_no_robot_has_are_refused(make_robot, values, says):
    with pytest.raises(gtr.InputError) as refused:
        make_robot().with_values(**values)
    assert says in str(refused.value)


def test_what_may_vanish_may(make_robot):
    robot = make_robot().with_values(mu=0.0, density=0, **{"presliding.length": 0.0})
    assert float(robot.value("mu")) == 0.0 == float(robot.value("density"))


def test_traced_values_are_taken_as_they_are(make_robot):
    robot = make_robot()

    def modulus(E):
        return robot.with_values(E=E).value("E")

    assert float(jax.grad(modulus)(-3.0)) == 1.0
    assert float(jax.jit(modulus)(-3.0)) == -3.0
    np.testing.assert_array_equal(jax.vmap(modulus)(jnp.array([-1.0, 2.0])), [-1.0, 2.0])
