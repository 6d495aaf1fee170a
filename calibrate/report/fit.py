"""A fit in words, tables and pictures."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gtr_jax import equilibrium
from gtr_jax.files.numbers import measured_quantity, number, quantity
from gtr_jax.files.recording import Recording
from gtr_jax.files.units import display_of
from gtr_jax.plots.style import is_seen, png
from gtr_jax.report.page import Figure, Report, Table
from gtr_jax.report.spatial import shape_figure
from gtr_jax.simulation.displacement import by_tension
from gtr_jax.terms import REGISTRY

from ..channels import channels_in, quantity_of
from ..predictor import padded_history, simulated
from ..result import FitResult, FittedChannel, FittedRecording
from . import fit_figures as draw

NAMES = {"mu": "μ"}  # as pictures write them


def fit_report(fit: FitResult, recordings: Sequence[Recording], name: str) -> Report:
    """Verdict, figures and tables of a fit.

    Args:
        fit: from `calibrate.fit`.
        recordings: what was fitted.
        name: of the robot.
    """
    figures = [
        figure
        for fitted, recording in zip(fit.recordings, recordings, strict=True)
        for figure in _figures(fit, fitted, recording, several=len(recordings) > 1)
    ]
    return Report(
        title=f"{name}: fit",
        verdict=fit.verdict,
        warnings=fit.warnings,
        figures=[*figures, *_profile_figure(fit), *_posterior_figure(fit)],
        tables=_tables(fit),
    )


def _figures(fit: FitResult, fitted: FittedRecording, recording: Recording, *, several: bool) -> list[Figure]:
    if recording.T_tip is None:
        raise ValueError("a recording without T_tip cannot have been fitted")
    ending, whose = (f"-{fitted.name}", f"{fitted.name}: ") if several else ("", "")
    figures = []
    for i, tendon in enumerate(fitted.robot.tendons):
        own = f"-{tendon.name}" if tendon.name else ""
        of = f"{tendon.name}: " if tendon.name else ""
        pull = _pull(fitted, recording, i)
        figures += _of_tendon(fit, fitted, recording, pull, (f"{own}{ending}", f"{whose}{of}"))
    if fit.converged and fitted.robot.space:
        figures.append(_body(fitted, recording.time, ending, whose))
    seen = channels_in(recording, fitted.robot)
    others = {
        name: (seen[name], np.asarray(channel.simulated))
        for name, channel in fitted.channels.items()
        if quantity_of(name) != "T_tip"
    }
    if others:
        pull = _pull(fitted, recording, 0)
        over = pull.recorded, pull.model, pull.label
        if len(fitted.robot.tendons) > 1:
            samples = np.arange(1, len(recording) + 1.0)
            over = samples, samples, "sample"
        figures.append(
            Figure(
                f"channels{ending}",
                png(draw.plot_channels(*over[:2], others, phases=pull.phases, label=over[2])),
                f"{whose}What else was recorded, and the fitted model.",
            )
        )
    return figures


def _body(fitted: FittedRecording, time: np.ndarray | None, ending: str, whose: str) -> Figure:
    """The fitted body from three sides, at rest and where it was pulled most."""
    robot, drive = fitted.robot, np.asarray(fitted.T_base)
    drawn = tuple(tendon.drive == "displacement" for tendon in robot.tendons)
    run = simulated(robot, padded_history(drive, time, None, drawn=drawn))
    rest = equilibrium(by_tension(robot), np.zeros(drive.shape[1:]))
    pulls = np.asarray(run.T_base)[: len(drive)].reshape(len(drive), -1)
    top = int(np.argmax(np.max(pulls, axis=1)))
    figure = shape_figure(robot, run, rest, [(f"sample {top + 1}", top)])
    return dataclasses.replace(figure, name=f"{figure.name}{ending}", caption=f"{whose}{figure.caption}")


class _Pull(NamedTuple):
    """One tendon of a recording: what drives it, as recorded and in the model, as it is drawn, (K,) each; its
    label; the recorded tip tension [N], its fit, and the phases, (K,) each; half the width of the band [N].
    """

    recorded: np.ndarray
    model: np.ndarray
    label: str
    T_tip: np.ndarray
    fitted: FittedChannel
    phases: np.ndarray
    band: np.ndarray


def _pull(fitted: FittedRecording, recording: Recording, i: int) -> _Pull:
    def own(values: np.ndarray | None) -> np.ndarray:
        return np.asarray(values).reshape(len(recording), -1)[:, i]

    drawn = fitted.robot.tendons[i].drive == "displacement"
    factor, label = (1e3, draw.DRAWN) if drawn else (1.0, draw.PULL)
    return _Pull(
        recorded=factor * own(recording.displacement if drawn else recording.T_base),
        model=factor * own(fitted.T_base),
        label=label,
        T_tip=own(recording.T_tip),
        fitted=fitted.tips[i],
        phases=own(fitted.phases),
        band=own(_band(fitted)),
    )


def _of_tendon(
    fit: FitResult, fitted: FittedRecording, recording: Recording, pull: _Pull, named: tuple[str, str]
) -> list[Figure]:
    """Loop, course and residual of one tendon; `named` are the endings of their names and the words before
    their captions.
    """
    ending, whose = named
    simulated, left = np.asarray(pull.fitted.simulated), np.asarray(pull.fitted.residual)
    loop = draw.plot_fit(
        pull.recorded,
        pull.T_tip,
        simulated=(pull.model, simulated),
        phases=pull.phases,
        band=pull.band,
        found=[
            f"{NAMES.get(e.name, e.name)} = {measured_quantity(e.value, e.sd, e.unit)}" for e in fit.estimates
        ],
        label=pull.label,
    )
    tension = pull.recorded if pull.label == draw.PULL else None
    over_time = draw.plot_time(recording.time, tension, pull.T_tip, simulated=simulated, phases=pull.phases)
    residual = draw.plot_residual(
        pull.recorded, left, phases=pull.phases, noise=fitted.noise_N, label=pull.label
    )
    beside = "" if tension is None else ", with the tension at the base"
    drive = "displacement" if tension is None else "base tension"
    return [
        Figure(
            f"fit{ending}",
            png(loop),
            f"{whose}The recording, coloured by the fitted model's phase, and the model's "
            f"loop{_within(pull.band, simulated)}.",
        ),
        Figure(
            f"time{ending}",
            png(over_time),
            f"{whose}The same {'sample by sample' if recording.time is None else 'over time'}{beside}.",
        ),
        Figure(
            f"residual{ending}",
            png(residual),
            f"{whose}Simulated minus recorded tip tension, against {drive} and along it"
            f"{noise_band(fitted.noise_N, left)}. A pattern means that the model lacks something.",
        ),
    ]


def noise_band(noise: float | None, residual: np.ndarray) -> str:
    """Words about the noise [N] for the caption of a residual."""
    if not noise:
        return ""
    if is_seen(2 * noise, residual):
        return "; the grey band is two standard deviations of the noise"
    return f"; the noise, {number(noise, 'N', 2)}, is too small to be seen here"


def _within(band: np.ndarray, T_tip: np.ndarray) -> str:
    """Words about the band [N], (K,), for the caption of a loop."""
    if is_seen(float(np.max(band)), T_tip):
        return "; 95 in 100 samples lie within the grey band if the model is right"
    return f"; 95 in 100 samples lie within {number(float(np.max(band)), 'N', 2)} of it if the model is right"


def _band(fitted: FittedRecording) -> np.ndarray:
    """Half width of the band that holds 95 % of samples: noise and the parameters' uncertainty [N], (K,
    *tendons).
    """
    return 1.96 * np.hypot(np.asarray(fitted.band), fitted.noise_N or 0.0)


def _profile_figure(fit: FitResult) -> list[Figure]:
    if not fit.profiles:
        return []
    curves = {}
    for e in fit.estimates:
        if e.name in fit.profiles:
            p = fit.profiles[e.name]
            display, factor = display_of(e.unit)
            label = f"{e.name} [{display}]" if display else e.name
            curves[label] = (np.asarray(p.values) / factor, np.asarray(p.rise), np.asarray(p.parabola))
    return [
        Figure(
            "profiles",
            png(draw.plot_profiles(curves)),
            "Rise of the sum of squares as one parameter is held and the others are fitted anew. Where it "
            "leaves the parabola of the standard error, believe the profile.",
        )
    ]


def _posterior_figure(fit: FitResult) -> list[Figure]:
    if fit.posterior is None:
        return []
    draws = np.asarray(fit.posterior.draws)
    draws = draws.reshape(-1, draws.shape[-1])
    columns = {}
    for e, values in zip(fit.estimates, draws.T, strict=True):
        display, factor = display_of(e.unit)
        columns[f"{e.name} [{display}]" if display else e.name] = values / factor
    return [Figure("posterior", png(draw.plot_draws(columns)), "Draws from the posterior, and their shares.")]


def _posterior_table(fit: FitResult) -> list[Table]:
    if fit.posterior is None:
        return []
    p = fit.posterior
    rows = [
        (
            e.name,
            quantity(float(p.sd[i]), e.unit, 2),
            interval(float(p.lower95[i]), float(p.upper95[i]), float(p.sd[i]), e.unit),
            f"{p.effective[i]:.0f}",
            f"{p.rhat[i]:.3f}",
        )
        for i, e in enumerate(fit.estimates)
    ]
    chains, draws, _ = p.draws.shape
    note = f"{chains} chains of {draws} draws, {p.divergences} divergences; chains agree below R-hat 1.01."
    columns = ("parameter", "standard deviation", "95 % interval", "effective draws", "R-hat")
    return [Table("Posterior, by NUTS", columns, rows, note=note)]


def interval(low: float | None, high: float | None, sd: float | None, unit: str) -> str:
    """The ends of an interval, to the digits that the standard error leaves, with their unit once."""
    ends = [measured_quantity(end, sd, unit, error=False) for end in (low, high)]
    display = ends[1].partition(" ")[2]
    return f"{ends[0].removesuffix(display).rstrip()} to {ends[1]}"


def detectable(name: str, size: float | None, unit: str) -> str:
    """The smallest change of a number that would be seen; for a term's number, "not visible" beyond its usual
    range.
    """
    kind, _, own = name.partition(".")
    quantities = {q.name: q for q in REGISTRY[kind].quantities} if kind in REGISTRY else {}
    if size is not None and own in quantities:
        q = quantities[own]
        farthest = max(abs(end - float(q.null)) for end in q.usual)
        if not size <= farthest:
            return f"not visible at any usual size (up to {quantity(farthest, unit, 2)} from none)"
    return quantity(size, unit, 2)


def _tables(fit: FitResult) -> list[Table]:
    estimates = [
        (
            e.name,
            measured_quantity(e.value, e.sd, e.unit),
            interval(e.lower95, e.upper95, e.sd, e.unit),
            detectable(e.name, e.detectable, e.unit),
            quantity(e.initial, e.unit),
            e.note,
        )
        for e in fit.estimates
    ]
    columns = (
        *("parameter", "fitted ± standard error", "95 % interval", "smallest change seen", "before", "note"),
    )
    note = (
        "Intervals count the noise of the cells and all that the robot file calls uncertain; they are those "
        "of the model as it stands. The smallest change seen is found significant at 5 % "
        "in 95 of 100 recordings like these."
    )
    tables = [
        Table("Estimates", columns, estimates, note=note),
        *_made_of(fit),
        *_posterior_table(fit),
        *_agreement(fit),
        *_correlations(fit),
        *_distances(fit.recordings),
    ]
    several = len(fit.recordings) > 1
    phases = [
        (
            *([r.name] if several else []),
            phase,
            str(p["count"]),
            number(p["rms_N"], digits=3),
            number(p["mean_N"], digits=3),
        )
        for r in fit.recordings
        for phase, p in r.by_phase.items()
    ]
    heads = (*(["recording"] if several else []), "phase", "samples", "rms [N]", "mean [N]")
    solver = [
        ("result", fit.result if fit.converged else f"not converged: {fit.result}"),
        ("iterations, evaluations", f"{fit.iterations}, {fit.evaluations}"),
    ]
    return [*tables, Table("By phase", heads, phases), Table("Solver", ("", ""), solver)]


def _made_of(fit: FitResult) -> list[Table]:
    """What the intervals are made of, and the uncertain numbers that were fitted unasked."""
    rows = [(e.name, sources(e.made_of)) for e in fit.estimates if e.made_of]
    tables = []
    if rows:
        note = "Shares of the variance. A number's own name is what the robot file says of it beforehand."
        tables.append(
            Table("What the standard errors are made of", ("parameter", "sources"), rows, note=note)
        )
    carried = [
        (
            e.name,
            measured_quantity(e.value, e.sd, e.unit),
            quantity(e.initial, e.unit),
            e.note,
        )
        for e in fit.carried
    ]
    if carried:
        note = (
            "Nobody asked for these: the robot file calls them uncertain, so they are fitted within what it "
            "says of them. What is left of their uncertainty is in the intervals of the others."
        )
        heads = ("parameter", "fitted ± standard error", "before", "note")
        tables.append(Table("Carried along", heads, carried, note=note))
    return tables


def sources(made_of: Mapping[str, float], least: float = 0.0) -> str:
    """Sources of a variance with their shares from the least on, the largest first."""
    largest = sorted(made_of.items(), key=lambda item: -item[1])
    return ", ".join(f"{source} {100 * share:.0f} %" for source, share in largest if share >= least)


def _agreement(fit: FitResult) -> list[Table]:
    """Parameters from part of the samples alone."""
    rows = [
        (e.name, part, measured_quantity(e.value, e.sd, e.unit))
        for part, e in [
            *((f"{phase} alone", e) for phase, e in fit.mu_by_phase.items()),
            *((f"{which} alone", e) for each in fit.by_recording.values() for which, e in each.items()),
        ]
    ]
    columns = ("parameter", "from", "fitted ± standard error")
    return (
        [
            Table(
                "Do the parts agree?",
                columns,
                rows,
                note="All other parameters as fitted; what is uncertain of them is in the errors.",
            )
        ]
        if rows
        else []
    )


def _correlations(fit: FitResult) -> list[Table]:
    names = [e.name for e in fit.estimates]
    if len(names) < 2:
        return []
    rows = [
        (name, *(number(float(rho), digits=3) for rho in row))
        for name, row in zip(names, np.asarray(fit.correlation), strict=True)
    ]
    known = [(says, f"{number(100 * sd, digits=2)} %") for says, sd in fit.axes]
    return [
        Table("Correlations of the estimates", ("", *names), rows),
        Table(
            "What is known independently",
            ("change", "standard error"),
            known,
            note="Combinations of the parameters, the least known first.",
        ),
    ]


def _distances(recordings: Sequence[FittedRecording]) -> list[Table]:
    tables = []
    for r in recordings:
        base_noise = number(r.noise_base_N, "N", 3) if r.noise_base_N else "none: taken as exact"
        rows = [
            ("residual, root mean square", number(r.rms_N, "N", 3)),
            ("noise of the tip cell, one sd", number(r.noise_N, "N", 3)),
            ("noise of the base cell, one sd", base_noise),
            ("chi² per sample", number(r.chi2_per_n, digits=3)),
        ]
        steps = r.settings.get("samples_simulated", len(r.T_base))
        if steps < len(r.T_base):
            rows.append(("samples compared, simulated", f"{len(r.T_base)}, {steps}"))
        if r.outliers:
            rows.append(("samples that count less than half", str(r.outliers)))
        rows += [
            (f"{name}, root mean square", quantity(channel.rms, channel.unit, 3))
            for name, channel in r.channels.items()
            if name != "T_tip"
        ]
        of = f" {r.name}" if len(recordings) > 1 else " the recording"
        tables.append(Table(f"Distance from{of}", ("", ""), rows))
    return tables
