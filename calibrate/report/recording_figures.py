"""Pictures of one recording beside the model that was fitted to it."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from calibrate.fitting.fitted import FittedRecording
from calibrate.fitting.result import FitResult
from calibrate.inference.channels import channels_in, quantity_of
from gtr_jax import equilibrium
from gtr_jax.numbers import measured_quantity, number
from gtr_jax.plots.style import is_seen
from gtr_jax.recordings.recording import Recording
from gtr_jax.report.page import Figure
from gtr_jax.report.spatial import shape_figure
from gtr_jax.simulation.displacement import by_tension

from . import fit_figures as draw
from .recording_motion import Motion

NAMES = {"mu": "μ"}  # as pictures write them


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
                draw.plot_channels(*over[:2], others, phases=pull.phases, label=over[2]),
                f"{whose}What {'else ' if fitted.tips else ''}was recorded, and the fitted model.",
            )
        )
    return figures


def _body(motion: Motion, ending: str, whose: str) -> Figure:
    """The fitted body from three sides, at rest and where it was pulled most."""
    robot = motion.robot
    rest = equilibrium(by_tension(robot), np.zeros(np.shape(motion.run.T_base)[1:]))
    named = [(f"sample {motion.samples[motion.top] + 1}", motion.top)]
    figure = shape_figure(robot, motion.run, rest, named)
    return dataclasses.replace(figure, name=f"{figure.name}{ending}", caption=f"{whose}{figure.caption}")


class _Pull(NamedTuple):
    """One tendon of a recording: what drives it, as recorded and in the model, as it is drawn, (K,) each; its
    label; and the phases, (K,).
    """

    recorded: np.ndarray
    model: np.ndarray
    label: str
    phases: np.ndarray


def _pull(fitted: FittedRecording, recording: Recording, i: int) -> _Pull:
    drawn = fitted.robot.tendons[i].drive == "displacement"
    factor, label = (1e3, draw.DRAWN) if drawn else (1.0, draw.PULL)
    return _Pull(
        recorded=factor * of_tendon(i, recording.displacement if drawn else recording.T_base),
        model=factor * of_tendon(i, fitted.T_base),
        label=label,
        phases=of_tendon(i, fitted.phases),
    )


def of_tendon(i: int, values: np.ndarray | None) -> np.ndarray:
    """Values of one tendon, (K,), from those of all, (K, *tendons)."""
    each = np.asarray(values)
    return each.reshape(len(each), -1)[:, i]


def _of_tendon(
    fit: FitResult, fitted: FittedRecording, recording: Recording, i: int, named: tuple[str, str]
) -> list[Figure]:
    """Loop, course and residual of tendon i; `named` are the endings of their names and the words before
    their captions.
    """
    ending, whose = named
    pull, T_tip, band = (
        _pull(fitted, recording, i),
        of_tendon(i, recording.T_tip),
        of_tendon(i, _band(fitted)),
    )
    simulated, left = np.asarray(fitted.tips[i].simulated), np.asarray(fitted.tips[i].residual)
    loop = draw.plot_fit(
        pull.recorded,
        T_tip,
        simulated=(pull.model, simulated),
        phases=pull.phases,
        band=band,
        found=[
            f"{NAMES.get(e.name, e.name)} = {measured_quantity(e.value, e.sd, e.unit)}" for e in fit.estimates
        ],
        label=pull.label,
    )
    tension = pull.recorded if pull.label == draw.PULL else None
    over_time = draw.plot_time(recording.time, tension, T_tip, simulated=simulated, phases=pull.phases)
    residual = draw.plot_residual(
        pull.recorded, left, phases=pull.phases, noise=fitted.noise_N, label=pull.label
    )
    beside = "" if tension is None else ", with the tension at the base"
    drive = "displacement" if tension is None else "base tension"
    return [
        Figure(
            f"fit{ending}",
            loop,
            f"{whose}The recording, coloured by the fitted model's phase, and the model's "
            f"loop{_within(band, simulated)}.",
        ),
        Figure(
            f"time{ending}",
            over_time,
            f"{whose}The same {'sample by sample' if recording.time is None else 'over time'}{beside}.",
        ),
        Figure(
            f"residual{ending}",
            residual,
            f"{whose}Simulated minus recorded tip tension, against {drive} and along it"
            f"{noise_band(fitted.noise_N, left)}. A pattern means that the model lacks something.",
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


def _band(fitted: FittedRecording) -> np.ndarray:
    """Half width of the band that holds 95 % of samples: noise and the parameters' uncertainty [N], (K,
    *tendons).
    """
    return 1.96 * np.hypot(np.asarray(fitted.band), fitted.noise_N or 0.0)
