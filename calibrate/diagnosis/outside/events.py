"""Events as hypotheses: what happens at one time is offered only where a misfit is located in time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis, number_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.inference.instruments import leading
from gtr_jax.terms import REGISTRY

from .episodes import SLIPPING, Episode

MOVED, SHAKEN = "sheath-moved", "shaken-sheath"
# Times at which a lasting change is tried, and its sizes; how long it takes [s].
TIMES, CHANGES, TAKES = 16, (0.15, -0.15), 0.3
# Samples that it takes to tell an event from a law: in fewer, one is like a bad reading.
FEWEST = 400
# Share of friction that shaking is tried with, how fast it comes and goes, and the shortest tried [s].
SHARE, EDGE, SHORTEST = 0.6, 0.05, 0.1


def event_hypotheses(
    likelihood: Likelihood, found: Sequence[Episode], taken: Sequence[str]
) -> list[Hypothesis]:
    """A lasting change of friction at some time, and shaking during the episodes in which friction should
    hold the tip. None for several recordings, which do not share their events, and none for short ones.

    Args:
        likelihood: the recordings.
        found: episodes of the misfit.
        taken: terms that the model has already.
    """
    part, taken = likelihood.rigs[0].part, [*taken, *likelihood.untried]
    if len(likelihood.rigs) != 1 or part.time is None or part.samples < FEWEST:
        return []
    # The terms count time from the first sample.
    begun = float(part.time[0])
    time, T_base = part.time - begun, part.drives[leading(part)].T_base
    pulled = time[T_base > 0.05 * float(T_base.max())]
    hypotheses = []
    if MOVED not in taken and pulled.size:
        change, when = _numbers(MOVED, ("change", "time"), time)
        even = np.quantile(pulled, (np.arange(TIMES) + 0.5) / TIMES)
        times = [*even, *(e.start_s - begun for e in found if e.start_s is not None)]
        hypotheses.append(
            Hypothesis(
                name=MOVED,
                kind=MOVED,
                numbers=(change, when),
                starts=tuple({change.name: c, when.name: float(t)} for c in CHANGES for t in times),
                fixed={f"{MOVED}.duration": TAKES},
            )
        )
    held = [e for e in found if e.kind != SLIPPING and e.start_s is not None and e.end_s is not None]
    if SHAKEN not in taken and held:
        share, when, duration = _numbers(SHAKEN, ("share", "time", "duration"), time)
        starts = [
            {
                share.name: SHARE,
                when.name: e.start_s - begun - EDGE,
                duration.name: max(e.end_s - e.start_s, SHORTEST) + 2 * EDGE,
            }
            for e in held
            if e.start_s is not None and e.end_s is not None
        ]
        hypotheses.append(
            Hypothesis(
                name=SHAKEN,
                kind=SHAKEN,
                numbers=(share, when, duration),
                starts=tuple(starts),
                fixed={f"{SHAKEN}.edge": EDGE},
            )
        )
    return hypotheses


def _numbers(kind: str, names: Sequence[str], time: np.ndarray):
    """The free numbers of an event; its time is anywhere in the recording."""
    term = REGISTRY[kind]
    numbers = [number_of(term, next(q for q in term.quantities if q.name == name)) for name in names]
    start, end = float(time[0]), float(time[-1])
    return [
        dataclasses.replace(
            n, centre=0.5 * (start + end), sd=0.5 * (end - start), lower=start, upper=end, apart=0.5 * TAKES
        )
        if n.name.endswith(".time")
        else n
        for n in numbers
    ]
