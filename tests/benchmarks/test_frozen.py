"""What `benchmarks.frozen` says of two folders of answers, and that its cases read files that are there."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.frozen import compare
from benchmarks.frozen.__main__ import BEFORE, NOW, main, report
from benchmarks.frozen.cases import PARTS, Case

ROOT = Path(__file__).parents[2]
FIT = {"mu": 0.3, "curve": [0.0, 10.0], "says": "of 45 N, 21 N are left", "seconds": 4.0, "converged": True}
TABLE = "time_s,T_tip_N,phase\n0,1.5,pulling\n1,40,pulling\n"
DRAWING = "  0\nLINE\n 10\n1.25\n$TDCREATE\n 40\n2461374.71348\n"


@pytest.fixture
def answers(tmp_path):
    """The same answers before and now, and a function that changes a file of those now."""
    files = {"fit.json": json.dumps(FIT), "fit.csv": TABLE, "robot.dxf": DRAWING, "said.txt": "One.\nTwo.\n"}
    for run in (BEFORE, NOW):
        folder = tmp_path / run / "fit.made-up"
        folder.mkdir(parents=True)
        roots = {str(tmp_path / run): "ANSWERS"}
        (folder / "case.json").write_text(json.dumps({"digest": "", "exit": 0, "cpu": 1.0, "roots": roots}))
        for name, text in files.items():
            (folder / name).write_text(text)
        (folder / "report.txt").write_text(f"report: {folder}/report.html\n")
        np.save(folder / "T_tip.npy", np.array([1.0, np.nan]))

    def change(name, old, new):
        path = tmp_path / NOW / "fit.made-up" / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    return tmp_path, change


def differences(folder):
    return compare.folders(folder / BEFORE / "fit.made-up", folder / NOW / "fit.made-up")


def test_times_and_paths_are_left_out(answers):
    folder, change = answers
    change("fit.json", '"seconds": 4.0', '"seconds": 5.0')
    change("robot.dxf", "2461374.71348", "2461375.5")
    assert differences(folder) == []


@pytest.mark.parametrize(
    ("name", "old", "new", "where", "absolute", "relative"),
    [
        ("fit.json", "0.3", "0.33", "fit.json mu", 0.03, 0.1 / 1.1),
        ("fit.json", "[0.0, 10.0]", "[0.1, 10.0]", "fit.json curve", 0.1, 0.01),
        ("fit.json", "21 N", "20 N", "fit.json says line 1", 1.0, 1 / 21),
        ("fit.json", "true", "false", "fit.json converged", 1.0, 1.0),
        ("fit.json", "[0.0, 10.0]", "[0.0]", "fit.json curve", np.inf, np.inf),
        ("fit.csv", "1.5", "1.9", "fit.csv T_tip_N", 0.4, 0.01),
        ("fit.csv", "1.5", "nan", "fit.csv T_tip_N", np.inf, np.inf),
        ("robot.dxf", "1.25", "1.2", "robot.dxf line 4", 0.05, 0.04),
    ],
)
def test_a_changed_number(answers, name, old, new, where, absolute, relative):
    folder, change = answers
    change(name, old, new)
    (found,) = differences(folder)
    assert (found.where, found.kind) == (where, "number")
    assert (found.absolute, found.relative) == pytest.approx((absolute, relative))


def test_changed_words_are_no_changed_answer(answers, capsys):
    folder, change = answers
    change("fit.csv", "1,40,pulling", "1,40,holding")
    change("said.txt", "Two.", "Three.")
    assert [c.kind for c in differences(folder)] == ["words", "words"]
    assert report([Case("fit.made-up", ())], folder)
    assert (
        "only words changed: fit.csv phase: 'pulling', now 'holding', and 1 more" in capsys.readouterr().out
    )


def test_rounding_is_told_apart(answers, capsys):
    folder, change = answers
    change("fit.csv", "40", "40.00000001")
    assert report([Case("fit.made-up", ())], folder)
    assert "the same but for rounding: fit.csv T_tip_N: by 1e-08" in capsys.readouterr().out
    change("fit.csv", "40.00000001", "40.0000001")
    assert not report([Case("fit.made-up", ())], folder)


def test_what_is_missing(answers, capsys):
    folder, change = answers
    change("fit.json", '"mu"', '"friction"')
    (folder / NOW / "fit.made-up/T_tip.npy").unlink()
    found = differences(folder)
    assert [(c.where, c.kind) for c in found] == [
        ("T_tip.npy", "missing"),
        ("fit.json mu", "missing"),
        ("fit.json friction", "words"),
    ]
    assert not report([Case("fit.made-up", ()), Case("fit.other", ())], folder)
    assert "fit.other: missing: no answer was kept of it" in capsys.readouterr().out


def test_without_answers_it_says_how_to_make_them(tmp_path, capsys):
    assert main(["--check", "--answers", str(tmp_path / "none")]) == 2
    assert "--write quick" in capsys.readouterr().err


@pytest.mark.parametrize("part", PARTS)
def test_cases_have_names_of_their_own_and_read_files_that_are_there(part):
    cases = PARTS[part](ROOT, None)
    assert len({case.name for case in cases}) == len(cases)
    files = {a for case in cases for a in case.arguments if a.startswith(("examples/", "tests/"))}
    assert [name for name in sorted(files) if not (ROOT / name).exists()] == []
