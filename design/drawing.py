"""The channel for those who make it: `route.csv`, and drawings of the unloaded body at 1:1, DXF and SVG."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from gtr_jax.files.config import RobotConfig
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
    middle, normal = _midline(config, s)
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
        own, away = _midline(config, inside)
        bores.append(1e3 * _band(own, away, np.full(len(inside), 0.5 * bore.diameter)))
    return Drawing(
        1e3 * s,
        1e3 * R,
        1e3 * channel,
        tuple(1e3 * e for e in edges),
        1e3 * _band(middle, normal, radius),
        tuple(bores),
    )


def _midline(config: RobotConfig, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The unloaded midline [m] and its left normal at s, each (M, 2)."""
    rest = config.backbone.natural_curvature
    fine = np.union1d(np.linspace(0.0, config.backbone.length, 4001), s)
    knots = np.asarray(rest if isinstance(rest, tuple) else [(0.0, rest)], float)
    kappa = np.interp(fine, knots[:, 0], knots[:, 1])

    def sums(values):
        return np.concatenate([[0.0], np.cumsum(np.diff(fine) * 0.5 * (values[1:] + values[:-1]))])

    phi = sums(kappa)
    line = np.stack([sums(np.cos(phi)), sums(np.sin(phi)), phi], axis=1)
    x, y, angle = (np.interp(s, fine, column) for column in line.T)
    return np.stack([x, y], axis=1), np.stack([-np.sin(angle), np.cos(angle)], axis=1)


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


def dxf(drawing: Drawing) -> str:
    """The drawing as DXF (release 12, which everything reads), in mm: one polyline for each line."""
    pairs: list[tuple[int, str]] = [(0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009")]
    pairs += [(9, "$MEASUREMENT"), (70, "1"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES")]
    for layer, _, line, closed in _layers(drawing):
        points = line[:-1] if closed else line
        pairs += [(0, "POLYLINE"), (8, layer), (66, "1"), (70, "1" if closed else "0")]
        pairs += [(10, "0.0"), (20, "0.0"), (30, "0.0")]
        for x, y in points:
            pairs += [(0, "VERTEX"), (8, layer), (10, f"{x:.6f}"), (20, f"{y:.6f}"), (30, "0.0")]
        pairs += [(0, "SEQEND"), (8, layer)]
    pairs += [(0, "ENDSEC"), (0, "EOF")]
    return "".join(f"{code}\n{value}\n" for code, value in pairs)
