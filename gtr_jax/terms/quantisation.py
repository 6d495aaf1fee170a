"""A load cell shows whole steps."""

import jax
import jax.numpy as jnp

from .term import Quantity, Term
from .tried import NEVER


def stepped(step, T):
    """T to the nearest multiple of a step; its derivative is that of T. A step of 0 changes nothing."""
    size = jnp.where(step > 0, step, 1.0)
    whole = jnp.round(T / size) * size
    return jnp.where(step > 0, T + jax.lax.stop_gradient(whole - T), T)


TERM = Term(
    id="quantisation",
    place=700,
    says="A load cell is read in whole steps.",
    law="shown = step·round(T/step), for each cell its own step",
    seen="Samples take few values, all multiples of one force.",
    told_apart="List the distinct values in the file.",
    quantities=(
        Quantity("tip", "N", 0.0, 0.05, "Step of the cell at the tip; 0: none.", (1e-3, 0.5), 0.0),
        Quantity("base", "N", 0.0, 0.05, "Step of the cell at the base; 0: none.", (1e-3, 0.5), 0.0),
    ),
    tip=lambda p, T, at: stepped(p["tip"], T),
    base=lambda p, T, at: stepped(p["base"], T),
    tried=NEVER,  # read from the samples themselves
)
