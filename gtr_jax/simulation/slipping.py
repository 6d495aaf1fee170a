"""Where, and in which direction, the tendons slip in a load step."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..mechanics import ProgramSpec, Step
from ..mechanics.sections import Sections
from .solution import Loaded

SLIP_TOLERANCE = 1e-8  # share of the length, or of the largest tension, below which nothing moved
MOBILISED = 0.9  # share of its friction at which a tendon with presliding counts as slipping


def large_tension(T_base: Float[Array, "K *tendons"], preload: Float[Array, "*any"]) -> Float[Array, ""]:
    """A tension that counts as large in a history [N]."""
    return jnp.maximum(jnp.max(T_base), jnp.maximum(jnp.max(preload), 1e-6))


def moves_by_tension(
    tension: Float[Array, "*tendons N"],
    before: Float[Array, "*tendons N"],
    scale: Float[Array, ""],
):
    """Direction of slip along one tendon, (*tendons, N), from its tension and that before [N]; `scale` is a
    tension that counts as large [N].
    """
    change = tension - before
    return jnp.where(jnp.abs(change) > SLIP_TOLERANCE * scale, jnp.sign(change), 0.0)


def moves_by_friction(xi: Float[Array, "tendons N"]):
    """Direction of slip along several tendons, (tendons, N), from the unknown of their friction law."""
    slipped = jnp.concatenate([xi[..., 1:2], xi[..., 1:]], axis=-1)
    return jnp.where(jnp.abs(slipped) > 1.0 + SLIP_TOLERANCE, jnp.sign(slipped), 0.0)


def moves_by_slip(slipped, changed, tension, mobilised, wrap, length: Float[Array, ""], rigid: bool):
    """Direction of slip along the tendons, (*tendons, N), of a step with physics terms.

    A tendon slips where nearly all its friction is mobilised, and at the base once it moves there. It counts
    as slipping as a whole once nearly all friction along it is mobilised: next to its anchor, where it hardly
    moves, friction is never mobilised in full.

    Args:
        slipped, changed: slip [m] and change of tension [N] in the step, (*tendons, N).
        tension: after it [N].
        mobilised: share of friction that is mobilised, in [-1, 1].
        wrap: turning since the base [rad].
        length: of the body [m].
        rigid: whether its shape is fixed.
    """
    if rigid:  # nothing slips except by stretch of the tendon
        slipped, length = changed, jnp.max(jnp.abs(tension)) + 1e-6
    way = jnp.where(jnp.abs(slipped) > SLIP_TOLERANCE * length, jnp.sign(slipped), 0.0)
    if rigid:
        return way
    turning = jnp.diff(wrap, axis=-1, prepend=jnp.zeros_like(wrap[..., :1]))
    whole = jnp.where(wrap[..., -1] > 0, wrap[..., -1], 1.0)
    share = jnp.sum(mobilised * turning, axis=-1, keepdims=True) / whole[..., None]
    at_base = way[..., :1]
    all_of = (share * at_base > MOBILISED) & (at_base != 0.0)
    slips = (mobilised * way > MOBILISED) | (jnp.broadcast_to(jnp.arange(way.shape[-1]), way.shape) == 0)
    return jnp.where(all_of, at_base, jnp.where(slips, way, 0.0))


def front_of(s, sign):
    """Direction of slip of one tendon at the base and arc length up to which it reaches."""
    at = jnp.arange(s.shape[0])
    first_locked = jnp.min(jnp.where(sign != sign[0], at, s.shape[0]))
    front = jnp.max(jnp.where(at < first_locked, s, 0.0))
    return sign[0], jnp.where(sign[0] == 0.0, 0.0, front)


def moves_of(s: Sections, structure: ProgramSpec, rigid: bool, step: Step, done: Loaded, scale):
    """Direction of slip along the tendons in a step, (*tendons, N): with physics terms by slip, without them
    by friction where the slip decides, else by tension.

    Args:
        s: the robot at its nodes.
        structure: which equations act.
        rigid: whether the body's shape is fixed.
        step, done: the step.
        scale: a tension that counts as large [N].
    """
    before = s.to_anchor(jnp.moveaxis(step.before[0], 0, -1))
    if not structure.terms:
        if step.xi is not None:
            return moves_by_friction(jnp.moveaxis(step.xi, 0, -1))
        return moves_by_tension(done.tension, before, scale)
    assert step.slip is not None and step.before[1] is not None and step.mobilised is not None
    slipped = jnp.moveaxis(step.slip - step.before[1], 0, -1)
    slipped = slipped if step.moved is None else slipped + step.moved
    mobilised = jnp.moveaxis(step.mobilised, 0, -1)
    changed = done.tension - before
    return moves_by_slip(slipped, changed, done.tension, mobilised, done.wrap, s.mesh.s[-1], rigid)
