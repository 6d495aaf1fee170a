"""Stretches of time that are simulated and not compared, each with its reason."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from calibrate.inference.channels import unit_of
from calibrate.inference.setup import Observation
from gtr_jax import InputError, Recording

from .episodes import AFTER_GAP, ALONE, RELAXES, TOGETHER, Episode, when
from .patterns import Pattern
from .sanity import FEWEST, fewest_of

# What no load history at the base brings about, and a fit is better without.
FROM_OUTSIDE = (AFTER_GAP, ALONE, RELAXES, TOGETHER)
ASKED = "asked for"
STILL = "readings stand still"
# Most of a recording that is left out unasked, as a share of its samples; and where readings stand still.
MOST, MOST_STILL = 0.15, 0.5


class Stretch(NamedTuple):
    """Places of the first and the last sample in a recording, why they are not compared, and whether that is
    because something outside the model acts.
    """

    first: int
    last: int
    why: str
    outside: bool = False


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """A stretch that was simulated and not compared.

    Attributes:
        recording: its name.
        first, last: places of its first and last sample in the recording.
        start_s, end_s: time [s]; None where the recording has none.
        samples: how many of those simulated are left out.
        size: rms of simulated minus recorded there, of what is explained, by the model that is shown, SI.
        unit: of it.
        why: the reason.
        outside: whether something outside the model acts there.
    """

    recording: str
    first: int
    last: int
    start_s: float | None
    end_s: float | None
    samples: int
    size: float
    unit: str
    why: str
    outside: bool

    @property
    def when(self) -> str:
        """In words."""
        return when(self.first, self.last, self.start_s, self.end_s)

    def to_json(self) -> dict[str, Any]:
        """For `diagnosis.json`: the unit is in the name of the size."""
        given = dataclasses.asdict(self)
        unit = given.pop("unit")
        return {f"size_{unit}" if key == "size" else key: value for key, value in given.items()}


def moves(stretch: Stretch | LeftOut) -> bool:
    """Whether what acts there from outside may have moved an end of the tendon."""
    return stretch.outside and stretch.why != STILL


def asked_for(
    recordings: Mapping[str, Recording], exclude: Sequence[tuple[float, float]]
) -> dict[str, list[Stretch]]:
    """Stretches of time [s] that a user leaves out, by name of the recording.

    Raises:
        InputError: a stretch that holds no sample of any recording, or recordings without time.
    """
    found: dict[str, list[Stretch]] = {name: [] for name in recordings}
    times = {}
    for name, recording in recordings.items() if exclude else ():
        if recording.time is None:
            raise InputError(
                f"{recording.path}: --exclude needs the time of the samples; add a column time_s"
            )
        times[name] = recording.time
    for start, end in exclude:
        inside = {name: np.flatnonzero((t >= start) & (t <= end)) for name, t in times.items()}
        if not any(places.size for places in inside.values()):
            last = ", ".join(f"from {t[0]:g} to {t[-1]:g} s" for t in times.values())
            raise InputError(f"--exclude {start:g}:{end:g}: no sample lies there; the recordings last {last}")
        for name, places in inside.items():
            if places.size:
                found[name].append(Stretch(int(places[0]), int(places[-1]), ASKED))
    return found


def from_outside(
    episodes: Sequence[Episode],
    samples: Mapping[str, int],
    known: Mapping[str, Sequence[Stretch]],
    events_s: Sequence[tuple[float, float]] = (),
) -> dict[str, list[Stretch]] | None:
    """The episodes in which something outside the model acts, up to where the tendon slips again and forgets
    it, beside the stretches that are left out already; None where there are none. Of a recording of which
    this would leave out too much, nothing more is left out.

    Args:
        episodes: of the model that is shown.
        samples: of each recording, by name.
        known: stretches left out already.
        events_s: beginning and end of the events of that model [s]: an episode that touches one may be due to
            an error of its time.
    """
    found, more = {name: list(stretches) for name, stretches in known.items()}, False
    for name, stretches in found.items():
        own = [
            Stretch(e.first, e.until, e.says, e.kind != AFTER_GAP)
            for e in episodes
            if e.recording == name and e.kind in FROM_OUTSIDE and not _touches(e, events_s)
        ]
        together = joined(own)
        if not together or sum(s.last - s.first + 1 for s in together) > MOST * samples[name]:
            continue
        more = True
        stretches += together
    return found if more else None


def where_still(
    pattern: Pattern | None, samples: Mapping[str, int], known: Mapping[str, Sequence[Stretch]]
) -> dict[str, list[Stretch]] | None:
    """The stretches in which readings stand still, beside those that are left out already; None where there
    are none, or where they are too much of their recording.

    Args:
        pattern: regularity of what the base model leaves.
        samples: of each recording, by name.
        known: stretches left out already.
    """
    if pattern is None or not pattern.stands:
        return None
    own = [Stretch(stand.first, stand.last, STILL, outside=True) for stand in pattern.stands]
    name = pattern.recording
    out = sum(s.last - s.first + 1 for s in [*own, *known[name]])
    if out > MOST_STILL * samples[name] or samples[name] - out < FEWEST:
        return None
    return {other: [*stretches, *(own if other == name else ())] for other, stretches in known.items()}


def _touches(e: Episode, events_s: Sequence[tuple[float, float]]) -> bool:
    """Whether an episode overlaps an event."""
    if e.start_s is None or e.end_s is None:
        return False
    return any(e.start_s <= end and e.end_s >= start for start, end in events_s)


def joined(stretches: Sequence[Stretch]) -> list[Stretch]:
    """Stretches that overlap as one, in their order."""
    found: list[Stretch] = []
    for s in sorted(stretches):
        if found and s.first <= found[-1].last:
            before = found[-1]
            why, outside = f"{before.why}; {s.why}", before.outside or s.outside
            found[-1] = Stretch(before.first, max(before.last, s.last), why, outside)
        else:
            found.append(s)
    return found


def without(part: Observation, stretches: Sequence[Stretch]) -> Observation:
    """A recording with stretches that are not compared. After one in which something outside acts, which may
    have moved an end of the tendon, displacements are counted from another place.

    Raises:
        InputError: fewer samples than a diagnosis needs are left to compare.
    """
    if not stretches:
        return part
    out = np.zeros(part.samples, bool)
    for first, last, *_ in stretches:
        out |= (part.places >= first) & (part.places <= last)
    ends = sorted(s.last for s in stretches if moves(s))
    since = np.searchsorted(ends, part.places) if ends else None
    if (left := int((~out).sum())) < (fewest := fewest_of(part)):
        raise InputError(f"{part.path}: --exclude leaves {left} samples to compare; leave {fewest} or more")
    return dataclasses.replace(part, left_out=out, since=since)


def left_out(part: Observation, stretches: Sequence[Stretch], residual: np.ndarray) -> list[LeftOut]:
    """What was left out of a recording as it was simulated.

    Args:
        part: the recording.
        stretches: what is left out.
        residual: simulated minus recorded of its channels, SI, (C, K).
    """
    found = []
    for first, last, why, outside in stretches:
        inside = np.flatnonzero((part.places >= first) & (part.places <= last))
        if not inside.size:
            continue
        ends = (None, None) if part.time is None else part.time[inside[[0, -1]]].tolist()
        off = residual[: part.explained, inside]
        found.append(
            LeftOut(
                recording=part.name,
                first=first,
                last=last,
                start_s=ends[0],
                end_s=ends[1],
                samples=len(inside),
                size=float(np.sqrt(np.mean(off**2))),
                unit=unit_of(part.channels[0]),
                why=why,
                outside=outside,
            )
        )
    return found
