"""Friction differs between pulling and releasing."""

import jax.numpy as jnp

from .term import Quantity, Term

TERM = Term(
    id="friction-asymmetry",
    place=150,
    says="Friction differs between slip towards the base and towards the tip.",
    law="μ while pulling, ratio·μ while releasing",
    seen="ln(T_tip/T_base) has a constant odd part: one branch is off, the other is not.",
    told_apart="In tensions alone it is one effect with a wrong gain of a cell: swap or calibrate the cells.",
    quantities=(
        Quantity(
            "ratio",
            "dimensionless",
            1.0,
            1.05,
            "Friction coefficient while releasing over that while pulling.",
            (0.85, 1.2),
            0.0,
            log=True,
        ),
    ),
    friction=lambda p, at: p["ratio"] if at.sense < 0 else jnp.ones_like(p["ratio"]),
)
