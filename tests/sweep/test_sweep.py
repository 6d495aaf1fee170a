"""Sweeps: what the store holds is what the simulator says, and an interrupted sweep ends as a whole one."""

import errno
import hashlib
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from command_line import run_gtr

import gtr_jax as gtr
from gtr_jax.app.cli.run_folder import RunFolder
from gtr_jax.errors import InputError
from gtr_jax.robot.validity import is_robot
from gtr_jax.sweep import load_sweep, open_sweep, sweep, task_of
from gtr_jax.sweep.lanes import Lanes
from gtr_jax.sweep.plan import Plan, _chunk, draw
from gtr_jax.sweep.run import Meter, run_here
from gtr_jax.sweep.sensitivity import _on_grid, sensitivity_of
from gtr_jax.sweep.store import Store
from gtr_jax.sweep.summary import summary_of
from gtr_jax.sweep.task import PLAIN, lanes_of

EXAMPLES = Path(__file__).parents[2] / "examples"
ROBOT = """
schema = 1
name = "short"
[backbone]
length = "120 mm"
outer_radius = ["14 mm", "11 mm"]
youngs_modulus = "1.0 MPa"
density = "1070 kg/m^3"
[routing]
kind = "straight-sine-straight"
r1 = "-8 mm"
r2 = "8 mm"
w1 = "20 mm"
w2 = "60 mm"
[tendon]
friction_coefficient = 0.3
"""
GRID = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip", "tip_pose", "T_base_switch", "displacement"]
resolution = 0.25
[vary]
"tendon.friction_coefficient" = { from = 0.1, to = 0.5, count = 5 }
E = { from = "0.8 MPa", to = "1.6 MPa", count = 3, scale = "log" }
[history]
pull = "20 N"
"""


def written(folder, text=GRID, robot=ROBOT, name="sweep.toml"):
    (folder / "robot.toml").write_text(robot)
    (folder / name).write_text(text)
    return folder / name


def contents(store):
    """Hash of every file of a store."""
    files = sorted(p for p in Path(store).rglob("*") if p.is_file())
    return {str(p.relative_to(store)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    folder = tmp_path_factory.mktemp("grid")
    file = written(folder)
    return file, sweep(file, folder / "whole.zarr").load()


def test_a_grid_holds_what_the_simulator_says(grid):
    file, data = grid
    task = task_of(load_sweep(file))
    assert data.T_tip.dims == ("mu", "E")
    np.testing.assert_array_equal(data.mu, np.linspace(0.1, 0.5, 5))
    np.testing.assert_allclose(data.E, np.geomspace(0.8e6, 1.6e6, 3), rtol=1e-15)
    assert data.T_tip.attrs["units"] == "N" and data.E.attrs["units"] == "Pa"
    assert np.all(data.result == 0) and float(data.T_base) == 20.0
    for i, j in itertools.product(range(5), range(3)):
        robot = task.robot.with_values(mu=float(data.mu[i]), E=float(data.E[j]))
        eq = gtr.equilibrium(robot, 20.0)
        at = data.isel(mu=i, E=j)
        np.testing.assert_allclose(at.T_tip, eq.T_tip, rtol=1e-12)
        np.testing.assert_allclose([at.tip_x, at.tip_y, at.tip_angle], eq.tip_pose, rtol=1e-11)
        np.testing.assert_allclose(at.displacement, eq.slip[0], rtol=1e-9)
    switch = gtr.release_switch(task.robot.with_values(mu=0.1, E=0.8e6), 20.0)
    np.testing.assert_allclose(data.T_base_switch[0, 0], switch.T_base, rtol=1e-10)


def test_the_store_says_how_it_was_made(grid):
    _, data = grid
    assert "friction_coefficient = 0.3" in data.attrs["robot"]
    assert "[vary" in data.attrs["sweep"]
    assert data.attrs["gtr_jax"]
    assert data.T_base.attrs["long_name"]


def test_an_interrupted_sweep_ends_as_a_whole_one(tmp_path, monkeypatch):
    file = written(tmp_path)
    monkeypatch.setattr("gtr_jax.sweep.task.block_size", lambda *_: 4)
    task = task_of(load_sweep(file))
    assert task.plan.blocks == 5
    whole = Store(tmp_path / "whole.zarr", task)
    whole.create()
    run_here(task, whole, whole.left(), print)

    cut = Store(tmp_path / "cut.zarr", task)
    cut.create()
    run_here(task, cut, [3, 1], print, threads=1)
    assert cut.left() == [0, 2, 4]
    # Killed while it wrote block 2: some arrays are there, one is torn, the result is not.
    cut.write(2, Lanes(task).solve(cut.points(2)))
    (cut.path / "result" / "c" / "2" / "0").unlink()
    (cut.path / "T_tip" / "c" / "2" / "0.1234.partial").write_bytes(b"torn")
    again = Store(tmp_path / "cut.zarr", task)
    again.create()
    assert again.left() == [0, 2, 4]
    run_here(task, again, again.left(), print)
    again.clean()
    assert contents(again.path) == contents(whole.path)


def test_a_store_of_another_sweep_is_refused(tmp_path):
    file = written(tmp_path)
    there = Store(tmp_path / "a.zarr", task_of(load_sweep(file)))
    there.create()
    other = written(tmp_path, GRID.replace('"20 N"', '"21 N"'), name="other.toml")
    with pytest.raises(InputError, match=r"a\.zarr: holds a sweep of another"):
        Store(tmp_path / "a.zarr", task_of(load_sweep(other))).create()


HISTORY = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip", "tip_pose", "loss", "dissipation", "shape", "tension_profile", "gradients"]
resolution = 0.25
points = "points.csv"
[history]
pull = "20 N"
release = "0 N"
steps = 40
"""
POINTS = "mu, backbone.youngs_modulus [MPa], r2 [mm]\n0.2, 1.0, 8\n0.4, 1.3, 7\n0.3, 0.9, 14\n"


@pytest.fixture(scope="module")
def history(tmp_path_factory):
    folder = tmp_path_factory.mktemp("history")
    file = written(folder, HISTORY)
    (folder / "points.csv").write_text(POINTS)
    return file, sweep(file, folder / "out.zarr").load()


def _run(task, mu, E, r2):
    T = np.concatenate([np.linspace(0, 20, 41), np.linspace(20, 0, 41)[1:]])
    robot = task.robot.with_values(mu=mu, E=E, r2=r2)
    return robot, gtr.simulate(robot, T)


def test_points_of_a_file_run_through_a_history(history):
    file, data = history
    task = task_of(load_sweep(file))
    assert data.sizes["point"] == 3 and data.sizes["step"] == 2
    np.testing.assert_array_equal(data.T_base, [20.0, 0.0])
    np.testing.assert_array_equal(data.step, [40, 80])
    np.testing.assert_allclose(data.E[:2], [1.0e6, 1.3e6])
    robot, run = _run(task, 0.4, 1.3e6, 0.007)
    at = data.isel(point=1)
    np.testing.assert_allclose(at.T_tip, run.T_tip[np.array([40, 80])], rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(at.tension, run.tension[np.array([40, 80])], rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(at.loss[0], 1 - run.T_tip[40] / 20.0, rtol=1e-11)
    eq = gtr.equilibrium_at(robot, run, 40)
    np.testing.assert_allclose(at.x[0], eq.x, rtol=1e-11, atol=1e-15)
    np.testing.assert_allclose(at.y[0], eq.y, rtol=1e-11, atol=1e-15)
    np.testing.assert_allclose(at.s, eq.s, rtol=1e-12)


def test_pictures_and_indices_are_of_the_largest_pull(history):
    file, data = history
    assert float(data.T_base[task_of(load_sweep(file)).history.shown]) == 20.0


def test_what_is_no_robot_is_said_to_be_none(history):
    _, data = history
    np.testing.assert_array_equal(data.result, [0, 0, 3])  # a channel at 14 mm in a body of 11 to 14 mm
    assert np.all(np.isnan(data.T_tip[2])) and np.all(np.isnan(data.x[2]))


def test_friction_takes_what_a_closed_loop_does_not_give_back(history):
    file, data = history
    _, run = _run(task_of(load_sweep(file)), 0.2, 1.0e6, 0.008)
    work = np.trapezoid(np.asarray(run.T_base), np.asarray(run.displacement))
    assert float(data.dissipation[0]) > 0
    np.testing.assert_allclose(data.dissipation[0], work, rtol=0.02)  # a coarse mesh


def test_gradients_are_those_of_differences(history):
    file, data = history
    task = task_of(load_sweep(file))
    usual = {"mu": 0.2, "E": 1.0e6, "r2": 0.008}
    for name, step in (("mu", 1e-5), ("E", 20.0), ("r2", 1e-7)):
        _, up = _run(task, **usual | {name: usual[name] + step})
        _, down = _run(task, **usual | {name: usual[name] - step})
        slope = (up.T_tip[40] - down.T_tip[40]) / (2 * step)
        np.testing.assert_allclose(data[f"dT_tip_d{name}"][0, 0], slope, rtol=1e-5)
        slope = (up.tip_pose[40, 1] - down.tip_pose[40, 1]) / (2 * step)
        np.testing.assert_allclose(data[f"dtip_y_d{name}"][0, 0], slope, rtol=1e-5)
    assert data.dT_tip_dE.attrs["units"] == "N/Pa"


def test_terms_external_forces_and_a_varied_pull(tmp_path):
    text = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip", "tip_pose"]
resolution = 0.25
[vary]
tip_force_y = ["-0.1 N", "0.1 N"]
"tip-gain.gain" = [1.0, 1.05]
"history.pull" = ["10 N", "20 N"]
"""
    file = written(tmp_path, text)
    data = sweep(file, tmp_path / "out.zarr").load()
    task = task_of(load_sweep(file))
    assert not task.by_slip and task.robot.loaded
    assert data.T_base.dims == ("tip_force_y", "tip-gain.gain", "pull")
    robot = task.robot.with_values(tip_force_y=-0.1)
    eq = gtr.equilibrium(robot, 10.0)
    at = data.isel({"tip_force_y": 0, "tip-gain.gain": 1, "pull": 0})
    np.testing.assert_allclose(at.T_tip, 1.05 * eq.T_tip, rtol=1e-10)
    np.testing.assert_allclose(at.tip_y, eq.tip_pose[1], rtol=1e-8)


def test_lanes_that_need_shares_of_the_load_are_solved_again(tmp_path):
    """A force under which the whole load at once does not settle."""
    text = """
schema = 1
robot = "robot.toml"
outputs = ["tip_pose"]
resolution = 0.25
[vary]
E = { from = "0.25 MPa", to = "0.4 MPa", count = 4 }
tip_force_x = { from = "-30 N", to = "0 N", count = 31 }
[history]
pull = "2 N"
"""
    file = written(tmp_path, text, ROBOT)
    task = task_of(load_sweep(file))
    lanes = Lanes(task)
    blocks = [task.plan.on_grid(i) for i in range(task.plan.blocks)]
    first = np.concatenate([lanes._padded(lanes._first, b, task.batch)["result"] for b in blocks])
    whole = {k: np.concatenate([lanes.solve(b)[k] for b in blocks]) for k in ("tip_x", "result")}
    done = whole["result"] == 0
    assert np.any(first != 0), "the case is too easy"
    assert np.all(done[first == 0]) and np.sum(done) > np.sum(first == 0)
    assert np.all(np.isfinite(whole["tip_x"][done]))
    assert np.all(np.isnan(whole["tip_x"][~done]))


def test_draws_beyond_the_bounds_are_no_robots(tmp_path):
    text = drawn("random", 4000).replace('{ from = "0.8 MPa", to = "1.6 MPa", scale = "log" }', NORMAL)
    data = sweep(written(tmp_path, text), tmp_path / "out.zarr").load()
    below = data.E.values <= 0
    assert below.any()
    np.testing.assert_array_equal(data.result == 3, below)
    assert np.all(data.result.values[data.E.values > 0.2e6] == 0)  # a modulus near nothing need not converge
    np.testing.assert_array_equal(np.isnan(data.T_tip), data.result != 0)


NORMAL = '{ mean = "1 MPa", sd = "0.33 MPa" }'
ROUGH = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip"]
[vary]
"local-friction.factor" = [1.0, 2.0]
"local-friction.start" = ["20 mm", "90 mm"]
"local-friction.end" = ["60 mm", "100 mm"]
[history]
pull = "20 N"
"""


def test_the_rules_of_a_term_hold_at_every_point(tmp_path):
    task = task_of(load_sweep(written(tmp_path, ROUGH)))
    lanes = object.__new__(Lanes)
    points = np.concatenate([task.plan.on_grid(block) for block in range(task.plan.blocks)])
    lanes.task = task
    found = {"result": np.zeros(len(points), np.uint8), "T_tip": np.ones(len(points))}
    lanes._refuse(points, found)
    factor, start, end = points.T
    wrong = (factor != 1) & (start >= end)
    assert wrong.any()
    np.testing.assert_array_equal(found["result"] == 3, wrong)
    np.testing.assert_array_equal(np.isnan(found["T_tip"]), wrong)


def test_a_term_that_a_rigid_sheath_cannot_have(tmp_path):
    robot = ROBOT.replace('youngs_modulus = "1.0 MPa"\ndensity = "1070 kg/m^3"', "rigid = true")
    text = (
        ROUGH.split("[vary]")[0]
        + """[vary]
"presliding.length" = ["0.5 mm", "1 mm"]
[history]
pull = "20 N"
"""
    )
    with pytest.raises(InputError, match=r"vary\.presliding\.length: .*slips"):
        task_of(load_sweep(written(tmp_path, text, robot)))


def test_times_of_a_history_decide_what_is_computed(tmp_path):
    text = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip"]
[vary]
"zero-drift.tip" = [0.01, 0.02]
[history]
file = "h.csv"
"""
    rows = "time_s,T_base_N\n0,0\n{0},10\n{1},5\n"
    prints = []
    for times in ((1, 2), (10, 20)):
        (tmp_path / "h.csv").write_text(rows.format(*times))
        task = task_of(load_sweep(written(tmp_path, text)))
        prints.append(task.fingerprint)
    assert task.history.kept == (1, 2) and task.history.shown == 0
    assert prints[0] != prints[1]


@pytest.mark.parametrize(
    "table, says",
    [
        ("mu,E[MPa\n0.3,1\n", "cannot read its unit"),
        ("mu,E[mm]\n0.3,1\n", "not a unit of a pressure"),
        ("mu,mu\n0.3,0.3\n", "is given twice"),
        ("mu,nu\n0.3,0.3\n", "no parameter 'nu'"),
        ("mu\n0.3\nnan\n", "expected a number"),
        ("mu\nnan\n", "holds no column of numbers"),
        ("pull,release\n10,2\n20,21\n", "history.release: must lie between"),
    ],
)
def test_a_wrong_table_of_points(tmp_path, table, says):
    text = HISTORY.replace('release = "0 N"', "") if "release" in table else HISTORY
    text = text.replace('pull = "20 N"', "") if "pull" in table else text
    file = written(tmp_path, text)
    (tmp_path / "points.csv").write_text(table)
    with pytest.raises(InputError, match=says):
        task_of(load_sweep(file))


def test_a_release_above_another_row_s_pull(tmp_path):
    file = written(tmp_path, HISTORY.replace('pull = "20 N"\nrelease = "0 N"', ""))
    (tmp_path / "points.csv").write_text("pull,release\n10,2\n20,12\n")
    assert task_of(load_sweep(file)).plan.points == 2


def test_two_runs_do_not_work_on_one_folder(tmp_path, capsys):
    file, out = written(tmp_path), tmp_path / "out"
    with RunFolder(out, {}).alone():
        told = run_gtr(capsys, "sweep", file, "-o", out, "--no-plot")
        assert told.status == 2 and "another gtr is at work on it" in told.err and not out.exists()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["robot.toml", file.name]


def test_a_disk_without_locks_is_no_reason_to_refuse(tmp_path, monkeypatch):
    def fail(self):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("filelock.FileLock.acquire", fail)
    with RunFolder(tmp_path / "out", {}).alone():
        pass
    with pytest.raises(KeyError), RunFolder(tmp_path / "out", {}).alone():
        raise KeyError


def test_a_damaged_store_is_mended(tmp_path, capsys):
    file, out = written(tmp_path, GRID.replace(', "T_base_switch"', "")), tmp_path / "out"
    assert run_gtr(capsys, "sweep", file, "-o", out, "--no-plot").status == 0
    store = out / "sweep.zarr"
    before = contents(store)
    # A job of an array that is sent again leaves what is finished alone.
    assert run_gtr(capsys, "sweep", file, "-o", out, "--part", "1/2").status == 0
    assert contents(store) == before
    (store / "T_tip/c/0/0").write_bytes(b"torn")
    told = run_gtr(capsys, "sweep", file, "-o", out, "--no-plot")
    assert told.status == 2 and "a part of T_tip is damaged; run again" in told.err
    assert run_gtr(capsys, "sweep", file, "-o", out, "--no-plot").status == 0
    assert contents(store) == before
    (store / "zarr.json").write_text("")
    told = run_gtr(capsys, "sweep", file, "-o", out)
    assert told.status == 2 and "is damaged; remove it" in told.err


def test_bores_lie_inside_and_apart(tmp_path):
    bores = """bores = [
  { from = "0 mm", to = "20 mm", diameter = "6 mm" },
  { from = "40 mm", to = "100 mm", diameter = "6 mm" },
]
[routing]"""
    task = task_of(load_sweep(written(tmp_path, robot=ROBOT.replace("[routing]", bores))))
    cases = {
        (0.02, 0.006): True,
        (0.05, 0.006): False,  # into the second bore
        (0.02, 0.030): False,  # wider than the body
    }
    for (end, diameter), holds in cases.items():
        assert bool(is_robot(task.robot.with_values(bore_0_to=end, bore_1_diameter=diameter))) is holds


@pytest.mark.slow
def test_several_tendons(tmp_path):
    robot = """
schema = 1
name = "pair"
[backbone]
length = "200 mm"
outer_radius = ["12 mm", "9 mm"]
youngs_modulus = "1.2 MPa"
[[tendons]]
name = "left"
friction_coefficient = 0.3
preload = "1 N"
routing = { kind = "parallel", offset = "8 mm" }
[[tendons]]
name = "right"
friction_coefficient = 0.3
preload = "1 N"
routing = { kind = "parallel", offset = "-8 mm" }
"""
    text = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip"]
resolution = 0.25
[vary]
"mu.left" = [0.1, 0.3]
[history]
pull = "15 N"
tendon = "left"
"""
    file = written(tmp_path, text, robot)
    data = sweep(file, tmp_path / "out.zarr").load()
    task = task_of(load_sweep(file))
    eq = gtr.equilibrium(task.robot.with_values(**{"mu.left": 0.1}), [15.0, 1.0])
    np.testing.assert_allclose(data["T_tip.left"][0], eq.T_tip[0], rtol=1e-10)
    np.testing.assert_allclose(data["T_tip.right"][0], eq.T_tip[1], rtol=1e-10)
    assert float(data["T_base.right"]) == 1.0


DRAWN = (
    GRID.split("[vary]")[0]
    + 'sample = "{kind}"\ncount = {count}\nseed = 3\n[vary]\n'
    + """
mu = { from = 0.1, to = 0.5 }
E = { from = "0.8 MPa", to = "1.6 MPa", scale = "log" }
r2 = { mean = "8 mm", sd = "0.2 mm" }
[history]
pull = "20 N"
"""
)


def drawn(kind, count):
    return DRAWN.replace("{kind}", kind).replace("{count}", str(count)).replace(', "T_base_switch"', "")


@pytest.mark.parametrize("kind", ["sobol", "latin-hypercube", "random", "saltelli"])
def test_samples_are_spread_as_asked_and_always_the_same(tmp_path, kind, monkeypatch):
    file = load_sweep(written(tmp_path, drawn(kind, 256)))
    task = task_of(file)
    whole = np.concatenate(list(draw(file, task.axes)))
    assert len(whole) == task.plan.points == (256 * 5 if kind == "saltelli" else 256)
    mu, E, r2 = whole.T
    assert 0.1 <= mu.min() < 0.11 and 0.49 < mu.max() <= 0.5
    assert abs(np.median(np.log(E)) - np.log(np.sqrt(0.8 * 1.6) * 1e6)) < 0.05
    assert abs(r2.mean() - 0.008) < 3e-5 and abs(r2.std() / 0.0002 - 1) < 0.1
    monkeypatch.setattr("gtr_jax.sweep.plan.DRAWN_AT_ONCE", 64)
    np.testing.assert_array_equal(np.concatenate(list(draw(file, task.axes))), whole)


def test_indices_of_a_sample_agree_with_those_of_a_grid(tmp_path):
    text = drawn("saltelli", 128).replace('r2 = { mean = "8 mm", sd = "0.2 mm" }', "")
    file = written(tmp_path, text)
    task = task_of(load_sweep(file))
    store = Store(tmp_path / "drawn.zarr", task)
    store.create()
    run_here(task, store, store.left(), print)
    told = sensitivity_of(task, store).indices["T_tip"]
    gridded = GRID.replace("count = 5", "count = 24").replace("count = 3", "count = 24")
    task = task_of(load_sweep(written(tmp_path, gridded.replace(', "T_base_switch"', ""), name="g.toml")))
    store = Store(tmp_path / "grid.zarr", task)
    store.create()
    run_here(task, store, store.left(), print)
    exact = sensitivity_of(task, store).indices["T_tip"]
    for name in ("mu", "E"):
        assert abs(told[name].first - exact[name].first) < 0.1
        drawn_total, total = (float(index[name].total or 0.0) for index in (told, exact))
        assert abs(drawn_total - total) < 0.1 and exact[name].first <= total + 1e-12


def test_variance_on_a_grid_is_parted_exactly(tmp_path):
    task = task_of(load_sweep(written(tmp_path)))
    a, b = np.meshgrid(np.arange(5.0), np.arange(3.0), indexing="ij")
    found = _on_grid(3 * a + b, task.axes)
    va, vb = 9 * np.var(np.arange(5.0)), np.var(np.arange(3.0))
    np.testing.assert_allclose(np.array([found["mu"].first, found["mu"].total], float), va / (va + vb))
    product = _on_grid((a - 2) * (b - 1), task.axes)
    told = np.array([product["mu"].first, product["mu"].total], float)
    np.testing.assert_allclose(told, [0, 1], atol=1e-12)


def test_blocks_cover_every_point_once(tmp_path):
    task = task_of(load_sweep(written(tmp_path)))
    for shape, block in (((7, 5, 3), 8), ((1000,), 64), ((3, 1000), 100), ((2, 2, 2), 100), ((1, 1), 1)):
        plan = Plan(task.axes, ("a",) * len(shape), shape, _chunk(shape, block))
        seen = np.zeros(shape, int)
        for number in range(plan.blocks):
            seen[plan.region(number)] += 1
            assert seen[plan.region(number)].size <= block
        assert np.all(seen == 1)


BAD = {
    "unknown output": ('"T_tip", ', '"T_tp", ', "unknown output 'T_tp'; did you mean 'T_tip'?"),
    "no output": ('"T_tip", "tip_pose", "T_base_switch", "displacement"', "", "outputs: is empty"),
    "unknown parameter": ('"tendon.friction_coefficient"', '"tendon.fricton_coefficient"', "did you mean"),
    "twice": ("E = {", "mu = {", "is given twice"),
    "wrong unit": ('"0.8 MPa"', '"0.8 mm"', "vary.E.from: 'mm' is not a unit of a pressure"),
    "no unit": ('"0.8 MPa"', '"0.8"', "carries no unit"),
    "negative": ("from = 0.1", "from = -0.1", "must be at least 0, is -0.1"),
    "not finite": ("from = 0.1", "from = nan", "not a finite number"),
    "no count": (", count = 5", "", "vary.tendon.friction_coefficient.count: expected how many values"),
    "too many": ("count = 5", "count = 10000000000000", "count: at most 100,000,000 values"),
    "one value many times": ("to = 0.5", "to = 0.1", "from and to are the same"),
    "unknown scale": ('"log"', '"loge"', "scale: expected linear, log"),
    "no pull": ('pull = "20 N"', "", "history.pull: missing"),
    "no robot": ('"robot.toml"', '"nobot.toml"', "nobot.toml"),
    "release above": (
        'pull = "20 N"',
        'pull = "20 N"\nrelease = "30 N"',
        "history.release: must lie between",
    ),
    "tendon": ('pull = "20 N"', 'pull = "20 N"\ntendon = "left"', "history.tendon: the robot has one tendon"),
    "unknown key": ("resolution", "resolutoin", "unknown key 'resolutoin'; did you mean 'resolution'?"),
    "count of a grid": (
        "resolution",
        "count = 9\nresolution",
        "count: a grid takes a count for each parameter",
    ),
    "sample without count": (
        "resolution",
        'sample = "sobol"\nresolution',
        "count: sample = 'sobol' needs how many",
    ),
    "dt of nothing": ('pull = "20 N"', 'pull = "20 N"\ndt = "1 s"', "history.dt: has no effect on a single"),
}


@pytest.mark.parametrize("case", list(BAD))
def test_a_wrong_sweep_file_gets_one_line(tmp_path, capsys, case):
    old, new, says = BAD[case]
    assert old in GRID
    file = written(tmp_path, GRID.replace(old, new, 1))
    done = run_gtr(capsys, "sweep", file, "-o", tmp_path / "out")
    assert done.status == 2 and done.err.count("\n") == 1, done.err
    assert says in done.err and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments, says",
    [
        ([], "-o: missing"),
        (["--part", "3/2", "-o", "out"], "--part: expected I/N"),
        (["--threads", "0", "-o", "out"], "--threads: must be 1 or more"),
        (["--workers", "2", "--threads", "2", "-o", "out"], "has no effect with"),
        (["--part", "1/2", "--workers", "2", "-o", "out"], "--part: has no effect with --workers"),
        (["--dry-run", "--workers", "2"], "--dry-run: times this process alone"),
    ],
)
def test_options_that_do_not_go_together(tmp_path, capsys, arguments, says):
    done = run_gtr(capsys, "sweep", written(tmp_path), *arguments)
    assert done.status == 2 and says in done.err


def test_the_command_from_parts_to_report(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("gtr_jax.sweep.task.block_size", lambda *_: 4)
    file, out = written(tmp_path), tmp_path / "out"
    first = run_gtr(capsys, "sweep", file, "-o", out, "--part", "1/2")
    assert first.status == 0 and "2 blocks are left" in first.out, first
    assert not out.exists()
    last = run_gtr(capsys, "sweep", file, "-o", out)
    assert last.status == 0, last.err
    assert "resuming the interrupted run: 3 blocks are there already" in last.err
    assert "15 of 15 points converged" in last.out
    data = open_sweep(out)
    assert np.all(data.result == 0)
    facts = json.loads((out / "sweep.json").read_text())
    assert facts["points"] == facts["converged"] == 15
    assert facts["ranges"]["T_tip"]["largest"] == pytest.approx(float(data.T_tip.max()))
    assert (out / "maps.png").exists() and (out / "sensitivity.png").exists()
    data.close()
    before = contents(out / "sweep.zarr")
    again = run_gtr(capsys, "sweep", file, "-o", out, "--no-plot")  # all is there
    assert again.status == 0 and "computed in" not in again.out
    assert contents(out / "sweep.zarr") == before and not (out / "maps.png").exists()
    assert not list(tmp_path.glob(".*"))
    (out / "mine.txt").write_text("kept")
    foreign = run_gtr(capsys, "sweep", file, "-o", out)
    assert foreign.status == 2 and "mine.txt" in foreign.err and contents(out / "sweep.zarr") == before


def test_a_dry_run_says_what_is_to_come(tmp_path, capsys):
    done = run_gtr(capsys, "sweep", written(tmp_path), "--dry-run")
    assert done.status == 0 and done.out.startswith("15 points in 1 blocks of at most 15; ")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["robot.toml", "sweep.toml"]


def test_a_folder_without_a_sweep(tmp_path):
    with pytest.raises(InputError, match="no sweep there"):
        open_sweep(tmp_path)


LONG = GRID.replace("count = 5", "count = 400").replace("count = 3", "count = 300")
LONG = LONG.replace(', "T_base_switch"', "")


def _command(file, out, *more):
    code = "import sys; from gtr_jax.app.cli import main; sys.exit(main())"
    return [sys.executable, "-c", code, "sweep", str(file), "-o", str(out), "--no-plot", *more]


@pytest.mark.slow
def test_a_sweep_killed_at_any_moment_ends_as_a_whole_one(tmp_path):
    file = written(tmp_path, LONG)
    subprocess.run(_command(file, tmp_path / "whole"), check=True, capture_output=True)
    store = tmp_path / ".cut.steps"
    for _ in range(3):
        running = subprocess.Popen(_command(file, tmp_path / "cut"), stderr=subprocess.DEVNULL)
        held = len(list(store.glob("result/c/*/*")))
        while len(list(store.glob("result/c/*/*"))) <= held and running.poll() is None:
            time.sleep(0.01)
        os.kill(running.pid, signal.SIGKILL)
        running.wait()
    assert store.exists(), "it was over before it could be killed"
    subprocess.run(_command(file, tmp_path / "cut"), check=True, capture_output=True)
    assert contents(tmp_path / "cut" / "sweep.zarr") == contents(tmp_path / "whole" / "sweep.zarr")


@pytest.mark.slow
def test_a_lost_worker_costs_its_blocks_only(tmp_path):
    pytest.importorskip("distributed")
    pytest.importorskip("cryptography")
    from gtr_jax.sweep.cluster import local_cluster, run_there

    file = written(tmp_path, LONG)
    task = task_of(load_sweep(file))
    whole = Store(tmp_path / "whole.zarr", task)
    whole.create()
    run_here(task, whole, whole.left(), print)
    there = Store(tmp_path / "there.zarr", task)
    there.create()
    killed = []

    def kill_one(says):
        if says.startswith("0 of") or killed or not says[0].isdigit():
            return
        pids: Any = client.run(os.getpid)
        killed.extend(list(pids.values())[:1])
        os.kill(killed[0], signal.SIGKILL)

    def limit():
        return jax.config.values["jax_compilation_cache_max_size"]

    with local_cluster(2) as client:
        limits: Any = client.run(limit)
        assert set(limits.values()) == {limit()}, "they share a cache"
        done = run_there(client, file, task, there, there.left(), kill_one)
    assert killed and not done.lost and not there.left()
    there.clean()
    assert contents(there.path) == contents(whole.path)


def test_the_time_left_is_told_from_what_settled_workers_do(tmp_path, monkeypatch):
    task = task_of(load_sweep(written(tmp_path, LONG)))
    clock, said = [0.0], []
    monkeypatch.setattr("gtr_jax.sweep.run.time", SimpleNamespace(monotonic=lambda: clock[0]))
    meter = Meter(task, range(task.plan.blocks), said.append, unsettled=2)
    each = task.plan.points // task.plan.blocks
    # Two workers compile for 30 s; then a block a second is done.
    for at, blocks in ((30.0, 1), (30.5, 2), (31.5, 3), (32.5, 4)):
        clock[0] = at
        meter(blocks * each)
    assert not any("left" in text for text in said[:3])
    left = float(said[-1].split(", ")[-1].removesuffix(" s left"))
    assert left == pytest.approx(task.plan.blocks - 4, abs=1.5)


@pytest.mark.slow
def test_workers_end_with_the_main_process(tmp_path):
    pytest.importorskip("distributed")
    pytest.importorskip("cryptography")
    code = (
        "import hashlib, os, time\n"
        "from gtr_jax.sweep.cluster import local_cluster\n"
        "if __name__ == '__main__':\n"
        "    with local_cluster(2) as client:\n"
        "        print(*client.run(os.getpid).values(), flush=True)\n"
        "        print(client.scheduler_info()['address'], *client.scheduler_info()['workers'], flush=True)\n"
        "        work = [(hashlib.pbkdf2_hmac, 'sha256', b'', b'', 10**9 + i) for i in range(2)]\n"
        "        busy = [client.submit(*what) for what in work]\n"
        "        time.sleep(60)\n"
    )
    (tmp_path / "main.py").write_text(code)
    with subprocess.Popen(
        [sys.executable, "main.py"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ) as main:
        assert main.stdout is not None
        workers = [int(pid) for pid in main.stdout.readline().split()]
        assert len(workers) == 2
        # Every user of the machine can reach their ports.
        assert [at.partition(":")[0] for at in main.stdout.readline().split()] == ["tls"] * 3
        main.kill()
    ended = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < ended:
        time.sleep(0.1)
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]


def test_the_example_is_a_sweep(capsys):
    task = task_of(load_sweep(EXAMPLES / "tdcm-1-sweep.toml"))
    assert task.plan.points == 10_000


@pytest.mark.parametrize(
    ("memory", "steps", "lanes"), [(80e9, 81, 2**21 // 81), (8e9, 81, 4938), (None, 1, 214748)]
)
def test_an_accelerator_holds_as_many_lanes_as_its_memory(monkeypatch, memory, steps, lanes):
    class Device:
        def memory_stats(self):
            return None if memory is None else {"bytes_limit": memory}

    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(jax, "local_devices", lambda: [Device()])
    assert lanes_of(PLAIN, steps) == lanes


def test_workers_that_others_could_reach_are_not_started(monkeypatch):
    distributed = pytest.importorskip("distributed")
    from gtr_jax.sweep.cluster import local_cluster

    def absent():
        raise ImportError("cryptography")

    monkeypatch.setattr(distributed.Security, "temporary", absent)
    with pytest.raises(InputError, match=r"--workers: needs cryptography.*gtr-jax\[cluster\]"):
        with local_cluster(1):
            pass


@pytest.mark.parametrize("keep", ["turns", "all"])
def test_what_was_found_is_what_the_map_shows(keep, tmp_path, monkeypatch):
    """At the largest base tension kept: once it is released, no tension is left at any point."""
    monkeypatch.setattr("gtr_jax.sweep.summary.sensitivity_of", lambda *_: None)
    released = f'pull = "20 N"\nrelease = "0 N"\nsteps = 4\nkeep = "{keep}"'
    task = task_of(load_sweep(written(tmp_path, GRID.replace('pull = "20 N"', released))))
    ramp = np.concatenate([task.history.up, 1 - task.history.down])[list(task.history.kept)]

    def read(name, block):
        shape = task.plan.shape
        variable = next(v for v in task.stored if v.name == name)
        if name == "result":
            return np.zeros(shape, int)
        at_most = np.full((*shape, *task.extra_shape(variable)), 3.5)
        return at_most * ramp if "step" in task.extra_dims(variable) else at_most

    store: Any = SimpleNamespace(read=read)
    done: Any = None
    ranges = summary_of(task, store, done).ranges
    assert ranges["T_tip"] == (3.5, 3.5, 3.5)
