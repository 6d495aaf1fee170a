"""The base's load cell shows a multiple of the tension."""

from .term import Quantity, Term

TERM = Term(
    id="base-gain",
    place=620,
    says="The load cell at the base shows a multiple of the true tension.",
    law="T_base shown = gain · T_base",
    seen="ln(T_tip/T_base) is off by the same amount in pulling and releasing; the robot bends as if pulled "
    "less or more than the cell says.",
    told_apart="Swap the cells, or hang a known weight on this one; the tip's pose tells it from tip-gain.",
    quantities=(
        Quantity("gain", "dimensionless", 1.0, 1.03, "Shown over true tension.", (0.9, 1.1), 0.0, log=True),
    ),
    base=lambda p, T, at: p["gain"] * T,
    true_base=lambda p, shown, at: shown / p["gain"],
    exact=True,
)
