"""The channels of a robot in space, or of several tendons, for those who make them: a table of each as a
curve for CAD, and the body's surface unrolled at 1:1, SVG. All of them as lines in space are drawn by
`gtr_jax.export.dxf`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from xml.sax.saxutils import escape

import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.channel_table import channel_curve

MARGIN = 5.0  # mm around the drawing
COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
EVERY = 90  # degrees between the lines along the unrolled body
LEAST_AWAY = 1e-9  # mm from the axis, below which a channel has no angle about it


@dataclasses.dataclass(frozen=True, eq=False)
class Unrolled:
    """One channel about the axis of the straight body, at M places.

    Attributes:
        name: of the tendon; "" of an only one.
        s: arc length of the midline [mm], (M,).
        away: distance from the midline [mm], (M,).
        angle: about the axis, from y towards z, without jumps [rad], (M,).
        curve: the columns of `channel_curve`.
    """

    name: str
    s: np.ndarray
    away: np.ndarray
    angle: np.ndarray
    curve: dict[str, np.ndarray]


def unroll(config: RobotConfig) -> tuple[Unrolled, ...]:
    """The channels of a robot, tendon after tendon."""
    robot = build_robot(config)
    found = []
    for tendon in robot.tendons:
        curve = channel_curve(robot, tendon)
        y, z = curve["y_mm"], curve["z_mm"]
        away = np.hypot(y, z)
        own = np.flatnonzero(away > LEAST_AWAY)
        angle = np.zeros_like(y)
        if own.size:  # where the channel meets the axis, the angle is that beside it
            turned = np.unwrap(np.arctan2(z[own], y[own]))
            angle = np.interp(np.arange(len(y)), own, turned)
        found.append(Unrolled(tendon.name, curve["s_mm"], away, angle, curve))
    return tuple(found)


def channel_csv(channel: Unrolled) -> str:
    """A channel as a table in mm and degrees: what a robot file reads (s, y, z), the same about the axis, and
    the line in the unloaded body for CAD.
    """
    columns = {
        **{name: channel.curve[name] for name in ("s_mm", "y_mm", "z_mm")},
        "radius_mm": channel.away,
        "angle_deg": np.degrees(channel.angle),
        **{name: values for name, values in channel.curve.items() if name.startswith("body_")},
    }
    rows = zip(*columns.values(), strict=True)
    return ",".join(columns) + "\n" + "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows)


def svg_unrolled(config: RobotConfig, channels: Iterable[Unrolled], title: str) -> str:
    """The surface of the straight body unrolled, one unit one millimetre: s to the right, the way about the
    axis at the largest outer radius upwards, the channels as they run below the surface. Wrapped round a
    cylinder of that radius, it shows where each is; 0 degrees is the y axis, 90 degrees the z axis.
    """
    radius, length = 1e3 * max(config.backbone.outer_radius), 1e3 * config.backbone.length
    channels = tuple(channels)
    half = [np.pi, *(float(np.max(np.abs(channel.angle))) for channel in channels)]
    steps = int(np.ceil(np.degrees(max(half)) / EVERY - 1e-9))
    high = radius * np.radians(steps * EVERY)
    width, height = length + 2 * MARGIN, 2 * high + 2 * MARGIN
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="{-MARGIN:.3f} {-high - MARGIN:.3f} {width:.3f} {height:.3f}">',
        f"<title>{escape(title)}</title>",
    ]
    for k in range(-steps, steps + 1):
        across = -radius * np.radians(k * EVERY)
        out.append(
            f'<path class="ANGLES" d="M0,{across:.4f} L{length:.4f},{across:.4f}" stroke="#999999" '
            'stroke-width="0.1"/>'
        )
        out.append(f'<text x="1" y="{across - 0.6:.4f}" font-size="3" fill="#666666">{k * EVERY}°</text>')
    out.append(
        f'<rect class="BODY" x="0" y="{-high:.4f}" width="{length:.4f}" height="{2 * high:.4f}" fill="none" '
        'stroke="#222222" stroke-width="0.25"/>'
    )
    for i, channel in enumerate(channels):
        points = zip(channel.s, -radius * channel.angle, strict=True)
        path = "M" + " L".join(f"{x:.4f},{y:.4f}" for x, y in points)
        name = f"<title>{escape(channel.name)}</title>" if channel.name else ""
        out.append(
            f'<path class="CHANNEL" d="{path}" fill="none" stroke="{COLOURS[i % len(COLOURS)]}" '
            f'stroke-width="0.25">{name}</path>'
        )
    return "\n".join([*out, "</svg>", ""])
