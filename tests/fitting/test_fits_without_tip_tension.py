"""Fits of recordings without tip tension: what else was recorded is compared, and only that spoken of."""

import dataclasses
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from command_line import run_gtr

import calibrate
import gtr_jax as gtr
from calibrate.fitting.fitted import FittedChannel
from calibrate.fitting.identifiability import _measurements
from calibrate.fitting.without_tip_tension import without_tip
from calibrate.inference.answer import TIP_CELL, Judged
from gtr_jax.recordings.base_tension import exact
from gtr_jax.recordings.thinning import thinned
from gtr_jax.simulation.markers import marker_places
from tests.conftest import PARALLEL

ROOT = Path(__file__).parents[2]
LOOP = np.concatenate([np.linspace(0, 15, 24), np.linspace(15, 3, 20)[1:], np.linspace(3, 12, 16)[1:]])
TRUTH = {"mu": 0.3, "E": 1.06e6}
POSE = {"tip_x": 1e-4, "tip_y": 1e-4, "tip_angle": 1e-3}


def posed(robot, T_base, *, seed=0, sd_base=0.02, channels=("tip_x", "tip_y", "tip_angle"), name="rec"):
    """A recording of the tip's pose or the tendon's displacement, with noise in every column."""
    rng = np.random.default_rng(seed)
    run = gtr.simulate(robot, T_base)
    clean = dict(zip(POSE, np.asarray(run.tip_pose).T, strict=True)) | {"displacement": run.displacement}
    columns = {
        key: np.asarray(clean[key]) + POSE.get(key, 2e-5) * rng.normal(size=len(T_base)) for key in channels
    }
    read = T_base + sd_base * rng.normal(size=len(T_base))
    recording = gtr.Recording(T_base=read, path=Path(f"{name}.csv"), sha256="")
    return dataclasses.replace(recording, **columns)


def holds(fit, name, truth=None):
    """The truth lies within the 95 % interval, and the interval is narrow enough to say something."""
    e, true = fit[name], TRUTH[name] if truth is None else truth
    assert e.lower95 is not None and e.upper95 is not None, fit.verdict
    assert e.lower95 < true < e.upper95
    assert e.upper95 - e.lower95 < 0.4 * true


@pytest.fixture
def truth(make_robot):
    """The robot at another resolution than fits have."""
    return make_robot(resolution=1.6, routing=PARALLEL)


def wrong(make_config, **sections):
    return make_config(
        PARALLEL,
        {"youngs_modulus": 0.85 * TRUTH["E"], **sections.pop("backbone", {})},
        {"friction_coefficient": 0.2},
        **sections,
    )


def test_pose_of_the_tip_gives_friction_and_modulus(make_config, truth):
    fit = calibrate.fit(wrong(make_config), posed(truth, LOOP))
    assert fit.converged, fit.verdict
    holds(fit, "mu")
    holds(fit, "E")
    (only,) = fit.recordings
    assert list(only.channels) == list(POSE)
    assert only.tips == [] and only.noise_N is None and only.chi2_per_n is None and only.by_phase == {}
    assert np.isnan(fit.residual).all() and np.isnan(fit.rms_N) and fit.chi2_per_n is None
    # The noise of the base is told without a tip, and the tip tension is simulated nonetheless.
    assert fit.noise_base_N == pytest.approx(0.02, rel=0.4)
    again = np.asarray(gtr.simulate(fit.robot, fit.T_base).T_tip)
    assert fit.T_tip == pytest.approx(again, abs=1e-9)
    assert all(TIP_CELL not in e.made_of for e in fit.estimates)
    for name, sd in POSE.items():
        assert only.channels[name].rms == pytest.approx(sd, rel=0.4)


def test_the_verdict_speaks_of_what_was_compared(make_config, truth):
    rec = posed(truth, LOOP)
    good = calibrate.fit(wrong(make_config), rec)
    assert "describes the recording to its noise" in good.verdict
    assert "° rms in the tip's angle (neighbouring samples by" in good.verdict
    assert "T_tip" not in good.verdict
    assert " N rms" not in good.verdict and "tension" not in good.verdict
    bent = dataclasses.replace(rec, tip_x=np.asarray(rec.tip_x) + 0.01 * np.sin(LOOP))
    bad = calibrate.fit(wrong(make_config), bent, free="mu,E")
    assert "does not describe the recording" in bad.verdict
    assert "mm rms in the tip's x (neighbouring samples by" in bad.verdict
    plain = json.loads(json.dumps(bad.to_json(), allow_nan=False))
    assert plain["fit"] == {"samples": len(LOOP), "rms_N": None, "chi2_per_n": None}
    assert plain["recordings"][0]["noise_N"] is None
    assert plain["settings"]["peak_T_tip_N"] is None
    assert not any("T_tip" in name for name in plain["recordings"][0]["channels"])


def test_displacement_alone(make_config, truth):
    rec = posed(truth, LOOP, channels=("displacement",))
    fit = calibrate.fit(wrong(make_config, uncertainty={"youngs_modulus": 0.3}), rec)
    assert fit.converged, fit.verdict
    holds(fit, "mu")
    assert list(fit.recordings[0].channels) == ["displacement"]
    assert "mm rms in the tendon's displacement" in fit.verdict


def test_friction_that_the_pose_does_not_tell_is_said(make_config, truth):
    rec = posed(truth, np.linspace(0, 0.5, 30), sd_base=0.0)
    fit = calibrate.fit(make_config(PARALLEL), rec, free="mu")
    assert not fit.converged
    assert "does not determine mu" in fit.verdict


def test_where_nobody_pulls_no_tip_tension_is_proposed(make_robot):
    still = SimpleNamespace(
        robot=make_robot(routing=PARALLEL),
        T_base=exact(np.zeros(20)),
        pulled=[np.zeros(20)],
        others=(),
        channels=("tip_angle",),
        time=None,
        tips=0,
    )
    assert not list(_measurements(cast(Any, still), cast(Any, None), np.zeros(2), None, ""))


def test_few_samples_have_no_known_noise(make_config, truth):
    rec = posed(truth, LOOP[::6], sd_base=0.0)
    fit = calibrate.fit(wrong(make_config), rec, free="E", noise_base_N=0.0)
    assert fit.converged, fit.verdict
    assert "whose noise cannot be estimated" in fit.verdict and "neighbouring" not in fit.verdict


def told(channels, residual, kept=None, noise=1e-4, tau=1.0):
    """What is said of residuals, (C, K), of a recording without tip tension."""
    C, K = residual.shape
    kept = np.ones(K, bool) if kept is None else kept
    recorded = np.linspace(0, 1e-2, K) * np.ones((C, 1))
    part = SimpleNamespace(name="rec", channels=channels, samples=K, recorded=recorded)
    fitted = SimpleNamespace(
        channels={n: FittedChannel("m", r, r, 1.0) for n, r in zip(channels, residual, strict=True)},
        outliers=int(np.sum(~kept)),
    )
    judged = Judged(
        residual=residual,
        phases=np.full(K, "pulling"),
        noises=(),
        weigh=cast(Any, SimpleNamespace(tau=np.full(C, tau))),
        by_noise=cast(Any, None),
        chi2_per_n=None,
        sd=np.full(C, noise),
        least=np.full(C, noise),
        kept=kept,
    )
    return without_tip(cast(Any, part), cast(Any, fitted), judged)


def test_displacements_of_several_tendons_are_no_marker():
    residual = 1e-4 * np.random.default_rng(0).normal(size=(5, 40))
    channels = ("displacement.left", "displacement.right", "mid_x", "mid_y", "tip_rotation_x")
    words = {c.words for c in told(channels, residual).compared}
    assert words == {
        "the tendon's displacement of left",
        "the tendon's displacement of right",
        "the place of marker mid",
        "the tip's rotation",
    }


def test_outliers_of_a_robust_fit_are_left_out_of_its_distance():
    residual = 1e-4 * np.random.default_rng(0).normal(size=(2, 40))
    residual[1, 7] = 0.05
    channels, kept = ("tip_x", "tip_y"), np.arange(40) != 7
    assert not told(channels, residual).described
    robust = told(channels, residual, kept)
    assert robust.described and "without 1 outliers" in robust.clauses()[0]
    assert all(c.rms < 2e-4 for c in robust.compared)
    none = told(channels, residual, np.zeros(40, bool))  # far off everywhere
    assert not none.described and np.isfinite([c.rms for c in none.compared]).all()


@pytest.mark.parametrize(("size", "described"), [(1.1, True), (1.6, False)])
def test_a_misfit_that_remembers_long_is_said(size, described):
    """A slow wave in the pose, whose samples count as few independent ones."""
    wave = size * np.sqrt(2) * 1e-4 * np.sin(np.linspace(0, 4 * np.pi, 200, endpoint=False))
    (only,) = told(["tip_x"], wave[None], tau=40.0).compared
    assert only.described is described


def test_a_recording_with_tip_tension_beside_one_without(make_config, truth):
    pose = posed(truth, LOOP, name="pose")
    rng = np.random.default_rng(5)
    T_tip = np.asarray(gtr.simulate(truth, LOOP).T_tip) + 0.02 * rng.normal(size=len(LOOP))
    tension = gtr.Recording(T_base=LOOP, T_tip=T_tip, path=Path("tension.csv"), sha256="")
    fit = calibrate.fit(wrong(make_config), [tension, pose], noise_base_N=0.0)
    assert fit.converged, fit.verdict
    holds(fit, "mu")
    first, second = fit.recordings
    assert list(first.channels) == ["T_tip"] and list(second.channels) == list(POSE)
    assert fit.chi2_per_n == first.chi2_per_n
    assert fit.rms_N == pytest.approx(first.rms_N)
    assert set(fit.by_recording["mu"]) == {"tension", "pose"}


@pytest.mark.slow
def test_marks_in_space_of_two_tendons(make_config):
    tendons = [
        {
            "name": name,
            "friction_coefficient": 0.25,
            "routing": {"kind": "straight", "radius": 0.008, "angle": angle},
        }
        for name, angle in (("a", 0.5), ("b", 2.6))
    ]
    markers = [
        {"name": "mid", "at": 0.13, "offset": [0.0, 0.0, 0.02]},
        {"name": "end", "at": 0.25, "offset": [0.0, 0.01, 0.0]},
    ]
    body = {"outer_radius": 0.012, "poissons_ratio": 0.45}
    config = make_config(backbone=body, tendons=tendons, markers=markers, space=True)
    truth = gtr.build_robot(config, resolution=0.6)
    pull = np.concatenate([np.linspace(0, 6, 10), np.linspace(6, 2, 8)[1:]])
    T_base = np.stack([pull, np.linspace(0, 3, len(pull))], axis=1)
    rng = np.random.default_rng(2)
    places = np.asarray(marker_places(truth, gtr.simulate(truth, T_base)))
    places = places + 1e-4 * rng.normal(size=places.shape)
    marks = {
        f"{m['name']}_{axis}": places[:, n, i] for n, m in enumerate(markers) for i, axis in enumerate("xyz")
    }
    rec = gtr.Recording(T_base=T_base, path=Path("rec.csv"), sha256="", tendons=("a", "b"), markers=marks)
    start = gtr.build_robot(config, resolution=0.4).with_values(**{"mu.a": 0.35, "mu.b": 0.2, "E": 0.9e6})
    fit = calibrate.fit(start, rec, free="mu.a,mu.b,E", noise_base_N=0.0)
    assert fit.converged, fit.verdict
    holds(fit, "mu.a", 0.25)
    holds(fit, "E")
    assert list(fit.recordings[0].channels) == list(marks)
    assert fit.T_tip.shape == T_base.shape and np.isfinite(fit.T_tip).all()
    assert "marker" in fit.verdict and "T_tip" not in fit.verdict


@pytest.mark.slow
def test_displacement_drives_and_the_pose_is_compared():
    config = gtr.load_config(ROOT / "examples/helix.toml").with_values({"backbone.youngs_modulus": 1.31e6})
    recording = thinned(gtr.read_recording(ROOT / "examples/helix-recording.csv", space=True), 32)
    absent = np.full_like(recording.T_base, np.nan)
    given = dataclasses.replace(recording, T_base=absent, T_tip=None)
    fit = calibrate.fit(config, given, free="mu", channels="tip_x,tip_y,tip_z")
    assert fit.converged, fit.verdict
    assert fit.recordings[0].robot.tendon.drive == "displacement"
    assert list(fit.recordings[0].channels) == ["tip_x", "tip_y", "tip_z"]
    e = fit["mu"]  # the example was made with 0.24
    assert e.sd is not None and abs(e.value - 0.24) < 4 * e.sd


def test_nothing_to_compare_is_refused(make_config):
    config, rec = make_config(PARALLEL), gtr.Recording(T_base=LOOP, path=Path("rec.csv"), sha256="")
    with pytest.raises(gtr.InputError, match=r"rec\.csv: .*T_tip_N.*tip_x_m") as refused:
        calibrate.fit(config, rec)
    assert "\n" not in str(refused.value)
    still = dataclasses.replace(rec, tip_x=np.full(len(LOOP), 0.25))
    with pytest.raises(gtr.InputError, match=r"tip_x never changes"):
        calibrate.fit(config, still)
    moved = dataclasses.replace(rec, tip_x=0.25 - 1e-3 * LOOP, tip_y=1e-3 * LOOP)
    with pytest.raises(gtr.InputError, match=r"ask for some of tip_x, tip_y"):
        calibrate.fit(config, moved, channels="")
    with pytest.raises(gtr.InputError, match=r"noise_N: .*tip tension"):
        calibrate.fit(config, moved, noise_N=0.01)
    with pytest.raises(gtr.InputError, match=r"too few"):
        calibrate.fit(config, dataclasses.replace(moved, T_base=LOOP[:3], tip_x=LOOP[:3], tip_y=LOOP[:3]))


def test_the_command(make_config, truth, capsys, tmp_path):
    gtr.dump_config(wrong(make_config), tmp_path / "robot.toml")
    gtr.write_recording(tmp_path / "rec.csv", posed(truth, LOOP))
    given = tmp_path / "robot.toml", tmp_path / "rec.csv"
    done = run_gtr(
        capsys, "fit", *given, "--free", "E", "--channels", "tip_y,tip_angle", "-o", tmp_path / "out"
    )
    assert done.status == 0, done.err
    assert "rms in the tip's angle" in done.out
    found = json.loads((tmp_path / "out/fit.json").read_text())
    assert list(found["recordings"][0]["channels"]) == ["tip_y", "tip_angle"]
    header = (tmp_path / "out/fit.csv").read_text().splitlines()[0].split(",")
    assert {"T_base_fitted_N", "tip_y_fitted_m", "tip_angle_fitted_rad", "phase"} < set(header)
    assert not any("T_tip" in name or name == "residual_N" for name in header)
    report = (tmp_path / "out/report.html").read_text()
    assert "T_tip" not in report.partition("robot.toml")[0] and "tip cell" not in report
    assert "tip_angle, root mean square" in report
    (played,) = re.findall(r'<script type="application/json">(.*?)</script>', report)
    titles = [chart["title"] for chart in json.loads(played)["charts"]]
    assert titles == ["Tip y", "Tip angle"] and len(json.loads(played)["told"]) == 4
    gtr.write_recording(tmp_path / "bare.csv", {"T_base": LOOP})
    done = run_gtr(capsys, "fit", given[0], tmp_path / "bare.csv", "-o", tmp_path / "other")
    assert done.status != 0 and "T_tip_N" in done.err and done.err.count("\n") == 1


def test_a_column_that_may_be_the_tip_tension_is_named(tmp_path):
    lines = [f"{x},{0.6 * x},{1e-3 * x}" for x in LOOP]
    (tmp_path / "rec.csv").write_text("\n".join(["T_base_N,tip_force_N,tip_y_m", *lines]))
    read = gtr.read_recording(tmp_path / "rec.csv", measured=True)
    assert read.T_tip is None
    assert any("add --columns 'T_tip=tip_force_N[N]'" in note for note in read.notes)


def read_columns(tmp_path, header, **options):
    lines = [",".join([f"{x}"] * (header.count(",") + 1)) for x in LOOP]
    (tmp_path / "rec.csv").write_text("\n".join([header, *lines]))
    return gtr.read_recording(tmp_path / "rec.csv", measured=True, **options)


def test_a_column_that_is_read_is_not_proposed_as_the_tip_tension(tmp_path):
    read = read_columns(tmp_path, "Force,tip_y_m", columns="T_base=Force[N]")
    assert read.notes == ()
    read = read_columns(tmp_path, "Force,load_N,tip_y_m", columns="T_base=Force[N]")
    assert any("add --columns 'T_tip=load_N[N]'" in note for note in read.notes)


def test_what_is_there_already_is_not_asked_for(tmp_path):
    with pytest.raises(gtr.InputError, match=r"no column T_tip_N\.b; (?!.*or record)"):
        read_columns(tmp_path, "T_base_N.a,T_base_N.b,T_tip_N.a,tip_y_m", tendons=("a", "b"))
    with pytest.raises(gtr.InputError, match=r"no column T_tip_N; .*or record the pose (?!.*displacement_m)"):
        read_columns(tmp_path, "time_s,displacement_m", space=True)


def test_glitches_are_looked_for_where_there_are_times(make_config, truth, tmp_path):
    rec = posed(truth, np.repeat(LOOP, 4), sd_base=0.005)
    spoilt = np.array(rec.tip_y)
    spoilt[100] += 0.3
    rec = dataclasses.replace(rec, tip_y=spoilt)
    gtr.write_recording(tmp_path / "holds.csv", rec)
    assert len(gtr.read_recording(tmp_path / "holds.csv", measured=True)) == len(rec)
    gtr.write_recording(tmp_path / "rec.csv", dataclasses.replace(rec, time=0.1 * np.arange(len(rec))))
    assert len(gtr.read_recording(tmp_path / "rec.csv", need_tip=False)) == len(rec)
    read = gtr.read_recording(tmp_path / "rec.csv", measured=True)
    assert len(read) == len(rec) - 1 and read.masked[0].channel == "tip_y"


def test_markers_share_their_error_however_far_the_model_is_off_some(make_config):
    """Otherwise a model that cannot reach the tip would give it up and follow the markers near the base."""
    markers = [{"name": "near", "at": "60 mm"}, {"name": "far", "at": "250 mm"}]
    truth = gtr.build_robot(
        make_config(PARALLEL, markers=markers, terms=[{"kind": "stiffening", "coefficient": 0.03}])
    )
    config = make_config(PARALLEL, markers=markers)
    T_base = np.linspace(0, 15, 20)
    rows = gtr.simulate(truth, T_base)
    seen = np.asarray(marker_places(truth, rows)) + 1e-4 * np.random.default_rng(0).normal(size=(20, 2, 3))
    named = {
        f"{m}_{axis}": seen[:, n, i] for n, m in enumerate(("near", "far")) for i, axis in enumerate("xy")
    }
    recording = gtr.Recording(T_base=T_base, path=Path("rec.csv"), sha256="", markers=named)
    fit = calibrate.fit(config, recording, free=("E",), noise_base_N=0.0)
    fitted = fit.recordings[0]
    sizes = {name: channel.sd for name, channel in fitted.channels.items()}
    assert len(set(sizes.values())) == 1
    off = {name: np.sqrt(np.mean(channel.residual**2)) for name, channel in fitted.channels.items()}
    assert off["far_y"] > 3 * off["near_y"]
