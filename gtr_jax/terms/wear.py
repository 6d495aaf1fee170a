"""Friction changes from cycle to cycle."""

from .term import Quantity, Term

TERM = Term(
    id="wear",
    place=160,
    says="Friction changes with every pull and release: running in, or wear.",
    law="μ (1 + rate·cycle), never below 0; "
    "cycle: the way T_base has gone, over twice its range in the recording",
    seen="The loop drifts from cycle to cycle, not in holds.",
    told_apart="Repeat one loop many times, and once more after a rest, in which friction-drift goes on.",
    quantities=(
        Quantity(
            "rate", "dimensionless", 0.0, 0.03, "Relative change of friction per cycle.", (-0.15, 0.15), -1.0
        ),
    ),
    loosens=True,
    friction=lambda p, at: 1 + p["rate"] * at.cycle,
)
