"""Files that another file names stay in its folder and are plain files, and no file that is read can hang."""

import json
import os
from pathlib import Path

import pytest
from command_line import RECORDED, RECORDING, run_gtr

from calibrate.planning.opened import open_folder
from design.target import parse_target
from design.uncertainty import uncertainty_of
from gtr_jax.config import references
from gtr_jax.config.config import load_config
from gtr_jax.errors import InputError
from gtr_jax.recordings.formats import text
from gtr_jax.sweep.config import parse_sweep
from gtr_jax.sweep.loadpath import given_history
from gtr_jax.sweep.task import inputs_of, task_of

BODY = """schema = 1
name = "robot"
[backbone]
length = "250 mm"
outer_radius = "10 mm"
youngs_modulus = "1 MPa"
[tendon]
friction_coefficient = 0.3
[routing]
kind = "table"
"""
ROUTE = "s_mm,R_mm\n0,5\n100,4\n250,5\n"
PRIVATE = "root:$y$secret:19000:0\nsecond:$y$hidden:19000:0\nthird line\n"
OUTSIDE = "is not in the folder of the file that names it"


@pytest.fixture
def folder(tmp_path):
    """A folder that somebody handed over, beside a file of the user's own."""
    (tmp_path / "private").write_text(PRIVATE)
    (tmp_path / "route.csv").write_text(ROUTE)
    inside = tmp_path / "handed"
    inside.mkdir()
    return inside


def robot(folder: Path, name: str) -> Path:
    path = folder / "robot.toml"
    path.write_text(f"{BODY}file = {name!r}\n")
    return path


def first_knot(path: Path):
    return getattr(load_config(path).routing, "knots")[0]  # noqa: B009


def sweep_naming(folder: Path, **named):
    data = {"schema": 1, "robot": "robot.toml", "outputs": ["T_tip"], "vary": {"mu": [0.1, 0.2]}}
    return parse_sweep(data | {"history": {"pull": "5 N"}} | named, source="SWEEP.toml", folder=folder)


def of_robot(folder, name):
    load_config(robot(folder, name))


def of_robot_of_sweep(folder, name):
    task_of(sweep_naming(folder, robot=name))


def of_points(folder, name):
    robot(folder, "route.csv")
    (folder / "route.csv").write_text(ROUTE)
    sweep = sweep_naming(folder, points=name, vary={})
    inputs_of(sweep)
    task_of(sweep)


def of_history(folder, name):
    robot(folder, "route.csv")
    (folder / "route.csv").write_text(ROUTE)
    sweep = sweep_naming(folder, history={"file": name})
    inputs_of(sweep)
    given_history(sweep, load_config(folder / "robot.toml"))


def of_fit(folder, name):
    target = {"schema": 1, "pose": [{"T_base": "5 N", "angle": "10 deg"}], "robust": {"fit": name}}
    uncertainty_of(load_config(RECORDED), parse_target(target, source="TARGET.toml", folder=folder))


def of_run_folder(folder, name):
    known = {"names": ["mu"], "matrix": [[1.0]]}
    model = {"settled": True, "recording": None, "file": name, "holds": [], "probability": 1}
    answer = {"robot_files": [model | {"information": known}], "recordings": [{"name": "r"}]}
    (folder / "diagnosis.json").write_text(json.dumps(answer))
    open_folder(folder)


KINDS = [of_robot, of_robot_of_sweep, of_points, of_history, of_fit, of_run_folder]


@pytest.mark.parametrize("read", KINDS, ids=lambda read: read.__name__.removeprefix("of_"))
@pytest.mark.parametrize("name", ["../private", "link", "/dev/zero", "absolute", "up.csv"])
def test_no_file_outside_is_read(read, name, folder):
    (folder / "link").symlink_to(folder.parent / "private")
    (folder / "up.csv").symlink_to("..")
    name = str(folder.parent / "private") if name == "absolute" else name
    with pytest.raises(InputError) as caught:
        read(folder, name)
    assert OUTSIDE in str(caught.value)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("read", KINDS, ids=lambda read: read.__name__.removeprefix("of_"))
@pytest.mark.parametrize("ending", ["", ".csv", ".dxf", ".parquet"])
def test_a_pipe_inside_is_no_file(read, ending, folder):
    os.mkfifo(folder / f"pipe{ending}")
    with pytest.raises(InputError, match="is a folder, a pipe or a device; name a file"):
        read(folder, f"pipe{ending}")


@pytest.mark.parametrize("read", [of_robot, of_points, of_history])
def test_what_is_no_table_is_not_quoted(read, folder):
    (folder / "notes.csv").write_text(PRIVATE.replace(":", " "))
    with pytest.raises(InputError, match=r"notes.csv: holds no column of numbers") as caught:
        read(folder, "notes.csv")
    assert "secret" not in str(caught.value) and "19000" not in str(caught.value)


def test_a_stated_root_holds_files_too(folder, monkeypatch):
    path = robot(folder, "../route.csv")
    with pytest.raises(InputError, match=OUTSIDE):
        load_config(path)
    monkeypatch.setenv(references.VARIABLE, str(folder.parent))
    assert first_knot(path) == (0.0, 0.005)
    with pytest.raises(InputError, match=OUTSIDE):
        load_config(robot(folder, "../../../dev/zero"))


def test_subfolders_and_links_inside_are_the_folder(folder, monkeypatch):
    (folder / "routes").mkdir()
    (folder / "routes" / "a.csv").write_text(ROUTE)
    (folder / "b.csv").symlink_to("routes/a.csv")
    for name in ("routes/a.csv", "b.csv", "routes/../b.csv", str(folder / "b.csv")):
        assert first_knot(robot(folder, name)) == (0.0, 0.005)
    link = folder.parent / "linked"
    link.symlink_to(folder)
    monkeypatch.chdir(link)
    assert first_knot(Path("robot.toml")) == (0.0, 0.005)


def test_names_that_are_no_names(folder):
    (folder / "loop").symlink_to("loop")
    with pytest.raises(InputError):
        load_config(robot(folder, "loop"))
    with pytest.raises(InputError, match="cannot be the name of a file"):
        references.referenced("a\0b", folder, "robot.toml")


def test_a_file_that_another_names_is_of_bounded_size(folder, monkeypatch):
    with (folder / "vast.csv").open("wb") as file:
        file.truncate(references.LARGEST + 1)
    with pytest.raises(InputError, match=r"'vast.csv' has more than 256 MiB"):
        load_config(robot(folder, "vast.csv"))


def test_a_file_that_is_read_is_of_bounded_size(tmp_path, monkeypatch):
    path = tmp_path / "vast.csv"
    with path.open("wb") as file:
        file.truncate(text.LARGEST + 1)
    with pytest.raises(InputError, match=r"vast.csv: has more than 1 GiB; export fewer columns"):
        text.read_bytes(path)


PIPED = {
    "inspect": ["inspect", "pipe", "-o", "out"],
    "the other recording": ["fit", RECORDED, "pipe", "-o", "out"],
    "diagnose": ["diagnose", RECORDED, "pipe", "-o", "out"],
    "simulate": ["simulate", "pipe", "--pull", "5", "-o", "out"],
    "a history": ["simulate", RECORDED, "--history", "pipe", "-o", "out"],
    "a mapping": ["inspect", RECORDING, "--columns", "pipe.toml", "-o", "out"],
    "a sweep": ["sweep", "pipe", "-o", "out"],
    "a target": ["design", RECORDED, "pipe", "-o", "out"],
    "an export": ["export", "pipe", "--to", "dxf", "-o", "out"],
}


@pytest.mark.parametrize("case", PIPED)
def test_a_pipe_or_a_device_given_as_a_file_does_not_hang(case, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    os.mkfifo("pipe.toml")
    for name in ("pipe", "/dev/zero"):
        if name == "/dev/zero" and "pipe.toml" in PIPED[case]:
            continue
        outcome = run_gtr(capsys, *(name if part == "pipe" else part for part in PIPED[case]))
        assert outcome.status == 2
        assert "is a pipe or a device, not a file; write what it gives into a file" in outcome.err
    assert not Path("out").exists()


def test_standard_input_without_end(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(text, "LARGEST", 1 << 20)
    with open("/dev/zero") as endless:
        monkeypatch.setattr("sys.stdin", endless)
        outcome = run_gtr(capsys, "inspect", "-", "-o", tmp_path / "out")
    assert outcome.status == 2 and outcome.err.startswith("error: -: has more than")
