"""Friction changes from cycle to cycle."""

from .term import Quantity, Term

TERM = Term(
    id="wear",
    says="Friction changes with every pull and release: running in, or wear.",
    law="μ (1 + rate·cycle), cycle the pulls and releases done so far (half a cycle each)",
    seen="The loop drifts from cycle to cycle, not in between.",
    told_apart="Repeat one loop many times, and once more after a rest, in which friction-drift goes on.",
    quantities=(
        Quantity(
            "rate", "dimensionless", 0.0, 0.03, "Relative change of friction per cycle.", (-0.15, 0.15), -1.0
        ),
    ),
    friction=lambda p, at: 1 + p["rate"] * at.cycle,
)
