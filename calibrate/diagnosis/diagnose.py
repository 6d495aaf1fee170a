"""`diagnose`: find from recordings which physics a robot's model leaves out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from calibrate.inference.instruments import of_one, tendon_of_channel
from calibrate.inference.side_by_side import in_lanes
from calibrate.inference.simulated_rig import SimulatedRig
from calibrate.inference.simulation_cache import SimulationCache
from calibrate.planning.proposal import Experiment, propose
from gtr_jax import Recording, Robot, RobotConfig

from .answer.gathered import gathered
from .answer.loop import Loop, Pull
from .answer.result import BAD_DATA, Diagnosis, Rival
from .base.load import names_of
from .base.prepare import Prepared, Undiagnosable, prepare
from .decision.decide import (
    Decision,
    decide,
    decide_discovered,
    decide_extended,
    narrowed,
    with_unseen,
)
from .decision.rivals import rivals_of
from .decision.verdict import AMBIGUOUS, DISCOVERED, PARTLY, UNEXPLAINED
from .evidence.averaged import averaged
from .evidence.marginal import Marginal, jointly
from .evidence.models import HOW_MANY, Models
from .evidence.refine import refine
from .hypotheses.hypotheses import EVENTS, INSTRUMENT_NUMBERS, Hypothesis, of_single_tendons
from .hypotheses.model import Fitted
from .laws.discovery import Discovery, discover
from .likelihood.held_out import held_out
from .likelihood.likelihood import Likelihood
from .likelihood.locate import cycles_in, locate, mu_by_stratum, phases_of, ratio_of_branches
from .likelihood.structure import structured
from .outside.episodes import episodes
from .outside.leave_out import Stretch, asked_for, from_outside, left_out, where_still
from .screening.pairs import promising
from .screening.screen import STARTS_EACH, Screened, firm_fit, merged, screen
from .search.differ import still_differ
from .search.forward_search import beaten, forward_search
from .search.search import PAIRS, SHORTLIST, WORTH, combine, refit_best
from .search.twins import SETTLED, settled_with_twins

# Number of best models that are refitted to all samples, and that are corrected to a fine mesh before.
FINAL, REFINED = 6, 3
# Answers, at most, in each of which more readings of one recording that stand still are left out; one more
# for each other recording.
STILL_ROUNDS = 3
# Most promising effects that are tried on each of several tendons alone, beside those of the cells.
OF_TENDONS = 3


def diagnose(
    robot: RobotConfig | Robot,
    recording: Recording | Sequence[Recording],
    *,
    channels: Sequence[str] | str | None = None,
    noise_N: float | None = None,
    noise_base_N: float | None = None,
    experiment: bool | None = None,
    exclude: Sequence[tuple[float, float]] = (),
    without: Sequence[str] = (),
    steps: Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find from recordings which physics a model leaves out.

    The base model (mu of each tendon and, unless the backbone is rigid, E) is fitted, and every term of the
    catalogue is tried beside it at finite sizes. The most promising terms are refitted with it, alone and up
    to three together. Models are compared by their evidence (Laplace's approximation, with a prior for every
    number and for how many effects there are). The verdict names an effect that is more probable than
    nothing, or the set of rivals that the data do not tell apart. Where structure is left that no term
    explains, a law that no catalogue holds is looked for; if none predicts unseen samples, nothing is named.
    The model that is named is refitted to part of the samples and judged on the rest.

    Args:
        robot: from `gtr_jax.load_config`; or a `Robot`, whose mu and E then have no priors.
        recording: with T_base, or the displacements of tendons that these drive, and T_tip or what else shows
            the robot (pose, markers, angles, displacements), all of them T_tip or none; 20 samples or
            more; or several of the same robot.
        channels: what is compared beside T_tip, where a recording has it; as of `calibrate.fit`.
        noise_N: standard deviation of recorded tip tensions [N]; estimated unless given.
        noise_base_N: standard deviation of recorded base tensions [N]; estimated unless given.
        experiment: whether to propose the experiment that separates the rivals; only where the verdict is
            "ambiguous", unless given.
        exclude: stretches of time [s] that are simulated and not compared.
        without: names of physics terms that are not tried.
        steps: file that keeps finished simulations, so that the same call resumes from there if it is
            interrupted, or fails while the answer is written; delete it once the answer is safe.
        progress: called with a line of text at each stage.

    Returns:
        The diagnosis. Data that cannot be diagnosed give the verdict "bad-data", and why.

    Raises:
        InputError: a recording without tip tension or too short, a rigid sheath of several tendons, an
            unknown term.
    """
    say = progress or (lambda _: None)
    cache = None if steps is None else SimulationCache(steps)
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    own = dict(zip(names_of(recordings), recordings, strict=True))
    leave_out = asked_for(own, exclude)

    def answer() -> tuple[Diagnosis, Prepared | None]:
        for may_differ in (True, False):
            ready = prepare(
                robot,
                recordings,
                channels,
                noise_N,
                noise_base_N,
                say,
                cache,
                may_differ=may_differ,
                leave_out=leave_out,
                untried=without,
            )
            if isinstance(ready, Undiagnosable):
                return Diagnosis.without_answer(BAD_DATA, *ready), None
            found = _search(ready, ready.leave_out, experiment, say)
            if found is not None:
                return found, ready
            say("with what was found the recordings agree: trying again with one value for all")
        raise AssertionError("a search in which nothing differs has an answer")

    try:
        found, ready = answer()
        samples = {name: len(r) for name, r in own.items()}
        if found.verdict == PARTLY and ready and not ready.likelihood.rules.looks_outside:
            more = from_outside(found.episodes, samples, leave_out, _events(found))
            if more is not None:
                say("leaving out the episodes in which something outside the model acts, and trying again")
                leave_out = more
                again, _ = answer()
                found = again if _leaves_less(again, found) else found
        for _ in range(STILL_ROUNDS + len(recordings) - 1):
            still = where_still(found.pattern, samples, leave_out)
            if found.verdict != UNEXPLAINED or still is None:
                break
            say("leaving out readings that stand still, and trying again")
            leave_out = still
            again, _ = answer()
            if not _leaves_less(again, found):
                break
            found = again
        return found
    finally:
        if cache is not None:
            cache.close()


def _events(found: Diagnosis) -> list[tuple[float, float]]:
    """Beginning and end of the events of the model that is shown [s]."""
    if found.loops[0].time is None:
        return []
    return _events_of({c.name: c.after for c in found.parameters}, float(found.loops[0].time[0]))


def _events_of(values: Mapping[str, float | None], begun: float) -> list[tuple[float, float]]:
    """Beginning and end of the events among the numbers of a model of a recording that begins at a time, with
    their duration to each side [s].
    """
    times = []
    for kind in EVENTS:
        at, lasts = values.get(f"{kind}.time"), values.get(f"{kind}.duration") or 0.0
        if at is not None:
            times.append((begun + at - lasts, begun + at + 2 * lasts))
    return times


def _leaves_less(again: Diagnosis, found: Diagnosis) -> bool:
    """Whether a second answer fits the samples that both compare better than the first."""
    if not again.loops:
        return False
    squares = [
        sum(
            float(np.sum((one.after - one.recorded)[: one.explained, other.counted & one.counted] ** 2))
            for one, other in zip(mine.loops, others.loops, strict=True)
        )
        for mine, others in ((again, found), (found, again))
    ]
    return squares[0] < squares[1]


def _search(
    ready: Prepared,
    leave_out: Mapping[str, Sequence[Stretch]],
    experiment: bool | None,
    say: Callable[[str], None],
) -> Diagnosis | None:
    """The answer; None if the recordings no longer differ once the model has the effects that were found."""
    likelihood, base, hypotheses = ready.likelihood, ready.base, ready.hypotheses
    models = Models(likelihood, hypotheses)
    models.add([base])
    say(f"trying {len(hypotheses)} hypotheses")
    screened = screen(likelihood, base, hypotheses)
    if single := of_single_tendons(likelihood.rigs[0].robot, _on_tendons(likelihood, screened)):
        say("trying cells and the most promising on single tendons")
        models.of |= {h.name: h for h in single}
        hypotheses = [*hypotheses, *single]
        screened = sorted([*screened, *screen(likelihood, base, single)], key=lambda s: -s.gain)
    pairs = promising(base, screened, PAIRS)
    firm = firm_fit(likelihood, base)
    if firm is not None:
        screened = merged(screened, screen(likelihood, firm, hypotheses, reference=base.cost))
    short = [s for s in screened if s.gain > WORTH][:SHORTLIST]
    if short:
        say(f"refitting the {len(short)} most promising")
        models.add(refit_best(likelihood, (), base, short, STARTS_EACH))
        # Errors of the coarse mesh and of the fewer samples would pass for a second effect.
        top = [f for f in models.ranked() if f.names][:REFINED]
        models.likelihood = refine(likelihood, models, {f.names: f for f in top}, ready.exact, ready.kept)
        models.reweigh()
        combine(models, pairs, say)
    say("refitting the best to all samples, on a fine mesh")
    found = _decided(models, ready, say)
    if found is None:
        return Diagnosis.without_answer(
            BAD_DATA, ["the simulation fails"], ready.parts, ready.warnings, ready.config
        )
    whole, decision = found
    outside = _outside(ready, whole, decision.chosen, leave_out)
    if outside is not None:
        say("leaving out the episodes in which something outside the model acts")
        less = ready.without(outside)
        again = _decided(whole, less, say, decision.chosen)
        if again is not None:
            ready, leave_out, (whole, decision) = less, outside, again
    discovery = _discovered(whole, decision, say)
    if discovery is not None:
        whole, decision = discovery.models, decide_discovered(discovery.models, discovery)
    decision = with_unseen(decision, whole, screened)
    chosen = decision.chosen
    if ready.differ and chosen.names and decision.verdict != UNEXPLAINED:
        if not still_differ(whole.likelihood, chosen, whole.hypotheses(chosen.names), ready.differ):
            return None
    say("refitting to part of the samples")
    return _answer(
        ready, leave_out, decision, whole, screened, discovery=discovery, experiment=experiment, say=say
    )


def _on_tendons(likelihood: Likelihood, screened: Sequence[Screened]) -> list[Hypothesis]:
    """The effects that are tried on single tendons: those of the cells, which cost little because the robot
    need not be simulated again, and the most promising others.
    """
    known = likelihood.rigs[0].robot.catalogue
    cells = [s.hypothesis for s in screened if known[s.hypothesis.kind].of_cells]
    others = [s for s in screened if not known[s.hypothesis.kind].of_cells and s.gain > WORTH]
    return [*cells, *(s.hypothesis for s in others[:OF_TENDONS])]


def _discovered(models: Models, decision: Decision, say: Callable[[str], None]) -> Discovery | None:
    """A law that explains structure which no effect of the catalogue does; None if there is none.

    It is looked for in recordings of one tendon in the plane that tension drives, whose readings do not stand
    still, beside the base model, and if none is found, beside the effects that explain a part of the misfit:
    these may only imitate it. Of a long recording, which lacks several things as a rule, it is looked for
    beside what explains a part alone.
    """
    robot = models.likelihood.rigs[0].robot
    stands = decision.pattern is not None and decision.pattern.stands
    if decision.verdict not in (UNEXPLAINED, PARTLY) or stands:
        return None
    if robot.space or robot.tendon_names or robot.tendon.drive != "tension":
        return None
    heads = [decision.chosen] if decision.verdict == PARTLY else []
    if models.likelihood.rules.laws_beside_the_base or not heads:
        heads = [models.base, *heads]
    room = (head for head in heads if len(head.names) + 1 < len(HOW_MANY))
    return next((found for head in room if (found := discover(models, head, say)) is not None), None)


def _decided(
    models: Models, ready: Prepared, say: Callable[[str], None], head: Fitted | None = None
) -> tuple[Models, Decision] | None:
    """The models refitted to all samples, and the verdict; None where that fails.

    Args:
        models: all that were refitted.
        ready: the recordings.
        head: the model to show where structure is left beyond any; looked for unless given.
    """
    whole = _on_all(models, ready.rough, ready.exact, [] if head is None else [head])
    if whole is None:
        return None
    known = None if head is None else whole.fits.get(tuple(sorted(head.names)))
    top = known or whole.ranked()[0]
    settled_with_twins(whole, top)
    decision = decide(whole)
    if structured(decision.left) and decision.pattern is None:
        best = forward_search(whole, decision.chosen, say) if known is None else whole.stored(known)
        decision = decide_extended(whole, best, decision)
    if whole.likelihood.rules.unseen_narrow:
        # Long recordings have cycles enough to tell by.
        decision = narrowed(whole, decision, beaten(whole, decision.chosen, decision.confusion))
    return whole, decision


def _outside(
    ready: Prepared, models: Models, chosen: Fitted, known: Mapping[str, Sequence[Stretch]]
) -> dict[str, list[Stretch]] | None:
    """What is left out once a model is found: where something outside it acts, in a recording in which rows
    far off count less; None where that is nothing.
    """
    time = ready.parts[0].time
    if not models.likelihood.rules.looks_outside or time is None:
        return None
    samples = {part.name: part.samples for part in ready.parts}
    events = _events_of(chosen.values, float(time[0]))
    return from_outside(episodes(models.likelihood, chosen), samples, known, events)


def _on_all(
    models: Models, rigs: list[SimulatedRig], fine: list[SimulatedRig], more: Sequence[Fitted] = ()
) -> Models | None:
    """The most probable models, and the base model, refitted to all samples; None if that fails."""
    few = models.likelihood
    likelihood = Likelihood(
        rigs=tuple(rigs), base=few.base, dimensions=few.dimensions, rules=few.rules, untried=few.untried
    )
    whole = Models(likelihood, list(models.of.values()))
    ranked = models.ranked()
    wanted: dict[tuple[str, ...], Fitted] = {(): models.base}
    for f in [*[f for f in ranked if f.names][:FINAL], *(f for f in more if f.names)]:
        wanted[f.names] = f
        # Where few samples need two effects, all samples may need only one.
        for name in f.names:
            wanted[(name,)] = models.fits.get((name,), f)
    likelihood = refine(likelihood, whole, wanted, fine)
    top = ranked[0]
    seen = likelihood.simulate(top.values, top.names)
    if seen is None:
        return None
    likelihood = likelihood.weighed(top.values, seen)
    if likelihood.dimensions:  # their effect must not pass for noise
        first = likelihood.refit(whole.hypotheses(top.names), whole.coordinates(top.names, top), most=4)
        if first is not None:
            likelihood = likelihood.weighed(first.values, first.seen)
    whole.likelihood = likelihood

    def refit(item):
        names, f = item
        return likelihood.refit(whole.hypotheses(names), whole.coordinates(names, f), most=4)

    whole.add([f for f in in_lanes(refit, list(wanted.items())) if f is not None])
    whole.mend()
    if () not in whole.fits:
        return None
    return _weighed_by_the_best(whole) if whole.likelihood.rules.weighed_by_the_best else whole


def _weighed_by_the_best(models: Models) -> Models:
    """The models with the likelihood as weighed by the one of them that fits best as weighed by itself. Where
    the tendon slips, and how the base cell's noise passes on to the tip, depends on the model: weighed by a
    rival, a true model may seem much worse than it is.
    """
    likelihood = models.likelihood

    def on_its_own(f: Fitted) -> tuple[float, Likelihood] | None:
        own = dataclasses.replace(
            likelihood.weighed(f.values, f.seen, likelihood.noise), rules=likelihood.rules
        )
        again = own.refit(models.hypotheses(f.names), f.x, most=4, exact=False)
        return None if again is None else (again.cost + own.log_determinant, own)

    top = models.ranked()[:FINAL]
    found = [t for t in in_lanes(on_its_own, top) if t is not None]
    least, own = min(found, key=lambda t: t[0], default=(0.0, likelihood))
    first = next(iter(found), (0.0, likelihood))
    if own is first[1] or least > first[0] - SETTLED:
        return models
    other = Models(own, list(models.of.values()))
    again = [own.refit(models.hypotheses(f.names), f.x, most=4) for f in models.fits.values()]
    other.add([f for f in again if f is not None])
    other.mend()
    return other if () in other.fits else models


def _as_the_file_says(models: Models) -> Models:
    """The base model without what instruments add, where that is fitted beside every hypothesis."""
    numbers = tuple(n for n in models.likelihood.base if n.parameter not in INSTRUMENT_NUMBERS)
    if numbers == models.likelihood.base:
        return models
    likelihood = models.likelihood.with_base(numbers)
    known = dict(zip((n.name for n in models.likelihood.base), models.base.x, strict=True))
    fitted = likelihood.refit((), np.asarray([known[n.name] for n in numbers]))
    if fitted is None:
        return models
    plain = Models(likelihood, ())
    plain.add([fitted])
    return plain


def _answer(
    ready: Prepared,
    leave_out: Mapping[str, Sequence[Stretch]],
    decision: Decision,
    models: Models,
    screened: Sequence[Screened],
    *,
    discovery: Discovery | None,
    experiment: bool | None,
    say: Callable[[str], None],
) -> Diagnosis:
    likelihood, base, chosen = models.likelihood, models.base, decision.chosen
    say("fitting all that is uncertain together")
    finer = sum(ready.exact[0].robot.intervals) / sum(ready.rough[0].robot.intervals)
    plain = _as_the_file_says(models)
    before = jointly(plain, plain.base, finer)
    more = chosen.names or plain is not models
    compared = [plain.base, chosen] if more else [base]
    after = jointly(models, chosen, finer) if more else before
    refitted: dict[tuple[str, ...], Marginal] = {}
    if len(decision.confusion) > 1:
        say("fitting the rivals likewise")
        for names in decision.confusion:
            own = models.fits[tuple(sorted(names))]
            refitted[own.names] = after if own is chosen else jointly(models, own, finer)
    say("averaging over models, and over what these recordings cannot show")
    marginals = {(): before} | refitted | {chosen.names: after}
    leaves = decision.verdict in (PARTLY, DISCOVERED, UNEXPLAINED)
    average = averaged(models, chosen, decision.probability, marginals, leaves=leaves)
    pieces = discovery is not None and discovery.pieces
    scores = held_out(likelihood, [(models.hypotheses(f.names), f) for f in compared], pieces=pieces)
    wanted = decision.verdict == AMBIGUOUS if experiment is None else experiment
    proposal: Experiment | None = None
    if wanted and chosen.names:
        say("looking for the experiment that would decide")
        rivals = rivals_of(models, decision)
        if len(rivals) > 1:
            sd = [noise.sd for noise in likelihood.noise[0]]
            named = decision.verdict != UNEXPLAINED
            proposal = propose(rivals, likelihood.rigs[0], sd, named=named)
    loops, left = [], [likelihood.residuals(m.fitted.seen) for m in (before, after)]
    for k, part in enumerate(ready.full):
        plain, shown = part.recorded + left[0][k], part.recorded + left[1][k]
        phases = phases_of(likelihood, before.fitted, k)

        def pull(i: int, part=part, k=k, ends=(part.recorded, plain, shown), phases=phases) -> Pull:
            drive, tendon = part.drives[i], part.robot.tendons[i]
            T, own, by_draw = drive.T_base, of_one(phases, i), tendon.drive == "displacement"
            tensions = part.tips > 0 and not by_draw
            return Pull(
                tendon=tendon.name if part.others else "",
                drive=T,
                by_displacement=by_draw,
                phases=own,
                branches=[ratio_of_branches(T, rows[i], own) for rows in ends] if tensions else [],
                noise_drive=float(drive.sd),
            )

        loops.append(
            Loop(
                name=part.name,
                channels=part.channels,
                time=part.time,
                recorded=part.recorded,
                before=plain,
                after=shown,
                cycles=cycles_in(part),
                counted=part.counted,
                explained=part.explained,
                noise=tuple(likelihood.noise[k]),
                of=tuple(tendon_of_channel(part, name) for name in part.channels),
                pulls=tuple(pull(i) for i in range(len(part.drives))),
            )
        )
    probability = decision.probability
    rivals = [
        Rival(
            names=f.names,
            probability=probability[f.names],
            delta=float(np.sqrt(max(base.chi2 - f.chi2, 0.0))),
            chi2_per_n=likelihood.mean_square(f),
            values=dict(f.values),
            failed=f.failed,
            log_posterior=models.log_posterior(f),
        )
        for f in models.ranked()
    ]
    return gathered(
        decision,
        models,
        screened,
        before=before,
        after=after,
        refitted=refitted,
        average=average,
        discovery=discovery,
        where=locate(likelihood, before.fitted),
        rest=locate(likelihood, after.fitted),
        strata=mu_by_stratum(before.likelihood, before.fitted, before.covariance),
        held=scores,
        loops=loops,
        rivals=rivals,
        experiment=proposal,
        parts=ready.parts,
        config=ready.config,
        fine=ready.fine,
        differ=ready.differ,
        episodes=episodes(likelihood, after.fitted),
        left_out=[
            out
            for part, residual in zip(ready.full, left[1], strict=True)
            for out in left_out(part, leave_out[part.name], residual)
        ],
        warnings=ready.warnings,
    )
