"""The shape: midline, body and channel, and what the tendon presses on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from scipy.interpolate import CubicSpline

from gtr_jax.numbers import number

from ..simulation.forces import ChannelForces
from ..simulation.solution import Equilibrium
from .style import (
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

SLACK = 1e-9  # N/m, below which nothing presses
FINER = 8  # points drawn per mesh interval
RIBBON = 0.12  # height of the tallest force drawn at the channel, relative to the larger side of the body
DRAWN_WIDTH, SHORTEST, TALLEST = 4.4, 1.3, 4.4  # of the plane [in]
HUES = ((BLUE, VERMILLION), (PURPLE, ORANGE), (GREY, INK), (BLUE, INK))  # normal force, friction
DOTTED = (0, (1, 1.6))
BELOW = 2.9  # what the forces along s and the labels take [in]


class Posture(NamedTuple):
    """One shape to draw: what to call it, and the equilibrium."""

    name: str
    state: Equilibrium


class Pressed(NamedTuple):
    """What one tendon does to its channel: its name ("" for an only one), the equilibrium and the forces."""

    name: str
    state: Equilibrium
    forces: ChannelForces


class Curve(NamedTuple):
    """A shape at the M points it is drawn at; panel ends stay double.

    s, panel: arc length [m] and index of the mesh panel, (M,). middle, channel, outline: points [mm], (M, 2),
    the outline closed.
    """

    s: np.ndarray
    panel: np.ndarray
    middle: np.ndarray
    channel: np.ndarray
    outline: np.ndarray


@styled
def plot_shape(
    postures: list[Posture],
    *,
    radius: np.ndarray,
    pressed: list[Pressed],
    bores: Sequence[tuple[float, float, float]] = (),
    notches: Sequence[tuple[float, float, float]] = (),
    axes: Sequence[Axes] | None = None,
) -> Figure:
    """Midline, outline and channels of each posture, and the forces along the channels of the loaded one.

    The upper part draws the normal force to the side on which the tendon presses, and the friction to the
    other; the lower part gives both in numbers.

    Args:
        postures: shapes to draw, in the order of the history.
        radius: outer radius of the body at the nodes [m], (N,).
        pressed: the tendons, in the state whose forces are drawn.
        bores: along the midline: start, end and diameter of each [m]; their walls are dotted.
        notches: as of `curve_of`.
        axes: two to draw into, the shape and the forces along it; a figure is made unless given.
    """
    strung = [_curves_of(posture.state, radius, notches) for posture in postures]
    curves = [tendons[0] for tendons in strung]
    colours = [GREY, INK, PURPLE] if len(curves) > 1 else [INK]
    width, height = np.ptp(np.concatenate([c.outline for c in curves]), axis=0)
    tall = min(max(DRAWN_WIDTH * height / width, SHORTEST), TALLEST)
    fig, (plane, along) = figure(tall + BELOW, 2, axes, height_ratios=[tall, 1.4])
    for tendons, colour in zip(strung, colours, strict=False):
        draw_body(plane, tendons[0], colour)
        _draw_bores(plane, tendons[0], bores, colour)
        for curve in tendons:
            plane.plot(*curve.channel.T, color=GREEN, linewidth=1.6, alpha=0.95 if colour == INK else 0.4)
    highest = max(SLACK, *(float(np.max(tendon.forces.normal)) for tendon in pressed))
    scale = RIBBON * max(width, height) / highest
    for tendon, hues in zip(pressed, HUES, strict=False):
        _draw_forces(plane, along, curve_of(tendon.state, radius), tendon, scale, hues)
    if highest > SLACK:
        _draw_scale(plane, highest, scale, np.concatenate([c.outline for c in curves]))
    plane.set_aspect("equal", adjustable="datalim")
    plane.set_xlabel("x [mm]")
    plane.set_ylabel("y [mm]")
    along.set_xlabel("s along the backbone [mm]")
    along.set_ylabel("force per length [N/m]")
    along.set_xlim(0, 1e3 * float(pressed[0].state.s[-1]))
    if len(pressed) > 1:
        low, high = along.get_ylim()
        along.set_ylim(low, high + 0.45 * (high - low))  # room for the legend
    along.legend(loc="upper left" if len(pressed) > 1 else "best", ncols=len(pressed), fontsize=8)
    keys: list[Artist] = [
        Line2D([], [], color=c, label=p.name, linewidth=2) for p, c in zip(postures, colours, strict=False)
    ]
    keys.append(Line2D([], [], color=GREEN, label="tendon", linewidth=1.6))
    if bores:
        keys.append(Line2D([], [], color=INK, label="bore", linewidth=0.9, linestyle=DOTTED))
    legend_above(fig, keys, axes)
    return fig


def curve_of(
    state: Equilibrium, radius: np.ndarray, notches: Sequence[tuple[float, float, float]] = ()
) -> Curve:
    """The shape between the nodes: splines of place, angle and offset within each panel.

    Args:
        state: of one tendon.
        radius: outer radius of the body at the nodes [m], (N,).
        notches: start, end and depth of each [m], negative of those that are cut from the right; they are
            panels of the mesh.
    """
    s = np.asarray(state.s)
    starts = np.flatnonzero(np.diff(s, prepend=-1.0, append=s[-1]) <= 0)
    pieces = []
    for p, nodes in enumerate(np.split(np.arange(len(s)), starts)):
        if len(nodes) > 1:
            at = np.interp(np.arange(0, len(nodes) - 1 + 1e-9, 1 / FINER), np.arange(len(nodes)), s[nodes])
            smooth = (state.x, state.y, state.angle, state.R)
            drawn = [CubicSpline(s[nodes], np.asarray(v)[nodes])(at) for v in smooth]
            pieces.append((at, np.full(len(at), p), *drawn, np.interp(at, s[nodes], radius[nodes])))
    at, panel, x, y, angle, R, half = (np.concatenate(column) for column in zip(*pieces, strict=True))
    normal = np.stack(_unit(angle + np.pi / 2), axis=1)
    middle = 1e3 * np.stack([x, y], axis=1)
    edges = np.stack([half, -half])
    within = np.concatenate([np.full(len(own), np.mean(own)) for own, *_ in pieces])  # its panel, of a point
    for start, end, depth in notches:
        edges[0 if depth > 0 else 1, (start < within) & (within < end)] -= depth
    left, right = (middle + 1e3 * edge[:, None] * normal for edge in edges)
    outline = np.concatenate([left, right[::-1], left[:1]])
    return Curve(at, panel, middle, middle + 1e3 * R[:, None] * normal, outline)


def _curves_of(
    state: Equilibrium, radius: np.ndarray, notches: Sequence[tuple[float, float, float]]
) -> list[Curve]:
    """The shape with each of its tendons."""
    if np.ndim(state.R) == 1:
        return [curve_of(state, radius, notches)]
    return [curve_of(state.of_tendon(i), radius, notches) for i in range(len(state.R))]


def _unit(angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.cos(angle), np.sin(angle)


def draw_body(axes: Axes, curve: Curve, colour: str) -> None:
    """Outline and midline."""
    axes.fill(*curve.outline.T, facecolor=colour, alpha=0.07, edgecolor="none")
    axes.plot(*curve.outline.T, color=colour, linewidth=0.9)
    axes.plot(*curve.middle.T, color=colour, linewidth=0.9, linestyle=(0, (7, 2, 1, 2)))


def _draw_bores(axes: Axes, curve: Curve, bores: Sequence[tuple[float, float, float]], colour: str) -> None:
    """The walls of the bores, which run along the midline."""
    heading = np.gradient(curve.middle, axis=0)
    length = np.hypot(*heading.T)
    tangent = heading / np.where(length > 0, length, 1.0)[:, None]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    for start, end, diameter in bores:
        inside = (curve.s >= start - 1e-9) & (curve.s <= end + 1e-9)
        for side in (0.5, -0.5):
            wall = curve.middle + side * 1e3 * diameter * normal
            axes.plot(*wall[inside].T, color=colour, linewidth=0.9, linestyle=DOTTED)


def _draw_scale(axes: Axes, highest: float, scale: float, drawn: np.ndarray) -> None:
    """How large a force a height of the bands along the tendon is: a bar of a round number of N/m.

    Args:
        axes: of the shape [mm].
        highest: largest force per length drawn [N/m].
        scale: height of a band [mm] per N/m.
        drawn: points of what is drawn [mm], (n, 2); the bar stands in the corner that has fewest.
    """
    power = 10.0 ** np.floor(np.log10(0.5 * highest))
    size = float(max(m for m in (1.0, 2.0, 5.0) if m * power <= 0.5 * highest) * power)
    at = (drawn - drawn.min(axis=0)) / np.ptp(drawn, axis=0)
    corners = {
        f"{('lower', 'upper')[y]} {('left', 'right')[x]}": np.sum(np.all(np.abs(at - (x, y)) < 0.4, axis=1))
        for y in (1, 0)
        for x in (0, 1)
    }
    height: Any = scale * size  # a float, whatever its annotation says
    bar = AnchoredSizeBar(
        axes.transData,
        0.0,
        f"bands: {number(size, 'N/m', 2)}",
        loc=min(corners, key=lambda corner: corners[corner]),
        size_vertical=height,
        pad=0.3,
        sep=5,
        frameon=False,
        label_top=False,
        color=GREY,
        fontproperties=FontProperties(size=8),
    )
    axes.add_artist(bar)


def _draw_forces(
    plane: Axes, along: Axes, curve: Curve, tendon: Pressed, scale: float, hues: tuple[str, str]
) -> None:
    """Normal force to the side it presses on, friction to the other, at one scale [mm per N/m]; and both
    against s.
    """
    forces = tendon.forces
    for values, sign, colour, dash, label in (
        (np.asarray(forces.normal), 1.0, hues[0], "-", "normal force $f_n$"),
        (np.asarray(forces.friction), -1.0, hues[1], "--", "friction $f_f$"),
    ):
        peak = float(values[np.argmax(np.abs(values))])
        what = f"{tendon.name}: {label.split()[-1]}" if tendon.name else label
        text: str | None = f"{what}, up to {number(peak, 'N/m', 3)}"
        force = along_curve(curve, forces, values)
        for here in _panels_of(curve):
            along.plot(1e3 * curve.s[here], force[here], color=colour, linestyle=dash, label=text)
            text = None  # once in the legend
        draw_ribbon(plane, curve, sign * scale * np.abs(force), colour)


def _panels_of(curve: Curve) -> list[np.ndarray]:
    """Indices of the drawn points, panel by panel."""
    return [np.flatnonzero(curve.panel == p) for p in np.unique(curve.panel)]


def along_curve(curve: Curve, forces: ChannelForces, values: np.ndarray) -> np.ndarray:
    """Values on the intervals between the nodes, (N-1,), at the points a curve is drawn at, (M,)."""
    joints = np.flatnonzero(np.asarray(forces.length) <= 0)
    panels = [np.setdiff1d(p, joints) for p in np.split(np.arange(len(forces.s)), joints)]
    panels = [p for p in panels if len(p)]
    out = np.empty(len(curve.s))
    for own, here in zip(panels, _panels_of(curve), strict=True):
        out[here] = _to_the_ends(curve.s[here], np.asarray(forces.s)[own], values[own])
    return out


def draw_ribbon(plane: Axes, curve: Curve, height: np.ndarray, colour: str) -> None:
    """A band at the channel, to the side the tendon turns to, or to the other where `height` [mm], (M,), is
    negative.
    """
    for here in _panels_of(curve):
        at = curve.channel[here]
        heading = np.unwrap(np.arctan2(np.gradient(at[:, 1]), np.gradient(at[:, 0])))
        turning = np.sign(np.gradient(heading))  # the tendon presses to the side it turns to
        across = np.stack(_unit(heading + np.pi / 2), axis=1)
        tips = at + (turning * height[here])[:, None] * across
        quads = np.stack([at[:-1], at[1:], tips[1:], tips[:-1]], axis=1)[turning[1:] == turning[:-1]]
        plane.add_collection(PolyCollection(list(quads), facecolor=colour, alpha=0.4, edgecolor="none"))


def _to_the_ends(s: np.ndarray, middles: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values at `s` from those at the middles of intervals, continued straight to the panel's ends."""
    if len(middles) == 1:
        return np.full(len(s), values[0])
    slopes = [(values[i + 1] - values[i]) / (middles[i + 1] - middles[i]) for i in (0, -2)]
    first = values[0] + slopes[0] * (s[0] - middles[0])
    last = values[-1] + slopes[1] * (s[-1] - middles[-1])
    return np.interp(s, [s[0], *middles, s[-1]], [first, *values, last])
