"""From the point where a fit ended to what is reported of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from calibrate.inference.answer import Answer, Judged, together
from calibrate.inference.channels import unit_of
from calibrate.inference.estimate import (
    MOSTLY_PRIOR,
    UNKNOWN,
    Estimate,
    Uncertainty,
    correlation,
    estimates,
    transform,
)
from calibrate.inference.number import is_log
from calibrate.inference.objective import all_converged
from calibrate.inference.setup import Observation, Setup
from calibrate.inference.simulated_readings import Prediction
from gtr_jax import InputError, RobotConfig
from gtr_jax.recordings.base_tension import BaseTension
from gtr_jax.recordings.signals.differences import MAD_TO_SD
from gtr_jax.robot.parameters import with_values
from gtr_jax.simulation.phases import REST

from .fitted import FittedChannel, FittedRecording
from .identifiability import MINOR, axes, remedy, singular
from .result import FitResult
from .start import Beaten, Start
from .subset_fits import NO_PHASES, NOT_BY_RECORDING, by_recording, mu_by_phase
from .verdict import SMALL, Distance, by_phase, disagreement_of_phases, most_of_noise, values_apart, verdict
from .without_tip_tension import DistanceWithoutTip, without_tip

# Correlation of two estimates from which they are said to trade off.
TRADE_OFF = 0.99
# Distance from the prior's mean, in its standard deviations, beyond which the reader is warned.
DRIFTED = 2.5
# Share of the precision from which all that is known is said to be the prior's: the data then narrow the
# interval by less than half a percent.
NOTHING_TOLD = 0.99
# 95 % quantile of the standard normal distribution.
ONE_SIDED_95 = 1.6449
# Friction whose upper limit is below this counts as too small to be seen.
SMALL_MU = 0.05
# Residuals beyond this many standard deviations of the bulk are outliers, if at most this share of samples
# is.
FAR_OFF, FEW = 7.0, 0.1


def _settings(setup: Setup, **more: Any) -> dict[str, Any]:
    priors = {f.name: prior for f, prior in zip(setup.free, setup.priors, strict=True) if prior is not None}
    return {
        "free": [f.name for f in setup.asked],
        "carried": [f.name for f in setup.free if f.carried],
        "samples": setup.samples,
        "peak_T_tip_N": setup.peak,
        "priors_sd_SI": priors,
        "recordings_of": {f.name: [setup.parts[k].name for k in f.parts] for f in setup.free},
        "robust": setup.robust,
        "max_steps": setup.max_steps,
        "optimiser": "Levenberg-Marquardt",
        **more,
    }


def _fitted_config(
    setup: Setup, k: int, values: np.ndarray, left: Sequence[float | None]
) -> tuple[RobotConfig | None, list[str]]:
    """The robot file of recording k with the fitted values, None if it has none or refuses them; and
    warnings. `left` holds the standard deviations that the fit leaves, SI, which replace those of the file.
    """
    config = setup.parts[k].config
    if config is None:
        return None, []
    changed = {
        f.entry.key: float(value)
        for f, value in zip(setup.free, values, strict=True)
        if k in f.parts and value != f.initial
    }
    try:
        found = config.with_values(changed).with_deviations(
            {
                f.entry.key: sd
                for f, sd in zip(setup.free, left, strict=True)
                if k in f.parts and sd is not None and f.entry.key in config.uncertainty
            }
        )
    except InputError as fault:
        return None, [f"The fitted values cannot be written as a robot file: {fault}."]
    return found, []


def _largest_mu(setup: Setup, known: Uncertainty, values: np.ndarray) -> float:
    """Upper limit (95 %) of mu where it is small, from the slope there; infinite if not fitted or unseen."""
    limits = [float(values[i] * (1 + ONE_SIDED_95 * known.alone[i])) for i in setup.friction()]
    return max(limits, default=np.inf)


def _notes(setup: Setup, known: Uncertainty, answer: Answer, values: np.ndarray) -> list[str]:
    """A note for the reader on each estimate, or ""."""
    notes, problem, descent = [], answer.problem, answer.descent
    drift, stopped = (descent.u - problem.centre) * problem.precision, answer.at[0].stopped(descent.u)
    for i, free in enumerate(setup.free):
        note = ""
        drifted = abs(drift[i]) > DRIFTED
        most = _largest_mu(setup, known, values)
        if free.carried:
            note = _drifted(drift[i]) if drifted else ""
        elif not known.known[i] and i in setup.friction() and most < SMALL_MU:
            note = f"no friction is seen, mu is below {most:.2g} (95 %)"
        elif descent.at_edge[i]:
            note = "ran to the end of the range searched, so it has no interval"
        elif stopped[i]:
            note = "lies at its bound: the recording asks for no more, so it has no interval"
        elif not known.known[i]:
            rest = "the robot file's" if setup.priors[i] is not None else "arbitrary"
            note = f"not determined by the recording, the value is {rest}"
        elif known.prior_share[i] > MOSTLY_PRIOR:
            note = _told_by_the_file(setup, i, float(known.prior_share[i]))
        elif drifted:
            note = _drifted(drift[i])
        notes.append(note)
    return notes


def _told_by_the_file(setup: Setup, i: int, share: float) -> str:
    """The note on a number of which the robot file says more than the recordings do, this share of its
    precision.
    """
    name, tell = setup.names[i], f"the recording{' tells' if len(setup.parts) == 1 else 's tell'}"
    if share > NOTHING_TOLD:
        return f"{tell} nothing about {name}: value and interval are those that the robot file states"
    return f"{tell} little about {name}: its interval is mostly the uncertainty that the robot file states"


def _said(name: str, note: str) -> str:
    """A note as a sentence that names its number."""
    return f"{note[0].upper()}{note[1:]}." if f"about {name}:" in note else f"{name}: {note}."


def _drifted(by: float) -> str:
    """The note on a number that moved by this many standard deviations of its prior."""
    return (
        f"lies {abs(by):.1f} standard deviations of its prior from the robot file's value: either that is "
        "wrong, or the model lacks something that this makes up for"
    )


def ignorance(setup: Setup, answer: Answer) -> str:
    """Why no parameter is determined; "" if one is. Friction too small to be seen is an answer."""
    known, values = answer.known(setup), np.asarray(answer.at[0].values(answer.descent.u))
    asked = [f.name for f in setup.asked]
    if known.known[: len(asked)].any():
        return ""
    others_known = all(p is not None for i, p in enumerate(setup.priors) if i not in setup.friction())
    if others_known and _largest_mu(setup, known, values) < SMALL_MU:
        return ""
    each = [n for n, a in zip(asked, known.alone, strict=False) if a < UNKNOWN]
    if len(each) > 1:
        names = " and ".join(each)
        way = _remedy(setup, answer, [setup.names.index(n) for n in each])
        return (
            f"the recording determines {names} only in combination; fix one of them, or state its "
            "uncertainty under [uncertainty] in the robot file"
            + (f"; or measure more: {way}" if way else _no_way(setup, answer))
        )
    return f"the recording does not determine {' or '.join(asked)}"


def _no_way(setup: Setup, answer: Answer) -> str:
    """What to add where none of the measurements that are simulated would tell parameters apart."""
    pulled = [part for part in setup.parts if part.tips and len(part.pulled) == 1 and not part.others]
    if not pulled or not singular(answer.information()):
        return ""
    return "; a larger pull would not tell them apart, because what the cells show depends on them alike"


def _remedy(setup: Setup, answer: Answer, among: list[int]) -> str:
    """The measurement that would tell parameters apart, in a sentence, or ""."""
    sd = [float(np.sqrt(j.weigh.tau[0]) * j.sd[0]) if j.noises else None for j in answer.judged]
    return remedy(setup, answer.at, answer.descent.u, answer.information(), sd, among)


def _steps(setup: Setup, answer: Answer) -> list[str]:
    """The unit of a change by a hundredth of a coordinate, in words, for each free number."""
    at = answer.at[0]
    relative = np.asarray(at.log) | (np.asarray(at.reference) != 0)
    scales = np.asarray(at.scale).tolist()
    return [
        "%" if share else f"% of {scale:g} {f.entry.unit}".rstrip()
        for f, share, scale in zip(setup.free, relative, scales, strict=True)
    ]


def _unknown_axes(setup: Setup, answer: Answer, known: Uncertainty) -> list[str]:
    """A sentence for each combination of parameters about which nothing is known, with the measurement that
    would help.
    """
    n, warnings = len(setup.asked), []
    for axis in axes(answer.information_about(n)):
        large = np.abs(axis.direction) > MINOR * np.max(np.abs(axis.direction))
        if axis.sd > UNKNOWN and large.sum() > 1 and not known.known[:n][large].any():
            among = np.flatnonzero(large).tolist()
            way = _remedy(setup, answer, among)
            warnings.append(
                "The simulation hardly changes if "
                + axis.in_a_sentence(setup.names[:n], _steps(setup, answer)[:n])
                + " at once, so that the recording does not determine these values"
                + ("s" if len(setup.parts) > 1 else "")
                + (f"; {way}." if way else ".")
            )
    return warnings


def _trade_offs(setup: Setup, answer: Answer, known: Uncertainty) -> list[str]:
    """A sentence for each pair of parameters that the recording hardly tells apart, with a measurement that
    would.
    """
    n, warnings = len(setup.asked), []
    rho, log = correlation(known.covariance[:n, :n]), np.asarray(answer.at[0].log)
    for i, j in zip(*np.triu_indices(len(rho), 1), strict=True):
        if abs(rho[i, j]) > TRADE_OFF:
            a, b = setup.names[i], setup.names[j]
            along = known.covariance[i, j] / known.covariance[i, i]
            sense = "larger" if along > 0 else "smaller"
            little = f": with {a} 1 % larger and {b} {abs(along):.2g} % {sense} the simulation hardly changes"
            way = _remedy(setup, answer, [int(i), int(j)])
            warnings.append(
                f"{a} and {b} trade off (correlation {rho[i, j]:+.3f})"
                + (little if log[i] and log[j] else "")
                + (f"; {way}." if way else ".")
            )
    return warnings


def _failure(setup: Setup, answer: Answer, fewer: Beaten | None) -> str:
    """Why there is no answer; "" if there is."""
    if not all_converged(answer.predictions):
        failed, steps = (
            sum(p.failed for p in answer.predictions),
            sum(p.steps for p in answer.problem.predictors),
        )
        return f"{failed} of {steps} load steps of the simulation did not converge"
    if not answer.descent.converged:
        return f"the optimiser did not finish ({answer.descent.result}); the values are where it stopped"
    if fewer is not None:
        names = zip(setup.names, fewer.held, strict=True)
        held = " and ".join(name for name, kept in names if kept)
        free = ",".join(f.name for f, kept in zip(setup.asked, fewer.held, strict=False) if not kept)
        one = np.sum(fewer.held) == 1
        rms = [j.residual[: len(j.noises)].ravel() for j in answer.judged]
        left = float(np.sqrt(np.mean(np.concatenate(rms) ** 2))) if any(r.size for r in rms) else np.nan
        much = f" ({fewer.rms:.3g} N rms instead of {left:.3g} N)" if np.isfinite(fewer.rms) else ""
        return (
            f"the search ended at a poor optimum: with {held} as in the robot file, a fit of the others "
            "alone "
            f"leaves less{much}; fit --free {free} first, write what it finds into the robot file, and give "
            f"{held} {'a start value' if one else 'start values'} there"
        )
    return ""


def _pulled(part: Observation) -> list[BaseTension]:
    """What drives the tendons that tension drives."""
    each = zip(part.drives, part.robot.tendons, strict=True)
    return [drive for drive, tendon in each if tendon.drive == "tension"]


def _by_phase(part: Observation, residual: np.ndarray, phases: np.ndarray) -> dict[str, dict[str, float]]:
    """As `by_phase`; of several tendons, each phase with the name of its tendon in front; empty without tip
    tensions.
    """
    names = part.robot.tendon_names
    if not part.tips:
        return {}
    if not names:
        return by_phase(residual[0], phases)
    return {
        f"{name}, {phase}": row
        for name, own, at in zip(names, residual, phases.T, strict=False)
        for phase, row in by_phase(own, at).items()
    }


def _fitted(
    setup: Setup,
    k: int,
    prediction: Prediction | None,
    answer: Answer | None,
    values: np.ndarray,
    covariance: np.ndarray | None,
    left: Sequence[float | None],
) -> tuple[FittedRecording, list[str]]:
    """Recording k beside the fitted model, or the initial one where there is no answer; and warnings."""
    part = setup.parts[k]
    judged = None if answer is None else answer.judged[k]
    shown = np.full_like(part.recorded, np.nan) if prediction is None else prediction.values
    phases = np.full(part.drive.shape, REST) if prediction is None else prediction.phases
    channels = {}
    every = shown - part.recorded
    if judged is not None:
        every = judged.weigh.left(every)
    for c, name in enumerate(part.channels):
        off = every[c]
        simulated = part.recorded[c] + off
        sd = None if judged is None else float(judged.sd[c])
        channels[name] = FittedChannel(unit_of(name), simulated, off, sd)
    band = np.zeros(part.drive.shape)
    if prediction is not None and covariance is not None and part.tips:
        known = np.isfinite(np.diag(covariance))
        slopes = prediction.jacobian[: part.tips, :, known]
        wide = np.sqrt(np.einsum("nkp,pq,nkq->kn", slopes, covariance[np.ix_(known, known)], slopes))
        band = wide.reshape(band.shape)
    noise, chosen = together(part.noises()) if judged is None else judged.noise, {}
    if answer is not None and judged is not None:
        chosen = {
            "samples_simulated": answer.problem.predictors[k].steps,
            "knots_of_base": sum(drive.size for drive in part.drives),
            "samples_per_independent_base": max(drive.tau for drive in part.drives),
            "samples_per_independent": float(judged.weigh.tau[0]),
        }
    config, warnings = part.config, []
    if covariance is not None:
        config, warnings = _fitted_config(setup, k, values, left)
    fitted = FittedRecording(
        name=part.name,
        robot=with_values(part.robot, setup.values_of(k, values)),
        config=config,
        channels=channels,
        T_base=part.drive,
        band=band,
        phases=phases,
        by_phase={} if prediction is None else _by_phase(part, every, phases),
        noise_N=noise.sd_if_known,
        noise_from=noise.source,
        noise_base_N=max((drive.sd for drive in _pulled(part)), default=0.0),
        chi2_per_n=None if judged is None else judged.chi2_per_n,
        outliers=0 if judged is None else int(np.sum(~judged.kept)),
        settings={"robot": part.robot.name, "path": part.path, **chosen},
        unrecorded=None if part.tips else _not_compared(part, prediction),
    )
    return fitted, warnings


def _not_compared(part: Observation, prediction: Prediction | None) -> np.ndarray:
    """The simulated tip tensions of a recording that has none [N], (K, *tendons); NaN without simulation."""
    shape = part.drive.shape
    return np.full(shape, np.nan) if prediction is None else prediction.T_tip.T.reshape(shape)


def summarise(
    setup: Setup,
    answer: Answer,
    iterations: int,
    evaluations: int,
    start: Start,
    fewer: Beaten | None = None,
) -> FitResult:
    """The result of a fit that reached an end, good or bad. `iterations` counts steps of the optimiser,
    `evaluations` simulations of all recordings. An end that a model with `fewer` free numbers beats is not
    counted as one.
    """
    at, descent = answer.at[0], answer.descent
    known, n = answer.known(setup), len(setup.asked)
    values = np.asarray(at.values(descent.u))
    notes = _notes(setup, known, answer, values)
    numbers = setup.numbers(np.asarray(at.reference))
    # A carried number keeps its prior where the recordings say nothing about it.
    every = known._replace(
        covariance=answer.spread(setup), known=known.known | [f.carried for f in setup.free]
    )
    found = estimates(numbers, values, setup.initial, every, notes, answer.sources(setup))
    warnings = [_said(free.name, note) for free, note in zip(setup.free, notes, strict=True) if note]
    warnings += _unknown_axes(setup, answer, known) + _trade_offs(setup, answer, known)
    failure, phases, apart = _failure(setup, answer, fewer), NO_PHASES, NOT_BY_RECORDING
    if failure:
        found = [
            dataclasses.replace(e, sd=None, lower95=None, upper95=None, detectable=None, made_of={})
            for e in found
        ]
    else:
        if known.known[setup.friction()].any():
            phases = mu_by_phase(setup, answer)
        apart = by_recording(setup, answer)
    disagreement = disagreement_of_phases(phases.estimates, phases.apart)
    if disagreement:
        warnings.append(
            disagreement[0].upper() + disagreement[1:] + ": farther apart than their errors allow."
        )
    clauses = [disagreement] if disagreement else []
    if apart.blamed:
        clauses.append(
            f"the recordings disagree: {values_apart(apart.blamed, apart.estimates[apart.blamed])}"
        )
        warnings.append(
            f"The recordings disagree, most likely about {apart.blamed}: find out what differs between them, "
            f"or fit it to each with --per-recording {apart.blamed}."
        )
    left = [e.sd for e in found]
    fitted = [
        _fitted(setup, k, prediction, answer, values, known.covariance, left)
        for k, prediction in enumerate(answer.predictions)
    ]
    recordings = tuple(recording for recording, _ in fitted)
    warnings += [sentence for _, more in fitted for sentence in more]
    for r, judged in zip(recordings, answer.judged, strict=True):
        few = f"samples{f' of {r.name}' if len(recordings) > 1 else ''} lie far off"
        if r.outliers:
            many = r.outliers > FEW * len(r.T_base)
            warnings.append(
                f"{r.outliers} of {len(r.T_base)} {few} and count less than half"
                + (": too many to be outliers, the model lacks something." if many else ".")
            )
        lone = _outliers(judged)
        if lone and not setup.robust:
            warnings.append(
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
        evaluations=evaluations + phases.evaluations + apart.evaluations,
        correlation=correlation(known.covariance[:n, :n]),
        information=answer.information_at(values),
        warnings=warnings,
        verdict=verdict(
            found[:n],
            [_distance(setup, r) for r in zip(recordings, answer.judged, strict=True)],
            disagreement="; ".join(clauses),
            failure=failure,
        ),
        settings=_settings(
            setup,
            samples_simulated=sum(p.steps for p in answer.problem.predictors),
            start=dict(zip(setup.names, np.asarray(at.values(start.u)).tolist(), strict=True)),
            starts_tried=start.tried,
            starts_that_agree=start.agreed,
        ),
        mu_by_phase=phases.estimates,
        by_recording=apart.estimates,
        axes=[
            (axis.words(setup.names[:n], _steps(setup, answer)[:n]), axis.sd)
            for axis in axes(answer.information_about(n))
        ],
    )


def _outliers(judged: Judged) -> int:
    """Number of samples that are far off while most are not; 0 where more than a few are far off."""
    compared = judged.residual[: len(judged.noises) or None]  # the tip tensions, if there are any
    off = np.abs(compared - np.median(compared, axis=1, keepdims=True))
    scale = MAD_TO_SD * np.median(off, axis=1, keepdims=True)
    far = int(np.sum(np.any((off > FAR_OFF * scale) & (scale > 0), axis=0)))
    return far if far <= FEW * off.shape[1] else 0


def _distance(setup: Setup, of: tuple[FittedRecording, Judged]) -> Distance | DistanceWithoutTip:
    fitted, judged = of
    part = next(p for p in setup.parts if p.name == fitted.name)
    if not part.tips:
        return without_tip(part, fitted, judged)
    used = len(setup.free) * len(fitted.T_base) / setup.samples
    degrees = max(len(fitted.T_base) - used, 1) / float(judged.weigh.tau[0])
    others, compared = [], max(len(part.channels) - part.tips, 1)
    for c, name in enumerate(part.channels):
        rms = judged.rms_of(fitted.channels[name].residual)
        if c < part.tips or rms <= SMALL * float(np.ptp(part.recorded[c])):
            continue
        if rms**2 > most_of_noise(part.samples, compared) * float(judged.least[c]) ** 2:
            others.append((name, rms, float(judged.least[c]), unit_of(name)))
    return Distance(
        name=fitted.name,
        rms=judged.rms,
        outliers=fitted.outliers,
        peak=float(np.max(part.recorded[: part.tips])),
        noise=fitted.noise_N,
        chi2=fitted.chi2_per_n,
        degrees=(degrees, judged.noise.degrees),
        table=fitted.by_phase,
        others=others,
    )


def unanswered(
    setup: Setup,
    predictions: tuple[Prediction, ...] | None,
    why: str,
    evaluations: int,
    information: np.ndarray | None = None,
) -> FitResult:
    """The result of a fit that could not begin, or that determines nothing: the robots as they were, no
    intervals, and why. `information` is what the recordings say nonetheless, as of `FitResult`.
    """
    p = len(setup.asked)
    recordings = tuple(
        _fitted(setup, k, None if predictions is None else predictions[k], None, setup.initial, None, ())[0]
        for k in range(len(setup.parts))
    )
    return FitResult(
        recordings=recordings,
        estimates=[
            Estimate(
                name=f.name,
                key=f.entry.key,
                value=v,
                sd=None,
                lower95=None,
                upper95=None,
                initial=v,
                unit=f.entry.unit,
                transform=transform(is_log(f.entry, v)),
                note="not fitted",
            )
            for f, v in zip(setup.asked, setup.initial.tolist(), strict=False)
        ],
        carried=[],
        converged=False,
        result=why,
        iterations=0,
        evaluations=evaluations,
        correlation=np.full((p, p), np.nan),
        information=information,
        warnings=[why[0].upper() + why[1:] + "."],
        verdict=f"No answer: {why}.",
        settings=_settings(setup),
    )
