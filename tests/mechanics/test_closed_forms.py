"""Closed forms: states, gradients and observed order at the default mesh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from tests.systems import SYSTEMS, exact_gradient, parallel

TOLERANCE = 1e-6


def outputs(eq):
    x, y, angle = eq.tip_pose
    return {"T_tip": eq.T_tip, "x": x, "y": y, "angle": angle}


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.name)
def test_state_at_the_default_mesh(system, make_robot):
    eq = gtr.equilibrium(make_robot(**system.sections), system.T_base)
    assert bool(eq.converged)
    got = outputs(eq)
    for name, value in system.exact().items():
        assert float(got[name]) == pytest.approx(value, rel=TOLERANCE), name


@pytest.mark.parametrize("system", SYSTEMS[1:5:2], ids=lambda s: s.name)
def test_gradient_at_the_default_mesh(system, make_robot):
    robot = make_robot(**system.sections)
    names = list(system.at)

    def run(values):
        eq = gtr.equilibrium(robot.with_values(**dict(zip(names, values, strict=True))), system.T_base)
        return jnp.stack([outputs(eq)[output] for output in system.exact()])

    at = [jnp.asarray(v) for v in system.at.values()]
    forward, reverse = (jnp.stack(d(run)(at), axis=1) for d in (jax.jacfwd, jax.jacrev))
    for i, output in enumerate(system.exact()):
        for k, name in enumerate(names):
            expected = exact_gradient(system, output, name)
            assert float(forward[i, k]) == pytest.approx(expected, rel=3 * TOLERANCE), (output, name)
            assert float(reverse[i, k]) == pytest.approx(float(forward[i, k]), rel=1e-9), (output, name)


@pytest.mark.parametrize("output", ["T_tip", "angle"])
def test_order_is_at_least_two(output, make_robot):
    system = parallel(0.8, 25.0)
    nodes, errors = [], []
    for resolution in (0.25, 0.5, 1.0, 2.0):
        robot = make_robot(resolution, **system.sections)
        eq = gtr.equilibrium(robot, system.T_base)
        nodes.append(eq.s.shape[0])
        errors.append(abs(float(outputs(eq)[output]) - system.exact()[output]))
    order = -np.polyfit(np.log(nodes), np.log(errors), 1)[0]
    assert order >= 2, (order, errors)


def test_published_tdcm_targets(make_robot):
    """With the published T_base of 45 N: T_tip_max 22.0 / 23.9 N and T_base_switch 11.9 / 15.0 N (mu, E not
    published).
    """
    for bores, w, mu, E, tip, switch in (
        ([(0.0, 0.02), (0.08, 0.25)], (0.02, 0.08), 0.36, 1.06e6, 22.0, 11.9),
        ([(0.0, 0.07), (0.155, 0.25)], (0.07, 0.155), 0.24, 0.50e6, 23.9, 15.0),
    ):
        robot = make_robot(
            routing={"kind": "straight-sine-straight", "r1": -0.01, "r2": 0.01, "w1": w[0], "w2": w[1]},
            backbone={
                "youngs_modulus": E,
                "bores": [{"from": a, "to": b, "diameter": 0.014} for a, b in bores],
            },
            tendon={"friction_coefficient": mu},
        )
        found = gtr.release_switch(robot, 45.0)
        assert bool(found.converged)
        # mu and E are given to two figures: that is what the tolerance stands for.
        assert float(found.T_tip) == pytest.approx(tip, rel=0.02)
        assert float(found.T_base) == pytest.approx(switch, rel=0.02)


def play(history, width, start=0.0):
    """Play operator of ln T with half width `width`, written on T."""
    out, now = [], start
    for T in history:
        now = min(max(now, T * np.exp(-width)), T * np.exp(width))
        out.append(now)
    return np.array(out)


def test_rigid_sheath_is_a_play_operator(make_robot):
    rng = np.random.default_rng(3)
    robot = make_robot(
        routing={"kind": "parallel", "offset": 0.0},
        backbone={"length": 1.0, "outer_radius": [0.002, 0.002], "natural_curvature": 11.7, "rigid": True},
        tendon={"friction_coefficient": 0.06},
    )
    history = np.abs(np.cumsum(rng.normal(size=300)))
    run = gtr.simulate(robot, history)
    assert bool(jnp.all(run.converged))
    np.testing.assert_allclose(run.T_tip, play(history, 0.06 * 11.7), rtol=1e-12, atol=1e-14)


def test_frictionless_shape_that_three_codes_agree_on(make_config):
    """R = 10 mm, L = 0.4 m, E = 54 GPa, solid round r = 0.7 mm, T = 6 N: tip (0.119918, 0.289785) m, 2.3569
    rad.

    The rod is thinner than the offset (discs carry the tendon), so the body is given as a wider rod of the
    same EI. The closed form itself is (0.1199269, 0.2898054) m; the other codes' rods also give under the
    compression, T/EA = 7.2e-5, which is what both coordinates fall short by and the tolerance allows.
    """
    wide = 0.012
    E = 54e9 * (0.0007 / wide) ** 4
    config = make_config(
        routing={"kind": "parallel", "offset": 0.01},
        backbone={"length": 0.4, "outer_radius": [wide, wide], "youngs_modulus": E},
        tendon={"friction_coefficient": 0.0},
    )
    x, y, angle = gtr.equilibrium(gtr.build_robot(config), 6.0).tip_pose
    assert float(x) == pytest.approx(0.119918, abs=2e-5)
    assert float(y) == pytest.approx(0.289785, abs=3e-5)
    assert float(angle) == pytest.approx(2.3569, abs=1e-4)
