"""Mesh weights, routings and cross-sections against numpy and scipy."""

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.mechanics.mesh import build_mesh, cumulative, panel_table
from gtr_jax.robot.robot import distal_mass, lay_out
from tests.conftest import ROUTINGS, SINE, TABLE


@pytest.mark.parametrize("intervals", [1, 2, 3, 4, 5, 12])
def test_weights_are_exact_for_the_polynomials_their_nodes_allow(intervals):
    x, _, weights, _ = panel_table(intervals)
    for degree in range(min(intervals, 3) + 1):
        for i in range(1, intervals + 1):
            if degree > min(i, 3):
                continue
            got = sum(weights[i, j] * x[i - j] ** degree for j in range(min(i + 1, 4)))
            assert got == pytest.approx(
                (x[i] ** (degree + 1) - x[i - 1] ** (degree + 1)) / (degree + 1), abs=1e-14
            )


def test_cumulative_integral_over_panels_with_jumps():
    mesh = build_mesh(jnp.asarray([0.0, 0.3, 0.3, 1.0]), (8, 1, 12))
    values = np.where(np.arange(mesh.s.shape[0]) < 9, np.exp(np.asarray(mesh.s)), np.asarray(mesh.s) ** 3)
    total = float(cumulative(mesh.weights, jnp.asarray(values))[-1])
    assert total == pytest.approx(np.exp(0.3) - 1 + (1 - 0.3**4) / 4, rel=1e-5)


@pytest.mark.parametrize("name", list(ROUTINGS))
def test_derivatives_of_the_offset(name, make_robot):
    robot = make_robot(8.0, routing=ROUTINGS[name])
    at = lay_out(robot)
    length = robot.backbone.length
    R = robot.routing.offset(at.mesh.s, at.passed[0], length)
    h = 1e-6
    up, down = (robot.routing.offset(at.mesh.s + d, at.passed[0], length) for d in (h, -h))
    inner = slice(2, -2)
    np.testing.assert_allclose(((up.value - down.value) / (2 * h))[inner], R.slope[inner], atol=1e-6)
    np.testing.assert_allclose(((up.slope - down.slope) / (2 * h))[inner], R.second[inner], atol=2e-3)


def test_published_formulas_at_a_point(make_robot):
    def R(routing, s):
        robot = make_robot(routing=routing, backbone={"length": 0.4, "outer_radius": [0.03, 0.03]})
        passed = robot.routing.kinks()[:, None] <= s
        return float(robot.routing.offset(jnp.asarray([s]), passed, robot.backbone.length).value[0])

    wave = {"kind": "converging-sine", "R_max": 0.015, "r_min": 0.0075, "n_sine": 10, "sigma": 0.3}
    assert R(wave, 0.1) == pytest.approx((0.015 - 0.0075 * 0.25) * (1 + 0.3 * np.sin(2.5 * np.pi)))
    cross = {"kind": "crossing-sine", "R_max": 0.02, "r_min": 0.008, "n_sine": 5}
    assert R(cross, 0.1) == pytest.approx((0.02 - 0.012 * 0.25) * np.sin(1.25 * np.pi))
    path5 = {"kind": "straight-sine-straight", "r1": -0.014, "r2": 0.014, "w1": 0.04, "w2": 0.1}
    assert [R(path5, s) for s in (0.01, 0.07, 0.3)] == pytest.approx([-0.014, 0.0, 0.014], abs=1e-15)
    assert R(path5, 0.04 + 1e-9) == pytest.approx(-0.014), "continuous at w1, unlike eq. (21) as printed"


def test_table_is_the_not_a_knot_spline(make_robot):
    from scipy.interpolate import CubicSpline

    robot = make_robot(routing=TABLE)
    knots = np.asarray(TABLE["knots"])
    s = np.linspace(0, 0.25, 37)
    R = robot.routing.offset(jnp.asarray(s), jnp.zeros((0, 37), bool), robot.backbone.length)
    spline = CubicSpline(knots[:, 0], knots[:, 1])
    for order, got in enumerate(R):
        np.testing.assert_allclose(got, spline(s, order), atol=1e-12 * 1e3**order)


def test_mass_of_a_bored_cone(make_robot):
    robot = make_robot(
        routing=SINE,
        backbone={"bores": [{"from": 0.0, "to": 0.07, "diameter": 0.012}]},
        loads={"gravity_angle": 0.0},
    )
    cone = np.pi * 0.25 / 3 * (0.02**2 + 0.02 * 0.013 + 0.013**2)
    expected = (cone - np.pi * 0.006**2 * 0.07) * 1070
    assert float(distal_mass(robot, lay_out(robot))[0]) == pytest.approx(expected, rel=1e-12)


def test_coincident_and_touching_kinks_make_no_spurious_turn(make_robot):
    """A bore from the base to where the wave starts and one from where it ends: same wrap as kinks a
    micrometre apart.
    """
    wraps = []
    for gap in (0.0, 1e-6):
        bores = [
            {"from": 0.0, "to": SINE["w1"] - gap, "diameter": 0.014},
            {"from": SINE["w2"] + gap, "to": 0.25, "diameter": 0.014},
        ]
        wraps.append(
            float(gtr.equilibrium(make_robot(routing=SINE, backbone={"bores": bores}), 30.0).wrap[-1])
        )
    assert wraps[0] == pytest.approx(wraps[1], rel=1e-4)
