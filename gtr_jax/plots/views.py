"""A body in space from three sides, with its channels coloured by tension."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from .style import BLUE, GREY, INK, PURPLE, VERMILLION, column_width, legend_above, styled

SIDES = ((0, 1), (0, 2), (1, 2))  # axes across and up of each view
AXES = "xyz"
POINTS = 160  # a body is drawn at
CORNERS = 20  # of a drawn section
COLOURS = "viridis_r"
INSIDE = "#F4F4F4"
OBSTACLE = "#E3D7C5"
WANTED: dict[str, Any] = {"marker": "+", "color": VERMILLION, "markersize": 11, "markeredgewidth": 1.8}
TALLEST = 5.5  # of the two views above one another [in]
MARGIN = 0.06  # around what is drawn, relative to its longest side


class Posture(NamedTuple):
    """One shape of a body at N nodes.

    Attributes:
        name: what to call it.
        position: of the midline [m], (N, 3).
        frames: directors of the sections as columns, (N, 3, 3).
        tension: of every tendon [N], (tendons, N).
        markers: places of markers [m], (markers, 3).
    """

    name: str
    position: np.ndarray
    frames: np.ndarray
    tension: np.ndarray
    markers: np.ndarray = np.zeros((0, 3))


class Strung(NamedTuple):
    """A body and its channels, unloaded.

    Attributes:
        s: arc length of the nodes [m], (N,); panel ends may be double.
        radius: of the body there [m], (N,).
        offsets: of the channels in the section: y, z [m], (tendons, N, 2).
        ends: arc length at which each tendon is anchored [m], (tendons,).
        names: of the tendons; empty for one.
    """

    s: np.ndarray
    radius: np.ndarray
    offsets: np.ndarray
    ends: np.ndarray
    names: Sequence[str] = ()


class Drawn(NamedTuple):
    """A posture at the M points it is drawn at, in mm.

    Attributes:
        s: arc length, (M,).
        middle: (M, 3).
        left, up: directors across the body, (M, 3).
        sections: outlines of the sections, (M, corners, 3).
        channels: (tendons, M, 3).
        tension: [N], (tendons, M).
    """

    s: np.ndarray
    middle: np.ndarray
    left: np.ndarray
    up: np.ndarray
    sections: np.ndarray
    channels: np.ndarray
    tension: np.ndarray


def drawn(body: Strung, posture: Posture, points: int = POINTS, corners: int = CORNERS) -> Drawn:
    """A posture between its nodes: splines through positions, directors and offsets.

    Args:
        body: the body.
        posture: its shape.
        points: M.
        corners: of a section's outline.
    """
    s, first = np.unique(body.s, return_index=True)
    at = np.linspace(s[0], s[-1], points)
    frames = posture.frames[first]
    middle = CubicHermiteSpline(s, posture.position[first], frames[:, :, 0])(at)
    left, up = (CubicSpline(s, frames[:, :, i])(at) for i in (1, 2))
    left, up = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (left, up))
    places = CubicSpline(s, body.offsets[:, first], axis=1)(at)
    channels = middle + places[..., :1] * left + places[..., 1:] * up
    around = np.linspace(0.0, 2 * np.pi, corners, endpoint=False)
    radius = np.interp(at, s, body.radius[first])[:, None, None]
    rim = np.cos(around)[:, None] * left[:, None] + np.sin(around)[:, None] * up[:, None]
    return Drawn(
        at,
        1e3 * middle,
        left,
        up,
        1e3 * (middle[:, None] + radius * rim),
        1e3 * channels,
        np.stack([np.interp(at, body.s, tension) for tension in posture.tension]),
    )


class Around(NamedTuple):
    """What a body is drawn among.

    Attributes:
        wanted: places that are wanted [m], (W, 3).
        directions: unit vectors that are wanted there, (W, 3); NaN where none is.
        rods: axes of obstacles with round ends, start and end [m], (O, 2, 3).
        radius: of them [m], (O,).
    """

    wanted: np.ndarray = np.zeros((0, 3))
    directions: np.ndarray = np.zeros((0, 3))
    rods: np.ndarray = np.zeros((0, 2, 3))
    radius: np.ndarray = np.zeros(0)


@styled
def plot_views(body: Strung, postures: Sequence[Posture], around: Around = Around()) -> Figure:  # noqa: B008
    """Each posture from three sides at one scale: the body in outline, its channels coloured by tension.

    Args:
        body: the body and its channels.
        postures: shapes in the order of the history; channels of the first, taken as the body at rest, have
            no colour if there are several.
        around: what is wanted, and obstacles.
    """
    shapes = [drawn(body, posture) for posture in postures]
    rods = 1e3 * around.rods
    room = 1e3 * around.radius[:, None, None]
    places = [1e3 * around.wanted, *(rods - room), *(rods + room)]
    low = np.min([*(shape.sections.min(axis=(0, 1)) for shape in shapes), *np.concatenate(places)], axis=0)
    high = np.max([*(shape.sections.max(axis=(0, 1)) for shape in shapes), *np.concatenate(places)], axis=0)
    margin = MARGIN * np.max(high - low)
    low, high = low - margin, high + margin
    size = high - low
    fig, views, scale = _views(size)
    colours = [GREY, INK, PURPLE, BLUE] if len(shapes) > 1 else [INK]
    most = max(float(np.max(shape.tension)) for shape in shapes)
    norm = Normalize(0.0, most if most > 0 else 1.0)
    order = [0, *range(len(shapes) - 1, 0, -1)]  # the loaded one in front
    for (across, up), axes in zip(SIDES, views, strict=True):
        for rank, i in enumerate(order):
            _draw_body(axes, shapes[i], (across, up), colours[i], 1.5 + 0.2 * rank)
            tensed = norm if i or len(shapes) == 1 else None
            _draw_channels(axes, shapes[i], body.ends, (across, up), tensed)
            if i == min(1, len(shapes) - 1):
                _name_channels(axes, shapes[i], body, (across, up))
            places = 1e3 * postures[i].markers[:, [across, up]].T
            axes.plot(*places, "s", color=colours[i], markersize=4, zorder=5)
        _draw_around(axes, around, (across, up), 0.12 * float(np.max(size)))
        axes.set_xlim(low[across], high[across])
        axes.set_ylim(low[up], high[up])
        axes.set_aspect("equal")
        axes.set_xlabel(f"{AXES[across]} [mm]")
        axes.set_ylabel(f"{AXES[up]} [mm]")
    bar = fig.colorbar(ScalarMappable(norm, COLOURS), cax=scale)
    bar.set_label("tension [N]")
    keys: list[Artist] = [
        Line2D([], [], color=colour, label=posture.name, linewidth=2)
        for posture, colour in zip(postures, colours, strict=False)
    ]
    if any(len(posture.markers) for posture in postures):
        keys.append(Line2D([], [], color=INK, marker="s", linestyle="", markersize=4, label="marker"))
    if len(around.wanted):
        keys.append(Line2D([], [], linestyle="", label="wanted", **WANTED))
    if len(around.radius):
        keys.append(Patch(facecolor=OBSTACLE, edgecolor=GREY, label="obstacle"))
    legend_above(fig, keys)
    return fig


def _draw_around(axes: Axes, around: Around, side: tuple[int, int], size: float) -> None:
    """Obstacles behind the body, what is wanted before it; arrows of a size [mm] in space."""
    turn = np.linspace(0.0, 2 * np.pi, 73)
    rim = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for ends, radius in zip(1e3 * around.rods[:, :, side], 1e3 * around.radius, strict=True):
        along = ends[1] - ends[0]
        forward = rim @ along >= 0  # the half of the rim that is drawn about the far end
        outline = radius * rim + np.where(forward[:, None], ends[1], ends[0])
        order = np.argsort(np.unwrap(np.arctan2(*(outline - ends.mean(axis=0)).T[::-1])))
        axes.add_patch(
            Polygon(
                outline[order], closed=True, facecolor=OBSTACLE, edgecolor=GREY, linewidth=0.8, zorder=1.2
            )
        )
    for place, direction in zip(1e3 * around.wanted, around.directions, strict=True):
        start = place[list(side)]
        axes.plot(*start, **WANTED, zorder=6)
        if np.all(np.isfinite(direction)):
            style = {"arrowstyle": "-|>", "color": VERMILLION, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
            end = start + size * direction[list(side)]
            axes.annotate("", tuple(end), tuple(start), arrowprops=style, zorder=6)


def _views(size: np.ndarray) -> tuple[Figure, list[Axes], Axes]:
    """A figure with the views of x and y, of x and z below it, of y and z beside that, all at one scale, and
    the axes of a colour bar in the corner.
    """
    room, between = 1.6, 0.75  # for labels beside and between the views [in]
    wide_of_all = column_width()
    scale = min((wide_of_all - room) / (size[0] + size[1]), TALLEST / (size[1] + size[2]))  # in per mm
    wide, deep, tall = scale * size
    height = deep + tall + between + 1.0
    fig = Figure(figsize=(wide_of_all, height))
    left, gap = 0.62, 0.72

    def place(x, y, w, h):
        return fig.add_axes((x / wide_of_all, y / height, w / wide_of_all, h / height))

    low = 0.5
    views = [
        place(left, low + tall + between, wide, deep),
        place(left, low, wide, tall),
        place(left + wide + gap, low, deep, tall),
    ]
    bar = place(left + wide + gap, low + tall + between, 0.12, deep)
    return fig, views, bar


def _draw_body(axes: Axes, shape: Drawn, side: tuple[int, int], colour: str, height: float) -> None:
    """The union of the sections, in outline, and the midline; `height` says what lies in front of what."""
    rims = shape.sections[:, :, side]
    back = np.roll(rims, 1, axis=1)
    quads = np.stack([rims[:-1], back[:-1], back[1:], rims[1:]], axis=2).reshape(-1, 4, 2)
    polygons = [*rims, *quads]
    for fill, wide, above in ((colour, 1.4, 0.0), (INSIDE, 0.1, 0.1)):
        axes.add_collection(
            PolyCollection(polygons, edgecolor=fill, facecolor=fill, linewidth=wide, zorder=height + above)
        )
    middle = shape.middle[:, side].T
    axes.plot(*middle, color=colour, linewidth=0.8, linestyle=(0, (7, 2, 1, 2)), zorder=2.4)


def _draw_channels(
    axes: Axes, shape: Drawn, ends: np.ndarray, side: tuple[int, int], norm: Normalize | None
) -> None:
    """The channels as far as their tendons run, coloured by tension unless there is no scale."""
    for channel, tension, end in zip(shape.channels, shape.tension, ends, strict=True):
        run = shape.s <= end * (1 + 1e-9)
        points = channel[run][:, side]
        if norm is None:
            axes.plot(*points.T, color=GREY, linewidth=1.0, zorder=2.5)
            continue
        pieces = np.stack([points[:-1], points[1:]], axis=1)
        lines = LineCollection(list(pieces), cmap=COLOURS, norm=norm, linewidths=1.8, zorder=3)
        lines.set_capstyle("round")
        lines.set_array(0.5 * (tension[run][1:] + tension[run][:-1]))
        axes.add_collection(lines)


def _name_channels(axes: Axes, shape: Drawn, body: Strung, side: tuple[int, int]) -> None:
    """The name of each of several tendons beyond its anchor, each farther out than the one before."""
    for k, (name, channel, end) in enumerate(zip(body.names, shape.channels, body.ends, strict=False)):
        run = channel[shape.s <= end * (1 + 1e-9)][:, side]
        heading = run[-1] - run[-2]
        out = heading / max(float(np.hypot(*heading)), 1e-9) * (9 + 8 * k)
        axes.annotate(
            name,
            run[-1],
            xytext=tuple(out),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=8,
            color=INK,
            zorder=6,
        )
