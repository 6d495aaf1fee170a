"""A fit's answer in words, tables and pictures. `calibrate.fit`, which is not imported here, returns it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from gtr_jax import plots
from gtr_jax.config import RobotConfig
from gtr_jax.plots.style import number
from gtr_jax.recording import Recording
from gtr_jax.units import DIMENSIONS, convert

from .page import Figure, Report, Table


class EstimateLike(Protocol):
    """One estimated parameter; see `calibrate.Estimate`."""

    @property
    def name(self) -> str: ...
    @property
    def key(self) -> str: ...
    @property
    def value(self) -> float: ...
    @property
    def sd(self) -> float | None: ...
    @property
    def lower95(self) -> float | None: ...
    @property
    def upper95(self) -> float | None: ...
    @property
    def initial(self) -> float: ...
    @property
    def unit(self) -> str: ...
    @property
    def note(self) -> str: ...


class FitAnswer(Protocol):
    """A fit; see `calibrate.FitResult`."""

    @property
    def config(self) -> RobotConfig | None: ...
    @property
    def estimates(self) -> Sequence[EstimateLike]: ...
    @property
    def rms_N(self) -> float: ...
    @property
    def noise_N(self) -> float | None: ...
    @property
    def noise_base_N(self) -> float: ...
    @property
    def T_base(self) -> np.ndarray: ...
    @property
    def profiles(self) -> Mapping[str, Any]: ...
    @property
    def chi2_per_n(self) -> float | None: ...
    @property
    def residual(self) -> np.ndarray: ...
    @property
    def T_tip(self) -> np.ndarray: ...
    @property
    def phases(self) -> np.ndarray: ...
    @property
    def by_phase(self) -> Mapping[str, Mapping[str, Any]]: ...
    @property
    def converged(self) -> bool: ...
    @property
    def result(self) -> str: ...
    @property
    def iterations(self) -> int: ...
    @property
    def evaluations(self) -> int: ...
    @property
    def warnings(self) -> Sequence[str]: ...
    @property
    def verdict(self) -> str: ...
    def to_json(self) -> dict[str, Any]: ...


def fit_report(fit: FitAnswer, recording: Recording, name: str) -> Report:
    """Verdict, figures and tables of a fit.

    Args:
        fit: from `calibrate.fit`.
        recording: what was fitted.
        name: of the robot.
    """
    return Report(
        title=f"{name}: fit",
        verdict=fit.verdict,
        warnings=fit.warnings,
        figures=_figures(fit, recording),
        tables=_tables(fit),
    )


def _figures(fit: FitAnswer, recording: Recording) -> list[Figure]:
    if recording.T_tip is None:
        raise ValueError("a recording without T_tip cannot have been fitted")
    phases = np.asarray(fit.phases)
    model = np.asarray(fit.T_base), np.asarray(fit.T_tip)
    loop = plots.plot_fit(recording.T_base, recording.T_tip, simulated=model, phases=phases)
    residual = plots.plot_residual(
        recording.T_base, np.asarray(fit.residual), phases=phases, noise=fit.noise_N
    )
    band = "; the grey band is two standard deviations of the noise" if fit.noise_N else ""
    return [
        Figure(
            "fit",
            plots.png(loop),
            "The recording, coloured by the fitted model's phase, and the model's loop.",
        ),
        Figure(
            "residual",
            plots.png(residual),
            f"Simulated minus recorded tip tension, against base tension and along the recording{band}. "
            "A pattern means that the model lacks something.",
        ),
        *_profile_figure(fit),
    ]


def _profile_figure(fit: FitAnswer) -> list[Figure]:
    if not fit.profiles:
        return []
    curves = {}
    for e in fit.estimates:
        if e.name in fit.profiles:
            p = fit.profiles[e.name]
            display, factor = _display(e.unit)
            label = f"{e.name} [{display}]" if display else e.name
            curves[label] = (np.asarray(p.values) / factor, np.asarray(p.rise), np.asarray(p.parabola))
    return [
        Figure(
            "profiles",
            plots.png(plots.plot_profiles(curves)),
            "Rise of the sum of squares as one parameter is held and the others are fitted anew. Where it "
            "leaves the parabola of the standard error, believe the profile.",
        )
    ]


def _display(unit: str) -> tuple[str, float]:
    """The unit people write an SI quantity in, and its size in SI."""
    display = DIMENSIONS[unit].display if unit in DIMENSIONS and unit != "dimensionless" else ""
    return (display, convert(1.0, display, unit)) if display else (unit, 1.0)


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """An SI quantity in the unit people write it in."""
    display, factor = _display(unit)
    return number(None if value is None else value / factor, display, digits)


def _tables(fit: FitAnswer) -> list[Table]:
    estimates = [
        (
            e.name,
            quantity(e.value, e.unit),
            quantity(e.sd, e.unit, 2),
            f"{quantity(e.lower95, e.unit)} … {quantity(e.upper95, e.unit)}",
            quantity(e.initial, e.unit),
            e.note,
        )
        for e in fit.estimates
    ]
    base_noise = number(fit.noise_base_N, "N", 3) if fit.noise_base_N else "none: taken as exact"
    distance = [
        ("residual, root mean square", number(fit.rms_N, "N", 3)),
        ("noise of the tip cell, one sd", number(fit.noise_N, "N", 3)),
        ("noise of the base cell, one sd", base_noise),
        ("chi² per sample", number(fit.chi2_per_n, digits=3)),
    ]
    phases = [
        (phase, str(p["count"]), number(p["rms_N"], digits=3), number(p["mean_N"], digits=3))
        for phase, p in fit.by_phase.items()
    ]
    solver = [
        ("result", fit.result if fit.converged else f"not converged: {fit.result}"),
        ("iterations, evaluations", f"{fit.iterations}, {fit.evaluations}"),
    ]
    columns = ("parameter", "fitted", "standard error", "95 % interval", "before", "note")
    return [
        Table("Estimates", columns, estimates, note="Intervals are those of the model as it stands."),
        Table("Distance from the recording", ("", ""), distance),
        Table("By phase", ("phase", "samples", "rms [N]", "mean [N]"), phases),
        Table("Solver", ("", ""), solver),
    ]
