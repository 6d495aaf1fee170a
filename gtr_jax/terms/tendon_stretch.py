"""The tendon, and what it is anchored to, give way under tension."""

from .term import Quantity, Term
from .tried import Tried, Variant

TERM = Term(
    id="tendon-stretch",
    place=400,
    says="The tendon stretches, or its anchor and the tip's load cell give way.",
    law="strain compliance·T along the tendon; the anchor moves by anchor·T_tip",
    seen="More tendon is drawn out than the body bends for; with presliding or viscous friction "
    "it changes the tensions too.",
    told_apart="Record the displacement of the tendon at the base; pull with the tip locked.",
    quantities=(
        Quantity(
            "compliance", "1/N", 0.0, 5e-5, "Strain per tension, 1/EA.", (2e-6, 5e-4), 0.0, assumed=True
        ),
        Quantity("anchor", "m/N", 0.0, 1e-5, "How far the anchor moves per tension.", (1e-6, 1e-4), 0.0),
    ),
    strain=lambda p, tension: p["compliance"] * tension,
    anchor=lambda p, tension: p["anchor"] * tension,
    tried=Tried(variants=(Variant(free=("compliance",)),)),
)
