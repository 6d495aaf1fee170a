"""The channels of a body in space as curves for CAD."""

import numpy as np
import pytest
from scipy.linalg import expm

import gtr_jax as gtr
from gtr_jax.robot.channel_table import channel_curve, natural_shape

HELIX = {"kind": "helix", "radius": 0.008, "turns": 1.25, "start_angle": 0.5}


def test_a_straight_body_has_the_channel_of_its_section(make_robot, tmp_path):
    robot = make_robot(routing=HELIX, tendon={"to": 0.2})
    curve = channel_curve(robot, robot.tendon)
    assert curve["s_mm"][-1] == pytest.approx(200)
    phi = 0.5 + 2 * np.pi * 1.25 * curve["s_mm"] / 250
    np.testing.assert_allclose(curve["body_x_mm"], curve["s_mm"], atol=1e-10)
    np.testing.assert_allclose(curve["body_y_mm"], 8 * np.cos(phi), atol=1e-10)
    np.testing.assert_allclose(curve["body_z_mm"], 8 * np.sin(phi), atol=1e-10)


def test_a_curve_routing_reads_it(make_robot, tmp_path, monkeypatch):
    robot = make_robot(routing=HELIX)
    gtr.write_recording(tmp_path / "channel.csv", channel_curve(robot, robot.tendon))
    text = (tmp_path / "channel.csv").read_text().splitlines()
    assert text[0] == "s_mm,y_mm,z_mm,body_x_mm,body_y_mm,body_z_mm"
    (tmp_path / "channel.csv").write_text("\n".join([text[0], *text[1:-1:10], text[-1]]))
    monkeypatch.setenv("GTR_JAX_ROOT", str(tmp_path))
    again = make_robot(routing={"kind": "curve", "file": str(tmp_path / "channel.csv")})
    s = robot.backbone.length * np.linspace(0.05, 0.95, 40)
    kinks = np.zeros((0, 40), bool)
    one, other = (r.routing.section_offset(s, kinks, r.backbone.length).value for r in (robot, again))
    np.testing.assert_allclose(one, other, atol=1e-7)


def test_a_bent_body_is_followed(make_robot):
    strain = np.array([4.0, -6.0, 9.0])
    body = {"natural_twist": 4.0, "natural_curvature_y": -6.0, "natural_curvature": 9.0}
    robot = make_robot(routing=HELIX, backbone=body)
    twist = np.zeros((4, 4))
    x, y, z = strain
    twist[:3, :3], twist[0, 3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]], 1.0
    middle, frames = natural_shape(robot, np.linspace(0.0, 0.25, 501))
    end = expm(0.25 * twist)
    np.testing.assert_allclose(middle[-1], end[:3, 3], atol=1e-7)
    np.testing.assert_allclose(frames[-1], end[:3, :3], atol=1e-12)
