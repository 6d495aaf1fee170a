"""A load cell reads no higher than a limit."""

import jax.numpy as jnp

from .term import Quantity, Term


def cut(limit, T):
    """T, or the limit where it is higher; a limit of 0 cuts nothing."""
    return jnp.where((limit > 0) & (limit < T), limit, T)


TERM = Term(
    id="saturation",
    says="A load cell or its amplifier shows nothing above a limit.",
    law="shown = min(T, limit), for each cell its own limit",
    seen="A flat top, at one and the same tension in every cycle.",
    told_apart="Look for equal samples at the top; use a larger range.",
    quantities=(
        Quantity("tip", "N", 0.0, 20.0, "Limit of the cell at the tip; 0: none.", (1.0, 200.0), 0.0),
        Quantity("base", "N", 0.0, 50.0, "Limit of the cell at the base; 0: none.", (1.0, 200.0), 0.0),
    ),
    tip=lambda p, T, at: cut(p["tip"], T),
    base=lambda p, T, at: cut(p["base"], T),
)
