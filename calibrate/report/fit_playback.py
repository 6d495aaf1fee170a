"""A fitted recording to go through on the page: loop, course, residual, what else was compared, the body."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from calibrate.fitting.fitted import FittedRecording
from calibrate.inference.channels import channels_in, quantity_of, unit_of
from gtr_jax.plots.style import GREY, INK
from gtr_jax.plots.tendons import COLOURS
from gtr_jax.recordings.recording import Recording
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import Chart, Column, Line, clock_of, playback

from .fit_figures import LABELS, SHOWN
from .recording_figures import of_tendon
from .recording_motion import Motion

DRIVES = {"tension": "tension at the base [N]", "displacement": "displacement at the base [mm]"}
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
    loops, course, left, against, told = [], [], [], [], []
    tendons = fitted.robot.tendons if fitted.tips else ()
    for i, tendon in enumerate(tendons):
        drawn = tendon.drive == "displacement"
        of = f" of {tendon.name}" if tendon.name else ""
        factor, unit = (1e3, "mm") if drawn else (1.0, "N")
        what = f"displacement{of}" if drawn else f"T_base{of}"
        given = recording.displacement if drawn else recording.T_base
        pull = Column(f"{what}, recorded", unit, factor * of_tendon(i, given))
        model = Column(f"{what}, fitted", unit, factor * of_tendon(i, fitted.T_base))
        tip = Column(f"T_tip{of}, recorded", "N", of_tendon(i, recording.T_tip))
        fits = Column(f"T_tip{of}, fitted model", "N", np.asarray(fitted.tips[i].simulated))
        residual = Column(f"simulated − recorded{of}", "N", np.asarray(fitted.tips[i].residual))
        half = 1.96 * np.hypot(of_tendon(i, fitted.band), fitted.noise_N or 0.0)
        band = Column(f"95 % of samples{of}, half width", "N", half)
        dots = functools.partial(Line, style="dots", phases=of_tendon(i, fitted.phases))
        if len(tendons) > 1:
            dots = functools.partial(Line, style="dots", colour=COLOURS[i % len(COLOURS)])
        loops += [dots(pull, tip), Line(model, fits, INK, band=band)]
        course += [] if drawn else [Line(clock, pull, GREY, "dashed")]
        course += [dots(clock, tip), Line(clock, fits, INK)]
        left.append(dots(clock, residual))
        against.append(dots(pull, residual))
        told += [pull, tip, fits, residual]
    drive = across([tendon.drive for tendon in tendons])
    charts = []
    if loops:
        difference = "simulated − recorded T_tip [N]"
        charts = [
            Chart("Loop", drive, "tension at the tip [N]", loops),
            Chart("Tensions", along, "tension [N]", course),
            Chart("Residual over the recording", along, difference, left, fitted.noise_N),
            Chart("Residual over the pull", drive, difference, against, fitted.noise_N),
        ]
    others = _others(fitted, recording, clock, along)
    charts += others
    told = told or [line.y for chart in others for line in chart.lines]
    ending = f"-{named}" if named else ""
    own = [f"-{tendon.name}" if tendon.name else "" for tendon in tendons]
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


def across(drives: Sequence[str]) -> str:
    """Label of the axis of what drives the tendons, by tension or displacement each."""
    kinds = set(drives)
    return DRIVES[kinds.pop()] if len(kinds) == 1 else "tension [N] or displacement [mm] at the base"


def _others(fitted: FittedRecording, recording: Recording, clock: Column, along: str) -> list[Chart]:
    """What was compared beside the tip tensions, each over the recording."""
    seen = channels_in(recording, fitted.robot)
    names = [name for name in fitted.channels if quantity_of(name) != "T_tip"][:OTHERS]
    return [
        channel_chart(
            name, clock, along, seen[name], [("fitted model", fitted.channels[name].simulated, INK)]
        )
        for name in names
    ]


def channel_chart(
    name: str,
    clock: Column,
    along: str,
    recorded: np.ndarray,
    models: Sequence[tuple[str, np.ndarray, str]],
) -> Chart:
    """One channel over a recording of K samples.

    Args:
        name: of the channel.
        clock, along: time or number of the samples, and the label of that axis.
        recorded: SI, (K,).
        models: what each is called, what it simulates, SI, (K,), and its colour.
    """
    quantity, _, tendon = name.partition(".")
    unit, factor = SHOWN[unit_of(name)]
    words = LABELS.get(quantity, quantity.replace("_", " ")).replace("$", "")
    words = " of ".join(filter(None, (words, tendon)))
    lines = [Line(clock, Column(f"{words}, recorded", unit, factor * np.asarray(recorded)), GREY, "dots")]
    lines += [
        Line(clock, Column(f"{words}, {label}", unit, factor * np.asarray(values)), colour)
        for label, values, colour in models
    ]
    return Chart(words[0].upper() + words[1:], along, f"{words} [{unit}]", lines)
