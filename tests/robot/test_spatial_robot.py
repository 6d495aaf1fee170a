"""Spatial robots as their files describe them: channels, stiffnesses, loads, base, parameters; no
mechanics.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gtr_jax.robot import routing, spatial_routing
from gtr_jax.robot.rotation import quaternion_of, rotation_of
from tests.conftest import ROUTINGS

LENGTH = 0.25


def of(values):
    return jnp.asarray(values, dtype=float)


CHANNELS = {
    "helix": spatial_routing.Helix(of(0.008), of(1.25), of(0.5)),
    "converging helix": spatial_routing.Helix(of(0.012), of(-0.75), of(1.0), of(0.0055)),
    "straight": spatial_routing.Straight(of(0.007), of(2.1)),
    "curve": spatial_routing.curve_routing(
        np.linspace(0, LENGTH, 6),
        np.array([8.0, 2.0, -5.0, -6.0, 1.0, 4.0]) * 1e-3,
        np.array([0.0, 6.0, 4.0, -3.0, -6.0, 0.0]) * 1e-3,
    ),
    "turned sine": routing.CrossingSine(of(0.008), of(0.006), of(2.0), plane_angle=of(0.8)),
}


@pytest.mark.parametrize("name", list(CHANNELS))
def test_derivatives_of_the_offset_in_the_section(name):
    channel, h = CHANNELS[name], 1e-6
    s = jnp.linspace(0.01, 0.24, 57)
    r, up, down = (channel.section_offset(s + d, jnp.zeros((0, 57), bool), of(LENGTH)) for d in (0.0, h, -h))
    assert r.value.shape == r.slope.shape == r.second.shape == (57, 2)
    np.testing.assert_allclose((up.value - down.value) / (2 * h), r.slope, atol=1e-7)
    np.testing.assert_allclose((up.slope - down.slope) / (2 * h), r.second, atol=1e-3)


def test_a_helix_stands_where_the_formula_says():
    place = (
        CHANNELS["converging helix"].section_offset(of([0.1]), jnp.zeros((0, 1), bool), of(LENGTH)).value[0]
    )
    rho, phi = 0.012 - 0.0065 * 0.4, 1.0 - 2 * np.pi * 0.75 * 0.4
    np.testing.assert_allclose(place, [rho * np.cos(phi), rho * np.sin(phi)], rtol=1e-14)


def test_a_curve_meets_its_knots():
    curve = CHANNELS["curve"]
    r = curve.section_offset(curve.knots_s, jnp.zeros((0, 6), bool), of(LENGTH))
    np.testing.assert_allclose(r.value[:, 0], curve.knots_y, atol=1e-17)
    np.testing.assert_allclose(r.value[:, 1], curve.knots_z, atol=1e-17)


@pytest.mark.parametrize("name", list(ROUTINGS))
@pytest.mark.parametrize("angle", [0.0, 0.8, -2.0])
def test_every_planar_channel_turns_with_its_plane(name, angle, make_robot):
    channel = make_robot(routing=ROUTINGS[name]).routing
    s = jnp.linspace(0.0, LENGTH, 21)
    passed = channel.kinks()[:, None] <= s[None, :]
    flat = channel.offset(s, passed, of(LENGTH))
    turned = vars(channel) | {"plane_angle": of(angle)}
    place = type(channel)(**turned).section_offset(s, passed, of(LENGTH))
    for R, r in zip(flat, place, strict=True):
        np.testing.assert_allclose(r, np.outer(R, [np.cos(angle), np.sin(angle)]), rtol=1e-15, atol=1e-300)


def test_a_helix_has_no_offset_in_one_plane():
    with pytest.raises(TypeError, match="leaves the plane"):
        CHANNELS["helix"].offset(of([0.1]), jnp.zeros((0, 1), bool), of(LENGTH))


def test_half_waves_of_a_helix_are_two_per_turn():
    assert CHANNELS["converging helix"].half_waves(0.1, 0.2, LENGTH) == pytest.approx(2 * 0.75 * 0.4)
    assert CHANNELS["straight"].half_waves(0.0, LENGTH, LENGTH) == 0.0


def test_a_rotation_vector_turns_as_it_says():
    for vector in ([0.0, 0.0, 0.0], [1e-5, -2e-5, 1e-6], [0.3, -1.2, 0.7], [0.0, 0.0, np.pi]):
        want = Rotation.from_rotvec(vector)
        found = rotation_of(of(vector))
        np.testing.assert_allclose(found, want.as_matrix(), atol=1e-15)
        quaternion = quaternion_of(jnp.stack([found, found.T]))
        np.testing.assert_allclose(np.abs(quaternion[0] @ want.as_quat()), 1.0, atol=1e-14)
        assert np.all(np.asarray(quaternion)[:, 3] >= 0)


def test_a_rotation_vector_is_differentiable_where_nothing_turns():
    slope = jax.jacobian(rotation_of)(jnp.zeros(3))
    np.testing.assert_array_equal(slope[:, :, 2], [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
