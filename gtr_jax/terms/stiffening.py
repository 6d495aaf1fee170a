"""The body stiffens, or softens, as it bends."""

from .term import Quantity, Term


def bend(p, kappa, at):
    """Bending moment over EI beyond the linear one."""
    bent = kappa - at.rest
    return p["coefficient"] * bent**3, at.kept


TERM = Term(
    id="stiffening",
    says="The body grows stiffer (or softer) the more it bends.",
    law="M = EI (κ − κ₀)(1 + coefficient·(κ − κ₀)²)",
    seen="At high tension the tip turns less than the model's, and less tension is lost.",
    told_apart="The tip's angle against the tension, over the whole range.",
    quantities=(
        Quantity(
            "coefficient", "m^2", 0.0, 1e-2, "Relative stiffening per squared curvature.", (-5e-3, 5e-2), None
        ),
    ),
    bend=bend,
)
