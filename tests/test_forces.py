"""Line pressure and friction of the tendon: they must account for every newton lost along it."""

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.examples import SIMULATED
from gtr_jax.forces import channel_forces

T_BASE = 45.0


@pytest.fixture(scope="module")
def pulled():
    return gtr.equilibrium(gtr.load_robot(SIMULATED), jnp.asarray(T_BASE))


def test_friction_sums_to_the_loss(pulled):
    forces = channel_forces(pulled)
    lost = float(jnp.sum(forces.friction * forces.length))
    at_kinks = -float(jnp.sum(jnp.where(forces.length > 0, 0.0, jnp.diff(pulled.tension))))
    np.testing.assert_allclose(lost + at_kinks, T_BASE - float(pulled.T_tip), rtol=1e-12)


def test_friction_is_mu_times_pressure_where_the_tendon_slips(pulled):
    mu = float(gtr.load_robot(SIMULATED).value("mu"))
    forces = channel_forces(pulled)
    np.testing.assert_allclose(forces.friction, mu * forces.normal, rtol=2e-4, atol=1e-9)
    assert float(jnp.min(forces.normal)) >= 0.0


def test_parallel_tendon_presses_with_tension_times_curvature():
    config = gtr.load_config(SIMULATED)
    robot = gtr.build_robot(config).with_values(mu=0.0, r1=0.01, r2=0.01)
    eq = gtr.equilibrium(robot, jnp.asarray(10.0))
    forces = channel_forces(eq)
    kappa = 0.5 * (eq.curvature[1:] + eq.curvature[:-1])
    there = np.asarray(forces.length) > 0
    expected = (10.0 * jnp.abs(kappa) / (1 - 0.01 * kappa))[there]  # curvature of the offset curve
    np.testing.assert_allclose(forces.normal[there], expected, rtol=1e-3)
    np.testing.assert_allclose(forces.friction, 0.0, atol=1e-12)


def test_locked_tendon_needs_less_friction_than_it_could_have():
    robot = gtr.load_robot(SIMULATED)
    before = gtr.equilibrium(robot, jnp.asarray(T_BASE))
    eq = gtr.equilibrium(robot, jnp.asarray(0.8 * T_BASE), memory=before.tension)
    forces = channel_forces(eq)
    limit = float(robot.value("mu")) * forces.normal
    assert bool(jnp.all(jnp.abs(forces.friction) <= limit * (1 + 1e-3) + 1e-9))
    assert (
        float(forces.friction[0]) < 0 < float(forces.friction[-1])
    )  # slips back at the base, holds at the tip
