"""Friction is higher while the slip is slow."""

import jax.numpy as jnp

from .term import Quantity, Term


def friction(p, at):
    """Factor on the friction coefficient, from the speed in the load step before."""
    return 1 + p["ratio"] * jnp.exp(-((at.speed / p["speed"]) ** 2))


TERM = Term(
    id="stribeck-friction",
    says="Friction is higher while the tendon slips slowly, or has just begun to.",
    law="μ (1 + ratio·exp(−(v/speed)²)), v the speed in the load step before",
    seen="Slow slip and the start of each slip cost more; overshoot after holds and reversals.",
    told_apart="Holds of different length before a reversal, and loops at different rates.",
    source="Stribeck 1902; Gaussian form: Bo & Pavelescu 1982",
    quantities=(
        Quantity(
            "ratio", "dimensionless", 0.0, 0.2, "Excess of friction at rest, relative.", (0.03, 0.6), 0.0
        ),
        Quantity(
            "speed",
            "m/s",
            1e-3,
            1e-3,
            "Speed at which the excess has faded.",
            (1e-4, 1e-2),
            0.0,
            log=True,
            size=False,
        ),
    ),
    timed=True,
    creeps=True,
    reads_speed=True,
    friction=friction,
)
