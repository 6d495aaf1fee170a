"""`design.pose_sensitivity`: derivatives of the tip against differences, with their units."""

import numpy as np
import pytest

import design
import gtr_jax as gtr
from tests.conftest import PARALLEL, SINE

T_BASE = 20.0


def differences(robot, name, step):
    """Central differences of pose and tip tension by one parameter."""
    value = float(robot.value(name))
    ends = []
    for h in (step, -step):
        eq = gtr.equilibrium(robot.with_values(**{name: value + h}), T_BASE)
        ends.append(np.append(np.asarray(eq.tip_pose), float(eq.T_tip)))
    return (ends[0] - ends[1]) / (2 * step)


def test_derivatives(make_robot):
    robot = make_robot(routing=SINE)
    table = design.pose_sensitivity(robot, T_BASE)
    names = [p.name for p in table.parameters]
    assert {"r1", "r2", "w1", "w2", "E", "length"} <= set(names)
    assert "mu" not in names
    assert table.converged
    for name in ("r1", "r2", "w1", "w2", "E"):
        step = 1e-5 * abs(float(robot.value(name)))
        found = [table[output, name] for output in table.outputs]
        assert found == pytest.approx(differences(robot, name, step), rel=1e-5, abs=1e-9)


def test_closed_form(make_robot):
    """Parallel tendon, no load: phi(L) = ln(1 + mu R T L/EI)/mu, so d phi/dE and d phi/dR are known."""
    robot = make_robot(
        routing=PARALLEL, backbone={"outer_radius": [0.012, 0.012]}, tendon={"friction_coefficient": 0.3}
    )
    mu, R, L, E = 0.3, 0.008, 0.25, 1.06e6
    I = np.pi * 0.012**4 / 4
    x = mu * R * T_BASE * L / (E * I)
    table = design.pose_sensitivity(robot, T_BASE, ("E", "routing.offset", "mu"))
    assert table.values[2] == pytest.approx(np.log1p(x) / mu, rel=1e-6)
    assert table["tip_angle", "E"] == pytest.approx(-x / E / (1 + x) / mu, rel=1e-6)
    assert table["tip_angle", "offset"] == pytest.approx(x / R / (1 + x) / mu, rel=1e-6)
    assert table["T_tip", "mu"] == pytest.approx(-T_BASE * x / mu / (1 + x) ** 2, rel=1e-6)


def test_units_and_rows(make_robot):
    table = design.pose_sensitivity(
        make_robot(routing=PARALLEL), T_BASE, ("offset", "mu", "natural_curvature")
    )
    assert table.unit("tip_angle", "offset") == "rad/m"
    assert table.unit("tip_x", "offset") == ""
    assert table.unit("T_tip", "mu") == "N"
    assert table.unit("tip_x", "natural_curvature") == "m/(rad/m)"
    row = table.rows()[0]
    assert row["parameter"] == "offset"
    assert row["d tip_angle [rad/m]"] == table["tip_angle", "offset"]
    assert row["d tip_x [-]"] == table["tip_x", "offset"]


def test_unknown_names(make_robot):
    robot = make_robot(routing=PARALLEL)
    with pytest.raises(gtr.InputError, match="does not exist"):
        design.pose_sensitivity(robot, T_BASE, ("r7",))
    with pytest.raises(gtr.InputError, match="no parameter"):
        design.pose_sensitivity(robot, T_BASE, ())
