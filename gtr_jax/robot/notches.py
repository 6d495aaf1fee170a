"""Notches cut into a tube from one side, as in the wrists of needles and forceps: what is left of the
section, and how far each can close.

The section that a notch leaves is the sector of the tube's ring opposite to the cut. With the outer and inner
radii r_o and r_i and the depth g, its half angle is a = arccos((g - r_o)/r_o). Area, distance of its centroid
from the axis and second moment about the centroid are

    A = a (r_o^2 - r_i^2),   y = 2/3 sin a (r_o^3 - r_i^3)/A,
    I = (r_o^4 - r_i^4)/4 (a + sin a cos a) - A y^2.

The body bends about this centroid, the neutral line, which lies y farther from the tendon than the axis does.
A notch of the height h is closed when its faces meet at the far side, at the angle h/(r_o + y).
These follow from integrals over the sector.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class Remaining(NamedTuple):
    """The section that a notch leaves of a tube, at the nodes, (N,).

    Attributes:
        area: [m^2].
        centroid: its distance from the axis of the tube [m].
        second: second moment about the centroid [m^4].
        reach: distance of the outermost fibre from the centroid [m].
    """

    area: Float[Array, " N"]
    centroid: Float[Array, " N"]
    second: Float[Array, " N"]
    reach: Float[Array, " N"]


def remaining(outer: Float[Array, " N"], inner: Float[Array, " N"], depth: Float[Array, ""]) -> Remaining:
    """The section that a notch leaves.

    Args:
        outer, inner: radii of the tube [m].
        depth: of the notch, from the outside [m]; more than the outer radius, less than the diameter.
    """
    half = jnp.arccos(jnp.clip((depth - outer) / outer, -1.0 + 1e-9, 1.0 - 1e-9))
    area = half * (outer**2 - inner**2)
    centroid = 2 / 3 * jnp.sin(half) * (outer**3 - inner**3) / area
    second = (outer**4 - inner**4) / 4 * (half + jnp.sin(half) * jnp.cos(half)) - area * centroid**2
    reach = jnp.maximum(outer - centroid, centroid - inner * jnp.cos(half))
    return Remaining(area, centroid, second, reach)


class Notches(eqx.Module):
    """A row of equal notches.

    Attributes:
        start: arc length where the first begins [m].
        height: along the body [m].
        spacing: uncut length between two [m].
        depth: from the outside [m].
        end_correction: length by which each bends as if it were longer than it is cut [m]; negative where
            rounded corners make it stiffer.
        natural_angle: by which each is bent without load [rad], (count,).
        side: of the body that is cut: 1.0 left, -1.0 right (static).
    """

    start: Float[Array, ""]
    height: Float[Array, ""]
    spacing: Float[Array, ""]
    depth: Float[Array, ""]
    end_correction: Float[Array, ""]
    natural_angle: Float[Array, " count"]
    side: float = eqx.field(static=True)

    @property
    def count(self) -> int:
        """How many there are."""
        return self.natural_angle.shape[0]

    @property
    def ends(self) -> tuple[Float[Array, " count"], Float[Array, " count"]]:
        """Arc lengths [m] where the notches begin and end."""
        start = self.start + jnp.arange(self.count, dtype=float) * (self.height + self.spacing)
        return start, start + self.height


class Cut(NamedTuple):
    """What notches make of the body at its nodes, (N,) each; outside of them as without.

    Attributes:
        within: whether a node lies in a notch.
        section: what is left of the section there, with the second moment and the reach of one that bends
            over the height of the cut alone.
        side: of the body that is cut, 1.0 or -1.0; 0.0 outside.
        natural: natural curvature that they add [1/m].
        limit: curvature towards the side of the cut at which a notch is closed [1/m].
    """

    within: Bool[Array, " N"]
    section: Remaining
    side: Float[Array, " N"]
    natural: Float[Array, " N"]
    limit: Float[Array, " N"]


def cut(
    rows: tuple[Notches, ...],
    within: Bool[Array, "notches N"],
    outer: Float[Array, " N"],
    inner: Float[Array, " N"],
) -> Cut:
    """What rows of notches make of the body.

    Args:
        rows: the rows; at least one.
        within: which notch, of all rows in their order, each node lies in.
        outer, inner: radii of the tube there [m].
    """
    zero = jnp.zeros_like(outer)
    found = Cut(zero > 1, Remaining(*(zero + 1.0,) * 4), zero, zero, zero + 1.0)
    first = 0
    for row in rows:
        own = within[first : first + row.count]
        first += row.count
        here, left = jnp.any(own, axis=0), remaining(outer, inner, row.depth)
        # At the same moment and angle, what bends is longer by the correction, and so less strained.
        longer = 1.0 + row.end_correction / row.height
        left = left._replace(second=left.second / longer, reach=left.reach / longer)
        angle = jnp.sum(jnp.where(own, row.natural_angle[:, None], 0.0), axis=0)
        natural, closes = row.side * angle / row.height, 1.0 / (outer + left.centroid)
        found = Cut(
            found.within | here,
            Remaining(*(jnp.where(here, new, old) for new, old in zip(left, found.section, strict=True))),
            jnp.where(here, row.side, found.side),
            jnp.where(here, natural, found.natural),
            jnp.where(here, closes, found.limit),
        )
    return found
