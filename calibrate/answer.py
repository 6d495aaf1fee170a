"""From the point where a fit ended to what is reported of it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gtr_jax import InputError, RobotConfig

from . import verdict as words
from .coordinates import Coordinates, Prediction, is_log
from .descent import Descent, Objective
from .estimate import (
    MOSTLY_PRIOR,
    UNKNOWN,
    Estimate,
    Uncertainty,
    correlation,
    estimates,
    transform,
    uncertainty,
)
from .identifiability import remedy
from .noise import Noise, correlation_time
from .phase_fit import mu_by_phase
from .result import FitResult
from .task import Task
from .weighing import Weighing

LEVELLING = 12
TRADE_OFF = 0.99
# Standard deviations of a prior.
DRIFTED = 2.5
ONE_SIDED_95 = 1.6449
SMALL_MU = 0.05
# A parameter that is zero in the robot file has no size to compare its error with: so many of its units.
UNKNOWN_WITHOUT_SCALE = 10.0


@dataclasses.dataclass(frozen=True)
class Answer:
    """A point and what the residual there says of the errors.

    Attributes:
        at, problem, descent: coordinates, least squares problem, and where its descent ended.
        prediction: the simulation there.
        residual: simulated minus recorded [N], (K,).
        phases: (K,).
        noise: of the recorded tip tension.
        weigh: residuals weighed with the tip's noise as large as they show.
        chi2_per_n: sum of squares per degree of freedom, in units of the noise; None if that cannot be told.
        rms: of the residual [N].
        tau: samples per independent one.
    """

    at: Coordinates
    problem: Objective
    descent: Descent
    prediction: Prediction
    residual: np.ndarray
    phases: np.ndarray
    noise: Noise
    weigh: Weighing
    chi2_per_n: float | None
    rms: float
    tau: float

    def known(self, task: Task) -> Uncertainty:
        """What data and priors say at this point; nothing of what ran to the end of its range."""
        log = np.asarray(self.at.log)
        unknown = np.where(log | (task.initial != 0), UNKNOWN, UNKNOWN_WITHOUT_SCALE)
        unknown = np.where(self.descent.at_edge, 0.0, unknown)
        jacobian = self.weigh(self.prediction.jacobian)
        return uncertainty(jacobian, float(np.sqrt(self.tau)), self.problem.precision, unknown)

    @staticmethod
    def of(task: Task, at: Coordinates, problem: Objective, descent: Descent) -> Answer:
        """Judge the point where a descent ended."""
        prediction = descent.prediction
        assert prediction is not None  # the start was simulated before the descent began
        residual = prediction.T_tip - task.T_tip
        noise = task.noise(prediction)
        weigh, chi2 = _weighed(task, prediction, noise)
        tau = correlation_time(weigh(residual)[: len(residual)])
        rms = float(np.sqrt(np.mean(residual**2)))
        return Answer(
            at, problem, descent, prediction, residual, prediction.phases, noise, weigh, chi2, rms, tau
        )


def _weighed(task: Task, prediction: Prediction, noise: Noise) -> tuple[Weighing, float | None]:
    """The weighing that the residual asks for, with the tip's noise or, where that does not explain it, with
    as much as does; and the sum of squares per degree of freedom in units of the noise.
    """
    base, residual = task.T_base, prediction.T_tip - task.T_tip
    degrees = max(len(residual) - len(task.chosen), 1)
    sd = max(noise.sd or 0.0, task.smallest_sigma)
    weigh = Weighing.of(base, prediction, sd, base.believed)
    chi2 = float(np.sum(weigh(residual) ** 2)) / degrees
    found = chi2 if noise.sd else None
    for _ in range(LEVELLING):
        if chi2 <= 1.0:
            break
        sd *= np.sqrt(chi2)
        weigh = Weighing.of(base, prediction, sd, base.believed)
        chi2 = float(np.sum(weigh(residual) ** 2)) / degrees
    return weigh, found


def _settings(task: Task, **more: Any) -> dict[str, Any]:
    priors = {p.key: prior for p, prior in zip(task.chosen, task.priors, strict=True) if prior is not None}
    return {
        "free": task.names,
        "samples": len(task.T_tip),
        "peak_T_tip_N": task.peak,
        "priors_relative_sd": priors,
        "noise_given_N": task.noise_N,
        "max_steps": task.max_steps,
        "optimiser": "optimistix.LevenbergMarquardt",
        **more,
    }


def _fitted_config(task: Task, values: dict[str, float]) -> RobotConfig | None:
    if task.config is None:
        return None
    try:
        changed = {
            p.key: values[p.name]
            for p, v in zip(task.chosen, task.initial, strict=True)
            if values[p.name] != v
        }
        return task.config.with_values(changed)
    except InputError as fault:
        task.warnings.append(f"The fitted values do not make a robot file: {fault}.")
        return None


def _largest_mu(task: Task, known: Uncertainty, values: np.ndarray) -> float:
    """Upper limit (95 %) of mu where it is small, from the slope there; infinite if not fitted or unseen."""
    if "mu" not in task.names:
        return np.inf
    i = task.names.index("mu")
    return float(values[i] * (1 + ONE_SIDED_95 * known.alone[i]))


def _notes(
    task: Task, known: Uncertainty, problem: Objective, descent: Descent, values: np.ndarray
) -> list[str]:
    """What a reader must know of each estimate; also gathered as warnings."""
    notes = []
    drift = (descent.u - problem.centre) * problem.precision
    for i, entry in enumerate(task.chosen):
        note = ""
        most = _largest_mu(task, known, values)
        if not known.known[i] and entry.name == "mu" and most < SMALL_MU:
            note = f"no friction is seen, mu is below {most:.2g} (95 %)"
        elif descent.at_edge[i]:
            note = "ran to the end of the range searched, so it has no interval"
        elif not known.known[i]:
            rest = "the prior's" if task.priors[i] is not None else "arbitrary"
            note = f"not determined by the recording, the value is {rest}"
        elif known.prior_share[i] > MOSTLY_PRIOR:
            note = f"rests mostly on its prior ({100 * known.prior_share[i]:.0f} % of what is known)"
        elif abs(drift[i]) > DRIFTED:
            note = (
                f"lies {abs(drift[i]):.1f} standard deviations of its prior from the robot file's value: "
                "either that is wrong, or the model lacks something that this makes up for"
            )
        notes.append(note)
        if note:
            task.warnings.append(f"{entry.name}: {note}.")
    return notes


def ignorance(task: Task, answer: Answer) -> str:
    """Why no parameter is determined; "" if one is. Friction too small to be seen is an answer."""
    known, values = answer.known(task), np.asarray(answer.at.values(answer.descent.u))
    if known.known.any():
        return ""
    others_known = all(p is not None for n, p in zip(task.names, task.priors, strict=True) if n != "mu")
    if others_known and _largest_mu(task, known, values) < SMALL_MU:
        return ""
    each = [n for n, a in zip(task.names, known.alone, strict=True) if a < UNKNOWN]
    if len(each) > 1:
        names = " and ".join(each)
        way = _remedy(task, answer, [task.names.index(n) for n in each])
        return (
            f"the recording determines {names} only in combination; fix one of them, or state its "
            "uncertainty under [uncertainty] in the robot file" + (f"; or measure more: {way}" if way else "")
        )
    return f"the recording does not determine {' or '.join(task.names)}"


def _remedy(task: Task, answer: Answer, among: list[int]) -> str:
    """The measurement that would tell parameters apart, in a sentence, or ""."""
    jacobian = answer.weigh(answer.prediction.jacobian)
    information = jacobian.T @ jacobian / answer.tau + np.diag(answer.problem.precision**2)
    sd = float(np.sqrt(answer.tau) / np.max(answer.weigh.weight))
    return remedy(task, answer.at, answer.descent.u, information, sd, among)


def _trade_offs(task: Task, answer: Answer, known: Uncertainty) -> None:
    """Warn of pairs that the recording hardly tells apart, with what would."""
    rho, log = correlation(known.covariance), np.asarray(answer.at.log)
    for i, j in zip(*np.triu_indices(len(rho), 1), strict=True):
        if abs(rho[i, j]) > TRADE_OFF:
            a, b = task.names[i], task.names[j]
            along = known.covariance[i, j] / known.covariance[i, i]
            sense = "up" if along > 0 else "down"
            little = f": {a} up by 1 % and {b} {sense} by {abs(along):.2g} % changes little"
            way = _remedy(task, answer, [int(i), int(j)])
            task.warnings.append(
                f"{a} and {b} trade off (correlation {rho[i, j]:+.3f})"
                + (little if log[i] and log[j] else "")
                + (f"; {way}." if way else ".")
            )


def _failure(answer: Answer) -> str:
    """Why there is no answer; "" if there is."""
    if not answer.prediction.converged:
        steps = f"{answer.prediction.failed} of {len(answer.residual)} load steps"
        return f"{steps} of the simulation did not converge"
    if not answer.descent.converged:
        return f"the optimiser did not finish ({answer.descent.result}); the values are where it stopped"
    return ""


def assemble(task: Task, answer: Answer, iterations: int) -> FitResult:
    """The result of a fit that reached an end, good or bad."""
    at, descent = answer.at, answer.descent
    log, scale = np.asarray(at.log), np.asarray(at.scale)
    known = answer.known(task)
    values = np.asarray(at.values(descent.u))
    found = estimates(
        task.chosen,
        values,
        task.initial,
        log,
        scale,
        known,
        _notes(task, known, answer.problem, descent, values),
    )
    _trade_offs(task, answer, known)
    failure = _failure(answer)
    alone: dict[str, Estimate] = {}
    if failure:
        found = [dataclasses.replace(e, sd=None, lower95=None, upper95=None) for e in found]
    elif known.known[[name == "mu" for name in task.names]].any():
        alone = mu_by_phase(task, at, answer.problem, descent, answer.phases)
    chi2 = answer.chi2_per_n
    table = words.by_phase(answer.residual, answer.phases)
    disagreement = words.disagreement(alone)
    if disagreement:
        task.warnings.append(disagreement[0].upper() + disagreement[1:] + ": more apart than their errors.")
    fitted = dict(zip(task.names, values.tolist(), strict=True))
    return FitResult(
        robot=task.robot.with_values(**fitted),
        config=_fitted_config(task, fitted),
        estimates=found,
        rms_N=answer.rms,
        noise_N=answer.noise.sd,
        noise_base_N=task.T_base.sd,
        chi2_per_n=chi2,
        residual=answer.residual,
        T_base=task.T_base.T_base,
        T_tip=answer.prediction.T_tip,
        phases=answer.phases,
        by_phase=table,
        converged=not failure,
        result=descent.result,
        iterations=iterations,
        evaluations=task.evaluations,
        correlation=correlation(known.covariance),
        warnings=task.warnings,
        verdict=words.verdict(
            found,
            rms=answer.rms,
            peak=task.peak,
            noise=answer.noise.sd,
            chi2=chi2,
            degrees=(max(len(answer.residual) - len(task.chosen), 1) / answer.tau, answer.noise.degrees),
            table=table,
            disagreement=disagreement,
            failure=failure,
        ),
        settings=_settings(
            task,
            noise_from=answer.noise.source,
            samples_simulated=answer.problem.predict.steps,
            knots_of_base=len(task.T_base.knots),
            samples_per_independent_base=task.T_base.tau,
            samples_per_independent=answer.tau,
            start={p.name: float(v) for p, v in zip(task.chosen, np.asarray(at.reference), strict=True)},
        ),
        mu_by_phase=alone,
    )


def unanswered(task: Task, prediction: Prediction | None, why: str) -> FitResult:
    """The result of a fit that could not begin: the robot as it was, no intervals, and why."""
    K, p = len(task.T_tip), len(task.chosen)
    T_tip = np.full(K, np.nan) if prediction is None else prediction.T_tip
    phases = np.full(K, words.REST) if prediction is None else prediction.phases
    residual = T_tip - task.T_tip
    noise = task.noise()
    task.warnings.append(why[0].upper() + why[1:] + ".")
    return FitResult(
        robot=task.robot,
        config=task.config,
        estimates=[
            Estimate(e.name, e.key, v, None, None, None, v, e.unit, transform(is_log(e, v)), "not fitted")
            for e, v in zip(task.chosen, task.initial.tolist(), strict=True)
        ],
        rms_N=float(np.sqrt(np.mean(residual**2))),
        noise_N=noise.sd,
        noise_base_N=task.T_base.sd,
        chi2_per_n=None if prediction is None else _weighed(task, prediction, noise)[1],
        residual=residual,
        T_base=task.T_base.T_base,
        T_tip=T_tip,
        phases=phases,
        by_phase={} if prediction is None else words.by_phase(residual, phases),
        converged=False,
        result=why,
        iterations=0,
        evaluations=task.evaluations,
        correlation=np.full((p, p), np.nan),
        warnings=task.warnings,
        verdict=f"No answer: {why}.",
        settings=_settings(task, noise_from=noise.source),
    )
