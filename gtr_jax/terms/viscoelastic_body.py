"""The body creeps: Maxwell branches beside its stiffness, of one time or of several."""

import jax.numpy as jnp

from .term import APART, Bent, Quantity, Term, spread_out
from .tried import Tried, Variant


def bend(p, kappa, at):
    """Moment of the branches over EI, exact for a constant rate of bending over the step; remembered are
    their sum and each.
    """
    each = []
    for k, time in enumerate(spread_out(p["time"], p["spread"])):
        steps = at.dt / time
        grown = -jnp.expm1(-steps)
        ratio = p["ratio"] / len(APART)
        each.append(at.kept[1 + k] * (1 - grown) + ratio * grown / steps * (kappa - at.before))
    q = sum(each[1:], each[0])
    return q, jnp.stack([q, *each])


def bend_in_space(p, strain, at):
    """The same for twist and both bendings, each by itself: the material creeps in shear as in bending."""
    each = [Bent(*one, at.dt) for one in zip(at.rest, at.before, at.kept, strict=True)]
    extra, kept = zip(*(bend(p, u, of) for u, of in zip(strain, each, strict=True)), strict=True)
    return extra, kept


TERM = Term(
    id="viscoelastic-body",
    place=330,
    says="The body creeps: bent quickly it is stiffer than bent slowly.",
    law="M = EI (κ − κ₀) + Σ q_j, q̇_j = ratio/4·EI κ̇ − q_j/t_j, "
    "t_j = time·10^(spread·(−3/2, −1/2, 1/2, 3/2)); in space so for twist and each bending",
    seen="The tip and the tip tension go on changing during holds; loops depend on the rate.",
    told_apart="Holds at several tensions with the pose recorded; viscous friction stops when slip stops.",
    source="standard linear solid (Zener); several times: generalised Maxwell model (Wiechert)",
    quantities=(
        Quantity(
            "ratio",
            "dimensionless",
            0.0,
            0.2,
            "Stiffness of all branches together, relative to EI.",
            (0.03, 0.6),
            0.0,
        ),
        Quantity(
            "time",
            "s",
            10.0,
            10.0,
            "Time in which the branches relax, in the geometric mean.",
            (0.5, 200.0),
            0.0,
            log=True,
            size=False,
        ),
        Quantity(
            "spread",
            "dimensionless",
            0.0,
            0.0,
            "Decades between the times of branches that follow one another; 0 for one time.",
            (0.2, 1.2),
            0.0,
            2.0,
            size=False,
        ),
    ),
    timed=True,
    relaxes=True,
    bend=bend,
    bend_in_space=bend_in_space,
    remembers=1 + len(APART),
    tried=Tried(
        variants=(
            Variant(free=("ratio", "time")),
            Variant("spectrum", ("ratio", "time", "spread")),
        )
    ),
)
