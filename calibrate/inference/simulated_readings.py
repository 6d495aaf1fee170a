"""The one door to simulated readings: what the instruments would show of a recording.

A fit asks for them at coordinates and with derivatives, which JAX has compiled (`predictor.py`). A diagnosis
and a plan ask for many at once with numbers by name, as native code and without derivatives
(`simulated_rig.py`). Whoever weighs readings need not know which of the two they come from.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np

from gtr_jax.simulation.phases import phases_of_slip

from .parallel import in_parallel


@dataclasses.dataclass(frozen=True, eq=False)
class SimulatedReadings:
    """What a simulation shows of a recording of K samples.

    Attributes:
        values: what the instruments would show, SI, (C, K).
        failed: load steps that did not meet their tolerance.
        slips: whether slip reaches the anchor, (K, *tendons).
        direction: of the slip at the base, (K, *tendons).
    """

    values: np.ndarray
    failed: int
    slips: np.ndarray
    direction: np.ndarray

    @property
    def tips(self) -> int:
        """How many of the values are tip tensions, one for each tendon."""
        return 1 if self.slips.ndim == 1 else self.slips.shape[1]

    @property
    def converged(self) -> bool:
        """Whether every load step met its tolerance."""
        return self.failed == 0

    @property
    def phases(self) -> np.ndarray:
        """Phase of each sample, (K, *tendons)."""
        if self.slips.ndim == 1:
            return phases_of_slip(self.slips, self.direction)
        each = map(phases_of_slip, self.slips.T, self.direction.T)
        return np.stack(list(each), axis=1)

    def flat(self) -> np.ndarray:
        """All in one array, which ends with the number of tendons: 0 without a tendon axis."""
        tendons = 0 if self.slips.ndim == 1 else self.tips
        each = (self.values, self.slips.T, self.direction.T)
        return np.concatenate([*(np.ravel(values) for values in each), [self.failed, tendons]])

    @staticmethod
    def of(flat: np.ndarray, samples: int) -> SimulatedReadings | None:
        """The inverse of `flat`; None for an empty array."""
        if not len(flat):
            return None
        failed, tendons = (int(number) for number in flat[-2:])
        rows, n = np.array(flat[:-2].reshape(-1, samples)), max(tendons, 1)
        slips, direction = rows[-2 * n : -n].T > 0, rows[-n:].T
        return SimulatedReadings(
            values=rows[: -2 * n],
            failed=failed,
            slips=slips if tendons else slips[:, 0],
            direction=direction if tendons else direction[:, 0],
        )

    def plus(self, channels: list[int], more: np.ndarray) -> SimulatedReadings:
        """A copy with `more`, (channels, K), added to some channels."""
        values = np.array(self.values)
        values[channels] += more
        return dataclasses.replace(self, values=values)


@dataclasses.dataclass(frozen=True, eq=False)
class Prediction(SimulatedReadings):
    """What a simulation shows, and its derivatives by p coordinates.

    Attributes:
        T_tip: simulated tension at the tip of each tendon [N], (tendons, K), among the values or not.
        jacobian: derivatives of the values by u, (C, K, p).
        slopes: for each tendon, derivative of the values with respect to a uniform shift of its base
            tension, per newton, (C, K); of a tendon that displacement drives, with respect to that, per
            metre. While friction holds the tip, that of T_tip is the one at the sample where it slipped last.
    """

    T_tip: np.ndarray
    jacobian: np.ndarray
    slopes: tuple[np.ndarray, ...]


Point = TypeVar("Point", contravariant=True)
Shown = TypeVar("Shown", bound=SimulatedReadings, covariant=True)


class Simulator(Protocol[Point, Shown]):
    """A recording that is simulated again and again: `Predictor` at coordinates, with derivatives, or
    `SimulatedRig` with numbers by name, as native code.

    Attributes:
        channels: names of what it shows, C of them.
    """

    @property
    def channels(self) -> Sequence[str]: ...

    def many(self, many: Sequence[Point]) -> Sequence[Shown | None]:
        """The recording at several points; None at those where the simulation breaks down."""
        ...


def simulate_all(
    recordings: Sequence[Simulator[Point, Shown]], many: Sequence[Point], *, in_threads: bool = False
) -> list[tuple[Shown, ...] | None]:
    """All recordings at each of several points; None at those where one breaks down.

    Args:
        recordings: what is simulated.
        many: the points.
        in_threads: simulate the recordings in threads beside each other. Who is in one of many threads
            already, as the searches of a diagnosis are, goes through them one by one, and no longer to the
            points at which one broke down.
    """
    if in_threads:
        each = in_parallel(lambda recording: recording.many(many), recordings)
    else:
        each, going = [], [*range(len(many))]
        for recording in recordings:
            here = dict(zip(going, recording.many([many[k] for k in going]), strict=True))
            each.append([here.get(k) for k in range(len(many))])
            going = [k for k in going if here[k] is not None]
    found: list[tuple[Shown, ...] | None] = []
    for k in range(len(many)):
        shown = tuple(own for own in (of[k] for of in each) if own is not None)
        found.append(shown if len(shown) == len(recordings) else None)
    return found
