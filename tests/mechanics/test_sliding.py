"""Slip that outlasts a reversal where friction grows with its speed: the blind benchmark's machine."""

import dataclasses
import itertools
from pathlib import Path

import jax
import numpy as np
import pytest

import gtr_jax as gtr
from benchmarks.blind import machine
from benchmarks.sliding import DT, HISTORIES, in_parts, thread
from benchmarks.sliding import sampled as history
from benchmarks.terms import compared
from gtr_jax.config.config import load_config, parse_config
from tests.benchmarks.test_blind import ARM
from tests.mechanics.test_events import ours
from tests.terms.test_spatial_terms import PARALLEL, SOFT, TURN

REVERSAL, INNER = (HISTORIES[name] for name in ("one reversal, holds", "two inner loops"))
# Coefficient [s/m], exponent, and the rms that is allowed of the tip tension [N], with four steps for each of
# the machine's samples. Points that keep the tension that friction could hold: 0.03 to 1.4 N.
LAWS = {
    "faint": (5.0, 1.0, 0.02),
    "weak": (20.0, 1.0, 0.05),
    "strong": (200.0, 1.0, 0.06),
    "of a film": (40.0, 0.7, 0.07),
}


def viscous(coefficient, exponent=1.0):
    return {"viscous-friction.coefficient": coefficient, "viscous-friction.exponent": exponent}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("corners", [REVERSAL, INNER], ids=["one reversal", "inner loops"])
def test_the_tip_tension_is_that_of_an_elastic_thread(corners, law):
    c, exponent, allowed = LAWS[law]
    time, T_base = history(corners)
    shown = machine.run(thread(c, exponent), time, T_base, parts=4)
    clock, T = in_parts(time, T_base, 4)
    run = gtr.simulate(ours(viscous(c, exponent)), T, time=clock)
    assert bool(run.converged.all()) and shown.worst < 5e-3
    off = np.asarray(run.T_tip)[::4] - shown.T_tip
    assert np.sqrt(np.mean(off**2)) < allowed, np.max(np.abs(off))


def test_steps_converge():
    time, T_base = history(INNER)
    tips = []
    for parts in (1, 4, 16):
        clock, T = in_parts(time, T_base, parts)
        run = gtr.simulate(ours(viscous(60.0)), T, time=clock)
        assert bool(run.converged.all())
        tips.append(np.asarray(run.T_tip)[::parts])
    apart = [np.sqrt(np.mean((a - b) ** 2)) for a, b in itertools.pairwise(tips)]
    assert apart[1] < 0.4 * apart[0] and apart[1] < 0.08, apart


def test_the_slip_is_found_at_every_reversal():
    """Between 0.875 and 0.9 N Newton's method went round in a cycle: the tip tension jumped by 0.2 N."""
    up, tips = np.linspace(0.0, 40.0, 11), []
    falls = (0.85, 0.86, 0.87, 0.88, 0.89, 0.9, 0.91)
    for fall in falls:
        T = np.append(up, 40.0 - fall)
        run = gtr.simulate(ours(viscous(5.0)), T, time=0.25 * np.arange(len(T)))
        assert bool(run.converged.all())
        tips.append((float(run.T_tip[-1]), 1e3 * float(run.displacement[-1])))
    # The tip hardly feels the release yet: falls that differ by 0.01 N differ by less than 1 mN and 1 um.
    assert np.max(np.abs(np.diff(tips, axis=0))) < 1e-3, tips


@pytest.mark.slow
def test_a_tendon_that_displacement_drives_finds_its_base_tension():
    """Of the displacements of finer steps: at reversals they fall by nanometres while the tension rises."""
    path = Path(__file__).parents[1] / "data" / "labelled" / "case-011" / "robot.toml"
    data = load_config(path).model_dump(mode="json", by_alias=True, exclude_none=True)
    pulled = gtr.build_robot(parse_config(data))
    data["tendon"]["drive"] = "displacement"
    drawn = gtr.build_robot(parse_config(data))
    corners = np.linspace(0, 20, 11), np.linspace(18, 4, 8), np.linspace(4, 15, 8)[1:], np.full(6, 15.0)
    T = np.concatenate(corners)
    clock = 0.5 * np.arange(len(T))
    fine, finer = in_parts(clock, T, 4)
    for coefficient in (5.0, 20.0, 60.0):
        values = viscous(coefficient) | {"mu": 0.3}
        want = gtr.simulate(pulled.with_values(**values), finer, time=fine)
        out = np.asarray(want.displacement)[::4]
        for parts in (1, 4):
            time, way = in_parts(clock, out, parts)
            run = gtr.simulate(drawn.with_values(**values), np.zeros_like(way), displacement=way, time=time)
            assert bool(run.converged.all()), (coefficient, parts)
            np.testing.assert_allclose(run.displacement, way, atol=1e-11)
        assert np.sqrt(np.mean((run.T_tip - want.T_tip) ** 2)) < 0.02


# Friction beside that of the speed: of the machine, and ours.
BESIDE = {
    "drag": (machine.Laws(drag=4.0), {"adhesion.drag": 4.0}),
    "lumped at the base": (machine.Laws(entry=0.2), {"local-friction.base": 0.2}),
    "lumped at the tip": (machine.Laws(exit=0.2), {"local-friction.tip": 0.2}),
}


@pytest.mark.parametrize("beside", BESIDE)
def test_beside_other_friction(beside):
    laws, values = BESIDE[beside]
    time, T_base = history(REVERSAL)
    laws = dataclasses.replace(laws, friction=lambda guides: 1 + 60.0 * np.abs(guides.flow) / ARM.friction)
    shown = machine.run(dataclasses.replace(ARM, laws=laws), time, T_base, parts=4)
    clock, T = in_parts(time, T_base, 4)
    run = gtr.simulate(ours(viscous(60.0) | values), T, time=clock)
    off = np.asarray(run.T_tip)[::4] - shown.T_tip
    assert bool(run.converged.all()) and np.sqrt(np.mean(off**2)) < 0.06, np.max(np.abs(off))


@pytest.mark.slow
def test_derivatives_after_a_reversal():
    time, T_base = history(REVERSAL)

    robot = ours({})

    def last(numbers):
        run = gtr.simulate(robot.with_values(**numbers), T_base, time=time, with_terms=True)
        return run.T_tip[round(11.0 / DT)]

    numbers = viscous(60.0) | {"mu": 0.3, "E": 1.5e6}
    slopes = jax.grad(last)(numbers)
    tip = jax.jit(last)
    for name in ("viscous-friction.coefficient", "mu", "E"):
        step = 1e-5 * numbers[name]
        up, down = (float(tip(numbers | {name: numbers[name] + s * step})) for s in (1, -1))
        assert float(slopes[name]) * numbers[name] == pytest.approx((up - down) / 2e-5, rel=2e-3, abs=1e-3), (
            name
        )


def test_in_a_plane_of_space_it_is_the_same(make_robot):
    time, T_base = history(INNER)
    terms = [{"kind": "viscous-friction", "coefficient": 60.0}]
    flat = make_robot(routing=PARALLEL, backbone=SOFT, terms=terms)
    turned = make_robot(routing=PARALLEL | {"plane_angle": TURN}, backbone=SOFT, space=True, terms=terms)
    runs = [gtr.simulate(robot, 0.2 * T_base, time=time) for robot in (flat, turned)]
    assert all(bool(run.converged.all()) for run in runs)
    np.testing.assert_allclose(np.asarray(runs[1].T_tip).ravel(), runs[0].T_tip, rtol=1e-5)


def test_the_run_of_another_simulator_until_the_first_release():
    folder = Path(__file__).parents[1] / "data" / "reference" / "viscous-friction"
    c = compared(folder)
    # That simulator keeps the tension of points that friction could hold, also while they slip.
    assert c.converged and c.tension[:70].max() < 0.02 and 1.0 < c.tension.max() < 3.0
