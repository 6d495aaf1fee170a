"""Friction changes with time."""

from .term import Quantity, Term

TERM = Term(
    id="friction-drift",
    place=170,
    says="Friction changes with time, whether or not the tendon moves: temperature, drying, a settling seal.",
    law="μ (1 + rate·t)",
    seen="The loop drifts with time, through holds too.",
    told_apart="A loop before and after a long rest: wear stands still during it.",
    quantities=(Quantity("rate", "1/s", 0.0, 2e-4, "Relative change of friction per time.", (-2e-3, 2e-3)),),
    timed=True,
    loosens=True,
    friction=lambda p, at: 1 + p["rate"] * at.time,
)
