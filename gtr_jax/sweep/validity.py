"""Whether numbers make a valid robot, checked inside the compiled program: a grid may contain invalid
combinations, such as a wave that ends before it begins, which a check of its ends does not find.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool

from gtr_jax.robot.robot import Robot, lay_out
from gtr_jax.robot.routing import StraightSineStraight


def is_robot(robot: Robot) -> Bool[Array, ""]:
    """Whether the channels lie inside the body, the bores too, and positions along the body are in order."""
    body, at = robot.backbone, lay_out(robot)
    radius = body.radius(at.mesh.s)
    holds = [body.length > 0, jnp.all(body.outer_radius > 0), jnp.all(jnp.isfinite(radius))]
    for tendon, passed in zip(robot.tendons, at.passed, strict=True):
        offset = tendon.routing.offset(at.mesh.s, passed, body.length).value
        holds.append(jnp.all(jnp.abs(offset) < radius))
        if isinstance(tendon.routing, StraightSineStraight):
            w1, w2 = tendon.routing.w1, tendon.routing.w2
            holds.append((w1 >= 0) & (w1 < w2) & (w2 <= body.length * (1 + NEAR)))
    if body.bore_start.shape[0]:
        inside = (body.bore_start >= 0) & (body.bore_end <= body.length * (1 + NEAR))
        slimmest = jnp.minimum(body.radius(body.bore_start), body.radius(body.bore_end))
        narrow = body.bore_diameter < 2 * slimmest
        holds += [jnp.all(inside), jnp.all(narrow), jnp.all(body.bore_start < body.bore_end)]
        order = jnp.argsort(body.bore_start)
        apart = body.bore_start[order][1:] >= body.bore_end[order][:-1] - NEAR * body.length
        holds.append(jnp.all(apart))
    return jnp.all(jnp.stack(holds))


NEAR = 1e-9  # relative tolerance of positions, as in the check of a robot file
