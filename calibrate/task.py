"""What is fitted to what: the robot, its free parameters and their priors, and the recorded tensions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from gtr_jax import InputError, Recording, Robot, RobotConfig, build_robot
from gtr_jax.parameters import Parameter

from . import noise
from .base_tension import BaseTension, exact
from .coordinates import Coordinates, Prediction, Predictor, coordinates
from .descent import Objective
from .weighing import Weighing

LARGEST_FACTOR = 30.0
LARGEST_SHIFT = 2.0
SMALLEST_SIGMA = 1e-6
# Recordings longer than this are simulated at about as many samples, or at steps of this share of the range.
LONG, FINEST = 2000, 1 / 400


@dataclasses.dataclass
class Task:
    """One fit under way.

    Attributes:
        robot: with the values it starts from.
        config: its file, or None.
        chosen: the p free parameters.
        initial: their values, SI.
        priors: their relative standard deviations, None where nothing is known.
        T_base: estimate of the true base tension, and what the recorded one says of it.
        T_tip: as recorded [N], (K,).
        trial: number of the trial, (K,), or None.
        noise_N: standard deviation of T_tip [N] if given.
        max_steps: of the optimiser.
        progress: called with a line at each stage.
        warnings: sentences gathered on the way.
        evaluations: simulated recordings so far.
        profiled: whether profile likelihoods are wanted.
    """

    robot: Robot
    config: RobotConfig | None
    chosen: list[Parameter]
    T_base: BaseTension
    T_tip: np.ndarray
    trial: np.ndarray | None
    noise_N: float | None
    max_steps: int
    progress: Callable[[str], None]
    warnings: list[str]
    evaluations: int = 0
    profiled: bool = False
    initial: np.ndarray = dataclasses.field(init=False)
    priors: list[float | None] = dataclasses.field(init=False)

    def __post_init__(self):
        self.initial = np.asarray([float(self.robot.value(p.name)) for p in self.chosen])
        known = self.config.uncertainty if self.config is not None else {}
        self.priors = [known.get(p.key) for p in self.chosen]
        for i, (entry, value) in enumerate(zip(self.chosen, self.initial, strict=True)):
            if value == 0 and self.priors[i] is not None:
                self.warnings.append(
                    f"The uncertainty of {entry.name} is relative and its value 0: not used."
                )
                self.priors[i] = None

    @property
    def names(self) -> list[str]:
        """Short names of the free parameters."""
        return [p.name for p in self.chosen]

    @property
    def peak(self) -> float:
        """Largest recorded tip tension [N]."""
        return float(np.max(self.T_tip))

    @property
    def smallest_sigma(self) -> float:
        """Error [N] below which the recording is not resolved, whatever its noise."""
        return SMALLEST_SIGMA * max(
            float(np.max(np.abs(self.T_base.T_base))), float(np.max(np.abs(self.T_tip))), 1e-3
        )

    def noise(self, fitted: Prediction | None = None) -> noise.Noise:
        """The noise given, or estimated; better so once a fitted model tells which stretches are locked."""
        if self.noise_N is not None:
            return noise.Noise(self.noise_N, "given")
        base = self.T_base
        if fitted is None:
            return noise.estimate(base.T_base, self.T_tip, self.trial, None)
        passed_on = float(np.mean(np.where(fitted.slips, fitted.slope, 0.0) ** 2)) * base.sd**2
        return noise.estimate(base.T_base, self.T_tip, self.trial, ~fitted.slips, passed_on)

    def nodes(self) -> np.ndarray | None:
        """Samples to simulate; None for all of them, as in a recording that is not long."""
        K = len(self.T_tip)
        if K <= LONG or self.T_base.sd == 0:
            return None
        travel = float(np.sum(np.abs(np.diff(self.T_base.T_base[self.T_base.knots]))))
        return self.T_base.nodes(max(travel / LONG, FINEST * float(np.ptp(self.T_base.T_base)), 1e-9))

    def coordinates(self, values: np.ndarray) -> Coordinates:
        """Coordinates with their origin at some values (SI, (p,))."""
        return coordinates(self.robot, self.chosen, dict(zip(self.names, values.tolist(), strict=True)))

    def objective(self, at: Coordinates, samples: np.ndarray, sigma: float) -> Objective:
        """Least squares on some of the samples, all with the same error sigma [N], and on the priors."""
        T_base = self.T_base.T_base[samples]
        whole = len(samples) == len(self.T_tip)
        log, scale = np.asarray(at.log), np.asarray(at.scale)
        has = np.asarray([p is not None for p in self.priors])
        relative = np.asarray([p or 1.0 for p in self.priors])
        spread = np.where(log, relative, relative * np.abs(self.initial) / scale)
        return Objective(
            predict=Predictor(self.robot, at, T_base, self.nodes() if whole else None),
            recorded=self.T_tip[samples],
            weigh=Weighing.plain(exact(T_base), sigma),
            centre=np.where(has, at.at(np.where(has, self.initial, np.asarray(at.reference))), 0.0),
            precision=np.where(has, 1 / np.where(has, spread, 1.0), 0.0),
            reach=np.where(log, np.log(LARGEST_FACTOR), LARGEST_SHIFT),
        )


def tensions(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Base and tip tension of a recording that can be fitted to.

    Raises:
        InputError: no tip tension, columns that do not match, fewer than four samples, numbers that are not
            finite.
    """
    where = recording.path
    if recording.T_tip is None:
        raise InputError(f"{where}: no tip tension to fit to; map it with --columns 'T_tip=NAME[N]'")
    T_base, T_tip = np.asarray(recording.T_base, float), np.asarray(recording.T_tip, float)
    if T_base.shape != T_tip.shape or T_base.ndim != 1:
        raise InputError(
            f"{where}: T_base and T_tip have {T_base.shape} and {T_tip.shape} samples; make them equal"
        )
    if len(T_base) < 4:
        raise InputError(f"{where}: {len(T_base)} samples are too few to fit to; give 4 or more")
    if not (np.all(np.isfinite(T_base)) and np.all(np.isfinite(T_tip))):
        raise InputError(f"{where}: T_base or T_tip is not finite in places; delete these samples")
    return T_base, T_tip


def robot_of(robot: RobotConfig | Robot) -> tuple[Robot, RobotConfig | None]:
    """The traced robot, and its file if one was given."""
    return (robot, None) if isinstance(robot, Robot) else (build_robot(robot), robot)
