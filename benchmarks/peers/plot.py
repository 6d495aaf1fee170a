"""Error of the tip against the time of one warm solve, for every setting of every solver."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

COLOURS = {"gtr-jax": "#0072b2", "soromox": "#d55e00", "solve_bvp": "#009e73", "pyelastica": "#7a3b8f"}
MARKS = {"gtr-jax": "o", "soromox": "s", "solve_bvp": "^", "pyelastica": "D"}
SIDES = {"gtr-jax": -14, "soromox": 18}  # by which labels are moved apart [pt]
COLUMNS = 2
EXACT = 1e-11  # errors below are drawn here


def frontier(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that no other beats in both time and error, by time."""
    best, kept = float("inf"), []
    for time, error in sorted(points):
        if error < 0.99 * best:
            best = error
            kept.append((time, error))
    return kept


def plot(found: dict[str, Any], path: Path) -> None:
    """One panel per problem; the line joins the settings that are worth using."""
    problems = found["problems"]
    rows, columns = -(-len(problems) // COLUMNS), min(COLUMNS, len(problems))
    fig, grid = plt.subplots(rows, columns, figsize=(5.2 * columns, 4.6 * rows), sharex=True, sharey=True)
    axes = np.atleast_1d(grid).ravel()
    for ax in axes[len(problems) :]:
        ax.set_visible(False)
    for ax, problem in zip(axes, problems, strict=False):
        for name, solver in found["solvers"].items():
            points = [
                (p["warm_s"] * 1e3, max(p["error"], EXACT))
                for p in solver.get("points", ())
                if p["problem"] == problem["name"] and p["converged"]
            ]
            if not points:
                continue
            colour = COLOURS[name]
            ax.plot(*zip(*points, strict=True), MARKS[name], ms=3.5, color=colour, alpha=0.35, mew=0)
            line = frontier(points)
            ax.plot(*zip(*line, strict=True), MARKS[name] + "-", ms=5, lw=1.6, color=colour)
            _label(ax, name, line, colour)
        for level in found["levels"]:
            ax.axhline(level, color="0.75", lw=0.8, ls=":", zorder=0)
        ax.set_title(problem["name"], fontsize=11)
        ax.set_xscale("log")
        ax.margins(x=0.12)
        ax.set_yscale("log")
        ax.set_ylim(EXACT / 100, 0.3)
        ax.set_xlabel("time of one warm solve [ms]")
        ax.tick_params(labelbottom=True)
        ax.grid(alpha=0.25)
    for ax in axes[::columns]:
        ax.set_ylabel("distance of the tip from the reference / length [-]")
    axes[0].text(
        0.99, 0.01, f"errors below {EXACT:g} drawn there", transform=axes[0].transAxes, ha="right", fontsize=7
    )
    m = found["machine"]
    fig.suptitle(f"The same frictionless rod, one solve: {m['processor']}, {m['date']}", fontsize=10)
    fig.tight_layout(rect=(0, 0, 1, 0.97))
    fig.savefig(path, dpi=120)
    plt.close(fig)


def _label(ax, name: str, line: list[tuple[float, float]], colour: str) -> None:
    """The solver's name under the end of its line."""
    ax.annotate(
        name,
        line[-1],
        xytext=(SIDES.get(name, 0), -16),
        textcoords="offset points",
        color=colour,
        fontsize=10,
        ha="center",
        weight="bold",
    )
