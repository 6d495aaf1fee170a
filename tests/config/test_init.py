"""`gtr init`: robot files from answers, given as options or typed in."""

import math

import pytest
from click.testing import CliRunner

import gtr_jax as gtr
from gtr_jax.app.cli import cli
from gtr_jax.config.new_robot import asks, kinds
from gtr_jax.config.routings import ROUTINGS
from tests.command_line import run_gtr


@pytest.fixture
def init(capsys, tmp_path, monkeypatch):
    """Run `gtr init robot.toml --yes` with options, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *options: run_gtr(capsys, "init", "robot.toml", "--yes", *options)


def offsets(config):
    """Offsets of the channels [m], in their order."""
    return [value for key, value in config.numbers().items() if key.endswith("routing.offset")]


def test_defaults_are_a_robot(init):
    outcome = init()
    assert outcome.status == 0, outcome.err
    config = gtr.load_config("robot.toml")
    assert config.backbone.length == 0.25 and config.backbone.youngs_modulus == 1e6
    assert config.uncertainty == {"backbone.youngs_modulus": 0.2} and offsets(config) == [
        pytest.approx(0.006)
    ]
    assert "time_s, T_base_N, T_tip_N" in outcome.out and "gtr simulate robot.toml --pull 20N" in outcome.out
    # It is not replaced unasked.
    again = init("--length", "100mm")
    assert (
        again.status == 2 and "is there already; choose another name, or replace it with --force" in again.err
    )
    assert gtr.load_config("robot.toml") == config
    assert init("--length", "100mm", "--force").status == 0
    assert gtr.load_config("robot.toml").backbone.length == 0.1


def test_answers_are_options_with_units(init):
    options = [
        "--name",
        "arm",
        "--length",
        "20cm",
        "--radius",
        "12mm",
        "--tip-radius",
        "9 mm",
        "--bore",
        "4mm",
    ]
    options += ["--modulus", "1.2MPa", "--modulus-sd", "10%", "--friction", "0.25", "--gravity=-y"]
    options += [
        "--tendons",
        "left,right",
        "--channel",
        "parallel offset=8mm",
        "--channel",
        "parallel offset=-8mm",
    ]
    outcome = init(*options)
    assert outcome.status == 0, outcome.err
    config = gtr.load_config("robot.toml")
    assert config.name == "arm" and config.tendon_names == ("left", "right")
    assert config.backbone.outer_radius == (0.012, 0.009) and config.backbone.bores[0].diameter == 0.004
    assert config.loads.gravity_angle == pytest.approx(-math.pi / 2) and config.backbone.density == 1070.0
    assert offsets(config) == [0.008, -0.008]
    assert "T_base_N.left, T_base_N.right" in outcome.out and "--tendon left" in outcome.out


def test_bodies_of_other_kinds(init):
    assert init("--body", "rigid", "--curvature", "2 rad/m", "--channel", "parallel offset=0").status == 0
    sheath = gtr.load_config("robot.toml")
    assert sheath.backbone.rigid and sheath.backbone.natural_curvature == 2.0 and not sheath.uncertainty
    assert (
        init("--body", "stiffness", "--stiffness", "2e-3 N m^2", "--drive", "displacement", "--force").status
        == 0
    )
    given = gtr.load_config("robot.toml")
    assert given.backbone.bending_stiffness == 2e-3 and given.tendon.drive == "displacement"


def test_a_file_of_knots_is_read_wherever_the_user_has_it(tmp_path, capsys, monkeypatch):
    """What is named on the command line no file names, so that it need not lie beside the robot file."""
    monkeypatch.chdir(tmp_path)
    for folder in ("robots", "elsewhere"):
        (tmp_path / folder).mkdir()
    knots = tmp_path / "elsewhere" / "knots.csv"
    knots.write_text("s_mm,R_mm\n0,6\n125,3\n250,6\n")
    robot = tmp_path / "robots" / "a.toml"
    for file in (knots, "elsewhere/knots.csv", "../elsewhere/knots.csv"):
        said = ["--tendons", "a,b", "--channel", f"table file={file}"]
        outcome = run_gtr(capsys, "init", robot, "--yes", "--force", *said)
        assert outcome.status == 0, outcome.err
        assert [len(t.routing.model_dump()["knots"]) for t in gtr.load_config(robot).tendons] == [3, 3]
    knots.unlink()
    outcome = run_gtr(capsys, "init", robot, "--yes", "--force", "--channel", f"table file={knots}")
    assert outcome.status != 0 and str(knots) in outcome.err


@pytest.mark.parametrize("space", [False, True])
def test_every_kind_of_channel_has_likely_values(init, tmp_path, space):
    assert {*kinds(space=False)} | {*kinds(space=True)} == {*ROUTINGS}
    (tmp_path / "knots.csv").write_text("s_mm,R_mm\n0,6\n125,3\n250,6\n")
    (tmp_path / "curve.csv").write_text("s_mm,y_mm,z_mm\n0,6,0\n125,4,3\n250,0,6\n")
    files = {"table": " file=knots.csv", "curve": " file=curve.csv"}
    for kind in kinds(space=space):
        outcome = init("--force", "--space" if space else "--plane", "--channel", kind + files.get(kind, ""))
        assert outcome.status == 0, (kind, outcome.err)
        assert gtr.load_config("robot.toml").in_space == space
        every = {"kind", *(one.key for one in asks(kind, length=0.25, radius=0.01))} - {"file"}
        assert every <= {*ROUTINGS[kind].model_fields}
    # Several tendons share the section.
    angles = [asks("straight", length=1, radius=1, tendon=i, of=3)[1].default for i in range(3)]
    assert angles == ["0 deg", "120 deg", "240 deg"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--length", "25N"], "--length: 'N' is not a unit of a length; write for example \"250 mm\""),
        (["--length", "-1mm"], "--length: '-1mm' must be above 0"),
        (["--body", "rubber"], "--body: must be one of modulus, stiffness, rigid; got 'rubber'"),
        (["--length", "120"], "--length: '120' carries no unit; write it too, as in '250mm'"),
        (["--modulus", "1.9"], "--modulus: '1.9' carries no unit; write it too, as in '1MPa'"),
        (["--modulus-sd", "20"], "--modulus-sd: '20' carries no unit; write it too, as in '20%'"),
        (["--channel", "parallel offset=8"], "--channel: '8' carries no unit; write it too, as in '6mm'"),
        (["--bore", "30mm"], "--bore: '30mm' is not less than the diameter of the body"),
        (["--tendons", "left"], "--tendons: 'left' is one name; give two or more with commas"),
        (["--gravity", "+z"], "--gravity: must be one of none, +x, -x, +y, -y; got '+z'"),
        (["--channel", "paralel offset=8mm"], "--channel: must be one of parallel, straight-sine-straight"),
        (["--channel", "parallel ofset=8mm"], "routing: unknown key 'ofset'; did you mean 'offset'?"),
        (["--channel", "parallel 8mm"], "--channel: '8mm' is not NAME=VALUE"),
        (["--channel", "parallel offset=80mm"], "the tendon leaves the body"),
        (["--channel", "table"], "needs the file of its knots, as 'table file=knots.csv'"),
        (
            ["--tendons", "a,b,c", "--channel", "parallel", "--channel", "parallel"],
            "given 2 times for 3 tendons",
        ),
    ],
)
def test_an_answer_that_is_none_is_refused_in_one_line(init, tmp_path, options, says):
    outcome = init(*options)
    assert outcome.status == 2 and outcome.err.startswith("error: ") and outcome.err.count("\n") == 1
    assert says in outcome.err, outcome.err
    assert not (tmp_path / "robot.toml").exists()


def test_questions_are_put_again_until_there_is_an_answer(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    answers = {
        "name": "bench",
        "length": "25N\n30cm",  # a wrong unit first
        "radius": "10 mm",
        "tip radius": "",
        "body": "modulus",
        "bore": "",
        "modulus": "2 MPa",
        "sd": "0",
        "tendons": "left\nleft,right",
        "space": "n",
        "friction": "0.2",
        "drive": "",
        "gravity": "",
        "channel of left": "parallel\n80mm",  # outside the body: asked again
        "again": "parallel\n8mm",
        "channel of right": "parallel\n-8mm",
    }
    done = CliRunner().invoke(cli, ["init", "robot.toml"], input="\n".join(answers.values()) + "\n")
    assert done.exit_code == 0, done.output
    for said in ("is not a unit of a length", "is one name", "the tendon leaves the body"):
        assert f"Error: {said}" in done.output or said in done.output, said
    config = gtr.load_config("robot.toml")
    assert config.name == "bench" and config.backbone.length == 0.3 and not config.uncertainty
    assert offsets(config) == [0.008, -0.008]
    # A file that is there is replaced only after a yes.
    kept = (tmp_path / "robot.toml").read_text()
    CliRunner().invoke(cli, ["init", "robot.toml"], input="n\n")
    assert (tmp_path / "robot.toml").read_text() == kept


def test_a_robot_file_ends_with_toml(capsys, tmp_path):
    outcome = run_gtr(capsys, "init", tmp_path / "robot.csv", "--yes")
    assert outcome.status == 2 and "a robot file ends with .toml; name it robot.toml" in outcome.err


def test_a_number_typed_in_has_the_unit_of_the_answer_beside_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    typed = ["catheter", "120", "1.9", "", "", "0", "55", "20", "", "y", "0.2", "", "+x", "1070"]
    typed += ["helix", "1.2", "1.5", "90"]
    done = CliRunner().invoke(cli, ["init", "robot.toml"], input="\n".join(typed) + "\n")
    assert done.exit_code == 0, done.output
    config = gtr.load_config("robot.toml")
    assert config.backbone.length == 0.12 and config.backbone.outer_radius == (0.0019, 0.0019)
    assert config.backbone.youngs_modulus == 55e6 and config.deviation("youngs_modulus") is None
    assert config.uncertainty == {"backbone.youngs_modulus": 0.2} and config.backbone.density == 1070
    assert config.numbers()["routing.start_angle"] == pytest.approx(math.pi / 2)
    assert config.numbers()["routing.turns"] == 1.5  # a pure number needs no unit
    for taken in ("120 mm", "1.9 mm", "55 MPa", "20 %", "1070 kg/m^3", "1.2 mm", "90 deg"):
        assert f"taken as {taken}\n" in done.output
    assert done.output.count("taken as") == 7


def test_a_length_of_many_metres_is_pointed_out(init):
    outcome = init("--length", "120m")
    assert outcome.status == 0
    assert (
        'warning: backbone.length: 120 m is very large for such a robot; if 120 mm is meant, write "120 mm"'
        in outcome.err
    )


@pytest.mark.parametrize(
    "command", [["init", "robot.toml"], ["export", "robot.toml", "--to", "dxf", "-o", "robot.dxf"]]
)
def test_a_command_that_writes_a_file_does_not_speak_of_run_folders(command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if command[0] == "export":
        monkeypatch.setattr("gtr_jax.config.config.load_config", interrupted)
    monkeypatch.setattr("click.termui.visible_prompt_func", interrupted)
    outcome = run_gtr(capsys, *command)
    assert outcome.status == 130
    assert outcome.err.splitlines()[-1].endswith(f"interrupted: {command[-1]} was not written")


def interrupted(*_):
    raise KeyboardInterrupt
