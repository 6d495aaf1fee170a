"""Where in time a simulation and a recording differ: episodes, each with what both cells did and what the
model thought.

The map by phase and tension (`locate`) shows laws that are wrong wherever they apply. What happens once, a
knock on the sheath, a tip end that is moved, a burst of stick-slip, shows in time.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.inference.instruments import of_one, words_for
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_readings import SimulatedReadings
from gtr_jax.recordings.signals.differences import MAD_TO_SD

# A sample belongs to an episode beyond this many standard deviations of its noise, and beyond this many of
# the misfit elsewhere: a law that is wrong everywhere makes no episodes.
NOISE, ELSEWHERE = 4.0, 3.0
# An episode goes on through this many samples within these limits; it has this many samples beyond them, and
# this share of the misfit of its recording.
GAP, FEWEST, LEAST = 3, 3, 0.02
# Episodes reported for each recording.
MOST = 8
# Share of the samples of an episode in which friction holds the tip, from which it counts as held; below its
# complement it counts as slipping.
HELD = 0.7
# The base stands if it moves less than this share of what the tip does. Tensions relax towards each other if
# |ln(T_tip/T_base)| falls to this share.
STANDS, RELAXED = 0.3, 0.7
# A gap is a step in time of this many times the usual one; an episode follows it from so many samples on.
GAPS, BEHIND = 5.0, 2
AFTER_GAP, ALONE, RELAXES, TOGETHER, SLIPPING, MIXED = (
    "after-a-gap",
    "tip-moves-alone",
    "tensions-relax",
    "tip-moves-while-held",
    "while-slipping",
    "mixed",
)
WORDS = {
    AFTER_GAP: "it begins after a gap in the recording, in which the load is not known",
    ALONE: "the tip moves while the base stands still and friction should hold it: was the tip end moved?",
    RELAXES: "both tensions relax towards each other while friction should hold them: was the sheath shaken?",
    TOGETHER: "the tip follows the base while friction should hold it",
    SLIPPING: "the loss differs while the tendon slips",
    MIXED: "partly held, partly slipping",
}


@dataclasses.dataclass(frozen=True)
class Episode:
    """A stretch of time in which T_tip and its simulation differ.

    Attributes:
        recording: its name.
        first, last: places of its first and last sample in the recording.
        until: place of the last sample before the simulated tendon slips at the tip again, and forgets it.
        start_s, end_s: time [s]; None where the recording has none.
        mean_N, size_N: simulated minus recorded: mean, and rms beyond the noise.
        share: of the misfit of the recording, in squares.
        held: share of the samples in which the model holds the tip by friction.
        T_base_N, T_tip_N, model_N: first, least, largest and last value of the recorded tensions and of the
            simulated tip tension.
        kind: what it looks like: a key of `WORDS`.
        says: all this in words.
        tendon: its name, where there are several.
        displacement_m: of the tendon, as `T_base_N`, where displacement drives it; that is then None.
    """

    recording: str
    first: int
    last: int
    until: int
    start_s: float | None
    end_s: float | None
    mean_N: float
    size_N: float
    share: float
    held: float
    T_base_N: tuple[float, float, float, float] | None
    T_tip_N: tuple[float, float, float, float]
    model_N: tuple[float, float, float, float]
    kind: str
    says: str
    tendon: str = ""
    displacement_m: tuple[float, float, float, float] | None = None

    def to_json(self) -> dict[str, Any]:
        """For `diagnosis.json`: without what only robots of several tendons, or displacement, give."""
        more = {"tendon": self.tendon or None, "displacement_m": self.displacement_m}
        given = {k: v for k, v in dataclasses.asdict(self).items() if k not in more}
        return given | {k: v for k, v in more.items() if v is not None}


def episodes(likelihood: Likelihood, fitted: Fitted) -> list[Episode]:
    """Episodes of the misfit of T_tip that a fit leaves, those with most of it first."""
    found = []
    for k, (rig, residual) in enumerate(zip(likelihood.rigs, likelihood.residuals(fitted.seen), strict=True)):
        part, rows = rig.part, residual[: rig.part.tips]
        sds = np.asarray([noise.sd for noise in likelihood.noise[k][: part.tips]])[:, None]
        variances = sds**2 + likelihood.weighs[k].passed[: part.tips] ** 2
        excess = np.where(part.counted, np.maximum(rows**2 - variances, 0.0), 0.0)
        total = max(float(excess.sum()), 1e-300)
        own = [
            _episode(
                part,
                i,
                (a, b),
                fitted.seen[k],
                share,
                whose=f"{part.name}, " if len(likelihood.rigs) > 1 else "",
            )
            for i in range(part.tips)
            for a, b in _runs(rows[i], np.sqrt(variances[i]), part.counted)
            if (share := float(excess[i, a : b + 1].sum()) / total) > LEAST
        ]
        found += sorted(own, key=lambda e: -e.share)[:MOST]
    return sorted(found, key=lambda e: -e.share)


def _runs(row: np.ndarray, sd: np.ndarray, counted: np.ndarray) -> list[tuple[int, int]]:
    """First and last samples of the stretches in which a residual stands out on one side, (K,) each given."""
    usual = MAD_TO_SD * float(np.median(np.abs(row[counted]))) if counted.any() else 0.0
    out = np.flatnonzero(counted & (np.abs(row) > np.maximum(NOISE * sd, ELSEWHERE * usual)))
    if not out.size:
        return []
    apart = (np.diff(out) > GAP) | (np.diff(np.sign(row[out])) != 0)
    groups = np.split(out, 1 + np.flatnonzero(apart))
    return [(int(g[0]), int(g[-1])) for g in groups if len(g) >= FEWEST]


def when(first: int, last: int, start_s: float | None, end_s: float | None) -> str:
    """A stretch of a recording in words: by time [s], or without one by the numbers of its samples."""
    return f"samples {first + 1} to {last + 1}" if start_s is None else f"{start_s:.4g} to {end_s:.4g} s"


def _ends(values: np.ndarray) -> tuple[float, float, float, float]:
    return float(values[0]), float(values.min()), float(values.max()), float(values[-1])


def _episode(
    part: Observation,
    tendon: int,
    ends: tuple[int, int],
    seen: SimulatedReadings,
    share: float,
    *,
    whose: str,
) -> Episode:
    a, b = ends
    inside, time = slice(a, b + 1), part.time
    drive, read, slipping = part.drives[tendon].T_base, part.recorded[tendon], of_one(seen.slips, tendon)
    T_base, T_tip, model = (T[inside] for T in (drive, read, seen.values[tendon]))
    places = part.places
    slips = b + 1 + np.flatnonzero(slipping[b + 1 :])
    until = int(slips[0]) - 1 if slips.size else part.samples - 1
    first, last = int(places[a]), int(places[b])
    row = model - T_tip
    held = float(np.mean(~slipping[inside]))
    # What the tip did also shows in the step into the episode.
    around = slice(max(a - 1, 0), b + 1)
    by_draw = part.robot.tendons[tendon].drive == "displacement"
    kind = _kind(drive[around], read[around], held)
    if by_draw and kind == RELAXES:  # what drives it is not a tension
        kind = ALONE
    if held > 1 - HELD and _behind_gap(part, a):
        kind = AFTER_GAP
    start, end = (None, None) if time is None else (float(time[a]), float(time[b]))
    mean, size = float(row.mean()), float(np.sqrt(np.mean(row**2)))
    at = when(first, last, start, end)
    sense = "too high" if mean > 0 else "too low"
    driven = (1e3, "mm", "the displacement") if by_draw else (1.0, "N", "T_base")
    start_of, end_of = (driven[0] * float(T_base[i]) for i in (0, -1))
    moved = (
        f"{driven[2]} goes from {start_of:.3g} to {end_of:.3g} {driven[1]}, T_tip from {T_tip[0]:.3g} to "
        f"{T_tip[-1]:.3g} N, the simulated one from {model[0]:.3g} to {model[-1]:.3g} N"
    )
    return Episode(
        recording=part.name,
        first=first,
        last=last,
        until=int(places[until]),
        start_s=start,
        end_s=end,
        mean_N=mean,
        size_N=size,
        share=share,
        held=held,
        T_base_N=None if by_draw else _ends(T_base),
        T_tip_N=_ends(T_tip),
        model_N=_ends(model),
        kind=kind,
        says=f"{whose}{at}: simulated T_tip{words_for(part, tendon)} {sense} by {abs(mean):.2g} N; {moved}; "
        f"{WORDS[kind]}",
        tendon=part.robot.tendon_names[tendon] if part.others else "",
        displacement_m=_ends(T_base) if by_draw else None,
    )


def _behind_gap(part: Observation, a: int) -> bool:
    """Whether a sample follows a gap in the recording by a few samples."""
    if part.time is None:
        return False
    each = np.diff(part.time) / np.diff(part.places)
    before = slice(max(a - BEHIND - 1, 0), a)
    alone = np.diff(part.places)[before] == 1
    return bool(np.any(each[before][alone] > GAPS * float(np.median(each))))


def _kind(T_base: np.ndarray, T_tip: np.ndarray, held: float) -> str:
    """What an episode looks like, from the recorded tensions [N] and the share in which friction holds."""
    if held < 1 - HELD:
        return SLIPPING
    if held < HELD:
        return MIXED
    base, tip = float(np.ptp(T_base)), float(np.ptp(T_tip))
    ends = np.asarray([[T_base[0], T_base[-1]], [T_tip[0], T_tip[-1]]])
    if np.all(ends > 0):
        before, after = np.abs(np.log(ends[1] / ends[0]))
        opposite = (ends[0, 1] - ends[0, 0]) * (ends[1, 1] - ends[1, 0]) <= 0
        if after < RELAXED * before and (opposite or base < STANDS * tip):
            return RELAXES
    return ALONE if base < STANDS * tip else TOGETHER
