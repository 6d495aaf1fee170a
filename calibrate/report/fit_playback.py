"""A fitted recording to go through on the page: loop, course, residual, what else was compared, the body."""

from __future__ import annotations

from calibrate.fitting.fitted import FittedRecording
from calibrate.inference.channels import channels_in, quantity_of
from gtr_jax.plots.chart import Chart, Column, clock_of
from gtr_jax.recordings.recording import Recording
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import playback

from .fit_charts import (
    Over,
    channel_chart,
    course_chart,
    fitted_model,
    fitted_tendon,
    loop_chart,
    residual_charts,
)
from .recording_motion import Motion

OTHERS = 6  # channels beside tip tensions that are shown


def fit_playback(
    fitted: FittedRecording, recording: Recording, motion: Motion | None, *, named: str, most: int
) -> Playback:
    """One recording beside the fitted model.

    Args:
        fitted, recording: fitted and as it is.
        motion: the fitted robot moved along it.
        named: its name where there are several, else "".
        most: steps at which the body is shown.
    """
    clock, along = clock_of(recording.time, len(recording))
    names = [tendon.name for tendon in fitted.robot.tendons] if fitted.tips else []
    tendons = [fitted_tendon(fitted, i, recording) for i in range(len(names))]
    charts = []
    if tendons:
        charts = [
            loop_chart(tendons),
            course_chart(tendons, clock, along),
            *residual_charts(tendons, clock, along, fitted.noise_N),
        ]
    told = [column for t in tendons for column in (t.pull, t.tip, t.simulated, t.residual)]
    others = _others(fitted, recording, clock, along)
    charts += others
    told = told or [line.y for chart in others for line in chart.lines]
    ending = f"-{named}" if named else ""
    own = [f"-{name}" if name else "" for name in names]
    return playback(
        charts,
        clock=clock,
        told=told,
        unit="sample",
        first=0 if motion is None else int(motion.samples[motion.top]),
        body=None if motion is None else motion.body(most),
        stills=[f"{what}{o}{ending}" for what in ("fit", "time", "residual") for o in own],
        title=named,
    )


def _others(fitted: FittedRecording, recording: Recording, clock: Column, along: str) -> list[Chart]:
    """What was compared beside the tip tensions, each over the recording."""
    seen = channels_in(recording, fitted.robot)
    names = [name for name in fitted.channels if quantity_of(name) != "T_tip"][:OTHERS]
    return [
        channel_chart(name, Over(clock, clock, along), seen[name], [fitted_model(fitted, name)])
        for name in names
    ]
