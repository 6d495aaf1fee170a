"""Several tendons, and a payload, in robot files, recordings, the command line and sensitivities."""

import csv
import json
import tomllib
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run_gtr

import calibrate
import design
import gtr_jax as gtr
from benchmarks.paper.study import ROBOTS
from gtr_jax.config.config import parse_config
from gtr_jax.errors import InputWarning
from gtr_jax.examples import SIMULATED

PAIR = ROBOTS / "antagonists.toml"
LEFT = '[[tendons]]\nname = "left"'


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run_gtr(capsys, *arguments)


def test_a_file_of_two_tendons():
    config = gtr.load_config(PAIR)
    assert config.tendon_names == ("left", "right")
    assert config.tendon is None and config.routing is None
    numbers = config.numbers()
    assert numbers["tendons.left.routing.offset"] == 0.008
    assert numbers["tendons.right.preload"] == 1.0
    changed = config.with_values(
        {"tendons.left.friction_coefficient": 0.1, "tendons.right.routing.offset": "-7 mm"}
    )
    assert changed.numbers()["tendons.left.friction_coefficient"] == 0.1
    assert changed.tendons[1].routing.model_dump()["offset"] == -0.007
    with pytest.raises(gtr.InputError, match=r"tendons\.middle"):
        config.with_values({"tendons.middle.preload": 1.0})


def test_it_is_written_and_read_back(tmp_path):
    config = gtr.load_config(PAIR)
    gtr.dump_config(config, tmp_path / "robot.toml")
    assert gtr.load_config(tmp_path / "robot.toml") == config


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name = "right"', 'name = "left"', "tendons[1].name: 'left' is given twice"),
        ('name = "right"', 'name = "1"', "tendons[1].name: '1' cannot end a column's name"),
        ('name = "right"\n', "", "name"),
        (LEFT, f"[tendon]\nfriction_coefficient = 0.3\n\n{LEFT}", "has both 'tendon' and 'tendons'"),
        ('"-8 mm"', '"-13 mm"', "tendons.right"),
        (
            'routing = { kind = "parallel", offset = "8 mm" }\n',
            "",
            'add for example routing = { kind = "parallel"',
        ),
        ("friction_coefficient", "friction", "did you mean 'friction_coefficient'?"),
        ("friction_coefficient = 0.3", "friction_coefficient = -0.3", "cannot be negative"),
    ],
    ids=["twice", "digit", "nameless", "both", "outside", "unrouted", "unknown", "negative"],
)
def test_what_is_refused(tmp_path, old, new, says):
    text = PAIR.read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "robot.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(gtr.InputError) as refused:
        gtr.load_robot(tmp_path / "robot.toml")
    assert says in str(refused.value) and "robot.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_one_table_of_several_is_a_robot_with_one_tendon(tmp_path):
    text = PAIR.read_text(encoding="utf-8")
    text = text[: text.rindex("[[tendons]]")]
    text += """
[[terms]]
kind = "adhesion"
tendon = "left"
drag = "0.1 N/m"
[uncertainty]
"tendons.left.friction_coefficient" = "10 %"
"tendons.left.routing.offset" = "0.1 mm"
"""
    (tmp_path / "robot.toml").write_text(text, encoding="utf-8")
    with pytest.warns(InputWarning, match="tendons: there is only one, so its columns and numbers carry"):
        config = gtr.load_config(tmp_path / "robot.toml")
    several = gtr.load_config(PAIR)
    assert config.tendon_names == () and config.routing == several.tendons[0].routing
    assert config.tendon.friction_coefficient == several.tendons[0].friction_coefficient
    assert config.terms[0].tendon is None
    assert config.uncertainty == {"tendon.friction_coefficient": 0.1, "routing.offset": "0.1 mm"}
    # Written and read again it is the same robot, as one with one tendon.
    gtr.dump_config(config, tmp_path / "again.toml")
    assert gtr.load_config(tmp_path / "again.toml") == config
    assert gtr.load_robot(tmp_path / "again.toml").tendon_names == ()


def test_the_name_of_a_lone_tendon_is_refused_in_one_line(tmp_path):
    """Its robot has one tendon without a name."""
    from gtr_jax.app.cli.simulate import pulls_of

    path = tmp_path / "r.csv"
    path.write_text("T_base_N.left,T_tip_N.left\n1,1\n2,1\n3,2\n", encoding="utf-8")
    with pytest.raises(gtr.InputError) as refused:
        gtr.read_recording(path)
    assert str(refused.value) == (
        f"{path}: no column T_base_N, but 'T_base_N.left'; a robot's one tendon carries no name: rename the "
        "column to T_base_N, and likewise others that end with .left"
    )
    text = PAIR.read_text(encoding="utf-8")
    (tmp_path / "robot.toml").write_text(text[: text.rindex("[[tendons]]")], encoding="utf-8")
    with pytest.warns(InputWarning, match="there is only one"):
        config = gtr.load_config(tmp_path / "robot.toml")
    with pytest.raises(gtr.InputError, match="the robot's one tendon carries no name; leave --tendon out"):
        pulls_of(config, "left", None, None, None)


def test_a_pull_to_nothing_is_the_rest_under_what_acts(tmp_path):
    """Loads, preloads and terms act on a robot that nobody pulls; on others --pull 0 is refused as before."""
    from gtr_jax.app.cli.simulate import pulls_of
    from gtr_jax.config.amount import amount_of

    acting = ('[loads]\ntip_force = ["0 N", "-0.1 N"]', '[loads]\ntip_force = ["0 N", "0 N", "0.1 N"]')
    for section in acting:
        config = parse_config(tomllib.loads(SINGLE + section))
        for drive in (pulls_of(config, None, amount_of(0), None, None),):
            assert drive.T_base.tolist() == [0.0]
    preloaded = parse_config(tomllib.loads(SINGLE.replace("0.3", '0.3\npreload = "2 N"')))
    assert pulls_of(preloaded, None, amount_of(2), None, None).T_base.tolist() == [2.0]
    for config, pull in ((preloaded, 0), (parse_config(tomllib.loads(SINGLE)), 0)):
        with pytest.raises(gtr.InputError, match="--pull: must be above the preload"):
            pulls_of(config, None, amount_of(pull), None, None)


SINGLE = """
schema = 1
[backbone]
length = "250 mm"
outer_radius = "10 mm"
youngs_modulus = "1 MPa"
[routing]
kind = "parallel"
offset = "5 mm"
[tendon]
friction_coefficient = 0.3
"""


def test_recording_of_two_tendons(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("T_base_gf.right,time_s,T_base_gf.left\n100,0,0\n200,1,50\n")
    recording = gtr.read_recording(path, need_tip=False, tendons=("left", "right"))
    np.testing.assert_allclose(recording.T_base, np.array([[0, 100], [50, 200]]) * 9.80665e-3)
    gtr.write_recording(tmp_path / "again.csv", recording)
    again = gtr.read_recording(tmp_path / "again.csv", need_tip=False, tendons=("left", "right"))
    np.testing.assert_allclose(again.T_base, recording.T_base, rtol=0)
    mapped = gtr.read_recording(
        path,
        "T_base.left=T_base_gf.right[gf],T_base.right=T_base_gf.left[gf]",
        need_tip=False,
        tendons=("left", "right"),
    )
    np.testing.assert_allclose(mapped.T_base, recording.T_base[:, ::-1])
    with pytest.raises(gtr.InputError, match=r"both T_base\.left and T_base\.right"):
        gtr.read_recording(
            path,
            "T_base.left=T_base_gf.left[gf],T_base.right=T_base_gf.left[gf]",
            need_tip=False,
            tendons=("left", "right"),
        )
    path.write_text("T_base_N.left,T_base_N.rigth\n0,0\n1,1\n")
    with pytest.raises(gtr.InputError, match=r"T_base\.right=T_base_N\.rigth\[N\]"):
        gtr.read_recording(path, need_tip=False, tendons=("left", "right"))
    path.write_text("T_base_N.left,T_base_N.left\n0,0\n1,1\n")
    with pytest.raises(gtr.InputError, match="rename one"):
        gtr.read_recording(path, need_tip=False, tendons=("left", "right"))
    path.write_text("T_base_N.left\n0\n1\n")
    with pytest.raises(gtr.InputError, match=r"T_base_N\.right"):
        gtr.read_recording(path, need_tip=False, tendons=("left", "right"))


def test_simulate_at_the_command_line(run, tmp_path):
    outcome = run(
        "simulate", PAIR, "--tendon", "left", "--pull", "9", "--release", "1", "--steps", "8", "-o", "a"
    )
    assert outcome.status == 0, outcome.err
    facts = json.loads((tmp_path / "a/simulation.json").read_text())
    assert set(facts["at_T_base_max"]["tendons"]) == {"left", "right"}
    rows = list(csv.DictReader((tmp_path / "a/simulation.csv").read_text().splitlines()))
    assert len(rows) == 17 and {row["T_base_N.right"] for row in rows} == {"1.0"}
    assert float(rows[8]["T_tip_N.right"]) > 1.0, "dragged along by the body"
    profile = list(csv.DictReader((tmp_path / "a/profile.csv").read_text().splitlines()))
    assert (
        float(profile[-1]["tension_loss_factor.left"]) < 1 < float(profile[-1]["tension_loss_factor.right"])
    )
    again = run("simulate", PAIR, "--history", "a/simulation.csv", "-o", "b")
    assert again.status == 0, again.err
    assert (tmp_path / "b/simulation.csv").read_bytes() == (tmp_path / "a/simulation.csv").read_bytes()
    refused = run("diagnose", PAIR, "a/simulation.csv", "-o", "c")
    assert refused.status == 1 and "17 samples are too few to diagnose" in refused.out


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--pull", "9"), "--tendon: which of"),
        (("--pull", "9", "--tendon", "lef"), "did you mean 'left'?"),
        (("--pull", "0.5", "--tendon", "left"), "above the preload of 1 N"),
        (("--history", "h.csv"), "T_base_N.left"),
    ],
)
def test_bad_input_at_the_command_line(run, tmp_path, arguments, says):
    (tmp_path / "h.csv").write_text("T_base_N\n0\n1\n")
    outcome = run("simulate", PAIR, *arguments, "-o", "out")
    assert outcome.status == 2 and says in outcome.err and len(outcome.err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_a_diagnosis_of_three_samples_of_two_tendons_is_refused():
    robot = gtr.load_robot(PAIR)
    recording = gtr.Recording(
        T_base=np.ones((3, 2)),
        T_tip=np.ones((3, 2)),
        tendons=("left", "right"),
        path=Path("rec.csv"),
        sha256="",
    )
    with pytest.raises(gtr.InputError, match="3 samples are too few"):
        calibrate.diagnose(robot, recording)


def test_sensitivities_of_two_tendons():
    robot = gtr.load_robot(PAIR)
    table = design.pose_sensitivity(robot, [9.0, 2.0], ("offset.left", "E"))
    assert table.converged and table.outputs[-2:] == ("T_tip.left", "T_tip.right")
    for name in ("offset.left", "E"):
        step = 1e-4 * abs(float(robot.value(name)))
        ends = []
        for h in (step, -step):
            eq = gtr.equilibrium(robot.with_values(**{name: robot.value(name) + h}), [9.0, 2.0])
            ends.append(np.append(np.asarray(eq.tip_pose), np.asarray(eq.T_tip)))
        found = [table[output, name] for output in table.outputs]
        assert found == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)


def test_a_payload_weighs_as_a_tip_force_does():
    config = gtr.load_config(SIMULATED).with_values({"backbone.density": 1000.0})
    data = config.model_dump(by_alias=True, exclude_none=True)
    loads = {"gravity_angle": -np.pi / 2}
    heavy = gtr.build_robot(gtr.RobotConfig.model_validate(data | {"loads": {**loads, "payload": "50 g"}}))
    force = gtr.build_robot(
        gtr.RobotConfig.model_validate(data | {"loads": {**loads, "tip_force": [0.0, -0.05 * 9.80665]}})
    )
    one, two = gtr.equilibrium(heavy, 30.0), gtr.equilibrium(force, 30.0)
    np.testing.assert_allclose(one.tip_pose, two.tip_pose, rtol=1e-9)
    lighter = gtr.equilibrium(heavy.with_values(payload=0.0), 30.0)
    assert float(lighter.tip_pose[1]) > float(one.tip_pose[1]) + 1e-3
    with pytest.raises(ValueError, match=r"loads\.payload.*gravity_angle"):
        gtr.RobotConfig.model_validate(data | {"loads": {"payload": 0.05}})
    assert bool(jnp.isfinite(one.T_tip))


def test_the_example_is_the_packaged_one():
    assert (Path(__file__).parents[2] / "examples/antagonists.toml").read_bytes() == PAIR.read_bytes()
