"""The body itself loses energy in bending, whatever the rate."""

import jax.numpy as jnp

from .term import STILL, Quantity, Term


def bend(p, kappa, at):
    """Moment of a Dahl element over EI, exact for a step of any size."""
    change = kappa - at.before
    sense = jnp.where(change >= -STILL, 1.0, -1.0)
    z = sense - (sense - at.kept[0]) * jnp.exp(-sense * change / p["curvature"])
    return p["ratio"] * p["curvature"] * z, z[None]


def bend_in_space(p, strain, at):
    """The same for the vector of both bendings, which a step turns along a straight line; twist has none."""
    changes = [u - before for u, before in zip(strain, at.before, strict=True)][1:]
    held = [kept[0] for kept in at.kept][1:]
    square = changes[0] ** 2 + changes[1] ** 2
    moves = square > STILL**2
    way = jnp.sqrt(jnp.where(moves, square, 1.0))
    left = jnp.exp(-jnp.where(moves, way, 0.0) / p["curvature"])
    z = [0.0 * strain[0]]
    for change, was in zip(changes, held, strict=True):
        along = change / way
        z.append(jnp.where(moves, along - (along - was) * left, was + change / p["curvature"]))
    return tuple(p["ratio"] * p["curvature"] * one for one in z), tuple(one[None] for one in z)


TERM = Term(
    id="body-hysteresis",
    place=340,
    says="The body itself is hysteretic: layers, braids or plies rub as it bends.",
    law="M = EI (κ − κ₀) + EI·ratio·curvature·z, dz/dκ = (1 − z sgn κ̇)/curvature; "
    "in space dz = (dκ − z |dκ|)/curvature with the vectors of both bendings",
    seen="The tip's pose lags behind the tension more than the tendon's friction explains, at any rate.",
    told_apart="Bend the body by hand or by a weight, with the tendon slack, and record the pose.",
    source="Dahl 1968, on curvature",
    quantities=(
        Quantity(
            "ratio",
            "dimensionless",
            0.0,
            0.1,
            "Extra stiffness right after a reversal, relative to EI.",
            (0.02, 0.5),
            0.0,
        ),
        Quantity(
            "curvature",
            "rad/m",
            1.0,
            1.0,
            "Change of curvature over which it gives way.",
            (0.1, 10.0),
            0.0,
            log=True,
            size=False,
        ),
    ),
    bend=bend,
    bend_in_space=bend_in_space,
    remembers=1,
)
