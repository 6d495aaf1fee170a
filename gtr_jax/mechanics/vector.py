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


def parts(vector) -> Vector:
    """A vector from an array whose last axis holds its components."""
    return vector if isinstance(vector, Vector) else Vector(*(vector[..., i] for i in range(3)))


def joined(vector):
    """The array of a vector, with its components along the last axis."""
    return jnp.stack([*vector], axis=-1)


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
