"""The channel for those who make it: `route.csv`, and a picture of the unloaded body at 1:1, SVG; the drawing
for CAD is `gtr_jax.export.dxf`.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.export.unloaded import Unloaded, unloaded
from gtr_jax.robot.build import build_robot

from .limits import stations_of

PLACES = 401  # stations along the body
MARGIN = 5.0  # mm around the drawing


@dataclasses.dataclass(frozen=True, eq=False)
class Drawing:
    """Lines in the plane of bending, mm, base at the origin, base tangent along +x.

    Attributes:
        s: arc length of the midline, (M,), strictly increasing. R: offset of the channel, (M,).
        channel: its centre line, (M, 2). edges: its two walls, each (M, 2); none without a diameter.
        body: outline, closed, (K, 2). bores: outline of each, closed.
    """

    s: np.ndarray
    R: np.ndarray
    channel: np.ndarray
    edges: tuple[np.ndarray, ...]
    body: np.ndarray
    bores: tuple[np.ndarray, ...]


def draw(config: RobotConfig, *, channel_diameter: float = 0.0) -> Drawing:
    """Draw a robot in its unloaded shape.

    Args:
        config: the robot, of one tendon.
        channel_diameter: [m]; with it the channel's walls are drawn too.
    """
    robot = build_robot(config)
    at = stations_of(robot, robot.tendon, PLACES)
    s, first = np.unique(np.round(np.asarray(at.s), 12), return_index=True)
    R = np.asarray(at.R.value)[first]
    body = unloaded(robot)
    middle, normal = _midline(body, s)
    channel = middle + R[:, None] * normal
    tangent = np.gradient(channel, s, axis=0, edge_order=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    half = 0.5 * channel_diameter
    edges = tuple(channel + side * half * across for side in (1.0, -1.0)) if half > 0 else ()
    radius = np.asarray(robot.backbone.radius(jnp.asarray(s)))
    bores = []
    for bore in config.backbone.bores:
        inside = np.union1d(s[(s >= bore.from_) & (s <= bore.to)], [bore.from_, bore.to])
        own, away = _midline(body, inside)
        bores.append(1e3 * _band(own, away, np.full(len(inside), 0.5 * bore.diameter)))
    return Drawing(
        1e3 * s,
        1e3 * R,
        1e3 * channel,
        tuple(1e3 * e for e in edges),
        1e3 * _band(middle, normal, radius),
        tuple(bores),
    )


def _midline(body: Unloaded, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The unloaded midline [m] and its left normal at s, each (M, 2)."""
    middle, frames = body.at(s)
    return middle[:, :2], frames[:, :2, 1]


def _band(middle: np.ndarray, normal: np.ndarray, half: np.ndarray) -> np.ndarray:
    left, right = (middle + side * half[:, None] * normal for side in (1.0, -1.0))
    return np.concatenate([left, right[::-1], left[:1]])


def route_csv(drawing: Drawing) -> str:
    """The channel's centre line in mm: s and offset, which a robot file takes, and x, y for CAD."""
    rows = zip(drawing.s, drawing.R, *drawing.channel.T, strict=True)
    return "s_mm,R_mm,x_mm,y_mm\n" + "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)


def _layers(drawing: Drawing) -> list[tuple[str, str, np.ndarray, bool]]:
    """Layer, colour, line and whether it is closed, of everything drawn."""
    lines = [("BODY", "#222222", drawing.body, True)]
    lines += [("BORES", "#777777", bore, True) for bore in drawing.bores]
    lines += [("CHANNEL_WALLS", "#0072B2", edge, False) for edge in drawing.edges]
    return [*lines, ("CHANNEL", "#D55E00", drawing.channel, False)]


def svg(drawing: Drawing, title: str) -> str:
    """The drawing as SVG, one unit one millimetre."""
    from xml.sax.saxutils import escape

    points = np.concatenate([line for _, _, line, _ in _layers(drawing)])
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    width, height = high - low
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="{low[0]:.3f} {-high[1]:.3f} {width:.3f} {height:.3f}">',
        f"<title>{escape(title)}</title>",
    ]
    for layer, colour, line, closed in _layers(drawing):
        path = "M" + " L".join(f"{x:.4f},{-y:.4f}" for x, y in line) + (" Z" if closed else "")
        out.append(f'<path class="{layer}" d="{path}" fill="none" stroke="{colour}" stroke-width="0.25"/>')
    return "\n".join([*out, "</svg>", ""])
