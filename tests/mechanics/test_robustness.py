"""Cold starts, failures and batches: everything converges or says so, and nothing that is not finite goes
unflagged.
"""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import gtr_jax as gtr
from tests.conftest import PARALLEL, ROUTINGS, SINE

VARIED = {
    "sine": {"r1": 0.4, "r2": 0.4, "w1": 0.5, "w2": 0.3},
    "wave": {"R_max": 0.4, "r_min": 0.3, "sigma": 0.8, "n_sine": 0.6},
    "cross": {"R_max": 0.4, "r_min": 0.3, "n_sine": 0.5},
    "parallel": {"offset": 0.5},
    "table": {"knot_1": 0.5, "knot_2": 0.9},
}
LOADS = {"gravity_angle": 0.0, "tip_force": [0.1, 0.1]}


def random_robots(robot, spread, loaded):
    """A function of a random key: equilibrium of a random robot of this kind, pulled once from slack."""

    def one(key):
        keys = iter(jax.random.split(key, 20))

        def uniform(low, high):
            return jax.random.uniform(next(keys), (), minval=low, maxval=high)

        values = {name: robot.value(name) * uniform(1 - s, 1 + s) for name, s in spread.items()}
        values |= {"mu": uniform(0.02, 1.0), "E": 10 ** uniform(5.5, 7.3)}
        if loaded:
            values |= {"gravity_angle": uniform(-3.2, 3.2), "density": uniform(0.0, 1500.0)}
            values |= {"tip_force_x": uniform(-1.0, 1.0), "tip_force_y": uniform(-1.0, 1.0)}
        eq = gtr.equilibrium(robot.with_values(**values), 10 ** uniform(-0.5, 2.0))
        # Some of them have their channel outside the body.
        return eq.tension, eq.angle, eq.x, eq.solved, eq.tension[-1] / eq.tension[0]

    return one


def sweep(make_robot, name, loaded, count, seed):
    robot = make_robot(routing=ROUTINGS[name], loads=LOADS if loaded else None)
    keys = jax.random.split(jax.random.key(seed), count)
    tension, angle, x, converged, kept = jax.jit(jax.vmap(random_robots(robot, VARIED[name], loaded)))(keys)
    finite = np.isfinite(np.asarray(tension)).all(1) & np.isfinite(np.asarray(angle)).all(1)
    finite &= np.isfinite(np.asarray(x)).all(1)
    angles = np.abs(np.asarray(angle)).max(axis=1)
    return np.array(converged), finite, angles, np.array(kept)


@pytest.mark.parametrize("name", ["sine", "parallel"])
def test_cold_sweep_small(name, make_robot):
    converged, finite, *_ = sweep(make_robot, name, False, 64, 0)
    assert converged.all() and finite.all()


@pytest.mark.slow
@pytest.mark.parametrize("loaded", [False, True], ids=["free", "loaded"])
@pytest.mark.parametrize("name", list(ROUTINGS))
def test_cold_sweep_of_a_thousand(name, loaded, make_robot):
    """Ten sweeps of 100: random robots and tensions up to 99 % loss and 3 rad, all from a cold start."""
    converged, finite, angle, kept = sweep(make_robot, name, loaded, 100, 1)
    inside = np.asarray((angle <= 3.0) & (kept >= 0.01))
    assert inside.sum() >= 50
    assert np.all(converged[inside])
    assert np.all(finite | ~converged), "nothing that is not finite goes unflagged"


def test_a_99_percent_loss_from_a_cold_start(make_robot):
    robot = make_robot(routing=ROUTINGS["wave"], tendon={"friction_coefficient": 3.0})
    eq = gtr.equilibrium(robot, 60.0)
    assert bool(eq.converged) and float(eq.T_tip) < 0.01 * 60.0


def test_a_solve_that_fails_is_flagged_and_leaves_the_memory(make_robot):
    robot = make_robot(routing=SINE, loads=LOADS)
    history = np.array([5.0, np.nan, 5.0])
    run = gtr.simulate(robot, history)
    assert list(np.asarray(run.converged)) == [True, False, True]
    assert float(run.T_tip[2]) == pytest.approx(float(run.T_tip[0]), rel=1e-9)


def test_too_few_steps_is_a_result_and_not_an_exception(make_robot):
    robot = make_robot(routing=SINE, loads={"tip_force": [0.0, 0.5]})
    eq = gtr.equilibrium(robot, 20.0, solver=gtr.SolverOptions(atol=0.0))
    assert not bool(eq.converged) and eq.result != optx.RESULTS.successful
    assert np.isfinite(np.asarray(eq.tension)).all()


def test_vmap_equals_a_loop(make_robot):
    robot = make_robot(routing=SINE, loads=LOADS)
    forces, tensions = jnp.asarray([0.0, -0.3, 1.5, -2.5, 4.0]), jnp.asarray([0.5, 80.0, 3.0, 40.0, 12.0])

    def one(force, T):
        eq = gtr.equilibrium(robot.with_values(tip_force_y=force), T)
        return eq.tip_pose, eq.T_tip, eq.iterations

    pose, T_tip, steps = jax.vmap(one)(forces, tensions)
    assert len(set(np.asarray(steps).tolist())) > 1, "lanes differ in their step counts"
    for i in range(5):
        p, t, _ = one(forces[i], tensions[i])
        np.testing.assert_allclose(pose[i], p, atol=1e-9)
        np.testing.assert_allclose(T_tip[i], t, rtol=1e-9)


def test_a_batched_solution_reads_like_a_single_one(make_robot):
    robot = make_robot(routing=PARALLEL)
    many = jax.vmap(lambda T: gtr.equilibrium(robot, T))(jnp.asarray([1.0, 5.0]))
    one = gtr.equilibrium(robot, 5.0)
    assert many.T_tip.shape == (2,) and many.tip_pose.shape == (2, 3)
    np.testing.assert_allclose(many.tip_pose[1], one.tip_pose, atol=1e-12)


def test_padding_changes_nothing(make_robot):
    from gtr_jax.simulation.history import padded_length

    robot = make_robot(routing=SINE)
    history = np.linspace(0, 20, 23)
    assert padded_length(23) > 23 and padded_length(1000) == 1024 and padded_length(24) == 24
    whole = gtr.simulate(robot, np.concatenate([history, [20.0]]))
    part = gtr.simulate(robot, history)
    np.testing.assert_array_equal(part.T_tip, whole.T_tip[:23])
    assert part.T_tip.shape == (23,)


def test_changing_a_value_does_not_recompile(make_robot):
    robot = make_robot(routing=SINE)
    traces = []

    @jax.jit
    def tip(robot):
        traces.append(1)
        return gtr.equilibrium(robot, 10.0).T_tip

    first = tip(robot)
    second = tip(robot.with_values(mu=0.5, E=2e6, w1=0.02))
    assert len(traces) == 1 and float(first) != float(second)


def test_shapes_of_the_load_are_checked(make_robot):
    robot = make_robot()
    with pytest.raises(ValueError, match=r"one base tension, not shape \(3,\)"):
        gtr.equilibrium(robot, jnp.ones(3))
    for wrong in (5.0, np.zeros(0)):
        with pytest.raises(ValueError, match="at least one tension"):
            gtr.simulate(robot, wrong)
