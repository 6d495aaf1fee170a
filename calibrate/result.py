"""What a fit answers."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from gtr_jax import Robot, RobotConfig

from .estimate import Estimate, Profile


def _plain(x: Any) -> Any:
    """JSON has no NaN: null stands for what is not known."""
    if isinstance(x, np.ndarray):
        return _plain(x.tolist())
    if isinstance(x, dict):
        return {str(k): _plain(v) for k, v in x.items()}
    if isinstance(x, list | tuple):
        return [_plain(v) for v in x]
    if isinstance(x, float | np.floating):
        return float(x) if np.isfinite(x) else None
    return x.item() if isinstance(x, np.generic) else x


@dataclasses.dataclass(frozen=True, eq=False)
class FitResult:
    """A robot fitted to a recording of K samples.

    Attributes:
        robot: the fitted robot.
        config: the fitted robot file; None when a `Robot` was given, or when the file would refuse the fitted
            values.
        estimates: one per free parameter.
        rms_N: root mean square of the residual [N].
        noise_N: standard deviation of the recorded tip tension [N], given or estimated; None if it cannot be
            told.
        noise_base_N: standard deviation of the recorded base tension [N]; 0 if it is taken as exact.
        chi2_per_n: sum of squared residuals in units of the noise per degree of freedom; None without noise.
        residual: simulated minus recorded tip tension [N], (K,).
        T_base: estimate of the true base tension, which is simulated with [N], (K,).
        T_tip: simulated [N], (K,).
        phases: "pulling", "transition", "releasing" or "rest", (K,).
        by_phase: per phase its "count", "rms_N" and "mean_N" of the residual.
        converged: whether there is an answer: the optimiser and every load step converged, and something was
            to be fitted.
        result: how the optimiser ended, in words.
        iterations, evaluations: steps of the optimiser, and recordings simulated in all.
        correlation: between the estimates, (p, p); NaN where one is unknown.
        warnings: what a reader must know, a sentence each.
        verdict: the answer in one sentence.
        settings: what was asked and what was chosen, plain values.
        mu_by_phase: mu estimated from the samples of one phase alone, the other parameters at their fitted
            values; empty if mu is not free or a phase is too short.
        profiles: profile likelihood of each parameter that the recording determines, by name.
    """

    robot: Robot
    config: RobotConfig | None
    estimates: list[Estimate]
    rms_N: float
    noise_N: float | None
    noise_base_N: float
    chi2_per_n: float | None
    residual: np.ndarray
    T_base: np.ndarray
    T_tip: np.ndarray
    phases: np.ndarray
    by_phase: dict[str, dict[str, float]]
    converged: bool
    result: str
    iterations: int
    evaluations: int
    correlation: np.ndarray
    warnings: list[str]
    verdict: str
    settings: dict[str, Any]
    mu_by_phase: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    profiles: dict[str, Profile] = dataclasses.field(default_factory=dict)

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of a parameter, by name."""
        found = {e.name: e for e in self.estimates} | {e.key: e for e in self.estimates}
        return found[name]

    def to_json(self) -> dict[str, Any]:
        """Plain values for a JSON file: units in the keys, SI; null for what is not known."""

        def entry(e: Estimate) -> dict[str, Any]:
            fields = dataclasses.asdict(e)
            return {k: v for k, v in fields.items() if k != "name"}

        return _plain(
            {
                "verdict": self.verdict,
                "converged": self.converged,
                "result": self.result,
                "parameters": {e.name: entry(e) for e in self.estimates},
                "correlation": {"names": [e.name for e in self.estimates], "matrix": self.correlation},
                "fit": {
                    "samples": len(self.residual),
                    "rms_N": self.rms_N,
                    "noise_N": self.noise_N,
                    "noise_base_N": self.noise_base_N,
                    "chi2_per_n": self.chi2_per_n,
                },
                "by_phase": self.by_phase,
                "mu_by_phase": {phase: entry(e) for phase, e in self.mu_by_phase.items()},
                "profiles": {name: dataclasses.asdict(p) for name, p in self.profiles.items()},
                "warnings": self.warnings,
                "iterations": self.iterations,
                "evaluations": self.evaluations,
                "settings": self.settings,
            }
        )
