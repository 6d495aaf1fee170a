"""The command line: what it answers, what it leaves behind, and what it refuses to touch."""

import csv
import dataclasses
import hashlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from command_line import RECORDED, RECORDING, run_gtr
from jax.experimental.compilation_cache import compilation_cache

import gtr_jax as gtr
from gtr_jax.app.cli import cli
from gtr_jax.app.cli.progress import Progress
from gtr_jax.cache import cache_folder, enable_cache
from gtr_jax.config.schema import json_schema
from gtr_jax.examples import SIMULATED

SIMULATION_FILES = {
    *("loop.png", "shape.png", "tension.png", "report.html", "robot.toml", "run.json"),
    *("profile.csv", "simulation.csv", "simulation.json"),
}
FIT_FILES = {
    *(
        "fit.csv",
        "fit.json",
        "fit.png",
        "fitted.toml",
        "profiles.png",
        "report.html",
        "residual.png",
        "robot.toml",
        "run.json",
        "time.png",
    ),
}
LOOP = ("--pull", "45", "--release", "0", "--steps", "8")


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run_gtr(capsys, *arguments)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """One run folder of `gtr simulate`, to look at."""
    from gtr_jax.app.cli import main

    folder = tmp_path_factory.mktemp("simulated") / "out"
    assert main(["simulate", str(SIMULATED), *LOOP, "-o", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """One run folder of `gtr fit`, on part of the shipped recording."""
    from gtr_jax.app.cli import main

    place = tmp_path_factory.mktemp("fitted")
    lines = RECORDING.read_text().splitlines(keepends=True)
    (place / "rec.csv").write_text("".join(lines[:121]))
    assert main(["fit", str(RECORDED), str(place / "rec.csv"), "--free", "mu", "-o", str(place / "out")]) == 0
    return place / "out"


def names(folder):
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


def contents_of(folder):
    return {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def load(path):
    def refuse(constant):
        raise ValueError(f"{constant} is not JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def left_over(folder):
    return sorted(p.name for p in folder.iterdir())


# --- simulate ---------------------------------------------------------------------------------------------


def test_simulation_leaves_a_whole_run_folder(simulated):
    assert names(simulated) == SIMULATION_FILES
    assert left_over(simulated.parent) == ["out"]
    record = load(simulated / "run.json")
    assert record["command"].startswith(f"gtr simulate {SIMULATED} --pull 45 --release 0")
    assert record["inputs"]["robot"]["sha256"] == hashlib.sha256(SIMULATED.read_bytes()).hexdigest()
    assert {"python", "gtr-jax", "jax", "jaxlib", "device"} <= set(record["versions"])
    assert set(record["files"]) == SIMULATION_FILES


def test_simulation_json_is_the_simulation(simulated):
    data = load(simulated / "simulation.json")
    robot = gtr.load_robot(SIMULATED)
    T_base = np.concatenate([np.linspace(0, 45, 9), np.linspace(45, 0, 9)[1:]])
    run = gtr.simulate(robot, jnp.asarray(T_base))
    assert data["steps"] == 17 and data["T_base_max_N"] == 45.0
    np.testing.assert_allclose(data["at_T_base_max"]["T_tip_N"], run.T_tip[8], rtol=1e-12)
    np.testing.assert_allclose(data["tension_loss"], 1 - run.T_tip[8] / 45.0, rtol=1e-12)
    switch = gtr.release_switch(robot, jnp.asarray(45.0))
    np.testing.assert_allclose(data["T_base_switch_N"], switch.T_base, rtol=1e-9)
    assert sum(phase["steps"] for phase in data["phases"].values()) == 17
    assert set(data["phases"]) == {"rest", "pulling", "transition", "releasing"}
    convergence = data["convergence"]
    assert convergence["converged"] and convergence["flagged"] == 0
    assert 0 <= convergence["worst_residual_norm"] < 1e-8 and convergence["iterations"] >= 17


def test_resolved_robot_is_the_robot(simulated):
    assert gtr.load_config(simulated / "robot.toml") == gtr.load_config(SIMULATED)


def test_simulation_reads_back_as_a_recording_and_as_a_history(simulated, run, tmp_path):
    recording = gtr.read_recording(simulated / "simulation.csv")
    assert recording.tip_angle is not None and recording.displacement is not None and len(recording) == 17
    outcome = run("simulate", SIMULATED, "--history", simulated / "simulation.csv", "-o", "again")
    assert outcome.status == 0
    assert (tmp_path / "again/simulation.csv").read_bytes() == (simulated / "simulation.csv").read_bytes()


def test_history_from_other_columns_keeps_its_time(run, tmp_path):
    (tmp_path / "h.csv").write_text("clock,cell,note\n0,0,a\n2,1000,b\n5,800,c\n")
    mapping = "T_base=cell[gf],time=clock[s]"
    assert run("simulate", SIMULATED, "--history", "h.csv", "--columns", mapping, "-o", "out").status == 0
    rows = list(csv.DictReader((tmp_path / "out/simulation.csv").read_text().splitlines()))
    assert [row["time_s"] for row in rows] == ["0.0", "2.0", "5.0"]
    np.testing.assert_allclose([float(row["T_base_N"]) for row in rows], [0, 9.80665, 7.84532])
    assert [row["phase"] for row in rows] == ["rest", "pulling", "transition"]
    assert "history" in load(tmp_path / "out/run.json")["inputs"]


def test_quantities_take_units(run, tmp_path):
    assert run("simulate", SIMULATED, "--pull", "1 kgf", "--steps", "2", "-o", "out").status == 0
    data = load(tmp_path / "out/simulation.json")
    np.testing.assert_allclose(data["T_base_max_N"], 9.80665)
    assert data["steps"] == 3 and set(data["phases"]) == {"rest", "pulling"}


def test_a_pull_starts_at_the_preload(run, tmp_path):
    robot = SIMULATED.read_text().replace("= 0.36", '= 0.36\npreload = "5 N"')
    (tmp_path / "robot.toml").write_text(robot)
    assert run("simulate", "robot.toml", "--pull", "10", "--steps", "2", "-o", "out").status == 0
    recording = gtr.read_recording(tmp_path / "out/simulation.csv")
    np.testing.assert_allclose(recording.T_base, [5.0, 7.5, 10.0])


def test_a_history_that_never_pulls(run, tmp_path):
    (tmp_path / "h.csv").write_text("T_base_N\n0\n0\n0\n")
    outcome = run("simulate", SIMULATED, "--history", "h.csv", "-o", "out")
    assert outcome.status == 0 and "stays slack" in outcome.out
    assert load(tmp_path / "out/simulation.json")["tension_loss"] is None


def test_one_sample(run, tmp_path):
    (tmp_path / "h.csv").write_text("T_base_N\n5\n")
    assert run("simulate", SIMULATED, "--history", "h.csv", "-o", "out").status == 0


def test_answer_goes_to_stdout(run):
    outcome = run("simulate", SIMULATED, *LOOP, "-o", "out")
    verdict, report = outcome.out.splitlines()
    assert verdict.startswith("TD-CM I: of 45 N at the base, 21.9 N reach the tip (51.4 % lost)")
    assert verdict.endswith("until the base is down to 11.8 N.")
    assert report == "report: out/report.html"
    assert "rror" not in outcome.err


def test_rigid_sheath(run, tmp_path, make_config):
    from gtr_jax.config.config import dump_config

    sheath = {"length": 1.0, "outer_radius": 0.002, "natural_curvature": 11.7, "rigid": True}
    config = make_config(backbone=sheath, routing={"kind": "parallel", "offset": 0.0})
    dump_config(config, tmp_path / "robot.toml")
    assert run("simulate", "robot.toml", *LOOP, "-o", "out").status == 0
    T_tip = load(tmp_path / "out/simulation.json")["at_T_base_max"]["T_tip_N"]
    np.testing.assert_allclose(T_tip, 45 * np.exp(-0.3 * 11.7), rtol=1e-6)


def test_steps_that_do_not_converge_are_said_and_written(run, tmp_path, monkeypatch):
    from gtr_jax.report import simulation_answer

    def broken(robot, T_base, **clock):
        run = gtr.simulate(robot, T_base, **clock)
        late = jnp.arange(len(run.T_base)) > 10
        pick = jax.vmap(optx.RESULTS.where, in_axes=(0, None, 0))
        result = pick(late, optx.RESULTS.nonlinear_max_steps_reached, run.result)
        T_tip = jnp.where(late, jnp.nan, run.T_tip)
        return dataclasses.replace(run, result=result, T_tip=T_tip)

    monkeypatch.setattr(simulation_answer, "simulate", broken)
    outcome = run("simulate", SIMULATED, *LOOP, "-o", "out")
    assert outcome.status == 1
    assert "6 of 17 steps did not converge" in outcome.out and "step 12" in outcome.out
    assert names(tmp_path / "out") == SIMULATION_FILES
    convergence = load(tmp_path / "out/simulation.json")["convergence"]
    assert not convergence["converged"] and convergence["flagged_steps"] == list(range(12, 18))
    assert "did not converge" in (tmp_path / "out/report.html").read_text()


# --- the report -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["simulated", "fitted"])
def test_report_loads_nothing(kind, request):
    page = (request.getfixturevalue(kind) / "report.html").read_text(encoding="utf-8")
    assert "://" not in page and "<script src" not in page and "<link" not in page
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) == {"simulated": 3, "fitted": 4}[kind]
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "default-src 'none'" in page and 'name="viewport"' in page


def test_report_says_the_verdict_first_then_figures_then_tables(simulated):
    page = (simulated / "report.html").read_text(encoding="utf-8")
    places = [
        page.index(mark) for mark in ('class="verdict"', "<figure", "<table", "How it was made", "sha256 ")
    ]
    assert places == sorted(places)
    assert load(simulated / "simulation.json")["verdict"] in page


def test_report_escapes_what_the_robot_file_says(run, tmp_path):
    robot = SIMULATED.read_text().replace('"TD-CM I"', '"<script>alert(1)</script>"')
    (tmp_path / "robot.toml").write_text(robot)
    assert run("simulate", "robot.toml", "--pull", "9", "--steps", "8", "-o", "out").status == 0
    page = (tmp_path / "out/report.html").read_text()
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page


# --- fit and demo -----------------------------------------------------------------------------------------


def test_fit_leaves_a_whole_run_folder(fitted):
    assert names(fitted) == FIT_FILES
    data = load(fitted / "fit.json")
    assert data["converged"] and data["verdict"] in (fitted / "report.html").read_text(encoding="utf-8")
    estimate = data["parameters"]["mu"]
    config = gtr.load_config(fitted / "fitted.toml")
    assert config.tendon.friction_coefficient == estimate["value"]
    assert gtr.load_config(fitted / "robot.toml") == gtr.load_config(RECORDED)
    assert data["settings"]["free"] == ["mu"] and "command" in data["settings"]
    rows = list(csv.DictReader((fitted / "fit.csv").read_text().splitlines()))
    assert len(rows) == 120
    base = [float(row["T_base_fitted_N"]) - float(row["T_base_N"]) for row in rows]
    assert np.std(base) < 3 * data["recordings"][0]["noise_base_N"] + 1e-9
    left = [float(row["T_tip_fitted_N"]) - float(row["T_tip_N"]) for row in rows]
    np.testing.assert_allclose([float(row["residual_N"]) for row in rows], left, atol=1e-12)


def test_noise_may_be_given(run, tmp_path):
    given = ("--free", "mu", "--noise", "0.05 N", "--noise-base", "0")
    assert run("fit", RECORDED, RECORDING, *given, "-o", "out").status == 0
    data = load(tmp_path / "out/fit.json")
    only = data["recordings"][0]
    assert (only["noise_N"], only["noise_base_N"]) == (0.05, 0.0)
    for name, value in (("--noise", "0"), ("--noise-base", "-1"), ("--noise", "3 mm")):
        outcome = run("fit", RECORDED, RECORDING, name, value, "-o", "other")
        assert outcome.status == 2 and name in outcome.err and len(outcome.err.splitlines()) == 1


def test_fit_that_does_not_converge_is_said_and_written(run, tmp_path, monkeypatch):
    import calibrate

    real = calibrate.fit

    def gives_up(*arguments, **options):
        found = real(*arguments, **options)
        return dataclasses.replace(found, converged=False, result="gave up", verdict="No answer: gave up.")

    monkeypatch.setattr(calibrate, "fit", gives_up)
    (tmp_path / "rec.csv").write_text("".join(RECORDING.read_text().splitlines(keepends=True)[:121]))
    outcome = run("fit", RECORDED, "rec.csv", "--free", "mu", "-o", "out")
    assert outcome.status == 1
    assert "No answer: gave up." in outcome.out
    assert names(tmp_path / "out") == FIT_FILES
    assert not load(tmp_path / "out/fit.json")["converged"]


@pytest.mark.slow
def test_demo_finds_what_a_good_fit_conceals(run, tmp_path):
    outcome = run("demo", "-o", "demo-out")
    assert outcome.status == 0
    reports = re.findall(r"^report: (.*)$", outcome.out, flags=re.MULTILINE)
    assert reports == [f"demo-out/{name}/report.html" for name in ("simulate", "fit", "diagnose", "discover")]
    assert all((tmp_path / report).is_file() for report in reports)
    index = (tmp_path / "demo-out/index.html").read_text()
    for place in re.findall(r'(?:href|src)="([^"]*)"', index):
        assert (tmp_path / "demo-out" / place).is_file()
    assert index.count("/report.html") >= 4 and "demo-out/index.html" in outcome.out
    fitted = load(tmp_path / "demo-out/fit/fit.json")
    assert "to its noise" in fitted["verdict"]
    mu = fitted["parameters"]["mu"]
    assert abs(mu["value"] - 0.3) > 10 * mu["sd"]
    found = load(tmp_path / "demo-out/diagnose/diagnosis.json")
    assert found["verdict"] == "missing-physics" and found["named"] == ["local-friction"]
    mu, pulley = (found["parameters"][name] for name in ("mu", "local-friction.base"))
    assert abs(mu["after"] - 0.3) < max(3 * mu["sd"], 0.003)
    assert abs(pulley["value"] - 0.1) < max(3 * pulley["sd"], 0.003)
    law = load(tmp_path / "demo-out/discover/diagnosis.json")
    assert law["verdict"] == "discovered" and law["discovered"]["acts"] == "friction"
    assert law["discovered"]["of"] == "T" and "exp(-((T-at)/width)^2)" in law["discovered"]["formula"]
    held = law["fit"]["held_out_rms_N"]
    assert held["after"] < 0.5 * held["before"]
    low, high = law["parameters"]["mu"]["averaged95"]
    assert low < 0.24 < high, "it was made with 0.24"


# --- the run folder ---------------------------------------------------------------------------------------


def test_an_earlier_run_is_replaced(run, tmp_path):
    short = ("--pull", "9", "--steps", "8")
    assert run("simulate", SIMULATED, *short, "-o", "out").status == 0
    assert run("simulate", SIMULATED, "--pull", "8", "--steps", "8", "-o", "out").status == 0
    assert load(tmp_path / "out/simulation.json")["T_base_max_N"] == 8.0
    assert left_over(tmp_path) == ["out"]


def test_an_empty_folder_is_used(run, tmp_path):
    (tmp_path / "out").mkdir()
    assert run("simulate", SIMULATED, "--pull", "9", "--steps", "8", "-o", "out").status == 0
    assert names(tmp_path / "out") == SIMULATION_FILES


@pytest.mark.parametrize("what", ["folder", "file", "added"])
def test_foreign_files_are_left_alone(what, run, tmp_path, simulated):
    out = tmp_path / "out"
    if what == "file":
        out.write_text("mine")
    else:
        out.mkdir()
        if what == "added":
            for name in SIMULATION_FILES:
                (out / name).write_bytes((simulated / name).read_bytes())
        (out / "thesis.tex").write_text("mine")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    outcome = run("simulate", SIMULATED, "--pull", "9", "-o", "out")
    assert outcome.status == 2
    assert outcome.err.startswith("error: -o out: ") and outcome.err.count("\n") == 1
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


def test_a_run_of_another_command_is_replaced_by_force_only(run, tmp_path, fitted):
    shutil.copytree(fitted, tmp_path / "F")
    before = contents_of(tmp_path)
    pull = ("simulate", SIMULATED, "--pull", "9", "--steps", "8", "-o", "F")
    outcome = run(*pull)
    assert outcome.status == 2 and contents_of(tmp_path) == before
    assert outcome.err.startswith("error: -o F: holds a run of 'gtr fit', not of 'gtr simulate'")
    assert "--force" in outcome.err and outcome.err.count("\n") == 1
    assert run(*pull, "--force").status == 0
    assert names(tmp_path / "F") == SIMULATION_FILES and left_over(tmp_path) == ["F"]


def test_force_replaces_foreign_files_but_no_input_and_not_the_place_one_is_in(run, tmp_path):
    pull = ("--pull", "9", "--steps", "8", "--force", "-o")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/robot.toml").write_text(SIMULATED.read_text())
    for robot, folder in (("mine/robot.toml", "mine"), (SIMULATED, ".")):
        before = contents_of(tmp_path)
        outcome = run("simulate", robot, *pull, folder)
        assert outcome.status == 2 and contents_of(tmp_path) == before
    assert run("simulate", SIMULATED, *pull, "mine").status == 0
    assert names(tmp_path / "mine") == SIMULATION_FILES


def test_every_command_that_writes_a_folder_can_be_forced():
    for name, command in cli.commands.items():
        options = {option for p in command.params for option in p.opts}
        # The live page gives each of its runs a folder of its own.
        assert name == "view" or ("-o" in options) <= ("--force" in options), name


def test_a_run_folder_with_its_own_input_is_left_alone(run, tmp_path):
    assert run("simulate", SIMULATED, "--pull", "9", "--steps", "8", "-o", "out").status == 0
    outcome = run("simulate", SIMULATED, "--history", "out/simulation.csv", "-o", "out")
    assert outcome.status == 2 and "out/simulation.csv" in outcome.err
    assert names(tmp_path / "out") == SIMULATION_FILES


def test_a_place_that_cannot_be_written(run, tmp_path):
    (tmp_path / "file").write_text("")
    outcome = run("simulate", SIMULATED, "--pull", "9", "--steps", "8", "-o", "file/out")
    assert outcome.status == 2 and "Traceback" not in outcome.err and "-o" in outcome.err


@pytest.mark.parametrize("when", ["solving", "drawing"])
def test_an_interrupt_leaves_everything_as_it_was(when, run, tmp_path, monkeypatch):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    assert run("simulate", SIMULATED, "--pull", "9", "--steps", "8", "-o", "out").status == 0
    before = (tmp_path / "out/run.json").read_bytes()
    if when == "solving":
        monkeypatch.setattr("gtr_jax.report.simulation_answer.answer_simulation", interrupt)
    else:
        monkeypatch.setattr("gtr_jax.report.page.render", interrupt)
    outcome = run("simulate", SIMULATED, "--pull", "8", "--steps", "8", "-o", "out")
    assert outcome.status == 130
    assert outcome.err.splitlines()[-1] == "interrupted: no run folder was written" and outcome.out == ""
    assert (tmp_path / "out/run.json").read_bytes() == before
    assert left_over(tmp_path) == ["out"]


# A shell that starts the tests in the background has them ignore the signal.
HEEDED = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
# What the script `gtr` does.
COMMAND = "import sys; sys.argv[0] = 'gtr'\nfrom gtr_jax.app.cli import main; raise SystemExit(main())"
INTERRUPTED = (
    HEEDED
    + "from gtr_jax.interruption import interruption\ninterruption.install(); interruption.running = True\n"
)


def said_by(code, *arguments, after=None):
    """Exit status and stderr of a Python process, interrupted once it has printed a line, or after a time."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        if after is None:
            assert process.stdout.readline() == "ready\n"
        else:
            time.sleep(after)
        process.send_signal(signal.SIGINT)
        err = process.communicate(timeout=60)[1]
    return process.returncode, err


@pytest.mark.parametrize("after", [0.25, 0.7])
def test_control_c_while_modules_are_imported(after, tmp_path):
    code = HEEDED + COMMAND
    status, err = said_by(code, "simulate", SIMULATED, "--pull", "9", "-o", tmp_path / "out", after=after)
    assert (status, err) == (130, "interrupted: no run folder was written\n")


LOST = """
import gc, time
def waits_once(phase, info, waited=[]):
    if not waited:
        waited.append(1)
        print("ready", flush=True)
        time.sleep(1.0)
gc.callbacks.append(waits_once)
try:
    gc.collect()
    while True:
        sum(range(1000))
except KeyboardInterrupt:
    raise SystemExit(7)
"""
DEAF = """
import hashlib, threading
threading.Timer(0.5, print, ("ready",), {"flush": True}).start()
hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)
"""
SWALLOWED = """
import threading, time
threading.Timer(0.5, print, ("ready",), {"flush": True}).start()
while True:
    try:
        time.sleep(60)
    except BaseException:
        pass
"""
WHOLE = """
import time
with interruption.held():
    print("ready", flush=True)
    time.sleep(1.0)
    done = True
try:
    time.sleep(60)
except KeyboardInterrupt:
    raise SystemExit(7 if done else 8)
"""


@pytest.mark.parametrize(
    ("code", "status"),
    [(LOST, 7), (DEAF, 130), (SWALLOWED, 130), (WHOLE, 7)],
    ids="lost deaf swallowed whole".split(),
)
def test_control_c_is_never_lost(code, status):
    # With Python's own handler the first prints "Exception ignored in" and runs on, and so do the next two.
    quick = "from gtr_jax import interruption as module; module.UNWINDING = 1.0\n"
    found, err = said_by(INTERRUPTED + quick + code)
    assert (found, err) == (status, "interrupted: no run folder was written\n" if status == 130 else "")


def test_a_second_control_c_ends_what_waits():
    code = INTERRUPTED + (
        "import os, hashlib, threading, time\n"
        "def press():\n"
        "    for wait in (0.1, 1.0):\n"
        "        time.sleep(wait); os.kill(os.getpid(), signal.SIGINT)\n"
        "threading.Thread(target=press).start()\n"
        "with interruption.patient():\n"
        "    hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 130 and done.stderr.splitlines()[-1].startswith("interrupted")


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.0, 0.5, 3.0])
def test_control_c(tmp_path, after):
    command = [sys.executable, "-c", HEEDED + COMMAND]
    command += ["simulate", str(SIMULATED), "--pull", "45", "--steps", "60000", "-o", str(tmp_path / "out")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert "compiling" in process.stderr.readline()
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        began = time.monotonic()
        rest = process.stderr.read()
    assert process.returncode == 130 and time.monotonic() - began < 20
    assert rest.splitlines()[-1] == "interrupted: no run folder was written"
    assert "Traceback" not in rest and "Exception ignored" not in rest
    assert left_over(tmp_path) == []


# --- standard input, and python -m -------------------------------------------------------------------------


def from_stdin(monkeypatch, path):
    data = io.BytesIO(path.read_bytes() if path else b"")
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(data))


def test_a_robot_file_and_a_history_may_come_from_standard_input(run, tmp_path, monkeypatch, simulated):
    from_stdin(monkeypatch, SIMULATED)
    assert run("simulate", "-", *LOOP, "-o", "robot").status == 0
    from_stdin(monkeypatch, simulated / "simulation.csv")
    assert run("simulate", SIMULATED, "--history", "-", "-o", "history").status == 0
    for name in ("robot", "history"):
        found = (tmp_path / name / "simulation.csv").read_text()
        assert found == (simulated / "simulation.csv").read_text()
    recorded = load(tmp_path / "robot/run.json")["inputs"]["robot"]
    assert recorded == {"path": "-", "sha256": hashlib.sha256(SIMULATED.read_bytes()).hexdigest()}


def test_a_recording_may_come_from_standard_input(run, tmp_path, monkeypatch, fitted):
    (tmp_path / "rec.csv").write_text("".join(RECORDING.read_text().splitlines(keepends=True)[:121]))
    from_stdin(monkeypatch, tmp_path / "rec.csv")
    assert run("fit", RECORDED, "-", "--free", "mu", "-o", "out").status == 0
    assert (tmp_path / "out/fit.csv").read_text() == (fitted / "fit.csv").read_text()


def test_standard_input_is_read_once_and_not_empty(run, monkeypatch):
    from_stdin(monkeypatch, SIMULATED)
    outcome = run("simulate", "-", "--history", "-", "-o", "out")
    assert outcome.status == 2 and "can be read once" in outcome.err
    from_stdin(monkeypatch, None)
    outcome = run("simulate", "-", "--pull", "9", "-o", "out")
    assert outcome.status == 2 and "nothing comes from standard input" in outcome.err


def test_the_package_runs_as_the_command():
    done = subprocess.run([sys.executable, "-m", "gtr_jax", "--version"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("gtr ")


def test_completion_is_offered():
    code = COMMAND
    environment = os.environ | {"_GTR_COMPLETE": "bash_complete", "COMP_WORDS": "gtr si", "COMP_CWORD": "1"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert "simulate" in done.stdout


# --- the rest ---------------------------------------------------------------------------------------------


def test_version_and_help(run):
    outcome = run("--version")
    assert outcome.status == 0 and re.fullmatch(r"gtr \d+\.\d+\.\d+\n", outcome.out)
    for command in ([], ["simulate"], ["fit"], ["diagnose"], ["terms"], ["demo"], ["schema"]):
        outcome = run(*command, "--help")
        assert outcome.status == 0 and outcome.out.startswith("Usage: gtr") and outcome.err == ""


def test_schema(run):
    outcome = run("schema")
    assert outcome.status == 0 and json.loads(outcome.out) == json_schema()


def test_unknown_command(run):
    outcome = run("simulat")
    assert outcome.status == 2 and outcome.out == ""
    assert outcome.err.startswith("error: ") and outcome.err.count("\n") == 1 and "simulate" in outcome.err


def test_cache_folder_is_per_user_and_per_jaxlib(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    for setting, parent in ((None, tmp_path / "user/gtr-jax"), (str(tmp_path / "here"), tmp_path / "here")):
        if setting is None:
            monkeypatch.delenv("GTR_JAX_CACHE")
        else:
            monkeypatch.setenv("GTR_JAX_CACHE", setting)
        folder = cache_folder()
        assert folder is not None
        if setting or sys.platform == "linux":
            assert folder == parent / f"jaxlib-{version('jaxlib')}"
    monkeypatch.setenv("GTR_JAX_CACHE", "off")
    assert cache_folder() is None and enable_cache() is None


def test_cache_holds_programs(monkeypatch, tmp_path):
    monkeypatch.setenv("GTR_JAX_CACHE", str(tmp_path))
    monkeypatch.setattr("gtr_jax.stored._root", None)  # as it was, once the test is over
    options = (
        "jax_compilation_cache_dir",
        "jax_persistent_cache_min_compile_time_secs",
        "jax_persistent_cache_min_entry_size_bytes",
    )
    before = {name: getattr(jax.config, name) for name in options}
    try:
        jax.jit(lambda x: jnp.sin(x) * 3.14159)(jnp.arange(5.0)).block_until_ready()  # it may be late
        folder = enable_cache()
        assert folder is not None
        jax.jit(lambda x: jnp.cos(x) * 3.14159)(jnp.arange(5.0)).block_until_ready()
        assert list(folder.iterdir())
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def test_cache_that_cannot_be_written_is_done_without(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("GTR_JAX_CACHE", str(tmp_path / "file"))
    assert enable_cache() is None


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


@pytest.mark.parametrize("stream", [io.StringIO, Terminal])
def test_progress_is_silent_when_quick(stream):
    screen = stream()
    with Progress(screen) as progress:
        progress("compiling")
    assert screen.getvalue() == ""


def test_progress_speaks_in_lines(monkeypatch):
    monkeypatch.setattr("gtr_jax.app.cli.progress.PAUSE", 0.01)
    screen = io.StringIO()
    with Progress(screen, patience=0.01) as progress:
        time.sleep(0.05)
        assert screen.getvalue() == ""  # before the first stage
        for stage in ("compiling", "drawing"):
            progress(stage)
            time.sleep(0.2)
    assert [line.split(" (")[0] for line in screen.getvalue().splitlines()] == ["compiling", "drawing"]


def test_progress_on_a_terminal_is_shown(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    screen = Terminal()
    with Progress(screen, patience=0.01) as progress:
        progress("compiling")
        time.sleep(0.6)
    assert "compiling" in screen.getvalue()


def test_examples_are_the_published_manipulators():
    examples = Path(__file__).parents[2] / "examples"
    for name, T_tip, T_switch in (("tdcm-1", 22.0, 11.9), ("tdcm-2", 23.9, 15.0)):
        with (examples / f"{name}.toml").open("rb") as stream:
            assert tomllib.load(stream)["schema"] == 1
        switch = gtr.release_switch(gtr.load_robot(examples / f"{name}.toml"), jnp.asarray(45.0))
        np.testing.assert_allclose([switch.T_tip, switch.T_base], [T_tip, T_switch], rtol=0.013)
