"""Friction is higher while the slip is slow."""

import jax.numpy as jnp

from .term import Quantity, Term


def friction(p, at):
    """Factor on the friction coefficient, from the speed in the load step before."""
    return 1 + p["ratio"] * jnp.exp(-((at.speed / p["speed"]) ** 2))


TERM = Term(
    id="stribeck-friction",
    place=120,
    says="Friction is higher while the tendon slips slowly, or has just begun to.",
    law="μ (1 + ratio·exp(−(v/speed)²)), v the speed in the load step before",
    seen="Slow slip and the start of each slip cost more; overshoot after holds and reversals.",
    note="Stick-slip needs no term of its own: friction that breaks away higher than it slides is this law. "
    "Where the slip that a breakaway lets go within one sample is faster than `speed`, and the slip in "
    "between is slower, the tendon sticks and lets go in bursts. With μ = 0.3, ratio 0.3 and speed 0.2 mm/s, "
    "a pull of the concealed example's robot from 2 to 42 N at 0.5 N/s, which slips at 0.09 mm/s on average, "
    "has 5, 12 and 20 bursts of up to 2.4 N at 2, 4 and 8 samples per second; the elastic thread of the "
    "blind benchmark with the same law has 5, 13 and 27. How many there are depends on the sampling in both, "
    "because the law knows only the speed in the step before: of a recording it explains the size of bursts, "
    "not each of them.",
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
