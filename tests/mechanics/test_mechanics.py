"""What the mechanics demands of any routing and load: the moment identity, virtual work, symmetry,
dissipation, loops.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from tests.conftest import CROSS, PARALLEL, ROUTINGS, SINE, TABLE, WAVE

LOADS = {"gravity_angle": -1.2, "tip_force": [0.05, -0.08], "tip_moment": 0.002}
BORES = {
    "bores": [{"from": 0.0, "to": 0.05, "diameter": 0.012}, {"from": 0.12, "to": 0.25, "diameter": 0.01}]
}


def literal_moment(robot, eq, metric: bool):
    """Eqs. (15) and (16) of Liu & Alambeigi in numpy, from the solved shape; with the factor nu = ds_c/ds, or
    as printed.
    """
    s, kappa, phi, T = (np.asarray(a) for a in (eq.s, eq.curvature, eq.angle, eq.tension))
    keep = np.concatenate([[True], np.diff(s) > 0])
    s, kappa, phi, T = s[keep], kappa[keep], phi[keep], T[keep]
    x, y, R = (np.asarray(a)[keep] for a in (eq.x, eq.y, eq.R))
    p = np.stack([x, y])
    normal = np.stack([-np.sin(phi), np.cos(phi)])
    channel = p + R * normal
    slope = np.gradient(R, s, edge_order=2)
    lead = 1 - R * kappa
    psi = phi + np.arctan2(slope, lead)
    nu = np.hypot(slope, lead)
    tangent = np.stack([np.cos(psi), np.sin(psi)])
    # Forces of the tendon on the body per channel length: T kappa_c across, dT/ds_c along the channel.
    turn = np.gradient(psi, s, edge_order=2) / nu
    drop = np.gradient(T, s, edge_order=2) / nu
    force = T * turn * np.stack([-np.sin(psi), np.cos(psi)]) + drop * tangent
    if metric:
        force = force * nu
    anchor = -T[-1] * tangent[:, -1]
    total = np.empty_like(s)
    for i in range(len(s)):
        arm = channel[:, i:] - p[:, i : i + 1]
        moment = arm[0] * force[1, i:] - arm[1] * force[0, i:]
        tip = channel[:, -1] - p[:, i]
        total[i] = np.trapezoid(moment, s[i:]) + tip[0] * anchor[1] - tip[1] * anchor[0]
    identity = T * R * lead / nu
    return s, total, identity


@pytest.mark.parametrize("routing", [WAVE, CROSS, TABLE], ids=["wave", "cross", "table"])
def test_local_moment_identity_is_the_papers_integrals_with_the_metric_factor(routing, make_robot):
    robot = make_robot(12.0, routing=routing)
    eq = gtr.equilibrium(robot, 30.0)
    _, literal, identity = literal_moment(robot, eq, metric=True)
    scale = np.abs(identity).max()
    assert np.abs(literal - identity).max() < 2e-3 * scale
    _, printed, _ = literal_moment(robot, eq, metric=False)
    assert np.abs(printed - identity).max() > 1e-2 * scale, "eq. (16) as printed lacks nu, and it shows"


@pytest.mark.parametrize("routing", list(ROUTINGS.values()), ids=list(ROUTINGS))
def test_virtual_work(routing, make_robot):
    """For any virtual curvature: EI (kappa - kappa_0) dkappa = -T dnu + F dp_tip + weight dp + M_tip
    dphi_tip.
    """
    robot = make_robot(2.0, routing=routing, loads=LOADS, backbone={**BORES, "natural_curvature": 1.5})
    eq = gtr.equilibrium(robot, 12.0)
    assert bool(eq.converged)
    from gtr_jax.mechanics.channel import metric_factor
    from gtr_jax.mechanics.mesh import cumulative
    from gtr_jax.robot.robot import distal_mass, lay_out, sections

    s = sections(robot)
    at = lay_out(robot)
    w = s.mesh.weights
    weight = distal_mass(robot, at) * robot.loads.gravity
    g = robot.loads.gravity_angle

    def work(kappa):
        phi = cumulative(w, kappa)
        elastic = cumulative(w, 0.5 * (kappa - s.rest) ** 2 / s.compliance)[-1]
        tendon = cumulative(w, jax.lax.stop_gradient(eq.tension) * metric_factor(kappa, s.R))[-1]
        # Weight of what is distal works along each element: integral of n_ext . t ds.
        x = cumulative(w, (robot.loads.tip_force[0] + weight * jnp.cos(g)) * jnp.cos(phi))[-1]
        y = cumulative(w, (robot.loads.tip_force[1] + weight * jnp.sin(g)) * jnp.sin(phi))[-1]
        return elastic + tendon - x - y - robot.loads.tip_moment * phi[-1]

    gradient = jax.grad(work)(eq.curvature)
    for seed in range(3):
        a, b, c = np.random.default_rng(seed).normal(size=3)
        test = a + b * jnp.cos(9 * s.mesh.s / 0.25) + c * s.mesh.s / 0.25
        moment = jnp.abs((eq.curvature - s.rest) / s.compliance * test)
        scale = float(cumulative(w, moment)[-1])
        assert abs(float(jnp.sum(gradient * test))) < 2e-5 * scale


@pytest.mark.parametrize("routing", [SINE, WAVE, CROSS, PARALLEL], ids=["sine", "wave", "cross", "parallel"])
def test_mirror_symmetry(routing, make_robot):
    flip = {k: (-v if k in ("r1", "r2", "R_max", "r_min", "offset") else v) for k, v in routing.items()}
    down = {"gravity_angle": 1.2, "tip_force": [0.05, 0.08], "tip_moment": -0.002}
    history = np.array([0.0, 10.0, 20.0, 12.0, 4.0, 9.0])
    one = gtr.simulate(make_robot(routing=routing, loads=LOADS), history)
    two = gtr.simulate(make_robot(routing=flip, loads=down), history)
    np.testing.assert_allclose(one.T_tip, two.T_tip, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(one.tip_pose * np.array([[1.0, -1.0, -1.0]]), two.tip_pose, rtol=0, atol=1e-8)


def loop(peak=20.0, steps=60, cycles=1):
    up = np.linspace(0, peak, steps)
    return np.concatenate([up, up[-2::-1]] + [np.concatenate([up[1:], up[-2::-1]])] * (cycles - 1))


@pytest.mark.parametrize("routing", [SINE, CROSS, PARALLEL], ids=["sine", "cross", "parallel"])
def test_dissipation_never_negative_and_loops_close(routing, make_robot):
    steps = 80
    history = loop(20.0, steps, cycles=3)
    run = gtr.simulate(make_robot(routing=routing), history)
    assert bool(jnp.all(run.converged))
    T, u = np.asarray(run.T_base), np.asarray(run.displacement)
    work = np.cumsum(0.5 * (T[1:] + T[:-1]) * np.diff(u))
    ends = np.array([1, 2, 3]) * 2 * (steps - 1) - 1
    per_cycle = np.diff(np.concatenate([[0.0], work[ends]]))
    assert np.all(per_cycle > 0), "work put in over a closed loop is what friction took"
    np.testing.assert_allclose(per_cycle, per_cycle[0], rtol=1e-6)
    # Loop closure: every cycle repeats the first, and at zero tension the robot is straight again.
    first = np.asarray(run.T_tip)[: 2 * steps - 1]
    third = np.asarray(run.T_tip)[2 * 2 * (steps - 1) :]
    np.testing.assert_allclose(third, first, atol=1e-6)
    np.testing.assert_allclose(run.tip_pose[-1], np.array([0.25, 0.0, 0.0]), atol=1e-9)


def test_an_inner_loop_dissipates_and_closes(make_robot):
    inner = np.concatenate([np.linspace(0, 20, 30), np.linspace(19, 12, 30), np.linspace(12.2, 20, 30)])
    again = np.concatenate([np.linspace(19, 12, 30), np.linspace(12.2, 20, 30)])
    run = gtr.simulate(make_robot(routing=SINE), np.concatenate([inner, again]))
    assert float(run.T_tip[89]) == pytest.approx(float(run.T_tip[29]), rel=1e-9)
    T, u = np.asarray(run.T_base)[89:], np.asarray(run.displacement)[89:]
    assert np.sum(0.5 * (T[1:] + T[:-1]) * np.diff(u)) > 0
    assert u[-1] == pytest.approx(u[0], abs=1e-9)


def test_algorithm_one_on_a_sequential_history(make_robot):
    """Tip tension constant through the transition, which ends at the solved-for switch and not at a grid
    point.
    """
    robot = make_robot(routing=SINE, backbone=BORES)
    up, down = np.linspace(0, 45, 46), np.linspace(44.5, 0, 90)
    run = gtr.simulate(robot, np.concatenate([up, down]))
    phases = gtr.label_phases(run)
    assert phases[0] == "rest" and set(phases[1:46]) == {"pulling"}
    switch = gtr.release_switch(robot, 45.0)
    released = phases[46:] == "releasing"
    np.testing.assert_array_equal(released, down < float(switch.T_base))
    np.testing.assert_allclose(run.T_tip[46:][~released], float(switch.T_tip), rtol=1e-9)
    fronts = np.asarray(run.slip_front)[46:][~released]
    assert np.all(np.diff(fronts) >= 0) and fronts[0] < 0.05, "the slipping stretch grows from the base"
    before, after = (
        gtr.simulate(robot, jnp.stack([jnp.asarray(45.0), switch.T_base * f])) for f in (1.001, 0.999)
    )
    assert float(before.T_tip[1]) == pytest.approx(float(switch.T_tip), rel=1e-9)
    assert float(after.T_tip[1]) < float(switch.T_tip) * (1 - 1e-4)


def test_a_repull_from_transition_keeps_the_far_tendon_locked(make_robot):
    run = gtr.simulate(make_robot(routing=SINE), np.array([0.0, 20.0, 15.0, 17.0, 25.0]))
    assert list(gtr.label_phases(run)) == ["rest", "pulling", "transition", "transition", "pulling"]
    locked = np.asarray(run.s) > float(run.slip_front[3])
    np.testing.assert_allclose(run.tension[3][locked], run.tension[2][locked], rtol=1e-9)
    assert float(run.slip_direction[2]) == -1 and float(run.slip_direction[3]) == 1


def test_without_friction_the_tension_is_uniform_and_the_path_does_not_matter(make_robot):
    robot = make_robot(routing=WAVE, tendon={"friction_coefficient": 0.0})
    run = gtr.simulate(robot, np.array([0.0, 20.0, 5.0, 10.0]))
    np.testing.assert_allclose(
        run.tension, jnp.broadcast_to(run.T_base[:, None], run.tension.shape), atol=1e-12
    )
    straight = gtr.equilibrium(robot, 10.0)
    np.testing.assert_allclose(run.tip_pose[-1], straight.tip_pose, atol=1e-10)


def test_preload_is_the_memory_before_the_first_load(make_robot):
    robot = make_robot(routing=SINE, tendon={"preload": 5.0})
    run = gtr.simulate(robot, np.array([5.0, 5.5, 30.0, 0.0]))
    assert float(run.T_tip[0]) == pytest.approx(5.0), "a tendon at its preload stays there"
    assert float(run.T_tip[1]) == pytest.approx(5.0), "a little more at the base does not reach the tip"
    slack = gtr.simulate(make_robot(routing=SINE), np.array([30.0]))
    assert float(run.T_tip[2]) == pytest.approx(float(slack.T_tip[0]), rel=1e-9), "a full pull forgets it"
    assert float(run.T_tip[3]) == 0.0


def test_natural_curvature_alone_is_the_shape_at_rest(make_robot):
    eq = gtr.equilibrium(make_robot(backbone={"natural_curvature": 4.0}), 0.0)
    a = 4.0 * 0.25
    np.testing.assert_allclose(eq.tip_pose, [np.sin(a) / 4, (1 - np.cos(a)) / 4, a], rtol=1e-7)


def test_tip_moment_bends_a_uniform_rod_to_an_arc(make_robot):
    robot = make_robot(backbone={"outer_radius": [0.013, 0.013]}, loads={"tip_moment": 0.05})
    eq = gtr.equilibrium(robot, 0.0)
    assert float(eq.tip_pose[2]) == pytest.approx(0.05 * 0.25 / (1.06e6 * np.pi / 4 * 0.013**4), rel=1e-9)


def test_gravity_direction_is_an_angle_from_the_base_tangent(make_robot):
    tips = [
        gtr.equilibrium(make_robot(loads={"gravity_angle": a}), 0.0).tip_pose
        for a in (-np.pi / 2, np.pi / 2, 0.0)
    ]
    assert float(tips[0][1]) < -1e-3 and float(tips[1][1]) == pytest.approx(-float(tips[0][1]), rel=1e-8)
    assert float(tips[2][1]) == pytest.approx(0.0, abs=1e-9), (
        "gravity along the robot stretches, bends nothing"
    )
