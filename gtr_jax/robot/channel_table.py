"""The channels of a body in space as curves, for CAD."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from gtr_jax.config.midline import followed

from .clearance import place_in_section
from .parts import Parts, Tendon

POINTS = 501  # along a channel
FINER = 8  # steps between two of them in which the body's natural shape is followed


def channel_curve(robot: Parts, tendon: Tendon) -> dict[str, np.ndarray]:
    """Centre line of a channel, as columns in mm, (POINTS,) each: s, its place in the section (y, z), as the
    routing `curve` reads it from a file, and its place in the body that nothing loads, whose base is at the
    origin (body_x, body_y, body_z).

    Args:
        robot: in space.
        tendon: one of its tendons; the channel ends where it is anchored.
    """
    length = float(robot.backbone.length)
    end = length if tendon.to is None else float(tendon.to)
    s = np.linspace(0.0, end, POINTS)
    place = place_in_section(tendon, s, length)
    middle, frames = natural_shape(robot, s)
    points = middle + np.einsum("nij,nj->ni", frames[:, :, 1:], place)
    names = ("s_mm", "y_mm", "z_mm", "body_x_mm", "body_y_mm", "body_z_mm")
    return dict(zip(names, 1e3 * np.column_stack([s, place, points]).T, strict=True))


def natural_shape(robot: Parts, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Midline [m], (N, 3), and directors as columns, (N, 3, 3), of the body that nothing loads, at increasing
    arc lengths from 0 on [m], (N,).
    """
    fine = np.interp(np.arange(FINER * (len(s) - 1) + 1) / FINER, np.arange(len(s)), s)
    strain = np.asarray(robot.backbone.strain_at_rest(jnp.asarray(0.5 * (fine[1:] + fine[:-1]))))
    middle, frames = followed(fine, strain[:, :3])  # nothing stretches it
    return middle[::FINER], frames[::FINER]
