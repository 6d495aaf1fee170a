"""How far the channels of several tendons run from one another in the section."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..mechanics.offset import SpatialOffset
from .parts import Parts, Tendon
from .routing import Routing

POINTS = 2001  # places along the body that are looked at
TOUCHING = 1e-6  # m, below which two channels are at one place


class Distance(NamedTuple):
    """How far two channels run from one another.

    Attributes:
        first, second: names of their tendons.
        least: smallest distance of their centre lines [m].
        at: arc length of it [m].
        most: largest distance [m].
    """

    first: str
    second: str
    least: float
    at: float
    most: float

    @property
    def says(self) -> str:
        """A sentence where the channels run through one another; else ""."""
        if self.least > TOUCHING:
            return ""
        return (
            f"The channels of {self.first} and {self.second} run through one another at s = "
            f"{1e3 * self.at:.4g} mm; the model does not hinder the tendons there."
        )


def distances(robot: Parts) -> list[Distance]:
    """The distance of each pair of channels, as far as both tendons run."""
    return [_distance(robot, *pair) for pair in itertools.combinations(robot.tendons, 2)]


def _distance(robot: Parts, first: Tendon, second: Tendon) -> Distance:
    length = float(robot.backbone.length)
    end = min(length if t.to is None else float(t.to) for t in (first, second))
    s = np.linspace(0.0, end, POINTS)
    one, other = (place_in_section(t, s, length) for t in (first, second))
    apart = one - other
    # The nearest point of each chord between two places, so that channels that cross there are found.
    start, chord = apart[:-1], np.diff(apart, axis=0)
    square = np.sum(chord**2, axis=1)
    part = np.clip(-np.sum(start * chord, axis=1) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    gaps = np.hypot(*(start + part[:, None] * chord).T)
    i = int(np.argmin(gaps))
    at = s[i] + part[i] * (s[i + 1] - s[i])
    return Distance(first.name, second.name, float(gaps[i]), float(at), float(np.hypot(*apart.T).max()))


def place_in_section(tendon: Tendon, s: np.ndarray, length: float) -> np.ndarray:
    """Where a channel runs in the section, y and z [m], (N, 2), at arc lengths [m], (N,), of a body of some
    length [m].
    """
    passed = tendon.routing.kinks()[:, None] <= s[None, :]
    return np.asarray(offsets(tendon.routing, jnp.asarray(s), jnp.asarray(passed), jnp.asarray(length)).value)


@eqx.filter_jit
def offsets(
    routing: Routing, s: Float[Array, " N"], passed: Bool[Array, "kinks N"], length: Float[Array, ""]
) -> SpatialOffset:
    """`Routing.section_offset`, as one program."""
    return routing.section_offset(s, passed, length)
