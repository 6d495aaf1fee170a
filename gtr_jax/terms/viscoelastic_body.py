"""The body creeps: a Maxwell branch beside its stiffness."""

import jax.numpy as jnp

from .term import Bent, Quantity, Term


def bend(p, kappa, at):
    """Moment of the branch over EI, exact for a constant rate of bending over the step."""
    steps = at.dt / p["time"]
    grown = -jnp.expm1(-steps)
    q = at.kept[0] * (1 - grown) + p["ratio"] * grown / steps * (kappa - at.before)
    return q, q[None]


def bend_in_space(p, strain, at):
    """The same for twist and both bendings, each by itself: the material creeps in shear as in bending."""
    each = [Bent(*one, at.dt) for one in zip(at.rest, at.before, at.kept, strict=True)]
    extra, kept = zip(*(bend(p, u, of) for u, of in zip(strain, each, strict=True)), strict=True)
    return extra, kept


TERM = Term(
    id="viscoelastic-body",
    says="The body creeps: bent quickly it is stiffer than bent slowly.",
    law="M = EI (κ − κ₀) + q, q̇ = ratio·EI κ̇ − q/time; in space so for twist and each bending",
    seen="The tip and the tip tension go on changing during holds; loops depend on the rate.",
    told_apart="Holds at several tensions with the pose recorded; viscous friction stops when slip stops.",
    source="standard linear solid (Zener)",
    quantities=(
        Quantity(
            "ratio", "dimensionless", 0.0, 0.2, "Stiffness of the branch, relative to EI.", (0.03, 0.6), 0.0
        ),
        Quantity(
            "time",
            "s",
            10.0,
            10.0,
            "Time in which the branch relaxes.",
            (0.5, 200.0),
            0.0,
            log=True,
            size=False,
        ),
    ),
    timed=True,
    relaxes=True,
    bend=bend,
    bend_in_space=bend_in_space,
    remembers=1,
)
