"""One parameter fitted to part of the samples: do pulling and releasing, or two recordings, agree?"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from gtr_jax.simulation.phases import PULLING, RELEASING

from .answer import Answer
from .descent import descend
from .estimate import UNKNOWN, Estimate, estimates, uncertainty
from .parallel import in_parallel
from .readings.noise import correlation_time
from .setup import Setup

FEWEST = 8
MAX_STEPS = 12
# Shared values that scatter more than chance gives in so many of all joint fits are said to disagree.
CHANCE = 0.01


class Phases(NamedTuple):
    """What phases alone say of mu.

    Attributes:
        estimates: by phase; one that is short, or knows nothing of mu, is left out.
        apart: by how many standard errors pulling and releasing differ; 0 where one is left out.
        evaluations: times that all recordings were simulated.
    """

    estimates: dict[str, Estimate]
    apart: float
    evaluations: int


def mu_by_phase(setup: Setup, answer: Answer) -> Phases:
    """mu from pulling alone and from releasing alone; other parameters and the phases stay as fitted, and
    what is uncertain of them counts in the errors. Nothing where recordings have their own mu.
    """
    if len(setup.friction()) != 1:
        return NO_PHASES
    inside = {phase: [judged.phases == phase for judged in answer.judged] for phase in (PULLING, RELEASING)}
    long = [phase for phase, samples in inside.items() if sum(map(np.sum, samples)) >= FEWEST]

    def of_phase(phase: str) -> tuple[_Alone | None, int]:
        setup.progress(f"fitting {phase} alone")
        return _alone(setup, answer, setup.friction()[0], inside[phase])

    each = in_parallel(of_phase, long)
    evaluations = sum(count for _, count in each)
    found = {phase: alone for phase, (alone, _) in zip(long, each, strict=True) if alone is not None}
    apart = 0.0
    if len(found) == 2:
        off, covariance = _together(list(found.values()), answer.spread(setup))
        apart = abs(float(off[0] - off[1])) / float(
            np.sqrt(np.array([1, -1]) @ covariance @ np.array([1, -1]))
        )
    return Phases({phase: alone.estimate for phase, alone in found.items()}, apart, evaluations)


class Apart(NamedTuple):
    """What recordings alone say of the parameters that they share, the others as fitted; what is uncertain of
    these counts in the errors.

    Attributes:
        estimates: by parameter, then recording; those left out that know nothing of it.
        blamed: the parameter about which they disagree, if they do: of those that they give different values,
            the one whose values describe them best; "" if they agree.
        evaluations: times that all recordings were simulated.
    """

    estimates: dict[str, dict[str, Estimate]]
    blamed: str
    evaluations: int


NO_PHASES, NOT_APART = Phases({}, 0.0, 0), Apart({}, "", 0)


def by_recording(setup: Setup, answer: Answer) -> Apart:
    """Each parameter that recordings share, from each of them alone."""
    known, found, left, evaluations = answer.known(setup), {}, {}, 0
    for i, free in enumerate(setup.asked):
        if len(free.parts) < 2 or not known.known[i]:
            continue
        setup.progress(f"{free.name} from each recording alone")

        def of_recording(k: int, i: int = i) -> tuple[_Alone | None, int]:
            inside = [np.full(part.samples, j == k) for j, part in enumerate(setup.parts)]
            return _alone(setup, answer, i, inside)

        fits = in_parallel(of_recording, free.parts)
        evaluations += sum(count for _, count in fits)
        each = {
            setup.parts[k].name: alone
            for k, (alone, _) in zip(free.parts, fits, strict=True)
            if alone is not None
        }
        if len(each) > 1:
            found[free.name] = {name: alone.estimate for name, alone in each.items()}
            if _scattered(list(each.values()), answer.spread(setup)):
                left[free.name] = sum(alone.squares for alone in each.values())
    return Apart(found, min(left, key=left.__getitem__, default=""), evaluations)


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
    return float(off @ np.linalg.solve(covariance, off)) > float(chdtri(len(values) - 1, CHANCE))


def _alone(setup: Setup, answer: Answer, i: int, inside: list[np.ndarray]) -> tuple[_Alone | None, int]:
    """Free number i from some of the samples, of each recording, None where they know nothing of it; and how
    many simulations of all recordings it took.
    """
    active = np.arange(len(setup.free)) == i
    weighs = tuple(j.by_noise.only(kept) for j, kept in zip(answer.judged, inside, strict=True))
    problem = dataclasses.replace(answer.problem, weighs=weighs, precision=np.zeros(len(active)))
    found = descend(
        problem, answer.descent.u, active=active, known=answer.descent.predictions, max_steps=MAX_STEPS
    )
    if found.predictions is None or found.at_edge.any():
        return None, found.evaluations
    # The noise counts here, not the misfit of all samples: these may be described where the others are not.
    squares, count, tau = 0.0, 0, 1.0
    for part, weigh, kept, prediction in zip(setup.parts, weighs, inside, found.predictions, strict=True):
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
        return None, found.evaluations
    own = float(known.covariance[0, 0])
    lean = np.where(active, 0.0, -(jacobian[:, i] @ jacobian) / float(jacobian[:, i] @ jacobian[:, i]))
    both = known._replace(covariance=known.covariance + lean @ answer.spread(setup) @ lean)
    at = answer.at[0]
    found_there = estimates(
        [setup.numbers(np.asarray(at.reference))[i]],
        np.asarray(at.values(found.u))[active],
        setup.initial[active],
        both,
        [""],
    )[0]
    alone = _Alone(estimate=found_there, u=float(found.u[i]), own=own, lean=lean, squares=squares)
    return alone, found.evaluations
