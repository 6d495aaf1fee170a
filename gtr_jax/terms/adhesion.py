"""A drag along the channel that does not depend on the tension."""

from .term import Quantity, Term

TERM = Term(
    id="adhesion",
    place=140,
    says="The channel drags on the tendon even where it does not press: seals, lubricant, a tight fit.",
    law="dT/ds lowered by drag while pulling, raised while releasing; T never below 0",
    seen="Much of the tension is lost at low tension; the loop does not close at zero.",
    told_apart="Loops at low tension; a straight run.",
    quantities=(Quantity("drag", "N/m", 0.0, 2.0, "Force per length of the body.", (0.2, 10.0), 0.0),),
    drag=lambda p, at: p["drag"],
)
