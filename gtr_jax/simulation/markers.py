"""Where markers stand: points fixed to sections of the body, between its nodes too."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.bodies import line_of
from ..robot.robot import Robot, sections
from .arrays import SimulationArrays
from .shape import Shape

READ = ("x", "y", "z", "angle")  # of a marker, as a recording's quantities end


def shape_in_plane(robot: Robot, curvature: Float[Array, "K N"], angle: Float[Array, "K N"]) -> Shape:
    """The shape in space of a body that stays in its plane, at K steps.

    Args:
        robot: as simulated.
        curvature: of the midline [1/m].
        angle: of the midline [rad].
    """
    s = sections(robot)
    along, across = jnp.cos(angle), jnp.sin(angle)
    nil, one = jnp.zeros_like(angle), jnp.ones_like(angle)
    x, y = jax.vmap(functools.partial(line_of, s))(angle, curvature)
    rows = ((along, -across, nil), (across, along, nil), (nil, nil, one))
    return Shape(
        strain=jnp.stack([nil, nil, curvature], axis=-1),
        rotation=jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2),
        position=jnp.stack([x, y, nil], axis=-1),
        stretch=None if s.shift is None else -s.shift[None] * curvature,  # beside the neutral line
    )


def marker_places(robot: Robot, run: SimulationArrays) -> Float[Array, "K markers 3"]:
    """Places of the robot's markers in the world at every step [m]; arguments as of `marker_readings`."""
    return marker_readings(robot, run)[..., :3]


def marker_angles(robot: Robot, run: SimulationArrays) -> Float[Array, "K markers"]:
    """Angles of the sections of the robot's markers at every step [rad]; as `marker_readings`."""
    return marker_readings(robot, run)[..., 3]


@eqx.filter_jit
def marker_readings(robot: Robot, run: SimulationArrays) -> Float[Array, "K markers 4"]:
    """Places of the robot's markers in the world at every step [m], and the angles of their sections [rad];
    see `markers_on`.

    Args:
        robot: as simulated.
        run: its simulation.
    """
    shape = shape_in_plane(robot, run.curvature, run.angle) if run.shape is None else run.shape
    return markers_on(robot, run.s, shape)


def marker_rows(robot: Robot, places: Any) -> dict[str, Any]:
    """What `markers_on` gives, by the names of a recording's quantities, (K,) each."""
    return {
        f"{marker.name}_{name}": places[:, n, i]
        for n, marker in enumerate(robot.markers)
        for i, name in enumerate(READ)
    }


def markers_on(robot: Robot, s: Float[Array, " N"], shape: Shape) -> Float[Array, "K markers 4"]:
    """Places of the robot's markers in the world [m], of order four in the mesh; and the angles of their
    sections from the ones that they are counted from [rad]: of a robot in the plane positive to the left, of
    one in space the angle between the two tangents of the midline.

    Args:
        robot: whose markers they are.
        s: its nodes [m].
        shape: of its body at K steps.
    """
    if not robot.markers:
        return jnp.zeros((shape.position.shape[0], 0, 4))
    at = jnp.stack([marker.at for marker in robot.markers])
    start = jnp.stack([marker.angle_from for marker in robot.markers])
    offset = jnp.stack([marker.offset for marker in robot.markers])

    def one(shape):
        angle = _turn if robot.space else _angle
        turned = angle(s, shape, at, start)
        return jnp.concatenate([_places(s, shape, at, offset), turned[:, None]], axis=1)

    return jax.vmap(one)(shape)


def _angle(s, shape: Shape, at, start) -> Float[Array, " markers"]:
    """Angle of a section of a body in the plane from another one [rad], by Hermite's cubic of its angle."""
    # The angle of the midline may be beyond a turn; its increments between neighbouring nodes are not.
    rotation = shape.rotation
    sine = rotation[:-1, 0, 0] * rotation[1:, 1, 0] - rotation[:-1, 1, 0] * rotation[1:, 0, 0]
    cosine = rotation[:-1, 0, 0] * rotation[1:, 0, 0] + rotation[:-1, 1, 0] * rotation[1:, 1, 0]
    phi = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.arctan2(sine, cosine))])

    def of(node):
        return phi[node], shape.strain[node, 2]

    return _between(s, at, of) - _between(s, start, of)


def _turn(s, shape: Shape, at, start) -> Float[Array, " markers"]:
    """Angle between the tangents of the midline at two sections [rad]."""

    def of(node):
        frame, strain = shape.rotation[node], shape.strain[node]
        return frame[:, :, 0], strain[:, 2:3] * frame[:, :, 1] - strain[:, 1:2] * frame[:, :, 2]

    def tangent(place):
        found = _between(s, place, of)
        return found / jnp.linalg.norm(found, axis=1, keepdims=True)

    one, other = tangent(start), tangent(at)
    across = jnp.sum(jnp.cross(one, other) ** 2, axis=1)
    sine = jnp.where(across > 0, jnp.sqrt(jnp.where(across > 0, across, 1.0)), 0.0)
    return jnp.arctan2(sine, jnp.sum(one * other, axis=1))


def _between(
    s: Float[Array, " N"], at: Float[Array, " markers"], of: Callable[[Array], tuple[Array, Array]]
) -> Float[Array, "markers *any"]:
    """Hermite's cubic at places between the nodes.

    Args:
        s: nodes [m].
        at: the places [m].
        of: the quantity and its derivative by s at given nodes, (markers, ...) each.
    """
    before = jnp.clip(jnp.searchsorted(s, at, side="right") - 1, 0, s.shape[0] - 2)
    (start, leaves), (end, arrives) = of(before), of(before + 1)

    def along(values: Float[Array, " markers"]) -> Array:
        return values.reshape(-1, *[1] * (start.ndim - 1))

    length = s[before + 1] - s[before]
    x, length = along((at - s[before]) / jnp.where(length > 0, length, 1.0)), along(length)
    return (
        (1 + 2 * x) * (1 - x) ** 2 * start
        + x * (1 - x) ** 2 * length * leaves
        + x**2 * (3 - 2 * x) * end
        + x**2 * (x - 1) * length * arrives
    )


def _places(
    s: Float[Array, " N"], shape: Shape, at: Float[Array, " markers"], offset: Float[Array, "markers 3"]
) -> Float[Array, "markers 3"]:
    """Places of points of sections: p + D o runs along D ((1 + e) e1 + u x o)."""

    def of(node):
        frame = shape.rotation[node]
        axis = jnp.asarray([[1.0, 0.0, 0.0]])
        axis = axis if shape.stretch is None else (1.0 + shape.stretch[node])[:, None] * axis
        along = axis + jnp.cross(shape.strain[node], offset)
        return shape.position[node] + _turned(frame, offset), _turned(frame, along)

    return _between(s, at, of)


def _turned(
    frames: Float[Array, "markers 3 3"], vectors: Float[Array, "markers 3"]
) -> Float[Array, "markers 3"]:
    return jnp.sum(frames * vectors[:, None, :], axis=-1)
