"""What README and quick start tell the reader to type is typed, in the order in which it stands there."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from command_line import run_gtr

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "docs/quickstart.md"]
# Shown with files that only the reader has.
ILLUSTRATIVE = ("rig.csv",)
HISTORY = "T_base_N\n0\n15\n30\n20\n"


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and contents of the code blocks of a page."""
    return re.findall(
        r"^```(\w*)\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_page(page, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("GTR_JAX_CACHE", "off")
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
