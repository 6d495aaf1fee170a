"""The robot of a recording moved along it, for pictures: a simulation of the samples worth drawing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from calibrate.inference.load_history import padded_history, simulation_along
from gtr_jax import Robot, Simulation
from gtr_jax.recordings.base_tension import turning_points
from gtr_jax.report.motion import body_of

BODIES, FEWEST = 200, 20  # steps at which the bodies of a page are shown: in all, and at least of each
MOST = 2000  # samples that are simulated; beyond it only these and where the tension turns
TURN = 0.02  # share of its range by which what drives a tendon goes back where it turns


class Motion(NamedTuple):
    """A simulation of J samples of a recording: which they are, (J,), the run, whose further steps are
    padding, and the robot.
    """

    samples: np.ndarray
    run: Simulation
    robot: Robot

    @property
    def top(self) -> int:
        """Step of the largest base tension."""
        pulls = np.asarray(self.run.T_base)[: len(self.samples)].reshape(len(self.samples), -1)
        return int(np.argmax(np.max(pulls, axis=1)))

    def body(self, most: int) -> dict[str, Any]:
        """What a playback needs to draw the body at up to so many steps."""
        return body_of(
            self.robot, self.run, first=self.top, steps=len(self.samples), samples=self.samples, most=most
        )


def motion_along(robot: Robot, drive: np.ndarray, time: np.ndarray | None) -> Motion | None:
    """The robot moved along a recording; None if it breaks down on the way.

    Args:
        robot: as fitted.
        drive: what drives the tendons, (K, *tendons): tension [N], or displacement [m].
        time: of the samples [s], (K,), or None.
    """
    samples = _samples(drive)
    drawn = tuple(tendon.drive == "displacement" for tendon in robot.tendons)
    clock = None if time is None else np.asarray(time)[samples]
    run = simulation_along(robot, padded_history(drive[samples], clock, None, drawn=drawn))
    finite = np.all(np.isfinite(np.asarray(run.tip_position)[: len(samples)]))
    return Motion(samples, run, robot) if finite else None


def _samples(drive: np.ndarray) -> np.ndarray:
    K = len(drive)
    if K <= MOST:
        return np.arange(K)
    each = drive.reshape(K, -1).T
    turns = [k for own in each for k in turning_points(own, TURN * float(np.ptp(own)))]
    return np.unique([*np.linspace(0, K - 1, MOST).round().astype(int), *turns])
