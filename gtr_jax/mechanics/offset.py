"""Where the tendon channel runs in the body: its offset from the midline, with two derivatives."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .mesh import shifted


class Offset(NamedTuple):
    """Channel offset R [m], slope R' [-] and second derivative R'' [1/m], each (N,); with several tendons
    (tendons, N).
    """

    value: Float[Array, "*tendons N"]
    slope: Float[Array, "*tendons N"]
    second: Float[Array, "*tendons N"]

    def before(self) -> Offset:
        """At each node's predecessor; at the base its own."""
        return Offset(*(shifted(r, 1, r[..., :1]) for r in self))

    def rows(self) -> Offset:
        """The same with nodes along the first axis."""
        return Offset(*(jnp.moveaxis(r, -1, 0) for r in self))


class SpatialOffset(NamedTuple):
    """Channel offset r [m], slope r' [-] and second derivative r'' [1/m] of a tendon that may leave the
    plane, each (N, 2), with several tendons (tendons, N, 2): components y, the left normal as R in the plane,
    and z, both turning with the section.
    """

    value: Float[Array, "*tendons N 2"]
    slope: Float[Array, "*tendons N 2"]
    second: Float[Array, "*tendons N 2"]

    def before(self) -> SpatialOffset:
        """At each node's predecessor; at the base its own."""
        return SpatialOffset(*(jnp.concatenate([r[..., :1, :], r[..., :-1, :]], axis=-2) for r in self))

    def rows(self) -> SpatialOffset:
        """The same with nodes along the first axis."""
        return SpatialOffset(*(jnp.moveaxis(r, -2, 0) for r in self))
