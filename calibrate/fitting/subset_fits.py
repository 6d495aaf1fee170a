"""One parameter fitted to part of the samples: do pulling and releasing, or two recordings, agree?"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from calibrate.inference.answer import Answer
from calibrate.inference.descent import descend
from calibrate.inference.estimate import UNKNOWN, Estimate, estimates, uncertainty
from calibrate.inference.parallel import in_parallel
from calibrate.inference.setup import Setup
from gtr_jax.recordings.signals.noise import correlation_time
from gtr_jax.simulation.phases import PULLING, RELEASING

# Samples that a phase needs for an estimate of its own.
FEWEST = 8
# Steps of the optimiser for one parameter, which starts from the joint fit.
MAX_STEPS = 12
# Recordings are said to disagree if their values scatter more than they would by chance in this share of
# fits.
CHANCE = 0.01


class Phases(NamedTuple):
    """Estimates of mu from single phases.

    Attributes:
        estimates: by phase; a phase that is too short, or does not determine mu, is left out.
        apart: by how many standard errors pulling and releasing differ; 0 where one is left out.
        evaluations: times that all recordings were simulated.
    """

    estimates: dict[str, Estimate]
    apart: float
    evaluations: int


def mu_by_phase(setup: Setup, answer: Answer) -> Phases:
    """Estimate mu from pulling alone and from releasing alone. The other parameters and the phases stay as
    fitted, and the uncertainty of these parameters counts in the errors. Empty unless a single mu is free,
    and where tendons of one robot have phases of their own.
    """
    if len(setup.friction()) != 1 or any(part.others for part in setup.parts):
        return NO_PHASES
    inside = {phase: [judged.phases == phase for judged in answer.judged] for phase in (PULLING, RELEASING)}
    long = [phase for phase, samples in inside.items() if sum(map(np.sum, samples)) >= FEWEST]

    def of_phase(phase: str) -> tuple[_SubsetFit | None, int]:
        setup.progress(f"fitting {phase} alone")
        return _fit_subset(setup, answer, setup.friction()[0], inside[phase])

    each = in_parallel(of_phase, long)
    evaluations = sum(count for _, count in each)
    found = {phase: fit for phase, (fit, _) in zip(long, each, strict=True) if fit is not None}
    apart = 0.0
    if len(found) == 2:
        off, covariance = _together(list(found.values()), answer.spread(setup))
        apart = abs(float(off[0] - off[1])) / float(
            np.sqrt(np.array([1, -1]) @ covariance @ np.array([1, -1]))
        )
    return Phases({phase: fit.estimate for phase, fit in found.items()}, apart, evaluations)


class ByRecording(NamedTuple):
    """Estimates of shared parameters from each recording alone. The other parameters stay as fitted, and
    their uncertainty counts in the errors.

    Attributes:
        estimates: by parameter, then recording; recordings that do not determine it are left out.
        blamed: of the parameters whose values disagree, the one whose separate fits describe the recordings
            best; "" if all agree.
        evaluations: times that all recordings were simulated.
    """

    estimates: dict[str, dict[str, Estimate]]
    blamed: str
    evaluations: int


NO_PHASES, NOT_BY_RECORDING = Phases({}, 0.0, 0), ByRecording({}, "", 0)


def by_recording(setup: Setup, answer: Answer) -> ByRecording:
    """Estimate each shared parameter from each recording alone."""
    known, found, left, evaluations = answer.known(setup), {}, {}, 0
    for i, free in enumerate(setup.asked):
        if len(free.parts) < 2 or not known.known[i]:
            continue
        setup.progress(f"{free.name} from each recording alone")

        def of_recording(k: int, i: int = i) -> tuple[_SubsetFit | None, int]:
            inside = [np.full(part.samples, j == k) for j, part in enumerate(setup.parts)]
            return _fit_subset(setup, answer, i, inside)

        fits = in_parallel(of_recording, free.parts)
        evaluations += sum(count for _, count in fits)
        each = {
            setup.parts[k].name: fit for k, (fit, _) in zip(free.parts, fits, strict=True) if fit is not None
        }
        if len(each) > 1:
            found[free.name] = {name: fit.estimate for name, fit in each.items()}
            if _scattered(list(each.values()), answer.spread(setup)):
                left[free.name] = sum(fit.squares for fit in each.values())
    return ByRecording(found, min(left, key=left.__getitem__, default=""), evaluations)


class _SubsetFit(NamedTuple):
    """One number estimated from some of the samples.

    Attributes:
        estimate: the number, with the errors of the other numbers counted in.
        u: coordinate of the number.
        own: variance of u if the other numbers were known.
        lean: change of u per change of each other coordinate, (p,).
        squares: sum of squared residuals that is left.
    """

    estimate: Estimate
    u: float
    own: float
    lean: np.ndarray
    squares: float


def _together(each: list[_SubsetFit], spread: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of one number from several parts, (m,), and their covariance, (m, m): errors of the other
    numbers, whose covariance is `spread`, (p, p), move all parts together.
    """
    lean = np.stack([a.lean for a in each])
    return np.asarray([a.u for a in each]), np.diag([a.own for a in each]) + lean @ spread @ lean.T


def _scattered(each: list[_SubsetFit], spread: np.ndarray) -> bool:
    """Whether values of one number lie farther apart than their errors allow."""
    values, covariance = _together(each, spread)
    ones = np.ones(len(values))
    weights = np.linalg.solve(covariance, ones)
    off = values - float(weights @ values) / float(weights @ ones)
    return float(off @ np.linalg.solve(covariance, off)) > float(chdtri(len(values) - 1, CHANCE))


def _fit_subset(
    setup: Setup, answer: Answer, i: int, inside: list[np.ndarray]
) -> tuple[_SubsetFit | None, int]:
    """Estimate free number i from some of the samples of each recording, None if they do not determine it;
    and count how often all recordings were simulated.
    """
    active = np.arange(len(setup.free)) == i
    weighs = tuple(j.by_noise.only(kept) for j, kept in zip(answer.judged, inside, strict=True))
    problem = dataclasses.replace(answer.problem, weighs=weighs, precision=np.zeros(len(active)))
    found = descend(
        problem, answer.descent.u, active=active, known=answer.descent.predictions, max_steps=MAX_STEPS
    )
    if found.predictions is None or found.at_edge.any():
        return None, found.evaluations
    # Weighed by the noise, not by the misfit of all samples: the model may describe these and not the others.
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
    fit = _SubsetFit(estimate=found_there, u=float(found.u[i]), own=own, lean=lean, squares=squares)
    return fit, found.evaluations
