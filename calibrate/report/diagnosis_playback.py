"""A diagnosed recording to go through on the page: loop, course and what is left, without and with what was
missing, and the body.
"""

from __future__ import annotations

import numpy as np

from gtr_jax.plots.style import BLUE, GREY, ORANGE, PURPLE, VERMILLION
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import Chart, Column, Line, Span, playback
from gtr_jax.robot.build import build_robot

from ..diagnosis.result import Diagnosis, Loop
from .fit_playback import DRIVES, OTHERS, channel_chart
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
    K = loop.recorded.shape[1]
    number = Column("sample", "", np.arange(1.0, K + 1))
    clock = number if loop.time is None else Column("time", "s", np.asarray(loop.time))
    along = "sample" if loop.time is None else "time [s]"

    def models(i: int) -> list[tuple[str, np.ndarray, str]]:
        before = ("best fit without" if found else "best fit", loop.before[i], VERMILLION)
        return [before, (label, loop.after[i], BLUE)] if found else [before]

    loops, course, left, told = [], [], [], []
    for i, pull in enumerate(loop.pulls):
        of = f" of {pull.tendon}" if pull.tendon else ""
        drawn = pull.by_displacement
        what, factor, unit = ("displacement", 1e3, "mm") if drawn else ("T_base", 1.0, "N")
        drive = Column(f"{what}{of}", unit, factor * np.asarray(pull.drive))
        recorded = Column(f"T_tip{of}, recorded", "N", np.asarray(loop.recorded[i]))
        loops.append(Line(drive, recorded, GREY, "dots"))
        course += [] if drawn else [Line(clock, drive, PURPLE, "dashed")]
        course.append(Line(clock, recorded, GREY, "dots"))
        told += [drive, recorded]
        for name, values, colour in models(i):
            tip = Column(f"T_tip{of}, {name}", "N", np.asarray(values))
            residual = Column(f"simulated − recorded{of}, {name}", "N", tip.values - recorded.values)
            loops.append(Line(drive, tip, colour))
            course.append(Line(clock, tip, colour))
            left.append(Line(clock, residual, colour))
            told.append(tip)
    kinds = {"displacement" if pull.by_displacement else "tension" for pull in loop.pulls}
    across = DRIVES[kinds.pop()] if len(kinds) == 1 else "tension [N] or displacement [mm] at the base"
    noise = max(pull.noise_N for pull in loop.pulls)
    others = list(enumerate(loop.channels))[loop.tips :][:OTHERS]
    charts = [
        Chart("Loop", across, "tension at the tip [N]", loops),
        Chart("Tensions", along, "tension [N]", course),
        Chart("What is left", along, "simulated − recorded T_tip [N]", left, noise, _spans(answer, loop)),
        *(channel_chart(name, clock, along, loop.recorded[i], models(i)) for i, name in others),
    ]
    motion = _motion(answer, loop)
    ending = [named] * bool(named)
    own = ["".join(f"-{n}" for n in ending + [pull.tendon] * bool(pull.tendon)) for pull in loop.pulls]
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
