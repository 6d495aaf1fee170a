"""Events as hypotheses: what happens at one time is offered only where a misfit is located in time."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import EVENTS, Hypothesis, hypothesis_of, numbers_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.inference.instruments import leading
from calibrate.inference.number import Number
from gtr_jax.terms import REGISTRY
from gtr_jax.terms.tried import Moments

from .episodes import SLIPPING, Episode

# Times under tension at which an event is tried, and the change of such a time that matters [s].
TIMES, MATTERS = 16, 0.15
# Samples that it takes to tell an event from a law: in fewer, one is like a bad reading.
FEWEST = 400


def event_hypotheses(
    likelihood: Likelihood, found: Sequence[Episode], taken: Sequence[str]
) -> list[Hypothesis]:
    """What may have happened once, as the terms of events state it, those with fewest numbers first. None for
    several recordings, which do not share their events, and none for short ones.

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
    moments = _moments(time, T_base, begun, found)
    hypotheses = []
    for kind in EVENTS - {*taken}:
        term = REGISTRY[kind]
        for variant in term.tried.variants:
            free = numbers_of(term, variant, term.quantities)
            hypotheses.append(hypothesis_of(term, variant, _anywhere(free, time), moments))
    return sorted((h for h in hypotheses if h.starts), key=lambda h: (len(h.numbers), h.name))


def _moments(time: np.ndarray, T_base: np.ndarray, begun: float, found: Sequence[Episode]) -> Moments:
    """When an event may have happened, from the time since the first sample [s] and the base tension [N]."""
    pulled = time[T_base > 0.05 * float(T_base.max())]
    begins = []
    if pulled.size:
        even = np.quantile(pulled, (np.arange(TIMES) + 0.5) / TIMES)
        begins = [*map(float, even), *(float(e.start_s - begun) for e in found if e.start_s is not None)]
    held = [
        (e.start_s - begun, e.end_s - e.start_s)
        for e in found
        if e.kind != SLIPPING and e.start_s is not None and e.end_s is not None
    ]
    return Moments(begins, held)


def _anywhere(free: Sequence[Number], time: np.ndarray) -> tuple[Number, ...]:
    """The free numbers of an event; its time is anywhere in the recording."""
    start, end = float(time[0]), float(time[-1])
    return tuple(
        dataclasses.replace(
            n, centre=0.5 * (start + end), sd=0.5 * (end - start), lower=start, upper=end, apart=MATTERS
        )
        if n.name.endswith(".time")
        else n
        for n in free
    )
