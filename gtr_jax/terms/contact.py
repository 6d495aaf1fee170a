"""The tip runs into something."""

import math

import jax.numpy as jnp

from .term import Quantity, Term


def stop(p, place):
    """Force of the stop [N], against its direction; negative where the tip is away from it."""
    return p["stiffness"] * (place - p["distance"])


def stop_normal(p):
    """Direction in which the tip of a robot in space runs into the stop, in the axes of the base."""
    flat = jnp.cos(p["elevation"])
    return flat * jnp.cos(p["angle"]), flat * jnp.sin(p["angle"]), jnp.sin(p["elevation"])


TERM = Term(
    id="contact",
    says="The tip runs into a stop at one place of its path.",
    law="force stiffness·depth against angle, once the tip is beyond distance in that direction; in space "
    "the stop is a plane, its normal (cos angle cos elevation, sin angle cos elevation, sin elevation)",
    seen="A kink at one tension: beyond it the tip hardly moves, and less tension is lost.",
    told_apart="Look; or record the pose.",
    quantities=(
        Quantity("stiffness", "N/m", 0.0, 200.0, "Force per depth.", (10.0, 1e4), 0.0),
        Quantity(
            "distance",
            "m",
            0.0,
            0.02,
            "Place of the stop along angle, from the base.",
            (-0.2, 0.2),
            size=False,
        ),
        Quantity(
            "angle",
            "rad",
            math.pi / 2,
            math.pi / 2,
            "Direction, from the base tangent, in which the tip runs into it.",
            (-math.pi, math.pi),
            size=False,
        ),
    ),
    across=(
        Quantity(
            "elevation",
            "rad",
            0.0,
            0.5,
            "Angle of that direction out of the plane of x and y, towards z.",
            (-math.pi / 2, math.pi / 2),
            size=False,
        ),
    ),
    stop=stop,
    stop_angle=lambda p: p["angle"],
    stop_normal=stop_normal,
)
