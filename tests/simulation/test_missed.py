"""Steps that follow one which did not converge."""

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.mechanics import ProgramSpec, SolverOptions
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.missed import trusted
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_of

L = 0.2
ONE, TWO = ProgramSpec((), 0, False), ProgramSpec((), 2, False)


def told(met, loads, whole, *, structure=ONE, preload=0.0):
    """Which steps are trusted; `whole` says in which direction the tendon slips along its whole length."""
    loads = np.asarray(loads, float)
    ways = np.asarray(whole, float)
    ways = ways if loads.ndim == 1 else np.repeat(ways[:, None], loads.shape[1], axis=1)
    slip = (jnp.asarray(ways), jnp.asarray(L * np.abs(ways)))
    begun = jnp.full(loads.shape[1:], preload)
    found = trusted(structure, jnp.asarray(met), jnp.asarray(loads), begun, slip, jnp.asarray(L))
    return [bool(x) for x in found]


def test_without_a_miss_every_step_counts():
    assert told([True] * 3, [1, 5, 2], [0, 0, 0]) == [True] * 3


def test_a_peak_is_missed_until_the_tendon_slips_beyond_all_that_was_missed():
    met, loads = [True, False, True, True, True, True], [5, 9, 7, 6, 4, 3]
    # 5 -> 7 slips as a whole for who has not seen the 9; really it is a partial release.
    assert told(met, loads, [1, 0, 1, -1, -1, -1]) == [True, False, False, False, True, True]
    assert told(met, [5, 9, 7, 8, 9.5, 8], [1, 0, 1, 1, 1, 0]) == [True, False, False, False, True, True]
    assert told(met, loads, [1, 0, 0, 0, 0, 0]) == [True, False, False, False, False, False]


def test_a_load_that_lies_on_the_way_was_only_gone_past():
    met, still = [True, False, False, True, True], [0] * 5
    assert told(met, [5, 6, 7, 8, 4], still) == [True, False, False, True, True]
    # The way turned at 7: what was held there is not known.
    assert told([True, False, True, True], [5, 7, 6, 8], still[:4]) == [True, False, False, False]


def test_a_first_step_that_is_missed_is_remembered():
    assert told([False, True, True], [10, 5, 8], [0, 1, 1]) == [False, False, False]
    assert told([False, True], [10, 12], [0, 0]) == [False, True]
    assert told([False, True], [10, 12], [0, 0], preload=11.0) == [False, False]


def test_several_tendons_have_to_slip_beyond_it_all():
    met = [True, False, True]
    assert told(met, [[1, 1], [2, 3], [3, 5]], [0, 0, 0], structure=TWO) == [True, False, False]
    assert told(met, [[1, 1], [2, 3], [3, 5]], [0, 0, 1], structure=TWO) == [True, False, True]
    assert told(met, [[1, 1], [2, 6], [3, 5]], [0, 0, 1], structure=TWO) == [True, False, False]
    assert told(met, [[1, 1], [2, 1], [0, 0]], [0, 0, 0], structure=TWO) == [True, False, True], "slack"


@pytest.mark.parametrize(
    "structure", [ProgramSpec(("tendon-stretch",), 2, False), ProgramSpec(("body-hysteresis",), 0, False)]
)
def test_where_more_is_remembered_steps_stay_flagged(structure):
    loads = np.array([5.0, 9.0, 4.0, 10.0])
    loads = np.stack([loads, loads], axis=1) if structure.tendons else loads
    met, whole = [True, False, True, True], [1, 1, -1, 1]
    assert told(met, loads, whole, structure=structure) == [True, False, False, False]


def test_a_load_that_is_not_known_is_no_step():
    assert told([True, False, True], [1, np.nan, 2], [0] * 3) == [True, False, True]


@pytest.mark.parametrize("native", [False, True])
def test_a_simulation_flags_what_follows(make_robot, native):
    robot = make_robot()
    # No robot bears the second; the third slips as a whole for who has not seen it.
    history = np.array([5.0, 1e5, 12.0, 9.0, 0.5, 0.2])
    if native:
        loads = loads_of(jnp.asarray(history), jnp.arange(6.0), None)
        run = steps_natively(robot, structure_of(robot, None), loads, SolverOptions(), None)
    else:
        run = gtr.simulate(robot, history)
    assert [bool(x) for x in run.converged] == [True, False, False, False, True, True]
    first = gtr.simulate(robot, history[1:])
    assert [bool(x) for x in first.converged] == [False, False, False, False, False]
