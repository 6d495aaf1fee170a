"""Friction fitted to the samples of one phase alone: do pulling and releasing tell the same story?."""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.phases import PULLING, RELEASING

from .coordinates import Coordinates
from .descent import Descent, Objective, descend
from .estimate import UNKNOWN, Estimate, estimates, uncertainty
from .noise import correlation_time
from .task import Task

FEWEST = 8


def mu_by_phase(
    task: Task, at: Coordinates, problem: Objective, fitted: Descent, phases: np.ndarray
) -> dict[str, Estimate]:
    """mu from pulling alone and from releasing alone; other parameters and the phases stay as fitted.

    Args:
        task: the fit.
        at: its coordinates.
        problem: its least squares problem on all samples.
        fitted: where it ended.
        phases: of the fitted model, (K,).

    Returns:
        Estimates by phase; a phase that is short, or knows nothing of mu, is left out.
    """
    if "mu" not in task.names:
        return {}
    active = np.asarray([name == "mu" for name in task.names])
    found = {}
    for phase in (PULLING, RELEASING):
        inside = phases == phase
        if inside.sum() < FEWEST:
            continue
        task.progress(f"fitting {phase} alone")
        part = dataclasses.replace(problem, weigh=problem.weigh.only(inside), precision=np.zeros(len(active)))
        before = problem.predict.count
        alone = descend(part, fitted.u, active=active, known=fitted.prediction, max_steps=12)
        task.evaluations += problem.predict.count - before
        if alone.prediction is None or alone.at_edge.any():
            continue
        weighed = part.weigh(alone.prediction.T_tip - task.T_tip)
        tip = weighed[: len(inside)][inside]
        spread = max(1.0, float(np.sum(weighed**2)) / (len(tip) - 1)) * correlation_time(tip)
        slope = part.weigh(alone.prediction.jacobian)[:, active]
        known = uncertainty(slope, np.sqrt(spread), np.zeros(1), np.full(1, UNKNOWN))
        if known.known.all():
            i = int(np.flatnonzero(active)[0])
            value = np.asarray(at.values(alone.u))[active]
            found[phase] = estimates(
                [task.chosen[i]],
                value,
                task.initial[active],
                np.asarray(at.log)[active],
                np.ones(1),
                known,
                [""],
            )[0]
    return found
