"""Scoring of the cases that hide two or three effects, and their section of the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from string import Template

import numpy as np

from . import score
from .score import ENOUGH, Scored, holds, quantiles, rate, rows_csv, seconds, table, taken

NOT_YET = """## Two and three effects at once

These cases have not been scored yet; `python -m benchmarks.blind --family combined` does it.
"""
KINDS = {"pair": "≥ 65 %", "triple": "≥ 40 %"}


def read(folder: Path, processes: int = 2) -> list[Scored]:
    """All cases that have an answer."""
    return score.read(folder, processes)


def overview(cases: Sequence[Scored]) -> list[list[str]]:
    """Rows of the main table: what, target, reached."""
    strong = [s for s in cases if s.information > ENOUGH]
    gains = [taken(s.answer, s.key) for s in strong if s.answer.get("held_out")]
    known = [within for s in cases if (within := holds(s, 1)) is not None]
    return [
        ["information > 6", "", rate([s.information > ENOUGH for s in cases])],
        *[
            [
                f"{kind}s named whole or in the set, information > 6",
                target,
                rate([s.covered for s in strong if s.kind == kind]),
            ]
            for kind, target in KINDS.items()
        ],
        [
            "pairs and triples named whole or in the set, every one missed beside the others by more than 6",
            "",
            rate([s.covered for s in strong if s.holds["least_part"] > ENOUGH]),
        ],
        [
            "all or a part of them named and nothing wrong, information > 6",
            "≥ 85 %",
            rate([s.near for s in strong]),
        ],
        [
            "whole or in the set, or a part and nothing wrong, the same",
            "",
            rate([s.covered or s.near for s in strong]),
        ],
        ["confidently wrong, the same", "≤ 5 %", rate([s.wrong for s in strong])],
        [
            "all that is named, or each set of it, holds what is not there, the same",
            "",
            rate([s.all_wrong for s in strong]),
        ],
        [
            "share of what there is to gain on unseen samples that is gained (median; 90 % above), the same",
            "",
            "–" if not gains else f"{np.median(gains):.0%}; {np.quantile(gains, 0.1):.0%}",
        ],
        ["95 % interval of μ holds the truth", "", rate(known)],
        ["time of an answer [s] (median; 90 % below)", "", quantiles(seconds(cases), "{:.0f}; {:.0f}")],
    ]


def verdicts(cases: Sequence[Scored]) -> list[list[str]]:
    """Rows by verdict: how many, and how many of them hold the truth, a part of it, or something else."""
    rows = []
    for verdict in sorted({s.verdict for s in cases}):
        of = [s for s in cases if s.verdict == verdict]
        whole = [s for s in of if s.covered]
        part = [s for s in of if s.near and not s.covered]
        mixed = [s for s in of if s.sets and s not in whole and s not in part and not s.all_wrong]
        counts = (of, whole, part, mixed, [s for s in of if s.all_wrong])
        rows.append([verdict, *(str(len(c)) for c in counts)])
    return rows


def write(cases: Sequence[Scored], folder: Path, seeds: str, drawn: int) -> None:
    """The section, `combined.md`, into a folder, and a line per case into `proof` in it."""
    (folder / "proof").mkdir(parents=True, exist_ok=True)
    (folder / "proof" / "combined-cases.csv").write_text(rows_csv(cases), encoding="utf-8")
    template = Template(Path(__file__).with_name("combined.md").read_text(encoding="utf-8"))
    head = ["verdict", "cases", "whole, or in the set", "a part and nothing wrong"]
    head += ["some sets a part, others wrong", "each holds what is not there"]
    text = template.substitute(
        cases=len(cases),
        drawn=drawn,
        seeds=seeds,
        tools=", ".join(sorted({s.answer["tool"] for s in cases})),
        pairs=sum(s.kind == "pair" for s in cases),
        triples=sum(s.kind == "triple" for s in cases),
        crashed=sum(s.verdict == "crashed" for s in cases),
        overview=table(["what", "target", "reached"], overview(cases)),
        verdicts=table(head, verdicts(cases)),
    )
    (folder / "combined.md").write_text(text, encoding="utf-8")
