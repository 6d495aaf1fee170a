"""The limits of a design as margins: non-negative where kept, 1 where a whole scale away.

Limits on the channel alone are checked at stations of their own, close together and on both sides of every
kink, so that no bend hides between the nodes of the mesh.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gtr_jax.mechanics.channel import turning_rate
from gtr_jax.mechanics.offset import Offset, SpatialOffset
from gtr_jax.mechanics.space import SPACE
from gtr_jax.robot.parts import Tendon
from gtr_jax.robot.robot import Robot
from gtr_jax.robot.routing import StraightSineStraight

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
APART, OBSTACLE = "channel_clearance", "obstacle_clearance"


class LimitValues(eqx.Module):
    """The numbers of the limits, SI; limits that are not given are ignored.

    Attributes:
        wall, bore: least distance of the channel's centre line from the outer surface and from a bore [m].
        apart: least distance between the centre lines of two channels [m].
        obstacle: least distance between body and obstacle [m].
        radius: least radius of curvature [m].
        loss: largest share lost. tip: least tip tension [N].
        base_slope, tip_slope: largest angle between channel and midline [rad].
    """

    wall: Float[Array, ""]
    bore: Float[Array, ""]
    apart: Float[Array, ""]
    obstacle: Float[Array, ""]
    radius: Float[Array, ""]
    loss: Float[Array, ""]
    tip: Float[Array, ""]
    base_slope: Float[Array, ""]
    tip_slope: Float[Array, ""]


class Stations(NamedTuple):
    """One channel at M places, ends of bores and kinks among them (kinks from both sides).

    s: arc length [m], (M,). R: offset and its derivatives, (M,), in space (M, 2). bored: which bores the
    place touches, (bores, M).
    """

    s: Float[Array, " M"]
    R: Offset | SpatialOffset
    bored: Bool[Array, "bores M"]

    @property
    def away(self) -> Float[Array, " M"]:
        """Distance of the channel from the midline [m], (M,)."""
        return jnp.abs(self.R.value) if isinstance(self.R, Offset) else _norm(self.R.value)

    @property
    def slant(self) -> Float[Array, " M"]:
        """Angle between channel and midline [rad], (M,), of a straight body."""
        size = jnp.abs(self.R.slope) if isinstance(self.R, Offset) else _norm(self.R.slope)
        return jnp.arctan(size)

    @property
    def line(self) -> Float[Array, "M 3"]:
        """Places of the channel in the straight body [m], (M, 3)."""
        across = self.R.value
        if isinstance(self.R, Offset):
            across = jnp.stack([across, jnp.zeros_like(across)], axis=-1)
        return jnp.concatenate([self.s[:, None], across], axis=-1)


def _norm(vectors: Float[Array, "*any axes"]) -> Float[Array, "*any"]:
    """Length of vectors, with derivative 0 at 0."""
    square = jnp.sum(vectors**2, axis=-1)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def stations_of(robot: Robot, tendon: Tendon, count: int) -> Stations:
    """A channel of a robot at `count` even places, close together between its kinks, and at kinks and ends of
    bores; as far as its tendon runs.
    """
    body, routing = robot.backbone, tendon.routing
    end = body.length if tendon.to is None else tendon.to
    kinks = jnp.clip(routing.kinks(), None, end)
    k = kinks.shape[0]
    even = jnp.linspace(0.0, 1.0, count) * end
    if k > 1:
        within = kinks[0] + jnp.linspace(0.0, 1.0, BETWEEN + 2)[1:-1] * (kinks[-1] - kinks[0])
        even, count = jnp.concatenate([even, within]), count + BETWEEN
    bores = [jnp.clip(ends, None, end) for ends in (body.bore_start, body.bore_end)]
    s = jnp.concatenate([even, kinks, kinks, *bores])
    passed = kinks[:, None] <= s[None, :]
    before = ~jnp.eye(k, dtype=bool)  # seen from before, a kink has not passed itself
    own = passed[:, count : count + k] & before
    passed = jnp.concatenate([passed[:, :count], own, passed[:, count + k :]], axis=1)
    near = 1e-9 * body.length
    bored = (body.bore_start[:, None] - near <= s[None]) & (s[None] <= body.bore_end[:, None] + near)
    offset = routing.section_offset if robot.space else routing.offset
    return Stations(s, offset(s, passed, body.length), bored)


def all_stations(robot: Robot, count: int) -> tuple[Stations, ...]:
    """The stations of every channel."""
    return tuple(stations_of(robot, tendon, count) for tendon in robot.tendons)


def channel_margins(
    robot: Robot, stations: tuple[Stations, ...], limits: LimitValues, given: tuple[str, ...]
) -> dict[str, Float[Array, " _"]]:
    """Margins of the channels, by limit, each with as many rows as it has places.

    Args:
        robot: the design.
        stations: its channels.
        limits: their numbers.
        given: names of those that are checked (static).
    """
    each = [
        _margins(robot, tendon, at, limits, given) for tendon, at in zip(robot.tendons, stations, strict=True)
    ]
    names = dict.fromkeys(itertools.chain(*each))
    margins = {name: jnp.concatenate([own[name] for own in each if name in own]) for name in names}
    if APART in given:
        size = jnp.max(robot.backbone.outer_radius)
        gaps = [channel_gap(one, other) for one, other in itertools.combinations(stations, 2)]
        margins[APART] = (jnp.concatenate(gaps) - limits.apart) / size
    return margins


def _margins(
    robot: Robot, tendon: Tendon, at: Stations, limits: LimitValues, given: tuple[str, ...]
) -> dict[str, Float[Array, " _"]]:
    """Margins of one channel."""
    body, R = robot.backbone, at.R
    size = jnp.max(body.outer_radius)
    room = (body.radius(at.s) - limits.wall) / size
    sides = [R.value, -R.value] if isinstance(R, Offset) else [at.away]
    margins = {WALL: jnp.concatenate([room - side / size for side in sides])}
    if body.bore_diameter.shape[0] and BORE in given:
        apart = (at.away[None] - 0.5 * body.bore_diameter[:, None] - limits.bore) / size
        margins[BORE] = jnp.where(at.bored, apart, FAR).ravel()
    if RADIUS in given:
        margins[RADIUS] = 1.0 - limits.radius * jnp.abs(channel_curvature(robot, at))
    if BASE_SLOPE in given:
        margins[BASE_SLOPE] = limits.base_slope - at.slant[:1]
    if TIP_SLOPE in given:
        last = jnp.argmax(at.s)
        margins[TIP_SLOPE] = (limits.tip_slope - at.slant[last])[None]
    if WAVE in given and isinstance(tendon.routing, StraightSineStraight):
        kinks = tendon.routing.kinks()
        margins[WAVE] = (kinks[1:] - kinks[:1]) / body.length - LEAST_WAVE
    return margins


def channel_curvature(robot: Robot, at: Stations) -> Float[Array, " M"]:
    """Curvature of the channel's centre line in the unloaded body [1/m], (M,); in the plane positive to the
    left.
    """
    body = robot.backbone
    rest = body.strain_at_rest if isinstance(at.R, SpatialOffset) else body.curvature_at_rest
    kappa = rest(at.s)
    ahead, step = at.s + 1e-6 * body.length, 1e-6 * body.length
    slope = (rest(ahead) - kappa) / step
    if isinstance(at.R, SpatialOffset):
        return SPACE.bend(kappa, slope, at.R)
    a = 1.0 - at.R.value * kappa
    return turning_rate(kappa, slope, at.R) / jnp.hypot(a, at.R.slope)


def channel_gap(one: Stations, other: Stations) -> Float[Array, " M"]:
    """Distance of every place of one channel from the nearest point of another, in the straight body [m],
    (M,); the other is a polygon through its places.
    """
    order = jnp.argsort(other.s)
    points = other.line[order]
    return jnp.min(to_segments(one.line[:, None], points[:-1][None], points[1:][None]), axis=1)


def to_segments(
    points: Float[Array, "*any axes"], start: Float[Array, "*any axes"], end: Float[Array, "*any axes"]
) -> Float[Array, "*any"]:
    """Distance of points from the segments between start and end [m]."""
    along = end - start
    square = jnp.sum(along**2, axis=-1)
    part = jnp.sum((points - start) * along, axis=-1) / jnp.where(square > 0, square, 1.0)
    return _norm(points - start - jnp.clip(part, 0.0, 1.0)[..., None] * along)
