"""What the commands write for readers: pages of long histories, figures for papers, movies."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import RECORDED, RECORDING, run_gtr

from gtr_jax.examples import SIMULATED

MOST = 5_000_000  # bytes of a page


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: run_gtr(capsys, *arguments)


def played(page: Path):
    """The histories that a page plays."""
    html = page.read_text(encoding="utf-8")
    return [json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', html)]


def columns_of(data):
    return {c["label"]: np.array(c["values"], float) for c in data["columns"]}


def rows_of(path: Path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_two_thousand_samples_with_figures_for_papers(run, tmp_path):
    time = np.linspace(0, 200, 2000)
    T_base = np.interp(time, [0, 30, 50, 60, 90, 110, 140, 200], [1, 30, 5, 25, 45, 2, 35, 1])
    lines = [f"{t:.3f},{T:.4f}" for t, T in zip(time, T_base, strict=True)]
    Path("h.csv").write_text("\n".join(["time_s,T_base_N", *lines]))
    files = ("--figures", "svg", "--figures", "pdf")
    outcome = run("simulate", SIMULATED, "--history", "h.csv", *files, "-o", "out")
    assert outcome.status == 0, outcome.err
    page = tmp_path / "out/report.html"
    assert page.stat().st_size < MOST
    (data,) = played(page)
    rows = rows_of(tmp_path / "out/simulation.csv")
    assert data["numbers"] == list(range(1, 2001)) and data["of"] == len(rows) == 2000
    shown = columns_of(data)
    for label, header, factor in (
        ("T_base", "T_base_N", 1),
        ("T_tip", "T_tip_N", 1),
        ("angle of the tip", "tip_angle_rad", 180 / np.pi),
        ("time", "time_s", 1),
    ):
        recorded = factor * np.array([float(row[header]) for row in rows])
        np.testing.assert_allclose(shown[label], recorded, rtol=1e-4, atol=1e-9)
    # The body ends where the tip of that step lies, within the digits of a place and the splines.
    body = data["body"]
    assert not body["space"] and len(body["steps"]) == len(body["samples"]) <= 202
    for k, step in zip(body["samples"], body["steps"], strict=True):
        tip = [1e3 * float(rows[k][name]) for name in ("tip_x_m", "tip_y_m")]
        np.testing.assert_allclose(np.array(step["place"][-2:]) * body["scale"], tip, atol=0.05)
        assert step["tension"][0][-1] * body["most"] / 1000 == pytest.approx(
            float(rows[k]["T_tip_N"]), abs=0.05
        )
    names = {f"figures/{name}.{ending}" for name in ("loop", "shape", "tension") for ending in ("svg", "pdf")}
    assert names <= set(json.loads((tmp_path / "out/run.json").read_text())["files"])
    assert all((tmp_path / "out" / name).stat().st_size > 5000 for name in names)


def test_a_movie_lies_in_the_run_folder(run, tmp_path):
    outcome = run("simulate", SIMULATED, "--pull", "20", "--steps", "3", "--movie", "m.gif", "-o", "out")
    assert outcome.status == 0, outcome.err
    assert (tmp_path / "out/m.gif").read_bytes().startswith(b"GIF89a")
    assert "m.gif" in json.loads((tmp_path / "out/run.json").read_text())["files"]
    again = run("simulate", SIMULATED, "--pull", "20", "--steps", "3", "--movie", "m.mov", "-o", "out")
    assert again.status == 2 and "--movie m.mov: must end in .gif or .mp4" in again.err
    assert (tmp_path / "out/m.gif").exists(), "an earlier run is left as it was"


def test_a_fit_plays_the_recording_beside_the_model(run, tmp_path):
    lines = RECORDING.read_text().splitlines()
    Path("rec.csv").write_text("\n".join(lines[:101]))
    outcome = run("fit", RECORDED, "rec.csv", "--free", "mu", "--figures", "png", "-o", "out")
    assert outcome.status == 0, outcome.err
    (data,) = played(tmp_path / "out/report.html")
    rows, shown = rows_of(tmp_path / "out/fit.csv"), columns_of(data)
    for label, header in (
        ("T_base, recorded", "T_base_N"),
        ("T_tip, recorded", "T_tip_N"),
        ("T_tip, fitted model", "T_tip_fitted_N"),
        ("simulated − recorded", "residual_N"),
    ):
        recorded = np.array([float(row[header]) for row in rows])
        np.testing.assert_allclose(shown[label], recorded, rtol=1e-4, atol=1e-9)
    (phases,) = data["phases"]
    assert [phases["names"][int(d)] for d in phases["of"]][1:] == [row["phase"] for row in rows][1:]
    assert [chart["title"] for chart in data["charts"]] == [
        "Loop",
        "Tensions",
        "Residual over the recording",
        "Residual over the pull",
    ]
    assert data["charts"][2]["noise"] > 0 and len(data["body"]["steps"]) == 100
    html = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert html.count('<figure class="still">') == 3 and (tmp_path / "out/figures/fit.png").exists()
