"""What a recording leaves open, and which further measurement would settle it.

Where two parameters trade off, the covariance of the estimates has a long axis. Measurements that cost a
laboratory little are simulated with the fitted robot, their Fisher information is added to the recording's,
and the one that shortens the axis most is named with what it would bring.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from calibrate.inference.coordinates import Coordinates
from calibrate.inference.estimate import FLAT, UNKNOWN, UNKNOWN_WITHOUT_SCALE
from calibrate.inference.objective import SHARED
from calibrate.inference.predictor import Predictor
from calibrate.inference.setup import Observation, Setup

from .start import thin

# Blocks of the thinned recording, and samples of each branch of the simulated pull.
STEPS = 40
HIGHER = 1.5  # times the largest base tension
# Standard deviation of the tip angle in a proposed measurement [rad], and of a tip tension where none was
# recorded, as a share of the largest base tension.
ANGLE_SD, TENSION_SD = np.radians(1.0), 0.01
# Components below this share of the largest are left out of words.
MINOR = 0.1
# A measurement is worth naming if the largest standard error falls below this share of its present value.
WORTHWHILE = 0.7


@dataclasses.dataclass(frozen=True, eq=False)
class Axis:
    """A combination of the free numbers whose error is independent of those of the others.

    Attributes:
        direction: in coordinates, of unit length, (p,).
        sd: standard deviation along it, in coordinates: relative where a number is fitted on its own scale;
            infinite where nothing is known.
    """

    direction: np.ndarray
    sd: float

    def words(self, names: Sequence[str], steps: Sequence[str]) -> str:
        """The combination, scaled to a change of 1 % of its largest part; `steps` holds the unit for each."""
        return ", ".join(
            f"{name} {'up' if change > 0 else 'down'} by {abs(change):.2g} {step}"
            for name, change, step in self._parts(names, steps)
        )

    def in_a_sentence(self, names: Sequence[str], steps: Sequence[str]) -> str:
        """The same as something done: "mu is raised by 1 % and E is lowered by 0.5 %"."""
        return listed(
            f"{name} is {'raised' if change > 0 else 'lowered'} by {abs(change):.2g} {step}"
            for name, change, step in self._parts(names, steps)
        )

    def _parts(self, names: Sequence[str], steps: Sequence[str]) -> Iterator[tuple[str, float, str]]:
        part = self.direction / self.direction[np.argmax(np.abs(self.direction))]
        for i in map(int, np.argsort(-np.abs(part))):
            if abs(part[i]) >= MINOR:
                yield names[i], float(part[i]), steps[i]


def listed(words: Iterable[str]) -> str:
    """Words with commas between and "and" before the last."""
    every = list(words)
    return " and ".join([", ".join(every[:-1]), every[-1]] if every[1:] else every)


def axes(information: np.ndarray) -> list[Axis]:
    """Principal axes of the Fisher information in coordinates, (p, p), least known first."""
    values, vectors = np.linalg.eigh(information)
    floor = FLAT * max(float(values[-1]), 1e-300)
    return [
        Axis(v, float(1 / np.sqrt(value)) if value > floor else np.inf)
        for value, v in zip(values, vectors.T, strict=True)
    ]


def _measurements(
    part: Observation, at: Coordinates, u: np.ndarray, sd: float | None, of: str
) -> Iterator[tuple[str, np.ndarray]]:
    """Each measurement in words, with its Fisher information in the coordinates, (p, p): of what the
    instruments show, as in the recording. None for a robot of several tendons, or of one that displacement
    drives.
    """
    if len(part.pulled) != 1 or part.others:
        return

    def information(T_base, time, channel, error):
        channels = part.channels if channel in part.channels else (*part.channels, channel)
        shown = Predictor(
            part.robot, at, T_base, time, channels=channels, length=part.steps if part.steps <= SHARED else 0
        )(u)
        if shown is None or shown.failed:
            return np.zeros((len(u), len(u)))
        rows = shown.jacobian[channels.index(channel)]
        return rows.T @ rows / error**2

    few = thin(part.T_base.T_base, STEPS)
    history, time = part.T_base.T_base[few], None if part.time is None else part.time[few]
    if "tip_angle" not in part.channels and not part.robot.space and not part.robot.backbone.rigid:
        yield (
            f"the angle of the tip{of}, recorded to 1° beside the {'tensions' if part.tips else 'rest'},",
            information(history, time, "tip_angle", ANGLE_SD),
        )
    if sd is None:
        error = TENSION_SD * float(np.max(history))
        if error <= 0:  # nobody pulls: there is no tension to record
            return
        yield (
            f"the tension at the tip{of}, recorded to {error:.2g} N,",
            information(history, time, "T_tip", error),
        )
        return
    peak = HIGHER * float(np.max(history))
    loop = np.concatenate([np.linspace(0.0, peak, STEPS), np.linspace(peak, 0.0, STEPS)[1:]])
    yield f"a pull{of} to {peak:.3g} N and back", information(loop, None, "T_tip", sd)


def remedy(
    setup: Setup,
    at: Sequence[Coordinates],
    u: np.ndarray,
    information: np.ndarray,
    sd: Sequence[float | None],
    among: list[int],
) -> str:
    """The measurement that would tell some of the parameters apart, in a sentence; "" if none here would:
    with it each of them has to be known, and clearly better than now.

    Args:
        setup, at: the fit and the coordinates of its recordings.
        u: where it ended, (p,).
        information: the Fisher information of recordings and priors, (p, p).
        sd: effective standard deviation of each recording's tip tension [N]; None where it has none.
        among: the parameters in question.
    """
    before = _errors(information)
    scaled = np.asarray(at[0].log) | (np.asarray(at[0].reference) != 0)
    known = np.where(scaled, UNKNOWN, UNKNOWN_WITHOUT_SCALE)
    best, words = WORTHWHILE, ""
    several = len(setup.parts) > 1
    offers = itertools.chain(
        *(
            _measurements(part, a, u, error, f" of {part.name}" if several else "")
            for part, a, error in zip(setup.parts, at, sd, strict=True)
        )
    )
    for name, more in offers:
        after = _errors(information + more)
        if not np.all(after[among] < known[among]):
            continue
        gain = float(np.max(after[among] / np.minimum(before[among], 1e3)))
        if gain < best:
            best = gain
            each = ", ".join(
                f"{setup.names[i]} to {100 * after[i]:.2g} %"
                if bool(np.asarray(at[0].log)[i])
                else setup.names[i]
                for i in among
            )
            words = f"{name} would tell them apart ({each})"
    return words


def singular(information: np.ndarray) -> bool:
    """Whether the Fisher information, (p, p), leaves some combination open altogether: to rounding, nothing
    that was recorded depends on it.
    """
    return not np.all(np.isfinite(_errors(information)))


def _errors(information: np.ndarray) -> np.ndarray:
    """Standard errors, (p,); infinite along directions about which nothing is known."""
    size = np.sqrt(np.diag(information))
    if np.any(size == 0):
        return np.where(size == 0, np.inf, np.nan)
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    with np.errstate(divide="ignore"):
        inverse = np.where(values > FLAT, 1 / np.maximum(values, 1e-300), np.inf)
    spread = np.where(vectors**2 > 1e-12, vectors**2 * inverse, 0.0).sum(axis=1)
    return np.sqrt(spread) / size
