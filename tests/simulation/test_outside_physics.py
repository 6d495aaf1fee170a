"""Numbers that no robot has: a result code says so, under a transformation and outside one."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.robot.parameters import bounded
from gtr_jax.robot.validity import is_robot
from gtr_jax.terms import REGISTRY
from tests.conftest import PARALLEL, SINE

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def solve():
    """Whether an equilibrium, and every step of a simulation, says that the numbers are outside physics; its
    result; its tip tension.
    """

    @jax.jit
    def solved(robot):
        eq, run = gtr.equilibrium(robot, 5.0), gtr.simulate(robot, [1.0, 5.0, 2.0])
        return eq.outside_physics, run.outside_physics, eq.converged, eq.result, eq.T_tip

    return solved


WRONG = {
    "modulus": {"E": -1e6},
    "no modulus": {"E": 0.0},
    "friction": {"mu": -0.1},
    "preload": {"preload": -1.0},
    "channel": {"r1": -0.05},
    "wave": {"w1": 0.2, "w2": 0.1},
    "radius": {"outer_radius_tip": -0.01},
    "nothing": {"length": float("nan")},
    "term": {"adhesion.drag": -1.0},
    "endless friction": {"mu": float("inf")},
    "endless preload": {"preload": float("inf")},
    "endless offset": {"r1": float("nan")},
}

UNSOLVABLE = {"no modulus", "nothing", "radius", "endless friction", "endless preload", "endless offset"}


@pytest.mark.parametrize("case", WRONG)
def test_numbers_of_no_robot_are_said_by_the_result(make_robot, solve, case):
    # As a function that JAX traces builds it, or whoever replaces what is in it.
    robot = make_robot(routing=SINE)
    changed = jax.jit(lambda values: robot.with_values(**values))(WRONG[case])
    changed = dataclasses.replace(changed, acting=robot.acting)
    outside, each, converged, result, _ = solve(changed)
    alone = gtr.equilibrium(changed, 5.0)
    assert not bool(converged) and not bool(alone.converged) and not bool(is_robot(changed))
    if case in UNSOLVABLE:
        return  # the solver fails by itself, or finds something
    assert bool(outside) and bool(np.all(each)) and bool(alone.solved)
    assert str(result).startswith("outside_physics: ") and "a number of the robot is outside" in str(result)
    assert bool(alone.outside_physics)


def test_a_robot_is_not_outside(make_robot, solve):
    robot = make_robot(routing=SINE)
    outside, each, converged, result, _ = solve(robot)
    assert not bool(outside) and not bool(np.any(each)) and bool(converged)
    assert str(result) == "successful"


def test_only_the_lanes_that_are_outside_are(make_robot):
    robot = make_robot(routing=PARALLEL)

    @jax.jit
    def tip(E):
        eq = gtr.equilibrium(robot.with_values(E=E), 5.0)
        return eq.T_tip, eq.converged

    E = jnp.array([1e6, -1e6, 2e6])
    T_tip, converged = jax.vmap(tip)(E)
    assert converged.tolist() == [True, False, True]
    alone = [float(tip(value)[0]) for value in E[::2]]
    np.testing.assert_allclose(T_tip[::2], alone, rtol=1e-12)
    slope = jax.grad(lambda E: tip(E)[0])(1e6)
    assert np.isfinite(slope) and slope != 0.0


@pytest.mark.parametrize("name", ["tdcm-1", "tdcm-2", "antagonists", "helix", "three-tendons"])
def test_every_example_is_inside(name):
    robot = gtr.load_robot(EXAMPLES / f"{name}.toml")
    assert bool(is_robot(robot))
    values, least, most, above = bounded(robot)
    assert values.shape == least.shape == most.shape == above.shape


def test_absent_terms_are_within_their_bounds():
    for term in REGISTRY.values():
        for q in term.numbers:
            assert (q.lower is None or q.null >= q.lower) and (q.upper is None or q.null <= q.upper), q
