"""Recordings that disagree about one number, and the robot files of a diagnosis that is not settled."""

import json
import tomllib
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run_gtr

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.answer.robots import _labels
from calibrate.diagnosis.likelihood.locate import locate, mu_by_stratum
from calibrate.diagnosis.prepare import Prepared, prepare
from calibrate.inference.number import values_in
from calibrate.inference.simulated_rig import SimulatedRig
from gtr_jax.simulation.history import padded_length
from gtr_jax.simulation.sensing import cells_show
from gtr_jax.terms import REGISTRY

EXAMPLE = Path(__file__).parents[2] / "examples" / "rig"
TRUTH = {"mu": 0.27, "E": 1.42e6, "r1": -9.1e-3}
LOOPS = ((0, 45, 120), (45, 45, 20), (45, 18, 80), (18, 36, 60), (36, 1, 100), (1, 40, 100), (40, 0, 100))


def recorded(name, seed, *, posed=False, duration=60.0, **values):
    """A recording of the example rig with some numbers changed."""
    T = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in LOOPS])
    time = np.linspace(0.0, duration, len(T))
    robot = gtr.load_robot(EXAMPLE / "robot.toml").with_values(**TRUTH | values)
    run = gtr.simulate(robot, T, time=time)
    shown, rng = cells_show(robot, jnp.asarray(T), run.T_tip, jnp.asarray(time)), np.random.default_rng(seed)

    def noisy(true, sd):
        return np.asarray(true) + rng.normal(0, sd, len(T))

    pose: Any = {"tip_angle": noisy(run.tip_pose[:, 2], 7e-3)} if posed else {}
    return gtr.Recording(
        path=Path(f"{name}.csv"),
        sha256="",
        time=time,
        T_base=np.round(noisy(shown.T_base, 0.1), 2),
        T_tip=noisy(shown.T_tip, 0.05),
        **pose,
    )


def prepared(recordings, **options):
    ready = prepare(gtr.load_config(EXAMPLE / "robot.toml"), recordings, **options)
    assert isinstance(ready, Prepared)
    return ready


def examples(*names):
    return [gtr.read_recording(EXAMPLE / f"{name}.csv") for name in names]


def test_numbers_of_one_recording():
    values = {"mu@monday": 0.27, "mu@oiled": 0.22, "E": 1.4e6}
    assert values_in(values, "oiled") == {"mu": 0.22, "E": 1.4e6}
    assert values_in({"mu": 0.3}, "oiled") == {"mu": 0.3}


def test_files_of_rivals_have_telling_names():
    assert _labels([("presliding",), ("cell-hysteresis.tip", "wear")]) == [
        "presliding",
        "cell-hysteresis-and-wear",
    ]
    assert _labels([("low-pass.tip",), ("low-pass.base",)]) == ["low-pass-tip", "low-pass-base"]


def test_the_oiled_tendon_differs_in_friction():
    ready = prepared(examples("monday", "tuesday", "oiled"))
    (found,) = ready.differ
    assert (
        found.name == "mu" and found.groups[0] == ["oiled"] and set(found.groups[1]) == {"monday", "tuesday"}
    )
    assert found.own["oiled"] == pytest.approx(0.22, rel=0.03)
    assert found.own["monday"] == pytest.approx(0.27, rel=0.03)
    assert found.own["tuesday"] == pytest.approx(found.own["monday"], rel=0.01)
    assert found.or_numbers == [] and found.or_effects == [] and found.standard_errors > 20
    # With it differing the base model describes all three.
    assert ready.likelihood.mean_square(ready.base) < 1.2
    parts = mu_by_stratum(ready.likelihood, ready.base, np.eye(len(ready.base.x)))
    for label, mu, *_ in parts:
        assert mu == pytest.approx(found.own[label.partition(",")[0]], rel=0.1), label


def test_where_says_in_which_recording():
    ready = prepared(examples("monday", "oiled"), may_differ=False)
    found = locate(ready.likelihood, ready.base)
    assert found and {w.recording for w in found} == {"monday", "oiled"}
    assert all(w.says.startswith(f"{w.recording}: ") for w in found)
    alone = prepared(examples("tuesday"))
    assert not any(w.says.startswith("tuesday") for w in locate(alone.likelihood, alone.base))


@pytest.mark.parametrize(
    ("name", "values", "other"),
    [
        ("E", {}, {"E": 1.25e6}),
        ("r1", {}, {"r1": -8.4e-3}),
        ("tip-offset.force", {}, {"tip-offset.force": 0.3}),
    ],
)
def test_the_number_that_differs_is_named(name, values, other):
    two = [recorded("one", 1, posed=True, **values), recorded("other", 2, posed=True, **values | other)]
    ready = prepared(two)
    assert name in {n for d in ready.differ for n in (d.name, *d.or_numbers)}
    (found,) = ready.differ
    if found.name == name:
        change = found.own["other"] - found.own["one"]
        wanted = other[name] - TRUTH.get(name, 0.0)
        assert change == pytest.approx(wanted, rel=0.25)


def test_recordings_that_agree_do_not_differ():
    assert prepared(examples("monday", "tuesday")).differ == []
    assert prepared([recorded(f"r{k}", 10 + k) for k in range(3)]).differ == []


@pytest.mark.slow
def test_an_effect_of_the_rate_is_no_number_that_differs():
    # A slow loop and a fast one with viscous friction: mu of each by itself would fit nearly as well.
    viscous: Any = {"viscous-friction.coefficient": 4.0}
    two = [recorded("slow", 1, duration=300.0, **viscous), recorded("fast", 2, duration=20.0, **viscous)]
    ready = prepared(two)
    assert not ready.differ or "viscous-friction" in ready.differ[0].or_effects


@pytest.fixture
def work(monkeypatch):
    """Samples simulated with physics terms, which is what a diagnosis spends its time on."""
    done, real = [], SimulatedRig._simulated

    def counted(rig, keys):
        for items, _ in keys:
            kinds = {name.partition(".")[0] for name, _ in items} & set(REGISTRY)
            if any(not REGISTRY[kind].of_cells for kind in kinds):
                done.append(padded_length(rig.part.samples) * sum(rig.robot.intervals))
        return real(rig, keys)

    monkeypatch.setattr(SimulatedRig, "_simulated", counted)
    return done


@pytest.mark.slow
def test_three_recordings_that_disagree_take_three_times_one(work, tmp_path, capsys):
    files = [EXAMPLE / f"{name}.csv" for name in ("monday", "tuesday", "oiled")]
    out = tmp_path / "out"
    outcome = run_gtr(capsys, "diagnose", EXAMPLE / "robot.toml", *files, "-o", out)
    assert outcome.status == 0 and outcome.out.startswith(
        "recordings-differ: mu differs between the recordings"
    )
    three = sum(work)
    work.clear()
    calibrate.diagnose(gtr.load_config(EXAMPLE / "robot.toml"), gtr.read_recording(files[0]))
    assert three < 3 * sum(work)
    data = json.loads((out / "diagnosis.json").read_text())
    (found,) = data["differs"]
    assert found["parameter"] == "mu" and found["groups"][0] == ["oiled"]
    assert data["named"] == []
    for name, mu in (("monday", 0.27), ("tuesday", 0.27), ("oiled", 0.22)):
        own = found["by_recording"][name]
        assert own["value"] == data["parameters"][f"mu@{name}"]["after"]
        assert own["value"] == pytest.approx(mu, rel=0.05)
        robot = gtr.load_robot(out / f"diagnosed-{name}.toml")
        assert float(robot.value("mu")) == pytest.approx(own["value"])
    text = (out / "diagnosed.toml").read_text()
    assert text.startswith("# mu differs between the recordings. This file has the values that fit monday.")
    assert [f["recording"] for f in data["robot_files"]] == ["monday", "monday", "tuesday", "oiled"]
    assert "What differs between the recordings: mu" in (out / "report.html").read_text()


@pytest.mark.slow
def test_rivals_are_written_and_the_file_says_that_it_is_not_settled(tmp_path, capsys):
    folder = Path(__file__).parents[1] / "data" / "labelled" / "case-005"
    config, given = gtr.load_config(folder / "robot.toml"), gtr.read_recording(folder / "recording.csv")
    robot, T, time = gtr.build_robot(config), jnp.asarray(given.T_base), jnp.arange(float(len(given)))
    own = robot.with_values(**{"mu": 0.4, "tip-gain.gain": 1.06})
    shown = cells_show(own, T, gtr.simulate(own, T, time=time).T_tip, time)
    T_tip = np.asarray(shown.T_tip) + 0.04 * np.random.default_rng(5).normal(size=len(T))
    made, out = tmp_path / "made.csv", tmp_path / "out"
    gtr.write_recording(made, {"time": np.asarray(time), "T_base": np.asarray(shown.T_base), "T_tip": T_tip})
    outcome = run_gtr(capsys, "diagnose", folder / "robot.toml", made, "-o", out)
    assert outcome.status == 0 and outcome.out.startswith("ambiguous")
    data = json.loads((out / "diagnosis.json").read_text())
    first, *rivals = data["robot_files"]
    assert first["file"] == "diagnosed.toml" and not any(f["settled"] for f in data["robot_files"])
    assert sorted(f["holds"] for f in rivals) == sorted(data["confusion_set"]) and len(rivals) > 1
    assert "diagnosed-tip-gain.toml" in {f["file"] for f in rivals}
    comment = " ".join(
        line[2:] for line in (out / "diagnosed.toml").read_text().splitlines() if line[:1] == "#"
    )
    assert comment.startswith("Not settled") and f"This file holds {first['holds'][0]}." in comment
    assert comment in " ".join(outcome.out.split())
    page = (out / "report.html").read_text()
    for f in rivals:
        assert f["file"] in comment and f["file"] in page
        kinds = {term["kind"] for term in tomllib.loads((out / f["file"]).read_text())["terms"]}
        assert kinds == set(f["holds"])
        gtr.load_robot(out / f["file"])
    assert (out / "diagnosed.toml").read_text().split("schema", 1)[1] == (
        out / f"diagnosed-{first['holds'][0]}.toml"
    ).read_text().split("schema", 1)[1]
