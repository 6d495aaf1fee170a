"""The charts of a diagnosed recording, which its page plays and from which its figures are drawn: loop,
course and what is left, without and with what was missing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.answer.loop import Loop, Pull
from calibrate.diagnosis.answer.result import Diagnosis
from calibrate.inference.channels import quantity_of, unit_of, words_of
from gtr_jax.plots.chart import Chart, Column, Line, Span, clock_of
from gtr_jax.plots.style import BLUE, GREY, ORANGE, PURPLE, VERMILLION

from .fit_charts import DRIVES, SHOWN, across


class Axis(NamedTuple):
    """How a channel is drawn: its label, its short name, the unit on paper, and that unit per SI unit."""

    label: str
    short: str
    unit: str
    size: float


LEFT_OUT = "left out"
TIP = Axis("tension at the tip", "T_tip", "N", 1.0)


def axis_of(channel: str) -> Axis:
    """How a channel is drawn."""
    if quantity_of(channel) == "T_tip":
        return TIP
    words = words_of(channel).removeprefix("the ")
    return Axis(words, words, *SHOWN[unit_of(channel)])


def label_of(answer: Diagnosis) -> str:
    """What the model that is shown has, in words."""
    return "with the nearest term" if answer.verdict == "unexplained" else "with what was missing"


def is_found(answer: Diagnosis) -> bool:
    """Whether a model with something missing is shown; where the verdict is "unexplained", the nearest."""
    return len(answer.held_out) > 1


def models_of(answer: Diagnosis, loop: Loop, c: int) -> list[tuple[str, np.ndarray, str]]:
    """The models beside channel c: what each is called, what it simulates, SI, (K,), and its colour."""
    found = is_found(answer)
    before = ("best fit without" if found else "best fit", loop.before[c], VERMILLION)
    return [before, (label_of(answer), loop.after[c], BLUE)] if found else [before]


class DiagnosisCharts(NamedTuple):
    """Charts of some channels of a recording.

    Attributes:
        loop: over what drives the tendons.
        course, left: what was recorded with the models, and what these leave, over the recording.
        columns: what drives the tendons, and what was recorded and simulated.
    """

    loop: Chart
    course: Chart
    left: Chart
    columns: list[Column]


def diagnosis_charts(
    answer: Diagnosis, loop: Loop, channels: Sequence[int], pulls: Sequence[int], clock: tuple[Column, str]
) -> DiagnosisCharts:
    """Loop, course and what is left.

    Args:
        answer: the diagnosis.
        loop: the recording.
        channels: numbers of the channels, all of them tip tensions or none.
        pulls: numbers of the tendons, among them those of the channels.
        clock: time or number of the samples, and the label of that axis.
    """
    at, along = clock
    drives = {i: drive_of(loop.pulls[i]) for i in pulls}
    axes = [axis_of(loop.channels[c]) for c in channels]
    tensions = all(axis is TIP for axis in axes)
    loops, course, left, columns = [], [], [], list(drives.values())
    if tensions:
        course += [
            Line(at, drive, PURPLE, "dashed")
            for i, drive in drives.items()
            if not loop.pulls[i].by_displacement
        ]
    for c, axis in zip(channels, axes, strict=True):
        pull, drive = loop.pulls[loop.of[c]], drives[loop.of[c]]
        tendon = f" of {pull.tendon}" if pull.tendon else ""
        what = f"T_tip{tendon}" if axis is TIP else axis.short
        recorded = Column(f"{what}, recorded", axis.unit, axis.size * np.asarray(loop.recorded[c]))
        loops.append(Line(drive, recorded, GREY, "dots"))
        course.append(Line(at, recorded, GREY, "dots"))
        columns.append(recorded)
        for name, values, colour in models_of(answer, loop, c):
            model = Column(f"{what}, {name}", axis.unit, axis.size * np.asarray(values))
            of = tendon if axis is TIP else f", {axis.short}"
            residual = Column(f"simulated − recorded{of}, {name}", axis.unit, model.values - recorded.values)
            loops.append(Line(drive, model, colour))
            course.append(Line(at, model, colour))
            left.append(Line(at, residual, colour))
            columns.append(model)
    noise, unit = max(axes[0].size * loop.noise[c].sd for c in channels), axes[0].unit
    all_of = (
        "tension at the tip" if tensions else axes[0].label if len(channels) == 1 else "what was recorded"
    )
    difference = f"simulated − recorded{' T_tip' if tensions else ''} [{unit}]"
    spans = _spans(answer, loop, [loop.pulls[i].tendon for i in pulls])
    return DiagnosisCharts(
        Chart("Loop", drive_label(loop, pulls), f"{all_of} [{unit}]", loops),
        Chart(
            "Tensions" if tensions else "Course",
            along,
            f"{'tension' if tensions else all_of} [{unit}]",
            course,
        ),
        Chart("What is left", along, difference, left, noise, spans),
        columns,
    )


def drive_of(pull: Pull) -> Column:
    """What drives a tendon."""
    of = f" of {pull.tendon}" if pull.tendon else ""
    what, factor, unit = ("displacement", 1e3, "mm") if pull.by_displacement else ("T_base", 1.0, "N")
    return Column(f"{what}{of}", unit, factor * np.asarray(pull.drive))


def drive_label(loop: Loop, pulls: Sequence[int]) -> str:
    """Label of the axis of what drives these tendons, with the name of one among several."""
    label = across(["displacement" if loop.pulls[i].by_displacement else "tension" for i in pulls])
    if len(pulls) == 1 < len(loop.pulls):
        return label.replace(" at the base", f" at the base of {loop.pulls[pulls[0]].tendon}")
    return label


def still_charts(answer: Diagnosis, loop: Loop, c: int) -> tuple[Chart, list[Chart], list[Chart]]:
    """Of one channel the loop, the charts of its course, and what each model leaves over what drives the
    tendon.
    """
    i = loop.of[c]
    pull, axis = loop.pulls[i], axis_of(loop.channels[c])
    at, along = clock_of(loop.time, loop.recorded.shape[1])
    along += f", {pull.tendon}" if pull.tendon else ""
    charts = diagnosis_charts(answer, loop, [c], [i], (at, along))
    left_out = [span for span in charts.left.spans if span.label == LEFT_OUT]
    course = [dataclasses.replace(charts.course, spans=left_out), charts.left]
    if axis is not TIP and not pull.by_displacement:
        drive = Line(at, charts.columns[0], PURPLE, "dashed")
        course.insert(0, Chart("Drive", along, DRIVES["tension"], [drive], spans=left_out))
    left = [
        Chart(
            line.y.label.rpartition(", ")[2],
            charts.loop.across,
            f"simulated − recorded [{axis.unit}]",
            [Line(charts.columns[0], line.y, style="dots", phases=np.asarray(pull.phases))],
            charts.left.noise,
        )
        for line in charts.left.lines
    ]
    return charts.loop, course, left


def _spans(answer: Diagnosis, loop: Loop, tendons: Sequence[str]) -> list[Span]:
    """Episodes of these tendons, numbered as in their table, and what is left out."""

    def ends(e) -> tuple[float, float]:
        return (e.first + 1.0, e.last + 1.0) if e.start_s is None else (e.start_s, e.end_s)

    spans = [
        Span(*ends(e), "episode", f"{k} {e.tendon}".strip(), ORANGE)
        for k, e in enumerate(answer.episodes, start=1)
        if e.recording == loop.name and e.tendon in tendons
    ]
    return [
        *(Span(*ends(e), LEFT_OUT, "", GREY) for e in answer.left_out if e.recording == loop.name),
        *spans,
    ]
