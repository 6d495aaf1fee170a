"""Figures of the antagonistic pair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gtr_jax.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    VERMILLION,
    figure,
    legend_above,
    styled,
)

from .antagonists import Held

COLOURS = (BLUE, GREEN, ORANGE, PURPLE)
TIMES = ((0, INK), (8, VERMILLION), (24, BLUE), (48, GREEN))  # steps after the top


@styled
def plot_pairs(cases: Sequence[Held]) -> Figure:
    """Tip tensions of both tendons and the angle of the tip against the pulled tendon's base tension.

    Args:
        cases: one for each held tension.
    """
    fig, (pulled, held, angle) = figure(6.4, 3, sharex=True)
    keys = []
    for colour, case in zip(COLOURS, cases, strict=True):
        T_base, T_tip = np.asarray(case.run.T_base[:, 0]), np.asarray(case.run.T_tip)
        pulled.plot(T_base, T_tip[:, 0], color=colour, linewidth=1.8)
        held.plot(T_base, T_tip[:, 1], color=colour, linewidth=1.8)
        held.axhline(case.held, color=colour, linewidth=1.0, linestyle=(0, (4, 2)))
        angle.plot(T_base, np.degrees(np.asarray(case.run.tip_pose[:, 2])), color=colour, linewidth=1.8)
        keys.append(Line2D([], [], color=colour, linewidth=2, label=f"{case.held:g} N held"))
    pulled.set_ylabel("pulled: $T_{tip}$ [N]")
    held.set_ylabel("held: $T_{tip}$ [N]")
    angle.set_ylabel("angle of the tip [°]")
    angle.set_xlabel("tension at the base of the pulled tendon [N]")
    for axes in (pulled, held, angle):
        axes.set_ylim(0, None)
    angle.set_xlim(0, None)
    legend_above(fig, keys)
    return fig


@styled
def plot_along(case: Held) -> Figure:
    """Tension of both tendons along the robot at the largest tension and on the way back.

    Args:
        case: one held tension.
    """
    fig, (pulled, held) = figure(4.8, 2, sharex=True)
    s = 1e3 * np.asarray(case.run.s)
    keys = []
    for after, colour in TIMES:
        step = case.top + after
        for axes, tendon in ((pulled, 0), (held, 1)):
            axes.plot(s, case.run.tension[step, tendon], color=colour, linewidth=1.8)
        base = float(case.run.T_base[step, 0])
        keys.append(Line2D([], [], color=colour, linewidth=2, label=f"{base:.1f} N"))
    pulled.set_ylabel("pulled: $T$ [N]")
    held.set_ylabel("held: $T$ [N]")
    held.axhline(case.held, color=GREY, linewidth=1.0, linestyle=(0, (4, 2)))
    held.set_xlabel("s along the backbone [mm]")
    held.set_xlim(0, s[-1])
    legend_above(fig, keys)
    return fig
