"""Bad input at the command line: exit 2, one line on stderr that says where and what to do, no output."""

import pytest
from command_line import RECORDED, RECORDING, run_gtr

from gtr_jax.examples import SIMULATED

ROBOT = SIMULATED.read_text()
RIGID = ROBOT.replace("[routing]", "rigid = true\n\n[routing]")
GOOD = "time_s,T_base_N,T_tip_N\n0,0,0\n1,10,6\n2,20,12\n3,10,9\n"


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Run a command that must be refused; its message."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        outcome = run_gtr(capsys, *arguments, "-o", "out")
        assert outcome.status == 2
        assert outcome.out == ""
        assert outcome.err.startswith("error: ")
        assert outcome.err.count("\n") == 1 and outcome.err.endswith("\n")
        assert not [
            p.name for p in tmp_path.iterdir() if p.name not in ("robot.toml", "rec.csv", "history.csv")
        ]
        return outcome.err.removeprefix("error: ").rstrip("\n")

    return run


RECORDINGS = {
    "missing column": (
        "time_s,T_base_N\n0,0\n",
        None,
        ["no column T_tip_N", "columns found: time_s, T_base_N", "--columns"],
    ),
    "unknown unit in the header": (GOOD.replace("T_tip_N", "T_tip [stone]"), None, ["'stone'", "--columns"]),
    "unknown unit in the mapping": (GOOD, "T_base=T_base_N[blob]", ["'blob'"]),
    "mapping to no column": (GOOD, "T_base=load_cell", ["load_cell"]),
    "NaN in a cell": (GOOD.replace("2,20,12", "2,nan,12"), None, ["row 4", "T_base_N", "delete the row"]),
    "text in a cell": (GOOD.replace("2,20,12", "2,20,broken"), None, ["row 4", "T_tip_N", "'broken'"]),
    "time going backwards": (
        GOOD.replace("\n2,20", "\n0.5,20"),
        None,
        ["row 4", "time goes backwards", "order"],
    ),
    "tip above base": (GOOD.replace("2,20,12", "2,20,120"), None, ["row 4", "T_tip", "swapped", "--columns"]),
    "sign reversed": (GOOD.replace("2,20,12", "2,-20,12"), None, ["row 4", "T_base", "sign"]),
    "unequal rows": (GOOD.replace("2,20,12", "2,20"), None, ["row 4"]),
    "empty file": ("", None, ["empty"]),
    "header only": ("time_s,T_base_N,T_tip_N\n", None, ["rec.csv"]),
    "time that nobody mapped is not a fault": (
        "Timestamp,F_base_g,F_tip_g\n31.01.2026 14:05,0,0\n",
        None,
        ["no column T_base_N", "--columns 'T_base=F_base_g[gf],T_tip=F_tip_g[gf]'"],
    ),
    "mapped time that is none": ("When,T_base_N,T_tip_N\nnoon,0,0\n", "time=When", ["row 2", "time stamp"]),
    "not text": ("a\0b", None, ["not a text file"]),
}


@pytest.mark.parametrize("case", RECORDINGS)
def test_recording(case, refused, tmp_path):
    text, columns, says = RECORDINGS[case]
    (tmp_path / "rec.csv").write_text(text)
    mapping = ["--columns", columns] if columns else []
    message = refused("fit", SIMULATED, "rec.csv", *mapping)
    for words in ["rec.csv", *says] if "mapping" not in case else says:
        assert words in message


@pytest.mark.parametrize("command", ["fit", "diagnose"])
@pytest.mark.parametrize("unit", ["", "[N]", "[gf]"])
def test_a_forgotten_unit_is_suspected(command, unit, refused, tmp_path):
    header, *rows = RECORDING.read_text().splitlines()
    columns = header.split(",")
    base, tip = columns.index("T_base_N"), columns.index("T_tip_N")
    lines = ["data_0,data_2"]
    for row in rows:
        cells = row.split(",")
        lines.append(",".join(f"{float(cells[i]) / 9.80665e-3:.1f}" for i in (base, tip)))
    if unit == "[gf]":
        lines = lines[:3]  # read right, it is only too short
    (tmp_path / "rec.csv").write_text("\n".join(lines))
    message = refused(command, RECORDED, "rec.csv", "--columns", f"T_base=data_0{unit},T_tip=data_2{unit}")
    if unit == "[gf]":
        assert "samples are too few" in message
    else:
        for words in ("rec.csv", "T_base reaches 4", "grams-force", "[gf]", "youngs_modulus"):
            assert words in message


ROBOTS = {
    "tendon outside the body": (
        'r2 = "10 mm"',
        'r2 = "30 mm"',
        ["routing", "leaves the body at s =", "inside"],
    ),
    "bore wider than the body": ('diameter = "14 mm" },\n]', 'diameter = "34 mm" },\n]', ["bores", "34"]),
    "w1 above w2": ('w1 = "20 mm"', 'w1 = "90 mm"', ["w1", "w2"]),
    "negative modulus": ('"1.06 MPa"', '"-1.06 MPa"', ["youngs_modulus", "positive"]),
    "negative friction": ("= 0.36", "= -0.36", ["friction_coefficient"]),
    "unknown unit": ('"250 mm"', '"250 mmm"', ["backbone.length", "'mmm'", '"250 mm"']),
    "unit of another kind": ('"250 mm"', '"250 N"', ["backbone.length", "not a unit of a length"]),
    "unknown key": ("youngs_modulus", "youngs_moduls", ["'youngs_moduls'", "'youngs_modulus'"]),
    "missing key": ('length = "250 mm"', "", ["'length'", "for example"]),
    "a physics term": (
        "[tendon]",
        '[[terms]]\nkind = "presiding"\n\n[tendon]',
        ["terms[0].kind", "unknown kind 'presiding'; the terms, nearest first: presliding, ", "zero-drift"],
    ),
    "an integer of 400 digits": ('"250 mm"', f"1{400 * '0'}", ["backbone.length", "digits"]),
    "a radius of 1e308": ('["20 mm", "13 mm"]', "1e308", ["backbone.outer_radius", "1e+308 is more than"]),
    "a unit to be computed": ('"250 mm"', '"250 9**9**9"', ["unknown unit '9**9**9'"]),
    "empty file": (ROBOT, "", ["empty"]),
    "not TOML": ("[backbone]", "backbone: {", ["not TOML"]),
}


@pytest.mark.parametrize("case", ROBOTS)
def test_robot(case, refused, tmp_path):
    old, new, says = ROBOTS[case]
    assert old in ROBOT
    (tmp_path / "robot.toml").write_text(ROBOT.replace(old, new))
    message = refused("simulate", "robot.toml", "--pull", "45")
    for words in ["robot.toml", *says]:
        assert words in message


OPTIONS = {
    "no history": ([], "--pull"),
    "pull and history": (["--pull", "45", "--history", "history.csv"], "--pull"),
    "steps and history": (["--steps", "5", "--history", "history.csv"], "--steps"),
    "columns without history": (["--pull", "45", "--columns", "T_base=x"], "--columns"),
    "release above pull": (["--pull", "45", "--release", "46"], "--release"),
    "pull nothing": (["--pull", "0"], "--pull"),
    "release without pull": (["--release", "0"], "--pull"),
    "no steps": (["--pull", "45", "--steps", "0"], "--steps"),
    "half a step": (["--pull", "45", "--steps", "2.5"], "--steps"),
    "tension in metres": (["--pull", "45 mm"], "--pull: 'mm' is not a unit of a force"),
    "tension in words": (["--pull", "hard"], "--pull"),
    "tension not finite": (["--pull", "nan"], "--pull"),
    "resolution of nothing": (["--pull", "45", "--resolution", "0"], "--resolution"),
    "unknown option": (["--pul", "45"], "--pul"),
    "history that is not there": (["--history", "nowhere.csv"], "nowhere.csv: no such file"),
    "history without base tension": (["--history", "history.csv"], "history.csv: no column T_base_N"),
}


@pytest.mark.parametrize("case", OPTIONS)
def test_option(case, refused, tmp_path):
    (tmp_path / "history.csv").write_text("time_s,x\n0,1\n")
    options, says = OPTIONS[case]
    assert says in refused("simulate", SIMULATED, *options)


def test_robot_that_is_not_there(refused):
    assert refused("simulate", "nowhere.toml", "--pull", "45").startswith("nowhere.toml: no such file")


def test_robot_that_is_a_folder(refused, tmp_path):
    assert "error" not in refused("simulate", tmp_path, "--pull", "45")


def test_files_of_a_fit_in_the_wrong_order(refused):
    assert "given twice" in refused("fit", RECORDED, RECORDING, RECORDING)
    assert "needs the robot" in refused("fit", RECORDING, RECORDED)
    assert "no recording follows" in refused("fit", RECORDED)
    assert "no recording follows" in refused("fit", RECORDED, SIMULATED, RECORDING)


def test_robots_that_disagree_about_what_they_share(refused, tmp_path):
    (tmp_path / "rec.csv").write_text(RECORDING.read_text())
    message = refused("fit", RECORDED, RECORDING, SIMULATED, "rec.csv", "--free", "E")
    assert "E is shared" in message and "--per-robot E" in message


def test_unknown_channel(refused):
    assert "got 'angle'" in refused("fit", RECORDED, RECORDING, "--channels", "angle")


def test_unknown_parameter(refused):
    message = refused("fit", RECORDED, RECORDING, "--free", "mu,EE")
    assert "'EE'" in message and "E" in message


def test_no_parameter(refused):
    assert "--free" in refused("fit", RECORDED, RECORDING, "--free", ",")


def test_modulus_of_a_rigid_sheath(refused, tmp_path):
    (tmp_path / "robot.toml").write_text(RIGID)
    assert "rigid" in refused("fit", "robot.toml", RECORDING, "--free", "mu,E")


def test_no_output_folder(capsys):
    outcome = run_gtr(capsys, "simulate", SIMULATED, "--pull", "45")
    assert outcome.status == 2
    assert outcome.err.startswith("error: ") and outcome.err.count("\n") == 1 and "-o" in outcome.err


def test_a_tension_that_no_shape_stands(tmp_path, monkeypatch, capsys):
    # It is seen only once the robot is simulated: progress has been told by then.
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT)
    outcome = run_gtr(capsys, "simulate", "robot.toml", "--pull", "1e12", "--steps", "2", "-o", "out")
    assert outcome.status == 2 and outcome.out == "" and not (tmp_path / "out").exists()
    last = outcome.err.rstrip("\n").splitlines()[-1]
    assert last.startswith("error: robot.toml: at a base tension of") and "is the unit right?" in last
