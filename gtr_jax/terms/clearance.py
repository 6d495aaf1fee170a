"""The tendon has play in its channel and touches it less than the channel turns."""

import jax.numpy as jnp

from .term import Quantity, Term

TERM = Term(
    id="clearance",
    place=220,
    says="The tendon has room in its channel: taut, it cuts corners and turns less than the channel.",
    law="turning scaled by 1 − share·(1 − exp(−T/tension))",
    seen="Less friction than at low tension once the tendon is taut.",
    told_apart="Loops at low tension; a thicker tendon.",
    quantities=(
        Quantity(
            "share",
            "dimensionless",
            0.0,
            0.15,
            "Share of the turning that a taut tendon cuts.",
            (0.02, 0.5),
            0.0,
            0.95,
        ),
        Quantity(
            "tension", "N", 3.0, 5.0, "Tension that pulls it taut.", (0.5, 20.0), 0.0, log=True, size=False
        ),
    ),
    wrap=lambda p, tension: 1 - p["share"] * (1 - jnp.exp(-tension / p["tension"])),
)
