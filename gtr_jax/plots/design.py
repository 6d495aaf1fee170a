"""Figures of a design: the shape against its target, the tip's way through pull and release, the channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from gtr_jax.equilibrium import Equilibrium

from .shape import curve_of, draw_body
from .style import (
    BLUE,
    GREY,
    INK,
    PALE,
    PHASE_COLOUR,
    PURPLE,
    VERMILLION,
    figure,
    legend_above,
    line_by_phase,
    number,
    phase_keys,
    styled,
)

ARROW = 0.07  # of the larger side of what is drawn


class Mark(NamedTuple):
    """A place that is wanted: x, y [mm], direction [rad] or NaN, radius of the tolerance [mm], text."""

    x: float
    y: float
    angle: float
    tolerance: float
    text: str


def _mark(axes, mark: Mark, size: float, colour: str = VERMILLION) -> None:
    axes.plot(mark.x, mark.y, marker="+", color=colour, markersize=11, markeredgewidth=1.8, zorder=6)
    axes.add_patch(
        Circle((mark.x, mark.y), mark.tolerance, fill=False, color=colour, linewidth=0.8, zorder=6)
    )
    if mark.angle == mark.angle:
        end = (mark.x + size * np.cos(mark.angle), mark.y + size * np.sin(mark.angle))
        style = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", end, (mark.x, mark.y), arrowprops=style, zorder=6)
    if mark.text:
        axes.annotate(
            mark.text,
            (mark.x, mark.y),
            xytext=(9, -4),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=colour,
            zorder=7,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
        )


@styled
def plot_targets(
    shapes: Sequence[tuple[str, Equilibrium]],
    radius: np.ndarray,
    tips: np.ndarray,
    phases: np.ndarray,
    marks: list[Mark],
    cloud: np.ndarray | None = None,
) -> Figure:
    """The deformed shape at each target, and the way of the tip through the whole pull and release.

    Args:
        shapes: what to call each shape, and its equilibrium.
        radius: outer radius of the body at the nodes [m], (N,).
        tips: of the tip along the history [m], (K, 2).
        phases: of each step, (K,).
        marks: what is wanted.
        cloud: tips on the ellipse of what is not known [m], (D, 2).
    """
    curves = [(name, curve_of(state, radius)) for name, state in shapes]
    everything = np.concatenate([c.outline for _, c in curves])
    width, height = np.ptp(everything, axis=0)
    fig, (axes,) = figure(min(max(4.6 * height / max(width, 1e-9), 2.2), 5.6) + 0.9)
    colours = [PALE, INK, GREY, BLUE]  # the way of the tip has the colours of its phases
    keys = []
    for i, (name, curve) in enumerate(curves):
        colour = colours[min(i, len(colours) - 1)]
        draw_body(axes, curve, colour)
        axes.plot(*curve.channel.T, color=PURPLE, linewidth=1.5, alpha=0.9 if i else 0.4)
        keys.append(Line2D([], [], color=colour, linewidth=2, label=name))
    line_by_phase(axes, 1e3 * tips[:, 0], 1e3 * tips[:, 1], phases, width=1.8)
    if cloud is not None and len(cloud):
        axes.plot(*(1e3 * cloud).T, marker=".", linestyle="", color=INK, markersize=4, zorder=5)
        keys.append(Line2D([], [], color=INK, marker=".", linestyle="", label="uncertain"))
    for mark in marks:
        _mark(axes, mark, ARROW * max(width, height))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    keys.append(Line2D([], [], color=PURPLE, linewidth=1.5, label="tendon"))
    keys.append(Line2D([], [], color=VERMILLION, marker="+", linestyle="", label="wanted"))
    for key in phase_keys(phases[1:]):
        key.set_label(f"tip, {key.get_label()}")
        keys.append(key)
    fig.legend(handles=keys, loc="outside upper center", ncols=4, handlelength=1.4, columnspacing=1.2)
    return fig


@styled
def plot_tip(
    T_base: np.ndarray,
    pose: np.ndarray,
    phases: np.ndarray,
    marks: list[tuple[float, str, int, float, float]],
) -> Figure:
    """Tip position and angle against base tension through pull and release, and what is wanted of them.

    Args:
        T_base: [N], (K,).
        pose: tip x [m], y [m], angle [rad], (K, 3).
        phases: of each step, (K,).
        marks: base tension [N], branch, which column of the pose, value and tolerance in SI.
    """
    fig, axes = figure(5.4, 3, sharex=True)
    for column, (ax, name, size) in enumerate(
        zip(axes, ("tip x [mm]", "tip y [mm]", "tip angle [°]"), (1e3, 1e3, np.degrees(1.0)), strict=True)
    ):
        line_by_phase(ax, T_base, size * pose[:, column], phases)
        for T, branch, which, value, tolerance in marks:
            if which == column:
                colour = PHASE_COLOUR[branch]
                ax.errorbar(T, size * value, yerr=size * tolerance, color=VERMILLION, capsize=3, zorder=6)
                ax.plot(T, size * value, marker="o", color=VERMILLION, markerfacecolor=colour, zorder=7)
        ax.set_ylabel(name)
    axes[-1].set_xlabel("tension at the base $T_{base}$ [N]")
    wanted = Line2D([], [], color=VERMILLION, marker="o", linestyle="", label="wanted")
    legend_above(fig, [*phase_keys(phases[1:]), wanted])
    return fig


@styled
def plot_channels(
    channels: list[np.ndarray],
    radius: tuple[np.ndarray, np.ndarray],
    bores: list[np.ndarray],
    clearance: float,
) -> Figure:
    """The channel in the body, unloaded, the chosen one dark, the alternatives pale.

    Args:
        channels: (s, R) [mm] of each, (M, 2), the chosen one first.
        radius: s and outer radius [mm], each (M,).
        bores: outline of each [mm], (K, 2), in s and offset.
        clearance: of the centre line from the surface [mm]; drawn dashed unless 0.
    """
    fig, (axes,) = figure(3.0)
    s, r = radius
    axes.fill_between(s, -r, r, color=INK, alpha=0.06, linewidth=0)
    for side in (1, -1):
        axes.plot(s, side * r, color=INK, linewidth=1)
        if clearance > 0:
            axes.plot(s, side * (r - clearance), color=GREY, linewidth=0.9, linestyle=(0, (4, 3)))
    for bore in bores:
        axes.fill(*bore.T, facecolor="white", edgecolor=GREY, linewidth=0.9)
    for line in channels[:0:-1]:
        axes.plot(*line.T, color=BLUE, linewidth=1, alpha=0.45)
    axes.plot(*channels[0].T, color=VERMILLION, linewidth=2.2)
    axes.set_xlabel("s along the backbone [mm]")
    axes.set_ylabel("offset R [mm]")
    axes.set_xlim(float(s[0]), float(s[-1]))
    keys = [Line2D([], [], color=VERMILLION, linewidth=2.2, label="chosen")]
    if len(channels) > 1:
        text = f"{len(channels) - 1} alternative{'s' if len(channels) > 2 else ''}"
        keys.append(Line2D([], [], color=BLUE, linewidth=1, label=text))
    if clearance > 0:
        text = f"{number(clearance, 'mm', 3)} from the surface"
        keys.append(Line2D([], [], color=GREY, linewidth=0.9, linestyle=(0, (4, 3)), label=text))
    legend_above(fig, keys)
    return fig
