"""Friction grows less than in proportion to the pressure."""

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import Tried, Variant

LEAST = 1e-6  # of the reference pressure: below it the factor, which would diverge at 0, is constant


def by_pressure(p, at):
    """Factor on the friction coefficient."""
    share = at.pressure / p["reference"]
    return jnp.where(share > LEAST, share, LEAST) ** (p["exponent"] - 1)


TERM = Term(
    id="pressure-dependent-friction",
    place=130,
    says="The friction coefficient falls as the tendon presses harder on its channel.",
    law="μ (N/reference)^(exponent − 1), N = T κ_c the line pressure",
    seen="The share of tension that is lost falls with the tension.",
    told_apart="Loops up to different tensions; adhesion acts at low tension only.",
    source="Hertz contact of an elastic sheath gives 2/3; Archard gives up to 1",
    quantities=(
        Quantity("exponent", "dimensionless", 1.0, 0.9, "Exponent of the pressure.", (2 / 3, 0.98), 0.5, 1.5),
        Quantity(
            "reference",
            "N/m",
            100.0,
            100.0,
            "Line pressure at which the coefficient is the robot's.",
            (30.0, 300.0),
            0.0,
            log=True,
            size=False,
        ),
    ),
    by_pressure=by_pressure,
    # The reference cannot be told from mu.
    tried=Tried(variants=(Variant(free=("exponent",)),)),
)
