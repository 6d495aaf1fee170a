"""The tip's load cell shows a multiple of the tension."""

from .term import Quantity, Term

TERM = Term(
    id="tip-gain",
    place=610,
    says="The load cell at the tip shows a multiple of the true tension.",
    law="T_tip shown = gain · T_tip",
    seen="ln(T_tip/T_base) is off by the same amount in pulling and releasing, at every tension.",
    told_apart="Swap the cells, or hang a known weight on this one; in tensions alone it is one effect with "
    "base-gain and friction-asymmetry.",
    quantities=(
        Quantity("gain", "dimensionless", 1.0, 1.03, "Shown over true tension.", (0.9, 1.1), 0.0, log=True),
    ),
    tip=lambda p, T, at: p["gain"] * T,
    exact=True,
)
