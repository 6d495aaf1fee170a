"""What a recording has to hold for a question to be answered from it, and whether it does."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gtr_jax.numbers import measured, number
from gtr_jax.recordings.recording import Recording
from gtr_jax.recordings.signals.stretches import Stretch, runs

from .cell import Cell
from .cycles import Cycles
from .delay import Delay
from .findings import counted
from .friction import FEWEST, Friction
from .slip import TRANSITION, Phases

# Decades that rates must span, samples of a reversal (median), seconds of a hold, and cycles that repeat.
DECADES, OF_REVERSAL, OF_HOLD, REPEATS = 1.0, 10, 2.0, 3
POSE = ("tip_x", "tip_y", "tip_angle", "displacement")


@dataclasses.dataclass(frozen=True)
class Need:
    """One question.

    Attributes:
        question: what one wants to know.
        there: whether the recording holds what that takes.
        says: what it takes and what was measured, as a sentence.
    """

    question: str
    there: bool
    says: str


def needs(
    recording: Recording,
    cells: tuple[Cell, Cell],
    *,
    phases: Phases,
    holds: Sequence[Stretch],
    cycles: Cycles,
    friction: Friction,
    delay: Delay,
) -> tuple[Need, ...]:
    """Every question, answered for a recording that was inspected."""
    reversals = [b - a + 1 for a, b in runs(phases.label == TRANSITION)]
    within = int(np.median(reversals)) if reversals else 0
    posed = [name for name in POSE if getattr(recording, name) is not None]
    levels = int(np.sum(np.isfinite(friction.pulling) & np.isfinite(friction.releasing)))
    return (
        Need(
            "friction (mu)",
            levels >= FEWEST,
            "Friction needs slip on pull and on release at the same tension: both are there at "
            f"{levels} of {len(friction.T_base)} levels of tension.",
        ),
        Need(
            "gain of a cell, or friction that differs between pull and release",
            False,
            "In tensions alone the two look the same; record once more with the two cells swapped, or weigh "
            "both with the same weight.",
        ),
        _rates(cycles),
        Need(
            "presliding",
            within >= OF_REVERSAL,
            f"Presliding needs reversals that are sampled finely: {len(reversals)} stretches in which "
            f"friction holds the tip, of {within} samples (median); {OF_REVERSAL} are needed.",
        ),
        _zeros(cells),
        _holds(holds, recording.time),
        Need(
            "where along the tendon the friction is, and stiffness",
            bool(posed),
            "Both need the pose of the tip or the displacement of the tendon: "
            + (f"{', '.join(posed)} recorded." if posed else "neither is recorded."),
        ),
        Need(
            "memory of the friction",
            cycles.inner > 0,
            f"Memory shows in inner loops, pulls that begin before the tension is released: {cycles.inner} "
            f"of {len(cycles.cycles)} pulls.",
        ),
        Need(
            "wear, oiling, temperature",
            len(cycles.repeats) >= REPEATS,
            f"A change with time needs cycles that repeat: {len(cycles.repeats) or 'none'} "
            + ("agree in both their ends" if cycles.repeats else "agrees with another in both its ends")
            + f"; {REPEATS} are needed.",
        ),
        _skew(delay),
    )


def _rates(cycles: Cycles) -> Need:
    question = "friction that depends on rate"
    if cycles.decades is None:
        return Need(question, False, "Rate needs a clock: there is no column of time.")
    slow, fast = (cycles.rates_N_per_s[p] for p in ("5%", "95%"))
    return Need(
        question,
        cycles.decades >= DECADES,
        f"Rate needs rates over {DECADES:.0f} decade or more: from {number(slow, 'N/s', 2)} to "
        f"{number(fast, 'N/s', 2)} (5 % and 95 % of the way), {cycles.decades:.1f} decades.",
    )


def _zeros(cells: tuple[Cell, Cell]) -> Need:
    there = [
        when
        for when, has in (
            ("before", cells[0].zero_before is not None),
            ("after", cells[0].zero_after is not None),
        )
        if has
    ]
    if not there:
        says = "no stretch is unloaded"
    else:
        says = f"unloaded {' and '.join(there)}" + ("" if len(there) == 2 else " only")
    return Need(
        "zeros of the cells and their drift",
        len(there) == 2,
        f"Zeros need a slack tendon before the first pull and after the last release: {says}.",
    )


def _holds(holds: Sequence[Stretch], time: np.ndarray | None) -> Need:
    question = "creep and relaxation"
    if time is None:
        return Need(question, False, "Creep needs holds and a clock: there is no column of time.")
    longest = max((float(time[h.last] - time[h.first]) for h in holds), default=0.0)
    return Need(
        question,
        longest >= OF_HOLD,
        f"Creep needs holds under load of {OF_HOLD:g} s or more: "
        + (
            f"{counted(len(holds), 'hold')}, the longest {number(longest, 's', 3)}."
            if holds
            else "there is none."
        ),
    )


def _skew(delay: Delay) -> Need:
    if delay.seconds is None or delay.sd_s is None:
        return Need(
            "clocks of the two cells",
            False,
            f"The delay between the cells needs slip at rates that change: not determined; {delay.why_not}.",
        )
    return Need(
        "clocks of the two cells",
        True,
        "The delay between the cells needs slip at rates that change: the tip's cell lags by "
        f"{measured(1e3 * delay.seconds, 1e3 * delay.sd_s, 'ms')}.",
    )
