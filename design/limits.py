"""The limits of a design as margins: non-negative where kept, 1 where a whole scale away.

Limits on the channel alone are checked at stations of their own, close together and on both sides of every
kink, so that no bend hides between the nodes of the mesh.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gtr_jax.mechanics.channel import turning_rate
from gtr_jax.mechanics.offset import Offset
from gtr_jax.robot.robot import Robot

LEAST_WAVE = 0.02  # least w2 - w1, of the length
FAR = 1.0  # margin at places that a limit does not concern
BETWEEN = 48  # stations between the kinks, where the channel bends

WALL, BORE, RADIUS, BASE_SLOPE, TIP_SLOPE, WAVE = (
    "wall_clearance",
    "bore_clearance",
    "min_channel_radius",
    "max_base_slope",
    "max_tip_slope",
    "wave_length",
)
LOSS, TIP, RELEASE = "max_tension_loss", "min_T_tip", "T_base before release"


class LimitValues(eqx.Module):
    """The numbers of the limits, SI; limits that are not given are ignored.

    Attributes:
        wall, bore: least distance of the channel's centre line from the outer surface and from a bore [m].
        radius: least radius of curvature [m].
        loss: largest share lost. tip: least tip tension [N].
        base_slope, tip_slope: largest angle between channel and midline [rad].
    """

    wall: Float[Array, ""]
    bore: Float[Array, ""]
    radius: Float[Array, ""]
    loss: Float[Array, ""]
    tip: Float[Array, ""]
    base_slope: Float[Array, ""]
    tip_slope: Float[Array, ""]


class Stations(NamedTuple):
    """The channel at M places, ends of bores and kinks among them (kinks from both sides).

    s: arc length [m], (M,). R: offset and its derivatives, (M,). bored: which bores the place touches,
    (bores, M).
    """

    s: Float[Array, " M"]
    R: Offset
    bored: Bool[Array, "bores M"]


def stations_of(robot: Robot, count: int) -> Stations:
    """The channel of a robot at `count` even places, close together between its kinks, and at kinks and ends
    of bores.
    """
    body, routing = robot.backbone, robot.routing
    kinks = routing.kinks()
    k = kinks.shape[0]
    even = jnp.linspace(0.0, 1.0, count) * body.length
    if k > 1:
        within = kinks[0] + jnp.linspace(0.0, 1.0, BETWEEN + 2)[1:-1] * (kinks[-1] - kinks[0])
        even, count = jnp.concatenate([even, within]), count + BETWEEN
    s = jnp.concatenate([even, kinks, kinks, body.bore_start, body.bore_end])
    passed = kinks[:, None] <= s[None, :]
    before = ~jnp.eye(k, dtype=bool)  # seen from before, a kink has not passed itself
    own = passed[:, count : count + k] & before
    passed = jnp.concatenate([passed[:, :count], own, passed[:, count + k :]], axis=1)
    near = 1e-9 * body.length
    bored = (body.bore_start[:, None] - near <= s[None]) & (s[None] <= body.bore_end[:, None] + near)
    return Stations(s, routing.offset(s, passed, body.length), bored)


def channel_margins(
    robot: Robot, at: Stations, limits: LimitValues, given: tuple[str, ...]
) -> dict[str, Float[Array, " _"]]:
    """Margins of the channel, by limit, each with as many rows as it has places.

    Args:
        robot: the design.
        at: its channel.
        limits: their numbers.
        given: names of those that are checked (static).
    """
    body, R = robot.backbone, at.R
    size = jnp.max(body.outer_radius)
    room = (body.radius(at.s) - limits.wall) / size
    margins = {WALL: jnp.concatenate([room - R.value / size, room + R.value / size])}
    if body.bore_diameter.shape[0] and BORE in given:
        apart = (jnp.abs(R.value)[None] - 0.5 * body.bore_diameter[:, None] - limits.bore) / size
        margins[BORE] = jnp.where(at.bored, apart, FAR).ravel()
    if RADIUS in given:
        margins[RADIUS] = 1.0 - limits.radius * jnp.abs(channel_curvature(robot, at))
    if BASE_SLOPE in given:
        margins[BASE_SLOPE] = limits.base_slope - jnp.abs(jnp.arctan(R.slope[:1]))
    if TIP_SLOPE in given:
        last = jnp.argmax(at.s)
        margins[TIP_SLOPE] = (limits.tip_slope - jnp.abs(jnp.arctan(R.slope[last])))[None]
    if WAVE in given:
        kinks = robot.routing.kinks()
        margins[WAVE] = (kinks[1:] - kinks[:1]) / body.length - LEAST_WAVE
    return margins


def channel_curvature(robot: Robot, at: Stations) -> Float[Array, " M"]:
    """Curvature of the channel's centre line in the unloaded body [1/m], (M,), positive to the left."""
    body = robot.backbone
    kappa = body.curvature_at_rest(at.s)
    ahead, step = at.s + 1e-6 * body.length, 1e-6 * body.length
    slope = (body.curvature_at_rest(ahead) - kappa) / step
    a = 1.0 - at.R.value * kappa
    return turning_rate(kappa, slope, at.R) / jnp.hypot(a, at.R.slope)
