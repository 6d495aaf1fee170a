"""How far the body keeps away from obstacles at every target."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gtr_jax.robot.robot import Robot

from .limits import to_segments
from .model import States

BETWEEN = 16  # places in each interval of the mesh: between them the gap is off by micrometres


class Obstacles(eqx.Module):
    """O rods with round ends, balls among them.

    Attributes:
        start, end: of their axes [m], (O, axes).
        radius: [m], (O,).
    """

    start: Float[Array, "O axes"]
    end: Float[Array, "O axes"]
    radius: Float[Array, " O"]


@eqx.filter_jit
def gaps(robot: Robot, states: States, obstacles: Obstacles) -> Float[Array, "O S intervals"]:
    """Least distance between body and obstacles in each interval of the mesh [m], negative inside.

    The body is taken as all balls about its midline that are as large as its sections.

    Args:
        robot: the design.
        states: S of its states.
        obstacles: O of them.
    """
    places, s = places_between(states)
    room = robot.backbone.radius(s.ravel()).reshape(1, 1, *s.shape)
    start, end = obstacles.start[:, None, None, None], obstacles.end[:, None, None, None]
    apart = to_segments(places[None], start, end) - room - obstacles.radius[:, None, None, None]
    return jnp.min(apart, axis=-1)


def places_between(states: States) -> tuple[Float[Array, "S n b axes"], Float[Array, "n b"]]:
    """Places of the midline in every interval of the mesh, and their arc lengths [m]: cubics between the
    nodes, with their directions.
    """
    u = jnp.linspace(0.0, 1.0, BETWEEN + 1)
    h = jnp.diff(states.s)
    s = states.s[:-1, None] + h[:, None] * u[None]
    u = u[None, None, :, None]
    rise, first, last = u * u * (3.0 - 2.0 * u), u * (1.0 - u) ** 2, u * u * (u - 1.0)
    a, b = states.midline[:, :-1, None], states.midline[:, 1:, None]
    da, db = states.tangent[:, :-1, None], states.tangent[:, 1:, None]
    return a + (b - a) * rise + h[None, :, None, None] * (first * da + last * db), s
