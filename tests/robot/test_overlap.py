"""A body that passes through itself is told from one that bends far."""

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.examples import SIMULATED
from gtr_jax.report.simulation import facts, simulation_report
from gtr_jax.report.simulation_answer import answer_simulation
from gtr_jax.robot.overlap import crosses_itself, impossible, impossible_in_space, meets_itself, outline

RADIUS, LENGTH = 0.01, 0.3


def arc(turn, radius=RADIUS, n=101):
    """Outline of a body that bends into an arc of a circle."""
    s = np.linspace(0.0, LENGTH, n)
    return outline(s, turn * s / LENGTH, np.full(n, radius))


@pytest.mark.parametrize("sign", [1, -1])
def test_an_arc_crosses_itself_once_its_ends_meet(sign):
    # The tip's corners, at the middle's circle of radius L/turn, come round to the face of the base
    # at a turn of 360 degrees; until then no wall touches another.
    assert not crosses_itself(arc(sign * np.radians(300)))
    assert not crosses_itself(arc(sign * np.radians(355)))
    assert crosses_itself(arc(sign * np.radians(365)))


def test_a_wall_that_folds_crosses_itself():
    s = np.linspace(0.0, LENGTH, 201)
    kappa = np.where((s > 0.14) & (s < 0.16), 1.6 / RADIUS, 0.0)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(s) * (kappa[1:] + kappa[:-1]))])
    assert crosses_itself(outline(s, 0.4 * angle, np.full(201, RADIUS))) is False
    assert crosses_itself(outline(s, angle, np.full(201, RADIUS))) is True


def test_straight_and_double_nodes_do_not():
    s = np.repeat(np.linspace(0.0, LENGTH, 40), 2)
    assert not crosses_itself(outline(s, np.zeros(80), np.full(80, RADIUS)))
    assert not crosses_itself(outline(s, 2.0 * s / LENGTH, np.full(80, RADIUS)))


@pytest.fixture(scope="module")
def wound():
    return answer_simulation(gtr.load_robot(SIMULATED), np.linspace(0.0, 450.0, 31))


def test_a_body_wound_into_itself_is_said_to_be(wound):
    found = wound.impossible
    assert found.overlaps and found.strain > 0.5 and wound.converged
    bent = np.abs(np.asarray(wound.run.curvature)) * np.asarray(wound.robot.backbone.radius(wound.run.s))
    np.testing.assert_allclose(found.strain, bent.max(), rtol=1e-12)
    data, report = facts(wound), simulation_report(wound)
    assert data["body"]["overlaps_itself"] and data["body"]["overlap_step"] == found.overlap_step + 1
    assert "passes through itself" in report.verdict and "passes through itself" in data["verdict"]
    assert any("strained" in text for text in report.warnings)


def test_a_body_that_bends_far_is_not():
    robot = gtr.load_robot(SIMULATED)
    run = gtr.simulate(robot, jnp.linspace(0.0, 150.0, 12))
    assert np.degrees(run.tip_pose[-1, 2]) > 120
    found = impossible(robot.backbone, run.s, curvature=run.curvature, angle=run.angle, T_base=run.T_base)
    assert not found.says


def coil(pitch, turns=1.5, radius=0.03, n=301):
    """Nodes of a body that winds about an axis, each turn `pitch` [m] beyond the last, and its midline."""
    angle = np.linspace(0.0, 2 * np.pi * turns, n)
    places = np.stack([pitch * angle / (2 * np.pi), radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))]), places


def test_a_coil_meets_itself_once_its_turns_touch():
    for pitch, meets in ((0.021, False), (0.019, True)):
        s, places = coil(pitch)
        assert meets_itself(s, places, np.full(len(s), RADIUS)) is meets


def test_an_arc_in_space_meets_itself_as_in_the_plane():
    s = np.linspace(0.0, LENGTH, 401)
    for turn in (200, 300, 365):
        angle = np.radians(turn) * s / LENGTH
        kappa = np.radians(turn) / LENGTH
        places = np.stack([np.sin(angle), 1 - np.cos(angle), 0 * s], axis=1) / kappa
        assert meets_itself(s, places, np.full(401, RADIUS)) is (turn == 365)


def test_the_wall_is_strained_by_bending_and_by_twist(make_robot):
    body = make_robot(backbone={"outer_radius": 0.011}).backbone
    s = jnp.linspace(0.0, 0.25, 3)
    strain = jnp.array([[[1.0, 3.0, 4.0]], [[-60.0, 3.0, 4.0]]]) * jnp.ones((2, 3, 1))
    found = impossible_in_space(
        body, s, strain=strain, position=jnp.zeros((2, 3, 3)), T_base=jnp.array([1.0, 2.0])
    )
    assert (found.strain, found.strain_step) == (pytest.approx(0.66), 1)
    assert any("strained by 66 %" in text for text in found.says)


def test_the_stretch_of_the_axis_strains_the_wall_and_lets_it_fold_sooner(make_robot):
    body = make_robot(backbone={"outer_radius": 0.011}).backbone
    s, stretch = jnp.linspace(0.0, 0.25, 3), jnp.full((2, 3), -0.6)
    strain = jnp.array([[[0.0, 0.0, 10.0]], [[0.0, 0.0, 40.0]]]) * jnp.ones((2, 3, 1))
    pulls, places = jnp.array([1.0, 2.0]), jnp.ones((2, 3, 3)) * s[None, :, None]
    found = impossible_in_space(body, s, strain=strain, position=places, T_base=pulls, stretch=stretch)
    assert (found.strain, found.strain_step) == (pytest.approx(1.04), 1)
    assert found.overlap_step == 1


@pytest.mark.parametrize("space", [False, True])
def test_a_sheath_that_is_wound_through_itself_is_said_to_be(make_robot, space):
    """Its tensions hold nonetheless: they follow from how far it turns."""
    for turns, through in ((3.0, True), (0.7, False)):
        sheath = {"rigid": True, "natural_curvature": 2 * np.pi * turns / 0.25, "youngs_modulus": 0.0}
        robot = make_robot(backbone=sheath, space=space)
        s = jnp.linspace(0.0, 0.25, 101)
        kappa = jnp.full((4, 101), 2 * np.pi * turns / 0.25)
        angle, pulls = kappa * s[None], jnp.arange(4.0)
        if space:
            places = jnp.stack([jnp.sin(angle), 1 - jnp.cos(angle), 0 * angle], axis=-1) / kappa[..., None]
            strain = jnp.stack([0 * kappa, 0 * kappa, kappa], axis=-1)
            found = impossible_in_space(robot.backbone, s, strain=strain, position=places, T_base=pulls)
        else:
            found = impossible(robot.backbone, s, curvature=kappa, angle=angle, T_base=pulls)
        assert found.overlaps is through and not found.means_nothing and found.strain == 0.0
        assert any("tensions hold" in text for text in found.says) is through


def test_a_simulation_of_a_wound_sheath_has_a_result(make_robot):
    sheath = {"rigid": True, "natural_curvature": 6 * np.pi / 0.25, "youngs_modulus": 0.0}
    answer = answer_simulation(make_robot(backbone=sheath), np.linspace(0.0, 10.0, 5))
    data = facts(answer)
    assert data["body"] == {"overlaps_itself": True, "overlap_step": 1, "largest_wall_strain": 0.0}
    assert "at the base" in data["verdict"] and "passes through itself" in answer.warnings[0]
