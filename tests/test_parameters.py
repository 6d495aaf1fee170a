"""Named parameters: read, replaced, refused."""

import pytest

import gtr_jax as gtr
from gtr_jax.parameters import parameter
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
        changed = robot.with_values(**{entry.name: 0.0123})
        assert float(changed.value(entry.name)) == pytest.approx(0.0123), entry.name


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
