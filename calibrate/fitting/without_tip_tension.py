"""How far a fitted model is from a recording without tip tension, in words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calibrate.inference.answer import Judged
from calibrate.inference.channels import ORIENTATION, chosen_by, unit_of, words_of
from calibrate.inference.setup import Observation
from gtr_jax.recordings.signals.noise import FEWEST_SAMPLES

from .fitted import FittedRecording
from .verdict import SMALL, in_unit, most_of_noise

# So many of what was compared, the worst first, are named.
NAMED = 3


class Compared(NamedTuple):
    """A channel, or all axes of a marker's place or of the tip's rotation together.

    Attributes:
        words: what it is.
        rms: of the residual, outliers left out, in the SI unit.
        noise: differences of neighbouring samples, one standard deviation.
        unit: SI unit.
        described: whether the residual is no more than that noise, or small.
    """

    words: str
    rms: float
    noise: float
    unit: str
    described: bool

    def off(self, known: bool) -> str:
        """How far the model is off, with the noise where that is known."""
        beside = f" (neighbouring samples by {in_unit(self.noise, self.unit)})" if known else ""
        return f"{in_unit(self.rms, self.unit)} rms in {self.words}{beside}"


class DistanceWithoutTip(NamedTuple):
    """How far the fitted model is from one recording that has no tip tension.

    Attributes:
        name: of the recording.
        known: whether the noise of what was compared can be told.
        compared: what was compared, the worst described first.
        outliers: samples that count less than half.
    """

    name: str
    known: bool
    compared: list[Compared]
    outliers: int

    @property
    def described(self) -> bool:
        """Whether the residuals are no more than noise."""
        return self.known and all(c.described for c in self.compared)

    @property
    def bad(self) -> bool:
        """Whether the model falls short of the recording."""
        return self.known and not self.described

    def clauses(self) -> list[str]:
        """How the model describes this recording; begins a sentence or follows "but"."""
        listed = [c for c in self.compared if not self.bad or not c.described]
        more = f", and {len(listed) - NAMED} more" if len(listed) > NAMED else ""
        but = f", without {self.outliers} outliers" if self.outliers else ""
        off = f"off by {', '.join(c.off(self.known) for c in listed[:NAMED])}{more}{but}"
        if not self.known:
            return [f"the fitted model is {off}, from the recording, whose noise cannot be estimated"]
        if self.described:
            return [f"the fitted model describes the recording to its noise: {off}"]
        return [f"the fitted model does not describe the recording: it is {off}"]


def without_tip(part: Observation, fitted: FittedRecording, judged: Judged) -> DistanceWithoutTip:
    """The distance of a recording without tip tension from its fit."""
    groups: dict[str, list[int]] = {}
    for c, name in enumerate(part.channels):
        groups.setdefault(_whole(name), []).append(c)
    known = part.samples >= FEWEST_SAMPLES
    compared = [_compared(part, fitted, judged, whole, rows) for whole, rows in groups.items()]
    compared.sort(key=lambda c: -c.rms / c.noise if known else -c.rms)
    return DistanceWithoutTip(part.name, known, compared, fitted.outliers)


def _whole(channel: str) -> str:
    """The marker or the rotation that a channel is an axis of; else the channel, of whatever tendon."""
    _, _, *whole = chosen_by(channel)
    return whole[0] if whole else channel


def _compared(
    part: Observation, fitted: FittedRecording, judged: Judged, whole: str, rows: list[int]
) -> Compared:
    names = [part.channels[c] for c in rows]
    rms = np.asarray([judged.rms_of(fitted.channels[name].residual) for name in names])
    noise = judged.least[rows]
    limit = most_of_noise(part.samples, len(part.channels))
    small = rms <= SMALL * np.ptp(part.recorded[rows], axis=1)
    words = words_of(names[0])
    if whole != names[0]:
        words = "the tip's rotation" if whole == ORIENTATION else f"the place of marker {whole}"
    return Compared(
        words=words,
        rms=float(np.linalg.norm(rms)),
        noise=float(np.linalg.norm(noise)),
        unit=unit_of(names[0]),
        described=bool(np.all(small | (rms**2 <= limit * noise**2))),
    )
