"""The shape of a body, and where its tip is."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class Shape(eqx.Module):
    """Shape of a body in space, at N nodes.

    Attributes:
        strain: twist and the two bendings, in the axes of the section [1/m], (N, 3).
        rotation: the directors of the section as columns, in the axes of the world, (N, 3, 3).
        position: of the midline in the world [m], (N, 3).
        stretch: of the axis [-], (N,); None of a body that does not stretch.
    """

    strain: Float[Array, "*batch N 3"]
    rotation: Float[Array, "*batch N 3 3"]
    position: Float[Array, "*batch N 3"]
    stretch: Float[Array, "*batch N"] | None = None

    @property
    def whole_strain(self) -> Float[Array, "*batch N strains"]:
        """The strain as the mechanics has it, with the stretch if there is one."""
        if self.stretch is None:
            return self.strain
        return jnp.concatenate([self.strain, self.stretch[..., None]], axis=-1)


def tip_position(shape: Shape | None, pose: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """Position of the tip in the world [m], from its shape in space or else its pose in the plane."""
    if shape is not None:
        return shape.position[..., -1, :]
    return jnp.concatenate([pose[..., :2], jnp.zeros_like(pose[..., :1])], axis=-1)


def tip_rotation(shape: Shape | None, pose: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """The directors of the tip as columns, from its shape in space or else its pose in the plane."""
    if shape is not None:
        return shape.rotation[..., -1, :, :]
    cos, sin = jnp.cos(pose[..., 2]), jnp.sin(pose[..., 2])
    zero, one = jnp.zeros_like(cos), jnp.ones_like(cos)
    rows = ((cos, -sin, zero), (sin, cos, zero), (zero, zero, one))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


class Pose(NamedTuple):
    """Where the tip is and how it is turned, in the world, of a robot in the plane or in space.

    Attributes:
        position: of the midline [m], (*batch, 3); z = 0 in the plane.
        rotation: the directors as columns, (*batch, 3, 3): the tangent, and the axes y and z of the section.
    """

    position: Float[Array, "*batch 3"]
    rotation: Float[Array, "*batch 3 3"]
