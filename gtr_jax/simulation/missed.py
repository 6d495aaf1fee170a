"""Steps that follow one which did not converge.

A step that does not converge leaves the memory of the step before, and the next one starts from there, as if
its load had not been. A history decides what friction holds, so the next step may meet its own equations and
still be off. It counts as converged again once

- every tendon slips along its whole length in it, or is slack, so that nothing is left of what was held,
- or the loads that were missed lie on the straight way from the last good step to this one, so that the way
  was gone in one step instead of several.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

STRAIGHT = 1e-9  # share by which a way may be longer than the straight one
WHOLE = 1e-9  # share of the length by which the slip may fall short of it
SLACK = 1e-9  # N


class _Missed(NamedTuple):
    """What was missed: the last good load and the last one [N], (tendons,); the way between them [N]; whether
    a load was missed, and whether the state goes on from a step that is not to be trusted.
    """

    good: Float[Array, " tendons"]
    last: Float[Array, " tendons"]
    way: Float[Array, ""]
    missed: Bool[Array, ""]
    off: Bool[Array, ""]


def trusted(
    met: Bool[Array, " K"],
    T_base: Float[Array, "K *tendons"],
    direction: Float[Array, "K *tendons"],
    front: Float[Array, "K *tendons"],
    length: Float[Array, ""],
) -> Bool[Array, " K"]:
    """Which steps count as converged.

    Args:
        met: which meet their own equations. A load that is not finite is no step that could be missed.
        T_base: base tensions [N].
        direction, front: of the slip, as in `Simulation`.
        length: of the body [m].
    """
    steps = met.shape[0]
    loads, ways, fronts = (a.reshape(steps, -1) for a in (T_base, direction, front))
    slips = (ways != 0) & (fronts >= (1.0 - WHOLE) * length)
    whole = jnp.all(slips | (loads <= SLACK), axis=1)

    def step(at: _Missed, x):
        met, load, whole = x
        way = at.way + jnp.linalg.norm(load - at.last)
        straight = way <= (1.0 + STRAIGHT) * jnp.linalg.norm(load - at.good)
        good = met & (~at.missed | whole | (straight & ~at.off))
        after = _Missed(
            jnp.where(good, load, at.good), load, jnp.where(good, 0.0, way), ~good, ~good & (met | at.off)
        )
        known = jnp.all(jnp.isfinite(load))
        after = jax.tree_util.tree_map(lambda new, old: jnp.where(known, new, old), after, at)
        return after, good

    no = jnp.asarray(False)
    start = _Missed(loads[0], loads[0], jnp.zeros(()), no, no)
    return jax.lax.scan(step, start, (met, loads, whole))[1]
