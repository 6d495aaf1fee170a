"""Gradients through a 400-step history with reversals, against central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from tests.conftest import SINE

BORES = {
    "bores": [{"from": 0.0, "to": 0.015, "diameter": 0.012}, {"from": 0.13, "to": 0.25, "diameter": 0.01}]
}
LOADS = {"gravity_angle": -1.2, "tip_force": [0.03, -0.05]}
# Pull, transition, re-pull, full release, second pull and a partial release: 400 steps.
HISTORY = np.concatenate(
    [
        np.linspace(start, end, count + 1)[1:]
        for start, end, count in (
            (0, 24, 100),
            (24, 15, 60),
            (15, 22, 60),
            (22, 3, 80),
            (3, 20, 60),
            (20, 9, 40),
        )
    ]
)
SAMPLES = np.array([40, 99, 130, 159, 200, 219, 260, 299, 340, 399])
TIGHT = gtr.SolverOptions(atol=1e-13)


def compare(robot, names, step):
    """Largest relative error of the gradient of a fixed mixture of tip tensions and poses, per parameter."""
    rng = np.random.default_rng(5)
    mix = jnp.asarray(rng.normal(size=(len(SAMPLES), 4)) * np.array([1.0, 30.0, 30.0, 5.0]))

    def output(values, scale):
        changed = robot.with_values(**dict(zip(names, values, strict=True)))
        run = gtr.simulate(changed, HISTORY * scale, solver=TIGHT)
        picked = jnp.concatenate([run.T_tip[SAMPLES, None], run.tip_pose[SAMPLES]], axis=1)
        return jnp.sum(mix * picked), jnp.all(run.converged)

    def value(x):
        total, ok = output(list(x[:-1]), x[-1])
        return total, ok

    x0 = jnp.asarray([float(robot.value(n)) for n in names] + [1.0])
    (_, ok), gradient = jax.jit(jax.value_and_grad(value, has_aux=True))(x0)
    assert bool(ok)
    plain = jax.jit(lambda x: value(x)[0])
    errors = {}
    for i, name in enumerate([*names, "T_base"]):
        h = step * float(jnp.abs(x0[i]))
        # Richardson on two central differences: truncation far below the 1e-5 asked for.
        near, far = ((plain(x0.at[i].add(k * h)) - plain(x0.at[i].add(-k * h))) / (2 * k * h) for k in (1, 2))
        difference = (4 * near - far) / 3
        errors[name] = abs(float(gradient[i] - difference)) / abs(float(difference))
    return errors


def test_gradients_through_a_history(make_robot):
    robot = make_robot(routing=SINE, backbone=BORES)
    errors = compare(robot, ["mu", "E", "r1", "r2", "w1", "w2"], 2e-6)
    assert max(errors.values()) <= 1e-5, errors


@pytest.mark.slow
def test_gradients_through_a_history_with_external_loads(make_robot):
    robot = make_robot(routing=SINE, backbone=BORES, loads=LOADS)
    names = ["mu", "E", "r1", "r2", "w1", "w2", "tip_force_x", "tip_force_y", "gravity_angle"]
    errors = compare(robot, names, 2e-6)
    assert max(errors.values()) <= 1e-5, errors


def test_forward_and_reverse_mode_agree(make_robot):
    robot = make_robot(routing=SINE, loads=LOADS)

    def tip(mu, force):
        return gtr.equilibrium(robot.with_values(mu=mu, tip_force_y=force), 15.0).tip_pose

    at = (jnp.asarray(0.3), jnp.asarray(-0.05))
    for forward, reverse in zip(jax.jacfwd(tip, (0, 1))(*at), jax.jacrev(tip, (0, 1))(*at), strict=True):
        np.testing.assert_allclose(forward, reverse, rtol=1e-9)


def test_derivatives_hold_where_kinks_coincide(make_robot):
    """A bore that ends where the wave starts: the derivative is the one of the kinks parting, on one side."""
    robot = make_robot(routing=SINE, backbone={"bores": [{"from": 0.0, "to": SINE["w1"], "diameter": 0.014}]})
    tip = jax.jit(lambda w: gtr.equilibrium(robot.with_values(w1=w), 30.0).T_tip)
    h = 1e-7
    sides = [
        float(tip(SINE["w1"] + h) - tip(SINE["w1"])) / h,
        float(tip(SINE["w1"]) - tip(SINE["w1"] - h)) / h,
    ]
    gradient = float(jax.grad(tip)(SINE["w1"]))
    assert min(abs(gradient / side - 1) for side in sides) < 1e-4


def test_gradient_of_the_release_switch(make_robot):
    robot = make_robot(routing=SINE)
    switch = jax.jit(lambda mu: gtr.release_switch(robot.with_values(mu=mu), 30.0).T_base)
    h = 1e-5
    difference = float(switch(0.3 + h) - switch(0.3 - h)) / (2 * h)
    assert float(jax.grad(switch)(0.3)) == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize("loads", [{}, LOADS], ids=["free", "loaded"])
def test_programs_with_derivatives_can_be_cached(loads, make_robot):
    """JAX does not keep programs that call back into Python in its compilation cache."""
    robot = make_robot(routing=SINE, loads=loads)

    def slopes(mu):
        def tip(m):
            changed = robot.with_values(mu=m)
            return gtr.simulate(changed, jnp.linspace(0.0, 9.0, 16)).T_tip[-1]

        return jax.jacfwd(tip)(mu), jax.grad(tip)(mu)

    assert "callback" not in jax.jit(slopes).lower(jnp.asarray(0.3)).as_text()


def test_derivative_at_slack_is_that_of_the_first_pull(make_robot):
    robot = make_robot(routing=SINE)
    slope = float(jax.grad(lambda T: gtr.equilibrium(robot, T).T_tip)(0.0))
    assert slope == pytest.approx(float(gtr.equilibrium(robot, 1e-6).T_tip) / 1e-6, rel=1e-5)
