"""What a recording should make its reader do, most important first."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from gtr_jax.errors import listed
from gtr_jax.numbers import measured, number
from gtr_jax.recordings.signals.stretches import Stretch

from .cell import Cell
from .cycles import Cycles
from .delay import Delay
from .friction import Friction
from .sampling import Sampling
from .slip import PULLING, RELEASING, Phases

PROBLEM, NOTE, FINE = "problem", "note", "fine"
SEVERITIES = (PROBLEM, NOTE, FINE)
PLURAL = {"glitch": "es", "dropout": "s"}
DROPPED = "dropped"  # kind of what was left out because the user asked for it
END = {"T_base": "base", "T_tip": "tip"}
# Noise, resolution and zeros are problems from these shares of the range on, and worth a note from the
# second.
LARGE, WORTH = 0.02, 0.005
SURE = 3.0  # standard errors
UNEVEN = 0.2  # of the sampling step
SEEN = 2.0  # times the noise: an error of this size shows
SHAKES = 3.0  # times the noise at rest, of that in motion
MISSING = 0.02  # of the duration, in gaps, and of the samples left out
DROPS = 3  # stretches for which the remedy spells the options out
CHANGES = 0.1  # of ln(T_tip/T_base) on the pull, from low tension to high


@dataclasses.dataclass(frozen=True)
class Finding:
    """One finding.

    Attributes:
        severity: "problem", "note" or "fine".
        says: what was found, as a sentence.
        remedy: what to do about it; "" for nothing.
    """

    severity: str
    says: str
    remedy: str = ""


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """Samples that were left out for one channel.

    Attributes:
        channel: "T_base", "T_tip" or another quantity; "" where a stretch was dropped.
        kind: "glitch", "dropout" or "dropped".
        samples: number of them.
        largest: the largest deviation, in `unit`, with its sign; None where there is no number.
        unit: of the deviation.
        at_s: where each begins [s], as far as there is a clock.
    """

    channel: str
    kind: str
    samples: int
    largest: float | None
    unit: str
    at_s: tuple[float, ...] = ()


def findings(
    sampling: Sampling,
    cells: tuple[Cell, Cell],
    *,
    masked: Sequence[LeftOut],
    phases: Phases,
    cycles: Cycles,
    friction: Friction,
    delay: Delay,
) -> tuple[Finding, ...]:
    """All findings about a recording that was inspected, the problems first."""
    found = [
        *_clock(sampling),
        *(finding for cell in cells for finding in _stuck(cell)),
        *_swapped(friction),
        *_late(delay, cells, cycles),
        *_branches(phases, cycles),
        *_masked(masked, sampling.samples),
        *_friction(friction),
        *_level(friction),
        *_zeros(cells),
        *(finding for cell in cells for finding in _noise(cell)),
    ]
    return tuple(sorted(found, key=lambda finding: SEVERITIES.index(finding.severity)))


def times(where: Sequence[Stretch], most: int = 3) -> str:
    """When stretches were: their times, or their samples without a clock."""
    if where and where[0].start_s is not None:
        return "at " + listed([number(w.start_s, "s") for w in where], most)
    return "at sample " + listed([str(w.first + 1) for w in where], most)


def counted(count: int, one: str, many: str = "") -> str:
    """A number of things: "1 gap", "3 gaps"."""
    return f"{count} {one}" if count == 1 else f"{count} {many or one + 's'}"


def _drop(where: Sequence[Stretch]) -> str:
    """The options that leave stretches out, as far as there is a clock."""
    if where[0].start_s is None or len(where) > DROPS:
        return "--drop"
    return " ".join(f"--drop {w.start_s:.6g}:{w.end_s:.6g}" for w in where)


def _clock(sampling: Sampling) -> Iterator[Finding]:
    if sampling.rate_Hz is None:
        if sampling.repeated or sampling.reversed:
            yield Finding(PROBLEM, "The stamps of time never advance.", "Map another column to time.")
        else:
            yield Finding(
                NOTE,
                "There is no column of time: rates, holds and the delay between the cells stay unknown.",
                "Record the time of each sample, or map its column with --columns.",
            )
        return
    if sampling.reversed:
        yield Finding(
            PROBLEM,
            f"The stamps run backwards {counted(sampling.reversed, 'time')}, first at sample "
            f"{(sampling.reversed_at or 0) + 1}.",
            "Put the rows in the order of time, or give each trial its own file.",
        )
    if sampling.gaps:
        lost = sampling.missing_s / (sampling.duration_s or 1.0)
        yield Finding(
            PROBLEM if lost > MISSING else NOTE,
            f"{counted(len(sampling.gaps), 'gap')}, {number(sampling.missing_s, 's', 3)} in all, "
            f"{times(sampling.gaps)}.",
            "What the tendon did meanwhile is not known: judge the loop after a gap with care.",
        )
    if sampling.repeated:
        yield Finding(
            NOTE,
            f"{counted(sampling.repeated, 'stamp repeats', 'stamps repeat')} the one before.",
            "The clock is coarser than the samples, or rows are logged twice: give the time more digits.",
        )
    if (sampling.jitter or 0.0) > UNEVEN:
        low, high = (1e3 * sampling.step_s[p] for p in ("5%", "95%"))
        yield Finding(
            NOTE,
            f"The sampling is uneven: 90 % of the steps lie between {number(low, digits=3)} and "
            f"{number(high, 'ms', 3)}.",
            "Keep the column of time; if it says when a sample was written, rather than taken, stamp at the "
            "amplifier.",
        )


def _stuck(cell: Cell) -> Iterator[Finding]:
    for own, what, remedy in (
        (
            cell.saturated,
            "stays at the end of its range",
            "and use a cell, or a range of the amplifier, that reaches farther.",
        ),
        (cell.dead, "repeats one reading", "and look for a loose plug or a logger that stalls."),
    ):
        if not own:
            continue
        where = [s.where for s in own]
        values = listed(sorted({number(s.value_N, "N") for s in own}), 2)
        places = f"{counted(len(own), 'stretch', 'stretches')} of {sum(map(len, where))} samples in all"
        yield Finding(
            PROBLEM,
            f"The cell at the {END[cell.name]} {what} ({values}) in {places}, {times(where)}; neither "
            "tension nor noise explains it.",
            f"Leave these samples out with {_drop(where)}, {remedy}",
        )


def _swapped(friction: Friction) -> Iterator[Finding]:
    ratio = friction.pulling[np.isfinite(friction.pulling)]
    larger = float(np.median(ratio)) if ratio.size else np.nan
    remedy = (
        "Swap the columns, check their units, or, if the tendon is pulled at the tip, call that end the base."
    )
    if friction.base_leads is False:
        yield Finding(
            PROBLEM,
            "The loop of T_tip over T_base runs the wrong way round: it is the tip that leads.",
            remedy,
        )
    elif larger > 1.0:
        yield Finding(
            PROBLEM,
            f"On the pull the tip shows {number(larger, digits=3)} times the base; friction makes it less.",
            remedy,
        )


def _late(delay: Delay, cells: tuple[Cell, Cell], cycles: Cycles) -> Iterator[Finding]:
    if delay.seconds is None or delay.sd_s is None or not cycles.rates_N_per_s:
        return
    late = measured(1e3 * abs(delay.seconds), 1e3 * delay.sd_s, "ms")
    says = f"The tip's cell is {'late' if delay.seconds > 0 else 'early'} by {late}"
    fast = cycles.rates_N_per_s["95%"]
    error = abs(delay.seconds) * fast
    if abs(delay.seconds) <= SURE * delay.sd_s:
        yield Finding(FINE, f"{says}, which is not significant.")
        return
    worst = error > SEEN * cells[1].noise.total_N and error > WORTH * cells[1].highest_N
    yield Finding(
        PROBLEM if worst else NOTE,
        f"{says}: {number(error, 'N', 2)} at {number(fast, 'N/s', 2)}. Friction that grows with rate looks "
        "the same in this number.",
        "Sample both cells with one clock, or pull more slowly.",
    )


def _branches(phases: Phases, cycles: Cycles) -> Iterator[Finding]:
    if not cycles.cycles:
        yield Finding(PROBLEM, "The base tension never rises: there is no pull.", "Record a pull.")
        return
    for phase, name, severity in ((PULLING, "pull", PROBLEM), (RELEASING, "release", NOTE)):
        if not np.any(phases.of_step == phase):
            yield Finding(
                severity,
                f"The tendon never slips on {name}.",
                f"{name.capitalize()} farther, or sample faster: friction is determined from slip both ways.",
            )


def _masked(masked: Sequence[LeftOut], samples: int) -> Iterator[Finding]:
    for m in masked:
        at = ", at " + listed([number(t, "s") for t in m.at_s], 3) if m.at_s else ""
        severity = PROBLEM if m.samples > MISSING * samples else NOTE
        if m.kind == DROPPED:
            yield Finding(NOTE, f"{counted(m.samples, 'sample')} dropped as asked{at}.")
        elif m.largest is None:
            yield Finding(
                severity,
                f"{counted(m.samples, 'sample')} of {m.channel} without a number{at}: left out.",
                "Look for a loose plug, or a logger that skips.",
            )
        else:
            yield Finding(
                severity,
                f"{counted(m.samples, 'sample')} of {m.channel} left out as {m.kind}"
                f"{'' if m.samples == 1 else PLURAL.get(m.kind, '')}, up to "
                f"{number(abs(m.largest), m.unit, 3)} off{at}.",
                "Look at them in the pictures; --keep-glitches keeps them.",
            )


def _noise(cell: Cell) -> Iterator[Finding]:
    end, n = END[cell.name], cell.noise
    reach = cell.highest_N - cell.lowest_N
    if n.total_N > WORTH * reach:
        yield Finding(
            PROBLEM if n.total_N > LARGE * reach else NOTE,
            f"The cell at the {end} has noise of {number(n.total_N, 'N', 2)}, "
            f"{100 * n.total_N / reach:.2g} % of its range.",
            "Use a cell of a smaller range, average in the amplifier, or shield the cable.",
        )
    if cell.resolution_N is not None and cell.resolution_N > max(
        2 * n.total_N, (WORTH if n.total_N else LARGE) * reach
    ):
        yield Finding(
            NOTE,
            f"The cell at the {end} resolves {number(cell.resolution_N, 'N', 2)}, more than its noise.",
            "Log more digits, or use a finer range of the amplifier.",
        )
    if n.moving_N is not None and n.slow_N is not None and n.moving_N > SHAKES * n.white_N > 0:
        yield Finding(
            NOTE,
            f"The cell at the {end} is noisier in motion ({number(n.moving_N, 'N', 2)}) than at rest "
            f"({number(n.white_N, 'N', 2)}).",
            "The tension itself shakes, stick-slip or the motor's steps; take --noise from motion, not from "
            "rest.",
        )


def _zeros(cells: tuple[Cell, Cell]) -> Iterator[Finding]:
    for cell in cells:
        zero = cell.zero_before or cell.zero_after
        if zero is None:
            continue
        reach, end = cell.highest_N - cell.lowest_N, END[cell.name]
        if abs(zero.value_N) > max(SURE * zero.sd_N, WORTH * reach):
            yield Finding(
                PROBLEM if abs(zero.value_N) > LARGE * reach else NOTE,
                f"The cell at the {end} shows {measured(zero.value_N, zero.sd_N, 'N')} unloaded.",
                "Subtract it, or fit the zero of the cell (the term base-offset or tip-offset).",
            )
        drift, sd = cell.drift_N, cell.drift_sd_N
        if drift is not None and sd is not None and abs(drift) > max(SURE * sd, WORTH * reach):
            yield Finding(
                PROBLEM if abs(drift) > LARGE * reach else NOTE,
                f"The zero of the cell at the {end} moved by {measured(drift, sd, 'N')} over the recording.",
                "Let the amplifier warm up, or take tension that friction keeps in the tendon into account.",
            )
    if all(cell.zero_before is None and cell.zero_after is None for cell in cells):
        yield Finding(
            NOTE,
            "No stretch is unloaded: the zeros of the cells are not known.",
            "Begin and end with a slack tendon for a second or more.",
        )


def _level(friction: Friction) -> Iterator[Finding]:
    known = np.flatnonzero(np.isfinite(friction.pulling))
    if known.size >= 8:
        quarter = known.size // 4
        low, high = (float(np.median(friction.pulling[own])) for own in (known[:quarter], known[-quarter:]))
        if abs(np.log(high / low)) > CHANGES:
            yield Finding(
                NOTE,
                f"T_tip/T_base on the pull goes from {number(low, digits=2)} to {number(high, digits=2)} as "
                "the tension rises; with one coefficient of friction, in a channel whose shape does not "
                "change, it would be the same at every tension.",
                "Bending of the robot, a zero of a cell, or friction that depends on load can cause that; "
                "compare with a simulation.",
            )


def _friction(friction: Friction) -> Iterator[Finding]:
    if friction.mu_theta is None or friction.both is None:
        return
    theta = measured(friction.mu_theta, friction.mu_theta_sd)
    if friction.symmetric:
        yield Finding(FINE, f"Apparent friction mu·theta is {theta}, the same on pull and release.")
        return
    yield Finding(
        NOTE,
        f"Friction is not the same on pull and release: half the sum of ln(T_tip/T_base) is "
        f"{measured(friction.both, friction.both_sd)}, half the difference, mu·theta, {theta}.",
        "A gain or zero of a cell, friction that differs by direction, or bending can cause that; swap the "
        "cells to find out.",
    )
