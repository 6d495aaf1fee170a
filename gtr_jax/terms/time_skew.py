"""The two load cells do not share a clock."""

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import SIZES, At, Instrument, Prior, Read, Start, Tried, Variant

DELAY = 0.03  # s, standard deviation of the delay that instruments always add


def read_at(p, time, passed):
    """Times of the tension that is shown at some times, from these and the time passed since the start."""
    return time - p["delay"] - p["rate"] * passed


def late(p, T, clock):
    """The tension as late as the clocks are apart, linear between the samples; beyond them the first and last
    value.
    """
    if T.ndim == 1:
        return jnp.interp(read_at(p, clock, clock), clock, T)
    each = (jnp.broadcast_to(p[name], T.shape[1:]) for name in ("delay", "rate"))
    columns = [
        jnp.interp(read_at({"delay": delay, "rate": rate}, clock, clock), clock, column)
        for delay, rate, column in zip(*each, T.T, strict=True)
    ]
    return jnp.stack(columns, axis=1)


def starts_drift(at: At, rig: object) -> list[Start]:
    """Clocks that drift apart, and agree at the start."""
    return [{"rate": at["rate"](sign * size), "delay": 0.0} for size in SIZES for sign in (1, -1)]


def delay(read: Read) -> Prior | None:
    """That instruments always add, where both cells are read."""
    return None if read.T_tip is None else Prior(centre=0.0, sd=DELAY, size=False)


TERM = Term(
    id="time-skew",
    place=680,
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
    read_at=read_at,
    exact=True,
    tried=Tried(
        variants=(
            Variant(free=("delay",)),
            Variant("drift", ("rate", "delay"), starts=starts_drift),
        ),
        always=(Instrument("delay", delay),),
    ),
)
