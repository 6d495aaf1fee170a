"""Poses of the tip as vectors whose differences are linear in place and orientation.

In the plane a pose is x [m], y [m], angle [rad]. In space it is x, y, z [m] and the nine entries of the
rotation of the tip's section, row by row, the first column of which is the direction of the midline. The
residual of a rotation by a small angle a then has the size a sqrt(2), that of a direction the size a.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

PLANE, SPACE = 3, 12  # numbers of a pose
DIRECTION = [3, 6, 9]  # of them, those of the direction of the midline in space
ANGLE = 2  # the angle in the plane


def in_space(place: Float[Array, "*S 3"], rotation: Float[Array, "*S 3 3"]) -> Float[Array, "*S 12"]:
    """A pose in space from its place [m] and the directors of its section as columns."""
    return jnp.concatenate([place, rotation.reshape(*place.shape[:-1], 9)], axis=-1)


def axes_of(size: int) -> int:
    """How many numbers of a pose of a size are of its place."""
    return 2 if size == PLANE else 3


def place_of(pose: Any) -> np.ndarray:
    """The place of poses [m], (..., 2) or (..., 3)."""
    pose = np.asarray(pose)
    return pose[..., : axes_of(pose.shape[-1])]


def distance(gap: Any) -> np.ndarray:
    """Distance [m] between the places of two poses, from the difference of the poses, (..., pose)."""
    return np.sqrt(np.sum(place_of(gap) ** 2, axis=-1))


def turn(gap: Any, *, direction: bool = False) -> np.ndarray:
    """Angle [rad] between the orientations of two poses, from the difference of the poses, (..., pose).

    Args:
        gap: the difference.
        direction: whether in space only the directions of the midline count.
    """
    gap = np.asarray(gap)
    if gap.shape[-1] == PLANE:
        return np.abs(gap[..., ANGLE])
    if direction:
        return 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(gap[..., DIRECTION], axis=-1)))
    return 2.0 * np.arcsin(np.minimum(1.0, np.linalg.norm(gap[..., 3:], axis=-1) / math.sqrt(8.0)))


def turning(rate: Any) -> np.ndarray:
    """Rate of turning [rad per unit] from the derivative of a pose by a number, (..., pose)."""
    rate = np.asarray(rate)
    if rate.shape[-1] == PLANE:
        return np.abs(rate[..., ANGLE])
    return np.linalg.norm(rate[..., 3:], axis=-1) / math.sqrt(2.0)


def rotation_matrix(pose: Any) -> np.ndarray:
    """The rotation of poses in space, (..., 3, 3)."""
    pose = np.asarray(pose)
    return pose[..., 3:].reshape(*pose.shape[:-1], 3, 3)
