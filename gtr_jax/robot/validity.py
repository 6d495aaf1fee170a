"""Whether numbers make a valid robot, checked inside the compiled program, where values are traced: those of
a transformed function, or of a grid, which may contain invalid combinations, such as a wave that ends before
it begins, which a check of its ends does not find.
"""

from __future__ import annotations

import itertools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from .clearance import TOUCHING
from .parameters import bounded
from .parts import Tendon
from .robot import Layout, Robot, lay_out
from .routing import StraightSineStraight
from .shapes import Tube


def is_robot(robot: Robot) -> Bool[Array, ""]:
    """Whether every number is within its bounds (stiffnesses above zero, friction not below), the channels
    lie inside the body, the bores and what carries the load too, and positions along the body are in order.
    """
    body, at = robot.backbone, lay_out(robot)
    radius = body.radius(at.mesh.s)
    holds = [_within_bounds(robot), jnp.all(jnp.isfinite(radius))]
    for tendon, passed, beyond in zip(robot.tendons, at.passed, at.beyond, strict=True):
        if robot.space:
            place = tendon.routing.section_offset(at.mesh.s, passed, body.length).value
            holds.append(jnp.all((jnp.sum(place**2, axis=-1) < radius**2) | beyond))
            holds += _held(tendon, body.length)
        else:
            offset = tendon.routing.offset(at.mesh.s, passed, body.length).value
            holds.append(jnp.all(jnp.abs(offset) < radius))
        if isinstance(tendon.routing, StraightSineStraight):
            w1, w2 = tendon.routing.w1, tendon.routing.w2
            holds.append((w1 >= 0) & (w1 < w2) & (w2 <= body.length * (1 + NEAR)))
    if robot.space:
        turned = jnp.sum(robot.base.rotation_vector**2)
        holds += [turned <= (2 * jnp.pi * (1 + NEAR)) ** 2, body.poissons_ratio > -1.0]
        holds += _own_channels(robot, at)
    holds += _apart(jnp.asarray(body.piece_start), jnp.asarray(body.piece_end), body.length)
    if body.bore_start.shape[0]:
        slimmest = jnp.minimum(body.radius(body.bore_start), body.radius(body.bore_end))
        holds.append(jnp.all(body.bore_diameter < 2 * slimmest))
        holds += _apart(body.bore_start, body.bore_end, body.length)
    if isinstance(body.shape, Tube):
        holds.append(
            (body.shape.inner_diameter >= 0) & (body.shape.inner_diameter < body.shape.outer_diameter)
        )
    if body.shape is not None:
        holds.append(body.shape.extent() <= jnp.min(radius) * (1 + NEAR))
    if body.notches:
        holds += _apart(body.notch_start, body.notch_end, body.length)
        for row in body.notches:
            outer = body.radius(jnp.concatenate(row.ends))
            holds += [jnp.all(row.depth > outer), jnp.all(row.depth < 2 * outer), row.height > 0]
    return jnp.all(jnp.stack(holds))


def _within_bounds(robot: Robot) -> Bool[Array, ""]:
    """Whether the numbers are finite and within their bounds, but for rounding."""
    values, least, most, above = bounded(robot)
    near = NEAR * np.where(np.isfinite(least), np.abs(least), 0.0), NEAR * np.abs(most)
    inside = (values >= least - near[0]) & (values <= np.where(np.isfinite(most), most + near[1], np.inf))
    return jnp.all(jnp.isfinite(values) & inside & ((values > least) | ~above))


def _apart(start: Array, end: Array, length: Array) -> list[Bool[Array, ""]]:
    """Whether stretches of the body lie inside it, none over another."""
    if not start.shape[0]:
        return []
    order = jnp.argsort(start)
    follow = start[order][1:] >= end[order][:-1] - NEAR * length
    inside = (start >= 0) & (end <= length * (1 + NEAR))
    return [jnp.all(inside), jnp.all(start < end), jnp.all(follow)]


def _held(tendon: Tendon, length: Array) -> list[Bool[Array, ""]]:
    """Whether a tendon ends on the body, and its guides lie in order before its end."""
    holds, end = [], length if tendon.to is None else tendon.to
    if tendon.to is not None:
        holds.append((end > 0) & (end <= length * (1 + NEAR)))
    if tendon.guides is not None:
        holds += [tendon.guides[0] > 0, jnp.all(jnp.diff(tendon.guides) > 0)]
        holds.append(tendon.guides[-1] <= end * (1 + NEAR))
    return holds


def _own_channels(robot: Robot, at: Layout) -> list[Bool[Array, ""]]:
    """Whether no tendon runs in the channel of another all along."""
    each = zip(robot.tendons, at.passed, at.beyond, strict=True)
    runs = [
        (t.routing.section_offset(at.mesh.s, p, robot.backbone.length).value, past) for t, p, past in each
    ]
    return [
        jnp.any((jnp.sum((one - other) ** 2, axis=-1) > TOUCHING**2) & ~past & ~ended)
        for (one, past), (other, ended) in itertools.combinations(runs, 2)
    ]


NEAR = 1e-9  # relative tolerance of positions, as in the check of a robot file
