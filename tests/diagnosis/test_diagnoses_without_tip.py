"""Which physics is missing, from recordings without a cell at the tip: poses, markers and angles."""

import json
from pathlib import Path

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from gtr_jax.__main__ import main
from gtr_jax.config.config import parse_config

PULLS = np.concatenate([np.linspace(0.0, 2.5, 14), np.linspace(2.4, 0.2, 12)])
NOISE = np.deg2rad(0.1)
SOFT = {"kind": "superelastic", "softening": 0.8, "strain": 0.012}
COUNT, HEIGHT, SPACING, FIRST = 3, 0.8e-3, 1.2e-3, 1.2e-3


def wrist(**more):
    """A notched tube of nitinol with a marker behind each notch."""
    pitch = HEIGHT + SPACING
    ends = [FIRST + i * pitch for i in range(COUNT + 1)]
    return parse_config(
        {
            "schema": 1,
            "name": "wrist",
            "backbone": {
                "length": ends[-1],
                "outer_radius": 0.81e-3,
                "youngs_modulus": 50e9,
                "bores": [{"from": 0.0, "to": ends[-1], "diameter": 1.4e-3}],
                "notches": [
                    {"from": FIRST, "height": HEIGHT, "depth": 1.4e-3, "count": COUNT, "spacing": SPACING}
                ],
            },
            "routing": {"kind": "parallel", "offset": 0.7e-3},
            "tendon": {"friction_coefficient": 0.15},
            "markers": [
                {"name": f"n{i}", "at": ends[i + 1] - 0.1e-3, "angle_from": ends[i] - 0.1e-3}
                for i in range(COUNT)
            ],
            **more,
        }
    )


def angles(config, seed):
    """What cameras would record of a robot."""
    robot = gtr.build_robot(config)
    run = gtr.simulate(robot, PULLS)
    assert np.all(run.converged)
    noise = NOISE * np.random.default_rng(seed).normal(size=(len(PULLS), COUNT))
    seen = np.asarray(gtr.marker_angles(robot, run)) + noise
    markers = {f"n{i}_angle": seen[:, i] for i in range(COUNT)}
    return gtr.Recording(T_base=PULLS, path=Path("rec.csv"), sha256="", markers=markers)


@pytest.fixture(scope="module")
def told():
    return calibrate.diagnose(wrist(), angles(wrist(terms=[SOFT]), seed=1))


@pytest.mark.slow
def test_angles_show_that_the_body_is_superelastic(told):
    assert told.verdict == "missing-physics" and told.named == ["superelastic"], told.says
    found = {c.name: c for c in told.parameters}
    strain = found["superelastic.strain"]
    assert strain.lower95 < SOFT["strain"] < strain.upper95
    assert told.unit == "rad" and told.rms[1] < 1.3 * NOISE < 0.3 * told.rms[0]
    assert told.noise == pytest.approx(NOISE, rel=0.3)
    assert "°" in told.says and " N" not in told.says
    assert {w.channel for w in told.where} <= {f"n{i}_angle" for i in range(COUNT)}
    assert told.episodes == [] and "tip-gain" not in told.settings["hypotheses"]


@pytest.mark.slow
@pytest.mark.parametrize("known", [False, True], ids=["nothing known", "its plateau known"])
def test_angles_show_that_it_unloads_on_a_lower_plateau(known):
    """Friction holds the bend on release, too, and is told apart from it."""
    robot, truth = wrist(terms=[SOFT] * known), wrist(terms=[SOFT | {"hysteresis": 0.5}])
    found = calibrate.diagnose(robot, angles(truth, seed=1))
    assert found.verdict == "missing-physics" and found.named == ["superelastic"], found.says
    told = {c.name: c for c in found.parameters}
    assert ("superelastic.softening" in told) == (not known)
    for name, value in (("superelastic.hysteresis", 0.5), ("mu", 0.15)):
        low, high = told[name].lower95, told[name].upper95
        assert low is not None and high is not None
        assert low < value < high


@pytest.mark.slow
def test_sound_angles_are_adequate():
    found = calibrate.diagnose(wrist(), angles(wrist(), seed=2))
    assert found.verdict == "adequate", found.says


@pytest.mark.slow
def test_a_tip_that_is_seen_by_a_camera(make_config):
    """Places tell that a load acts; the tip's angle is compared beside them."""
    sound = make_config(routing={"kind": "parallel", "offset": 0.01})
    loaded = sound.with_values({"loads.tip_force": (0.0, 0.15)})
    T = np.concatenate([np.linspace(0.0, 8.0, 20), np.linspace(7.5, 0.5, 18)])
    run = gtr.simulate(gtr.build_robot(loaded), T)
    x, y, angle = np.asarray(run.tip_pose).T
    rng = np.random.default_rng(4)
    read = {"tip_x": x, "tip_y": y, "tip_angle": angle}
    sizes = {"tip_x": 3e-4, "tip_y": 3e-4, "tip_angle": 5e-3}
    read = {name: values + sizes[name] * rng.normal(size=len(T)) for name, values in read.items()}
    recording = gtr.Recording(T_base=T, path=Path("rec.csv"), sha256="", **read)
    found = calibrate.diagnose(sound, recording)
    assert found.unit == "m" and found.rms[1] < 1.3 * 3e-4
    assert any("tip-load" in names for names in (found.named, *found.confusion_set)), found.says


@pytest.mark.slow
def test_the_command_writes_what_was_recorded(told, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(calibrate, "diagnose", lambda *_, **__: told)
    gtr.dump_config(wrist(), tmp_path / "robot.toml")
    recording = angles(wrist(terms=[SOFT]), seed=1)
    gtr.write_recording(
        tmp_path / "rec.csv",
        {"T_base_N": recording.T_base} | {f"{k}_rad": v for k, v in recording.markers.items()},
    )
    out = tmp_path / "out"
    assert main(["diagnose", str(tmp_path / "robot.toml"), str(tmp_path / "rec.csv"), "-o", str(out)]) == 0
    assert "missing-physics" in capsys.readouterr().out
    said = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))["fit"]
    assert said["rms_rad"]["after"] < said["rms_rad"]["before"] and "held_out_rms_rad" in said
    header = (out / "diagnosis.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert header[:4] == ["T_base_N", "n0_angle_rad", "n0_angle_before_rad", "n0_angle_after_rad"]
    assert header[-1] == "phase"
    assert list(told.loops[0].to_pandas().columns) == header
    data = told.loops[0].to_xarray()
    assert data.n0_angle_after.units == "rad" and "phase" in data.coords
    np.testing.assert_array_equal(data.n0_angle_after, told.loops[0].after[0])
    numbers = told.to_pandas()
    assert numbers.index.tolist() == [c.name for c in told.parameters]
    assert numbers["sd"].isna().tolist() == [c.sd is None for c in told.parameters]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "angle at marker n0" in page and "residual of T_tip" not in page


def test_what_cannot_be_diagnosed_together_is_refused(make_config):
    config = make_config(routing={"kind": "parallel", "offset": 0.01})
    T = np.linspace(0.0, 8.0, 30)
    seen = gtr.Recording(T_base=T, path=Path("seen.csv"), sha256="", tip_x=0.25 - 1e-4 * T, tip_y=1e-3 * T)
    felt = gtr.Recording(T_base=T, path=Path("felt.csv"), sha256="", T_tip=0.8 * T)
    with pytest.raises(gtr.InputError, match=r"seen\.csv: no tip tension, which felt\.csv has"):
        calibrate.diagnose(config, [felt, seen])
    with pytest.raises(gtr.InputError, match=r"noise_N: no recording has a tip tension"):
        calibrate.diagnose(config, seen, noise_N=0.01)
    few = gtr.Recording(T_base=T[:8], path=Path("few.csv"), sha256="", tip_x=0.25 - 1e-4 * T[:8])
    assert "8 samples are too few to diagnose; record 20 or more" in calibrate.diagnose(config, few).says
