"""Superelastic metal that unloads on a lower plateau: one section, inner loops, robots in plane and space."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import gtr_jax as gtr
from gtr_jax.config.config import parse_config
from gtr_jax.robot.build import build_robot
from gtr_jax.terms import superelastic
from gtr_jax.terms.term import Bent

E, RADIUS, ARM, LENGTH = 50e9, 1e-3, 0.8e-3, 0.1
EI = E * np.pi / 4 * RADIUS**4
SOFTENING, STRAIN, HYSTERESIS = 0.85, 0.01, 0.5
NUMBERS = {"softening": SOFTENING, "strain": STRAIN, "hysteresis": HYSTERESIS}


def rod(mu=0.0, *, routing=None, **more):
    """A rod of nitinol with a tendon beside its axis, which bends it by its tension alone."""
    return build_robot(
        parse_config(
            {
                "schema": 1,
                "backbone": {"length": LENGTH, "outer_radius": RADIUS, "youngs_modulus": E},
                "routing": routing or {"kind": "parallel", "offset": ARM},
                "tendon": {"friction_coefficient": mu},
                "terms": [{"kind": "superelastic", **NUMBERS}],
                **more,
            }
        )
    )


def transformed(bent, strain):
    """Curvature that a rectangular section of a bilinear material has transformed under loading [1/m]."""
    x = abs(bent) * RADIUS / strain
    return bent * (1 - 1.5 / x + 0.5 / x**3) if x > 1 else 0.0


def plateau(bent, strain):
    """Moment over EI while the section transforms, upper or lower plateau by the strain."""
    return bent - SOFTENING * transformed(bent, strain)


def inverted(moment, strain):
    """Curvature at which a plateau has a moment over EI."""
    root: Any = brentq(lambda bent: plateau(bent, strain) - moment, 0.0, 200.0, xtol=1e-13)
    return root


def test_a_section_under_a_moment_runs_through_the_flag():
    """Up the upper plateau, down elastically, down the lower plateau, and straight at the end."""
    top = 14.0
    T = np.array([0, 4, 8, 12, top, 13, 12, 10, 8, 6, 4, 2, 0]) * EI / ARM
    run = gtr.simulate(rod(), T)
    assert np.all(run.converged)
    bent = np.asarray(run.curvature)
    np.testing.assert_allclose(bent, bent[:, :1] * np.ones_like(bent), rtol=1e-9, atol=1e-12)
    most = inverted(top, STRAIN)
    held = SOFTENING * transformed(most, STRAIN)
    low = STRAIN * (1 - HYSTERESIS)
    up = [inverted(m, STRAIN) if m else 0.0 for m in (0, 4, 8, 12, top)]
    down = [min(m + held, inverted(m, low)) if m else 0.0 for m in (13, 12, 10, 8, 6, 4, 2, 0)]
    assert up[3] < down[1] - 1.0 and down[0] == 13 + held, "the loop is open, and begins elastically"
    np.testing.assert_allclose(bent[:, 0], [*up, *down], rtol=1e-8, atol=1e-9)


def test_without_hysteresis_unloading_is_loading():
    T = np.concatenate([np.linspace(0, 14, 8), np.linspace(14, 0, 8)[1:]]) * EI / ARM
    bent = np.asarray(gtr.simulate(rod().with_values(**{"superelastic.hysteresis": 0.0}), T).curvature)[:, 0]
    np.testing.assert_allclose(bent, bent[::-1], rtol=1e-8, atol=1e-10)


def moments(bend, numbers, way):
    """Moment over EI beyond the linear one along a way of the curvature, (K,)."""
    kept, found = jnp.zeros(1), []
    for before, now in itertools.pairwise([0.0, *way]):
        extra, kept = bend(numbers, jnp.asarray(now), Bent(0.0, before, kept, jnp.ones(()), reach=RADIUS))
        found.append(float(extra))
    return np.asarray(found)


def test_inner_loops_close_and_no_bend_is_left():
    """Elastic between the plateaus, return to the point where an inner loop began, and nothing at the end."""
    way = [30.0, 18.0, 24.0, 18.0, 30.0, 0.0, -30.0, 0.0]
    extra = moments(superelastic.bend, NUMBERS, way)
    assert extra[1] == pytest.approx(extra[3], rel=1e-12) and extra[0] == pytest.approx(extra[4], rel=1e-12)
    assert extra[2] == pytest.approx(extra[1], rel=1e-12), "the inner loop is elastic: it loses nothing"
    assert extra[5] == extra[7] == 0.0 and extra[6] == -extra[0]
    cycle = np.concatenate([np.linspace(0, 30, 60), np.linspace(30, -30, 120), np.linspace(-30, 0, 60)])
    moment = cycle + moments(superelastic.bend, NUMBERS, cycle)
    assert np.trapezoid(moment, cycle) > 10.0


def test_both_plateaus_are_those_of_fibres_that_transform_one_by_one():
    """A rectangular section of fibres, each with a flag of its own: the envelope is exact, and between the
    plateaus, where its outer fibres turn back before its inner ones, the law is off by a few per cent, most
    where it meets its lower plateau itself.
    """
    y = (np.arange(4000) + 0.5) / 4000 * RADIUS
    low = STRAIN * (1 - HYSTERESIS)
    was, fibres = np.zeros_like(y), []
    low_again: Any = brentq(lambda e: transformed(e, low) - transformed(40.0, STRAIN), 20.0, 40.0)
    way = np.concatenate([np.linspace(0, 40, 41), np.sort([*np.linspace(0, 39, 40), low_again])[::-1]])
    for bent in way:
        was = np.clip(was, np.maximum(bent * y - STRAIN, 0), np.maximum(bent * y - low, 0))
        fibres.append(-SOFTENING * 3 / RADIUS**3 * np.mean(y * was) * RADIUS)
    extra, fibres = moments(superelastic.bend, NUMBERS, way), np.asarray(fibres)
    largest = np.max(way + fibres)
    np.testing.assert_allclose(extra[:41], fibres[:41], atol=1e-5 * largest)
    np.testing.assert_allclose(extra[62:], fibres[62:], atol=1e-5 * largest)
    off = np.abs(extra - fibres) / largest
    assert way[np.argmax(off)] == low_again and 0.0425 < np.max(off) < 0.0432


def test_no_hysteresis_leaves_the_law_reversible_in_space():
    rng = np.random.default_rng(5)
    numbers, kept = NUMBERS | {"hysteresis": 0.0}, (jnp.zeros(1),) * 3
    for _ in range(30):
        strain = rng.normal(0, 20, 3)
        extra, kept = superelastic.bend_in_space(
            numbers, tuple(strain), Bent((0.0,) * 3, strain, kept, jnp.ones(()), reach=RADIUS)
        )
        size = np.hypot(*strain[1:])
        wanted = -SOFTENING * transformed(size, STRAIN) / size * strain[1:]
        np.testing.assert_allclose(np.asarray(extra, float), [0.0, *wanted], atol=1e-11)


def test_bending_back_and_forth_in_space_is_that_of_the_plane():
    across, kept = np.array([0.0, 0.6, 0.8]), (jnp.zeros(1),) * 3
    way = [30.0, 18.0, 24.0, 12.0, 3.0, -40.0, 10.0]
    for now, want in zip(way, moments(superelastic.bend, NUMBERS, way), strict=True):
        at = Bent((0.0,) * 3, now * across, kept, jnp.ones(()), reach=RADIUS)
        extra, kept = superelastic.bend_in_space(NUMBERS, tuple(now * across), at)
        np.testing.assert_allclose(np.asarray(extra, float), want * across, atol=1e-11)


def test_a_bend_that_is_turned_round_loses_energy():
    """As a curved wire does that is turned about its axis: the moment lags behind the bend."""
    kept, done, last = (jnp.zeros(1),) * 3, 0.0, None
    for t in np.linspace(0, 4 * np.pi, 160):
        strain = 30.0 * np.array([0.0, np.sin(t), np.cos(t)])
        at = Bent((0.0,) * 3, strain, kept, jnp.ones(()), reach=RADIUS)
        extra, kept = superelastic.bend_in_space(NUMBERS, tuple(strain), at)
        moment = strain + np.asarray(extra, float)
        if last is not None and t > 2 * np.pi:
            done += 0.5 * (moment + last[1]) @ (strain - last[0])
        last = strain, moment
    assert done > 10.0


LOOPS = np.concatenate([np.linspace(*ends, 9)[1:] for ends in ((0, 900), (900, 350), (350, 700), (700, 0))])


@pytest.mark.slow
def test_a_robot_in_space_is_that_of_the_plane():
    runs = [gtr.simulate(rod(0.2, **more), LOOPS) for more in ({}, {"space": True})]
    assert all(np.all(run.converged) for run in runs)
    assert np.allclose(runs[0].tip_position[:, :2], runs[1].tip_position[:, :2], atol=1e-7)
    turned = {"kind": "parallel", "offset": ARM, "plane_angle": 0.7}
    run = gtr.simulate(rod(0.2, routing=turned), LOOPS)
    assert np.all(run.converged)
    across = np.hypot(run.tip_position[:, 1], run.tip_position[:, 2])
    np.testing.assert_allclose(across, np.abs(runs[0].tip_position[:, 1]), atol=1e-7)


@pytest.mark.parametrize("loads", [{}, {"tip_force": [0.0, -2.0]}], ids=["free", "loaded"])
def test_steps_of_any_size_are_solved(loads):
    """Between two plateaus the slope is steep, on either flat: Newton's method by itself would jump to and
    fro.
    """
    T = np.random.default_rng(3).uniform(0, 1000, 60)
    run = gtr.simulate(rod(0.2, loads=loads), T)
    assert np.all(run.converged)
    assert np.max(run.curvature) > 2.5 * STRAIN / RADIUS


@pytest.mark.slow
def test_gradients_of_a_loop():
    robot, names = rod(0.2), ("E", "mu", *(f"superelastic.{name}" for name in NUMBERS))

    def tip(values):
        changed = robot.with_values(**dict(zip(names, values, strict=True)))
        return gtr.simulate(changed, LOOPS[:28]).tip_pose[-1, 2]

    at = jnp.asarray([float(robot.value(name)) for name in names])
    slope = jax.grad(tip)(at)
    differences = [
        (tip(at.at[i].multiply(1 + 1e-5)) - tip(at.at[i].multiply(1 - 1e-5))) / (2e-5 * at[i])
        for i in range(len(names))
    ]
    assert np.allclose(slope, differences, rtol=2e-4)
    assert abs(float(slope[-1])) > 0.1


def test_hysteresis_without_a_plateau_is_refused():
    with pytest.raises(gtr.InputError, match=r"terms\.superelastic: .*softening"):
        rod(terms=[{"kind": "superelastic", "hysteresis": 0.5}])
