"""The straight body with its channels, as it is made: no load, no simulation."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..robot.clearance import place_in_section
from ..robot.robot import Robot
from .style import GREY, INK, PALE, figure, legend_above, styled
from .tendons import COLOURS

POINTS = 401


def notches_of(robot: Robot) -> list[tuple[float, float, float]]:
    """Start, end and depth of each notch [m], the depth negative of those that are cut from the right."""
    return [
        (float(start), float(end), row.side * float(row.depth))
        for row in robot.backbone.notches
        for start, end in zip(*row.ends, strict=True)
    ]


@styled
def plot_straight(robot: Robot, *, axes: Axes | Sequence[Axes] | None = None) -> Figure:
    """The body from its side, in space from above too, with bores, notches, channels and guides.

    Args:
        robot: with numbers that are known, not traced.
        axes: to draw into, one, in space two; a figure is made unless given.
    """
    body, length = robot.backbone, float(robot.backbone.length)
    s = np.linspace(0.0, length, POINTS)
    radius = 1e3 * np.asarray(body.radius(jnp.asarray(s)))
    axes_names = ("y", "z") if robot.space else ("y",)
    fig, sides = figure(1.2 + 1.5 * len(axes_names), len(axes_names), axes, sharex=True)
    keys = []
    for row, (ax, name) in enumerate(zip(sides, axes_names, strict=True)):
        ax.fill_between(1e3 * s, -radius, radius, color=PALE, linewidth=0)
        for start, end, wide in zip(body.bore_start, body.bore_end, body.bore_diameter, strict=True):
            ends = 1e3 * np.asarray([float(start), float(end)])
            half = 0.5e3 * float(wide)
            ax.fill_between(ends, -half, half, color="white", edgecolor=GREY, linewidth=0.6)
        for start, end, depth in notches_of(robot) if row == 0 else ():
            ends = np.array([start, end])
            edge = np.sign(depth) * np.asarray(body.radius(jnp.asarray(ends)))
            floor = edge - depth
            ax.fill_between(1e3 * ends, 1e3 * floor, 1e3 * edge, color="white", edgecolor=GREY, linewidth=0.6)
        for k, tendon in enumerate(robot.tendons):
            colour, wide = COLOURS[k % len(COLOURS)], max(3.0 - 0.8 * k, 1.2)  # one may lie behind another
            end = length if tendon.to is None else float(tendon.to)
            along = s[s <= end]
            if tendon.guides is not None:  # straight between the disks
                along = np.unique(np.concatenate([[0.0], np.asarray(tendon.guides), [end]]))
            offset = 1e3 * place_in_section(tendon, along, length)[:, row]
            marker = "" if tendon.guides is None else "|"
            ax.plot(1e3 * along, offset, color=colour, linewidth=wide, marker=marker, markersize=9)
            if row == 0 and tendon.name:
                keys.append(Line2D([], [], color=colour, linewidth=1.8, label=tendon.name))
        for marker in robot.markers:
            x, *across = (1e3 * float(v) for v in (marker.at + marker.offset[0], *marker.offset[1:]))
            ax.plot(x, across[row], marker="o", linestyle="", color=INK, markersize=4)
            ax.annotate(marker.name, (x, across[row]), (4, 3), textcoords="offset points", fontsize=8)
        ax.set_ylabel(f"{name} [mm]")
    sides[-1].set_xlabel("along the body, from the base [mm]")
    if keys:
        legend_above(fig, keys, axes)
    return fig
