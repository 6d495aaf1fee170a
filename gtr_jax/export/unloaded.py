"""The body that nothing loads, and the channels in it, as lines along the midline's arc length.

The base is at the origin, its tangent along x, its left normal along y. A notched tube is drawn as it is cut:
straight at its notches, whatever angle they keep afterwards.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from gtr_jax.robot.channel_table import natural_shape
from gtr_jax.robot.clearance import place_in_section
from gtr_jax.robot.parts import Parts, Tendon
from gtr_jax.robot.robot import Robot

PLACES = 1001  # along the body, at which its shape is known; between them it is followed in one step
BLOCK = 512  # arc lengths that are evaluated together: JAX compiles for every new number of them


@dataclasses.dataclass(frozen=True, eq=False)
class Unloaded:
    """The midline of a body at rest.

    Attributes:
        robot: of which.
        s: arc lengths where it is known [m], (M,).
        middle: midline there [m], (M, 3).
        frames: directors of the sections as columns, (M, 3, 3).
    """

    robot: Parts
    s: np.ndarray
    middle: np.ndarray
    frames: np.ndarray

    @property
    def length(self) -> float:
        """Of the body [m]."""
        return float(self.robot.backbone.length)

    @functools.cached_property
    def straight(self) -> bool:
        """Whether the midline is straight and untwisted."""
        return not np.any(self._strain(self.s))

    def _strain(self, s: np.ndarray) -> np.ndarray:
        return in_blocks(lambda s: self.robot.backbone.strain_at_rest(jnp.asarray(s)), s)[:, :3]

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Midline [m], (N, 3), and directors as columns, (N, 3, 3), at arc lengths [m], (N,)."""
        s = np.asarray(s, float)
        if self.straight:
            return s[:, None] * np.eye(3)[0], np.broadcast_to(np.eye(3), (len(s), 3, 3))
        below = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 1)
        step = (s - self.s[below])[:, None]
        strain = self._strain(self.s[below] + 0.5 * step[:, 0])
        half, whole = (Rotation.from_rotvec(part * step * strain).as_matrix() for part in (0.5, 1.0))
        ahead = np.einsum("nij,nj->ni", self.frames[below], half[:, :, 0])
        return self.middle[below] + step * ahead, self.frames[below] @ whole

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
    length = float(robot.backbone.length)
    even = np.linspace(0.0, length, PLACES)
    kinks = [np.asarray(knots) for knots in robot.backbone.kinks()]
    s = np.unique(np.clip(np.concatenate([even, *kinks]), 0.0, length))
    return Unloaded(robot, s, *natural_shape(robot, s))


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
