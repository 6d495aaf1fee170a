"""Line pressure and friction of the tendon: they must account for every newton lost along it."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.examples import SIMULATED
from gtr_jax.simulation.forces import channel_forces

T_BASE = 45.0


@pytest.fixture(scope="module")
def pulled():
    return gtr.equilibrium(gtr.load_robot(SIMULATED), jnp.asarray(T_BASE))


def test_friction_coefficient_times_pressure_sums_to_the_loss(pulled):
    """All that is lost is mu times the pressure, along the channel and at kinks: T_base (1 - e^-mu theta)."""
    mu = float(gtr.load_robot(SIMULATED).value("mu"))
    forces = channel_forces(pulled)
    pressed = float(jnp.sum(forces.normal * forces.length + forces.kink_normal))
    lost = T_BASE * -np.expm1(-mu * float(pulled.wrap[-1]))
    np.testing.assert_allclose(mu * pressed, lost, rtol=1e-4)
    np.testing.assert_allclose(
        jnp.sum(forces.friction * forces.length + forces.kink_friction), lost, rtol=1e-9
    )


def test_kinks_take_their_share():
    config = gtr.load_config(SIMULATED)
    data = config.model_dump(by_alias=True, exclude_none=True)
    data["backbone"]["bores"] = [
        {"from": 0.0, "to": 0.04, "diameter": 0.014}
    ]  # ends where the channel runs slantwise
    robot = gtr.build_robot(gtr.RobotConfig.model_validate(data))
    eq = gtr.equilibrium(robot, T_BASE)
    forces = channel_forces(eq)
    assert float(jnp.max(forces.kink_friction)) > 1e-5
    np.testing.assert_allclose(
        forces.kink_friction, float(robot.value("mu")) * forces.kink_normal, rtol=1e-3, atol=1e-12
    )


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


def test_factors_of_equation_14(pulled):
    mu = float(gtr.load_robot(SIMULATED).value("mu"))
    f = channel_forces(pulled)
    wrap = 0.5 * (pulled.wrap[1:] + pulled.wrap[:-1])
    np.testing.assert_allclose(f.tension_loss_factor, np.exp(-mu * wrap), rtol=1e-3)
    turn = np.abs(np.diff(np.asarray(pulled.tendon_angle)))
    smooth = np.asarray(f.length) > 0
    curvature = turn[smooth] / np.asarray(f.length)[smooth]
    large = curvature > 0.05 * curvature.max()  # elsewhere the tendon turns there and back within an interval
    np.testing.assert_allclose(np.asarray(f.normal_projection)[smooth][large], curvature[large], rtol=1e-2)
    np.testing.assert_allclose(f.normal, f.normal_projection * np.exp(-mu * wrap) * T_BASE, rtol=1e-3)
    np.testing.assert_allclose(f.friction_projection, mu * f.normal_projection, rtol=2e-4, atol=1e-9)


def test_projection_changes_sign_with_the_slip():
    """Fully released, the tendon slips towards the tip everywhere, and is tighter there than at the base."""
    robot = gtr.load_robot(SIMULATED)
    before = gtr.equilibrium(robot, T_BASE)
    f = channel_forces(gtr.equilibrium(robot, 2.0, memory=before.tension))
    mu = float(robot.value("mu"))
    np.testing.assert_allclose(f.friction_projection, -mu * f.normal_projection, rtol=2e-4, atol=1e-9)
    assert np.all(np.asarray(f.tension_loss_factor) >= 1.0)


def test_forces_as_vectors_balance_the_tension(pulled):
    """What the tendon does to its channel, summed, is the tension that leaves at the tip less what enters."""
    f = jax.tree_util.tree_map(np.asarray, channel_forces(pulled))
    angle, turn = f.angle, f.turn
    t = np.stack([np.cos(angle), np.sin(angle)])
    n = np.stack([-np.sin(angle), np.cos(angle)])
    total = np.sum((turn * f.normal * n - f.friction * t) * f.length, axis=1)
    at_kinks = f.kink_normal * turn * n
    psi, T = np.asarray(pulled.tendon_angle)[[0, -1]], np.asarray(pulled.tension)[[0, -1]]
    ends = T * np.stack([np.cos(psi), np.sin(psi)])
    lost_at_kinks = np.where(f.length > 0, 0.0, np.diff(np.asarray(pulled.tension))) * t
    summed = total + at_kinks.sum(axis=1) + lost_at_kinks.sum(axis=1)
    np.testing.assert_allclose(summed, ends[:, 1] - ends[:, 0], rtol=1e-3, atol=1e-3 * T_BASE)


def test_slack_tendon_has_no_forces_and_finite_derivatives():
    robot = gtr.load_robot(SIMULATED)

    def total(T_base):
        f = channel_forces(gtr.equilibrium(robot, T_base))
        return jnp.stack([jnp.sum(f.tension_loss_factor), jnp.sum(f.friction_projection), jnp.sum(f.normal)])

    assert np.all(np.asarray(total(jnp.asarray(0.0))) == 0.0)
    assert np.all(np.isfinite(jax.jacfwd(total)(jnp.asarray(0.0))))


def test_several_tendons_are_asked_for_one_by_one():
    robot = gtr.load_robot(Path(__file__).parents[2] / "examples" / "antagonists.toml")
    eq = gtr.equilibrium(robot, [8.0, 5.0])
    with pytest.raises(ValueError, match="of_tendon"):
        channel_forces(eq)
    left, right = (channel_forces(eq.of_tendon(i)) for i in range(2))
    there = np.asarray(left.length) > 0
    assert np.all(np.asarray(left.turn)[there] == 1.0)
    assert np.all(np.asarray(left.friction)[there] > 0), "pulled harder, it slips towards the base"
    assert np.all(np.asarray(right.friction)[there] < 0), "and drags the other towards the tip"
