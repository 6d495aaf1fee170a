"""Gravity differs from that of the model."""

import dataclasses

import jax.numpy as jnp

from .term import Quantity, Term


def loads(p, given):
    """The loads with the acceleration added."""
    return dataclasses.replace(given, more_gravity=given.more_gravity + jnp.stack([p["x"], p["y"]]))


TERM = Term(
    id="gravity-error",
    says="Gravity acts in another direction, or on another weight, than the model says.",
    law="acceleration (x, y) added to gravity",
    seen="The pose is off at every tension, as the whole body sags otherwise.",
    told_apart="Turn the rig: what turns with it is gravity.",
    quantities=(
        Quantity("x", "m/s^2", 0.0, 2.0, "Acceleration added along the base tangent.", (-10.0, 10.0)),
        Quantity("y", "m/s^2", 0.0, 2.0, "Acceleration added to its left.", (-10.0, 10.0)),
    ),
    loads=loads,
)
