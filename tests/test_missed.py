"""Steps that follow one which did not converge."""

import jax.numpy as jnp
import numpy as np
import pytest

from gtr_jax.simulation.missed import trusted

L = 0.2


def told(met, loads, whole):
    """Which steps are trusted; `whole` says in which the tendon slips along its whole length."""
    whole, loads = np.asarray(whole, float), np.asarray(loads, float)
    each = whole if loads.ndim == 1 else np.repeat(whole[:, None], loads.shape[1], axis=1)
    direction, front = jnp.asarray(np.sign(each)), jnp.asarray(L * each)
    found = trusted(jnp.asarray(met), jnp.asarray(loads), direction, front, jnp.asarray(L))
    return [bool(x) for x in found]


def test_without_a_miss_every_step_counts():
    assert told([True] * 3, [1, 5, 2], [0, 0, 0]) == [True] * 3


def test_a_peak_that_was_missed_is_missed_until_the_tendon_slips_as_a_whole():
    met, loads = [True, False, True, True, True, True], [5, 9, 5, 4, 2, 1]
    assert told(met, loads, [1, 0, 0, 0, 1, 0]) == [True, False, False, False, True, True]


def test_a_load_that_lies_on_the_way_was_only_gone_past():
    assert told([True, False, False, True, True], [5, 6, 7, 8, 4], [0] * 5) == [
        True,
        False,
        False,
        True,
        True,
    ]
    # The way turned at 7: what was held there is not known.
    assert told([True, False, True, True], [5, 7, 6, 8], [0] * 4) == [True, False, False, False]


def test_of_several_tendons_the_way_is_straight_in_all():
    met = [True, False, True]
    assert told(met, [[1, 1], [2, 3], [3, 5]], [0] * 3) == [True, False, True]
    assert told(met, [[1, 1], [2, 1], [3, 5]], [0] * 3) == [True, False, False]
    assert told(met, [[1, 1], [2, 1], [0, 0]], [0] * 3) == [True, False, True]  # slack tendons hold nothing


def test_a_load_that_is_not_known_is_no_step():
    assert told([True, False, True], [1, np.nan, 2], [0] * 3) == [True, False, True]


@pytest.mark.parametrize("native", [False, True])
def test_a_simulation_flags_what_follows(make_robot, monkeypatch, native):
    """The largest load is missed; the way back holds what would have been held from there."""
    import gtr_jax as gtr
    from gtr_jax.mechanics import March
    from gtr_jax.simulation import natively
    from gtr_jax.simulation.history import loads_of
    from gtr_jax.simulation.programs import structure_of

    robot = make_robot()
    history = np.array([1.0, 5.0, 1e5, 4.9, 4.8, 0.5, 0.2])  # no robot bears the third
    if native:
        loads = loads_of(jnp.asarray(history), jnp.arange(7.0), None)
        run = natively.steps_natively(robot, structure_of(robot, None), loads, March(), None)
        converged = run.converged
    else:
        converged = np.asarray(gtr.simulate(robot, history).converged)
    assert [bool(x) for x in converged] == [True, True, False, False, False, True, True]
