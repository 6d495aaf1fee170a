"""`gtr inspect`: what it writes, what it prints, what it refuses."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from command_line import run_gtr
from rigs import CYCLE, REST, ramps, recorded

from gtr_jax.inspection.cycles import PULL, RELEASED
from gtr_jax.inspection.delay import LEAST_SD
from gtr_jax.inspection.noise import NEARLY_ALL, PIECE
from gtr_jax.inspection.sampling import GAP
from gtr_jax.inspection.slip import OF_NOISE, SLIPS, STEP
from gtr_jax.inspection.still import BAND, OF_RAMP, SAMPLES, SECONDS, SHARE
from gtr_jax.inspection.stuck import CHANCE
from gtr_jax.inspection.zero import NEAR
from gtr_jax.recordings.recording import read_recording, write_recording

ROOT = Path(__file__).parents[2]
GF = 9.80665e-3
RIG = ROOT / "examples" / "rig"


@pytest.fixture(scope="module")
def columns():
    """A recording with a glitch and a gap."""
    found = recorded(*ramps(REST, *CYCLE, *CYCLE, (0.0, 2.0)), step=0.001, jitter=0.05)
    found["T_tip"][700] += 100.0
    kept = (found["time"] < 18.0) | (found["time"] > 18.5)
    return {name: values[kept] for name, values in found.items()}


@pytest.fixture
def recording(tmp_path, columns):
    write_recording(tmp_path / "rig.csv", columns)
    return tmp_path / "rig.csv"


@pytest.fixture
def unnamed(tmp_path, columns):
    """The same as a logger without names writes it: in grams-force, with channels of no use."""
    rng = np.random.default_rng(0)
    n = len(columns["time"])
    idle = rng.normal(0, 0.2, (2, n))
    idle[0, 40] = 1500.0
    table = np.stack(
        [np.arange(n), columns["time"], columns["T_base"] / GF, idle[0], columns["T_tip"] / GF, idle[1]],
        axis=1,
    )
    lines = [",Time,data_0,data_1,data_2,data_3"]
    lines += [",".join([f"{row[0]:.0f}", *(repr(float(v)) for v in row[1:])]) for row in table]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    return tmp_path / "log.csv"


def test_a_run_folder_holds_the_answer(capsys, tmp_path, recording, columns):
    out = tmp_path / "look"
    done = run_gtr(capsys, "inspect", recording, "-o", out)
    assert (done.status, done.err) == (0, "")
    first = done.out.splitlines()[0]
    assert re.search(
        r"No problem found: 2 pulls up to 15 N in 29.8 s at 80 Hz, apparent mu·theta 0\.5", first
    )
    names = {p.name for p in out.iterdir()}
    assert {"inspection.json", "columns.toml", "recording.csv", "report.html", "run.json"} <= names
    assert {"channels.png", "loop.png", "ratio.png", "left-out.png", "steps.png", "rates.png"} <= names
    data = json.loads((out / "inspection.json").read_text())
    assert data["sampling"]["gaps"][0]["start_s"] == pytest.approx(18.0, abs=0.05)
    assert data["masked"][0]["channel"] == "T_tip" and data["masked"][0]["samples"] == 1
    assert "device" not in data["settings"]["versions"]
    page = (out / "report.html").read_text()
    assert page.count("<img") == len([n for n in names if n.endswith(".png")])
    assert "http" not in page.replace("http-equiv", "") and "The robot, with every" not in page
    for finding in data["findings"]:
        assert finding["severity"] in ("problem", "note", "fine")
        assert f"{finding['severity']}: {finding['says']}" in done.out
    cleaned = read_recording(out / "recording.csv")
    assert len(cleaned) == len(columns["time"]) - 1 and not cleaned.masked


def test_columns_that_no_header_names_are_guessed_and_can_be_used(capsys, tmp_path, unnamed, columns):
    out = tmp_path / "look"
    done = run_gtr(capsys, "inspect", unnamed, "-o", out)
    assert done.status == 0
    assert f"guessed: confirm them in {out / 'columns.toml'}" in done.out.splitlines()[0]
    assert "T_base is guessed to be column 'data_0' in gf" in done.out
    assert re.search(r"would be 15\d\d N in N and 1\.5\d? N in mN", done.out)
    mapping = tomllib.loads((out / "columns.toml").read_text())
    assert mapping["columns"] == {"time": "Time [s]", "T_base": "data_0 [gf]", "T_tip": "data_2 [gf]"}
    read = read_recording(unnamed, out / "columns.toml")
    assert read.T_base[-1] == pytest.approx(columns["T_base"][-1], abs=1e-9)
    assert "Confirm in columns.toml" in (out / "report.html").read_text()
    again = run_gtr(capsys, "inspect", unnamed, "--columns", out / "columns.toml", "-o", tmp_path / "again")
    assert again.status == 0 and "guessed" not in again.out
    assert tomllib.loads((tmp_path / "again/columns.toml").read_text()) == mapping


def test_the_user_knows_better(capsys, tmp_path, unnamed):
    said = "T_base=data_0[mN],T_tip=data_2[mN]"
    done = run_gtr(
        capsys,
        "inspect",
        unnamed,
        "--columns",
        said,
        "--keep-glitches",
        "--drop",
        "18:19",
        "-o",
        tmp_path / "look",
    )
    assert done.status == 0 and "guessed" not in done.out
    mapping = tomllib.loads((tmp_path / "look/columns.toml").read_text())
    assert mapping["columns"]["T_base"] == "data_0 [mN]"
    assert mapping["clean"] == {"keep_glitches": True, "drop": ["18:19"]}
    data = json.loads((tmp_path / "look/inspection.json").read_text())
    assert data["tip"]["highest_N"] > 10.0 and {m["kind"] for m in data["masked"]} == {"dropped"}


def test_several_recordings_have_a_section_each(capsys, tmp_path):
    out = tmp_path / "look"
    done = run_gtr(capsys, "inspect", RIG / "monday.csv", RIG / "tuesday.csv", "-o", out)
    assert done.status == 0
    assert "monday: No problem found: 3 pulls" in done.out and "tuesday: No problem found" in done.out
    data = json.loads((out / "inspection.json").read_text())
    assert list(data["recordings"]) == ["monday", "tuesday"]
    names = {p.name for p in out.iterdir()}
    assert {
        "columns-monday.toml",
        "columns-tuesday.toml",
        "recording-monday.csv",
        "loop-tuesday.png",
    } <= names
    page = (out / "report.html").read_text()
    assert '<h1 class="part">monday</h1>' in page and "no problem found in any" in page
    pose = [n for n in data["recordings"]["tuesday"]["needs"] if "stiffness" in n["question"]]
    assert pose[0]["there"] and "tip_angle, displacement" in pose[0]["says"]


def test_recordings_of_one_name_are_numbered(capsys, tmp_path, recording):
    (tmp_path / "b").mkdir()
    (tmp_path / "b/rig.csv").write_bytes(recording.read_bytes())
    done = run_gtr(capsys, "inspect", recording, tmp_path / "b/rig.csv", "-o", tmp_path / "look")
    assert done.status == 0
    assert {"columns-rig-1.toml", "columns-rig-2.toml"} <= {p.name for p in (tmp_path / "look").iterdir()}


def test_doubtful_recordings_are_inspected_rather_than_refused(capsys, tmp_path, columns):
    swapped = columns | {"T_base": columns["T_tip"], "T_tip": columns["T_base"]}
    write_recording(tmp_path / "swapped.csv", swapped)
    done = run_gtr(capsys, "inspect", tmp_path / "swapped.csv", "-o", tmp_path / "a")
    assert done.status == 0 and "it is the tip that leads" in done.out
    time = columns["time"].copy()
    time[200] -= 1.0
    write_recording(tmp_path / "back.csv", columns | {"time": time})
    done = run_gtr(capsys, "inspect", tmp_path / "back.csv", "-o", tmp_path / "b")
    assert done.status == 0 and "stamps run backwards 1 time" in done.out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b,c\n1,2,x\n2,1,y\n3,5,z\n", "no column T_base_N; columns found: a, b, c"),
        ("time_s,T_base_N\n" + "".join(f"{i},{i % 7}\n" for i in range(40)), "no column T_tip_N"),
        ("T_base_N,T_tip_N\n" + "1,1\n" * 5, "has 5 samples"),
        ("T_base_N,T_tip_N\n" + "1,1\n" * 50, "throughout"),
        ("base [V],tip [V]\n" + "".join(f"{i % 9},{i % 9 / 2}\n" for i in range(40)), "a voltage, no force"),
        ("T_base_N,T_tip_N\n" + "1,x\n" * 50, "row 2"),
        ("", "empty"),
    ],
)
def test_bad_input_ends_in_one_line(capsys, tmp_path, text, message):
    (tmp_path / "bad.csv").write_text(text)
    done = run_gtr(capsys, "inspect", tmp_path / "bad.csv", "-o", tmp_path / "look")
    assert done.status == 2 and not (tmp_path / "look").exists()
    (line,) = done.err.splitlines()
    assert line.startswith(f"error: {tmp_path / 'bad.csv'}") and message in line


def test_the_command_needs_no_jax(recording, tmp_path):
    code = (
        "import sys; from gtr_jax.app.cli import main;"
        f"status = main(['inspect', {str(recording)!r}, '-o', {str(tmp_path / 'look')!r}]);"
        "print(status, sorted({'jax', 'equinox', 'scipy.signal', 'pandas'} & {*sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "0 []"


def test_the_page_shows_what_the_command_prints(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs/inspect.md").read_text(encoding="utf-8")
    shown = re.search(r"```text\n(.*?)```", page, re.DOTALL)
    assert shown is not None
    done = run_gtr(capsys, "inspect", "examples/rig/monday.csv", "-o", tmp_path / "look")
    assert done.out.replace(str(tmp_path / "look"), "out/look") == shown[1]


def test_the_page_names_the_thresholds_of_the_code():
    page = (ROOT / "docs/inspect.md").read_text(encoding="utf-8")
    for said in (
        f"longer than {GAP:g} median steps",
        f"at least {100 * NEARLY_ALL:g} % of the small differences",
        f"within {BAND:g} standard deviations of its noise (at least {100 * SHARE:g} % of its range) "
        f"for {SECONDS:g} s, {SAMPLES} samples and {100 * OF_RAMP:g} % of the longest ramp",
        f"straight line over {PIECE} samples",
        f"within {100 * NEAR:g} % of their least reading",
        f"once in {1 / CHANCE:,.0f} recordings",
        f"by {100 * STEP:g} % of its range or {OF_NOISE:g} standard deviations",
        f"exceeds {SLIPS:g} times T_tip/T_base",
        f"by {100 * PULL:g} % of the range; an inner loop if it starts above {100 * RELEASED:g} %",
        f"least {LEAST_SD:g} of a sampling step",
    ):
        assert said in " ".join(page.split()), said


def test_the_report_goes_through_the_recording(recording, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    others = tmp_path / "again.csv"
    others.write_bytes(recording.read_bytes())
    assert run_gtr(capsys, "inspect", recording, others, "-o", "out").status == 0
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "<h2>rig</h2>" in page and "<h2>again</h2>" in page
    one, other = (json.loads(t) for t in re.findall(r'<script type="application/json">(.*?)</script>', page))
    assert one == other
    read = read_recording(recording)
    assert read.T_tip is not None and read.time is not None
    assert one["of"] == len(read) and len(one["numbers"]) <= 4100
    kept = np.asarray(one["numbers"]) - 1
    shown = {c["label"]: np.asarray(c["values"], float) for c in one["columns"]}
    for label, values in (("T_base", read.T_base), ("T_tip", read.T_tip), ("time", read.time)):
        np.testing.assert_allclose(shown[label], values[kept], rtol=1e-5, atol=1e-9)
    assert np.max(shown["T_base"]) == pytest.approx(np.max(read.T_base), rel=1e-5)
    spans = {span["label"]: span for span in one["charts"][0]["spans"]}
    assert spans["gap"]["start"] == pytest.approx(18.0, abs=0.02)
    assert spans["gap"]["end"] == pytest.approx(18.5, abs=0.02)
    assert set(one["phases"][0]["names"]) >= {"pulling", "releasing", "transition"}
