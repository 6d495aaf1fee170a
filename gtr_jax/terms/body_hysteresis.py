"""The body itself loses energy in bending, whatever the rate."""

import jax.numpy as jnp

from .term import STILL, Quantity, Term


def bend(p, kappa, at):
    """Moment of a Dahl element over EI, exact for a step of any size."""
    change = kappa - at.before
    sense = jnp.where(change >= -STILL, 1.0, -1.0)
    z = sense - (sense - at.kept[0]) * jnp.exp(-sense * change / p["curvature"])
    return p["ratio"] * p["curvature"] * z, z[None]


TERM = Term(
    id="body-hysteresis",
    says="The body itself is hysteretic: layers, braids or plies rub as it bends.",
    law="M = EI (κ − κ₀) + EI·ratio·curvature·z, dz/dκ = (1 − z sgn κ̇)/curvature",
    seen="The tip's pose lags behind the tension more than the tendon's friction explains, at any rate.",
    told_apart="Bend the body by hand or by a weight, with the tendon slack, and record the pose.",
    source="Dahl 1968, on curvature",
    quantities=(
        Quantity(
            "ratio",
            "dimensionless",
            0.0,
            0.1,
            "Extra stiffness right after a reversal, relative to EI.",
            (0.02, 0.5),
            0.0,
        ),
        Quantity(
            "curvature",
            "rad/m",
            1.0,
            1.0,
            "Change of curvature over which it gives way.",
            (0.1, 10.0),
            0.0,
            log=True,
            size=False,
        ),
    ),
    bend=bend,
    remembers=1,
)
