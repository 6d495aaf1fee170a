"""From the point where a fit ended to what is reported of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from gtr_jax import InputError, RobotConfig
from gtr_jax.robot.parameters import with_values

from . import verdict as words
from .alone import Apart, Phases, by_recording, mu_by_phase
from .answer import Answer, Judged
from .coordinates import CHANNEL_UNITS, CHANNELS, Prediction, is_log
from .descent import all_converged
from .estimate import MOSTLY_PRIOR, UNKNOWN, Estimate, Uncertainty, correlation, estimates, transform
from .identifiability import MINOR, axes, remedy
from .noise import MAD_TO_SD
from .result import Channel, FitResult, FittedRecording
from .start import Start
from .task import Task

TRADE_OFF = 0.99
# Standard deviations of a prior.
DRIFTED = 2.5
ONE_SIDED_95 = 1.6449
SMALL_MU = 0.05
# Residuals beyond so many standard deviations of the bulk are outliers, if they are at most such a share.
FAR_OFF, FEW = 7.0, 0.1


def _settings(task: Task, **more: Any) -> dict[str, Any]:
    priors = {f.name: prior for f, prior in zip(task.free, task.priors, strict=True) if prior is not None}
    return {
        "free": [f.name for f in task.asked],
        "carried": [f.name for f in task.free if f.carried],
        "samples": task.samples,
        "peak_T_tip_N": task.peak,
        "priors_sd_SI": priors,
        "recordings_of": {f.name: [task.parts[k].name for k in f.parts] for f in task.free},
        "robust": task.robust,
        "max_steps": task.max_steps,
        "optimiser": "optimistix.LevenbergMarquardt",
        **more,
    }


def _fitted_config(
    task: Task, k: int, values: np.ndarray, left: Sequence[float | None]
) -> RobotConfig | None:
    """The robot file of recording k with the fitted values, and with what is `left` uncertain of the numbers
    that it called uncertain, SI; None where that is what it was.
    """
    config = task.parts[k].config
    if config is None:
        return None
    changed = {
        f.entry.key: float(value)
        for f, value in zip(task.free, values, strict=True)
        if k in f.parts and value != f.initial
    }
    try:
        return config.with_values(changed).with_deviations(
            {
                f.entry.key: sd
                for f, sd in zip(task.free, left, strict=True)
                if k in f.parts and sd is not None and f.entry.key in config.uncertainty
            }
        )
    except InputError as fault:
        task.warnings.append(f"The fitted values do not make a robot file: {fault}.")
        return None


def _largest_mu(task: Task, known: Uncertainty, values: np.ndarray) -> float:
    """Upper limit (95 %) of mu where it is small, from the slope there; infinite if not fitted or unseen."""
    limits = [float(values[i] * (1 + ONE_SIDED_95 * known.alone[i])) for i in task.friction()]
    return max(limits, default=np.inf)


def _notes(task: Task, known: Uncertainty, answer: Answer, values: np.ndarray) -> list[str]:
    """What a reader must know of each estimate; also gathered as warnings."""
    notes, problem, descent = [], answer.problem, answer.descent
    drift, stopped = (descent.u - problem.centre) * problem.precision, answer.at[0].stopped(descent.u)
    for i, free in enumerate(task.free):
        note = ""
        drifted = abs(drift[i]) > DRIFTED
        most = _largest_mu(task, known, values)
        if free.carried:
            note = _drifted(drift[i]) if drifted else ""
        elif not known.known[i] and free.entry.name == "mu" and most < SMALL_MU:
            note = f"no friction is seen, mu is below {most:.2g} (95 %)"
        elif descent.at_edge[i]:
            note = "ran to the end of the range searched, so it has no interval"
        elif stopped[i]:
            note = "lies at its bound: the recording asks for no more, so it has no interval"
        elif not known.known[i]:
            rest = "the prior's" if task.priors[i] is not None else "arbitrary"
            note = f"not determined by the recording, the value is {rest}"
        elif known.prior_share[i] > MOSTLY_PRIOR:
            note = f"rests mostly on its prior ({100 * known.prior_share[i]:.0f} % of what is known)"
        elif drifted:
            note = _drifted(drift[i])
        notes.append(note)
        if note:
            task.warnings.append(f"{free.name}: {note}.")
    return notes


def _drifted(by: float) -> str:
    """What is said of a number that lies so many standard deviations of its prior from where it started."""
    return (
        f"lies {abs(by):.1f} standard deviations of its prior from the robot file's value: either that is "
        "wrong, or the model lacks something that this makes up for"
    )


def ignorance(task: Task, answer: Answer) -> str:
    """Why no parameter is determined; "" if one is. Friction too small to be seen is an answer."""
    known, values = answer.known(task), np.asarray(answer.at[0].values(answer.descent.u))
    asked = [f.name for f in task.asked]
    if known.known[: len(asked)].any():
        return ""
    others_known = all(p is not None for i, p in enumerate(task.priors) if i not in task.friction())
    if others_known and _largest_mu(task, known, values) < SMALL_MU:
        return ""
    each = [n for n, a in zip(asked, known.alone, strict=False) if a < UNKNOWN]
    if len(each) > 1:
        names = " and ".join(each)
        way = _remedy(task, answer, [task.names.index(n) for n in each])
        return (
            f"the recording determines {names} only in combination; fix one of them, or state its "
            "uncertainty under [uncertainty] in the robot file" + (f"; or measure more: {way}" if way else "")
        )
    return f"the recording does not determine {' or '.join(asked)}"


def _remedy(task: Task, answer: Answer, among: list[int]) -> str:
    """The measurement that would tell parameters apart, in a sentence, or ""."""
    sd = [float(np.sqrt(j.weigh.tau[0]) * j.sd[0]) for j in answer.judged]
    return remedy(task, answer.at, answer.descent.u, answer.information(), sd, among)


def _steps(task: Task, answer: Answer) -> list[str]:
    """What a hundredth of a coordinate is of each free number."""
    at = answer.at[0]
    relative = np.asarray(at.log) | (np.asarray(at.reference) != 0)
    scales = np.asarray(at.scale).tolist()
    return [
        "%" if share else f"% of {scale:g} {f.entry.unit}".rstrip()
        for f, share, scale in zip(task.free, relative, scales, strict=True)
    ]


def _unknown_axes(task: Task, answer: Answer, known: Uncertainty) -> None:
    """Warn of combinations of parameters that nothing is known of, and say which measurement would help."""
    n = len(task.asked)
    for axis in axes(answer.information_about(n)):
        large = np.abs(axis.direction) > MINOR * np.max(np.abs(axis.direction))
        if axis.sd > UNKNOWN and large.sum() > 1 and not known.known[:n][large].any():
            among = np.flatnonzero(large).tolist()
            way = _remedy(task, answer, among)
            task.warnings.append(
                "Nothing tells these changes from none: "
                + axis.words(task.names[:n], _steps(task, answer)[:n])
                + (f"; {way}." if way else ".")
            )


def _trade_offs(task: Task, answer: Answer, known: Uncertainty) -> None:
    """Warn of pairs that the recording hardly tells apart, with what would."""
    n = len(task.asked)
    rho, log = correlation(known.covariance[:n, :n]), np.asarray(answer.at[0].log)
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
    if not all_converged(answer.predictions):
        failed, steps = (
            sum(p.failed for p in answer.predictions),
            sum(p.steps for p in answer.problem.predict.parts),
        )
        return f"{failed} of {steps} load steps of the simulation did not converge"
    if not answer.descent.converged:
        return f"the optimiser did not finish ({answer.descent.result}); the values are where it stopped"
    return ""


def _fitted(
    task: Task,
    k: int,
    prediction: Prediction | None,
    answer: Answer | None,
    values: np.ndarray,
    covariance: np.ndarray | None,
    left: Sequence[float | None],
) -> FittedRecording:
    """Recording k beside the model; as it was where there is no answer."""
    part = task.parts[k]
    judged = None if answer is None else answer.judged[k]
    missing = np.full((len(CHANNELS), part.samples), np.nan)
    shown = missing if prediction is None else prediction.values
    phases = np.full(part.samples, words.REST) if prediction is None else prediction.phases
    channels = {}
    every = shown[part.where] - part.recorded
    if judged is not None:
        every = judged.weigh.left(every)
    for c, (name, at) in enumerate(zip(part.channels, part.where, strict=True)):
        off = every[c]
        simulated = part.recorded[c] + off
        sd = None if judged is None else float(judged.sd[c])
        channels[name] = Channel(CHANNEL_UNITS[at], simulated, off, sd)
    band = np.zeros(part.samples)
    if prediction is not None and covariance is not None:
        known = np.isfinite(np.diag(covariance))
        slopes = prediction.jacobian[0][:, known]
        band = np.sqrt(np.einsum("kp,pq,kq->k", slopes, covariance[np.ix_(known, known)], slopes))
    noise, chosen = part.noise() if judged is None else judged.noise, {}
    if answer is not None and judged is not None:
        chosen = {
            "samples_simulated": answer.problem.predict.parts[k].steps,
            "knots_of_base": part.T_base.size,
            "samples_per_independent_base": part.T_base.tau,
            "samples_per_independent": float(judged.weigh.tau[0]),
        }
    return FittedRecording(
        name=part.name,
        robot=with_values(part.robot, task.values_of(k, values)),
        config=part.config if covariance is None else _fitted_config(task, k, values, left),
        channels=channels,
        T_base=part.T_base.T_base,
        band=band,
        phases=phases,
        by_phase={} if prediction is None else words.by_phase(channels["T_tip"].residual, phases),
        noise_N=noise.sd,
        noise_from=noise.source,
        noise_base_N=part.T_base.sd,
        chi2_per_n=None if judged is None else judged.chi2_per_n,
        outliers=0 if judged is None else int(np.sum(~judged.kept)),
        settings={"robot": part.robot.name, "path": part.path, **chosen},
    )


def assemble(task: Task, answer: Answer, iterations: int, start: Start) -> FitResult:
    """The result of a fit that reached an end, good or bad."""
    at, descent = answer.at[0], answer.descent
    log, scale = np.asarray(at.log), np.asarray(at.scale)
    known, n = answer.known(task), len(task.asked)
    values = np.asarray(at.values(descent.u))
    notes = _notes(task, known, answer, values)
    named = [dataclasses.replace(f.entry, name=f.name) for f in task.free]
    # What was carried along is known as before where the recordings say nothing of it.
    told = known._replace(covariance=answer.spread(task), known=known.known | [f.carried for f in task.free])
    found = estimates(named, values, task.initial, log, scale, told, notes, answer.sources(task))
    _unknown_axes(task, answer, known)
    _trade_offs(task, answer, known)
    failure = _failure(answer)
    phases = Phases({}, 0.0)
    apart = Apart({}, "")
    if failure:
        found = [
            dataclasses.replace(e, sd=None, lower95=None, upper95=None, detectable=None, made_of={})
            for e in found
        ]
    else:
        if known.known[task.friction()].any():
            phases = mu_by_phase(task, answer)
        apart = by_recording(task, answer)
    disagreement = words.disagreement(phases.estimates, phases.apart)
    if disagreement:
        task.warnings.append(disagreement[0].upper() + disagreement[1:] + ": more apart than their errors.")
    clauses = [disagreement] if disagreement else []
    if apart.blamed:
        clauses.append(f"the recordings disagree: {words.apart(apart.blamed, apart.estimates[apart.blamed])}")
        task.warnings.append(
            f"The recordings disagree, most likely about {apart.blamed}: find out what differs between them, "
            f"or fit it to each with --per-recording {apart.blamed}."
        )
    left = [e.sd for e in found]
    recordings = tuple(
        _fitted(task, k, prediction, answer, values, known.covariance, left)
        for k, prediction in enumerate(answer.predictions)
    )
    for r, judged in zip(recordings, answer.judged, strict=True):
        few = f"samples{f' of {r.name}' if len(recordings) > 1 else ''} lie far off"
        if r.outliers:
            many = r.outliers > FEW * len(r.T_base)
            task.warnings.append(
                f"{r.outliers} of {len(r.T_base)} {few} and count less than half"
                + (": too many to be outliers, the model lacks something." if many else ".")
            )
        lone = _outliers(judged)
        if lone and not task.robust:
            task.warnings.append(
                f"{lone} of {len(r.T_base)} {few} while the others do not: a robust fit (--robust) lets them "
                "count less."
            )
    return FitResult(
        recordings=recordings,
        estimates=found[:n],
        carried=found[n:],
        converged=not failure,
        result=descent.result,
        iterations=iterations,
        evaluations=task.evaluations,
        correlation=correlation(known.covariance[:n, :n]),
        warnings=task.warnings,
        verdict=words.verdict(
            found[:n],
            [_distance(task, answer, r) for r in zip(recordings, answer.judged, strict=True)],
            disagreement="; ".join(clauses),
            failure=failure,
        ),
        settings=_settings(
            task,
            samples_simulated=sum(p.steps for p in answer.problem.predict.parts),
            start=dict(zip(task.names, np.asarray(at.values(start.u)).tolist(), strict=True)),
            starts_tried=start.tried,
            starts_that_agree=start.agreed,
        ),
        mu_by_phase=phases.estimates,
        by_recording=apart.estimates,
        axes=[
            (axis.words(task.names[:n], _steps(task, answer)[:n]), axis.sd)
            for axis in axes(answer.information_about(n))
        ],
    )


def _outliers(judged: Judged) -> int:
    """Samples far off where most are not; 0 where the model misses more than a few."""
    off = np.abs(judged.residual[0] - np.median(judged.residual[0]))
    scale = MAD_TO_SD * float(np.median(off))
    far = int(np.sum(off > FAR_OFF * scale))
    return far if scale > 0 and far <= FEW * len(off) else 0


def _distance(task: Task, answer: Answer, of: tuple[FittedRecording, Judged]) -> words.Distance:
    fitted, judged = of
    used = len(task.free) * len(fitted.T_base) / task.samples
    degrees = max(len(fitted.T_base) - used, 1) / float(judged.weigh.tau[0])
    part = next(p for p in task.parts if p.name == fitted.name)
    others = []
    for c, name in enumerate(part.channels):
        if c and fitted.channels[name].rms > words.SMALL * float(np.ptp(part.recorded[c])):
            others.append(
                (name, fitted.channels[name].rms, float(judged.least[c]), CHANNEL_UNITS[part.where[c]])
            )
    return words.Distance(
        name=fitted.name,
        rms=judged.rms,
        outliers=fitted.outliers,
        peak=float(np.max(part.T_tip)),
        noise=fitted.noise_N,
        chi2=fitted.chi2_per_n,
        degrees=(degrees, judged.noise.degrees),
        table=fitted.by_phase,
        others=[o for o in others if o[1] ** 2 > words.LACK_OF_FIT * o[2] ** 2],
    )


def unanswered(task: Task, predictions: tuple[Prediction, ...] | None, why: str) -> FitResult:
    """The result of a fit that could not begin: the robots as they were, no intervals, and why."""
    p = len(task.asked)
    task.warnings.append(why[0].upper() + why[1:] + ".")
    recordings = tuple(
        _fitted(task, k, None if predictions is None else predictions[k], None, task.initial, None, ())
        for k in range(len(task.parts))
    )
    return FitResult(
        recordings=recordings,
        estimates=[
            Estimate(
                f.name,
                f.entry.key,
                v,
                None,
                None,
                None,
                v,
                f.entry.unit,
                transform(is_log(f.entry, v)),
                "not fitted",
            )
            for f, v in zip(task.asked, task.initial.tolist(), strict=False)
        ],
        carried=[],
        converged=False,
        result=why,
        iterations=0,
        evaluations=task.evaluations,
        correlation=np.full((p, p), np.nan),
        warnings=task.warnings,
        verdict=f"No answer: {why}.",
        settings=_settings(task),
    )
