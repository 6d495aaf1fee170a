"""Figures of a design: the shape against its target, the tip's path through pull and release, the channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from gtr_jax.numbers import number
from gtr_jax.plots.shape import curve_of, draw_body
from gtr_jax.plots.style import (
    BLUE,
    GREY,
    INK,
    PALE,
    PHASE_COLOUR,
    PURPLE,
    VERMILLION,
    column_width,
    figure,
    legend_above,
    line_by_phase,
    phase_keys,
    styled,
)
from gtr_jax.plots.views import WANTED
from gtr_jax.simulation.solution import Equilibrium

from ..unrolled import COLOURS, Unrolled

ARROW = 0.07  # of the larger side of what is drawn
MAGNIFIED = 4  # places, at most, drawn magnified
PANEL = 2.3  # height of those drawings [in]
AROUND = 1.5  # of the tolerance, or of the miss, that they show to every side
PLAIN: dict[str, Any] = {
    "marker": "D",
    "color": INK,
    "markerfacecolor": "white",
    "markersize": 6,
    "markeredgewidth": 1.6,
}
HAS: dict[str, Any] = {"marker": "o", "color": INK, "markersize": 4.5}


class Mark(NamedTuple):
    """A place: x, y [mm], direction [rad] or NaN, radius of the tolerance [mm]; whether it is where the tip
    would be with the design of the plain model, and not what is wanted.
    """

    x: float
    y: float
    angle: float
    tolerance: float
    plain: bool = False


class Near(NamedTuple):
    """A place drawn magnified: what is wanted and what is found there, (x, y) [mm]; direction wanted [rad] or
    NaN; radius of the tolerance [mm]; and its title.
    """

    wanted: tuple[float, float]
    found: tuple[float, float]
    angle: float
    tolerance: float
    title: str


def _mark(axes: Axes, mark: Mark, size: float) -> None:
    axes.plot(mark.x, mark.y, **(PLAIN if mark.plain else WANTED), zorder=7 if mark.plain else 6)
    axes.add_patch(
        Circle((mark.x, mark.y), mark.tolerance, fill=False, color=VERMILLION, linewidth=0.8, zorder=6)
    )
    _arrow(axes, (mark.x, mark.y), mark.angle, size)


def _arrow(axes: Axes, start: tuple[float, float], angle: float, size: float) -> None:
    """The direction that is wanted, if one is."""
    if angle == angle:
        end = (start[0] + size * np.cos(angle), start[1] + size * np.sin(angle))
        style = {"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", end, start, arrowprops=style, zorder=6)


def _magnify(axes: Axes, near: Near, tips: np.ndarray, phases: np.ndarray, cloud: np.ndarray | None) -> None:
    """A place with its tolerance, the tip and its way, in mm from what is wanted."""
    centre = np.asarray(near.wanted)
    found = np.asarray(near.found) - centre
    reach = AROUND * max(near.tolerance, float(np.hypot(*found)))
    way = 1e3 * tips - centre
    line_by_phase(axes, way[:, 0], way[:, 1], phases, width=1.8)
    if cloud is not None and len(cloud):
        axes.plot(*(1e3 * cloud - centre).T, marker=".", linestyle="", color=INK, markersize=4)
    axes.add_patch(Circle((0, 0), near.tolerance, facecolor=VERMILLION, alpha=0.12, linewidth=0))
    axes.add_patch(Circle((0, 0), near.tolerance, fill=False, color=VERMILLION, linewidth=1.0, zorder=5))
    axes.plot(0, 0, **WANTED, zorder=6)
    _arrow(axes, (0.0, 0.0), near.angle, 0.8 * reach)
    axes.plot(*found, **HAS, zorder=7)
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)
    axes.tick_params(labelsize=7.5)
    axes.set_xlabel(f"x {_from(centre[0])} [mm]", fontsize=8)
    axes.set_ylabel(f"y {_from(centre[1])} [mm]", fontsize=8)
    axes.set_title(near.title, fontsize=8, color=INK)


def _from(value: float) -> str:
    return f"{'−' if value >= 0 else '+'} {number(abs(value), digits=5)}"


@styled
def plot_targets(
    shapes: Sequence[tuple[str, Equilibrium]],
    radius: np.ndarray,
    tips: np.ndarray,
    phases: np.ndarray,
    marks: list[Mark],
    near: Sequence[Near] = (),
    cloud: np.ndarray | None = None,
) -> Figure:
    """The deformed shape at each target, and the path of the tip through the whole pull and release; below,
    magnified, the places that are wanted with their tolerances.

    Args:
        shapes: what to call each shape, and its equilibrium.
        radius: outer radius of the body at the nodes [m], (N,).
        tips: of the tip along the history [m], (K, 2).
        phases: of each step, (K,).
        marks: what is wanted, and where the design of a plain model leads.
        near: places to magnify, the first few of which are.
        cloud: tips on the ellipse of what is not known [m], (D, 2).
    """
    curves = [(name, curve_of(state, radius)) for name, state in shapes]
    everything = np.concatenate([c.outline for _, c in curves])
    width, height = np.ptp(everything, axis=0)
    tall = min(max(4.6 * height / max(width, 1e-9), 2.2), 5.6) + 0.9
    near = near[:MAGNIFIED]
    fig = Figure(figsize=(column_width(), tall + (PANEL if near else 0.0)), layout="constrained")
    parts = fig.add_gridspec(2 if near else 1, 1, height_ratios=[tall, PANEL] if near else [tall])
    axes = fig.add_subplot(parts[0])
    if near:
        below = parts[1].subgridspec(1, len(near))
        for i, place in enumerate(near):
            _magnify(fig.add_subplot(below[i]), place, tips, phases, cloud)
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
    if any(not mark.plain for mark in marks):
        keys.append(Line2D([], [], linestyle="", label="wanted", **WANTED))
    if any(mark.plain for mark in marks):
        keys.append(Line2D([], [], linestyle="", label="tip, by the plain model", **PLAIN))
    if near:
        keys.append(Line2D([], [], linestyle="", label="tip of this design", **HAS))
    for key in phase_keys(phases[1:]):
        key.set_label(f"tip, {key.get_label()}")
        keys.append(key)
    legend_above(fig, keys)
    return fig


@styled
def plot_tip(
    T_base: np.ndarray,
    pose: np.ndarray,
    phases: np.ndarray,
    marks: list[tuple[float, str, int, float, float]],
    *,
    space: bool = False,
) -> Figure:
    """Tip position and, in the plane, angle against base tension through pull and release, and what is wanted
    of them.

    Args:
        T_base: [N], (K,).
        pose: tip x [m], y [m], angle [rad], in space z [m], (K, 3).
        phases: of each step, (K,).
        marks: base tension [N], branch, which column of the pose, value and tolerance in SI.
        space: whether the third column is z.
    """
    fig, axes = figure(5.4, 3, sharex=True)
    last = ("tip z [mm]", 1e3) if space else ("tip angle [°]", np.degrees(1.0))
    for column, (ax, (name, size)) in enumerate(
        zip(axes, (("tip x [mm]", 1e3), ("tip y [mm]", 1e3), last), strict=True)
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
    chosen: str = "chosen",
) -> Figure:
    """The channel in the body, unloaded, the chosen one dark, the alternatives pale.

    Args:
        channels: (s, R) [mm] of each, (M, 2), the chosen one first.
        radius: s and outer radius [mm], each (M,).
        bores: outline of each [mm], (K, 2), in s and offset.
        clearance: of the centre line from the surface [mm]; drawn dashed unless 0.
        chosen: what to call the first.
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
    keys = [Line2D([], [], color=VERMILLION, linewidth=2.2, label=chosen)]
    if len(channels) > 1:
        text = f"{len(channels) - 1} alternative{'s' if len(channels) > 2 else ''}"
        keys.append(Line2D([], [], color=BLUE, linewidth=1, label=text))
    if clearance > 0:
        text = f"{number(clearance, 'mm', 3)} from the surface"
        keys.append(Line2D([], [], color=GREY, linewidth=0.9, linestyle=(0, (4, 3)), label=text))
    legend_above(fig, keys)
    return fig


@styled
def plot_unrolled(
    channels: Sequence[Sequence[Unrolled]],
    limits: tuple[np.ndarray, np.ndarray, np.ndarray],
    chosen: str = "chosen",
) -> Figure:
    """Angle about the axis and distance from it of every channel against arc length, the chosen design dark,
    the alternatives pale.

    Args:
        channels: of each design, the chosen one first.
        limits: s [mm], and the least and the largest distance from the axis that walls leave there [mm],
            each (M,).
        chosen: what to call the first.
    """
    fig, (above, below) = figure(4.6, 2, sharex=True)
    for design in channels[:0:-1]:
        for channel in design:
            above.plot(channel.s, np.degrees(channel.angle), color=BLUE, linewidth=1, alpha=0.45)
            below.plot(channel.s, channel.away, color=BLUE, linewidth=1, alpha=0.45)
    several = len(channels[0]) > 1
    keys = []
    for i, channel in enumerate(channels[0]):
        colour = COLOURS[i % len(COLOURS)]
        above.plot(channel.s, np.degrees(channel.angle), color=colour, linewidth=2.2)
        below.plot(channel.s, channel.away, color=colour, linewidth=2.2)
        name = f"{chosen}, {channel.name}" if several else chosen
        keys.append(Line2D([], [], color=colour, linewidth=2.2, label=name))
    s, least, largest = limits
    for edge in (least, largest):
        below.plot(s, edge, color=GREY, linewidth=0.9, linestyle=(0, (4, 3)))
    below.set_ylim(bottom=0.0)
    above.set_ylabel("angle about the axis [°]")
    below.set_ylabel("distance from it [mm]")
    below.set_xlabel("s along the backbone [mm]")
    below.set_xlim(float(s[0]), float(s[-1]))
    if len(channels) > 1:
        text = f"{len(channels) - 1} alternative{'s' if len(channels) > 2 else ''}"
        keys.append(Line2D([], [], color=BLUE, linewidth=1, label=text))
    keys.append(Line2D([], [], color=GREY, linewidth=0.9, linestyle=(0, (4, 3)), label="kept between"))
    legend_above(fig, keys)
    return fig
