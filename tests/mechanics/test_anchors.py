"""Tendons that are anchored inside the body."""

import numpy as np
import pytest

import gtr_jax as gtr

HELIX = {"kind": "helix", "radius": 0.008, "start_angle": 0.5}
BODY = {"outer_radius": 0.012, "youngs_modulus": 1.2e6}
HISTORY = np.array([0.0, 2.0, 4.0, 6.0, 5.5, 4.0, 2.0])


@pytest.fixture(scope="module")
def runs():
    """A body whose tendon ends at 200 of 250 mm, and one that is 200 mm long."""
    from gtr_jax.config.config import parse_config

    found = []
    for length, turns, to in ((0.25, 1.0, 0.2), (0.2, 0.8, None)):
        data = {
            "schema": 1,
            "space": True,
            "backbone": {"length": length, **BODY},
            "routing": {**HELIX, "turns": turns},
            "tendon": {"friction_coefficient": 0.3, **({} if to is None else {"to": to})},
        }
        robot = gtr.build_robot(parse_config(data), resolution=2.0)
        found.append((robot, gtr.simulate(robot, HISTORY)))
    return found


def test_it_bends_the_body_as_if_that_ended_there(runs):
    (_, long), (_, short) = runs
    assert long.converged.all() and short.converged.all()
    np.testing.assert_allclose(long.T_tip, short.T_tip, rtol=2e-6, atol=1e-9)
    # The meshes differ, and in step 5 the tendon is locked from between two nodes on.
    np.testing.assert_allclose(long.displacement, short.displacement, rtol=3e-5, atol=1e-9)
    np.testing.assert_array_equal(gtr.label_phases(long), gtr.label_phases(short))
    at = int(np.flatnonzero(np.abs(np.asarray(long.s) - 0.2) < 1e-12)[0])
    # 5e-8 m apart on this mesh, 16 times as much on one half as fine: order four.
    np.testing.assert_allclose(long.shape.position[:, at], short.shape.position[:, -1], atol=1e-7)


def test_beyond_the_anchor_the_body_is_straight_and_the_tendon_slack(runs):
    (robot, long), _ = runs
    s = np.asarray(long.s)
    at = int(np.flatnonzero(np.abs(s - 0.2) < 1e-12)[-1])
    np.testing.assert_allclose(long.shape.strain[:, at + 1 :], 0.0, atol=1e-9)
    assert np.all(np.asarray(long.tension)[:, at + 1 :] == 0.0)
    frames, places = np.asarray(long.shape.rotation), np.asarray(long.shape.position)
    np.testing.assert_allclose(places[:, -1], places[:, at] + 0.05 * frames[:, at, :, 0], atol=1e-12)
    state = gtr.equilibrium_at(robot, long, 3)
    assert float(state.tendon_length) == pytest.approx(
        float(state.metric[:at] @ np.gradient(s[:at])), rel=2e-2
    )
    np.testing.assert_allclose(state.wrap[at:], state.wrap[at], rtol=0)


@pytest.mark.slow
def test_its_end_may_be_fitted(runs):
    import jax

    robot = runs[0][0]

    def T_tip(to):
        return gtr.simulate(robot.with_values(to=to), HISTORY).T_tip[3]

    slope = (T_tip(0.2 + 1e-6) - T_tip(0.2 - 1e-6)) / 2e-6
    assert float(jax.grad(T_tip)(0.2)) == pytest.approx(float(slope), rel=1e-5)
