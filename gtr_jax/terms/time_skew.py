"""The two load cells do not share a clock."""

import jax.numpy as jnp

from .term import Quantity, Term


def late(delay, T, clock):
    """The tension a delay earlier, linear between the samples; the first and last value beyond them."""
    if T.ndim == 1:
        return jnp.interp(clock - delay, clock, T)
    return jnp.stack([jnp.interp(clock - delay, clock, column) for column in T.T], axis=1)


TERM = Term(
    id="time-skew",
    says="The cell at the tip is read later (or earlier) than the one at the base.",
    law="T_tip shown(t) = T_tip(t − delay)",
    seen="The loop widens with the rate while pulling, and narrows where the delay is negative.",
    told_apart="Tap the rig: both cells must show it at once. Repeat at another rate.",
    quantities=(Quantity("delay", "s", 0.0, 0.05, "How late the tip's cell is.", (-1.0, 1.0)),),
    timed=True,
    tip=lambda p, T, at: late(p["delay"], T, at.time),
)
