"""The body stiffens, or softens, as it bends."""

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import At, Prior, Rig, Start, Tried, Variant


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


def _unit(rig: Rig) -> float:
    """One over the square of the largest change of curvature [m^2]. Below -4/27 of it the moment has a
    maximum below the applied moment, and the body would buckle.
    """
    return max(rig.bend, 1e-6) ** -2


def prior(rig: Rig) -> dict[str, Prior]:
    """The stiffness changes by less than itself."""
    return {"coefficient": Prior(sd=0.4 * _unit(rig), lower=-0.13 * _unit(rig))}


def starts(at: At, rig: Rig) -> list[Start]:
    """Bodies that stiffen and that soften."""
    return [{"coefficient": share * _unit(rig)} for share in (0.12, 0.4, -0.05, -0.11)]


TERM = Term(
    id="stiffening",
    place=300,
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
    tried=Tried(variants=(Variant("", ("coefficient",), prior, starts),)),
)
