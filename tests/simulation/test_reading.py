"""What the load cells show stands in a simulation, in Python as in the command's file."""

import csv

import numpy as np
import pytest
from command_line import run_gtr

import gtr_jax as gtr
from gtr_jax.examples import SIMULATED

LOOP = np.concatenate([np.linspace(0, 40, 13), np.linspace(40, 0, 13)[1:]])
TIME = 0.5 * np.arange(len(LOOP))
CELLS = {"tip-gain.gain": 1.08, "base-offset.force": 0.4, "low-pass.tip": 0.3, "time-skew.delay": -0.7}


@pytest.fixture(scope="module")
def robot():
    return gtr.load_robot(SIMULATED)


def test_a_simulation_holds_what_the_cells_show(robot):
    case = robot.with_values(**CELLS)
    run = gtr.simulate(case, LOOP, time=TIME)
    expected = gtr.reading(case, run)  # of these steps alone, not of those it is padded with
    np.testing.assert_allclose(run.reading.T_tip, expected.T_tip, atol=1e-12)
    np.testing.assert_allclose(run.reading.T_base, LOOP + 0.4, atol=1e-12)
    plain = gtr.simulate(robot, LOOP, time=TIME)
    np.testing.assert_allclose(run.T_tip, plain.T_tip, atol=1e-9)  # the true tension is the same
    assert np.abs(run.reading.T_tip - run.T_tip).max() > 0.5


def test_without_a_term_of_the_cells_they_show_the_truth(robot):
    run = gtr.simulate(robot, LOOP)
    np.testing.assert_array_equal(run.reading.T_tip, run.T_tip)
    np.testing.assert_array_equal(run.reading.T_base, LOOP)


def test_the_command_writes_the_same_readings_and_the_true_tensions(robot, tmp_path, capsys):
    (tmp_path / "gain.toml").write_text(
        SIMULATED.read_text() + '\n[[terms]]\nkind = "tip-gain"\ngain = 1.08\n', encoding="utf-8"
    )
    out = tmp_path / "out"
    done = run_gtr(capsys, "simulate", tmp_path / "gain.toml", "--pull", "40", "--steps", "8", "-o", out)
    assert done.status == 0 and done.err.count("warning: A physics term of the load cells acts") == 1
    rows = list(csv.DictReader((out / "simulation.csv").read_text().splitlines()))
    run = gtr.simulate(gtr.load_robot(tmp_path / "gain.toml"), np.linspace(0, 40, 9))
    for name, values in {
        "T_base_N": run.reading.T_base,
        "T_tip_N": run.reading.T_tip,
        "T_base_true_N": run.T_base,
        "T_tip_true_N": run.T_tip,
    }.items():
        np.testing.assert_allclose([float(row[name]) for row in rows], values, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run.reading.T_tip, 1.08 * run.T_tip, rtol=1e-12)
