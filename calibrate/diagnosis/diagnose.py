"""`diagnose`: which physics a robot's model leaves out, told from recordings."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gtr_jax import InputError, Recording, Robot, RobotConfig, build_robot, simulate

from ..base_tension import BEND, sharpened
from ..fit import channels_of, part_of
from ..free import distinct
from ..number import Number, values_in
from ..parallel import in_parallel
from ..predictor import CHANNELS
from ..setup import Part, recorded
from .bench import Bench, passing
from .cache import SimulationCache
from .decide import Decision, decide, with_unseen
from .differ import MOST as MOST_DIFFER
from .differ import Difference, differing, names_to_split, still_differ
from .experiment import Experiment, propose
from .follow import dimensions_of
from .heldout import held_out
from .hypotheses import Hypothesis, base_numbers, catalogue
from .locate import cycles_of, locate, mu_by_stratum, phases_of, ratio_of_branches
from .marginal import Marginal, jointly
from .model import Fitted, model_of
from .result import BAD_DATA, Diagnosis, Loop, Rival
from .rig import Rig, resolution_of, some_samples
from .sanity import faults
from .search import (
    SHORTLIST,
    STARTS_EACH,
    WORTH,
    Models,
    Screened,
    base_fit,
    combine,
    firm_fit,
    merged,
    refit_best,
    screen,
)

# Samples of each recording on which hypotheses are tried, and on which the best are refitted.
FEW, MANY = 140, 1200
# Samples of each recording on which hypotheses are tried where there are several: together they tell more.
FEW_OF_SEVERAL = 96
# Models that are refitted to all samples.
FINAL, REFINED = 4, 3
# Resolution of the mesh that they are corrected to.
FINEST = 1.5


@dataclasses.dataclass(frozen=True, eq=False)
class Prepared:
    """What the search starts from.

    Attributes:
        config: the robot file, or None.
        fine: the robot on its own mesh.
        parts, full: the recordings, and those samples of them that are used.
        kept: those of them on the bench.
        warnings: what the reader must know.
        bench: few samples on a coarse mesh.
        rough, exact: all samples on the coarse mesh, and on a fine one.
        base: fit of the base model.
        hypotheses: what may be missing.
        differ: the numbers that differ between the recordings.
    """

    config: RobotConfig | None
    fine: Robot
    parts: list[Part]
    full: list[Part]
    kept: list[np.ndarray]
    warnings: list[str]
    bench: Bench
    rough: list[Rig]
    exact: list[Rig]
    base: Fitted
    hypotheses: list[Hypothesis]
    differ: list[Difference] = dataclasses.field(default_factory=list)


def diagnose(
    robot: RobotConfig | Robot,
    recording: Recording | Sequence[Recording],
    *,
    channels: Sequence[str] | str | None = None,
    noise_N: float | None = None,
    noise_base_N: float | None = None,
    experiment: bool | None = None,
    steps: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Tell which physics a model leaves out of recordings.

    The base model (mu and, unless the backbone is rigid, E) is fitted; every term of the catalogue is tried
    beside it at finite sizes; the most promising are refitted with mu and E, alone and up to three together;
    what is more probable than nothing by its evidence (Laplace's approximation, with a prior for every number
    and for how many effects there are) is named, or the set of rivals that the data do not tell apart, or,
    where structure is left that no term explains, nothing. What is named is refitted to part of the samples
    and judged on the rest.

    Args:
        robot: from `gtr_jax.load_config`; or a `Robot`, whose mu and E then have no priors.
        recording: with T_base and T_tip, 20 samples or more; or several of the same robot.
        channels: what is compared beside T_tip, where a recording has it: some of tip_x, tip_y, tip_angle,
            displacement; all unless given.
        noise_N, noise_base_N: standard deviations of the recorded tensions [N]; estimated unless given.
        experiment: whether to propose the experiment that separates the rivals; only where there are some,
            unless given.
        steps: file that keeps what is done, so that the same call goes on from there if it is interrupted, or
            fails while the answer is written; delete it once that is safe.
        progress: called with a line of text at each stage.

    Returns:
        The diagnosis. Data that cannot be diagnosed give the verdict "bad-data", and why.

    Raises:
        InputError: a recording without tip tension or too short, a robot of several tendons.
    """
    say = progress or (lambda _: None)
    cache = None if steps is None else SimulationCache(steps)
    try:
        for may_differ in (True, False):
            ready = prepare(
                robot, recording, channels, noise_N, noise_base_N, say, cache, may_differ=may_differ
            )
            if isinstance(ready, Diagnosis):
                return ready
            found = _search(ready, experiment, say)
            if found is not None:
                return found
            say("with what was found the recordings agree: trying again with one value for all")
        raise AssertionError("a search in which nothing differs has an answer")
    finally:
        if cache is not None:
            cache.close()


def _search(ready: Prepared, experiment: bool | None, say: Callable[[str], None]) -> Diagnosis | None:
    """The answer; None where recordings do not differ any more once there is what was found."""
    bench, base, hypotheses = ready.bench, ready.base, ready.hypotheses
    models = Models(bench, hypotheses)
    models.add([base])
    say(f"trying {len(hypotheses)} hypotheses")
    screened = screen(bench, base, hypotheses)
    firm = firm_fit(bench, base)
    if firm is not None:
        screened = merged(screened, screen(bench, firm, hypotheses, reference=base.cost))
    short = [s for s in screened if s.gain > WORTH][:SHORTLIST]
    if short:
        say(f"refitting the {len(short)} most promising")
        models.add(refit_best(bench, (), base, short, STARTS_EACH))
        # What the coarse mesh, and the fewer samples, leave out of an effect would pass for a second one.
        top = [f for f in models.ranked() if f.names][:REFINED]
        _refine(bench, models, {f.names: f for f in top}, ready.exact, ready.kept)
        models.reweigh()
        combine(models, say)
    say("refitting the best to all samples, on a fine mesh")
    whole = _on_all(models, ready.rough, ready.exact)
    if whole is None:
        return Diagnosis.without_answer(
            BAD_DATA, ["the simulation fails"], ready.parts, ready.warnings, ready.config
        )
    decision = with_unseen(decide(whole), whole, screened)
    chosen = decision.chosen
    if ready.differ and chosen.names and decision.verdict != "unexplained":
        if not still_differ(whole.bench, chosen, whole.hypotheses(chosen.names), ready.differ):
            return None
    say("refitting to part of the samples")
    return _answer(ready, decision, whole, screened, experiment=experiment, say=say)


def prepare(
    robot: RobotConfig | Robot,
    recording: Recording | Sequence[Recording],
    channels: Sequence[str] | str | None = None,
    noise_N: float | None = None,
    noise_base_N: float | None = None,
    say: Callable[[str], None] = lambda _: None,
    cache: SimulationCache | None = None,
    *,
    may_differ: bool = True,
) -> Prepared | Diagnosis:
    """Read the recordings, fit the base model, ask whether a number differs between them, and list what may
    be missing; arguments as of `diagnose`.

    Args:
        may_differ: whether that is asked.

    Returns:
        What the search starts from; a diagnosis where the data do not allow one.
    """
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    if not recordings:
        raise InputError("diagnose: no recording is given")
    channels = channels_of(channels, recordings)
    config = robot if isinstance(robot, RobotConfig) else None
    fine = build_robot(robot) if isinstance(robot, RobotConfig) else robot
    if fine.tendon_names:
        raise InputError(
            f"diagnose: {fine.name} has {len(fine.tendons)} tendons; this version diagnoses one tendon; take "
            "the others out of the robot file"
        )
    warnings: list[str] = []
    names = distinct([r.path.stem for r in recordings])
    parts: list[Part] = []
    for name, r in zip(names, recordings, strict=True):
        part, more = part_of(name, fine, config, r, channels, noise_N=noise_N, noise_base_N=noise_base_N)
        parts.append(part)
        warnings += more
    found = [fault for part in parts for fault in faults(part)]
    if found:
        return Diagnosis.without_answer(BAD_DATA, found, parts, warnings, config)
    coarse = build_robot(config, resolution=resolution_of(fine)) if config else fine
    finest = build_robot(config, resolution=FINEST) if config else fine
    deviations = deviations_of(config)
    dimensions = dimensions_of(config, fine)
    several = len(parts) > 1
    free = [*(d.name for d in dimensions), *(names_to_split(dimensions) if several else [])]

    def fitted(
        parts: list[Part],
        start: np.ndarray | None,
        numbers: tuple[Number, ...] = base_numbers(fine, deviations),
        dimensions: Sequence[Number] = dimensions,
    ) -> _Start | None:
        """Recordings on the bench, and the base model fitted to them; None if that fails."""
        full = [part if part.samples <= MANY else part.only(some_samples(part, MANY)) for part in parts]
        kept = [some_samples(part, FEW_OF_SEVERAL if several else FEW) for part in full]
        small = [p if len(k) == p.samples else p.only(k) for p, k in zip(full, kept, strict=True)]
        rigs = [Rig(p, coarse, free, cache) for p in small]
        bench = Bench(rigs, numbers, dimensions)
        base = base_fit(bench, start)
        if base is None:
            return None
        exact = [Rig(p, finest, free, cache) for p in full]
        _refine(bench, Models(bench, ()), {(): base}, exact, kept)
        base = base_fit(bench, base.x)
        return None if base is None else _Start(full, kept, bench, exact, base)

    say("fitting mu" if fine.backbone.rigid else "fitting mu and E")
    start = fitted(parts, None)
    differ: list[Difference] = []
    while start is not None and may_differ and several and len(differ) < MOST_DIFFER:
        say("asking whether one number differs between the recordings")
        found_split = differing(start.bench, start.base, fine, hypotheses_of(fine, start.base, start.full))
        if found_split is None:
            break
        numbers, left, at, difference = found_split
        again = fitted(parts, at, numbers, left)
        if again is None:
            break
        start, differ = again, [*differ, difference]
    if start is not None:
        sharper = _sharpened(start, [recorded(r)[0] for r in recordings])
        if sharper is not None:
            say("fitting again, the base tension's corners put where the tip tells")
            again = fitted(sharper, start.base.x, start.bench.base, start.bench.dimensions)
            start = again if again is not None and _worth(start, again) else start
    if start is None:
        return Diagnosis.without_answer(
            BAD_DATA, ["the simulation fails at every start value tried"], parts, warnings, config
        )
    full, kept, bench, exact, base = start
    own = {n.parameter for n in base.numbers}
    hypotheses = [
        h for h in hypotheses_of(fine, base, full) if not own & {*h.fixed, *(n.name for n in h.numbers)}
    ]
    return Prepared(
        config,
        fine,
        parts,
        full,
        kept,
        warnings,
        bench,
        [Rig(p, coarse, free, cache) for p in full],
        exact,
        base,
        hypotheses,
        differ,
    )


class _Start(NamedTuple):
    """Recordings on the bench: all their samples, those on the bench, the bench, all on a fine mesh, and the
    base model fitted.
    """

    full: list[Part]
    kept: list[np.ndarray]
    bench: Bench
    exact: list[Rig]
    base: Fitted


def _worth(before: _Start, after: _Start) -> bool:
    """Whether corners of the base tension that were added take enough of the misfit away, noise as before."""
    own, values = after.bench.noise, after.base.values
    seen = after.bench.simulate(values)
    if seen is None:
        return False
    after.bench.weigh(values, seen, before.bench.noise)
    squares = float(np.sum(after.bench.rows(seen) ** 2))
    after.bench.weigh(values, seen, own)
    sizes = [sum(rig.part.T_base.size for rig in s.bench.rigs) for s in (before, after)]
    return before.base.chi2 - squares > BEND * max(sizes[1] - sizes[0], 1)


def _sharpened(start: _Start, readings: Sequence[np.ndarray]) -> list[Part] | None:
    """The recordings with corners of the base tension where all channels together put them: a noisy base
    cell alone misses small steps and turns that the tip follows. None where the cell tells more.

    Args:
        start: the base model fitted.
        readings: base tension of each recording as recorded [N], (K,).
    """
    found, changed = [], False
    values = dict(start.base.values) | dict(start.base.dimensions)
    for part, rig, noise, read in zip(start.full, start.exact, start.bench.noise, readings, strict=True):
        base, here = part.T_base, rig(values)
        found.append(part)
        if base.sd == 0 or here is None or part.samples != len(read):
            continue
        weigh = passing(rig, here, noise, values)
        own = (weigh.last == np.arange(part.samples)) * weigh.slope * weigh.weight**2
        told, residual = (
            np.sum(own * weigh.slope, axis=0),
            weigh.centred(here.values[part.where] - part.recorded),
        )
        cell = base.sd**-2
        if np.median(told) < cell:
            continue
        shift = (cell * (read - base.T_base) - np.sum(own * residual, axis=0)) / (told + cell)
        informed = told > cell
        sd = float(np.sqrt(np.mean(1 / (told + cell)[informed])))
        sharper = sharpened(base, read, base.T_base + np.where(informed, shift, 0.0), sd)
        changed = changed or sharper is not base
        found[-1] = dataclasses.replace(part, T_base=sharper)
    return found if changed else None


def deviations_of(config: RobotConfig | None) -> dict[str, float]:
    """Standard deviations of ln mu and ln E that the robot file states."""
    if config is None:
        return {}
    found, values = {}, config.numbers()
    for name, key in (("mu", "tendon.friction_coefficient"), ("E", "backbone.youngs_modulus")):
        sd = config.deviation(key)
        if sd:
            found[name] = float(np.log1p(sd / abs(values[key])))
    return found


def hypotheses_of(fine: Robot, base: Fitted, parts: Sequence[Part]) -> list[Hypothesis]:
    """What may be missing in these recordings, given a fit of the base model."""
    tip_y = np.concatenate([seen.values[CHANNELS.index("tip_y")] for seen in base.seen])
    return catalogue(
        fine,
        timed=all(p.time is not None for p in parts),
        largest_tip=max(float(np.max(p.T_tip)) for p in parts),
        travel=np.asarray([tip_y.min(), tip_y.max()]),
        bend=_bend(fine, base, parts[0]),
    )


def _bend(fine: Robot, fitted: Fitted, part: Part) -> float:
    values = values_in(fitted.values, part.name)
    own = {name: values[name] for name in ("mu", "E") if name in values}
    top = np.asarray([0.0, float(part.T_base.T_base.max())])
    run = simulate(fine.with_values(**own), top, with_terms=False)
    return float(np.max(np.abs(run.curvature[-1] - run.curvature[0])))


def _refine(
    bench: Bench,
    models: Models,
    wanted: Mapping[tuple[str, ...], Fitted],
    fine: Sequence[Rig],
    kept: Sequence[np.ndarray] | None = None,
) -> None:
    """Correct a bench for what its mesh and samples leave out of some models.

    Args:
        bench: to correct.
        models: of which they are.
        wanted: by names of hypotheses, a fit that has the values of these.
        fine: all samples, on a fine mesh.
        kept: those of them on the bench; all unless given.
    """

    def correction(item):
        names, f = item
        values = model_of(bench.base, models.hypotheses(names)).values(models.coordinates(names, f))
        found = []
        for k, (rough, exact) in enumerate(zip(bench.rigs, fine, strict=True)):
            here, there = rough(values), exact(values)
            if here is None or there is None:
                return None
            found.append((there.values if kept is None else there.values[:, kept[k]]) - here.values)
        return found

    for names, more in zip(wanted, in_parallel(correction, list(wanted.items())), strict=True):
        if more is not None:
            bench.corrections[tuple(sorted(names))] = more


def _on_all(models: Models, rigs: list[Rig], fine: list[Rig]) -> Models | None:
    """The most probable models, and the base model, refitted to all samples; None if that fails."""
    bench = Bench(rigs, models.bench.base, models.bench.dimensions)
    whole = Models(bench, list(models.of.values()))
    ranked = models.ranked()
    wanted: dict[tuple[str, ...], Fitted] = {(): models.base}
    for f in [f for f in ranked if f.names][:FINAL]:
        wanted[f.names] = f
        # What fewer samples need two effects for may need one on all of them.
        for name in f.names:
            wanted[(name,)] = models.fits.get((name,), f)
    _refine(bench, whole, wanted, fine)
    top = ranked[0]
    seen = bench.simulate(top.values, top.names)
    if seen is None:
        return None
    bench.weigh(top.values, seen)
    if bench.dimensions:  # what they do must not pass for noise
        first = bench.refit(whole.hypotheses(top.names), whole.coordinates(top.names, top), most=4)
        if first is not None:
            bench.weigh(first.values, first.seen)

    def refit(item):
        names, f = item
        return bench.refit(whole.hypotheses(names), whole.coordinates(names, f), most=4)

    whole.add([f for f in in_parallel(refit, list(wanted.items())) if f is not None])
    return whole if () in whole.fits else None


def _answer(
    ready: Prepared,
    decision: Decision,
    models: Models,
    screened: Sequence[Screened],
    *,
    experiment: bool | None,
    say: Callable[[str], None],
) -> Diagnosis:
    bench, base, chosen = models.bench, models.base, decision.chosen
    compared = [base] if not chosen.names else [base, chosen]
    say("fitting all that is uncertain together")
    finer = sum(ready.exact[0].robot.intervals) / sum(ready.rough[0].robot.intervals)
    before = jointly(models, base, finer)
    after = jointly(models, chosen, finer) if chosen.names else before
    refitted: dict[tuple[str, ...], Marginal] = {}
    if len(decision.confusion) > 1:
        say("fitting the rivals likewise")
        for names in decision.confusion:
            own = models.fits[tuple(sorted(names))]
            refitted[own.names] = after if own is chosen else jointly(models, own, finer)
    scores = held_out(bench, [(models.hypotheses(f.names), f) for f in compared])
    wanted = decision.verdict == "ambiguous" if experiment is None else experiment
    proposal: Experiment | None = None
    if wanted and chosen.names:
        say("looking for the experiment that would decide")
        proposal = propose(models, decision, bench.rigs[0])
    loops = []
    for k, part in enumerate(ready.full):
        plain, shown = (m.fitted.seen[k].values[part.where] for m in (before, after))
        phases = phases_of(bench, before.fitted, k)
        T = part.T_base.T_base
        loops.append(
            Loop(
                part.name,
                part.channels,
                part.time,
                T,
                part.recorded,
                plain,
                shown,
                phases,
                cycles_of(T),
                [ratio_of_branches(T, tip, phases) for tip in (part.T_tip, plain[0], shown[0])],
                float(bench.noise[k][0].sd),
                float(part.T_base.sd),
            )
        )
    probability = decision.probability
    rivals = [
        Rival(
            f.names,
            probability[f.names],
            float(np.sqrt(max(base.chi2 - f.chi2, 0.0))),
            bench.mean_square(f),
            dict(f.values),
            f.failed,
            models.log_posterior(f),
        )
        for f in models.ranked()
    ]
    return Diagnosis.of(
        decision,
        models,
        screened,
        before=before,
        after=after,
        refitted=refitted,
        where=locate(bench, before.fitted),
        rest=locate(bench, after.fitted),
        strata=mu_by_stratum(before.bench, before.fitted, before.covariance),
        held=scores,
        loops=loops,
        rivals=rivals,
        experiment=proposal,
        parts=ready.parts,
        config=ready.config,
        fine=ready.fine,
        differ=ready.differ,
        warnings=ready.warnings,
    )
