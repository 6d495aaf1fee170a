"""`gtr` with robots in space."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from command_line import run_gtr

import gtr_jax as gtr
from gtr_jax.recordings.driving import driven

EXAMPLES = Path(__file__).parents[2] / "examples"
HELIX, THREE = EXAMPLES / "helix.toml", EXAMPLES / "three-tendons.toml"


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run_gtr(capsys, *arguments)


def rows_of(path):
    return list(csv.DictReader(Path(path).read_text().splitlines()))


def test_simulate_a_helix(run, tmp_path):
    outcome = run("simulate", HELIX, "--pull", "10", "--release", "1", "--steps", "8", "-o", "a")
    assert outcome.status == 0, outcome.err
    rows = rows_of("a/simulation.csv")
    assert len(rows) == 17
    assert {"tip_z_m", "tip_qw", "m1_x_m", "m1_z_m", "displacement_m"} <= set(rows[0])
    for row in rows:
        quaternion = [float(row[f"tip_q{axis}"]) for axis in "xyzw"]
        assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)
    loaded = rows[8]
    assert float(loaded["T_base_N"]) == 10.0 and float(loaded["T_tip_N"]) < 9.7
    assert abs(float(loaded["tip_z_m"])) > 0.05 and abs(float(loaded["tip_y_m"])) > 0.005
    facts = json.loads((tmp_path / "a/simulation.json").read_text())
    assert facts["at_T_base_max"]["tip_z_m"] == float(loaded["tip_z_m"])
    html = (tmp_path / "a/report.html").read_text()
    assert 'class="playback"' in html and '"space":true' in html and (tmp_path / "a/shape.png").exists()
    profile = rows_of("a/profile.csv")
    assert {"z_m", "twist_per_m", "offset_z_m"} <= set(profile[0])
    ends = rows_of("a/channel.csv")[-1]
    assert float(ends["body_x_mm"]) == pytest.approx(250) and "y_mm" in ends

    again = run("simulate", HELIX, "--history", "a/simulation.csv", "-o", "b")
    assert again.status == 0, again.err
    assert (tmp_path / "b/simulation.csv").read_bytes() == (tmp_path / "a/simulation.csv").read_bytes()


@pytest.mark.slow
def test_simulate_by_displacement(run, tmp_path):
    text = HELIX.read_text().replace(
        "friction_coefficient = 0.3",
        'friction_coefficient = 0.3\ndrive = "displacement"\naxial_stiffness = "4 kN"',
    )
    (tmp_path / "robot.toml").write_text(text)
    outcome = run("simulate", "robot.toml", "--pull", "6 mm", "--release", "2 mm", "--steps", "3", "-o", "a")
    assert outcome.status == 0, outcome.err
    rows = rows_of("a/simulation.csv")
    found = [1e3 * float(row["displacement_m"]) for row in rows]
    np.testing.assert_allclose(found, [0, 2, 4, 6, 14 / 3, 10 / 3, 2], atol=1e-9)
    tension = [float(row["T_base_N"]) for row in rows]
    assert tension[3] == max(tension) and all(float(row["T_tip_N"]) > 0 for row in rows[1:])
    again = run("simulate", "robot.toml", "--history", "a/simulation.csv", "-o", "b")
    assert again.status == 0, again.err
    back = [float(row["T_base_N"]) for row in rows_of("b/simulation.csv")]
    np.testing.assert_allclose(back, tension, atol=1e-8)


def test_markers_of_a_planar_robot(run, tmp_path):
    text = (EXAMPLES / "tdcm-1.toml").read_text()
    text += '\n[[markers]]\nname = "m1"\nat = "250 mm"\noffset = ["0 mm", "5 mm", "9 mm"]\n'
    (tmp_path / "robot.toml").write_text(text)
    outcome = run("simulate", "robot.toml", "--pull", "20", "--steps", "3", "-o", "a")
    assert outcome.status == 0, outcome.err
    last = {key: float(value) for key, value in rows_of("a/simulation.csv")[-1].items() if key != "phase"}
    angle = last["tip_angle_rad"]
    assert last["m1_x_m"] == pytest.approx(last["tip_x_m"] - 0.005 * np.sin(angle), abs=1e-12)
    assert last["m1_y_m"] == pytest.approx(last["tip_y_m"] + 0.005 * np.cos(angle), abs=1e-12)
    assert "m1_z_m" not in last


def test_a_target_in_the_plane_is_refused_for_a_robot_that_leaves_it(run, tmp_path):
    (tmp_path / "target.toml").write_text('schema = 1\n[[pose]]\nT_base = "5 N"\ntip = ["240 mm", "10 mm"]\n')
    outcome = run("design", HELIX, "target.toml", "-o", "out")
    assert outcome.status == 2, outcome.out
    assert "plane" in outcome.err and len(outcome.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_simulate_a_tendon_on_disks(run, tmp_path):
    text = HELIX.read_text().replace("= 0.3\n", '= 0.3\nguides = ["100 mm", "250 mm"]\n')
    (tmp_path / "robot.toml").write_text(text)
    outcome = run("simulate", "robot.toml", "--pull", "2", "--steps", "3", "-o", "out")
    assert outcome.status == 0, outcome.err
    rows = [(float(row["s_m"]), float(row["tension_N"])) for row in rows_of("out/profile.csv")]
    tension = [
        {round(T, 9) for s, T in rows if there(s)} for there in (lambda s: s < 0.0999, lambda s: s > 0.1001)
    ]
    assert [len(values) for values in tension] == [1, 1], "constant between the corners"
    assert 2 > max(tension[0]) > max(tension[1]) > 0


@pytest.mark.parametrize(
    ("robot", "arguments", "says"),
    [
        (THREE, ("--pull", "10", "--tendon", "a"), "driven by displacement; give for example --pull '10 mm'"),
        (HELIX, ("--pull", "10 mm"), "'mm' is not a unit of a force"),
        (HELIX, ("--pull", "10 quux"), "unknown unit"),
        (THREE, ("--pull", "10 mm", "--release", "12 mm", "--tendon", "a"), "between 0 mm and the 10 mm of"),
        (THREE, ("--history", "tension.csv"), "no column displacement_m.a, by which the tendon is driven"),
        (THREE, ("--history", "two.csv"), "no column T_base_N.c"),
    ],
)
def test_what_drives_a_tendon_has_to_be_said(run, tmp_path, robot, arguments, says):
    (tmp_path / "tension.csv").write_text("T_base_N.a,T_base_N.b,T_base_N.c\n0,0,0\n1,1,1\n")
    (tmp_path / "two.csv").write_text("displacement_mm.a,displacement_mm.b\n0,0\n1,1\n")
    outcome = run("simulate", robot, *arguments, "-o", "out")
    assert outcome.status == 2 and len(outcome.err.strip().splitlines()) == 1
    assert says in outcome.err


def test_how_a_history_drives(tmp_path):
    text = (
        "displacement_mm.a,T_base_N.b,displacement_mm.b,T_base_N.c,displacement_mm.c\n0,0,9,0,0\n4,3,9,0,1\n"
    )
    (tmp_path / "h.csv").write_text(text)
    config = gtr.load_config(THREE)
    config = config.with_values({"tendons.b.drive": "tension", "tendons.b.axial_stiffness": 2e3})
    given = gtr.read_recording(tmp_path / "h.csv", need_tip=False, tendons=config.tendon_names, space=True)
    changed, drive = driven(config, given)
    assert [tendon.drive for tendon in changed.tendons] == ["displacement", "tension", "displacement"]
    np.testing.assert_allclose(drive.T_base, [[np.nan, 0, np.nan], [np.nan, 3, np.nan]])
    assert drive.displacement is not None
    np.testing.assert_allclose(drive.displacement[:, [0, 2]], [[0, 0], [4e-3, 1e-3]])


def test_a_displacement_drives_a_robot_of_the_plane_in_space(tmp_path):
    (tmp_path / "h.csv").write_text("displacement_mm\n0\n4\n")
    config = gtr.load_config(EXAMPLES / "tdcm-1.toml")
    changed, drive = driven(config, gtr.read_recording(tmp_path / "h.csv", need_tip=False, space=True))
    assert changed.in_space and not config.in_space and np.isnan(drive.T_base).all()
