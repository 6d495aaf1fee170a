"""`make paper`: everything at once, and the page of the docs, whose numbers it must give again."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.paper.__main__ import paper

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/paper.md"
NUMBER = re.compile(r"[−+]?\d+(?:\.\d+)?(?:·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
LOWERED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def value_of(text: str) -> tuple[float, float]:
    """A printed number, and what its last digit is worth."""
    mantissa, _, power = text.replace("−", "-").partition("·10")
    scale = 10.0 ** int(power.translate(LOWERED)) if power else 1.0
    digits = len(mantissa.partition(".")[2])
    return float(mantissa) * scale, 10.0**-digits * scale


def test_the_numbers_of_a_page_are_read_as_printed():
    assert value_of("−2.60") == (-2.6, 0.01)
    assert value_of("3·10⁻⁸") == pytest.approx((3e-8, 1e-8))
    assert NUMBER.sub("#", "tip −1.5 of +2·10⁻³ N at r1") == "tip # of # N at r#"


@pytest.mark.slow
def test_the_page_of_the_docs_is_what_the_command_writes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert paper.main(["-o", "out"], standalone_mode=False) == 0
    written, kept = ((f / "paper.md").read_text(encoding="utf-8") for f in (tmp_path / "out", ROOT / "docs"))
    assert NUMBER.sub("#", written) == NUMBER.sub("#", kept), "run `make paper` and commit docs/"
    for one, other in zip(NUMBER.findall(written), NUMBER.findall(kept), strict=True):
        (a, unit), (b, _) = value_of(one), value_of(other)
        same = abs(a - b) <= 0.02 * abs(b) + 1.5 * unit or max(abs(a), abs(b)) < 1e-4
        assert same, f"{one} is no longer {other}: run `make paper` and commit docs/"
    facts = json.loads((tmp_path / "out/paper.json").read_text(encoding="utf-8"))
    assert facts["converged"]
    loops = facts["parts"]["The two fabricated manipulators"]["facts"]["loops"]
    assert loops["TD-CM I"]["T_tip_max_N"] == pytest.approx(22.0, abs=0.05)
    assert loops["TD-CM II"]["T_base_switch_release_switch_N"] == pytest.approx(15.0, abs=0.05)
    pictures = {p.name for p in (tmp_path / "out/paper").iterdir()}
    assert pictures == {p.name for p in (ROOT / "docs/paper").iterdir()}
    robots = {p.name for p in (tmp_path / "out/robots").iterdir()}
    assert robots == {p.name for p in (ROOT / "examples/paper").glob("*.toml")}


@pytest.mark.slow
@pytest.mark.parametrize("script", sorted((ROOT / "examples/paper").glob("*.py")), ids=lambda path: path.stem)
def test_example_scripts_run(script, tmp_path):
    done = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert len(done.stdout.splitlines()) >= 3 and not done.stderr
