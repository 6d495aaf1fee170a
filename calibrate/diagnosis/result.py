"""A diagnosis: the verdict, what carries it, and the robot with the physics that was missing."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gtr_jax import Robot, RobotConfig
from gtr_jax.numbers import measured_quantity
from gtr_jax.plain import plain
from gtr_jax.terms import REGISTRY

from ..number import OWN
from ..setup import Part
from .decide import ADEQUATE, AMBIGUOUS, MISSING, UNEXPLAINED, Decision, structured
from .differ import Difference
from .experiment import Experiment
from .locate import Where
from .marginal import Marginal
from .patterns import Pattern
from .robots import RobotFile, kinds, robot_files
from .search import SEEN, Models, Screened

BAD_DATA, DIFFER = "bad-data", "recordings-differ"
# Residual in units of the noise from which it is said to be more: of 86 sound recordings of the blind
# benchmark, from which this is taken, one with a bad repeat reached 1.49.
MORE = 1.5
# What the mesh leaves out is told from this share of the noise on.
COUNTS = 0.5
Names = tuple[str, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class Loop:
    """One recording of K samples beside the base model and the one that is shown.

    Attributes:
        name: of the recording.
        channels: T_tip first.
        time: [s], (K,), or None.
        T_base: true base tension as estimated [N], (K,).
        recorded, before, after: SI, (C, K).
        phases: of the base model, (K,).
        cycles: number of the cycle, from 1, (K,).
        branches: base tension, D and S of the recording, before and after; see `locate.ratio_of_branches`.
        noise_N, noise_base_N: of the cells.
    """

    name: str
    channels: tuple[str, ...]
    time: np.ndarray | None
    T_base: np.ndarray
    recorded: np.ndarray
    before: np.ndarray
    after: np.ndarray
    phases: np.ndarray
    cycles: np.ndarray
    branches: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    noise_N: float
    noise_base_N: float


@dataclasses.dataclass(frozen=True)
class Rival:
    """A model that was refitted.

    Attributes:
        names: of its hypotheses.
        probability: of it, beside the other models refitted and an effect too small to see.
        delta: root of the drop of the sum of squares from the base model.
        chi2_per_n: mean square of the white residuals.
        values: SI, by name.
        failed: load steps that did not converge.
        log_posterior: up to a constant.
    """

    names: Names
    probability: float
    delta: float
    chi2_per_n: float
    values: Mapping[str, float]
    failed: int
    log_posterior: float


@dataclasses.dataclass(frozen=True)
class Change:
    """A number before and after: SI; None where it is not in that model.

    Attributes:
        name, unit: of it.
        before, after: values.
        sd: standard deviation of the latter, all else that is uncertain counted in.
        lower95, upper95: its interval of 95 %.
        made_of: share of its variance by source: noise, uncertain numbers of the robot file, the law, the
            mesh.
    """

    name: str
    unit: str
    before: float | None
    after: float | None
    sd: float | None
    lower95: float | None = None
    upper95: float | None = None
    made_of: Mapping[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is missing from a robot's model.

    Attributes:
        verdict: "adequate", "recordings-differ", "missing-physics", "ambiguous", "unexplained" or "bad-data".
        says: the same in one or two sentences.
        named: terms that are missing: kinds, as robot files write them.
        confusion_set: sets of terms that the recordings do not tell apart, the most probable first.
        probability: of each model; "" for the base model; and that an effect is there too small to see.
        named_probability: of all models that hold what is named.
        where: where the base model and the recordings differ, most of the misfit first.
        rest: the same of the model that is shown.
        parameters: numbers before and after.
        rms_N, held_out: residual of T_tip before and after; see `heldout.held_out`.
        noise_N: of T_tip, the base cell's carried on to it.
        expected_N: what the residual of T_tip should be: the same and what the mesh leaves out.
        left, base_left: structure left by the model shown, and by the base model: size in standard deviations
            of the noise, and significance.
        pattern: a regularity in what the model shown leaves of T_tip that no noise has, or None.
        rivals: models refitted, the most probable first.
        strata: friction coefficient of the base model from parts of the samples: label, value, standard
            error, and what of it is the part's own noise.
        smallest_detectable: smallest size of each effect that these recordings would have shown, SI.
        experiment: what to measure next, or None.
        loops: for pictures.
        config: the robot file with what was found, or None.
        converged: whether every load step of the model shown met its tolerance.
        warnings: what the reader must know.
        settings: how it was done.
        differ: numbers that differ between recordings, with their values in the model that is shown; these
            are among the parameters, as "mu@monday".
        files: robot files: the first is that of `config`; then those of the rivals, and of the recordings
            where numbers differ.
    """

    verdict: str
    says: str
    named: list[str]
    confusion_set: list[list[str]]
    probability: dict[str, float]
    named_probability: float
    where: list[Where]
    rest: list[Where]
    parameters: list[Change]
    rms_N: tuple[float, float]
    held_out: list[dict[str, float]]
    noise_N: float
    expected_N: float
    left: tuple[float, float]
    base_left: tuple[float, float]
    pattern: Pattern | None
    rivals: list[Rival]
    strata: list[tuple[str, float, float, float]]
    smallest_detectable: dict[str, float]
    experiment: Experiment | None
    loops: list[Loop]
    config: RobotConfig | None
    converged: bool
    warnings: list[str]
    settings: dict[str, Any]
    differ: list[Difference] = dataclasses.field(default_factory=list)
    files: list[RobotFile] = dataclasses.field(default_factory=list)

    @staticmethod
    def without_answer(
        verdict: str,
        faults: list[str],
        parts: Sequence[Part],
        warnings: list[str],
        config: RobotConfig | None,
    ) -> Diagnosis:
        """A diagnosis of data that cannot be diagnosed."""
        nothing = (float("nan"), float("nan"))
        return Diagnosis(
            verdict,
            "These recordings cannot be diagnosed: " + "; ".join(faults).rstrip(".?") + ".",
            *([], [], {}, 0.0, [], [], []),
            nothing,
            [],
            float("nan"),
            float("nan"),
            nothing,
            nothing,
            *(None, [], [], {}, None, []),
            config,
            True,
            warnings,
            {"samples": sum(p.samples for p in parts)},
        )

    @staticmethod
    def of(
        decision: Decision,
        models: Models,
        screened: Sequence[Screened],
        *,
        before: Marginal,
        after: Marginal,
        refitted: Mapping[Names, Marginal],
        where: list[Where],
        rest: list[Where],
        strata: list[tuple[str, float, float, float]],
        held: list[dict[str, float]],
        loops: list[Loop],
        rivals: list[Rival],
        experiment: Experiment | None,
        parts: Sequence[Part],
        config: RobotConfig | None,
        fine: Robot,
        differ: Sequence[Difference],
        warnings: list[str],
    ) -> Diagnosis:
        """Gather a diagnosis."""
        chosen = decision.chosen
        off = [
            np.concatenate([v[0] - loop.recorded[0] for loop in loops for v in (getattr(loop, which),)])
            for which in ("before", "after")
        ]
        rms = (float(np.sqrt(np.mean(off[0] ** 2))), float(np.sqrt(np.mean(off[1] ** 2))))
        verdict = DIFFER if differ and decision.verdict == ADEQUATE else decision.verdict
        named = kinds(chosen.names) if verdict in (MISSING, AMBIGUOUS) else []
        confusion = list(map(list, dict.fromkeys(tuple(kinds(names)) for names in decision.confusion)))
        if verdict == MISSING and len(decision.confusion) > len(confusion):
            warnings.append(
                "Where is not told: " + " or ".join(" + ".join(n) for n in decision.confusion) + "."
            )
        parameters = _changes(before, after)
        noise, expected = models.bench.expected_rms(mesh=False), models.bench.expected_rms()
        files = robot_files(decision, after, refitted, differ, config, fine, warnings)
        diagnosis = Diagnosis(
            verdict,
            "",
            named if verdict == MISSING else [],
            confusion if verdict == AMBIGUOUS else ([named] if named else []),
            {" + ".join(names): p for names, p in decision.probability.items()},
            sum(p for names, p in decision.probability.items() if named and set(named) <= set(kinds(names))),
            where,
            rest,
            parameters,
            rms,
            held,
            noise,
            expected,
            decision.left,
            decision.base_left,
            decision.pattern,
            rivals,
            strata,
            {s.hypothesis.numbers[0].name: float(s.smallest) for s in screened if np.isfinite(s.smallest)},
            experiment,
            loops,
            files[0].config if files else None,
            after.fitted.failed == 0,
            warnings,
            {
                "samples": sum(p.samples for p in parts),
                "samples_simulated": sum(r.part.samples for r in models.bench.rigs),
                "mesh_intervals": sum(models.bench.rigs[0].robot.intervals),
                "seen_standard_errors": SEEN,
                "hypotheses": sorted(models.of),
                "free_of_the_base_model": [n.name for n in models.bench.base],
                "variance_scale": models.scale,
            },
            [d.at(after.fitted.values) for d in differ],
            files,
        )
        return dataclasses.replace(diagnosis, says=sentence(diagnosis, chosen.names))

    def own(self, difference: Difference) -> dict[str, Change]:
        """A number that differs, in each recording."""
        of = {c.name: c for c in self.parameters}
        return {k: of[f"{difference.name}{OWN}{k}"] for k in difference.own}

    def to_json(self) -> dict[str, Any]:
        """What `diagnosis.json` holds."""
        held = self.held_out
        fit: dict[str, Any] = {
            "rms_N": {"before": self.rms_N[0], "after": self.rms_N[1]},
            "noise_N": self.noise_N,
            "expected_rms_N": self.expected_N,
            "structure_left": {
                "before": {"noise_sd": self.base_left[0], "z": self.base_left[1]},
                "after": {"noise_sd": self.left[0], "z": self.left[1]},
            },
        }
        if self.pattern is not None:
            fit["pattern"] = {
                "recording": self.pattern.recording,
                "along": self.pattern.along,
                "period_N": self.pattern.period_N,
                "at_N": self.pattern.at_N,
                "width_N": self.pattern.width_N,
                "by_chance": self.pattern.chance,
                "share": self.pattern.share,
                "stands_still": [stand._asdict() for stand in self.pattern.stands],
            }
        if held:
            fit["held_out_rms_N"] = {"before": held[0]["rms_N"], "after": held[-1]["rms_N"]}
            fit["held_out_chi2_per_n"] = {"before": held[0]["chi2_per_n"], "after": held[-1]["chi2_per_n"]}
            fit["held_out_folds"] = {"number": held[0]["folds"], "better_after": held[-1]["best_in"]}
        parameters = {
            c.name: (
                {"before": c.before, "after": c.after, "sd": c.sd}
                if c.before is not None
                else {"value": c.after, "sd": c.sd, "unit": c.unit}
            )
            | ({} if c.sd is None else {"lower95": c.lower95, "upper95": c.upper95, "made_of": c.made_of})
            for c in self.parameters
        }
        proposal = None
        if self.experiment is not None:
            e = self.experiment
            proposal = {
                "says": e.says,
                "separates": [" + ".join(names) for names in e.separates],
                "expected_probability": e.expected_probability,
                "record": list(e.record),
                "menu_standard_errors": dict(e.menu),
            }
        answer = {
            "verdict": self.verdict,
            "says": self.says,
            "differs": [
                {
                    "parameter": d.name,
                    "unit": d.unit,
                    "one_value_for_all": d.shared,
                    "by_recording": {k: {"value": c.after, "sd": c.sd} for k, c in self.own(d).items()},
                    "groups": d.groups,
                    "difference": max(d.own.values()) - min(d.own.values()),
                    "standard_errors": d.standard_errors,
                    "or_numbers": d.or_numbers,
                    "or_effects": d.or_effects,
                }
                for d in self.differ
            ],
            "robot_files": [
                {
                    "file": f.name,
                    "holds": list(f.effects),
                    "recording": f.recording or None,
                    "probability": f.probability,
                    "settled": f.settled,
                }
                for f in self.files
            ],
            "named": self.named,
            "confusion_set": self.confusion_set,
            "probability": self.probability,
            "named_probability": self.named_probability,
            "where": [dataclasses.asdict(w) for w in self.where],
            "where_after": [dataclasses.asdict(w) for w in self.rest],
            "parameters": parameters,
            "fit": fit,
            "rivals": [dataclasses.asdict(r) for r in self.rivals],
            "friction_by_part": [
                {"part": p, "mu": v, "sd": sd, "own_sd": own} for p, v, sd, own in self.strata
            ],
            "next_experiment": proposal,
            "smallest_detectable": self.smallest_detectable,
            "converged": self.converged,
            "warnings": self.warnings,
            "settings": self.settings,
        }
        return plain(answer)


def _changes(before: Marginal, after: Marginal) -> list[Change]:
    """The numbers of the robot before and after, dimensions last but for what was set."""
    was = {n.name: before.fitted.values[n.name] for n in before.fitted.numbers}
    found = []
    for i, n in enumerate(after.fitted.numbers):
        value = after.fitted.values[n.name]
        lower, upper = after.interval(i)
        found.append(
            Change(n.name, n.unit, was.get(n.name), value, after.sd(i), lower, upper, after.made_of[i])
        )
    free = {n.name for n in after.fitted.numbers}
    assumed = {k: v for k, v in after.fitted.values.items() if k not in free}
    return found + [Change(name, "", None, value, None) for name, value in assumed.items()]


def difference_in_words(d: Diagnosis, difference: Difference) -> str:
    """Which number differs, by how much and between which recordings."""
    own = d.own(difference)

    def said(recording: str) -> str:
        shown = measured_quantity(difference.own[recording], own[recording].sd, difference.unit)
        return f"{shown} in {recording}"

    parts = [" and ".join(map(said, group)) for group in difference.groups]
    apart = f"{difference.standard_errors:.0f} standard errors, what is unknown of all alike left out"
    words = f"{difference.name} differs between the recordings: {', but '.join(parts)} ({apart})."
    others = [f"{name} that differs" for name in difference.or_numbers]
    others += [f"{name} in all of them" for name in difference.or_effects]
    if others:
        words += f" {' or '.join(others)} would explain them nearly as well."
    return words


def _noise(d: Diagnosis, verb: str = "") -> str:
    """The noise in words, and what the mesh leaves out where that counts."""
    mesh = float(np.sqrt(max(d.expected_N**2 - d.noise_N**2, 0.0)))
    also = f" and the mesh leaves out {mesh:.1g} N" if mesh > COUNTS * d.noise_N else ""
    return f"noise{verb} {d.noise_N:.2g} N{also}"


def sentence(d: Diagnosis, chosen: Names) -> str:
    """The verdict in words that its numbers carry."""
    before = "".join(f"{difference_in_words(d, difference)} " for difference in d.differ)
    return before + _of_physics(d, chosen)


def _of_physics(d: Diagnosis, chosen: Names) -> str:
    held = d.held_out
    better = ""
    if len(held) > 1 and np.isfinite(held[1]["rms_N"]):
        better = (
            f" On samples the fit has not seen, the residual goes from {held[0]['rms_N']:.2g} to "
            f"{held[1]['rms_N']:.2g} N ({_noise(d)})."
        )
    if d.verdict in (ADEQUATE, DIFFER):
        best = d.rivals[0] if d.rivals else None
        hint = ""
        if best is not None and best.names and best.probability > 0.5:
            hint = f" {' with '.join(best.names)} would fit a little better, too little to be claimed."
        more = ""
        if d.rms_N[0] > MORE * d.expected_N:
            more = ", which is more, with too little structure in it to claim anything"
        what = "Nothing else is missing" if d.verdict == DIFFER else "Nothing is missing"
        return (
            f"{what} that these recordings could show: the residual is {d.rms_N[0]:.2g} N where "
            f"the {_noise(d, ' is')}{more}.{hint}"
        )
    if d.verdict == UNEXPLAINED:
        nearest = ""
        if chosen:
            nearest = (
                f" The nearest, {' with '.join(chosen)}, leaves structure of {d.left[0]:.2g} standard "
                f"deviations of the noise.{better}"
            )
        what = "Something is missing that no term of the catalogue explains:"
        if d.pattern is not None:
            by_chance = f"by chance: {max(d.pattern.chance, 1e-99):.1g}"
            where = f" (in {d.pattern.recording})" if len(d.loops) > 1 else ""
            what += f" {d.pattern.says}{where} ({by_chance}), {100 * d.pattern.share:.0f} % of it;"
        at = f" Most of it: {d.where[0].says}." if d.where else ""
        off = f"the fit is off by {d.rms_N[0]:.2g} N where the {_noise(d, ' is')}"
        return f"{what} {off}.{at}{nearest}"
    mu = next((c for c in d.parameters if c.name == "mu"), None)
    moved = f" Friction goes from {mu.before:.3g} to {mu.after:.3g}." if mu and mu.before and mu.after else ""
    stays = ""
    if structured(d.left):
        stays = (
            f" Structure of {d.left[0]:.2g} standard deviations of the noise stays: a law is not quite "
            "right, or something more is missing."
        )
    if d.verdict == AMBIGUOUS:
        sets = " or ".join(" with ".join(s) for s in d.confusion_set)
        return f"Missing is {sets}: these recordings do not tell which.{better}{moved}{stays}"
    effects = "; ".join(REGISTRY[kind].says.rstrip(".") for kind in d.named)
    sure = "above 0.99" if d.named_probability > 0.99 else f"{d.named_probability:.2f}"
    sizes = ", ".join(
        f"{c.name} = {measured_quantity(c.after, c.sd, c.unit)}{' (assumed)' if c.sd is None else ''}"
        for c in d.parameters
        if c.before is None
    )
    return f"Missing: {' and '.join(d.named)} (probability {sure}). {effects}: {sizes}.{better}{moved}{stays}"
