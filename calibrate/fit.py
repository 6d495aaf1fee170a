"""`fit`: a robot's parameters from a recording of base and tip tension."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gtr_jax import InputError, Recording, Robot, RobotConfig

from . import base_tension
from .answer import Answer, assemble, ignorance, unanswered
from .coordinates import choose
from .descent import descend
from .profiles import profiles
from .result import FitResult
from .start import search
from .task import Task, robot_of, tensions
from .weighing import Weighing

DEFAULT_FREE = ("mu", "E")
# Slopes of the tip tension below this share of the largest tension are rounding.
NO_SLOPE = 1e-9
REWEIGHINGS = 3
# A noise given that is so many times the one seen deserves a warning.
TOO_LARGE = 3.0


def fit(
    robot: RobotConfig | Robot,
    recording: Recording,
    *,
    free: Sequence[str] | None = None,
    noise_N: float | None = None,
    noise_base_N: float | None = None,
    max_steps: int = 60,
    profiled: bool = False,
    progress: Callable[[str], None] | None = None,
) -> FitResult:
    """Fit parameters of a robot to a recording by least squares in the tip tension.

    The true base tension is an unknown like the parameters: straight between as few knots as the noise of the
    recorded one allows (`base_tension.py`), because tendons with friction remember extremes, so that noise
    taken for tension biases friction. Minimised is the sum of squares of what is left at the tip and at the
    base, each in units of its noise (`weighing.py`), and of (deviation/standard deviation) of each free
    parameter under [uncertainty] in the robot file, on the scale it is fitted on: logarithmic where positive.
    Base tensions below zero count as slack.

    Standard errors. The covariance is (J'J/tau + P)^-1 at the solution, J the weighed dT_tip/du by forward
    mode through the solver, P the priors' precision. The tip's noise is taken as large as the residual
    shows, be it noise or misfit, and tau = 1 + 2 sum of the residual's autocorrelations (Geyer's initial
    positive sequence) is the number of samples per independent one, so that K samples count as K/tau. Where
    the model misses physics this measures scatter, not bias: believe the verdict first. Slopes jump where a
    sample changes from locked to slipping, so errors are those on one side of it. A parameter that the data
    alone leave uncertain by a factor of e, or that ran to the end of the range searched, gets no interval.

    Args:
        robot: from `gtr_jax.load_config`; or a `Robot`, whose parameters then have no priors.
        recording: with T_base and T_tip, K >= 4 samples.
        free: parameters to fit, by short name or key of the robot file; unless given, mu and E, or mu alone
            for a rigid sheath.
        noise_N: standard deviation of the recorded tip tension [N]; estimated from the recording unless
            given.
        noise_base_N: that of the recorded base tension [N]; 0 takes it as exact.
        max_steps: steps after which the optimiser gives up.
        profiled: whether profile likelihoods are taken too, some dozen simulations per parameter.
        progress: called with a line of text at each stage.

    Returns:
        The answer. It does not raise where there is none: `converged` is False and `verdict` says why.

    Raises:
        InputError: unknown or unsuitable parameter, recording without tip tension or too short, noise not
            positive.
    """
    if noise_N is not None and not (np.isfinite(noise_N) and noise_N > 0):
        raise InputError(f"noise_N: must be a positive number of newtons, is {noise_N:g}")
    if noise_base_N is not None and not (np.isfinite(noise_base_N) and noise_base_N >= 0):
        raise InputError(f"noise_base_N: must be a number of newtons, not below 0, is {noise_base_N:g}")
    model, config = robot_of(robot)
    if model.tendon_names:
        raise InputError(
            f"fit: {model.name} has {len(model.tendons)} tendons; this version fits one tendon; "
            "take the others out of the robot file"
        )
    T_base, T_tip = tensions(recording)
    warnings: list[str] = []
    if free is None:
        free = ("mu",) if model.backbone.rigid else DEFAULT_FREE
        if model.backbone.rigid:
            warnings.append("E is not fitted: the backbone is rigid, so its stiffness has no effect.")
    chosen = choose(model, free)
    model = model.with_values(**{p.name: model.value(p.name) for p in chosen})
    if noise_base_N:
        seen = base_tension.estimate(T_base, recording.time).sd
        if 0 < TOO_LARGE * seen < noise_base_N:
            warnings.append(
                f"The noise given for the base tension, {noise_base_N:.3g} N, is far above the {seen:.2g} N "
                "that the recording shows: real changes smaller than it may be taken for noise."
            )
    silent = progress or (lambda _: None)
    base = base_tension.estimate(T_base, recording.time, noise_base_N)
    task = Task(
        model,
        config,
        chosen,
        base,
        T_tip,
        recording.trial,
        noise_N,
        max_steps,
        silent,
        warnings,
        profiled=profiled,
    )
    return _run(task)


def _run(task: Task) -> FitResult:
    sigma = max(task.noise().sd or 0.0, task.smallest_sigma)
    found = search(task, sigma)
    if found is None:
        return unanswered(task, None, "the simulation fails at every start value tried")
    at, start = found
    problem = task.objective(at, np.arange(len(task.T_tip)), sigma)
    task.progress("fitting")
    first = problem.predict(start)
    if first is None:
        return unanswered(task, None, "the simulation fails at the start values")
    tension = max(task.peak, float(np.max(task.T_base.T_base)), 1e-3)
    heard = np.max(np.abs(first.jacobian), axis=0) > NO_SLOPE * tension
    if not heard.any():
        names, still = " and ".join(task.names), np.ptp(first.T_tip) == 0
        reason = "no slip reaches the tip" if still else "the tip tension does not depend on it"
        return unanswered(task, first, f"the recording says nothing about {names}: {reason}")
    rms = float(np.sqrt(np.mean((first.T_tip - task.T_tip) ** 2)))
    weigh = Weighing.of(task.T_base, first, max(sigma, rms), task.T_base.believed)
    start, known, iterations = start, first, 0
    for k in range(REWEIGHINGS):
        problem = dataclasses.replace(problem, weigh=weigh)
        # Priors wait until it is known how well the model can fit: else one that is wrong passes for noise.
        unbiased = dataclasses.replace(problem, precision=np.zeros_like(problem.precision))
        descent = descend(
            problem if k else unbiased,
            start,
            active=heard,
            known=known,
            max_steps=task.max_steps,
            progress=task.progress,
        )
        iterations += descent.iterations
        answer = Answer.of(task, at, problem, descent)
        # Tip, base and priors are weighed by the errors that the data turn out to have.
        weigh = answer.weigh
        if descent.converged:
            start, known = descent.u, descent.prediction
        elif k:
            break
    counted = problem.predict.count
    task.evaluations += counted
    unknown = ignorance(task, answer)
    if unknown:
        as_given = np.where(np.asarray(at.log), np.maximum(task.initial, 1e-9), task.initial)
        return unanswered(task, problem.predict(at.at(as_given)), unknown)
    result = assemble(task, answer, iterations)
    if not (result.converged and task.profiled):
        return result
    found = profiles(task, answer)
    return dataclasses.replace(
        result, profiles=found, evaluations=result.evaluations + problem.predict.count - counted
    )
