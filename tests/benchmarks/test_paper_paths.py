"""The eight paths of the paper: two losses met, the rest predicted, eq. (16) with and without its factor."""

import dataclasses

import numpy as np
import pytest

import gtr_jax as gtr
from benchmarks.paper import printed
from benchmarks.paper.paths import (
    HALF_DIGIT,
    PUBLISHED_LOSS,
    SEGMENTS,
    T_BASE,
    WAVES,
    config_of,
    robots,
    solved,
    states,
)


@pytest.mark.slow
def test_the_two_losses_are_met_and_by_one_material_only():
    found = solved()
    assert found.starts.settled.all() and found.corners.settled.all()
    np.testing.assert_allclose(found.starts.mu, found.material.mu, rtol=1e-9)
    np.testing.assert_allclose(found.starts.E, found.material.E, rtol=1e-9)
    for path, loss in PUBLISHED_LOSS.items():
        T_tip = float(states()[path].pulled.T_tip)
        assert 1 - T_tip / 60.0 == pytest.approx(loss, abs=1e-6)
    assert np.ptp(found.corners.mu) < 0.02
    assert np.ptp(found.corners.E) < 0.06 * found.material.E


def test_the_robot_files_carry_that_material():
    for path, loss in PUBLISHED_LOSS.items():
        eq = gtr.equilibrium(gtr.build_robot(config_of(path)), T_BASE[path])
        assert abs(1 - float(eq.T_tip) / T_BASE[path] - loss) < HALF_DIGIT


@pytest.mark.slow
def test_what_the_paper_says_of_the_others():
    found = states()
    assert all(bool(state.pulled.converged) for state in found.values())
    losses = [1 - float(found[p].pulled.T_tip) / 60.0 for p in (1, 2, 3)]
    angles = [float(found[p].pulled.tip_pose[2]) for p in (1, 2, 3)]
    assert losses == sorted(losses) and angles == sorted(angles, reverse=True)
    signs = np.sign(np.asarray(found[4].pulled.curvature))
    assert np.sum(signs[2:] != signs[1:-1]) >= 4, "path 4 undulates"
    before = []
    for path in SEGMENTS:
        eq, w1 = found[path].pulled, config_of(path).numbers()["routing.w1"]
        before.append(-float(np.interp(w1, eq.s, eq.angle)))
    assert before == sorted(before), "the farther the wave, the more the part before it bends"


def finer(path: int, times: int):
    robot = dataclasses.replace(robots()[path], intervals=tuple(times * n for n in robots()[path].intervals))
    return robot.with_values(mu=float(solved().material.mu), E=float(solved().material.E))


@pytest.mark.parametrize("path", [4, 6])
def test_literal_moments_with_the_factor_are_the_local_identity(path):
    """And the difference shrinks with the square of the mesh; without the factor it stays."""
    off, moved = [], []
    for times in (1, 2):
        robot = finer(path, times)
        eq = gtr.equilibrium(robot, T_BASE[path])
        error = printed.factor_error(robot, T_BASE[path], eq)
        assert error.settled
        off.append(error.discretised)
        moved.append(error.moved)
    assert off[1] < 0.35 * off[0] < 1e-3
    assert moved[1] == pytest.approx(moved[0], rel=0.02)
    assert moved[1] > 5e-3, "eq. (16) as printed is another equilibrium"


def test_waves_and_segments_are_all_paths():
    assert set(states()) == set(WAVES) | set(SEGMENTS) == set(range(1, 9))
