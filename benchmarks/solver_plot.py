"""The plot of the solver study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import NullFormatter

MARKS = {"march": "o", "structured Newton": "s", "Anderson": "^", "Picard": "v", "dense Newton": "D"}


def plot(study: dict[str, Any], path: Path) -> None:
    """Above, error against time of one equilibrium; below, the cost per lane, the mesh and the loops."""
    names = list(study["systems"])
    fig, axes = plt.subplots(2, max(len(names), 3), figsize=(4.1 * max(len(names), 3), 7.6), squeeze=False)
    for ax, name in zip(axes[0], names, strict=False):
        _work_precision(ax, name, study["systems"][name])
    for ax in axes[0][len(names) :]:
        ax.set_axis_off()
    _lanes(axes[1][0], study)
    _mesh(axes[1][1], study)
    _loops(axes[1][2], study)
    for ax in axes[1][3:]:
        _convergence(ax, study)
    m = study["machine"]
    fig.suptitle(
        f"Solver candidates on one core of {m['processor']}, jax {m['versions']['jax']}, {m['date']}",
        fontsize=11,
    )
    fig.tight_layout(rect=(0, 0, 1, 0.97))
    fig.savefig(path, dpi=110)
    plt.close(fig)


def _work_precision(ax, name: str, system: dict[str, Any]) -> None:
    for solver, mark in MARKS.items():
        points = [
            (p["solvers"][solver]["single_s"] * 1e3, max(p["T_tip_relative"], 1e-15))
            for p in system["meshes"]
            if solver in p["solvers"]
        ]
        if points:
            ax.loglog(*zip(*points, strict=True), marker=mark, ms=5, lw=1.2, label=solver)
    ax.axhline(1e-6, color="0.6", lw=0.8, ls=":")
    slope = system["order_T_tip"]
    ax.set_title(
        f"{name}, {system['T_base_N']:g} N" + (f" (order {slope:.1f})" if slope else ""), fontsize=10
    )
    ax.set_xlabel("time of one equilibrium [ms]")
    ax.set_ylabel("error of the tip tension [-]")
    ax.legend(fontsize=7)
    ax.grid(alpha=0.3)


def _lanes(ax, study: dict[str, Any]) -> None:
    systems = study["systems"]
    for k, solver in enumerate(s for s in MARKS if s != "dense Newton"):
        heights = []
        for system in systems.values():
            entry = (
                next((p["solvers"].get(solver) for p in system["meshes"] if p["resolution"] == 1.0), None)
                or {}
            )
            heights.append(
                min(entry.get("lane_vmap_s", float("nan")), entry.get("lane_map_s", float("nan"))) * 1e6
            )
        ax.bar([i + 0.2 * k for i in range(len(heights))], heights, width=0.19, label=solver)
    ax.set_yscale("log")
    ax.set_xticks([i + 0.3 for i in range(len(systems))], list(systems), fontsize=7)
    ax.set_ylabel("time per lane [µs]")
    ax.set_title("batched, default mesh", fontsize=10)
    ax.legend(fontsize=7)
    ax.grid(alpha=0.3, axis="y")


def _mesh(ax, study: dict[str, Any]) -> None:
    for name, system in study["systems"].items():
        nodes = [p["nodes"] for p in system["meshes"]]
        ax.loglog(nodes, [max(p["T_tip_relative"], 1e-15) for p in system["meshes"]], "o-", ms=4, label=name)
    ax.axhline(1e-6, color="0.6", lw=0.8, ls=":")
    ax.set_xlabel("nodes [-]")
    ax.set_ylabel("error of the tip tension [-]")
    ax.set_title("one pull", fontsize=10)
    ax.legend(fontsize=7)
    ax.grid(alpha=0.3)


def _loops(ax, study: dict[str, Any]) -> None:
    for name, loop in study["loops"].items():
        ax.loglog(
            [p["nodes"] for p in loop["meshes"]],
            [p["T_tip_N"] for p in loop["meshes"]],
            "o-",
            ms=4,
            label=name,
        )
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("nodes [-]")
    ax.set_ylabel("largest error of the tip tension [N]")
    ax.set_title("hysteresis loop", fontsize=10)
    ax.legend(fontsize=7)
    ax.grid(alpha=0.3)


def _convergence(ax, study: dict[str, Any]) -> None:
    systems = study["convergence"]
    for k, solver in enumerate(MARKS):
        shares = [100 * s[solver]["share"] if solver in s else float("nan") for s in systems.values()]
        ax.bar([i + 0.16 * k for i in range(len(shares))], shares, width=0.15, label=solver)
    ax.set_xticks([i + 0.3 for i in range(len(systems))], list(systems), fontsize=7)
    ax.set_ylabel("share solved from a cold start [%]")
    ax.set_ylim(0, 135)
    ax.set_title("random friction, modulus, tension", fontsize=10)
    ax.legend(fontsize=7, ncols=3, loc="upper center")
    ax.grid(alpha=0.3, axis="y")
