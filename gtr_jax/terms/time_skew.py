"""The two load cells do not share a clock."""

import jax.numpy as jnp

from .term import Quantity, Term


def late(p, T, clock):
    """The tension as late as the clocks are apart, linear between the samples; beyond them the first and last
    value.
    """
    if T.ndim == 1:
        return jnp.interp(clock - p["delay"] - p["rate"] * clock, clock, T)
    each = (jnp.broadcast_to(p[name], T.shape[1:]) for name in ("delay", "rate"))
    columns = [
        jnp.interp(clock - delay - rate * clock, clock, column)
        for delay, rate, column in zip(*each, T.T, strict=True)
    ]
    return jnp.stack(columns, axis=1)


TERM = Term(
    id="time-skew",
    says="The cell at the tip is read later (or earlier) than the one at the base, or by another clock.",
    law="T_tip shown(t) = T_tip(t − delay − rate·t)",
    seen="The loop widens with the rate while pulling, and narrows where the delay is negative; more from "
    "cycle to cycle where the clocks drift apart.",
    told_apart="Tap the rig: both cells must show it at once, at the beginning and at the end. Repeat at "
    "another rate.",
    quantities=(
        Quantity("delay", "s", 0.0, 0.05, "How late the tip's cell is at the start.", (-1.0, 1.0)),
        Quantity(
            "rate", "dimensionless", 0.0, 1e-3, "How much later it gets per time, in s per s.", (-1e-2, 1e-2)
        ),
    ),
    timed=True,
    tip=lambda p, T, at: late(p, T, at.time),
)
