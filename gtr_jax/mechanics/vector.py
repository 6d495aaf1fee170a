"""Vectors by their components, so that XLA compiles a node to plain arithmetic, for several lanes at once:
arrays with a short axis of three would keep it from that.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp


class Vector(eqx.Module):
    """Three components, arrays of one shape; products with another vector are by component."""

    x: Any
    y: Any
    z: Any

    def __iter__(self):
        return iter((self.x, self.y, self.z))

    def _with(self, other, combine):
        others = other if isinstance(other, Vector) else (other,) * 3
        return Vector(*(combine(a, b) for a, b in zip(self, others, strict=True)))

    def __add__(self, other):
        return self._with(other, lambda a, b: a + b)

    def __radd__(self, other):  # of a sum, which starts with 0
        return self if isinstance(other, int) and other == 0 else self + other

    def __sub__(self, other):
        return self._with(other, lambda a, b: a - b)

    def __mul__(self, other):
        return self._with(other, lambda a, b: a * b)

    __rmul__ = __mul__

    def __neg__(self):
        return self * -1.0


class Stretched(Vector):
    """Strain of a section that its axis stretches too: twist and bendings, and the stretch `e`. As a vector,
    it is that of twist and bendings.
    """

    e: Any

    def _with(self, other, combine):
        whole = super()._with(other, combine)
        own = other.e if isinstance(other, Stretched) else None if isinstance(other, Vector) else other
        return Stretched(whole.x, whole.y, whole.z, self.e if own is None else combine(self.e, own))


def parts(vector) -> Any:
    """A vector, or where there are four components a strain, from an array whose last axis holds them."""
    if isinstance(vector, Vector):
        return vector
    each = [vector[..., i] for i in range(vector.shape[-1])]
    return Stretched(*each) if len(each) == 4 else Vector(*each)


def joined(vector):
    """The array of a vector, with its components along the last axis."""
    more = [vector.e] if isinstance(vector, Stretched) else []
    return jnp.stack([*vector, *more], axis=-1)


def stretched(vector: Vector, e) -> Stretched:
    """A strain of twist and bendings, and of the stretch."""
    return Stretched(vector.x, vector.y, vector.z, e)


def length_of(strain) -> Any:
    """Length of the axis per length that it has without strain."""
    return 1.0 + strain.e if isinstance(strain, Stretched) else 1.0


def cross(a, b) -> Vector:
    """Cross product of two vectors."""
    (ax, ay, az), (bx, by, bz) = a, b
    return Vector(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)


def dot(a, b):
    """Scalar product of two vectors."""
    (ax, ay, az), (bx, by, bz) = a, b
    return ax * bx + ay * by + az * bz


def applied(rows, vector) -> Vector:
    """A matrix, given by its three rows, times a vector."""
    return Vector(*(dot(row, vector) for row in rows))


def columns_of(rows) -> tuple[Vector, Vector, Vector]:
    """The columns of a matrix given by its rows, or its rows from its columns."""
    a, b, c = (Vector(*column) for column in zip(*rows, strict=True))
    return a, b, c


def inverse(rows) -> tuple[Vector, Vector, Vector]:
    """Rows of the inverse of a 3 x 3 matrix given by its rows."""
    a, b, c = rows
    columns = cross(b, c), cross(c, a), cross(a, b)
    whole = 1.0 / dot(a, columns[0])
    return columns_of([column * whole for column in columns])
