"""Where markers stand: points fixed to sections of the body, between its nodes too."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics.mesh import cumulative
from ..robot.robot import Robot, lay_out
from .history import Simulation
from .solution import Shape


def shape_in_plane(robot: Robot, curvature: Float[Array, "K N"], angle: Float[Array, "K N"]) -> Shape:
    """The shape in space of a body that stays in its plane, at K steps.

    Args:
        robot: as simulated.
        curvature: of the midline [1/m].
        angle: of the midline [rad].
    """
    weights = lay_out(robot).mesh.weights
    along, across = jnp.cos(angle), jnp.sin(angle)
    nil, one = jnp.zeros_like(angle), jnp.ones_like(angle)
    x, y = (jax.vmap(lambda slope: cumulative(weights, slope))(slope) for slope in (along, across))
    rows = ((along, -across, nil), (across, along, nil), (nil, nil, one))
    return Shape(
        strain=jnp.stack([nil, nil, curvature], axis=-1),
        rotation=jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2),
        position=jnp.stack([x, y, nil], axis=-1),
    )


@eqx.filter_jit
def marker_places(robot: Robot, run: Simulation) -> Float[Array, "K markers 3"]:
    """Places of the robot's markers in the world at every step [m]; see `markers_on`.

    Args:
        robot: as simulated.
        run: its simulation.
    """
    shape = shape_in_plane(robot, run.curvature, run.angle) if run.shape is None else run.shape
    return markers_on(robot, run.s, shape)


def markers_on(robot: Robot, s: Float[Array, " N"], shape: Shape) -> Float[Array, "K markers 3"]:
    """Places of the robot's markers in the world [m], of order four in the mesh.

    Args:
        robot: whose markers they are.
        s: its nodes [m].
        shape: of its body at K steps.
    """
    if not robot.markers:
        return jnp.zeros((shape.position.shape[0], 0, 3))
    at = jnp.stack([marker.at for marker in robot.markers])
    offset = jnp.stack([marker.offset for marker in robot.markers])
    return jax.vmap(lambda one: _places(s, one, at, offset))(shape)


def _places(
    s: Float[Array, " N"], shape: Shape, at: Float[Array, " markers"], offset: Float[Array, "markers 3"]
) -> Float[Array, "markers 3"]:
    """Hermite's cubic between the nodes about each marker: p + D o runs along D (e1 + u x o)."""
    before = jnp.clip(jnp.searchsorted(s, at, side="right") - 1, 0, s.shape[0] - 2)
    length = s[before + 1] - s[before]
    x = ((at - s[before]) / length)[:, None]

    def of(node):
        frame = shape.rotation[node]
        along = jnp.asarray([[1.0, 0.0, 0.0]]) + jnp.cross(shape.strain[node], offset)
        return shape.position[node] + _turned(frame, offset), length[:, None] * _turned(frame, along)

    (start, leaves), (end, arrives) = of(before), of(before + 1)
    return (
        (1 + 2 * x) * (1 - x) ** 2 * start
        + x * (1 - x) ** 2 * leaves
        + x**2 * (3 - 2 * x) * end
        + x**2 * (x - 1) * arrives
    )


def _turned(
    frames: Float[Array, "markers 3 3"], vectors: Float[Array, "markers 3"]
) -> Float[Array, "markers 3"]:
    return jnp.sum(frames * vectors[:, None, :], axis=-1)
