"""The command where nobody listens, and names that cannot be written down."""

import os
import subprocess
import sys

import pytest
from command_line import RECORDED, RECORDING, run_gtr

pytestmark = pytest.mark.skipif(os.name == "nt", reason="of POSIX shells")


def gtr(redirected, out):
    line = f'exec "$0" -P -m gtr_jax inspect "$1" -o "$2" {redirected}'
    return subprocess.run(
        ["sh", "-c", line, sys.executable, str(RECORDING), str(out)], capture_output=True, text=True
    )


@pytest.mark.parametrize("redirected", [">&-", "<&- >&- 2>&-"])
def test_a_closed_stream_changes_nothing(redirected, tmp_path):
    done = gtr(redirected, tmp_path / "out")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (tmp_path / "out" / "run.json").exists()


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_leaves_changes_nothing(unbuffered, tmp_path):
    command = [sys.executable, "-P", "-m", "gtr_jax", "inspect", str(RECORDING), "-o", str(tmp_path / "out")]
    there, here = os.pipe()
    os.close(there)
    done = subprocess.run(
        command, stdout=here, stderr=subprocess.PIPE, env=os.environ | {"PYTHONUNBUFFERED": unbuffered}
    )
    os.close(here)
    assert (done.returncode, done.stderr) == (0, b"")
    assert (tmp_path / "out" / "run.json").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulate", RECORDED, "--pull", "5", "-o", "out\udcff"],
        ["fit", "robot\udcff.toml", RECORDING, "-o", "out"],
        ["inspect", "recording\udcff.csv", "-o", "out"],
        ["export", RECORDED, "-o", "robot\udcff.dxf"],
    ],
)
def test_a_name_that_cannot_be_written_down_is_refused_at_once(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = run_gtr(capsys, *arguments)
    assert outcome.status == 2 and outcome.out == "" and not list(tmp_path.iterdir())
    assert outcome.err.endswith("this name is not in UTF-8; rename the file or folder\n")
    assert outcome.err.count("\n") == 1


@pytest.mark.parametrize("command", ["inspect", "simulate", "fit", "diagnose", "design", "sweep", "view"])
def test_a_file_that_is_not_there_is_no_fault_of_the_place_for_the_answer(command, capsys, tmp_path):
    given = {
        "inspect": ["nothere.csv"],
        "simulate": ["nothere.toml", "--pull", "5"],
        "fit": [RECORDED, "nothere.csv"],
        "diagnose": [RECORDED, "nothere.csv"],
        "design": [RECORDED, "nothere.toml"],
        "sweep": ["nothere.toml"],
        "view": ["nothere.toml"],
    }[command]
    outcome = run_gtr(capsys, command, *given, "-o", tmp_path / "out")
    assert outcome.status == 2
    assert outcome.err.endswith(": no such file; check the path\n") and outcome.err.count("\n") == 1


@pytest.mark.skipif(
    os.geteuid() == 0 and sys.platform != "linux", reason="needs a place without leave to write"
)
def test_a_place_that_cannot_be_written_is_named_with_the_remedy(capsys):
    outcome = run_gtr(capsys, "inspect", RECORDING, "-o", "/proc/nowhere")
    assert outcome.status == 2 and outcome.err.startswith("error: -o /proc/nowhere: ")
    assert outcome.err.endswith("; choose another place\n")


def test_an_unknown_parameter_is_answered_with_few_names(capsys, tmp_path):
    for name, says in (
        ("F", "known: mu, preload, r1, r2, w1, w2, E, length, "),
        ("lenght", "did you mean 'length'"),
    ):
        outcome = run_gtr(capsys, "fit", RECORDED, RECORDING, "--free", f"mu,{name}", "-o", tmp_path / "out")
        assert (
            outcome.status == 2 and f"parameter '{name}' does not exist on this robot; {says}" in outcome.err
        )
        assert len(outcome.err) < 400
    assert (
        "KIND.NUMBER of a term, which gtr terms KIND lists"
        in run_gtr(capsys, "fit", RECORDED, RECORDING, "--free", "F", "-o", tmp_path / "out").err
    )
