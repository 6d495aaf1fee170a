"""The base's load cell shows the tension plus a constant."""

from .term import Quantity, Term
from .tried import Tried

TERM = Term(
    id="base-offset",
    place=650,
    says="The load cell at the base shows a constant more than the true tension.",
    law="T_base shown = T_base + force",
    seen="ln(T_tip/T_base) is off by 1/T, most at low tension; a slack tendon does not read zero.",
    told_apart="Read the cell with the tendon slack.",
    quantities=(Quantity("force", "N", 0.0, 0.3, "Shown less true tension.", (-2.0, 2.0)),),
    base=lambda p, T, at: T + p["force"],
    true_base=lambda p, shown, at: shown - p["force"],
    exact=True,
    tried=Tried(by_recording=("force",)),
)
