"""Pictures of one recording beside the model that was fitted to it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing

from calibrate.fitting.fitted import FittedRecording
from calibrate.fitting.result import FitResult
from calibrate.inference.channels import channels_in, quantity_of
from gtr_jax import equilibrium
from gtr_jax.numbers import measured_quantity, number
from gtr_jax.plots.chart import clock_of
from gtr_jax.plots.chart_figure import plot_charts
from gtr_jax.plots.style import is_seen
from gtr_jax.recordings.recording import Recording
from gtr_jax.report.page import Figure
from gtr_jax.report.spatial import shape_figure
from gtr_jax.simulation.displacement import by_tension

from .fit_charts import (
    Over,
    channel_chart,
    course_chart,
    drive_of,
    fitted_model,
    fitted_tendon,
    loop_chart,
    residual_charts,
)
from .recording_motion import Motion

NAMES = {"mu": "μ"}  # as pictures write them
MANY = 6  # channels, from which on they are drawn lower


def recording_figures(
    fit: FitResult,
    fitted: FittedRecording,
    recording: Recording,
    *,
    several: bool,
    motion: Motion | None,
) -> list[Figure]:
    """Of each tendon whose tip tension was recorded the loop, its course and the residual; the body in space;
    and everything else that was compared.

    Args:
        fit: which the recording is part of.
        fitted, recording: the recording, fitted and as it is.
        several: whether there are others.
        motion: the fitted robot moved along the recording, for the body in space; None to draw none.
    """
    ending, whose = (f"-{fitted.name}", f"{fitted.name}: ") if several else ("", "")
    figures = []
    for i, tendon in enumerate(fitted.robot.tendons if fitted.tips else ()):
        own = f"-{tendon.name}" if tendon.name else ""
        of = f"{tendon.name}: " if tendon.name else ""
        figures += _of_tendon(fit, fitted, recording, i, (f"{own}{ending}", f"{whose}{of}"))
    if motion is not None and fitted.robot.space:
        figures.append(_body(motion, ending, whose))
    others = [name for name in fitted.channels if quantity_of(name) != "T_tip"]
    if others:
        figures.append(
            Figure(
                f"channels{ending}",
                _channels(fitted, recording, others),
                f"{whose}What {'else ' if fitted.tips else ''}was recorded, and the fitted model.",
            )
        )
    return figures


def _channels(fitted: FittedRecording, recording: Recording, names: Sequence[str]) -> Drawing:
    """Channels over what drives the tendon, or of several tendons over the samples."""
    over = drive_of(fitted, 0, recording)
    if len(fitted.robot.tendons) > 1:
        samples, label = clock_of(None, len(recording))
        over = Over(samples, samples, label, over.phases)
    seen = channels_in(recording, fitted.robot)
    charts = [channel_chart(name, over, seen[name], [fitted_model(fitted, name)]) for name in names]
    each = 2.2 if len(names) < MANY else 1.8
    return plot_charts(charts, 1.0 + each * len(names))


def _body(motion: Motion, ending: str, whose: str) -> Figure:
    """The fitted body from three sides, at rest and where it was pulled most."""
    robot = motion.robot
    rest = equilibrium(by_tension(robot), np.zeros(np.shape(motion.run.T_base)[1:]))
    named = [(f"sample {motion.samples[motion.top] + 1}", motion.top)]
    figure = shape_figure(robot, motion.run, rest, named)
    return dataclasses.replace(figure, name=f"{figure.name}{ending}", caption=f"{whose}{figure.caption}")


def _of_tendon(
    fit: FitResult, fitted: FittedRecording, recording: Recording, i: int, named: tuple[str, str]
) -> list[Figure]:
    """Loop, course and residual of tendon i; `named` are the endings of their names and the words before
    their captions.
    """
    ending, whose = named
    tendon = fitted_tendon(fitted, i, recording)
    clock, along = clock_of(recording.time, len(recording))
    over_clock, over_pull = residual_charts([tendon], clock, along, fitted.noise_N)
    found = [
        f"{NAMES.get(e.name, e.name)} = {measured_quantity(e.value, e.sd, e.unit)}" for e in fit.estimates
    ]
    drawn = tendon.drive == "displacement"
    beside = "" if drawn else ", with the tension at the base"
    return [
        Figure(
            f"fit{ending}",
            plot_charts([loop_chart([tendon])], 3.9, found),
            f"{whose}The recording, coloured by the fitted model's phase, and the model's "
            f"loop{_within(tendon.band.values, tendon.simulated.values)}.",
        ),
        Figure(
            f"time{ending}",
            plot_charts([course_chart([tendon], clock, along)], 3.2),
            f"{whose}The same {'sample by sample' if recording.time is None else 'over time'}{beside}.",
        ),
        Figure(
            f"residual{ending}",
            plot_charts([over_pull, over_clock], 5.6),
            f"{whose}Simulated minus recorded tip tension, against "
            f"{'displacement' if drawn else 'base tension'} and along the recording"
            f"{noise_band(fitted.noise_N, tendon.residual.values)}. "
            "A pattern means that the model lacks something.",
        ),
    ]


def noise_band(noise: float | None, residual: np.ndarray, unit: str = "N") -> str:
    """Words about the noise, in the unit of the residual, for the caption of that."""
    if not noise:
        return ""
    if is_seen(2 * noise, residual):
        return "; the grey band is two standard deviations of the noise"
    return f"; the noise, {number(noise, unit, 2)}, is too small to be seen here"


def _within(band: np.ndarray, T_tip: np.ndarray) -> str:
    """Words about the band [N], (K,), for the caption of a loop."""
    if is_seen(float(np.max(band)), T_tip):
        return "; 95 in 100 samples lie within the grey band if the model is right"
    return f"; 95 in 100 samples lie within {number(float(np.max(band)), 'N', 2)} of it if the model is right"
