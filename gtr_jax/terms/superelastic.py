"""The body is of a superelastic metal, nitinol: it grows soft where it is strained beyond its plateau, and
unloads on a lower one.

The law is a generalised play, the element of Krasnosel'skii and Pokrovskii: the share of the bend that has
transformed stays as it is between a curve on which it grows and one on which it shrinks again.
"""

import jax.numpy as jnp

from .term import Quantity, Term

ROUNDING = 1e-28  # squared distance from the middle of the ball, over the squared bend, that is only rounding


def _transformed(bent, reach, strain):
    """Bend that a section has transformed while it runs along a plateau [1/m], of a bend >= 0."""
    x = bent * reach / strain
    beyond = x > 1.0
    inverse = 1.0 / jnp.where(beyond, x, 1.0)
    return bent * jnp.where(beyond, 1.0 - inverse * (1.5 - 0.5 * inverse**2), 0.0)


def _limits(p, bent, reach):
    """The least that a bend >= 0 has transformed, that of loading, and the most, that of unloading [1/m]."""
    lower = (1.0 - p["hysteresis"]) * p["strain"]
    return _transformed(bent, reach, p["strain"]), _transformed(bent, reach, lower)


def bend(p, kappa, at):
    """Bending moment over EI beyond the linear one, and the bend transformed."""
    bent = kappa - at.rest
    sign = jnp.where(bent < 0, -1.0, 1.0)
    least, most = _limits(p, sign * bent, at.reach)
    was = sign * at.kept[0]
    # Where both limits are one, without hysteresis, derivatives follow the limit that is met.
    now = sign * jnp.where(was <= least, least, jnp.where(was >= most, most, was))
    return -p["softening"] * now, now[None]


def bend_in_space(p, strain, at):
    """The same for the vector of both bendings: what has transformed stays in the ball whose poles are the
    two limits along the bend, and moves to its nearest point; twist stays linear.
    """
    _, y, z = (u - rest for u, rest in zip(strain, at.rest, strict=True))
    square = y * y + z * z
    bends = square > 0
    size = jnp.sqrt(jnp.where(bends, square, 1.0))
    least, most = _limits(p, jnp.where(bends, size, 0.0), at.reach)
    middle, radius = 0.5 * (least + most) / size, 0.5 * (most - least)
    away = [kept[0] - middle * one for kept, one in zip(at.kept[1:], (y, z), strict=True)]
    far = away[0] * away[0] + away[1] * away[1]
    outside = far >= radius * radius
    apart = far > ROUNDING * square
    share = jnp.where(outside, jnp.where(apart, radius / jnp.sqrt(jnp.where(apart, far, 1.0)), 0.0), 1.0)
    now = [middle * one + share * off for one, off in zip((y, z), away, strict=True)]
    extra = tuple(-p["softening"] * one for one in now)
    return (0.0 * y, *extra), tuple(one[None] for one in (0.0 * y, *now))


def fault(values, length):
    """Why no body can have these numbers; empty if one can."""
    alone = values["hysteresis"] and not values["softening"]
    return "hysteresis does nothing without softening; give both" if alone else ""


TERM = Term(
    id="superelastic",
    says="A body of nitinol is superelastic: where it is strained beyond its plateau it grows soft, and it "
    "unloads on a lower plateau.",
    law="M = EI (e − softening·q), e = κ − κ₀; bent farther q(e) = e (1 − 1.5/x + 0.5/x³) where x = |e| "
    "c/strain > 1, c the distance of the outermost fibre from the neutral line, and 0 below; bent back q "
    "stays until it meets the same curve with (1 − hysteresis)·strain; in between M changes by EI",
    seen="Beyond some tension the body bends far more for each newton, notch after notch; on release it "
    "stays bent until the tension is well below that.",
    told_apart="The angle against the tension over the whole range, before any notch closes; friction "
    "alone never makes the slope grow. Friction, too, holds the bend on release: load and unload the body "
    "by a weight, with the tendon slack.",
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
        Quantity(
            "hysteresis",
            "dimensionless",
            0.0,
            0.5,
            "By what share of its height the plateau of unloading lies below that of loading.",
            (0.2, 0.7),
            0.0,
            0.95,
        ),
    ),
    source="moment of a rectangular section of a bilinear material; flag with elastic inner loops: "
    "Auricchio and Sacco 1997; generalised play: Krasnosel'skii and Pokrovskii 1989",
    note="Sections that are not rectangles pass over to the plateau a little more slowly or faster; the "
    "strain takes that up. Both plateaus are those of fibres that transform one by one. From one to the "
    "other the section turns as a whole, while its outer fibres turn first: at most 4.3 % of the largest "
    "moment apart, bent to four times the strain of the plateau. Inner loops are elastic and close. In "
    "space what has transformed lags behind a bend that turns round.",
    softens=True,
    by_strain=True,
    bend=bend,
    bend_in_space=bend_in_space,
    remembers=1,
    round_only=True,
    fault=fault,
)
