"""What the instruments show of a simulation, channel by channel: the same for JAX and for native code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gtr_jax import Robot
from gtr_jax.simulation.markers import marker_rows

from .channels import ROTATION, is_of_marker, quantity_of, tendon_of


def shows_markers(robot: Robot, channels: Sequence[str]) -> bool:
    """Whether some channels are those of a robot's markers."""
    return bool(robot.markers) and any(map(is_of_marker, channels))


def channel_rows(
    robot: Robot,
    channels: Sequence[str],
    *,
    place: Any,
    angle: Any,
    turned: Any,
    markers: Any,
    ends: Mapping[str, Any],
) -> list[Any]:
    """Readings on some channels of K steps, SI, (K,) each; arrays of NumPy, or of JAX in a program.

    Args:
        robot: what was simulated.
        channels: names of what is wanted.
        place: of the tip [m], (K, 2), in space (K, 3).
        angle: of the tip [rad], (K,); None where no channel is of it.
        turned: the channels ROTATION of the tip [rad], (K, 3); None where they are not compared.
        markers: their places [m] and the angles of their sections [rad], (K, markers, 4); None where no
            channel is of them.
        ends: what is read at the ends of the tendons, by quantity: T_tip and T_base [N], displacement [m],
            (K, *tendons) each.
    """
    rows = {f"tip_{axis}": row for axis, row in zip("xyz", place.T, strict=False)}
    if angle is not None:
        rows["tip_angle"] = angle
    if turned is not None:
        rows |= dict(zip(ROTATION, turned.T, strict=True))
    if markers is not None:
        rows |= marker_rows(robot, markers)

    def row(name: str) -> Any:
        if name in rows:
            return rows[name]
        values = ends[quantity_of(name)]
        return values[:, tendon_of(name, robot)] if robot.tendon_names else values

    return [row(name) for name in channels]
