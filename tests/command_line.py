"""Run `gtr` in the tests' own process."""

from pathlib import Path
from typing import NamedTuple

import pytest

from gtr_jax.app.cli import main


class Outcome(NamedTuple):
    """What a command left behind."""

    status: int
    out: str
    err: str


# A recording by another simulator with noise, made with mu = 0.2611 and E = 1.335 MPa, and its robot.
RECORDED, RECORDING = (
    Path(__file__).parent / "data" / "recorded" / name for name in ("robot.toml", "recording.csv")
)


def run_gtr(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> Outcome:
    """Run `gtr` with these arguments; what was printed before is dropped."""
    capsys.readouterr()
    status = main([str(a) for a in arguments])
    printed = capsys.readouterr()
    return Outcome(status, printed.out, printed.err)
