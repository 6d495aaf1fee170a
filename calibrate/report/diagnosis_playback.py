"""A diagnosed recording to go through on the page: loop, course and what is left, without and with what was
missing, and the body.
"""

from __future__ import annotations

import numpy as np

from calibrate.diagnosis.answer.loop import Loop, Pull
from calibrate.diagnosis.answer.result import Diagnosis
from gtr_jax.plots.style import BLUE, GREY, ORANGE, PURPLE, VERMILLION
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import Chart, Column, Line, Span, clock_of, playback
from gtr_jax.robot.build import build_robot

from .diagnosis_channels import channels_shown
from .diagnosis_channels import named as naming
from .diagnosis_figures import TIP, axis_of
from .fit_playback import OTHERS, across, channel_chart
from .recording_motion import Motion, motion_along


def diagnosis_playback(
    answer: Diagnosis, loop: Loop, label: str, *, found: bool, named: str, most: int
) -> Playback:
    """One recording beside the models.

    Args:
        answer: the diagnosis.
        loop: the recording.
        label: what the model that is shown has.
        found: whether that differs from the base model.
        named: name of the recording where there are several, else "".
        most: steps at which the body is shown.
    """
    clock, along = clock_of(loop.time, loop.recorded.shape[1])

    def models(i: int) -> list[tuple[str, np.ndarray, str]]:
        before = ("best fit without" if found else "best fit", loop.before[i], VERMILLION)
        return [before, (label, loop.after[i], BLUE)] if found else [before]

    loops, course, left, told = [], [], [], []
    drives = [_drive_of(pull) for pull in loop.pulls]
    told += drives
    shown = channels_shown(loop)
    axes = [axis_of(loop.channels[c]) for c in shown]
    tensions = all(axis is TIP for axis in axes)
    if tensions:
        course += [
            Line(clock, drive, PURPLE, "dashed")
            for drive, pull in zip(drives, loop.pulls, strict=True)
            if not pull.by_displacement
        ]
    for c, axis in zip(shown, axes, strict=True):
        pull, drive = loop.pulls[loop.of[c]], drives[loop.of[c]]
        tendon = f" of {pull.tendon}" if pull.tendon else ""
        what = f"T_tip{tendon}" if axis is TIP else axis.short
        recorded = Column(f"{what}, recorded", axis.unit, axis.size * np.asarray(loop.recorded[c]))
        loops.append(Line(drive, recorded, GREY, "dots"))
        course.append(Line(clock, recorded, GREY, "dots"))
        told.append(recorded)
        for name, values, colour in models(c):
            model = Column(f"{what}, {name}", axis.unit, axis.size * np.asarray(values))
            of = tendon if axis is TIP else f", {axis.short}"
            residual = Column(f"simulated − recorded{of}, {name}", axis.unit, model.values - recorded.values)
            loops.append(Line(drive, model, colour))
            course.append(Line(clock, model, colour))
            left.append(Line(clock, residual, colour))
            told.append(model)
    drive_axis = across(["displacement" if pull.by_displacement else "tension" for pull in loop.pulls])
    noise, unit = max(axes[0].size * loop.noise[c].sd for c in shown), axes[0].unit
    others = [c for c in range(len(loop.channels)) if c not in shown]
    all_of = "tension at the tip" if tensions else axes[0].label if len(shown) == 1 else "what was recorded"
    charts = [
        Chart("Loop", drive_axis, f"{all_of} [{unit}]", loops),
        Chart(
            "Tensions" if tensions else "Course",
            along,
            f"{'tension' if tensions else all_of} [{unit}]",
            course,
        ),
        Chart(
            "What is left",
            along,
            f"simulated − recorded{' T_tip' if tensions else ''} [{unit}]",
            left,
            noise,
            _spans(answer, loop),
        ),
        *(
            channel_chart(loop.channels[c], clock, along, loop.recorded[c], models(c))
            for c in others[:OTHERS]
        ),
    ]
    motion = _motion(answer, loop)
    own = [naming(loop, c, several=bool(named)).ending for c in shown]
    return playback(
        charts,
        clock=clock,
        told=told,
        unit="sample",
        first=0 if motion is None else int(motion.samples[motion.top]),
        body=None if motion is None else motion.body(most),
        stills=[f"{what}{o}" for what in ("loop", "time") for o in own],
        title=named,
    )


def _drive_of(pull: Pull) -> Column:
    """What drives a tendon."""
    of = f" of {pull.tendon}" if pull.tendon else ""
    what, factor, unit = ("displacement", 1e3, "mm") if pull.by_displacement else ("T_base", 1.0, "N")
    return Column(f"{what}{of}", unit, factor * np.asarray(pull.drive))


def _spans(answer: Diagnosis, loop: Loop) -> list[Span]:
    """Episodes, numbered as in their table, and what is left out."""

    def ends(e) -> tuple[float, float]:
        return (e.first + 1.0, e.last + 1.0) if e.start_s is None else (e.start_s, e.end_s)

    spans = [
        Span(*ends(e), "episode", f"{k} {e.tendon}".strip(), ORANGE)
        for k, e in enumerate(answer.episodes, start=1)
        if e.recording == loop.name
    ]
    return [
        *(Span(*ends(e), "left out", "", GREY) for e in answer.left_out if e.recording == loop.name),
        *spans,
    ]


def _motion(answer: Diagnosis, loop: Loop) -> Motion | None:
    """The robot that is shown, with the numbers of this recording, moved along it; None where there is none
    or not all that drives its tendons is known.
    """
    own = [f.config for f in answer.files if f.settled and f.recording == loop.name]
    config = next(iter(own), answer.config)
    if config is None or len(loop.pulls) != len(config.strung):
        return None
    drives = [np.asarray(pull.drive) for pull in loop.pulls]
    drive = np.stack(drives, axis=1) if config.tendon_names else drives[0]
    return motion_along(build_robot(config), drive, loop.time)
