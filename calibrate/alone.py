"""One parameter fitted to part of the samples: do pulling and releasing, or two recordings, agree?"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from gtr_jax.phases import PULLING, RELEASING

from .answer import Answer
from .descent import descend
from .estimate import UNKNOWN, Estimate, estimates, uncertainty
from .noise import correlation_time
from .task import Task

FEWEST = 8
MAX_STEPS = 12
# Shared values that scatter more than chance gives in so many of all joint fits are said to disagree.
CHANCE = 0.01


def mu_by_phase(task: Task, answer: Answer) -> dict[str, Estimate]:
    """mu from pulling alone and from releasing alone; other parameters and the phases stay as fitted.

    Returns:
        Estimates by phase; a phase that is short, or knows nothing of mu, is left out, and so are all where
        recordings have their own mu.
    """
    if len(task.friction()) != 1:
        return {}
    found = {}
    for phase in (PULLING, RELEASING):
        inside = [judged.phases == phase for judged in answer.judged]
        if sum(map(np.sum, inside)) < FEWEST:
            continue
        task.progress(f"fitting {phase} alone")
        alone = _alone(task, answer, task.friction()[0], inside)
        if alone is not None:
            found[phase] = alone.estimate
    return found


class Apart(NamedTuple):
    """What recordings alone say of the parameters that they share, the others as fitted.

    Attributes:
        estimates: by parameter, then recording; those left out that know nothing of it.
        blamed: the parameter about which they disagree, if they do: of those that they give different values,
            the one whose values describe them best; "" if they agree.
    """

    estimates: dict[str, dict[str, Estimate]]
    blamed: str


def by_recording(task: Task, answer: Answer) -> Apart:
    """Each parameter that recordings share, from each of them alone."""
    known, found, left = answer.known(task), {}, {}
    for i, free in enumerate(task.free):
        if len(free.parts) < 2 or not known.known[i]:
            continue
        task.progress(f"{free.name} from each recording alone")
        each, squares = {}, 0.0
        for k in free.parts:
            inside = [np.full(part.samples, j == k) for j, part in enumerate(task.parts)]
            alone = _alone(task, answer, i, inside)
            if alone is not None:
                each[task.parts[k].name] = alone.estimate
                squares += alone.squares
        if len(each) > 1:
            found[free.name] = each
            if _scattered(each):
                left[free.name] = squares
    return Apart(found, min(left, key=left.__getitem__, default=""))


def _scattered(each: dict[str, Estimate]) -> bool:
    """Whether values of one parameter lie farther apart than their errors allow."""
    values = np.asarray([e.value for e in each.values()])
    sd = np.asarray([e.sd for e in each.values()], float)
    mean = np.sum(values / sd**2) / np.sum(sd**-2)
    return float(np.sum(((values - mean) / sd) ** 2)) > float(chi2.isf(CHANCE, len(values) - 1))


class _Alone(NamedTuple):
    estimate: Estimate
    squares: float


def _alone(task: Task, answer: Answer, i: int, inside: list[np.ndarray]) -> _Alone | None:
    """Free number i from some of the samples, of each recording; None where they know nothing of it."""
    active = np.arange(len(task.free)) == i
    weighs = tuple(j.by_noise.only(kept) for j, kept in zip(answer.judged, inside, strict=True))
    problem = dataclasses.replace(answer.problem, weighs=weighs, precision=np.zeros(len(active)))
    before = problem.predict.count
    found = descend(
        problem, answer.descent.u, active=active, known=answer.descent.predictions, max_steps=MAX_STEPS
    )
    task.evaluations += problem.predict.count - before
    if found.predictions is None or found.at_edge.any():
        return None
    # The noise counts here, not the misfit of all samples: these may be described where the others are not.
    squares, count, tau = 0.0, 0, 1.0
    for part, weigh, kept, prediction in zip(task.parts, weighs, inside, found.predictions, strict=True):
        channels, base = weigh.split(part.residual(prediction))
        if not kept.any():
            continue
        squares += float(np.sum(channels**2) + np.sum(base**2))
        count += int(channels.shape[0] * np.sum(kept))
        tau = max([tau, *(correlation_time(row) for row in channels[:, kept])])
    spread = max(1.0, squares / max(count - 1, 1)) * tau
    known = uncertainty(
        problem.jacobian(found.predictions)[:, active], np.sqrt(spread), np.zeros(1), np.full(1, UNKNOWN)
    )
    if not known.known.all():
        return None
    at = answer.at[0]
    free = task.free[i]
    found_there = estimates(
        [dataclasses.replace(free.entry, name=free.name)],
        np.asarray(at.values(found.u))[active],
        task.initial[active],
        np.asarray(at.log)[active],
        np.asarray(at.scale)[active],
        known,
        [""],
    )[0]
    return _Alone(found_there, squares)
