"""A physics term of your own: a seal that drags on the tendon wherever the channel does not press hard.

gtr terms my-seal --terms examples/seal.py
"""

import jax.numpy as jnp

from gtr_jax.terms import Quantity, Term


def drag(p, at):
    """Force per length that opposes slip [N/m], from the line pressure [N/m]."""
    return p["size"] * jnp.exp(-at.pressure / p["fade"])


TERM = Term(
    id="my-seal",
    says="A seal drags on the tendon wherever the channel does not press hard.",
    law="dT/ds lowered by size·exp(−p/fade) while pulling, raised while releasing",
    seen="Much of the tension is lost at low tension, little more at high.",
    told_apart="Loops at low tension.",
    quantities=(
        Quantity("size", "N/m", 0.0, 6.0, "Force per length of the body.", (0.5, 12.0), 0.0),
        Quantity(
            "fade", "N/m", 40.0, 40.0, "Line pressure over which it fades.", (10.0, 200.0), 1.0, size=False
        ),
    ),
    drag=drag,
)
