"""The rod that every solver gets, and what counts as an answer. Imports what every environment has."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

LENGTH = 0.4  # m
RADIUS = 0.7e-3  # m, solid round
YOUNGS_MODULUS = 54e9  # Pa
OFFSET = 10e-3  # m, of the parallel tendon to the left of the midline
TENSION = 6.0  # N
BENDING_STIFFNESS = YOUNGS_MODULUS * math.pi * RADIUS**4 / 4  # N m^2
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


TENDON = Problem("tendon alone", (0.0, 0.0))
LOADED = Problem("tendon and tip force", (0.0, -0.1))
PROBLEMS = (TENDON, LOADED)


@lru_cache
def reference(problem: Problem, tension: float = TENSION) -> tuple[float, float]:
    """The tip [m]: a circular arc by its closed form, else by shooting to about 1e-13 (none of the solvers
    compared works that way).
    """
    tip_curvature = tension * OFFSET / BENDING_STIFFNESS
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


def error(problem: Problem, tip: Iterable[float]) -> float:
    """Distance of a tip from the reference, over the length."""
    return math.dist(reference(problem), [float(v) for v in tip]) / LENGTH


def cheapest(points: list[dict[str, Any]], problem: str, level: float) -> dict[str, Any] | None:
    """The fastest converged point of a problem that reaches a level; None where none does."""
    enough = [p for p in points if p["problem"] == problem and p["converged"] and p["error"] <= level]
    return min(enough, key=lambda p: p["warm_s"], default=None)
