"""Steps that follow one which did not converge.

A step that does not converge leaves the memory of the step before, and the next one starts from there, as if
its load had not been. A history decides what friction holds, so the next step may meet its own equations and
still be off. It counts as converged again once

- every tendon slips along its whole length in it, up to a base tension above all that were missed or down to
  one below them, or is slack: it would slip so from whatever was held;
- or, of one tendon, the loads that were missed lie on the way from the last good step to this one: friction
  holds the same whether that way is gone in one step or in several.

The former does not hold where friction follows the slip by a law of a physics term, which may build it up
over a long one, neither where a law remembers more than the tension that friction holds: the body's past, the
time, the speed, or what was drawn out. Steps then stay flagged.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float

from ..mechanics import ProgramSpec

STRAIGHT = 1e-9  # share by which a way may be longer than the straight one
WHOLE = 1e-9  # share of the length by which the slip may fall short of it
SLACK = 1e-9  # N


class _Missed(NamedTuple):
    """What was missed: the last good load and the last one [N], (tendons,); the least and the largest since
    the former [N], (tendons,); the way between them [N]; whether a load was missed, and whether the state
    goes on from a step that is not to be trusted.
    """

    good: Float[Array, " tendons"]
    last: Float[Array, " tendons"]
    low: Float[Array, " tendons"]
    high: Float[Array, " tendons"]
    way: Float[Array, ""]
    missed: Bool[Array, ""]
    off: Bool[Array, ""]


def trusted(
    structure: ProgramSpec,
    met: Bool[Array, " K"],
    T_base: Float[Array, "K *tendons"],
    preload: Float[Array, "*tendons"],
    slip: tuple[Float[Array, "K *tendons"], Float[Array, "K *tendons"]],
    length: Float[Array, ""],
) -> Bool[Array, " K"]:
    """Which steps count as converged.

    Args:
        structure: the equations of the steps.
        met: which meet their own equations. A load that is not finite is not a step that could be missed.
        T_base: base tensions [N].
        preload: those before the first step [N].
        slip: its direction at the base and its front [m], as in `Simulation`.
        length: of the body [m].
    """
    steps = met.shape[0]
    by_term = structure.shares_slip and bool(structure.terms)
    loads, ways, fronts = (a.reshape(steps, -1) for a in (T_base, *slip))
    slips = (ways != 0) & (fronts >= (1.0 - WHOLE) * length)

    def step(at: _Missed, x):
        met, load, way, slips = x
        gone = at.way + jnp.sum(jnp.abs(load - at.last))
        low, high = jnp.minimum(at.low, load), jnp.maximum(at.high, load)
        beyond = jnp.where(way > 0, load >= high, load <= low)
        again = jnp.all(slips & beyond | (load <= SLACK)) & (not by_term)
        straight = gone <= (1.0 + STRAIGHT) * jnp.sum(jnp.abs(load - at.good))
        again = again | (straight & ~at.off & (not structure.tendons))
        good = met & (~at.missed | again & (not structure.remembers))
        kept = [jnp.where(good, load, old) for old in (at.good, low, high)]
        after = _Missed(
            kept[0], load, kept[1], kept[2], jnp.where(good, 0.0, gone), ~good, ~good & (met | at.off)
        )
        known = jnp.all(jnp.isfinite(load))
        after = jtu.tree_map(lambda new, old: jnp.where(known, new, old), after, at)
        return after, good

    no, begun = jnp.asarray(False), jnp.broadcast_to(preload.reshape(-1), loads[0].shape)
    start = _Missed(begun, begun, begun, begun, jnp.zeros(()), no, no)
    return jax.lax.scan(step, start, (met, loads, ways, slips))[1]
