"""A diagnosis in words, tables and pictures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calibrate.diagnosis.answer.loop import Loop
from calibrate.diagnosis.answer.result import Diagnosis
from calibrate.diagnosis.answer.sentence import MAY_ACT, interval_in_words
from calibrate.diagnosis.outside.leave_out import ASKED, STILL, LeftOut
from calibrate.fitting.verdict import in_unit
from calibrate.inference.channels import quantity_of
from gtr_jax.numbers import measured, measured_quantity, number, quantity
from gtr_jax.plots.chart_figure import plot_charts, typeset
from gtr_jax.recordings.base_tension import turning_points
from gtr_jax.report.page import Figure, Playback, Report, Table

from . import diagnosis_figures as draw
from .diagnosis_channels import channels_shown, named
from .diagnosis_charts import axis_of, is_found, label_of, still_charts
from .diagnosis_playback import diagnosis_playback
from .fit import detectable, sources
from .recording_figures import noise_band
from .recording_motion import BODIES, FEWEST

# Rivals drawn, at most; twice as many are listed.
SHOWN = 8
# Share of its range by which the base tension goes back at a reversal.
TURN = 0.02
# Share of a variance from which its source is named.
NAMED = 0.01


def diagnosis_report(answer: Diagnosis, name: str) -> Report:
    """Verdict, figures and tables of a diagnosis.

    Args:
        answer: from `calibrate.diagnose`.
        name: of the robot.
    """
    settles = [] if answer.settles is None else [answer.settles.says]
    next_step = [] if answer.experiment is None else [f"Measure next: {answer.experiment.says}"]
    return Report(
        title=f"{name}: diagnosis",
        verdict=answer.says,
        warnings=[*settles, *next_step, *answer.warnings],
        figures=list(_figures(answer)),
        tables=_tables(answer),
        playbacks=_playbacks(answer),
    )


def _playbacks(answer: Diagnosis) -> list[Playback]:
    several = len(answer.loops) > 1
    most = max(BODIES // max(len(answer.loops), 1), FEWEST)
    return [
        diagnosis_playback(answer, loop, named=loop.name if several else "", most=most)
        for loop in answer.loops
    ]


def first_figure(answer: Diagnosis) -> Figure | None:
    """The figure that shows most; None where there is none."""
    return next(_figures(answer), None)


def _figures(answer: Diagnosis) -> Iterator[Figure]:
    if answer.discovered is not None:
        caption = "The law that was found, over the range that the recordings cover, and nowhere else."
        yield Figure("law", draw.plot_law(answer.discovered), caption)
    for loop in answer.loops:
        for c in channels_shown(loop):
            yield from _of_channel(answer, loop, c)
    top = answer.rivals[:SHOWN]
    if len(top) > 1:
        names = [" + ".join(r.names) or "nothing missing" for r in top]
        chart = draw.plot_rivals(
            names, np.asarray([r.probability for r in top]), np.asarray([r.delta for r in top])
        )
        yield Figure("rivals", chart, "What else it could be: models refitted with mu and E.")
    if answer.experiment is not None:
        e = answer.experiment
        pulls = answer.loops[0].pulls
        drawn = draw.plot_history(
            e.time,
            e.T_base,
            e.T_tip,
            drawn=[pull.by_displacement for pull in pulls] if e.T_tip is None else (),
            names=[pull.tendon for pull in pulls],
        )
        yield Figure("next-experiment", drawn, answer.experiment.says)


def _of_channel(answer: Diagnosis, loop: Loop, c: int) -> list[Figure]:
    """The figures of one channel of a recording, with the names of recording and tendon where there are
    several.
    """
    pull, axis = loop.pulls[loop.of[c]], axis_of(loop.channels[c])
    ending, whose = named(loop, c, several=len(answer.loops) > 1)
    loop_chart, course, left = still_charts(answer, loop, c)
    after, label, noise = is_found(answer), label_of(answer), axis.size * loop.noise[c].sd
    drive = left[0].lines[0].x.values
    along = typeset(loop_chart.across)
    found = [
        Figure(
            f"loop{ending}",
            plot_charts([loop_chart], 3.9),
            f"{whose}The recording and the model, refitted to it"
            + (f" without and {label}." if after else "."),
        ),
        Figure(
            f"time{ending}",
            plot_charts(course, 1.8 + 1.8 * len(course)),
            f"{whose}The recording over time, and what is left of it"
            f"{', episodes numbered' if answer.episodes else ''}.",
        ),
        Figure(
            f"residual{ending}",
            plot_charts(left, 0.9 + 2.2 * len(left)),
            f"{whose}Where they differ{noise_band(noise, left[0].lines[0].y.values, axis.unit)}.",
        ),
    ]
    branches = pull.branches if after else pull.branches[:2]
    if branches and all(len(at) > 1 for at, _, _ in branches):
        found.append(
            Figure(
                f"branches{ending}",
                draw.plot_branches(branches, label, along=along),
                f"{whose}Release against pull at the same base tension: half the difference of "
                "ln(T_tip/T_base) is friction, half the sum what friction cannot do.",
            )
        )
    if loop.time is not None and float(np.ptp(loop.time)) > 0 and float(np.ptp(drive)) > 0:
        of = f" of {pull.tendon}" if pull.tendon else ""
        rates = np.gradient(drive, np.maximum.accumulate(loop.time) + 1e-9 * np.arange(len(loop.time)))
        drawn = draw.plot_against_rate(
            rates[loop.counted],
            _since_reversal(loop.time, drive)[loop.counted],
            left[-1].lines[0].y.values[loop.counted],
            noise=noise,
            unit=axis.unit,
            label=left[-1].title,
            along=f"rate of the displacement{of} [mm/s]"
            if pull.by_displacement
            else f"rate of $T_{{base}}${of} [N/s]",
        )
        caption = f"{whose}What is left of {axis.short} against rate, and against time since the base turned."
        found.append(Figure(f"rate{ending}", drawn, caption))
    return found


def _stretch(e: LeftOut) -> str:
    """A stretch that is left out, in words."""
    return f"{e.when}: {e.why}" if e.why in (ASKED, STILL) else e.why


def _since_reversal(time: np.ndarray, T_base: np.ndarray) -> np.ndarray:
    """Time since the base tension last turned [s], (K,), at least half the median step."""
    turns = turning_points(T_base, TURN * float(np.ptp(T_base)))
    last = np.asarray(turns)[np.searchsorted(turns, np.arange(len(T_base)), side="right") - 1]
    return np.maximum(time - time[last], 0.5 * float(np.median(np.diff(time))) or 1e-9)


def _differing(answer: Diagnosis) -> list[Table]:
    """The numbers that differ between recordings, and the robot files where there are several."""
    tables = []
    for d in answer.differ:
        rows = [
            (recording, quantity(change.after, d.unit), quantity(change.sd, d.unit, 2))
            for recording, change in answer.own(d).items()
        ]
        alike = "; ".join(" and ".join(group) for group in d.groups)
        note = (
            f"One value for all recordings would be {quantity(d.shared, d.unit)}, and leaves "
            f"{d.standard_errors:.0f} standard errors more. By value: {alike}. The standard deviations hold "
            "what is uncertain of all recordings in common, which a difference does not."
        )
        others = [*(f"{n} that differs" for n in d.or_numbers), *(f"{n} in all" for n in d.or_effects)]
        if others:
            note += f" Nearly as well: {', '.join(others)}."
        heads = ("recording", d.name, "standard deviation")
        tables.append(Table(f"What differs between the recordings: {d.name}", heads, rows, note=note))
    if len(answer.files) > 1:
        rows = [
            (f.name, " + ".join(f.effects) or "nothing missing", f.recording or "all", f"{f.probability:.3g}")
            for f in answer.files
        ]
        heads = ("file", "holds", "numbers of recording", "probability")
        tables.append(Table("Robot files", heads, rows, note=answer.files[0].note))
    return tables


def numbers_table(answer: Diagnosis) -> Table | None:
    """The numbers of the model before and after; None where there are none."""
    if not answer.parameters:
        return None
    rows = [
        (
            c.name,
            quantity(c.before, c.unit),
            measured_quantity(c.after, c.sd, c.unit),
            "" if c.averaged95 is None else " to ".join(interval_in_words(c.averaged95, c.unit)),
        )
        for c in answer.parameters
    ]
    heads = ("", "before", "after ± standard deviation", "95 %, averaged over models")
    note = (
        "The last column includes the rivals, each weighed by its probability, and any one further effect "
        "that these recordings neither show nor exclude (below)."
    )
    return Table("Numbers", heads, rows, note=note)


def _settled(answer: Diagnosis) -> list[Table]:
    """What became of the rivals of an earlier diagnosis."""
    if answer.settles is None:
        return []
    rows = [
        (
            " with ".join(r.terms),
            r.status,
            number(r.before, digits=2),
            number(r.after, digits=2),
            "not refitted" if r.behind is None else number(r.behind, digits=3),
        )
        for r in answer.settles.rivals
    ]
    heads = ("rival", "", "probability before", "now", "behind the best by [standard errors]")
    return [Table("What these recordings settle", heads, rows, note=answer.settles.says)]


def _tables(answer: Diagnosis) -> list[Table]:
    tables = [*_settled(answer), *_differing(answer)]
    if answer.where:
        rows = [(w.says, number(w.z, digits=3), f"{100 * w.share:.0f} %") for w in answer.where]
        tables.append(
            Table(
                "Where",
                ("part of the recording", "mean, standard errors", "share of the misfit"),
                rows,
                note="Of the best fit without anything missing. Refitting mu and E spreads a misfit over the "
                "whole loop: look at what is missing before you trust a place.",
            )
        )
    for title, stretches, note in (
        (
            "Episodes",
            [(f"{k}. {e.says}", f"{100 * e.share:.0f} %") for k, e in enumerate(answer.episodes, start=1)],
            "Stretches of time in which the model shown and the recording differ by more than the noise and "
            "by more than elsewhere.",
        ),
        (
            "Left out",
            [(_stretch(e), in_unit(e.size, e.unit)) for e in answer.left_out],
            "Simulated, so that the history continues, but not compared; the second column is the difference "
            "between simulation and recording there.",
        ),
    ):
        if stretches:
            heads = ("what happens", "share of the misfit" if title == "Episodes" else "rms")
            tables.append(Table(title, heads, stretches, note=note))
    numbers = numbers_table(answer)
    if numbers is not None:
        tables.append(numbers)
        rows = [(c.name, sources(c.made_of, NAMED)) for c in answer.parameters if c.made_of]
        note = (
            "Shares of the variance. The name of a number stands for what was known of it beforehand; errors "
            "of the mesh and of a law that is not quite right are counted too."
        )
        tables.append(Table("What the standard deviations are made of", ("", "sources"), rows, note=note))
    unseen = [h for h in answer.hidden if h.probability > MAY_ACT][:SHOWN]
    if unseen:
        rows = [
            (
                h.name,
                f"{h.probability:.2g}",
                f"{h.number} may differ from {h.null:g} by {quantity(h.largest, h.unit, 2)}",
                "" if h.mu95 is None else " to ".join(interval_in_words(h.mu95, "")),
            )
            for h in unseen
        ]
        heads = ("effect", "probability that it acts", "how large it may be (95 %)", "mu if it acts (95 %)")
        note = (
            "Effects beside the model shown, with the sizes that these recordings and the usual ranges "
            "allow; "
            "those that move mu most come first."
        )
        tables.append(Table("What may act unseen", heads, rows, note=note))
    if len(answer.held_out) > 1:
        before, after = answer.held_out
        tips = quantity_of(answer.loops[0].channels[0]) == "T_tip"
        unit, what = answer.unit, " of T_tip" if tips else ""
        rows = [
            (f"residual{what} on what was fitted, rms", *(in_unit(v, unit, 3) for v in answer.rms)),
            ("on what was held out, rms", *(in_unit(h["rms"], unit, 3) for h in answer.held_out)),
            ("chi² per sample, held out", *(number(h["chi2_per_n"], digits=3) for h in answer.held_out)),
            ("noise, as it should be left, rms", *(in_unit(answer.expected, unit, 3),) * 2),
        ]
        found = answer.discovered
        parts = "cycles, recordings, or stretches of one loop"
        if found is not None and found.pieces:
            parts = "every fourth of short pieces"
        note = (
            f"Held out in turn: {after['folds']:.0f} parts ({parts}); "
            f"the model with it is better in {after['best_in']:.0f}, without it in {before['best_in']:.0f}."
        )
        tables.append(Table("On data the fit has not seen", ("", "without", "with"), rows, note=note))
    if answer.rivals:
        rows = [
            (
                " + ".join(r.names) or "nothing missing",
                f"{r.probability:.3g}",
                number(r.delta, digits=3),
                number(r.chi2_per_n, digits=3),
                f"{r.failed} steps" if r.failed else "",
            )
            for r in answer.rivals[: 2 * SHOWN]
        ]
        refitted = {" + ".join(r.names) for r in answer.rivals}
        rows += [
            (what, f"{p:.3g}", "", "", "") for what, p in answer.probability.items() if what not in refitted
        ]
        heads = ("model", "probability", "better by [standard errors]", "chi² per sample", "not converged")
        tables.append(Table("Rivals", heads, rows))
        kinds = dict.fromkeys(name.partition(".")[0] for r in answer.rivals[:4] for name in r.names)
        told = [(kind, answer.catalogue[kind].says, answer.catalogue[kind].told_apart) for kind in kinds]
        if told:
            tables.append(Table("How to tell them apart", ("term", "what it is", "experiment"), told))
    if answer.strata:
        rows = [(part, measured(v, sd), number(own, digits=2)) for part, v, sd, own in answer.strata]
        heads = ("part", "mu ± standard error", "standard error from its own noise")
        note = (
            "All other numbers as fitted, nothing added. What is uncertain of them moves all parts together: "
            "to compare two parts, take the last column."
        )
        title = "Friction from parts of the recording, by the base model"
        tables.append(Table(title, heads, rows, note=note))
    if answer.experiment is not None:
        rows = [(what, number(v, digits=3)) for what, v in answer.experiment.menu]
        tables.append(Table("What to measure next", ("experiment", "tells apart by [standard errors]"), rows))
    if answer.smallest_detectable:
        units = {f"{t.id}.{q.name}": q.unit for t in answer.catalogue.values() for q in t.numbers}
        rows = [
            (name, detectable(name, v, units[".".join(name.split(".")[:2])]))
            for name, v in sorted(answer.smallest_detectable.items())
        ]
        note = (
            "Changes from null that move the recordings by "
            f"{answer.settings['seen_standard_errors']:g} standard errors once mu and E have followed."
        )
        tables.append(Table("Smallest effects that would have been seen", ("", "size"), rows, note=note))
    return tables
