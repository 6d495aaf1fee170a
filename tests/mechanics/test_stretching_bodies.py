"""Bodies that the forces along them stretch and shorten: closed forms, the integrals of the forces, the limit
of a stiff axis, and derivatives.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from design.literal_in_space import solve_in_space
from gtr_jax.config.config import parse_config
from gtr_jax.report.profile import profile
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.channel_table import natural_shape
from gtr_jax.simulation.history import equilibrium_at
from gtr_jax.simulation.markers import marker_places

L, RADIUS, E = 0.2, 8e-3, 1e6
AREA, SECOND = np.pi * RADIUS**2, np.pi * RADIUS**4 / 4
HELIX = {"kind": "helix", "radius": 5e-3, "turns": 0.6, "start_angle": 0.5, "tip_radius": 3e-3}
LOADS = {"gravity": [2.0, 0.0, -9.81], "tip_force": [0.1, -0.1, 0.2], "tip_moment": [0.0, 2e-3, 1e-3]}


def soft(routing=HELIX, mu=0.2, resolution=1.0, backbone=(), **more):
    body = {"length": L, "outer_radius": RADIUS, "youngs_modulus": E, "extensible": True, **dict(backbone)}
    data = {
        "schema": 1,
        "backbone": body,
        "routing": routing,
        "tendon": {"friction_coefficient": mu, **more.pop("tendon", {})},
        **more,
    }
    return build_robot(parse_config(data), resolution=resolution)


def test_a_tendon_on_the_axis_only_shortens_the_body():
    robot = soft({"kind": "straight", "radius": 0.0, "angle": 0.0})
    run = gtr.simulate(robot, np.array([0.0, 2.0, 10.0]))
    assert np.all(run.converged)
    shorter = L * np.array([0.0, 2.0, 10.0]) / (E * AREA)
    assert np.allclose(run.tip_position[:, 0], L - shorter, rtol=1e-10)
    assert np.allclose(run.displacement, shorter, rtol=1e-10, atol=1e-15)
    written = profile(equilibrium_at(robot, run, 2))
    assert np.allclose(written["axial_strain"], -shorter[2] / L, rtol=1e-10)


def test_weight_hangs_on_what_is_above_it():
    density, g = 1200.0, 9.81
    body = {"density": density}
    robot = soft(
        {"kind": "straight", "radius": 0.0, "angle": 0.0},
        0.0,
        backbone=body,
        loads={"gravity": [g, 0.0, 0.0], "tip_force": [0.5, 0.0, 0.0]},
    )
    run = gtr.simulate(robot, np.array([0.0, 1.0]))
    longer = density * g * L**2 / (2 * E) + (0.5 - np.array([0.0, 1.0])) * L / (E * AREA)
    assert np.allclose(run.tip_position[:, 0], L + longer, rtol=1e-9)


def test_a_parallel_tendon_bends_to_an_arc_of_the_shortened_axis():
    R, T = 5e-3, 4.0
    robot = soft({"kind": "straight", "radius": R, "angle": 0.0}, 0.0)
    run = gtr.simulate(robot, np.array([0.0, T]))
    kappa, e = T * R / (E * SECOND), -T / (E * AREA)
    assert run.shape is not None and run.shape.stretch is not None
    assert np.allclose(run.shape.strain[-1, :, 2], kappa, rtol=1e-10)
    assert np.allclose(run.shape.stretch[-1], e, rtol=1e-10)
    reached = (1 + e) / kappa * np.array([np.sin(kappa * L), 1 - np.cos(kappa * L)])
    assert np.allclose(run.tip_position[-1, :2], reached, rtol=1e-8)
    assert run.displacement[-1] == pytest.approx(L * (R * kappa - e), rel=1e-9)


@pytest.mark.parametrize("loads", [{}, LOADS], ids=["free", "loaded"])
@pytest.mark.parametrize(
    "released_from", [pytest.param(None, marks=pytest.mark.slow), 9.0], ids=["pulled", "released"]
)
def test_the_integrals_of_all_forces_agree(loads, released_from):
    """The solver of designs sums the forces of the tendon on the body; none of it is used here."""
    body = {"density": 1100.0} if loads else {}
    robot = soft(backbone=body, loads=loads, resolution=2.0)
    T = 6.0
    path = np.concatenate([np.linspace(0, released_from or T, 30), np.linspace(released_from or T, T, 20)])
    run = gtr.simulate(robot, path)
    literal = solve_in_space(robot, T, released_from=released_from)
    assert literal.settled
    assert np.all(run.converged)
    assert np.allclose(run.tip_position[-1], literal.place, atol=2e-5 * L)
    assert float(run.T_tip[-1]) == pytest.approx(literal.T_tip, rel=1e-5)
    stiff = gtr.simulate(
        soft(backbone={**body, "extensible": False, "axial_stiffness": 1e9}, loads=loads), path
    )
    assert np.linalg.norm(stiff.tip_position[-1] - literal.place) > 0.005 * L


@pytest.mark.slow
def test_a_stiff_axis_is_that_of_a_body_that_keeps_its_length():
    path = np.concatenate([np.linspace(0, 9, 10), np.linspace(9, 2, 8)])
    for loads in ({}, LOADS):
        held = {"extensible": False, "density": 1100.0}
        one = gtr.simulate(soft(backbone={**held, "axial_stiffness": 1e12}, loads=loads), path)
        other = gtr.simulate(soft(backbone=held, loads=loads), path)
        assert np.allclose(one.tip_position, other.tip_position, atol=1e-9)
        assert np.allclose(one.T_tip, other.T_tip, atol=1e-8)


def test_past_its_anchor_a_tendon_shortens_nothing():
    robot = soft({"kind": "straight", "radius": 5e-3, "angle": 1.0}, tendon={"to": 0.6 * L})
    run = gtr.simulate(robot, np.array([0.0, 5.0]))
    assert run.shape is not None and run.shape.stretch is not None
    stretch, s = np.asarray(run.shape.stretch[-1]), np.asarray(run.s)
    assert np.allclose(stretch[s > 0.6 * L + 1e-9], 0.0, atol=1e-12)
    assert np.all(stretch[s < 0.6 * L - 1e-9] < -1e-3)


@pytest.mark.slow
def test_gradients_with_loads():
    robot = soft(backbone={"density": 1100.0}, loads=LOADS)
    T = jnp.linspace(0.0, 8.0, 4)

    def tip(E, mu):
        return gtr.simulate(robot.with_values(E=E, mu=mu), T).tip_position[-1, 0]

    slopes = jax.grad(tip, argnums=(0, 1))(E, 0.2)
    for slope, (dE, dmu) in zip(slopes, ((10.0, 0.0), (0.0, 1e-5)), strict=True):
        step = dE + dmu
        difference = (tip(E + dE, 0.2 + dmu) - tip(E - dE, 0.2 - dmu)) / (2 * step)
        assert float(slope) == pytest.approx(float(difference), rel=1e-4)


def test_markers_of_a_body_that_stretches_lie_on_it():
    markers = [{"name": "end", "at": L}, {"name": "half", "at": 0.37 * L, "offset": [1e-3, 2e-3, 3e-3]}]
    robot, fine = soft(markers=markers), soft(markers=markers, resolution=4.0)
    run = gtr.simulate(robot, np.array([0.0, 6.0]))
    assert np.allclose(marker_places(robot, run)[:, 0], run.tip_position, atol=1e-12)
    other = gtr.simulate(fine, np.array([0.0, 6.0]))
    assert np.allclose(marker_places(robot, run)[:, 1], marker_places(fine, other)[:, 1], atol=1e-7)


def test_the_unloaded_body_is_as_long_as_it_is_written():
    middle, frames = natural_shape(soft(), np.linspace(0.0, L, 11))
    assert np.allclose(middle[-1], [L, 0.0, 0.0], atol=1e-12)
    assert np.allclose(frames[-1], np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("backbone", "words"),
    [
        ({"rigid": True, "youngs_modulus": 0.0}, "no effect on a body with rigid"),
        ({"axial_stiffness": -1.0}, "must be positive"),
        ({"youngs_modulus": 0.0, "bending_stiffness": 1e-3}, "give axial_stiffness"),
    ],
)
def test_wrong_axes_are_refused(backbone, words):
    with pytest.raises(gtr.InputError, match=words):
        soft(backbone=backbone)


@pytest.mark.slow
def test_a_tendon_that_ends_early_knows_nothing_of_the_body_beyond():
    """The other tendon shortens all of the body; of the one that ends half-way only what lies before counts,
    of the body's length and of its own stretch."""
    give, EA = 1e-4, E * AREA
    on_axis = {"kind": "straight", "radius": 0.0, "angle": 0.0}
    beside = {"kind": "straight", "radius": 5e-3, "angle": 1.0}
    data = {
        "schema": 1,
        "backbone": {"length": L, "outer_radius": RADIUS, "youngs_modulus": E, "extensible": True},
        "tendons": [
            {"name": "half", "to": L / 2, "friction_coefficient": 0.0, "routing": on_axis},
            {"name": "whole", "friction_coefficient": 0.0, "routing": beside},
        ],
    }
    T = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0], [2.0, 3.0]])
    shorter = T.sum(axis=1) * L / 2 / EA
    for compliance in (0.0, give):
        terms = [{"kind": "tendon-stretch", "compliance": compliance}] if compliance else []
        robot = build_robot(parse_config({**data, "terms": terms}))
        run = gtr.simulate(robot, T)
        assert np.all(run.converged)
        wanted = shorter + compliance * T[:, 0] * L / 2
        assert np.allclose(run.displacement[:, 0], wanted, rtol=1e-7, atol=1e-12)
