"""The pages of the docs on the physics terms.

`python -m gtr_jax.report.term_pages` writes them and their pictures again, into docs/terms.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gtr_jax.atomic_write import write_atomically
from gtr_jax.examples import SIMULATED
from gtr_jax.plots.terms import Loops, term_figure
from gtr_jax.robot.build import load_robot
from gtr_jax.robot.robot import Robot
from gtr_jax.terms import REGISTRY, Term

from ..simulation.history import reading, simulate
from .terms import GROUPS, example, usual_range, value_text

FAST = 116.0  # s, when the fast loop of the pictures begins

# What the pictures show where a typical value would not be seen, or lies elsewhere on this robot.
SHOWN: dict[str, dict[str, float]] = {
    "local-friction": {"base": 0.15, "tip": 0.0, "factor": 1.0},
    "tendon-stretch": {"compliance": 5e-4, "anchor": 0.0},
    "contact": {"stiffness": 400.0, "distance": 0.02},
    "saturation": {"tip": 15.0, "base": 0.0},
    "quantisation": {"tip": 1.0, "base": 0.0},
    "low-pass": {"tip": 4.0, "base": 0.0},
    "time-skew": {"delay": 2.0},
    "zero-drift": {"tip": 1e-2, "base": 0.0},
    "cell-hysteresis": {"tip": 0.7, "base": 0.0},
    "crosstalk": {"share": 0.03},
    "tip-gain": {"gain": 1.08},
    "base-gain": {"gain": 1.08},
    "tip-offset": {"force": 1.0},
    "base-offset": {"force": 1.0},
    "tip-load": {"x": 0.0, "y": -0.2},
    "gravity-error": {"x": 0.0, "y": -9.81},
    "friction-drift": {"rate": 1e-3},
    "wear": {"rate": 0.1},
    "friction-asymmetry": {"ratio": 1.15},
    "viscous-friction": {"coefficient": 60.0},
    "stiffening": {"coefficient": 0.02},
    "hyperelastic": {"second": 8.0, "third": 0.0},
    "superelastic": {"softening": 0.5, "strain": 0.03, "hysteresis": 0.5},
    "free-length": {"compliance": 1e-4},
    "shaken-sheath": {"share": 0.6, "time": 66.0, "duration": 6.0, "edge": 1.0},
    "tip-moved": {"tension": -4.0, "time": 66.0, "duration": 1.0},
    "sheath-moved": {"change": 0.3, "time": 84.0, "duration": 2.0},
    "body-hysteresis": {"ratio": 0.5, "curvature": 1.0},
}


PULL = 40.0  # N, to which the pictures pull


def history(pull: float = PULL) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and base tension [N]: a loop with an inner loop and a hold up to a tension, then a faster
    one.
    """
    corners = [(0, 0), (40, 40), (60, 40), (80, 18), (90, 28), (100, 18), (FAST, 2), (126, 40), (136, 2)]
    at, T = np.asarray(corners, float).T
    time = np.linspace(0.0, at[-1], 341)
    return time, np.interp(time, at, T) * (pull / PULL)


def loops_of(term: Term) -> Loops:
    """The picture's data; the robot is TD-CM I without gravity."""
    time, T_base = history()
    robot = load_robot(SIMULATED).with_values(density=1070.0)
    values = {f"{term.id}.{q.name}": float(q.typical) for q in term.quantities}
    values |= {f"{term.id}.{name}": v for name, v in SHOWN.get(term.id, {}).items()}
    return both_runs(time, T_base, (robot, robot.with_values(**values)), with_terms=True)


def both_runs(
    time: np.ndarray, T_base: np.ndarray, cases: Sequence[Robot], with_terms: bool | None = None
) -> Loops:
    """A load history of a robot without and with a term.

    Args:
        time: [s], (K,).
        T_base: [N], (K,).
        cases: the robot without and with it.
        with_terms: as for `simulate`.
    """
    shown, angles, drawn, bases = [], [], [], []
    for case in cases:
        run = simulate(case, T_base, time=time, with_terms=with_terms)
        cells = reading(case, run)
        shown.append(np.asarray(cells.T_tip))
        bases.append(np.asarray(cells.T_base))
        angles.append(np.asarray(run.tip_pose[:, 2]))
        drawn.append(np.asarray(run.displacement))
    return Loops(time, T_base, bases[1], (shown[0], shown[1]), (angles[0], angles[1]), (drawn[0], drawn[1]))


def page(term: Term, *, heading: int = 2) -> str:
    """A term's page of the docs, in Markdown; its picture is beside it."""
    rows = [
        f"| `{q.name}` | {'In space only. ' * (q in term.across)}{q.says} "
        f"| {value_text(float(q.null), q.unit)} "
        f"| {value_text(float(q.typical), q.unit)} | {usual_range(q)} |"
        for q in term.numbers
    ]
    source = f"\n\n**Source.** {term.source}." if term.source else ""
    note = f"\n\n{term.note}" if term.note else ""
    return (
        f"{'#' * heading} {term.id}\n\n{term.says}\n\n"
        f"**Law.** {term.law}\n\n**Seen in a recording.** {term.seen}\n\n"
        f"**Told apart.** {term.told_apart}{source}{note}\n\n"
        f"| number | what it is | does nothing at, or default | typical | usual |\n|---|---|---|---|---|\n"
        + "\n".join(rows)
        + f"\n\n![What {term.id} does to a loop]({term.id}.png)\n\n```toml\n"
        + "\n".join(example(term))
        + "\n```\n"
    )


def write_pages(folder: Path) -> None:
    """Write one page per term, its picture, and an index."""

    folder.mkdir(parents=True, exist_ok=True)
    index = [
        "# Physics terms\n",
        "Effects beyond friction in a fully constrained channel. Each is dormant until a `[[terms]]` table",
        "of the robot file gives it numbers; any of them can be fitted (`--free mu,presliding.length`).",
        "`gtr terms` lists them at the command line. These pages are written from the terms' own files by",
        "`python -m gtr_jax.report.term_pages`. A robot file may also state [laws of its own](../laws.md),",
        "and Python may add [terms of your own](../own-terms.md).\n",
        "The pictures show TD-CM I through one history: a loop at 1 N/s with a hold and an inner loop, then",
        "one at 4 N/s; without the term in grey. Events, which happen at a time of their own, are drawn over",
        "time as well. They are not among the ordinary hypotheses of `gtr diagnose`, because a free time can",
        "fit any bump.\n",
    ]
    for group, belongs in GROUPS.items():
        index += [f"\n## {group}\n", "| term | what it is | law |", "|---|---|---|"]
        for term in REGISTRY.values():
            if belongs(term):
                law = term.law.replace("|", "\\|")
                index.append(f"| [{term.id}]({term.id}.md) | {term.says} | {law} |")
                (folder / f"{term.id}.png").write_bytes(term_figure(term, loops_of(term), FAST))
                write_atomically(folder / f"{term.id}.md", page(term, heading=1))
    write_atomically(folder / "index.md", "\n".join(index) + "\n")


if __name__ == "__main__":
    import sys

    write_pages(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/terms"))
