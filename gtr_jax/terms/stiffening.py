"""The body stiffens, or softens, as it bends."""

import jax.numpy as jnp

from .term import Quantity, Term


def bend(p, kappa, at):
    """Bending moment over EI beyond the linear one."""
    bent = kappa - at.rest
    return p["coefficient"] * bent**3, at.kept


def bend_in_space(p, strain, at):
    """The same for the vector e of both bendings, from the energy coefficient/4 (e . EI e) |e|^2: of a round
    section EI e (1 + coefficient |e|^2), of any section without making energy. Twist stays linear.
    """
    _, y, z = (u - rest for u, rest in zip(strain, at.rest, strict=True))
    _, soft_y, soft_z = at.compliance

    def extra(own, other, soft, soft_other):
        stiffer = jnp.where(soft_other > 0, soft / jnp.where(soft_other > 0, soft_other, 1.0), 1.0)
        return 0.5 * p["coefficient"] * own * (2.0 * own**2 + (1.0 + stiffer) * other**2)

    return (0.0 * y, extra(y, z, soft_y, soft_z), extra(z, y, soft_z, soft_y)), at.kept


TERM = Term(
    id="stiffening",
    says="The body grows stiffer (or softer) the more it bends.",
    law="M = EI (κ − κ₀)(1 + coefficient·(κ − κ₀)²); in space with the vector of both bendings, "
    "from the energy coefficient/4·(e·EI e)|e|², e = κ − κ₀",
    seen="At high tension the tip turns less than the model's, and less tension is lost.",
    told_apart="The tip's angle against the tension, over the whole range.",
    quantities=(
        Quantity(
            "coefficient", "m^2", 0.0, 1e-2, "Relative stiffening per squared curvature.", (-5e-3, 5e-2), None
        ),
    ),
    bend=bend,
    bend_in_space=bend_in_space,
)
