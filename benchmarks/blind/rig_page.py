"""The section of the page on cases that are made as rigs make recordings, and its figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from string import Template

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from . import rig_score, score
from .rig_score import Rig
from .score import table

OUTCOMES = (("named", "#1b7837"), ("left, and said so", "#bdbdbd"), ("left unsaid", "#fdb863"))
NOT_YET = """## Recordings as rigs make them

These cases have not been scored yet; `python -m benchmarks.blind --family rig` does it.
"""


def outcome(case: Rig, effect: str) -> str:
    """Which of `OUTCOMES` becomes of an effect that is there."""
    if rig_score.term_of(case, effect) <= case.named:
        return "named"
    return "left, and said so" if case.verdict in ("partly-explained", "unexplained") else "left unsaid"


def effects_figure(cases: Sequence[Rig], path: Path) -> None:
    """What becomes of each effect."""
    effects = sorted({h for c in cases for h in c.key["hidden"]})
    figure, axes = plt.subplots(figsize=(8, 0.24 * len(effects) + 1.2), layout="constrained")
    for k, effect in enumerate(effects):
        of, start = [c for c in cases if effect in c.key["hidden"]], 0.0
        for what, colour in OUTCOMES:
            share = float(np.mean([outcome(c, effect) == what for c in of]))
            axes.barh(k, share, left=start, color=colour, height=0.8, label=what if k == 0 else None)
            start += share
        axes.text(1.01, k, str(len(of)), va="center", fontsize=7)
    axes.set(yticks=range(len(effects)), xlim=(0, 1.06))
    axes.set_xlabel("share of the cases that have it (their number at the right)")
    axes.set_yticklabels(effects, fontsize=8)
    axes.set_ylim(len(effects) - 0.4, -0.6)
    axes.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.45, 1.0), frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def write(cases: Sequence[Rig], folder: Path, seeds: str, drawn: int) -> None:
    """The section, `rig.md`, into a folder, its figure and a line per case into `proof` in it."""
    figures = folder / "proof"
    figures.mkdir(parents=True, exist_ok=True)
    effects_figure(cases, figures / "rig-effects.png")
    (figures / "rig-cases.csv").write_text(rig_score.rows_csv(cases), encoding="utf-8")
    samples = [len(c.key["clean"]["T_tip"]) for c in cases]
    rigs = [c for c in cases if c.key["kind"] == "rig"]
    seconds = score.seconds(cases)
    template = Template(Path(__file__).with_name("rig.md").read_text(encoding="utf-8"))
    text = template.substitute(
        cases=len(cases),
        drawn=drawn,
        seeds=seeds,
        tools=", ".join(sorted({c.answer["tool"] for c in cases})),
        sound=len(cases) - len(rigs),
        rigs=len(rigs),
        strange=sum(bool(c.key["outside"]) for c in rigs),
        eventful=sum(bool(c.key["events"]) for c in cases),
        events=sum(len(c.key["events"]) for c in cases),
        sheaths=sum(c.key["robot"] == "sheath" for c in cases),
        fewest=min(samples),
        most=max(samples),
        spoilt=sum(len(c.spoilt()) for c in cases),
        overview=table(["what", "target", "reached"], rig_score.overview(cases)),
        by_stratum=table(
            ["stratum", "cases", "detected", "precision", "recall", "confidently wrong"],
            rig_score.by_stratum(cases),
        ),
        by_effect=table(
            [
                "hidden",
                "term",
                "cases",
                "moves the cells by (median)",
                "named",
                "named where it is not there",
            ],
            rig_score.by_effect(cases),
        ),
        refused=sum(c.verdict == "refused" for c in cases),
        crashed=sum(c.verdict == "crashed" for c in cases),
        seconds=f"{np.median(seconds):.0f}" if seconds else "–",
        seconds_most=f"{np.max(seconds):.0f}" if seconds else "–",
    )
    (folder / "rig.md").write_text(text, encoding="utf-8")
