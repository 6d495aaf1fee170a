"""The result of a fit."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np

from calibrate.inference.estimate import Estimate, Profile
from calibrate.inference.posterior_draws import Posterior
from gtr_jax import Robot, RobotConfig
from gtr_jax.notebook import as_card
from gtr_jax.to_jsonable import to_jsonable

from .fitted import FittedRecording
from .tables import estimates_frame

if TYPE_CHECKING:
    import pandas


def _posterior(found: Posterior) -> dict[str, Any]:
    chains, draws, _ = found.draws.shape
    rows = zip(found.names, found.sd, found.lower95, found.upper95, found.effective, found.rhat, strict=True)
    names = ("sd", "lower95", "upper95", "effective_draws", "rhat")
    return {
        "chains": chains,
        "draws_per_chain": draws,
        "divergences": found.divergences,
        "converged": found.converged,
        "parameters": {name: dict(zip(names, row, strict=True)) for name, *row in rows},
    }


@dataclasses.dataclass(frozen=True, eq=False)
class FitResult:
    """Robots fitted to one recording or several, K samples in all.

    Attributes:
        recordings: each recording beside its fitted robot.
        estimates: one per free number.
        carried: the other numbers that the robot file calls uncertain, fitted with its standard deviations as
            priors.
        converged: whether there is an answer: the optimiser and every load step converged, and something was
            to be fitted.
        result: how the optimiser ended, in words.
        iterations, evaluations: steps of the optimiser, and times that all recordings were simulated.
        correlation: between the estimates, (p, p); NaN where one is unknown.
        information: Fisher information of recordings and priors about all free numbers, those carried along
            last, per product of their SI units, (p, p); None where nothing was simulated.
        warnings: what a reader must know, a sentence each.
        verdict: the answer in one sentence.
        settings: what was asked and what was chosen, plain values.
        mu_by_phase: mu estimated from the samples of one phase alone, the other parameters at their fitted
            values, and their errors counted in; empty if mu is not free or a phase is too short.
        by_recording: parameters that recordings share, estimated from each alone, likewise.
        axes: combinations of the estimates that are known independently, in words, with their relative
            standard deviation, the least known first.
        profiles: profile likelihood of each number that the recordings determine, by name.
        posterior: draws from the posterior, if asked for.
    """

    recordings: tuple[FittedRecording, ...]
    estimates: list[Estimate]
    carried: list[Estimate]
    converged: bool
    result: str
    iterations: int
    evaluations: int
    correlation: np.ndarray
    warnings: list[str]
    verdict: str
    settings: dict[str, Any]
    information: np.ndarray | None = None
    mu_by_phase: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    by_recording: dict[str, dict[str, Estimate]] = dataclasses.field(default_factory=dict)
    axes: list[tuple[str, float]] = dataclasses.field(default_factory=list)
    profiles: dict[str, Profile] = dataclasses.field(default_factory=dict)
    posterior: Posterior | None = None

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of a parameter, by name."""
        every = [*self.estimates, *self.carried]
        return ({e.key: e for e in every if "@" not in e.name} | {e.name: e for e in every})[name]

    def _only(self) -> FittedRecording:
        if len(self.recordings) != 1:
            raise ValueError(f"{len(self.recordings)} recordings were fitted; take one of fit.recordings")
        return self.recordings[0]

    @property
    def robot(self) -> Robot:
        """The fitted robot; ValueError if there are several recordings."""
        return self._only().robot

    @property
    def config(self) -> RobotConfig | None:
        """The fitted robot file; ValueError if there are several recordings."""
        return self._only().config

    @property
    def T_base(self) -> np.ndarray:
        """Base tension without noise, one recording after the other [N], (K, *tendons)."""
        return np.concatenate([r.T_base for r in self.recordings])

    @property
    def T_tip(self) -> np.ndarray:
        """Simulated [N], (K,)."""
        return np.concatenate([r.T_tip for r in self.recordings])

    @property
    def residual(self) -> np.ndarray:
        """Simulated minus recorded tip tension [N], (K,); NaN where none was recorded."""
        return np.concatenate([r.residual for r in self.recordings])

    @property
    def phases(self) -> np.ndarray:
        """Phase of each sample, (K,)."""
        return np.concatenate([r.phases for r in self.recordings])

    @property
    def by_phase(self) -> dict[str, dict[str, float]]:
        """Count, rms and mean of the residual per phase; ValueError if there are several recordings."""
        return self._only().by_phase

    @property
    def noise_N(self) -> float | None:
        """Standard deviation of the recorded tip tension [N]; ValueError if there are several recordings."""
        return self._only().noise_N

    @property
    def noise_base_N(self) -> float:
        """Standard deviation of the recorded base tension [N]; ValueError if there are several recordings."""
        return self._only().noise_base_N

    @property
    def rms_N(self) -> float:
        """Root mean square of the residual of all recorded tip tensions [N]; NaN if there are none."""
        each = [r.residual for r in self.recordings if r.tips]
        return float(np.sqrt(np.mean(np.concatenate(each) ** 2))) if each else np.nan

    @property
    def chi2_per_n(self) -> float | None:
        """Sum of squared residuals of the tensions in units of the noise per degree of freedom, of all
        recordings that have tip tensions.
        """
        each = [(r.chi2_per_n, len(r.T_base)) for r in self.recordings if r.tips]
        if not each or any(chi2 is None for chi2, _ in each):
            return None
        return float(sum(chi2 * n for chi2, n in each if chi2 is not None) / sum(n for _, n in each))

    def _information(self) -> dict[str, Any] | None:
        """What is known of the free numbers, for a file."""
        if self.information is None:
            return None
        return {"names": self.settings["free"] + self.settings["carried"], "matrix": self.information}

    _repr_html_ = as_card

    def to_pandas(self) -> pandas.DataFrame:
        """The estimates, a row for each number by its name: key, value, sd, ends of the 95 % interval, value
        in the robot file, SI unit, smallest change that would show, note, and whether it was carried along.
        """
        return estimates_frame(self.estimates, self.carried)

    def to_json(self) -> dict[str, Any]:
        """Plain values for a JSON file: units in the keys, SI; null for what is not known."""

        def entry(e: Estimate) -> dict[str, Any]:
            fields = dataclasses.asdict(e)
            return {k: v for k, v in fields.items() if k != "name"}

        def recording(r: FittedRecording) -> dict[str, Any]:
            channels = {name: {"unit": c.unit, "rms": c.rms, "sd": c.sd} for name, c in r.channels.items()}
            return {
                "name": r.name,
                "samples": len(r.T_base),
                "rms_N": r.rms_N,
                "noise_N": r.noise_N,
                "noise_from": r.noise_from,
                "noise_base_N": r.noise_base_N,
                "chi2_per_n": r.chi2_per_n,
                "outliers": r.outliers,
                "channels": channels,
                "by_phase": r.by_phase,
                **r.settings,
            }

        return to_jsonable(
            {
                "verdict": self.verdict,
                "converged": self.converged,
                "result": self.result,
                "parameters": {e.name: entry(e) for e in self.estimates},
                "carried": {e.name: entry(e) for e in self.carried},
                "correlation": {"names": [e.name for e in self.estimates], "matrix": self.correlation},
                "information": self._information(),
                "axes": [{"says": says, "relative_sd": sd} for says, sd in self.axes],
                "fit": {"samples": len(self.residual), "rms_N": self.rms_N, "chi2_per_n": self.chi2_per_n},
                "recordings": [recording(r) for r in self.recordings],
                "mu_by_phase": {phase: entry(e) for phase, e in self.mu_by_phase.items()},
                "by_recording": {
                    name: {which: entry(e) for which, e in each.items()}
                    for name, each in self.by_recording.items()
                },
                "profiles": {name: dataclasses.asdict(p) for name, p in self.profiles.items()},
                "posterior": None if self.posterior is None else _posterior(self.posterior),
                "warnings": self.warnings,
                "iterations": self.iterations,
                "evaluations": self.evaluations,
                "settings": self.settings,
            }
        )
