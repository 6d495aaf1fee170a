"""The page of the docs that reports the blind benchmark, and its figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

import matplotlib

matplotlib.use("Agg")
import itertools

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

from . import score
from .score import Scored, table

OUTCOMES = (
    ("right", "#1b7837"),
    ("in the set", "#a6dba0"),
    ("unexplained", "#bdbdbd"),
    ("called adequate", "#fdb863"),
    ("wrong", "#b2182b"),
)


def outcome(s: Scored) -> str:
    """Which of `OUTCOMES`; right is to name what is missing and nothing else, to call a sound recording
    adequate, and to call what lies outside the catalogue unexplained or to find its law.
    """
    if s.law is not None:
        return "wrong" if s.wrong_law else "right"
    expected = {"sound": "adequate", "outside": "unexplained"}.get(s.kind)
    if s.verdict == expected or (expected is None and s.exact):
        return "right"
    if s.covered:
        return "in the set"
    if s.verdict == "unexplained":
        return "unexplained"
    return "called adequate" if s.verdict == "adequate" else "wrong"


def effects_figure(scored: Sequence[Scored], path: Path) -> None:
    """What becomes of each effect."""
    rows = []
    for kind in ("single", "outside"):
        for effect in sorted({s.key["hidden"][0] for s in scored if s.kind == kind}):
            of = [s for s in scored if s.kind == kind and s.key["hidden"] == [effect]]
            rows.append((effect + (" (outside)" if kind == "outside" else ""), of))
    sound = [s for s in scored if s.kind == "sound"]
    rows.append(("nothing missing", sound))
    figure, axes = plt.subplots(figsize=(8, 0.24 * len(rows) + 1.2), layout="constrained")
    for k, (_name, of) in enumerate(rows):
        start = 0.0
        for what, colour in OUTCOMES:
            share = np.mean([outcome(s) == what for s in of])
            axes.barh(k, share, left=start, color=colour, height=0.8, label=what if k == 0 else None)
            start += share
        axes.text(1.01, k, str(len(of)), va="center", fontsize=7)
    axes.set(yticks=range(len(rows)), xlim=(0, 1.06), xlabel="share of the cases (their number at the right)")
    axes.set_yticklabels([name for name, _ in rows], fontsize=8)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.legend(ncols=5, loc="lower center", bbox_to_anchor=(0.45, 1.0), frameon=False, fontsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def information_figure(scored: Sequence[Scored], path: Path) -> None:
    """Detection and naming of single effects against what they leave."""
    single = [s for s in scored if s.kind == "single"]
    edges = np.asarray([0, 3, 6, 12, 25, 60, 1e9])
    figure, axes = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    shown = (
        ("anything missing", lambda s: s.claims, "#2166ac", "o"),
        ("named exactly", lambda s: s.exact, "#1b7837", "s"),
        ("named or in the set", lambda s: s.covered, "#7fbf7b", "^"),
        ("confidently wrong", lambda s: s.wrong, "#b2182b", "v"),
    )
    at = np.arange(len(edges) - 1)
    for k, (name, hit, colour, marker) in enumerate(shown):
        x, y, low, high = [], [], [], []
        for b in at:
            of = [hit(s) for s in single if edges[b] <= s.information < edges[b + 1]]
            if of:
                interval = stats.binomtest(int(np.sum(of)), len(of)).proportion_ci(method="exact")
                x.append(b + 0.08 * (k - 1.5))
                y.append(np.mean(of))
                low.append(np.mean(of) - interval.low)
                high.append(interval.high - np.mean(of))
        axes.errorbar(x, y, [low, high], color=colour, marker=marker, capsize=2, lw=1, label=name)
    labels = [f"{a:g}–{b:g}" if b < 1e6 else f"> {a:g}" for a, b in itertools.pairwise(edges)]
    axes.set(xticks=at, ylim=(-0.03, 1.03), ylabel="share of single effects")
    axes.set_xticklabels(labels)
    axes.set_xlabel("information left after refitting: root of the sum of squares, in noise variances")
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def reliability_figure(scored: Sequence[Scored], path: Path) -> None:
    """Whether probabilities are what they say."""
    points = score.reliability(scored)
    figure, axes = plt.subplots(figsize=(4, 3.8), layout="constrained")
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    for k, (said, right, n) in enumerate(points):
        interval = stats.binomtest(round(right * n), n).proportion_ci(method="exact")
        error = [[right - interval.low], [interval.high - right]]
        axes.errorbar(said, right, error, color="#2166ac", marker="o", capsize=2)
        axes.annotate(
            f"n = {n}",
            (said, right),
            (-6, 6 - 16 * (k % 2)),
            textcoords="offset points",
            ha="right",
            fontsize=7,
        )
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), aspect="equal")
    axes.set(xlabel="probability of the most probable model", ylabel="share of cases in which it is true")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def write(
    scored: Sequence[Scored],
    labels: Sequence[str] | None,
    page: Path,
    seeds: str,
    drawn: int,
    sections: Mapping[str, str],
) -> None:
    """The page, its figures in a folder beside it of the same name, and a line per case. `sections` are those
    on the other families: `rig`, `left_out` and `combined`.
    """
    figures = page.with_suffix("")
    figures.mkdir(parents=True, exist_ok=True)
    effects_figure(scored, figures / "effects.png")
    information_figure(scored, figures / "information.png")
    reliability_figure(scored, figures / "reliability.png")
    (figures / "cases.csv").write_text(score.rows_csv(scored), encoding="utf-8")
    counts = {
        kind: sum(s.kind == kind for s in scored) for kind in ("sound", "single", "pair", "triple", "outside")
    }
    sound = [s for s in scored if s.kind == "sound"]
    off = [s.holds["refit_rms_N"] for s in sound]
    noise = [s.holds["refit_rms_N"] / s.holds["noise_N"] for s in sound]
    seconds = score.seconds(scored)
    tools = sorted({s.answer["tool"] for s in scored})
    crashed = sum(s.verdict == "crashed" for s in scored)
    head = ["", "false alarms", "detected, information > 6", "single named exactly, information > 6"]
    head += ["confidently wrong", "outside called unexplained or found as a law, information > 6"]
    effect_head = ["hidden", "term", "information > 6", "information (median)", "concealment (median)"]
    effect_head += ["its own law leaves (median)", "named", "in the set", "unexplained", "a law", "adequate"]
    effect_head += ["wrong", "not in the set"]
    stratum_head = ["stratum", "cases", "anything missing", "named exactly"]
    stratum_head += ["among the three most probable", "confidently wrong"]
    template = Template(Path(__file__).with_name("page.md").read_text(encoding="utf-8"))
    text = template.substitute(
        counts,
        cases=len(scored),
        effects=len({s.key["hidden"][0] for s in scored if s.kind == "single"}),
        seeds=seeds,
        tools=", ".join(tools),
        off=f"{1e3 * np.median(off):.1f}",
        off_most=f"{1e3 * np.max(off):.0f}",
        share=f"{100 * np.median(noise):.0f}",
        share_most=f"{100 * np.max(noise):.0f}",
        overview=table(["what", "target", "reached"], score.overview(scored)),
        baselines=table(head, score.baselines(scored, labels)),
        by_effect=table(effect_head, score.per_effect(scored)),
        located=score.located(scored),
        by_stratum=table(stratum_head, score.by_stratum(scored)),
        seconds=f"{np.median(seconds):.0f}",
        seconds_most=f"{np.max(seconds):.0f}",
        crashed=crashed,
        drawn=drawn,
        **sections,
        unanswered=(
            ""
            if drawn == len(scored)
            else f" The other {drawn - len(scored)} had no answer yet when this page was written; cases are "
            "answered in the order of their random names, so that those are missing at random."
        ),
    )
    page.write_text(text, encoding="utf-8")
