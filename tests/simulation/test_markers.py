"""Markers stand where the closed form of the body's shape has them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import gtr_jax as gtr
from gtr_jax.simulation.markers import marker_places

OFFSET = [0.003, -0.01, 0.025]


@pytest.fixture
def marked(make_config):
    def build(resolution=1.0, **rest):
        markers = [
            {"name": "m1", "at": 0.1291, "offset": OFFSET},
            {"name": "end", "at": 0.25, "offset": OFFSET, "angle_from": 0.1},
        ]
        return gtr.build_robot(make_config(markers=markers, **rest), resolution=resolution)

    return build


def hat(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def test_on_an_arc(marked):
    robot = marked(
        routing={"kind": "parallel", "offset": 0.008},
        tendon={"friction_coefficient": 0.0},
        backbone={"outer_radius": 0.012},
    )
    run = gtr.simulate(robot, jnp.array([0.0, 5.0]))
    for k in range(2):
        kappa = float(run.curvature[k, 0])
        turns = [kappa * 0.1291, kappa * 0.15]
        np.testing.assert_allclose(gtr.marker_angles(robot, run)[k], turns, atol=1e-9)
        for i, at in enumerate((0.1291, 0.25)):
            angle = kappa * at
            middle = [np.sin(angle) / kappa, (1 - np.cos(angle)) / kappa] if kappa else [at, 0.0]
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            want = [*(np.array(middle) + turn @ OFFSET[:2]), OFFSET[2]]
            np.testing.assert_allclose(marker_places(robot, run)[k, i], want, atol=2e-9)


def test_on_a_body_that_is_a_helix_at_rest(marked):
    body = {"natural_twist": 4.0, "natural_curvature_y": -6.0, "natural_curvature": 9.0}
    robot = marked(routing={"kind": "straight", "radius": 0.008, "angle": 1.0}, backbone=body)
    run = gtr.simulate(robot, jnp.array([0.0]))
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[0, 3] = hat([4.0, -6.0, 9.0]), 1.0
    turned = expm(twist * 0.15)[:3, 0]
    assert float(gtr.marker_angles(robot, run)[0, 1]) == pytest.approx(np.arccos(turned[0]), abs=1e-6)
    for i, at in enumerate((0.1291, 0.25)):
        want = expm(twist * at) @ [*OFFSET, 1.0]
        np.testing.assert_allclose(
            marker_places(robot, run)[0, i], want[:3], atol=1e-7
        )  # 4e-7 of L: the mesh


@pytest.mark.slow
def test_gradients_of_a_place_agree_with_differences(marked):
    robot = marked(routing={"kind": "helix", "radius": 0.008, "turns": 0.75})

    def height(E):
        changed = robot.with_values(E=E)
        return marker_places(changed, gtr.simulate(changed, jnp.array([0.0, 6.0])))[1, 0, 2]

    E, h = 1.0e6, 1e2
    slope = (height(E + h) - height(E - h)) / (2 * h)
    assert float(jax.grad(height)(E)) == pytest.approx(float(slope), rel=1e-5)
