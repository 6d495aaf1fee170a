"""Rotations in space: from a rotation vector to a matrix, from a matrix to a quaternion."""

from __future__ import annotations

import jax.numpy as jnp
from jax.scipy.spatial.transform import Rotation
from jaxtyping import Array, Float


def cross_matrix(v: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The matrix of the cross product with v from the left."""
    x, y, z = v
    nil = jnp.zeros(())
    return jnp.stack([jnp.stack([nil, -z, y]), jnp.stack([z, nil, -x]), jnp.stack([-y, x, nil])])


def rotation_of(vector: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The rotation about an axis by the angle that is its length [rad] (Rodrigues); differentiable at zero.

    Args:
        vector: the axis times the angle, (3,).
    """
    square = vector @ vector
    small = square < 1e-8  # where the series are exact to rounding
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    first = jnp.where(small, 1.0 - square / 6, jnp.sin(angle) / angle)
    second = jnp.where(small, 0.5 - square / 24, (1.0 - jnp.cos(angle)) / angle**2)
    turn = cross_matrix(vector)
    return jnp.eye(3) + first * turn + second * turn @ turn


def quaternion_of(rotation: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """The unit quaternion (x, y, z, w) of a rotation matrix, w >= 0."""
    flat = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat(canonical=True)
    return flat.reshape(*rotation.shape[:-2], 4)
