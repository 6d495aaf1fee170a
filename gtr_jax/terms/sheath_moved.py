"""The sheath is moved, and friction differs from then on."""

from .term import Quantity, Term, rise
from .tried import At, Moments, Start, Tried, Variant

# Relative changes of friction that are tried, and how long the move takes [s].
CHANGES, TAKES = (0.15, -0.15), 0.3


def starts(at: At, moments: Moments) -> list[Start]:
    """More friction, and less, from any time on."""
    return [{"change": change, "time": time} for change in CHANGES for time in moments.begins]


TERM = Term(
    id="sheath-moved",
    place=190,
    says="The sheath is moved, or a clamp slips: its wrap, and with it friction, differs from then on.",
    law="μ (1 + change·S((t − time)/duration)), S(x) = 3x² − 2x³ from 0 to 1, never below 0; "
    "what friction no longer holds relaxes",
    seen="An event in time: all later loops are wider, or narrower, than all earlier ones.",
    told_apart="Compare loops before and after; friction-drift and wear change from loop to loop.",
    source="capstan equation: friction enters as μ times wrap",
    quantities=(
        Quantity("change", "dimensionless", 0.0, 0.3, "Relative change of friction.", (-0.6, 1.0), -1.0),
        Quantity("time", "s", 0.0, 30.0, "When it begins.", (0.0, 600.0), size=False),
        Quantity(
            "duration", "s", 0.1, 0.5, "How long the move takes.", (0.01, 5.0), 0.0, log=True, size=False
        ),
    ),
    timed=True,
    event=True,
    loosens=True,
    friction=lambda p, at: 1 + p["change"] * rise((at.time - p["time"]) / p["duration"]),
    tried=Tried(
        variants=(Variant("", ("change", "time"), None, starts, lambda moments: {"duration": TAKES}),)
    ),
)
