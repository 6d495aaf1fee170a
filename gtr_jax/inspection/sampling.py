"""How a recording was sampled: rate, jitter, gaps, and stamps that repeat or run backwards."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from gtr_jax.recordings.signals.stretches import Stretch, stretches

GAP = 5.0
"""A step longer than so many median steps is a gap."""
PERCENTILES = (0, 1, 5, 50, 95, 99, 100)


@dataclasses.dataclass(frozen=True)
class Sampling:
    """The clock of a recording of K samples.

    Attributes:
        samples: K, with those that were masked.
        duration_s, rate_Hz: from the first stamp to the last, and one over the median step.
        step_s: percentiles of the step [s], by percentage.
        jitter: half the spread from the 5th to the 95th percentile, as a share of the median step.
        gaps: from the last sample before each to the first after it.
        missing_s: time that the gaps take beyond a usual step, in sum.
        repeated, reversed: number of steps of no time, and of negative time.
        reversed_at: first sample whose stamp is earlier than the one before; None if there is none.
    """

    samples: int
    duration_s: float | None = None
    rate_Hz: float | None = None
    step_s: Mapping[str, float] = dataclasses.field(default_factory=dict)
    jitter: float | None = None
    gaps: tuple[Stretch, ...] = ()
    missing_s: float = 0.0
    repeated: int = 0
    reversed: int = 0
    reversed_at: int | None = None


def sampling(time: np.ndarray | None, samples: int) -> Sampling:
    """The sampling of a recording.

    Args:
        time: stamps [s], (K,), in the order of the rows; None if the recording has no clock.
        samples: K.
    """
    if time is None or samples < 2:
        return Sampling(samples)
    steps = np.diff(time)
    onward = steps[steps > 0]
    repeated, backwards = int(np.sum(steps == 0)), np.flatnonzero(steps < 0)
    at = int(backwards[0]) + 1 if backwards.size else None
    if onward.size == 0:
        return Sampling(samples, repeated=repeated, reversed=len(backwards), reversed_at=at)
    levels = dict(zip(PERCENTILES, np.percentile(onward, PERCENTILES).tolist(), strict=True))
    usual = levels[50]
    wide = np.flatnonzero(steps > GAP * usual).tolist()
    return Sampling(
        samples,
        duration_s=float(time.max() - time.min()),
        rate_Hz=1.0 / usual,
        step_s={f"{p}%": v for p, v in levels.items()},
        jitter=(levels[95] - levels[5]) / 2 / usual,
        gaps=stretches(((i, i + 1) for i in wide), time),
        missing_s=float(np.sum(steps[wide] - usual)),
        repeated=repeated,
        reversed=len(backwards),
        reversed_at=at,
    )
