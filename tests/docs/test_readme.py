"""What README and quick start tell the reader to type is typed, in the order in which it stands there."""

import re
import runpy
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from command_line import run_gtr

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "docs/quickstart.md"]
GRADIENTS = ROOT / "docs/gradients.md"
TUTORIAL = ROOT / "docs/tutorial.md"
# Shown with files that only the reader has, or with answers that only the reader gives.
ILLUSTRATIVE = ("rig.csv", "init robot.toml")
HISTORY = "T_base_N\n0\n15\n30\n20\n"


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and contents of the code blocks of a page."""
    return re.findall(
        r"^```(\w*)\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )


@pytest.mark.parametrize(
    "page", [pytest.param(p, id=p.name, marks=[pytest.mark.slow] * (p.name == "README.md")) for p in PAGES]
)
def test_page(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "examples", "examples")
    Path("history.csv").write_text(HISTORY)
    ran = 0
    for language, text in blocks(page):
        if language == "python":
            exec(compile(text, page.name, "exec"), {"__name__": "__main__"})
            ran += 1
            continue
        for line in text.splitlines():
            command = shlex.split(line, comments=True)
            if command[:1] == ["gtr"] and not any(name in line for name in ILLUSTRATIVE):
                outcome = run_gtr(capsys, *command[1:])
                assert outcome.status == 0, f"{line}: {outcome.err}"
                ran += 1
    assert ran >= 3


@pytest.mark.slow
def test_gradients_of_your_own(tmp_path, monkeypatch, capsys):
    pytest.importorskip("optax")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "examples", "examples")
    within: dict[str, Any] = {"__name__": "__main__"}
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):  # as a user has it
        for _, text in blocks(GRADIENTS):
            exec(compile(text, GRADIENTS.name, "exec"), within)
    found, area = capsys.readouterr().out.splitlines()
    assert found.startswith("mu = 0.2800, E = 1.2000 MPa")
    step = 1e-4
    rise = float(within["area"](0.2 + step) - within["area"](0.2 - step)) / (2 * step)
    assert abs(float(within["slope"]) / rise - 1) < 1e-3 and rise > 0, area


def said(line: str) -> tuple[str, list[float]]:
    """A line of an answer, its words and its numbers apart."""
    number = re.compile(r"[-−]?\d+(?:\.\d+)?")
    return number.sub("#", line), [float(n.replace("−", "-")) for n in number.findall(line)]


@pytest.mark.slow
def test_tutorial_shows_what_the_commands_print(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "examples", "examples")
    printed: list[str] = []
    compared = 0
    for language, text in blocks(TUTORIAL):
        if language == "":
            outcome = run_gtr(capsys, *shlex.split(text)[1:])
            assert outcome.status == 0
            printed = outcome.out.splitlines()
        elif language == "text":
            for line in text.splitlines():
                words, numbers = said(line)
                same = [numbers_of for found, numbers_of in map(said, printed) if found == words]
                assert same, f"not printed: {line}"
                assert any(n == pytest.approx(numbers, rel=0.02, abs=1e-3) for n in same), line
                compared += 1
        elif language == "python":
            exec(compile(text, "tutorial", "exec"), {"__name__": "__main__"})
    assert compared > 20


@pytest.mark.slow
def test_tutorial_recordings_are_those_of_its_script(tmp_path, monkeypatch):
    folder = ROOT / "examples/rig"
    monkeypatch.setattr(sys, "argv", ["record.py", str(tmp_path)])
    runpy.run_path(str(folder / "record.py"), run_name="__main__")
    for name in ("monday.csv", "tuesday.csv", "oiled.csv"):
        made, kept = (np.loadtxt(d / name, delimiter=",", skiprows=1) for d in (tmp_path, folder))
        np.testing.assert_allclose(made, kept, atol=0.011)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_page_shows_no_other_programs(page):
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))
    for language, text in blocks(page):
        for line in text.splitlines() if language == "" else ():
            command = shlex.split(line, comments=True)
            if command[0] == "make":
                assert command[1] in targets
            else:
                assert command[0] == "gtr" or command[:4] == ["python", "-m", "pip", "install"]
