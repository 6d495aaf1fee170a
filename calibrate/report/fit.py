"""A fit in words, tables and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibrate.fitting.fitted import FittedRecording
from calibrate.fitting.result import FitResult
from gtr_jax.numbers import measured_quantity, number, quantity
from gtr_jax.recordings.recording import Recording
from gtr_jax.report.page import Figure, Report, Table
from gtr_jax.terms import REGISTRY
from gtr_jax.units import display_of

from . import fit_figures as draw
from .fit_playback import fit_playback
from .recording_figures import recording_figures
from .recording_motion import BODIES, FEWEST, motion_along


def fit_report(fit: FitResult, recordings: Sequence[Recording], name: str) -> Report:
    """Verdict, figures and tables of a fit.

    Args:
        fit: from `calibrate.fit`.
        recordings: what was fitted.
        name: of the robot.
    """
    figures, playbacks, several = [], [], len(recordings) > 1
    for fitted, recording in zip(fit.recordings, recordings, strict=True):
        motion = motion_along(fitted.robot, fitted.T_base, recording.time) if fit.converged else None
        figures += recording_figures(fit, fitted, recording, several=several, motion=motion)
        most = max(BODIES // len(recordings), FEWEST)
        own = fitted.name if several else ""
        playbacks.append(fit_playback(fitted, recording, motion, named=own, most=most))
    return Report(
        title=f"{name}: fit",
        verdict=fit.verdict,
        warnings=fit.warnings,
        figures=[*figures, *_profile_figure(fit), *_posterior_figure(fit)],
        tables=_tables(fit),
        playbacks=playbacks,
    )


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
            draw.plot_profiles(curves),
            "Rise of the sum of squares as one parameter is held and the others are fitted again. Where it "
            "leaves the parabola of the standard error, trust the profile.",
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
    return [Figure("posterior", draw.plot_draws(columns), "Draws from the posterior, and their shares.")]


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
    by_phase = [Table("By phase", heads, phases)] if any(r.tips for r in fit.recordings) else []
    return [*tables, *by_phase, Table("Solver", ("", ""), solver)]


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
            "These were not asked for: the robot file calls them uncertain, so they are fitted within that "
            "uncertainty. What is left of it is in the intervals of the others."
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
        tip = [
            ("residual, root mean square", number(r.rms_N, "N", 3)),
            ("noise of the tip cell, one sd", number(r.noise_N, "N", 3)),
        ]
        chi2 = [("chi² per sample", number(r.chi2_per_n, digits=3))]
        base_noise = number(r.noise_base_N, "N", 3) if r.noise_base_N else "none: taken as exact"
        base = [("noise of the base cell, one sd", base_noise)]
        rows = [*tip, *base, *chi2] if r.tips else base
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
