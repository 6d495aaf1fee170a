"""The tendon's end at the tip is moved, or let go, from outside."""

from .term import Quantity, Term, rise
from .tried import NEVER

TERM = Term(
    id="tip-moved",
    place=200,
    says="The tendon's end at the tip, with its load cell, is moved from outside or let go.",
    law="T_tip changes by tension·S((t − time)/duration), S(x) = 3x² − 2x³ from 0 to 1, as far as friction "
    "to the base allows; T_tip exp(∓μ(θ(L) − θ)) bounds the tension that is held",
    seen="An event in time: the tip tension jumps while the base tension does not, until the tendon slips as "
    "a whole again.",
    told_apart="Look at a video of the tip. shaken-sheath takes both tensions towards each other; this takes "
    "the tip tension anywhere.",
    source="capstan equation, from the end at the tip",
    quantities=(
        Quantity(
            "tension",
            "N",
            0.0,
            -2.0,
            "Change of the tip tension; negative where it is let go.",
            (-10.0, 10.0),
        ),
        Quantity("time", "s", 0.0, 30.0, "When it begins.", (0.0, 600.0), size=False),
        Quantity(
            "duration", "s", 0.1, 0.5, "How long the move takes.", (0.01, 5.0), 0.0, log=True, size=False
        ),
    ),
    event=True,
    timed=True,
    tugged=lambda p, time: p["tension"] * rise((time - p["time"]) / p["duration"]),
    tried=NEVER,  # its free time and tension would fit any bump
)
