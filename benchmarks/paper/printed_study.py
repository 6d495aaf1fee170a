"""Eq. (16) as printed, told: how large the missing factor is for the paper's own eight paths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gtr_jax.report.page import Figure, Table

from . import path_figures as draw
from .paths import PATHS, T_BASE, states
from .printed import Error, errors
from .study import Statement, Study


def _table(found: dict[int, Error]) -> Table:
    rows = [
        [
            str(p),
            f"{e.metric[0]:.2f} to {e.metric[1]:.2f}",
            "{:.0f}, {:.0f}".format(*(1e3 * e.right[:2])),
            "{:.0f}, {:.0f}".format(*(1e3 * e.printed[:2])),
            f"{1e3 * e.moved:.0f}",
            f"{np.degrees(e.turned):+.1f}°".replace("-", "−"),
            f"{e.tension:+.2f}".replace("-", "−"),
            f"{1e3 * e.discretised:.2f}",
        ]
        for p, e in found.items()
    ]
    return Table(
        "Eq. (16) with and without the factor ν",
        [
            *(
                "path",
                "ν",
                "tip with ν [mm]",
                "tip as printed [mm]",
                "apart [mm]",
                "tip turned",
                "ΔT_tip [N]",
            ),
            "with ν, off the identity [mm]",
        ],
        rows,
        "The last column is the discretisation of the literal integrals: with the factor they must give the "
        "equilibrium that the simulator solves by the local moment identity.",
    )


def study_printed(progress: Callable[[str], None]) -> Study:
    """The equilibrium with eq. (16) as printed beside the right one, for the eight paths.

    Args:
        progress: told each stage.
    """
    progress("eq. (16): as printed and with its factor")
    found = errors()
    length = float(states()[PATHS[0]].pulled.s[-1])
    moved = {p: e.moved for p, e in found.items()}
    turned = {p: e.turned for p, e in found.items()}
    most = max(moved, key=moved.__getitem__)
    least = min(moved, key=moved.__getitem__)
    off = max(e.discretised for e in found.values())
    settled = sum(e.settled for e in found.values())
    lost = {
        p: 100 * (1 - (float(s.pulled.T_tip) + found[p].tension) / T_BASE[p]) for p, s in states().items()
    }
    text = [
        "The distributed forces (12) and (13) are forces per length of tendon, ds_c (the paper's appendix "
        "says so). Eq. (16) integrates them over ds, and so lacks the factor ν = ds_c/ds. With the factor, "
        "anchor (15) and distributed moment (16) collapse to T R (1 − Rκ)/ν, tension times arm at the cut: "
        "no integral is left, and this is what the simulator solves. Both literal forms are solved here "
        "with (18), the tension under the integral taken at ξ, as (12) and (13) have it, and not at s: "
        f"{settled} of {len(found)} paths to the solver's tolerance.",
        f"The factor is not small. As printed the tip lies {1e3 * moved[least]:.0f} mm (path {least}) to "
        f"{1e3 * moved[most]:.0f} mm (path {most}, {100 * moved[most] / length:.0f} % of L) from where it "
        "should be, although ν itself is within "
        f"{100 * max(max(abs(v - 1) for v in e.metric) for e in found.values()):.0f} % of 1: anchor and "
        "distributed moment are each about T times the distance to the tip, and nearly cancel to T times R. "
        "An error of a few per cent in one of them is of the order of the sum. The loss is less touched: "
        f"path 1 would lose {lost[1]:.1f} % and path 3 {lost[3]:.1f} %. Whether the paper's figures were "
        "computed as printed cannot be seen from it.",
    ]
    return Study(
        title="Eq. (16) as printed",
        text=text,
        solved=(settled, len(found)),
        statements=[
            Statement(
                "(15) plus (16) give the moment of the tendon on the body.",
                f"With the factor ν they do: the tip agrees with the local identity within {1e3 * off:.2f} "
                "mm, shrinking with the mesh. As printed they do not: tips "
                + ", ".join(f"{1e3 * v:.0f}" for v in moved.values())
                + " mm apart (paths 1 to 8).",
                min(moved.values()) < 2 * off,
            )
        ],
        figures=[
            Figure(
                "metric-factor",
                draw.plot_factor(moved, length, turned),
                "What the factor missing in eq. (16) does to the tip of the eight paths.",
            )
        ],
        tables=[_table(found)],
        facts={
            str(p): {
                "metric_factor": list(e.metric),
                "tip_moved_mm": 1e3 * e.moved,
                "tip_moved_share_of_length": e.moved / length,
                "tip_turned_deg": float(np.degrees(e.turned)),
                "T_tip_change_N": e.tension,
                "tension_loss_as_printed": lost[p] / 100,
                "curvature_change_relative": e.curvature,
                "with_factor_off_the_identity_mm": 1e3 * e.discretised,
                "settled": e.settled,
            }
            for p, e in found.items()
        },
    )
