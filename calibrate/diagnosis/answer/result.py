"""A diagnosis: the verdict, what carries it, and the robot with the physics that was missing."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from calibrate.diagnosis.evidence.averaged import Hidden
from calibrate.diagnosis.hypotheses.hypotheses import INSTRUMENT_NUMBERS
from calibrate.diagnosis.laws.found import FoundLaw
from calibrate.diagnosis.likelihood.locate import Where
from calibrate.diagnosis.outside.episodes import Episode
from calibrate.diagnosis.outside.leave_out import LeftOut
from calibrate.diagnosis.outside.patterns import Pattern
from calibrate.diagnosis.search.differ import Difference
from calibrate.inference.channels import unit_of
from calibrate.inference.number import OWN
from calibrate.inference.setup import Observation
from calibrate.planning.proposal import Experiment
from gtr_jax import RobotConfig
from gtr_jax.notebook import as_card
from gtr_jax.terms import Law, Term, catalogue_of
from gtr_jax.to_jsonable import to_jsonable

from .change import Change, changes_frame
from .loop import Loop
from .robots import RobotFile
from .settled import Settled

if TYPE_CHECKING:
    import pandas

BAD_DATA = "bad-data"
Names = tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Rival:
    """A model that was refitted.

    Attributes:
        names: of its hypotheses.
        probability: of the model, among the models refitted and an effect too small to see.
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


@dataclasses.dataclass(frozen=True, eq=False)
class Diagnosis:
    """What is missing from a robot's model.

    Attributes:
        verdict: "adequate", "recordings-differ", "missing-physics", "ambiguous", "partly-explained",
            "discovered", "unexplained" or "bad-data".
        says: the same in one or two sentences.
        named: terms that are missing: kinds, as robot files write them.
        confusion_set: sets of terms that the recordings do not tell apart, the most probable first.
        probability: of each model, where "" is the base model, and of an effect too small to see.
        named_probability: of all models that hold what is named.
        where: where the base model and the recordings differ, most of the misfit first.
        rest: the same for the model that is shown.
        parameters: numbers before and after.
        unit: SI unit of what is explained: N of tip tensions; m or rad where none was recorded.
        rms, held_out: residual of what is explained before and after; see `held_out.held_out`.
        noise: standard deviation of its noise, with the base cell's noise passed on to it.
        expected: expected rms residual: `noise` and the error of the mesh.
        left, base_left: structure left by the model shown, and by the base model: size in standard deviations
            of the noise, and significance.
        pattern: a regularity in the residual of what is explained that noise does not have, or None.
        rivals: models refitted, the most probable first.
        strata: friction coefficient of the base model from parts of the samples: label, value, standard
            error, and the standard error from the part's own noise alone.
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
        episodes: where in time the model that is shown and the recordings part, most of the misfit first.
        left_out: stretches of time that are simulated and not compared.
        hidden: effects that these recordings neither show nor exclude, those that move mu most first.
        discovered: the law that was found; None unless that is the verdict.
        laws: of the robot file, which were tried too where they were null, and those that were looked for.
        settles: what it settles of an earlier diagnosis, if that was asked.
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
    unit: str
    rms: tuple[float, float]
    held_out: list[dict[str, float]]
    noise: float
    expected: float
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
    episodes: list[Episode] = dataclasses.field(default_factory=list)
    left_out: list[LeftOut] = dataclasses.field(default_factory=list)
    hidden: list[Hidden] = dataclasses.field(default_factory=list)
    discovered: FoundLaw | None = None
    laws: tuple[Law, ...] = ()
    settles: Settled | None = None

    @property
    def catalogue(self) -> Mapping[str, Term]:
        """Every physics term that could be named, by name."""
        return catalogue_of(self.laws)

    @staticmethod
    def without_answer(
        verdict: str,
        faults: list[str],
        parts: Sequence[Observation],
        warnings: list[str],
        config: RobotConfig | None,
    ) -> Diagnosis:
        """A diagnosis of data that cannot be diagnosed."""
        unknown = float("nan")
        return Diagnosis(
            verdict=verdict,
            says="These recordings cannot be diagnosed: " + "; ".join(faults).rstrip(".?") + ".",
            named=[],
            confusion_set=[],
            probability={},
            named_probability=0.0,
            where=[],
            rest=[],
            parameters=[],
            unit=unit_of(parts[0].channels[0]) if parts else "N",
            rms=(unknown, unknown),
            held_out=[],
            noise=unknown,
            expected=unknown,
            left=(unknown, unknown),
            base_left=(unknown, unknown),
            pattern=None,
            rivals=[],
            strata=[],
            smallest_detectable={},
            experiment=None,
            loops=[],
            config=config,
            converged=True,
            warnings=list(warnings),
            settings={"samples": sum(p.samples for p in parts)},
        )

    @property
    def instruments(self) -> list[Change]:
        """What the instruments add, where that is fitted beside every hypothesis."""
        beside = INSTRUMENT_NUMBERS & set(self.settings.get("free_of_the_base_model", ()))
        return [c for c in self.parameters if c.name in beside]

    @property
    def share_explained(self) -> float | None:
        """Share of the misfit of what is explained beyond the noise, in squares, that the model shown takes:
        on samples the fit has not seen where there are such, else on those fitted. None where nothing is
        missing.
        """
        if len(self.held_out) < 2:
            return None
        ends = [h["rms"] for h in self.held_out]
        ends = ends if np.all(np.isfinite(ends)) else list(self.rms)
        before, after = (max(end**2 - self.expected**2, 0.0) for end in (ends[0], ends[-1]))
        return 1 - after / before if before > 0 and np.isfinite(before + after) else None

    def own(self, difference: Difference) -> dict[str, Change]:
        """The values of a number that differs, by recording."""
        of = {c.name: c for c in self.parameters}
        return {k: of[f"{difference.name}{OWN}{k}"] for k in difference.own}

    _repr_html_ = as_card

    def to_pandas(self) -> pandas.DataFrame:
        """The numbers before and after, a row for each by its name: SI, with sd, the 95 % interval under the
        model shown, the one averaged over models, and the unit; NaN where there is none.
        """
        return changes_frame(self.parameters)

    def to_json(self) -> dict[str, Any]:
        """The contents of `diagnosis.json`."""
        held, unit = self.held_out, self.unit
        fit: dict[str, Any] = {
            f"rms_{unit}": {"before": self.rms[0], "after": self.rms[1]},
            f"noise_{unit}": self.noise,
            f"expected_rms_{unit}": self.expected,
            "structure_left": {
                "before": {"noise_sd": self.base_left[0], "z": self.base_left[1]},
                "after": {"noise_sd": self.left[0], "z": self.left[1]},
            },
        }
        if self.pattern is not None:
            fit["pattern"] = {
                "recording": self.pattern.recording,
                "of": self.pattern.of,
                "along": self.pattern.along,
                "period_N": self.pattern.period_N,
                "at_N": self.pattern.at_N,
                "width_N": self.pattern.width_N,
                "by_chance": self.pattern.chance,
                "share": self.pattern.share,
                "stands_still": [stand._asdict() for stand in self.pattern.stands],
            }
        if held:
            fit[f"held_out_rms_{unit}"] = {"before": held[0]["rms"], "after": held[-1]["rms"]}
            fit["held_out_chi2_per_n"] = {"before": held[0]["chi2_per_n"], "after": held[-1]["chi2_per_n"]}
            fit["held_out_folds"] = {"number": held[0]["folds"], "better_after": held[-1]["best_in"]}
        parameters = {
            c.name: (
                {"before": c.before, "after": c.after, "sd": c.sd}
                if c.before is not None
                else {"value": c.after, "sd": c.sd, "unit": c.unit}
            )
            | ({} if c.sd is None else {"lower95": c.lower95, "upper95": c.upper95, "made_of": c.made_of})
            | ({} if c.averaged95 is None else {"averaged95": list(c.averaged95)})
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
                    "information": {"names": list(f.numbers), "matrix": f.information},
                }
                for f in self.files
            ],
            "recordings": [
                {
                    "name": loop.name,
                    "samples": len(loop.cycles),
                    "noise_base_N": max(
                        (p.noise_drive for p in loop.pulls if not p.by_displacement), default=0.0
                    ),
                    "channels": {
                        name: {"unit": unit_of(name), "sd": own.sd, "correlation": own.rho}
                        for name, own in zip(loop.channels, loop.noise, strict=True)
                    },
                }
                for loop in self.loops
            ],
            "named": self.named,
            "share_explained": self.share_explained,
            "discovered": None if self.discovered is None else self.discovered.to_json(),
            "confusion_set": self.confusion_set,
            "probability": self.probability,
            "named_probability": self.named_probability,
            "where": [w.to_json() for w in self.where],
            "where_after": [w.to_json() for w in self.rest],
            "episodes": [e.to_json() for e in self.episodes],
            "left_out": [e.to_json() for e in self.left_out],
            "parameters": parameters,
            "fit": fit,
            "rivals": [dataclasses.asdict(r) for r in self.rivals],
            "friction_by_part": [
                {"part": p, "mu": v, "sd": sd, "own_sd": own} for p, v, sd, own in self.strata
            ],
            "next_experiment": proposal,
            "smallest_detectable": self.smallest_detectable,
            "hidden": [h._asdict() for h in self.hidden],
            "settles": None if self.settles is None else dataclasses.asdict(self.settles),
            "converged": self.converged,
            "warnings": self.warnings,
            "settings": self.settings,
        }
        return to_jsonable(answer)
