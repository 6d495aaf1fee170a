"""The body that nothing loads, and the channels in it, as lines along the midline's arc length.

The base is at the origin, its tangent along x, its left normal along y. A notched tube is drawn as it is cut:
straight at its notches, whatever angle they keep afterwards.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from gtr_jax.config.midline import Midline, midline
from gtr_jax.robot.clearance import place_in_section
from gtr_jax.robot.parts import Parts, Tendon
from gtr_jax.robot.robot import Robot

BLOCK = 512  # arc lengths that are evaluated together: JAX compiles for every new number of them


@dataclasses.dataclass(frozen=True, eq=False)
class Unloaded:
    """A body at rest.

    Attributes:
        robot: of which.
        midline: as it is at rest.
    """

    robot: Parts
    midline: Midline

    @property
    def length(self) -> float:
        """Of the body [m]."""
        return float(self.robot.backbone.length)

    @property
    def straight(self) -> bool:
        """Whether the midline is straight and untwisted."""
        return self.midline.straight

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Midline [m], (N, 3), and directors as columns, (N, 3, 3), at arc lengths [m], (N,)."""
        return self.midline.at(s)

    def beside(self, place: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        """The line, places [m], (N, 3), over arc length, that runs at places (y, z) in the sections [m],
        (N, 2).
        """

        def line(s: np.ndarray) -> np.ndarray:
            middle, frames = self.at(s)
            return middle + np.einsum("nij,nj->ni", frames[:, :, 1:], place(s))

        return line

    def channel(self, tendon: Tendon) -> Callable[[np.ndarray], np.ndarray]:
        """The centre line of a channel, places [m], (N, 3), over arc length."""
        return self.beside(lambda s: in_blocks(lambda s: place_in_section(tendon, s, self.length), s))

    def kinks(self, tendon: Tendon) -> list[float]:
        """Arc lengths where the second derivative of a channel may jump [m]."""
        return [*self.kinks_of_body(), *(float(k) for k in np.asarray(tendon.routing.kinks()))]

    def kinks_of_body(self) -> list[float]:
        """The same of the midline."""
        return [float(k) for knots in self.robot.backbone.kinks() for k in np.asarray(knots)]


def unloaded(robot: Robot) -> Unloaded:
    """A robot's body at rest."""
    body = robot.backbone

    def strain(s: np.ndarray) -> np.ndarray:
        return in_blocks(lambda s: body.strain_at_rest(jnp.asarray(s)), s)[:, :3]

    kinks = [float(k) for knots in body.kinks() for k in np.asarray(knots)]
    return Unloaded(robot, midline(float(body.length), strain, kinks))


def in_blocks(along: Callable[[np.ndarray], Any], s: np.ndarray) -> np.ndarray:
    """What a function computes at arc lengths [m], (N, ...), called with `BLOCK` of them at a time."""
    s = np.asarray(s, float)
    padded = np.resize(np.pad(s, (0, -len(s) % BLOCK), mode="edge"), (-(-len(s) // BLOCK), BLOCK))
    return np.concatenate([np.asarray(along(block)) for block in padded])[: len(s)]


def end_of(tendon: Tendon, length: float) -> float:
    """Arc length where a tendon ends [m]."""
    return length if tendon.to is None else float(tendon.to)


def stops_of(tendon: Tendon, length: float) -> np.ndarray | None:
    """Arc lengths [m] between which a guided tendon runs straight, from the base to its anchor; None of one
    in a channel.
    """
    if tendon.guides is None:
        return None
    end = end_of(tendon, length)
    return np.unique(np.clip([0.0, *np.asarray(tendon.guides), end], 0.0, end))
