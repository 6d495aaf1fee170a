"""What differs between short and long recordings: long ones show what their instruments add, and hold
stretches in which something acts that no model has.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from calibrate.inference.setup import Observation
from gtr_jax.recordings.signals.noise import MAD_TO_SD, correlation_time

from .structure import HALF_STAYS, may_stay

# Samples from which on a recording shows what its instruments add.
LONG = 1000
# Times what is usual: rows beyond it count only a little more.
HEAVY = 4.0
# Times that events from outside are looked for, each with a better fit.
LOOKS = 2
# Errors of the base tension's corners grow with the readings: nothing is claimed below this drop of the sum
# of squares for each of the tip's. On a sound recording made as rigs make them viscous friction gained 0.015;
# on another an offset and a saturation of the tip's cell, which were there, 0.4.
FOR_EACH = 0.03


@dataclasses.dataclass(frozen=True)
class ShortRecordings:
    """What a fit leaves of short recordings is noise, or something that is missing.

    Attributes:
        tail: in standard deviations: rows much beyond it count only a little more than those at it; None
            where all count by their squares.
        fits_instruments: whether a delay and drifts of the cells are fitted beside every hypothesis.
        looks_outside: how often stretches in which something outside the model acts are looked for and left
            out before effects are tried; where not at all, the answer is looked at for them.
        error_of_unknown_cause: whether what even the best fit leaves counts as one in probabilities.
        weighed_by_the_best: whether all models are weighed by the one that fits best as weighed by itself.
        judged_by_all_rows: whether all rows judge what pays on unseen samples, not the readings explained.
        unseen_narrow: whether unseen samples tell apart models that the evidence does not.
        laws_beside_the_base: whether laws are looked for beside the base model where effects explain a part.
        laws_settle: whether fits of laws are taken on until their cost no longer falls: far from the data,
            rows that count less when far off show no way.
    """

    tail: float | None = dataclasses.field(default=None, init=False)
    fits_instruments = False
    looks_outside = 0
    error_of_unknown_cause = False
    weighed_by_the_best = False
    judged_by_all_rows = False
    unseen_narrow = False
    laws_beside_the_base = True
    laws_settle = False

    def robustify(self, rows: np.ndarray) -> np.ndarray:
        """White rows, (n,), so that their squares sum to what is minimised."""
        return rows

    def unrobustify(self, rows: np.ndarray) -> np.ndarray:
        """The inverse of `robustify`."""
        return rows

    def adapted(self, explained: Callable[[], np.ndarray]) -> ShortRecordings:
        """The same for recordings whose white rows of what is explained are as given."""
        del explained
        return self

    def samples_per_independent(self, row: np.ndarray) -> float:
        """By how many samples of a residual without what is known one of noise stands, (K,)."""
        del row
        return 1.0

    def least_drop(self, parts: Sequence[Observation]) -> float:
        """Drop of the sum of squares that errors of the base tension may cause."""
        del parts
        return 0.0

    def may_stay(self, left: tuple[float, float]) -> float:
        """Share of the structure of the base model that a model may leave of which effects explain a part."""
        return may_stay(left)


@dataclasses.dataclass(frozen=True)
class LongRecordings(ShortRecordings):
    """Long recordings hold stretches in which something outside any model acts, and a few samples in steep
    slopes; counted by their squares, these decide every fit. Even the best fit leaves more than noise.
    """

    tail: float = dataclasses.field(default=HEAVY)
    fits_instruments = True
    looks_outside = LOOKS
    error_of_unknown_cause = True
    weighed_by_the_best = True
    judged_by_all_rows = True
    unseen_narrow = True
    laws_beside_the_base = False
    laws_settle = True

    def robustify(self, rows: np.ndarray) -> np.ndarray:
        """White rows, (n,), so that their squares sum, with the tail c, to that of c^2 ln(1 + r^2/c^2), which
        a Student distribution of the errors has (Barron 2019, eq. 12).
        """
        return np.sign(rows) * self.tail * np.sqrt(np.log1p((rows / self.tail) ** 2))

    def unrobustify(self, rows: np.ndarray) -> np.ndarray:
        """The inverse of `robustify`."""
        return np.sign(rows) * self.tail * np.sqrt(np.expm1((rows / self.tail) ** 2))

    def adapted(self, explained: Callable[[], np.ndarray]) -> LongRecordings:
        """The same with rows far off at `HEAVY` times what is usual: a law that is missing is wrong by many
        standard deviations of the noise wherever it applies.
        """
        return LongRecordings(HEAVY * max(1.0, MAD_TO_SD * float(np.median(np.abs(explained())))))

    def samples_per_independent(self, row: np.ndarray) -> float:
        """Slow noise, and what a hold has in common with the peak before it, pass for a bump: samples count
        by how independent they are.
        """
        return correlation_time(row)

    def least_drop(self, parts: Sequence[Observation]) -> float:
        """The same, which grows with the readings."""
        return FOR_EACH * sum(part.explained * int(part.counted.sum()) for part in parts)

    def may_stay(self, left: tuple[float, float]) -> float:
        """Every effect pays on unseen cycles: half of what is left in squares may stay."""
        del left
        return HALF_STAYS


def rules_for(parts: Sequence[Observation]) -> ShortRecordings:
    """The rules for recordings: one is long if it shows what its instruments add, and what happens once;
    several share no drift, and need not share a delay.
    """
    long = len(parts) == 1 and parts[0].time is not None and parts[0].samples >= LONG
    return LongRecordings() if long else ShortRecordings()
