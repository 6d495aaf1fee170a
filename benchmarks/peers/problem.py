"""The rod that every solver gets, and what counts as an answer. Imports what every environment has."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

LENGTH = 0.4  # m
RADIUS = 0.7e-3  # m, solid round
YOUNGS_MODULUS = 54e9  # Pa
OFFSET = 10e-3  # m, of the parallel tendon to the left of the midline
TENSION = 6.0  # N
BENDING_STIFFNESS = YOUNGS_MODULUS * math.pi * RADIUS**4 / 4  # N m^2
POISSONS_RATIO = 0.3  # for the twist, in space
# N m^2, of twist and both bendings.
STIFFNESS = np.array([BENDING_STIFFNESS / (1 + POISSONS_RATIO), BENDING_STIFFNESS, BENDING_STIFFNESS])
LEVELS = (1e-3, 1e-4, 1e-6)  # distance of the tip from the reference, over the length


@dataclass(frozen=True)
class Problem:
    """A planar, inextensible, unshearable rod, clamped along +x at the origin, with a frictionless tendon.

    Attributes:
        name: as in the tables.
        tip_force: dead force at the tip, x and y [N].
    """

    name: str
    tip_force: tuple[float, float]

    @property
    def loaded(self) -> bool:
        """Whether anything but the tendon acts."""
        return any(self.tip_force)


@dataclass(frozen=True)
class Channel:
    """A tendon's channel about the midline, its radius and angle linear in the arc length.

    Attributes:
        radius, tip_radius: at base and tip [m].
        turns: about the midline, from base to tip.
        start_angle: from y towards z [rad].
        tension: of its tendon [N].
    """

    radius: float
    tip_radius: float
    turns: float
    start_angle: float
    tension: float

    def __str__(self) -> str:
        ends = f"{self.radius * 1e3:g}"
        ends += f" to {self.tip_radius * 1e3:g}" if self.tip_radius != self.radius else ""
        turning = f", {self.turns:g} turn{'s' * (self.turns > 1)} about it" if self.turns else ""
        return (
            f"A tendon {ends} mm off the midline, at {math.degrees(self.start_angle):g}° "
            f"from y at the base{turning}, under {self.tension:g} N"
        )

    def place(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Offset from the midline and its slope, (3, n) each, at arc lengths (n,)."""
        growth, speed = (self.tip_radius - self.radius) / LENGTH, 2 * math.pi * self.turns / LENGTH
        radius, angle = self.radius + growth * s, self.start_angle + speed * s
        cos, sin, none = np.cos(angle), np.sin(angle), np.zeros_like(s)
        d = np.stack([none, radius * cos, radius * sin])
        slope = np.stack([none, growth * cos - radius * speed * sin, growth * sin + radius * speed * cos])
        return d, slope


@dataclass(frozen=True)
class SpatialProblem:
    """The same rod with frictionless tendons that take it out of every plane.

    Attributes:
        name: as in the tables.
        channels: one of each tendon.
        tip_force: dead force at the tip [N].
    """

    name: str
    channels: tuple[Channel, ...]
    tip_force: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def loaded(self) -> bool:
        """Whether anything but the tendons acts."""
        return any(self.tip_force)

    @property
    def shares(self) -> list[float]:
        """Tension of each tendon, over that of the first."""
        return [channel.tension / TENSION for channel in self.channels]


TENDON = Problem("tendon alone", (0.0, 0.0))
LOADED = Problem("tendon and tip force", (0.0, -0.1))
PLANAR = (TENDON, LOADED)
HELIX = SpatialProblem("helical tendon", (Channel(OFFSET, OFFSET, 1.0, 0.0, TENSION),))
CONVERGING = SpatialProblem(
    "converging tendons",
    (
        Channel(OFFSET, 0.4 * OFFSET, 0.0, 0.0, TENSION),
        Channel(OFFSET, 0.6 * OFFSET, 0.25, 2 * math.pi / 3, TENSION / 2),
    ),
)
LOADED_HELIX = SpatialProblem("helical tendon and tip force", HELIX.channels, (0.0, -0.1, 0.05))
SPATIAL = (HELIX, CONVERGING, LOADED_HELIX)
PROBLEMS: tuple[Problem | SpatialProblem, ...] = (*PLANAR, *SPATIAL)


@lru_cache
def reference(problem: Problem | SpatialProblem) -> tuple[float, ...]:
    """The tip [m], (2,) or in space (3,): a circular arc by its closed form, else by integration along the
    rod and shooting, to about 1e-13 (none of the solvers compared works that way).
    """
    return _spatial_tip(problem) if isinstance(problem, SpatialProblem) else _planar_tip(problem)


def _planar_tip(problem: Problem) -> tuple[float, float]:
    tip_curvature = TENSION * OFFSET / BENDING_STIFFNESS
    if not problem.loaded:
        angle = tip_curvature * LENGTH
        return math.sin(angle) / tip_curvature, (1 - math.cos(angle)) / tip_curvature

    def state(base_curvature: float) -> np.ndarray:
        fx, fy = problem.tip_force

        def slope(_, y):
            cos, sin = math.cos(y[0]), math.sin(y[0])
            return [y[1], (fx * sin - fy * cos) / BENDING_STIFFNESS, cos, sin]

        return solve_ivp(
            slope, (0.0, LENGTH), [0.0, base_curvature, 0.0, 0.0], "DOP853", rtol=2.3e-14, atol=1e-15
        ).y[:, -1]

    root = brentq(lambda k: state(k)[1] - tip_curvature, 0.0, 1.5 * tip_curvature, xtol=1e-14)
    _, _, x, y = state(float(root))  # pyright: ignore[reportArgumentType]
    return float(x), float(y)


def strain(problem: SpatialProblem, s: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Twist and bendings [1/m], (3, n), of sections at `s` [m], (n,), that carry the tendons and the moment
    of the force at the tip, in the section's axes [N m], (3, n); by Newton's method.
    """
    K, u, n = STIFFNESS[:, None], np.zeros((3, len(s))), len(s)
    along, eye = np.array([1.0, 0.0, 0.0])[:, None], np.eye(3)
    for _ in range(30):
        left, slope = K * u - moment, np.repeat(np.diag(STIFFNESS)[None], n, 0)
        for channel in problem.channels:
            d, dd = channel.place(s)
            w = along + np.cross(u, d, axis=0) + dd
            size = np.linalg.norm(w, axis=0)
            t = w / size
            left = left + channel.tension * np.cross(d, t, axis=0)
            # d x (I - t t') / |w| x (du x d): the change of t as the strain changes.
            across = np.stack([np.cross(e[:, None], d, axis=0) for e in eye], axis=-1)  # (3, n, 3)
            across = across - t[:, :, None] * np.einsum("in,inj->nj", t, across)[None]
            turned = np.cross(d.T[:, None, :], np.moveaxis(across, (0, 1, 2), (2, 0, 1)))  # (n, of, 3)
            slope = slope + channel.tension / size[:, None, None] * np.swapaxes(turned, 1, 2)
        step = np.linalg.solve(slope, left.T[:, :, None])[:, :, 0].T
        u = u - step
        if np.max(np.abs(step)) < 1e-14 * (1 + np.max(np.abs(u))):
            break
    return u


def _spatial_tip(problem: SpatialProblem) -> tuple[float, float, float]:
    force = np.asarray(problem.tip_force)

    def tip(guess: np.ndarray) -> np.ndarray:
        def slope(s, y):
            R, r = y[:9].reshape(3, 3), y[9:]
            moment = R.T @ np.cross(guess - r, force)
            x, y_, z = strain(problem, np.array([s]), moment[:, None])[:, 0]
            turn = np.array([[0.0, -z, y_], [z, 0.0, -x], [-y_, x, 0.0]])
            return np.concatenate([(R @ turn).ravel(), R[:, 0]])

        start = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
        return solve_ivp(slope, (0.0, LENGTH), start, "DOP853", rtol=1e-13, atol=1e-15).y[9:, -1]

    if problem.loaded:
        free = _spatial_tip(SpatialProblem("", problem.channels))
        found = root(lambda r: tip(r) - r, free, tol=1e-13).x
    else:
        found = tip(np.zeros(3))
    return float(found[0]), float(found[1]), float(found[2])


def error(problem: Problem | SpatialProblem, tip: Iterable[float]) -> float:
    """Distance of a tip from the reference, over the length."""
    return math.dist(reference(problem), [float(v) for v in tip]) / LENGTH


def cheapest(points: list[dict[str, Any]], problem: str, level: float) -> dict[str, Any] | None:
    """The fastest converged point of a problem that reaches a level; None where none does."""
    enough = [p for p in points if p["problem"] == problem and p["converged"] and p["error"] <= level]
    return min(enough, key=lambda p: p["warm_s"], default=None)
