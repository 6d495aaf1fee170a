"""Gather a diagnosis: from the decision and the models to what is told."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from calibrate.diagnosis.decision.decide import Decision
from calibrate.diagnosis.decision.verdict import AMBIGUOUS, DISCOVERED, MISSING, PARTLY, verdict
from calibrate.diagnosis.evidence.averaged import Averaged
from calibrate.diagnosis.evidence.marginal import Marginal
from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.laws.discovery import Discovery, with_laws
from calibrate.diagnosis.laws.found import found_law
from calibrate.diagnosis.likelihood.locate import Where
from calibrate.diagnosis.outside.episodes import Episode
from calibrate.diagnosis.outside.leave_out import LeftOut
from calibrate.diagnosis.screening.screen import SEEN, Screened
from calibrate.diagnosis.search.differ import Difference
from calibrate.inference.channels import unit_of
from calibrate.inference.setup import Observation
from calibrate.planning.proposal import Experiment
from gtr_jax import Robot, RobotConfig

from .change import Change
from .loop import Loop
from .result import Diagnosis, Rival
from .robots import kinds, robot_files
from .sentence import sentence

Names = tuple[str, ...]


def gathered(
    decision: Decision,
    models: Models,
    screened: Sequence[Screened],
    *,
    before: Marginal,
    after: Marginal,
    refitted: Mapping[Names, Marginal],
    average: Averaged,
    discovery: Discovery | None,
    where: list[Where],
    rest: list[Where],
    strata: list[tuple[str, float, float, float]],
    held: list[dict[str, float]],
    loops: list[Loop],
    rivals: list[Rival],
    experiment: Experiment | None,
    parts: Sequence[Observation],
    config: RobotConfig | None,
    fine: Robot,
    differ: Sequence[Difference],
    episodes: list[Episode],
    left_out: list[LeftOut],
    warnings: list[str],
) -> Diagnosis:
    """Gather a diagnosis."""
    chosen = decision.chosen
    was, now, read = (
        np.concatenate(
            [row[: loop.explained, loop.counted].ravel() for row, loop in zip(each, loops, strict=True)]
        )
        for each in zip(*((loop.before, loop.after, loop.recorded) for loop in loops), strict=True)
    )
    outside = any(stretch.outside for stretch in left_out)
    told = verdict(dataclasses.replace(decision.quantities, differ=bool(differ), outside=outside)).name
    named = kinds(chosen.names) if told in (MISSING, AMBIGUOUS, PARTLY, DISCOVERED) else []
    confusion = list(map(list, dict.fromkeys(tuple(kinds(names)) for names in decision.confusion)))
    alone = told == MISSING or (told == PARTLY and len(confusion) == 1)
    alone = alone or (told == DISCOVERED and not confusion)
    laws = {} if discovery is None else discovery.laws
    fine = with_laws(fine, list(laws.values()))
    variants = []
    if alone and len(decision.confusion) > len(confusion):
        which = " or ".join(" + ".join(names) for names in decision.confusion)
        variants = [
            f"The recordings do not show which of these it is, where it acts or in which form: {which}."
        ]
    files, faults = robot_files(decision, after, refitted, differ, config, fine, laws)
    diagnosis = Diagnosis(
        verdict=told,
        says="",
        named=named if alone else [],
        confusion_set=([named] if named else []) if alone else confusion,
        probability={" + ".join(names): p for names, p in decision.probability.items()},
        named_probability=sum(
            p for names, p in decision.probability.items() if named and set(named) <= set(kinds(names))
        ),
        where=where,
        rest=rest,
        parameters=_changes(before, after, average),
        unit=unit_of(loops[0].channels[0]),
        rms=(_rms(was - read), _rms(now - read)),
        held_out=held,
        noise=models.likelihood.expected_rms(mesh=False),
        expected=models.likelihood.expected_rms(),
        left=decision.left,
        base_left=decision.base_left,
        pattern=decision.pattern,
        rivals=rivals,
        strata=strata,
        smallest_detectable={
            s.hypothesis.numbers[0].name: float(s.smallest) for s in screened if np.isfinite(s.smallest)
        },
        experiment=experiment,
        loops=loops,
        config=files[0].config if files else None,
        converged=after.fitted.failed == 0,
        warnings=[*warnings, *variants, *faults],
        settings={
            "samples": sum(p.samples for p in parts),
            "samples_simulated": sum(r.part.samples for r in models.likelihood.rigs),
            "mesh_intervals": sum(models.likelihood.rigs[0].robot.intervals),
            "seen_standard_errors": SEEN,
            "hypotheses": sorted(models.of),
            "free_of_the_base_model": [n.name for n in models.likelihood.base],
            "variance_scale": models.scale,
            "heavy_tails": models.likelihood.rules.tail,
        },
        differ=[d.at(after.fitted.values) for d in differ],
        files=files,
        episodes=episodes,
        left_out=left_out,
        hidden=average.hidden,
        discovered=None if discovery is None else found_law(discovery, after),
        laws=models.likelihood.rigs[0].robot.laws,
    )
    return dataclasses.replace(diagnosis, says=sentence(diagnosis, chosen.names))


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _changes(before: Marginal, after: Marginal, average: Averaged) -> list[Change]:
    """The numbers of the robot before and after; fixed numbers last."""
    was = {n.name: before.fitted.values[n.name] for n in before.fitted.numbers}
    found = []
    for i, n in enumerate(after.fitted.numbers):
        value = after.fitted.values[n.name]
        lower, upper = after.interval(i)
        found.append(
            Change(
                name=n.name,
                unit=n.unit,
                before=was.get(n.name),
                after=value,
                sd=after.sd(i),
                lower95=lower,
                upper95=upper,
                made_of=after.made_of[i],
                averaged95=average.ends.get(n.name),
            )
        )
    free = {n.name for n in after.fitted.numbers}
    assumed = {k: v for k, v in after.fitted.values.items() if k not in free}
    terms = after.likelihood.rigs[0].robot.catalogue
    units = {f"{t.id}.{q.name}": q.unit for t in terms.values() for q in t.numbers}
    return found + [
        Change(name=name, unit=units.get(name, ""), before=None, after=value, sd=None)
        for name, value in assumed.items()
    ]
