"""Which geometry a robot has, and what follows from its strain along the whole body."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from .geometry import Geometry
from .guides import Chords, chords_on, either
from .mesh import along_nodes, cumulative, derivatives, increments, trapezoids
from .offset import Offset, SpatialOffset
from .plane import PLANE
from .sections import Sections
from .space import SPACE, STRETCHING


def geometry_of(s: Sections) -> Geometry:
    """The geometry of a robot."""
    if not isinstance(s.R, SpatialOffset):
        return PLANE
    return STRETCHING if s.compliance.shape[-1] == 4 else SPACE


def chords_of(s: Sections, strain: Float[Array, "N strains"]) -> Chords:
    """The chords of guided tendons."""
    assert s.guides is not None
    direction = directions_of(s, strain)
    return chords_on(s.guides, s.R, strain, direction, jnp.stack(line_of(s, direction, strain), axis=-1))


def offset_of(s: Sections, strain: Float[Array, "N *strain"]) -> Offset | SpatialOffset:
    """Offset of the tendons from the midline: that of their channels, or of the chords between guides."""
    return s.R if s.guides is None else chords_of(s, strain).offset


def metric_of(s: Sections, strain: Float[Array, "N *strain"]) -> Float[Array, "*tendons N"]:
    """nu = ds_c/ds of the tendons, (*tendons, N); past an anchor, where there is no tendon, zero."""
    return s.ended(geometry_of(s).metric(strain, offset_of(s, strain)))


def turning_of(
    s: Sections, strain: Float[Array, "N *strain"], compact: bool = False
) -> Float[Array, "*tendons N"]:
    """Turning of the tendons between each node and the one before it [rad], (*tendons, N); compact, the body
    turns by the trapezoidal rule.
    """
    geometry, interval = geometry_of(s), s.mesh.interval
    before = jnp.concatenate([jnp.zeros_like(strain[:1]), strain[:-1]])
    take, weights = (trapezoids, interval.length) if compact else (increments, s.mesh.weights)
    turn = geometry.turn(along_nodes(take, weights, strain), strain, before, interval.length)
    rates = None if s.mesh.rates is None else along_nodes(derivatives, s.mesh.rates, strain)
    wrap = geometry.wrap(turn, strain, before, rates, s.R, s.R.before(), interval)
    return wrap if s.guides is None else either(s.guides.held, chords_of(s, strain).corners, wrap)


def directions_of(s: Sections, strain: Float[Array, "N *strain"]) -> Float[Array, "N *frame"]:
    """Directions of the sections."""
    return geometry_of(s).directions(s.mesh.weights, s.mesh.interval, strain)


def line_of(
    s: Sections, direction: Float[Array, "N *frame"], strain: Float[Array, "N *strain"]
) -> tuple[Float[Array, " N"], ...]:
    """Components of the axis' position [m], (N,) each, from the sections' directions and strain."""
    geometry = geometry_of(s)
    stretch = geometry.stretch(strain, s.shift)
    along = geometry.line(geometry.split_direction(direction))
    return tuple(cumulative(s.mesh.weights, c if stretch is None else stretch * c) for c in along)
