"""A dead force on the tip that the model does not know."""

import dataclasses

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import Tried, Variant, along_each


def loads(p, given):
    """The loads with the force added."""
    force = given.tip_force + jnp.stack([p["x"], p["y"], p["z"]])[: given.tip_force.shape[0]]
    return dataclasses.replace(given, tip_force=force)


TERM = Term(
    id="tip-load",
    place=500,
    says="A force pulls on the tip that the model does not know: a cable, a tool, a camera.",
    law="dead force (x, y), in space (x, y, z), on the tip",
    seen="The pose is off at every tension, most when slack; tensions hardly tell.",
    told_apart="Record the pose with the tendon slack; turn the rig: gravity turns with it.",
    quantities=(
        Quantity("x", "N", 0.0, 0.05, "Force along the base tangent.", (-0.5, 0.5)),
        Quantity("y", "N", 0.0, -0.05, "Force to its left.", (-0.5, 0.5)),
    ),
    across=(Quantity("z", "N", 0.0, 0.05, "Force out of the plane of x and y.", (-0.5, 0.5)),),
    loads=loads,
    adds_to="tip_force",
    tried=Tried(
        variants=(Variant(starts=lambda at, rig: along_each(at, (0.1, 0.5))),),
    ),
)
