"""One parameter fitted to part of the samples: do pulling and releasing, or two recordings, agree?"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from gtr_jax.simulation.phases import PULLING, RELEASING

from .answer import Answer
from .descent import descend
from .estimate import UNKNOWN, Estimate, estimates, uncertainty
from .noise import correlation_time
from .task import Task

FEWEST = 8
MAX_STEPS = 12
# Shared values that scatter more than chance gives in so many of all joint fits are said to disagree.
CHANCE = 0.01


class Phases(NamedTuple):
    """What phases alone say of mu.

    Attributes:
        estimates: by phase; one that is short, or knows nothing of mu, is left out.
        apart: by how many standard errors pulling and releasing differ; 0 where one is left out.
    """

    estimates: dict[str, Estimate]
    apart: float


def mu_by_phase(task: Task, answer: Answer) -> Phases:
    """mu from pulling alone and from releasing alone; other parameters and the phases stay as fitted, and
    what is uncertain of them counts in the errors. Nothing where recordings have their own mu.
    """
    if len(task.friction()) != 1:
        return Phases({}, 0.0)
    found: dict[str, _Alone] = {}
    for phase in (PULLING, RELEASING):
        inside = [judged.phases == phase for judged in answer.judged]
        if sum(map(np.sum, inside)) < FEWEST:
            continue
        task.progress(f"fitting {phase} alone")
        alone = _alone(task, answer, task.friction()[0], inside)
        if alone is not None:
            found[phase] = alone
    apart = 0.0
    if len(found) == 2:
        off, covariance = _together(list(found.values()), answer.spread(task))
        apart = abs(float(off[0] - off[1])) / float(
            np.sqrt(np.array([1, -1]) @ covariance @ np.array([1, -1]))
        )
    return Phases({phase: alone.estimate for phase, alone in found.items()}, apart)


class Apart(NamedTuple):
    """What recordings alone say of the parameters that they share, the others as fitted; what is uncertain of
    these counts in the errors.

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
    for i, free in enumerate(task.asked):
        if len(free.parts) < 2 or not known.known[i]:
            continue
        task.progress(f"{free.name} from each recording alone")
        each: dict[str, _Alone] = {}
        for k in free.parts:
            inside = [np.full(part.samples, j == k) for j, part in enumerate(task.parts)]
            alone = _alone(task, answer, i, inside)
            if alone is not None:
                each[task.parts[k].name] = alone
        if len(each) > 1:
            found[free.name] = {name: alone.estimate for name, alone in each.items()}
            if _scattered(list(each.values()), answer.spread(task)):
                left[free.name] = sum(alone.squares for alone in each.values())
    return Apart(found, min(left, key=left.__getitem__, default=""))


class _Alone(NamedTuple):
    """One number from some of the samples.

    Attributes:
        estimate: the errors of the other numbers counted in.
        u: its coordinate.
        own: variance of that, the other numbers being known.
        lean: its change per change of the other coordinates, (p,).
        squares: what is left.
    """

    estimate: Estimate
    u: float
    own: float
    lean: np.ndarray
    squares: float


def _together(each: list[_Alone], spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of one number from several parts, (m,), and their covariance, (m, m): what is uncertain of
    the other numbers, by their covariance `spread`, (p, p), moves all of them together.
    """
    lean = np.stack([a.lean for a in each])
    return np.asarray([a.u for a in each]), np.diag([a.own for a in each]) + lean @ spread @ lean.T


def _scattered(each: list[_Alone], spread: np.ndarray) -> bool:
    """Whether values of one number lie farther apart than their errors allow."""
    values, covariance = _together(each, spread)
    ones = np.ones(len(values))
    weights = np.linalg.solve(covariance, ones)
    off = values - float(weights @ values) / float(weights @ ones)
    return float(off @ np.linalg.solve(covariance, off)) > float(chi2.isf(CHANCE, len(values) - 1))


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
    wide = max(1.0, squares / max(count - 1, 1)) * tau
    jacobian = problem.jacobian(found.predictions)
    known = uncertainty(jacobian[:, active], np.sqrt(wide), np.zeros(1), np.full(1, UNKNOWN))
    if not known.known.all():
        return None
    own = float(known.covariance[0, 0])
    lean = np.where(active, 0.0, -(jacobian[:, i] @ jacobian) / float(jacobian[:, i] @ jacobian[:, i]))
    known.covariance[0, 0] += lean @ answer.spread(task) @ lean
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
    return _Alone(found_there, float(found.u[i]), own, lean, squares)
