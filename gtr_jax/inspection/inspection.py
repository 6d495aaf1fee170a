"""The whole inspection of one recording."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np

from gtr_jax.errors import InputError
from gtr_jax.numbers import number
from gtr_jax.recordings.recording import Recording
from gtr_jax.recordings.signals.differences import from_differences
from gtr_jax.recordings.signals.stretches import Stretch, runs, stretches
from gtr_jax.recordings.signals.turning import turns_of_long
from gtr_jax.to_jsonable import to_jsonable

from .cell import Cell
from .cycles import Cycles, cycles, rates
from .delay import Delay, delay
from .findings import FINE, PROBLEM, Finding, LeftOut, counted, findings
from .friction import Friction, friction
from .needs import Need, needs
from .noise import CellNoise, noise, resolution
from .sampling import Sampling, sampling
from .slip import HOLD, NAMES, PULLING, RELEASING, Phases, phases
from .still import band_of, still, window
from .stuck import counted_once, stuck
from .zero import unloaded, zero

FEWEST = 20
"""Samples of the shortest recording that can be inspected."""
# Reversals of the base tension that count: by so many standard deviations, and by this share of its range.
OF_NOISE, OF_RANGE = 6.0, 0.02
FEWEST_HELD = 8  # samples of a hold, next to where the base is stuck
PULLED = 0.1  # share of the range of the base tension above which the tendon is pulled
RAMP = (0.05, 0.95)  # of a way from turn to turn: the part that counts as ramp, without the rest before it
RAMPS = 50  # ways that are looked at, the longest


@dataclasses.dataclass(frozen=True, eq=False)
class Inspection:
    """What a recording of K samples says before any model of the robot.

    Attributes:
        name: of the recording's file.
        says: the whole in one sentence or two.
        sampling: its clock.
        base, tip: the cells.
        masked: samples that were left out.
        phases: of every sample, by a rule without a model.
        holds: stretches under load in which the base stands still.
        rest: stretches without load in which both cells stand still.
        cycles: pulls and releases.
        delay: of the tip's cell behind the base's.
        friction: from the ratio of the tensions.
        needs: what can be learnt from the recording.
        findings: the problems first.
    """

    name: str
    says: str
    sampling: Sampling
    base: Cell
    tip: Cell
    masked: tuple[LeftOut, ...]
    phases: Phases
    holds: tuple[Stretch, ...]
    rest: tuple[Stretch, ...]
    cycles: Cycles
    delay: Delay
    friction: Friction
    needs: tuple[Need, ...]
    findings: tuple[Finding, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values, units in the keys; of the phases, their shares of the samples."""
        data = {
            field.name: _plain(getattr(self, field.name))
            for field in dataclasses.fields(self)
            if field.name != "phases"
        }
        data["phases"] = {name: self.phases.share(phase) for phase, name in NAMES.items()}
        for end, cell in (("base", self.base), ("tip", self.tip)):
            data[end] |= {"drift_N": cell.drift_N, "drift_sd_N": cell.drift_sd_N}
        return to_jsonable(data)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return (
        dataclasses.asdict(value)
        if dataclasses.is_dataclass(value) and not isinstance(value, type)
        else value
    )


def inspect(recording: Recording) -> Inspection:
    """Inspect a recording of both cells of one tendon.

    Args:
        recording: from `gtr_jax.read_recording`.

    Raises:
        InputError: it has fewer than FEWEST samples, no tip tension, several tendons, or a base tension that
            never changes.
    """
    T_base, T_tip, time = recording.T_base, recording.T_tip, recording.time
    _check(recording)
    assert T_tip is not None
    clock = sampling(*_all_times(recording))
    masked = _left_out(recording)
    ordered = time if time is not None and not clock.reversed and clock.rate_Hz is not None else None
    step = None if clock.rate_Hz is None else 1 / clock.rate_Hz
    rough, quiet = _at_rest(T_base, T_tip, step)
    once = counted_once(T_base, T_tip, ordered)
    own = (T_base[once], T_tip[once])
    often = len(once) < len(T_base)  # rows that are logged again show no noise
    own_step = step
    if often and ordered is not None:
        own_step = float(np.median(np.diff(ordered[once])[np.diff(ordered[once]) > 0]))
    own_quiet = _at_rest(*own, own_step)[1] if often else quiet
    noises = noise(own[0], own_quiet[0]), noise(own[1], own_quiet[1])
    turns = turns_of_long(T_base, _hysteresis(T_base, max(rough[0], noises[0].total_N)))
    still_both = _both(quiet, len(T_base))
    pulled = np.flatnonzero(T_base - T_base.min() > PULLED * np.ptp(T_base))
    ends = unloaded(T_base, T_tip, ordered, quiet=still_both, pulls=(int(pulled[0]), int(pulled[-1])))
    cells = tuple(
        _cell(name, T, other, n, ends, ordered, once)
        for name, T, other, n in (
            ("T_base", T_base, T_tip, noises[0]),
            ("T_tip", T_tip, T_base, noises[1]),
        )
    )
    base, tip = cells
    level = [(c.zero_before or c.zero_after) for c in cells]
    true_base, true_tip = (
        T - (0.0 if z is None else z.value_N) for T, z in zip((T_base, T_tip), level, strict=True)
    )
    shaken = tuple(max(n.total_N, r) for n, r in zip(noises, rough, strict=True))
    labelled = phases(true_base, true_tip, turns=turns, noise=(shaken[0], shaken[1]), quiet=quiet[0])
    moves = np.zeros(0)
    if ordered is not None:
        nodes = np.append(labelled.steps[:, 0], labelled.steps[-1, 1])
        moves = rates(T_base, ordered, nodes)[_moving(nodes, quiet[0], ordered)]
    load = cycles(T_base, T_tip, ordered, turns=turns, moves=moves)
    late = _delay(T_base, T_tip, ordered, labelled, clock, rough)
    ratio = friction(true_base, true_tip, labelled)
    held = labelled.label == HOLD
    for s in (*base.saturated, *base.dead):
        held[s.where.rows] = False
    holds = stretches(runs(held, FEWEST_HELD), ordered)
    found = findings(
        clock, (base, tip), masked=masked, phases=labelled, cycles=load, friction=ratio, delay=late
    )
    return Inspection(
        name=recording.path.name,
        says=_sentence(clock, base, load, ratio, found),
        sampling=clock,
        base=base,
        tip=tip,
        masked=masked,
        phases=labelled,
        holds=holds,
        rest=tuple(end for end in ends if end is not None),
        cycles=load,
        delay=late,
        friction=ratio,
        needs=needs(
            recording,
            (base, tip),
            phases=labelled,
            holds=holds,
            cycles=load,
            friction=ratio,
            delay=late,
        ),
        findings=found,
    )


def _check(recording: Recording) -> None:
    place = recording.path
    if recording.T_tip is None:
        raise InputError(f"{place}: has no T_tip; an inspection compares the cells at both ends")
    if recording.tendons:
        raise InputError(f"{place}: has several tendons; inspect one at a time, mapped with --columns")
    if len(recording) < FEWEST:
        raise InputError(
            f"{place}: has {len(recording)} samples; an inspection needs {FEWEST}: record for longer"
        )
    if np.ptp(recording.T_base) == 0:
        raise InputError(
            f"{place}: T_base is {recording.T_base[0]:.4g} N throughout; record a pull, or map another column"
        )


def _all_times(recording: Recording) -> tuple[np.ndarray | None, int]:
    """Stamps of all samples, with those that were left out, and their number."""
    left_out = {m.rows: m.time for m in recording.masked}
    counts = [b - a + 1 for a, b in left_out]
    samples = len(recording) + sum(counts)
    if recording.time is None:
        return None, samples
    lost = [np.linspace(*ends, n) for ends, n in zip(left_out.values(), counts, strict=True) if ends]
    if not lost or np.any(np.diff(recording.time) < 0):
        return recording.time, samples
    extra = np.concatenate(lost)
    return np.insert(recording.time, np.searchsorted(recording.time, extra), extra), samples


def _left_out(recording: Recording) -> tuple[LeftOut, ...]:
    """What was left out, by channel and kind."""
    groups: dict[tuple[str, str, bool], list] = {}
    for m in recording.masked:
        groups.setdefault((m.channel, m.kind, m.size != m.size), []).append(m)
    return tuple(
        LeftOut(
            channel,
            kind,
            samples=sum(m.rows[1] - m.rows[0] + 1 for m in own),
            largest=None if numberless else max((m.size for m in own), key=abs),
            unit=own[0].unit,
            at_s=tuple(m.time[0] for m in own if m.time is not None),
        )
        for (channel, kind, numberless), own in groups.items()
    )


def _at_rest(
    T_base: np.ndarray, T_tip: np.ndarray, step: float | None
) -> tuple[tuple[float, float], list[list[tuple[int, int]]]]:
    """Noise of both cells by differences [N], and the stretches in which each stands still."""
    rough = from_differences(T_base), from_differences(T_tip)
    ramp = _ramp(T_base, turns_of_long(T_base, _hysteresis(T_base, rough[0])))
    quiet = [
        still(T, band_of(T, sd), window(step, ramp)) for T, sd in zip((T_base, T_tip), rough, strict=True)
    ]
    return rough, quiet


def _hysteresis(T: np.ndarray, sd: float) -> float:
    return max(OF_NOISE * sd, OF_RANGE * float(np.ptp(T)))


def _ramp(T: np.ndarray, turns: np.ndarray) -> int:
    """Samples of the longest ramp between turning points."""
    ways = sorted(itertools.pairwise(turns.tolist()), key=lambda w: w[0] - w[1])[:RAMPS]
    longest = 0
    for a, b in ways:
        share = (T[a : b + 1] - T[a]) / ((T[b] - T[a]) or 1.0)
        inside = np.flatnonzero(share > RAMP[0])[:1], np.flatnonzero(share < RAMP[1])[-1:]
        if all(ends.size for ends in inside):
            longest = max(longest, int(inside[1][0] - inside[0][0]))
    return longest


def _both(quiet: list[list[tuple[int, int]]], samples: int) -> list[tuple[int, int]]:
    """Stretches in which both cells stand still."""
    stand = np.ones(samples, bool)
    for own in quiet:
        here = np.zeros(samples, bool)
        for a, b in own:
            here[a : b + 1] = True
        stand &= here
    return runs(stand, 8)


def _moving(nodes: np.ndarray, quiet: list[tuple[int, int]], time: np.ndarray) -> np.ndarray:
    """Which steps between samples lie outside the stretches in which the base stands still, among those that
    take time.
    """
    middle = (nodes[1:] + nodes[:-1]) // 2
    firsts, lasts = (np.asarray([ends[i] for ends in quiet], int) for i in (0, 1))
    place = np.searchsorted(firsts, middle, side="right") - 1
    within = (
        (place >= 0) & (middle <= lasts[np.maximum(place, 0)]) if len(quiet) else np.zeros(len(middle), bool)
    )
    return ~within[np.diff(time[nodes]) > 0]


def _cell(
    name: str,
    T: np.ndarray,
    other: np.ndarray,
    own: CellNoise,
    ends: tuple[Stretch | None, Stretch | None],
    time: np.ndarray | None,
    once: np.ndarray,
) -> Cell:
    finest = resolution(T)
    saturated, dead = stuck(
        T, other, white=own.white_N, step=finest, is_tip=name == "T_tip", time=time, once=once
    )
    return Cell(
        name=name,
        lowest_N=float(T.min()),
        highest_N=float(T.max()),
        resolution_N=finest,
        noise=own,
        saturated=saturated,
        dead=dead,
        zero_before=zero(T, ends[0], own.total_N),
        zero_after=zero(T, ends[1], own.total_N),
    )


def _delay(
    T_base: np.ndarray,
    T_tip: np.ndarray,
    time: np.ndarray | None,
    labelled: Phases,
    clock: Sampling,
    sd: tuple[float, float],
) -> Delay:
    if time is None:
        return Delay(why_not="there is no column of time that only advances")
    slipping = labelled.runs_of(PULLING) + labelled.runs_of(RELEASING)
    whole = [ends for ends in slipping if not any(ends[0] <= gap.first < ends[1] for gap in clock.gaps)]
    return delay(T_base, T_tip, time, slipping=whole, noise=sd)


def _sentence(clock: Sampling, base: Cell, load: Cycles, ratio: Friction, found: tuple[Finding, ...]) -> str:
    """The whole in a sentence or two."""
    problems = sum(f.severity == PROBLEM for f in found)
    pulls = len(load.cycles)
    what = f"{counted(pulls, 'pull')} up to {number(base.highest_N, 'N', 3)}"
    if clock.rate_Hz is not None:
        what += f" in {number(clock.duration_s, 's', 3)} at {number(clock.rate_Hz, 'Hz', 3)}"
    else:
        what += f" in {clock.samples} samples without a clock"
    if ratio.mu_theta is not None:
        what += f", apparent mu·theta {number(ratio.mu_theta, digits=2)}"
    first = next((f for f in found if f.severity != FINE), None)
    begins = f" {first.says}" if first else ""
    if problems == 0:
        return f"No problem found: {what}.{begins}"
    return f"Look before use: {counted(problems, 'problem')}.{begins} The recording: {what}."
