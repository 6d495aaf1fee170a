"""The tip's load cell feels the base tension."""

from .term import Quantity, Term

TERM = Term(
    id="crosstalk",
    place=630,
    says="The load cell at the tip also feels the base tension, through mount, amplifier or cable.",
    law="T_tip shown = T_tip + share·T_base",
    seen="The tip seems to follow the base during the transition, when it should stand still.",
    told_apart="Pull with the tendon held fast behind the base: the tip's cell must not move.",
    quantities=(
        Quantity("share", "dimensionless", 0.0, 0.01, "Share of the base tension shown.", (-0.05, 0.05)),
    ),
    tip=lambda p, T, at: T + p["share"] * at.T_base,
    exact=True,
)
