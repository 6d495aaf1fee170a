"""The comparison with peers: its reference is right, ours meets it, and the page is made from the numbers."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import root

sys.path.insert(0, str(Path(__file__).parents[2]))  # benchmarks is not installed
from benchmarks.peers import environments, report, run_ours, run_solve_bvp
from benchmarks.peers.plot import frontier
from benchmarks.peers.problem import (
    BENDING_STIFFNESS,
    CONVERGING,
    HELIX,
    LENGTH,
    LOADED,
    OFFSET,
    PROBLEMS,
    SPATIAL,
    STIFFNESS,
    TENDON,
    TENSION,
    Problem,
    cheapest,
    error,
    reference,
)

NEARLY_NONE = Problem("shot, though next to no force acts", (0.0, 1e-13))


def test_shooting_meets_the_closed_form():
    assert math.dist(reference(TENDON), reference(NEARLY_NONE)) < 1e-12


def test_reference_under_a_tip_force_meets_collocation():
    found = run_solve_bvp.solver_of(LOADED, 50, 1e-10)()
    assert found.success
    assert error(LOADED, found.y[2:, -1]) < 1e-10
    energy = BENDING_STIFFNESS * found.y[1] ** 2 / 2 + np.dot(
        LOADED.tip_force, [np.cos(found.y[0]), np.sin(found.y[0])]
    )
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)  # the elastica's first integral
    assert found.y[1, -1] == pytest.approx(TENSION * OFFSET / BENDING_STIFFNESS)


def test_a_helical_tendon_makes_the_helix_of_the_closed_form():
    """In axes that turn with the channel nothing changes along the rod."""
    speed = 2 * np.pi / LENGTH
    d, dd = np.array([0.0, OFFSET, 0.0]), np.array([0.0, 0.0, speed * OFFSET])

    def left(u):
        w = np.array([1.0, 0.0, 0.0]) + np.cross(u, d) + dd
        return STIFFNESS * u + np.cross(d, TENSION * w / np.linalg.norm(w))

    x, y, z = root(left, [0.0, 0.0, 3.0], tol=1e-14).x + np.array([speed, 0.0, 0.0])
    turn = np.array([[0, -z, y, 1], [z, 0, -x, 0], [-y, x, 0, 0], [0, 0, 0, 0.0]])
    np.testing.assert_allclose(reference(HELIX), expm(turn * LENGTH)[:3, 3], atol=1e-12)


@pytest.mark.parametrize("problem", SPATIAL, ids=lambda p: p.name)
def test_references_in_space_meet_collocation(problem):
    found = run_solve_bvp.spatial_solver_of(problem, 10, 1e-7)()
    assert found.success
    assert error(problem, found.y[4:, -1]) < 1e-9


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda p: p.name)
def test_ours_meets_the_reference(problem):
    tip, converged = run_ours.tip_of(problem, run_ours.robot_of(problem, 1.0), TENSION)
    assert bool(converged)
    # A turn about the midline on the default mesh.
    assert error(problem, tip) < (5e-6 if "helical" in problem.name else 3e-7)


def test_channels_are_said():
    assert [str(channel) for channel in CONVERGING.channels] == [
        "A tendon 10 to 4 mm off the midline, at 0° from y at the base, under 6 N",
        "A tendon 10 to 6 mm off the midline, at 120° from y at the base, 0.25 turn about it, under 3 N",
    ]


def test_cheapest_is_the_fastest_that_is_good_enough():
    points = [
        {"problem": "a", "error": 1e-5, "warm_s": 3.0, "converged": True},
        {"problem": "a", "error": 1e-4, "warm_s": 2.0, "converged": True},
        {"problem": "a", "error": 1e-4, "warm_s": 0.5, "converged": False},
        {"problem": "a", "error": 1e-2, "warm_s": 1.0, "converged": True},
        {"problem": "b", "error": 0.0, "warm_s": 0.1, "converged": True},
    ]
    assert cheapest(points, "a", 1e-3) is points[1]
    assert cheapest(points, "a", 1e-6) is None
    assert frontier([(3.0, 1e-5), (2.0, 1e-4), (2.5, 1e-3), (1.0, 1e-2)]) == [
        (1.0, 1e-2),
        (2.0, 1e-4),
        (3.0, 1e-5),
    ]


def test_the_page_says_what_was_not_run_and_not_reached():
    point = {"problem": "tendon alone", "setting": "x", "error": 5e-4, "warm_s": 2e-3, "converged": True}
    found = {
        "machine": {"processor": "p", "cores": 2, "date": "d", "python": "3"},
        "quick": True,
        "tension_N": TENSION,
        "levels": [1e-3, 1e-6],
        "problems": [{"name": "tendon alone", "tip_force_N": [0, 0], "tip_m": [0.1, 0.2]}],
        "solvers": {
            "gtr-jax": {"points": [point], "batches": []},
            "solve_bvp": {"points": [point | {"warm_s": 4e-3}], "batches": []},
            "soromox": {"points": [], "batches": []},
            "pyelastica": {"failed": "pyelastica: cannot be installed: no index"},
        },
    }
    text = report.markdown(found)
    assert "**2.00 ms** (x; error 5.0e-04)" in text
    assert "10⁻³: solve_bvp 2." in text
    assert "not reached (best 5.0e-04)" in text
    assert "| soromox | not tried | not tried |" in text
    assert "Not run: pyelastica: cannot be installed: no index." in text


def test_a_peer_that_cannot_be_installed_is_one_line(tmp_path, monkeypatch):
    (tmp_path / "requirements-nothing.txt").write_text("./no-such-folder-here\n")
    monkeypatch.setattr(environments, "HERE", tmp_path)
    monkeypatch.setattr(environments, "FOLDER", tmp_path / "environments")
    with pytest.raises(environments.PeerError, match=r"^nothing: cannot be installed: [^\n]+$"):
        environments.python_of("nothing")
    assert not (tmp_path / "environments" / "nothing" / "installed.txt").exists()
