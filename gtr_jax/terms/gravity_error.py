"""Gravity differs from that of the model."""

import dataclasses

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import Tried, Variant, along_each


def loads(p, given):
    """The loads with the acceleration added."""
    more = jnp.stack([p["x"], p["y"], p["z"]])[: given.more_gravity.shape[0]]
    return dataclasses.replace(given, more_gravity=given.more_gravity + more)


TERM = Term(
    id="gravity-error",
    place=510,
    says="Gravity acts in another direction, or on another weight, than the model says.",
    law="acceleration (x, y), in space (x, y, z), added to gravity",
    seen="The pose is off at every tension, as the whole body sags otherwise.",
    told_apart="Turn the rig: what turns with it is gravity.",
    quantities=(
        Quantity("x", "m/s^2", 0.0, 2.0, "Acceleration added along the base tangent.", (-10.0, 10.0)),
        Quantity("y", "m/s^2", 0.0, 2.0, "Acceleration added to its left.", (-10.0, 10.0)),
    ),
    across=(
        Quantity("z", "m/s^2", 0.0, 2.0, "Acceleration added out of the plane of x and y.", (-10.0, 10.0)),
    ),
    loads=loads,
    adds_to="gravity",
    tried=Tried(
        variants=(Variant(starts=lambda at, rig: along_each(at, (0.1, 0.5))),),
        where=lambda rig: rig.loaded,
    ),
)
