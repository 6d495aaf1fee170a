"""The pages as the forge shows them: whole, and true of today's files, commands, links and thresholds."""

import importlib
import re
import shlex
import shutil
import tomllib
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from command_line import run_gtr
from test_readme import said

from benchmarks import inclusions
from gtr_jax import load_config
from gtr_jax.app.cli import cli

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
# Written by mkdocs from the docstrings.
FILLED_BY_MKDOCS = {DOCS / "api.md"}


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(text: str) -> list[tuple[str, str]]:
    """Language and contents of the code blocks of a page."""
    return re.findall(r"^```(\w*)\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def outside_blocks(text: str) -> str:
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


# What is written into pages from files


def test_an_inclusion_is_written_between_its_marks(tmp_path):
    (tmp_path / "table.md").write_text("# Its own title\n\n| a |\n|---|\n| 1 |\n")
    (tmp_path / "robot.toml").write_text('name = "rig"\n')
    page = "x\n<!-- begin table.md -->\nold\n<!-- end -->\ny\n<!-- begin robot.toml -->\n<!-- end -->\n"
    filled = inclusions.filled(page, tmp_path)
    assert "x\n<!-- begin table.md -->\n\n| a |\n|---|\n| 1 |\n\n<!-- end -->\ny\n" in filled
    assert '\n```toml\nname = "rig"\n```\n' in filled
    assert "old" not in filled and "Its own title" not in filled
    assert inclusions.filled(filled, tmp_path) == filled
    with pytest.raises(ValueError, match=r"begin nowhere\.md.*no such file"):
        inclusions.filled("<!-- begin nowhere.md -->\n<!-- end -->\n", tmp_path)
    with pytest.raises(ValueError, match=r"begin table\.md.*no end"):
        inclusions.filled("<!-- begin table.md -->\n", tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_what_a_page_shows_of_a_file_is_what_the_file_holds(page):
    text = page.read_text(encoding="utf-8")
    assert inclusions.filled(text, ROOT) == text, "run `python -m benchmarks.page` and commit docs/"


def test_every_result_stands_in_a_page():
    shown = {path for page in PAGES for path in inclusions.included(page.read_text(encoding="utf-8"))}
    written = {p.relative_to(ROOT).as_posix() for p in (ROOT / "benchmarks/results").glob("*.md")}
    assert written <= shown
    assert {"examples/tdcm-1-target.toml", "examples/tdcm-1-sweep.toml"} <= shown


@pytest.mark.parametrize("page", [p for p in PAGES if p not in FILLED_BY_MKDOCS], ids=name_of)
def test_nothing_on_a_page_waits_for_mkdocs(page):
    text = page.read_text(encoding="utf-8")
    assert "--8<--" not in text
    assert not re.search(r'^\s*(:::|!!!|\?\?\?|=== ")', outside_blocks(text), flags=re.MULTILINE)


# What pages say of commands, files and modules


def commands_of(page: Path) -> list[list[str]]:
    """Words of every `gtr` command that a page shows in a block."""
    found = []
    for language, text in blocks(page.read_text(encoding="utf-8")):
        if language not in ("", "bash"):
            continue
        for part in re.split(r"\n|&&", text):
            words = shlex.split(part, comments=True)
            if words[:1] == ["gtr"]:
                found.append(words[1:])
    return found


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_shown_are_commands_there_are(page):
    for words in commands_of(page):
        command = cli.commands[words[0]]
        context = command.make_context(words[0], [], resilient_parsing=True)
        command.make_parser(context).parse_args(list(words[1:]))


def test_commands_are_found_on_the_pages():
    shown = {words[0] for page in PAGES for words in commands_of(page)}
    assert {"simulate", "fit", "diagnose", "design", "sweep"} <= shown


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_options_files_and_modules_named_are_there(page):
    known = {o for command in cli.commands.values() for p in command.params for o in p.opts}
    programs = [*(ROOT / "benchmarks").rglob("*.py"), ROOT / "gtr_jax/report/terms.py"]
    known |= {o for file in programs for o in re.findall(r'"(--[a-z-]+)"', file.read_text(encoding="utf-8"))}
    for code in re.findall(r"`([^`\n]+)`", outside_blocks(page.read_text(encoding="utf-8"))):
        first = code.split()[0]
        if first.startswith("--"):
            assert first in known, code
        if re.fullmatch(r"(examples|tests|benchmarks|docs|gtr_jax|calibrate|design)/[\w./-]+", first):
            assert (ROOT / first).exists(), code
        if code.startswith("python -m ") and code.split()[2].partition(".")[0] in ("benchmarks", "gtr_jax"):
            module = ROOT / code.split()[2].replace(".", "/")
            assert module.with_suffix(".py").is_file() or (module / "__main__.py").is_file(), code


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", outside_blocks(page.read_text(encoding="utf-8"))):
        path = unquote(target.partition("#")[0])
        if path and "://" not in path:
            assert (page.parent / path).is_file(), target


def test_home_names_every_command_and_page():
    home = (DOCS / "index.md").read_text(encoding="utf-8")
    for name in cli.commands:
        assert f"`gtr {name}`" in home
    pages = re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert {p.relative_to(DOCS).as_posix() for p in DOCS.glob("*.md")} <= set(pages)
    for name in set(pages) - {"index.md"}:
        assert f"]({name})" in home, name


def test_the_robot_of_the_tutorial_is_that_of_the_example():
    language, shown = blocks((DOCS / "tutorial.md").read_text(encoding="utf-8"))[0]
    assert language == "toml"
    whole = tomllib.loads((ROOT / "examples/rig/robot.toml").read_text(encoding="utf-8"))
    for section, entries in tomllib.loads(shown).items():
        assert entries.items() <= whole[section].items()


def test_the_robot_file_of_the_docs_is_one(tmp_path):
    shown = dict(reversed(blocks((DOCS / "files.md").read_text(encoding="utf-8"))))["toml"]
    (tmp_path / "robot.toml").write_text(shown, encoding="utf-8")
    assert load_config(tmp_path / "robot.toml").name == "tdcm-1"


# What the page of the diagnosis says of its thresholds and of the benchmark

THRESHOLD = re.compile(r"^\| `(\w+)\.(\w+)(?:\[(\d)\])?`[^|]*\| ([^|]+) \|", flags=re.MULTILINE)


def test_thresholds_of_the_diagnosis_are_those_of_the_code():
    page = (DOCS / "diagnosis.md").read_text(encoding="utf-8").partition("## How it works")[2]
    stated = THRESHOLD.findall(page)
    assert len(stated) > 30
    for module, name, place, value in stated:
        package = "gtr_jax.recordings.base_tension" if module == "noise" else "calibrate.diagnosis"
        there = getattr(importlib.import_module(f"{package}.{module}"), name)
        there = there[int(place)] if place else there
        said = 1e-4 if value == "10⁻⁴" else float(value)
        assert said == there, f"{module}.{name}"


def test_counts_on_the_page_of_the_diagnosis_are_those_of_the_benchmark():
    page = (DOCS / "diagnosis.md").read_text(encoding="utf-8").partition("## How often it is right")[2]
    proof = (DOCS / "proof.md").read_text(encoding="utf-8")
    counts = re.findall(r"(\d+) of (\d+)", page.partition("What it misses")[0])
    assert len(counts) >= 6
    for right, of in counts:
        assert f"({right}/{of};" in proof, f"{right} of {of}"


PLUS_MINUS = re.compile(r" ± [\d.e+-]+")


@pytest.mark.slow
def test_the_page_of_the_diagnosis_shows_what_the_command_prints(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for folder in ("examples", "gtr_jax/examples"):
        shutil.copytree(ROOT / folder, folder)
    printed: list[str] = []
    compared = 0
    for language, text in blocks((DOCS / "diagnosis.md").read_text(encoding="utf-8")):
        if language == "" and " robot.toml " not in text:
            outcome = run_gtr(capsys, *shlex.split(text)[1:])
            assert outcome.status == 0, outcome.err
            printed = outcome.out.splitlines()
        elif language == "text":
            # What is printed in one line is broken on the page, and goes on behind a space.
            for line in text.replace("\n  ", " ").splitlines():
                words, numbers = said(PLUS_MINUS.sub("", line))
                close = [
                    np.allclose(found, numbers, rtol=0.05, atol=2e-3)
                    for there, found in (said(PLUS_MINUS.sub("", p)) for p in printed)
                    if there == words
                ]
                assert any(close), f"not printed: {line}\n" + "\n".join(printed)
                compared += 1
    assert compared >= 5


def test_the_files_that_the_map_names_are_there():
    files = [
        f"/{path.relative_to(ROOT)}"
        for f in ("gtr_jax", "calibrate", "design", "benchmarks")
        for path in (ROOT / f).rglob("*.py")
    ]
    named = set(re.findall(r"`([\w/]+\.py)`", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")))
    named -= {"utils.py", "tests/test_imports.py"}
    assert not [name for name in named if not any(file.endswith(f"/{name}") for file in files)]
