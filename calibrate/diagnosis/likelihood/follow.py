"""How recordings respond to the uncertain dimensions of the robot file, to first order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calibrate.inference.number import Number, number_at
from calibrate.inference.simulated_rig import friction_of
from gtr_jax import Robot, RobotConfig
from gtr_jax.robot.parameters import parameters_of
from gtr_jax.robot.stiffness import stiffness_of


class Follow(NamedTuple):
    """How the recordings respond to the uncertain dimensions, each moved by its standard deviation.

    Attributes:
        change: of the channels of each recording, (C, K, D) each.
        left, sizes, right: singular value decomposition of the change of the whitened rows, (n, D): (n, m),
            (m,), (m, D).
    """

    change: list[np.ndarray]
    left: np.ndarray
    sizes: np.ndarray
    right: np.ndarray

    def freed(self, rows: np.ndarray, followed: np.ndarray) -> np.ndarray:
        """Rows of unit variance, (n,), once the dimensions may follow those in `followed`, (n,)."""
        shares = 1 - 1 / np.sqrt(1 + self.sizes**2)
        return rows - (self.left * shares) @ (self.left.T @ followed)

    def moved(self, freed: np.ndarray) -> np.ndarray:
        """By how many standard deviations the dimensions then move, (D,)."""
        return -self.right.T @ (self.sizes / np.sqrt(1 + self.sizes**2) * (self.left.T @ freed))


def dimensions_of(config: RobotConfig | None, robot: Robot) -> list[Number]:
    """Numbers other than friction and stiffness that the robot file calls uncertain and that act."""
    if config is None:
        return []
    found, own = [], {*friction_of(robot), *stiffness_of(robot)}
    for entry in parameters_of(robot).values():
        sd = None if entry.name in own else config.deviation(entry.key)
        if sd and not (entry.external and not robot.loaded):
            found.append(number_at(entry, float(robot.value(entry.name)), sd=sd))
    return found
