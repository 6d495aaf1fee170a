"""Tendons that disks guide, straight between them.

In a segment between two guides a tendon is a chord from one to the other. Where it crosses a section it has
an offset r from the midline, as in a channel, but one that follows from the shape: with the chord's start d
and direction c in the axes of the section,

    r = d - c (d_x/c_x),    r' such that e1 + u x r + r' is parallel to c.

Its direction changes at the guides only, by the corner between two chords; friction acts there. Where it
enters the base it comes along the direction in which the channel leaves it.

The direction of a chord is unknown until the march has reached its end. So a march takes it from `slopes`, in
the axes of the section where the chord starts, and `search` closes the chords: those of the shape found must
be those that it was found with.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .offset import SpatialOffset
from .space import angle_of, course_of
from .vector import Vector, applied, columns_of, cross, dot, length_of, parts

SHORTEST = 1e-9  # of the length of the body, below which a segment is none


class Guides(eqx.Module):
    """The guides of the tendons; S is the largest number of segments of any.

    Attributes:
        held: which tendons are guided; the others run in a channel, (*tendons,).
        segment: in which segment each node lies, (*tendons, N).
        starts, ends: nodes at which the segments start and end, (*tendons, S); equal where there is none.
        slopes: y and z of the chords, per x, in the axes of the section where they start, (*tendons, S, 2).
    """

    held: Bool[Array, "*tendons"]
    segment: Int[Array, "*tendons N"]
    starts: Int[Array, "*tendons S"]
    ends: Int[Array, "*tendons S"]
    slopes: Float[Array, "*tendons S 2"]

    def begins(self) -> Bool[Array, "*tendons N"]:
        """At which nodes a segment begins."""
        return jnp.diff(self.segment, axis=-1, prepend=-1) > 0

    def along(self) -> Float[Array, "*tendons N 2"]:
        """Slopes of the chord of each node."""
        return jnp.take_along_axis(self.slopes, self.segment[..., None], axis=-2)


def guides_of(
    passed: Bool[Array, "guides N"] | None, beyond: Bool[Array, " N"], s: Float[Array, " N"], segments: int
) -> Guides:
    """The guides of one tendon. One where the tendon ends is its anchor: no segment begins there.

    Args:
        passed: which of them lie before each node; None for a tendon in a channel.
        beyond: which nodes lie past its anchor.
        s: arc length of the nodes [m].
        segments: S.
    """
    segment = jnp.zeros(s.shape[0], int) if passed is None else jnp.sum(passed, axis=0)
    last = jnp.sum(~beyond) - 1
    each = jnp.arange(segments)
    starts = jnp.sum(segment[None, :] < each[:, None], axis=1)
    ends = jnp.sum(segment[None, :] <= each[:, None], axis=1)
    starts, ends = (jnp.minimum(at, last) for at in (starts, ends))
    there = s[ends] - s[starts] > SHORTEST * s[-1]
    ends = jnp.where(there, ends, starts)
    segment = jnp.minimum(segment, jnp.max(jnp.where(there, each, 0)))
    return Guides(jnp.asarray(passed is not None), segment, starts, ends, jnp.zeros((segments, 2)))


class Strung(NamedTuple):
    """What a march carries of guided tendons, in the axes of the base: place of the midline, the midline's
    tangents at the nodes behind, direction of the tendons' chords and where they start.
    """

    place: Vector
    lines: tuple
    chord: Vector
    point: Vector


def offset_on(point: Vector, chord: Vector, strain: Vector) -> SpatialOffset:
    """Offset of a chord from the midline, in the section.

    Args:
        point, chord: a point of it, from the midline [m], and its direction, in the axes of the section.
        strain: of the section [1/m].
    """
    r = point - chord * (point.x / chord.x)
    stretch = (length_of(strain) + strain.y * r.z - strain.z * r.y) / chord.x
    slope = chord.y * stretch + strain.x * r.z, chord.z * stretch - strain.x * r.y
    none = jnp.zeros_like(r.y)
    return SpatialOffset(*(jnp.stack(pair, axis=-1) for pair in ((r.y, r.z), slope, (none, none))))


def direction_of(slopes: Float[Array, "*any 2"], direction) -> Vector:
    """Direction of a chord of some slopes in the axes of the base, of length one."""
    y, z = slopes[..., 0], slopes[..., 1]
    return applied(direction, Vector(jnp.ones_like(y), y, z)) * (1.0 / jnp.sqrt(1.0 + y * y + z * z))


def corner(before: Vector, after: Vector):
    """Angle between two directions [rad], with derivative 0 where there is none."""
    turn = cross(before, after)
    square = dot(turn, turn)
    sine = jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
    return angle_of(sine, dot(before, after))


def either(held: Bool[Array, "*tendons"], guided: Any, own: Any) -> Any:
    """Values of guided tendons, and of those in a channel."""
    return jax.tree_util.tree_map(
        lambda a, b: jnp.where(held.reshape(*held.shape, *[1] * (b.ndim - held.ndim)), a, b), guided, own
    )


class Chords(NamedTuple):
    """Guided tendons on a body of known shape.

    Attributes:
        slopes: of the chords, as of `Guides`.
        offset: of all tendons from the midline, those in a channel included.
        corners: by which the tendons turn at each node [rad], (*tendons, N).
    """

    slopes: Float[Array, "*tendons S 2"]
    offset: SpatialOffset
    corners: Float[Array, "*tendons N"]


def chords_on(
    guides: Guides,
    R: SpatialOffset,
    strain: Float[Array, "N strains"],
    direction: Float[Array, "N 3 3"],
    place: Float[Array, "N 3"],
) -> Chords:
    """The chords of a shape.

    Args:
        guides: of all tendons.
        R: offset of the channels, in which the guides lie.
        strain, direction, place: of the sections and the midline, in the axes of the base.
    """
    if R.value.ndim == 3:
        each = jax.vmap(chords_on, in_axes=(0, 0, None, None, None))
        return each(guides, R, strain, direction, place)
    frames = tuple(parts(direction[:, i, :]) for i in range(3))
    midline, u, none = parts(place), parts(strain), jnp.zeros_like(place[:, 0])
    at = midline + applied(frames, Vector(none, R.value[:, 0], R.value[:, 1]))

    def taken(tree, nodes):
        return jax.tree_util.tree_map(lambda v: v[nodes], tree)

    chord = taken(at, guides.ends) - taken(at, guides.starts)
    own = applied(columns_of(taken(frames, guides.starts)), chord)
    there = guides.ends > guides.starts
    slopes = jnp.stack([own.y, own.z], axis=-1) / jnp.where(there, own.x, 1.0)[:, None]
    slopes = jnp.where(there[:, None], slopes, 0.0)
    outward = direction_of(slopes, taken(frames, guides.starts))
    along, start = taken(outward, guides.segment), taken(taken(at, guides.starts), guides.segment)
    inverse = columns_of(frames)
    offset = offset_on(applied(inverse, start - midline), applied(inverse, along), u)
    offset = either(guides.held, offset, R)
    before = jax.tree_util.tree_map(lambda v: jnp.concatenate([v[:1], v[:-1]]), along)
    turned = jnp.where(guides.begins(), corner(before, along), 0.0)
    entry = corner(entering(taken(u, 0), jax.tree_util.tree_map(lambda r: r[0], R)), taken(along, 0))
    return Chords(slopes, offset, jnp.concatenate([entry[None], turned[1:]]))


def entering(strain: Vector, R: SpatialOffset) -> Vector:
    """Direction in which tendons enter the base, that of their channels there, of length one."""
    w, nu = course_of(strain, tuple((r[..., 0], r[..., 1]) for r in R))
    return w * (1.0 / nu)
