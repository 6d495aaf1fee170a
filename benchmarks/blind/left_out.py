"""Cases whose cause is a term that is taken out of the catalogue: is it found as a law?

A case has one effect; the name of its term lies beside the recording, because whoever answers leaves it out.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from . import cases
from .cases import Case
from .effects import CATALOGUE

# Hook and variable of each effect whose cause is a law of one variable.
PLACES = {
    "pressure": ("friction", "p"),
    "stribeck": ("friction", "v"),
    "viscous": ("friction", "v"),
    "wear": ("friction", "n"),
    "drift": ("friction", "t"),
    "patch": ("friction", "s"),
    "adhesion": ("drag", "s"),
    "clearance": ("friction", "T"),
    "stiffening": ("bending", "k"),
    "saturation": ("tip_cell", "T"),
}
# Other hooks that are right: viscous friction is of the speed of the load step, friction of that before.
ALSO = {"viscous": (("viscous", "v"),)}


def kinds(rng: np.random.Generator, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """What the cases hide, in turn."""
    turn = rng.permutation(list(PLACES))
    return [("single", (str(turn[k % len(turn)]),)) for k in range(count)]


def make(kind: str, hidden: tuple[str, ...], rng: np.random.Generator) -> Case | None:
    """A case; None where the machine fails, so that another must be drawn."""
    case = cases.make(kind, hidden, rng)
    return None if case is None else dataclasses.replace(case, without=CATALOGUE[hidden[0]][0])
