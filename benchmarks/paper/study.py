"""What a study of the paper leaves: numbers, the paper beside ours, figures and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gtr_jax.report.page import Figure, Table

FITTED = "fitted"
ROBOTS = Path(__file__).parents[2] / "examples/paper"  # the robot files of the paper


@dataclass(frozen=True)
class Statement:
    """A claim, what the simulator gives, and whether they agree: FITTED where parameters were chosen so that
    they do, None where nothing is tested. The claim is the paper's, or goes beyond it.
    """

    claim: str
    ours: str
    agrees: bool | str | None
    beyond: bool = False


def beyond(claim: str, ours: str, agrees: bool) -> Statement:
    """A claim that the paper does not make."""
    return Statement(claim, ours, agrees, beyond=True)


@dataclass(frozen=True)
class Study:
    """One part of the reproduction.

    Attributes:
        title: heading.
        text: paragraphs before the evidence; every number in them is computed in this run.
        statements: the paper beside ours.
        figures, tables: in this order.
        facts: every number behind them, SI with units in the keys, for `paper.json`.
        solved: how many of the equilibria, load steps and fits behind it converged, and of how many.
        robots: robot files worth keeping, as TOML text by file name.
    """

    title: str
    text: Sequence[str]
    solved: tuple[int, int]
    statements: Sequence[Statement] = ()
    figures: Sequence[Figure] = ()
    tables: Sequence[Table] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    robots: Mapping[str, str] = field(default_factory=dict)
