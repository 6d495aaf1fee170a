"""The body is of a superelastic metal, nitinol, and grows soft where it is strained beyond its plateau."""

import jax.numpy as jnp

from .term import Quantity, Term


def _lost(p, bent, reach):
    """Share of the elastic moment that is lost at a curvature [-]."""
    x = jnp.abs(bent) * reach / p["strain"]
    beyond = x > 1.0
    inverse = 1.0 / jnp.where(beyond, x, 1.0)
    return p["softening"] * jnp.where(beyond, 1.0 - inverse * (1.5 - 0.5 * inverse**2), 0.0)


def bend(p, kappa, at):
    """Bending moment over EI beyond the linear one."""
    bent = kappa - at.rest
    return -bent * _lost(p, bent, at.reach), at.kept


def bend_in_space(p, strain, at):
    """The same for the vector of both bendings; twist stays linear."""
    _, y, z = (u - rest for u, rest in zip(strain, at.rest, strict=True))
    square = y * y + z * z
    bent = jnp.sqrt(jnp.where(square > 0, square, 1.0))
    lost = _lost(p, jnp.where(square > 0, bent, 0.0), at.reach)
    return (0.0 * y, -y * lost, -z * lost), at.kept


TERM = Term(
    id="superelastic",
    says="A body of nitinol is superelastic: where it is strained beyond its plateau it grows soft.",
    law="M = EI e (1 − softening·(1 − 1.5/x + 0.5/x³)) where x = |e| c/strain > 1, e = κ − κ₀, c the "
    "distance of the outermost fibre from the neutral line; M = EI e below",
    seen="Beyond some tension the body bends far more for each newton, notch after notch.",
    told_apart="The angle against the tension over the whole range, before any notch closes; friction alone "
    "never makes the slope grow.",
    quantities=(
        Quantity(
            "softening",
            "dimensionless",
            0.0,
            0.85,
            "Share of the stiffness that is lost on the plateau.",
            (0.5, 0.95),
            0.0,
            0.99,
        ),
        Quantity(
            "strain",
            "dimensionless",
            0.01,
            0.012,
            "Strain of the outermost fibre at which the plateau begins.",
            (0.006, 0.03),
            0.0,
            log=True,
            size=False,
        ),
    ),
    source="moment of a rectangular section of a bilinear material",
    note="The law has no hysteresis: unloading nitinol follows a lower plateau, which it leaves out. "
    "Sections that are no rectangles pass over to the plateau a little more slowly or faster; the strain "
    "takes that up.",
    softens=True,
    bend=bend,
    bend_in_space=bend_in_space,
    round_only=True,
)
