"""The body is of rubber, whose stiffness depends on its strain: Yeoh's law, over a round section."""

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import NEVER


def _extra(p, square):
    """Relative stiffening, from the squared strain of the outermost fibre."""
    return 3.0 * p["second"] * square + 135.0 / 16.0 * p["third"] * square**2


def bend(p, kappa, at):
    """Bending moment over EI beyond the linear one."""
    bent = kappa - at.rest
    return bent * _extra(p, (bent * at.reach) ** 2), at.kept


def bend_in_space(p, strain, at):
    """The same for the vector of both bendings; twist stays linear."""
    _, y, z = (u - rest for u, rest in zip(strain, at.rest, strict=True))
    more = _extra(p, (y * y + z * z) * at.reach**2)
    return (jnp.zeros_like(y), y * more, z * more), at.kept


TERM = Term(
    id="hyperelastic",
    place=310,
    says="The body is of rubber, which grows softer or stiffer with its strain.",
    law="M = EI e (1 + 3 second·x² + 135/16 third·x⁴), x = |e| c, e = κ − κ₀, c the radius; second = "
    "C₂/C₁, third = C₃/C₁ of Yeoh's energy C₁ (I₁ − 3) + C₂ (I₁ − 3)² + C₃ (I₁ − 3)³, E = 6 C₁",
    seen="At high tension the tip turns less, or more, than the model's, most where the body is thick.",
    told_apart="On a body of one radius it is stiffening with the coefficient 3 second·c², and no "
    "recording tells the two apart; a tapering body is stiffened most at its base by this one, alike all "
    "along by the other. Or pull a strip of the material.",
    source="Yeoh 1993; stress E ε (1 + 6 second·ε² + 27 third·ε⁴) of a fibre, I₁ − 3 = 3 ε², over a round "
    "section",
    note="For strains up to 0.3 or so. E stays that of small strains. Left out is what the law has with C₁ "
    "alone, x²/6: 0.7 % at a strain of 0.2. In a thin tube x² counts one and a half times, and x⁴ twice. "
    "Strips and notched bodies, for which other numbers hold, are refused: for a strip of the height h they "
    "are 3.6 and 81/7, with c = h/2, so that stiffening with the coefficient 3.6 second·(h/2)² is its law up "
    "to x². "
    "`gtr diagnose` tries stiffening, of which this is a form; a fit takes either.",
    quantities=(
        Quantity("second", "dimensionless", 0.0, 0.3, "C₂/C₁; negative where it softens.", (-0.2, 1.0)),
        Quantity("third", "dimensionless", 0.0, 0.1, "C₃/C₁.", (-0.1, 1.0)),
    ),
    bend=bend,
    bend_in_space=bend_in_space,
    discs_only=True,
    round_only=True,
    by_strain=True,
    tried=NEVER,  # on a body of one radius it is stiffening by another name
)
