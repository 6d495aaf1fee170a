"""`fit`: parameters of robots from recordings of base and tip tension."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from calibrate.inference.answer import Answer
from calibrate.inference.channels import ROTATION, known_to, names_of, of_tendons, orientation_of
from calibrate.inference.descent import descend
from calibrate.inference.free import Free, carried_by, distinct, free_of
from calibrate.inference.objective import Objective
from calibrate.inference.posterior import CHAINS, DRAWS, WARM_UP, require_sampler, sample
from calibrate.inference.setup import (
    STRETCH,
    Observation,
    Setup,
    check_columns,
    check_noise,
    check_tension,
    fitted_to,
    recorded,
)
from gtr_jax import InputError, Recording, Robot, RobotConfig, build_robot
from gtr_jax.recordings import base_tension as readings
from gtr_jax.recordings.driving import driven_by
from gtr_jax.robot.parameters import with_values
from gtr_jax.robot.parts import Tendon
from gtr_jax.robot.stiffness import stiffness_of
from gtr_jax.simulation.programs import unmoved_in
from gtr_jax.terms import known_on
from gtr_jax.terms.unmoved import NO_SLIP

from .profiles import profiles
from .result import FitResult
from .start import beaten, candidates, search
from .summary import ignorance, summarise, unanswered

# Slopes of the tip tension below this share of the largest tension are rounding.
NO_SLOPE = 1e-9
# Names of parameters that say how far a tendon stretches begin so.
STRETCHES = (STRETCH, "EA")
# Rounds of fitting and estimating the errors; a robust fit needs more, because its weights change too.
REWEIGHINGS, ROBUST_REWEIGHINGS = 3, 8
# A given noise that is this many times the observed one deserves a warning.
TOO_LARGE = 3.0


def fit(
    robot: RobotConfig | Robot | Sequence[RobotConfig | Robot],
    recording: Recording | Sequence[Recording],
    *,
    free: Sequence[str] | None = None,
    per_recording: Sequence[str] = (),
    per_robot: Sequence[str] = (),
    channels: Sequence[str] | None = None,
    noise_N: float | None = None,
    noise_base_N: float | None = None,
    robust: bool = False,
    max_steps: int = 60,
    profiled: bool = False,
    sampled: bool = False,
    progress: Callable[[str], None] | None = None,
) -> FitResult:
    """Fit parameters of a robot, or of several, to recordings by least squares.

    The true base tension is an unknown like the parameters: straight between as few knots as the noise of the
    recorded one allows (`base_tension/`). Tendons with friction remember extremes, so noise taken for tension
    would bias friction. The cost is the sum of squares of the residuals at the tip and at the base, each in
    units of its noise (`weighing.py`), and of (deviation/standard deviation) of each free parameter under
    [uncertainty] in the robot file, on the scale it is fitted on: logarithmic where positive. Base tensions
    below zero count as slack.

    The tip's position, angle or orientation, the tendon's displacement and the places of the robot's markers
    are fitted as well where a recording has them, with errors scaled to their residuals; they alone, where it
    has no tip tension, which then is simulated but not compared. The zero of the
    displacement is unknown. A tendon of which a recording has no base tension is driven by its displacement,
    which then is what has noise; so is one that displacement drives by the robot file, of which a recorded
    base tension is fitted as well.

    Several recordings share every parameter that is not named in `per_recording` or `per_robot`.

    Every other number that [uncertainty] in the robot file names is fitted as well, with the file's standard
    deviation as its prior (`FitResult.carried`), so that its uncertainty enters the intervals of the free
    ones.

    Standard errors. The covariance is (J'J + P)^-1 at the solution, with J the weighed derivatives by forward
    mode through the solver and P the precision of the priors. The errors are scaled to the residual, be it
    noise or misfit, and K samples count as K/tau, where tau = 1 + 2 sum of the residual's autocorrelations
    (Geyer's initial positive sequence) is the number of samples per independent one. Where the model misses
    physics this measures scatter, not bias: believe the verdict first. Slopes jump where a sample changes
    from locked to slipping, so the errors hold on one side of the jump. A parameter that the data alone leave
    uncertain by a factor of e, or that ran to the end of the range searched, gets no interval.

    Args:
        robot: from `gtr_jax.load_config`; or a `Robot`, whose parameters then have no priors. One for all
            recordings, or one for each, the same object where it is the same robot.
        recording: with T_base, or the displacements of tendons that these drive, and T_tip or anything else
            that can be compared, K >= 4 samples; or several.
        free: parameters to fit, by short name or key of the robot file; unless given, the mu of each tendon
            and E, or mu alone for a rigid sheath.
        per_recording: parameters of which each recording has its own.
        per_robot: parameters of which each robot has its own.
        channels: what is fitted to beside T_tip, where a recording has it: some of tip_x, tip_y, tip_angle,
            displacement, and names of markers; in space tip_x, tip_y, tip_z, tip_rotation, displacement,
            T_base and markers; all unless given. Of several tendons "displacement.left" is the one of left.
        noise_N: standard deviation of the recorded tip tensions [N]; estimated from each recording that has
            them unless given.
        noise_base_N: that of the recorded base tensions [N]; 0 takes them as exact.
        robust: whether samples far off count less (Huber's estimator), and lone spikes of the base tension
            not at all.
        max_steps: steps after which the optimiser gives up.
        profiled: whether profile likelihoods are taken too, some dozen simulations per parameter.
        sampled: whether the posterior is sampled too, by NUTS; minutes. Needs the extra gtr-jax[posterior].
        progress: called with a line of text at each stage.

    Returns:
        The answer. It does not raise where there is none: `converged` is False and `verdict` says why. An end
        that a model with fewer of the free numbers beats is not an answer.

    Raises:
        InputError: unknown or unsuitable parameter, recording too short or with nothing to compare, noise
            not positive, robots that disagree about a shared parameter.
    """
    if sampled:
        require_sampler()
    if noise_N is not None and not (np.isfinite(noise_N) and noise_N > 0):
        raise InputError(f"noise_N: must be a positive number of newtons, is {noise_N:g}")
    if noise_base_N is not None and not (np.isfinite(noise_base_N) and noise_base_N >= 0):
        raise InputError(f"noise_base_N: must be a number of newtons, not below 0, is {noise_base_N:g}")
    free, per_recording, per_robot = map(_listed, (free, per_recording, per_robot))
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    given = [robot] * len(recordings) if isinstance(robot, RobotConfig | Robot) else list(robot)
    if not recordings or len(given) != len(recordings):
        raise InputError(
            f"fit: {len(given)} robots for {len(recordings)} recordings; give one, or one for each"
        )
    warnings: list[str] = []
    unique = list({id(r): r for r in given}.values())
    of = [next(i for i, r in enumerate(unique) if r is wanted) for wanted in given]
    configs = [r if isinstance(r, RobotConfig) else None for r in unique]
    models = [r if isinstance(r, Robot) else build_robot(r) for r in unique]
    if free is None:
        rigid = all(model.backbone.rigid for model in models)
        of_tendons = (
            f"mu.{name}" if name else "mu" for model in models for name in model.tendon_names or ("",)
        )
        stiff = (name for model in models for name in stiffness_of(model))
        free = (*dict.fromkeys(of_tendons), *dict.fromkeys(stiff))
        if rigid:
            warnings.append("E is not fitted: the backbone is rigid, so its stiffness has no effect.")
    for r, own in zip(of, recordings, strict=True):
        check_columns(own, models[r])
    channels = channels_of(channels, recordings, [models[r] for r in of])
    names = distinct([r.path.stem for r in recordings])
    robot_names = distinct([m.name if c is None else c.name for m, c in zip(models, configs, strict=True)])
    wanted = free_of(
        models, configs, of, names, robot_names, free, per_recording=per_recording, per_robot=per_robot
    )
    wanted += carried_by(models, configs, of, robot_names, wanted)
    # Setting a tip force makes a robot a loaded one: once, before anything is compiled.
    prepared = [
        models[r].with_values(**{f.entry.name: models[r].value(f.entry.name) for f in wanted if k in f.parts})
        for k, r in enumerate(of)
    ]
    parts = []
    for k, (name, model, r, rec) in enumerate(zip(names, prepared, of, recordings, strict=True)):
        _check_times(model, rec, wanted)
        _check_laws_can_act(model, configs[r], [f for f in wanted if k in f.parts])
        model, config, more = driven_as_recorded(model, configs[r], rec)
        warnings += more
        part, more = part_of(
            name,
            model,
            config,
            rec,
            channels,
            noise_N=noise_N,
            noise_base_N=noise_base_N,
            robust=robust,
        )
        if sampled and (len(part.pulled) != 1 or part.others):
            raise InputError(
                f"fit: {model.name} has several tendons, or one that displacement drives; the posterior is "
                "sampled for one that tension drives only"
            )
        parts.append(part)
        warnings += more
    check_noise(noise_N, parts)
    for k, part in enumerate(parts):
        if any(k in f.parts and f.entry.name.startswith(STRETCHES) for f in wanted):
            parts[k] = dataclasses.replace(part, stretches=True)
    setup = Setup(
        parts=tuple(parts),
        free=tuple(wanted),
        max_steps=max_steps,
        progress=progress or (lambda _: None),
        profiled=profiled,
        sampled=sampled,
        robust=robust,
    )
    result = _run(setup)
    return dataclasses.replace(result, warnings=[*warnings, *setup.unused_priors, *result.warnings])


def driven_as_recorded(
    model: Robot, config: RobotConfig | None, recording: Recording
) -> tuple[Robot, RobotConfig | None, list[str]]:
    """The robot and its file as a recording drives them, and a sentence for each tendon that displacement
    drives though the file says tension.
    """
    drawn = driven_by(recording, [(tendon.name, tendon.drive) for tendon in model.tendons])
    if not drawn:
        return model, config, []
    tendons = tuple(
        dataclasses.replace(tendon, drive="displacement") if tendon.name in drawn else tendon
        for tendon in model.tendons
    )
    keys = {f"tendons.{name}.drive" if name else "tendon.drive": "displacement" for name in drawn}
    said = [
        f"{recording.path}: has no {'.'.join(filter(None, ('T_base_N', name)))}, so that displacement drives "
        "the tendon."
        for name, drive in ((tendon.name, tendon.drive) for tendon in model.tendons)
        if name in drawn and drive == "tension"
    ]
    changed = None if config is None else config.with_values(keys)
    return dataclasses.replace(model, tendons=tendons), changed, said


def channels_of(
    channels: Sequence[str] | str | None, recordings: Sequence[Recording], robots: Sequence[Robot]
) -> tuple[str, ...] | None:
    """Names of channels that recordings have, from a string with commas between or as they are; None if none
    are given.

    Raises:
        InputError: a name that is not a channel, or that no recording has.
    """
    wanted = _listed(channels)
    have = names_of(recordings, robots)
    for name in wanted or ():
        if name in have:
            continue
        known = dict.fromkeys(one for robot in robots for one in known_to(robot))
        if name not in known:
            raise InputError(f"channels: must be one of {', '.join(known)}; got '{name}'")
        raise InputError(f"channel '{name}': no recording has it; leave it out")
    return wanted


def _listed(names: Sequence[str] | str | None) -> Any:
    """Names from one string with commas between, or as they are."""
    return tuple(n.strip() for n in names.split(",") if n.strip()) if isinstance(names, str) else names


def _check_times(robot: Robot, recording: Recording, wanted: Sequence[Free]) -> None:
    """Raise InputError if the recording has no times although a term that needs them acts or is free."""
    if recording.time is not None:
        return
    free = {term.id for f in wanted if (term := f.entry.term) is not None}
    for term in robot.catalogue.values():
        if term.timed and (term.id in free or known_on(term, robot.terms[term.id])):
            raise InputError(
                f"{recording.path}: has no column time_s, which {term.id} needs; add the times, or leave "
                f"{term.id} out"
            )


def _check_laws_can_act(robot: Robot, config: RobotConfig | None, wanted: Sequence[Free]) -> None:
    """Raise InputError if a law that acts, or a number of which is free, cannot act, because the tendon never
    slips.
    """
    started = with_values(robot, {f.entry.name: f.initial for f in wanted})
    for kind in unmoved_in(started):
        where = "" if config is None else f"{config.source}: "
        raise InputError(f"{where}terms.{kind}: {NO_SLIP}")


def part_of(
    name: str,
    robot: Robot,
    config: RobotConfig | None,
    recording: Recording,
    wanted: Sequence[str] | None,
    *,
    noise_N: float | None = None,
    noise_base_N: float | None = None,
    robust: bool = False,
) -> tuple[Observation, list[str]]:
    """Prepare a recording, with an estimate of its base tension; also return warnings for the reader.

    Args:
        name: of the recording.
        robot, config: what was recorded, and its file.
        recording: with what drives its tendons, and something to compare.
        wanted: channels to compare beside T_tip; all unless given.
        noise_N, noise_base_N, robust: as of `fit`.
    """
    drive, given = recorded(recording, robot)
    kept, warnings = fitted_to(given, wanted, robot, str(recording.path))
    if robot.space and recording.tip_angle is not None:
        warnings.append(
            f"{recording.path}: tip_angle is not fitted to in space; record the quaternion tip_qx to tip_qw."
        )
    channels, values = tuple(kept), np.stack(list(kept.values()))
    drives = []
    columns = drive.reshape(len(drive), -1).T
    tips = [kept.get(name) for name in of_tendons("T_tip", robot)]
    for tendon, pulled, T_tip in zip(robot.tendons, columns, tips, strict=True):
        found, more = _estimated(recording, robot, tendon, pulled, T_tip, noise_base_N, robust=robust)
        drives.append(found)
        warnings += more
    orientation = orientation_of(recording) if ROTATION[0] in channels else None
    part = Observation(
        name=name,
        path=str(recording.path),
        robot=robot,
        config=config,
        T_base=drives[0],
        channels=channels,
        recorded=values,
        time=recording.time,
        trial=recording.trial,
        noise_N=noise_N,
        others=tuple(drives[1:]),
        orientation=orientation,
    )
    return part, warnings


def _estimated(
    recording: Recording,
    robot: Robot,
    tendon: Tendon,
    pulled: np.ndarray,
    T_tip: np.ndarray | None,
    noise_base_N: float | None,
    *,
    robust: bool,
) -> tuple[readings.BaseTension, list[str]]:
    """What truly drives a tendon, a tension or a displacement, from its readings, (K,); and warnings."""
    warnings, tension = [], tendon.drive == "tension"
    what = f"the {'base tension' if tension else 'displacement'}{f' of {tendon.name}' if tendon.name else ''}"
    if tension:
        check_tension(pulled, robot, str(recording.path), tendon)
    else:
        noise_base_N = None
    if robust:
        pulled, spikes = readings.without_spikes(pulled)
        if spikes:
            warnings.append(f"{spikes} lone spikes of {what} in {recording.path} are left out.")
    base = readings.estimate_base(pulled, recording.time, noise_base_N, T_tip)
    if tension:
        base = readings.with_slow_noise(base, pulled, recording.time)
    if noise_base_N is None and base.sd == 0 and readings.is_noisy(pulled):
        remedy = "; give its noise with --noise-base" if tension else ""
        warnings.append(
            f"{recording.path}: {what} jumps about so much that noise cannot be distinguished from "
            f"changes: it is taken as exact, which biases friction if it is noisy{remedy}."
        )
    if noise_base_N:
        seen = readings.estimate_base(pulled, recording.time, tip=T_tip).sd
        if 0 < TOO_LARGE * seen < noise_base_N:
            warnings.append(
                f"The noise given for {what}, {noise_base_N:.3g} N, is far above the {seen:.2g} N "
                "that the recording shows: real changes smaller than it may be taken for noise."
            )
    return base, warnings


def _run(setup: Setup) -> FitResult:
    found = search(setup)
    if found is None:
        return unanswered(
            setup, None, "the simulation fails at every start value tried", len(candidates(setup))
        )
    at, start = found.at, found.u
    problem = Objective.of(setup, at)
    setup.progress("fitting")
    first = problem.predict(start)
    if first is None:
        return unanswered(setup, None, "the simulation fails at the start values", found.evaluations)
    heard = np.zeros(len(setup.free), bool)
    for part, prediction in zip(setup.parts, first, strict=True):
        for c, (row, slope) in enumerate(zip(part.recorded, prediction.jacobian, strict=True)):
            most = np.max(np.abs(slope), axis=0)
            heard |= most > NO_SLOPE * (setup.stiff if c < part.tips else max(float(np.ptp(row)), 1e-6))
    if not heard[: len(setup.asked)].any():
        names = " and ".join(f.name for f in setup.asked)
        tips = [p.T_tip for part, p in zip(setup.parts, first, strict=True) if part.tips]
        still = bool(tips) and all(np.all(np.ptp(T_tip, axis=1) == 0) for T_tip in tips)
        what = "the tip tension does not depend" if tips else "nothing that is compared depends"
        reason = "no slip reaches the tip" if still else f"{what} on it"
        which = "recording says" if len(setup.parts) == 1 else "recordings say"
        why = f"the {which} nothing about {names}: {reason}"
        return unanswered(setup, first, why, found.evaluations + 1)
    weighs = []
    for part, prediction in zip(setup.parts, first, strict=True):
        rms = np.sqrt(np.mean(part.residual(prediction) ** 2, axis=1))
        sd = part.pooled(np.maximum(part.least(part.noises()), rms))
        stretch = part.stretch(prediction.T_tip)
        weighs.append(part.weighing(prediction.slips, prediction.slopes, sd, stretch))
    problem = dataclasses.replace(problem, weighs=tuple(weighs))
    known, iterations, answer, evaluations = first, 0, None, found.evaluations + 1
    for k in range(ROBUST_REWEIGHINGS if setup.robust else REWEIGHINGS):
        # The first round omits the priors of the requested parameters, until it is known how well the model
        # can fit: otherwise the misfit due to a wrong prior passes for noise.
        carried = np.asarray([f.carried for f in setup.free])
        unbiased = dataclasses.replace(problem, precision=np.where(carried, problem.precision, 0.0))
        descent = descend(
            problem if k else unbiased,
            start,
            active=heard,
            known=known,
            max_steps=setup.max_steps,
            progress=setup.progress,
        )
        iterations += descent.iterations
        evaluations += descent.evaluations
        # Tip, base and priors are weighed by the errors that the data turn out to have.
        answer = Answer.of(setup, at, problem, descent)
        problem = answer.problem
        if descent.converged:
            start, known = descent.u, answer.predictions
        elif k:
            break
    assert answer is not None
    unknown = ignorance(setup, answer)
    if unknown:
        as_given = np.where(np.asarray(at[0].log), np.maximum(setup.initial, 1e-9), setup.initial)
        there = problem.predict(at[0].at(as_given))
        said = answer.information_at(as_given, there)
        return unanswered(setup, there, unknown, evaluations, said)
    fewer, more = beaten(setup, problem, problem.cost(answer.descent.u, answer.predictions), found)
    result = summarise(setup, answer, iterations, evaluations + more, found, fewer)
    if not result.converged:
        return result
    if setup.sampled:
        result = _sampled(setup, answer, result)
    if not setup.profiled:
        return result
    more = profiles(setup, answer)
    return dataclasses.replace(
        result,
        profiles=more.of,
        evaluations=result.evaluations + more.evaluations,
        warnings=[*result.warnings, *more.warnings],
    )


def _sampled(setup: Setup, answer: Answer, result: FitResult) -> FitResult:
    """The result with draws from its posterior."""
    setup.progress(f"sampling the posterior: {CHAINS} chains of {WARM_UP} steps to settle and {DRAWS} draws")
    found, warning = None, ""
    try:
        found = sample(setup, answer)
    except KeyboardInterrupt:
        warning = "Interrupted while sampling the posterior: the fit is complete without it."
    else:
        if found is None:
            warning = "The posterior is not sampled: the recordings do not determine every parameter."
        elif not found.converged:
            warning = (
                f"The chains of the posterior do not agree (R-hat up to {np.max(found.rhat):.3f}, "
                f"{found.divergences} divergences): do not use its intervals."
            )
    warnings = [*result.warnings, warning] if warning else result.warnings
    return dataclasses.replace(result, posterior=found, warnings=warnings)
