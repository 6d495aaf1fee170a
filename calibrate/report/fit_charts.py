"""The charts of a fitted recording, which its page plays and from which its figures are drawn: the loop, the
course, and what is left, of one tendon or of all of them together; and each other channel.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calibrate.fitting.fitted import FittedRecording
from calibrate.inference.channels import ROTATION, unit_of
from gtr_jax.plots.chart import Chart, Column, Line
from gtr_jax.plots.style import GREY, INK
from gtr_jax.plots.tendons import COLOURS
from gtr_jax.recordings.recording import Recording

DRIVES = {"tension": "tension at the base [N]", "displacement": "displacement at the base [mm]"}
# What a quantity is called; and the unit in which it is shown, with its number per SI unit, by SI unit.
LABELS = {
    **{f"tip_{axis}": f"tip {axis}" for axis in "xyz"},
    **{name: f"turn about {name[-1]}" for name in ROTATION},
    "tip_angle": "tip angle",
    "displacement": "tendon displacement",
    "T_base": "tension at the base",
}
SHOWN = {"m": ("mm", 1e3), "rad": ("°", float(np.degrees(1.0))), "N": ("N", 1.0)}


class Over(NamedTuple):
    """What K samples are drawn over: as recorded and of a model, the label of that axis, and phases, (K,), in
    whose colours the samples are drawn; None for grey.
    """

    recorded: Column
    model: Column
    label: str
    phases: np.ndarray | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class FittedTendon:
    """One tendon of a fitted recording of K samples, as columns of charts.

    Attributes:
        drive: "tension" or "displacement".
        pull, model: that drive, as recorded and of the fitted model.
        tip, simulated: the tip tension, as recorded and of the fitted model.
        residual: their difference.
        band: half the height of the band about the model that holds 95 % of samples.
        phases: label of each sample, (K,).
    """

    drive: str
    pull: Column
    model: Column
    tip: Column
    simulated: Column
    residual: Column
    band: Column
    phases: np.ndarray


def fitted_tendon(fitted: FittedRecording, i: int, recording: Recording | None) -> FittedTendon:
    """Tendon i, of which the tip tension was compared.

    Args:
        fitted: the recording, fitted.
        i: number of the tendon.
        recording: as it is; without it the drive of the model stands for the recorded one.
    """
    tendon = fitted.robot.tendons[i]
    of = f" of {tendon.name}" if tendon.name else ""
    over = drive_of(fitted, i, recording)
    assert over.phases is not None
    simulated, residual = (np.asarray(v) for v in (fitted.tips[i].simulated, fitted.tips[i].residual))
    tip = simulated - residual if recording is None else of_tendon(i, recording.T_tip)
    half = 1.96 * np.hypot(of_tendon(i, fitted.band), fitted.noise_N or 0.0)
    return FittedTendon(
        drive=tendon.drive,
        pull=over.recorded,
        model=over.model,
        tip=Column(f"T_tip{of}, recorded", "N", tip),
        simulated=Column(f"T_tip{of}, fitted model", "N", simulated),
        residual=Column(f"simulated − recorded{of}", "N", residual),
        band=Column(f"95 % of samples{of}, half width", "N", half),
        phases=over.phases,
    )


def drive_of(fitted: FittedRecording, i: int, recording: Recording | None) -> Over:
    """What drives tendon i; the arguments are those of `fitted_tendon`."""
    tendon = fitted.robot.tendons[i]
    drawn = tendon.drive == "displacement"
    factor, unit, what = (1e3, "mm", "displacement") if drawn else (1.0, "N", "T_base")
    what += f" of {tendon.name}" if tendon.name else ""
    given = fitted.T_base
    if recording is not None:
        given = recording.displacement if drawn else recording.T_base
    return Over(
        Column(f"{what}, recorded", unit, factor * of_tendon(i, given)),
        Column(f"{what}, fitted", unit, factor * of_tendon(i, fitted.T_base)),
        DRIVES[tendon.drive],
        of_tendon(i, fitted.phases),
    )


def of_tendon(i: int, values: np.ndarray | None) -> np.ndarray:
    """Values of one tendon, (K,), from those of all, (K, *tendons)."""
    each = np.asarray(values)
    return each.reshape(len(each), -1)[:, i]


def loop_chart(tendons: Sequence[FittedTendon]) -> Chart:
    """Tip tension over what drives the tendon."""
    lines = []
    for i, tendon in enumerate(tendons):
        lines.append(_dots(tendons, i, tendon.pull, tendon.tip))
        lines.append(Line(tendon.model, tendon.simulated, INK, band=tendon.band))
    return Chart("Loop", _across(tendons), "tension at the tip [N]", lines)


def course_chart(tendons: Sequence[FittedTendon], clock: Column, along: str) -> Chart:
    """Tensions over the clock, whose axis is labelled `along`."""
    lines = []
    for i, tendon in enumerate(tendons):
        if tendon.drive == "tension":
            lines.append(Line(clock, tendon.pull, GREY, "dashed"))
        lines += [_dots(tendons, i, clock, tendon.tip), Line(clock, tendon.simulated, INK)]
    return Chart("Tensions", along, "tension [N]", lines)


def residual_charts(
    tendons: Sequence[FittedTendon], clock: Column, along: str, noise: float | None
) -> tuple[Chart, Chart]:
    """What the model leaves, over the clock and over what drives the tendon.

    Args:
        tendons: of the recording.
        clock, along: as of `course_chart`.
        noise: of the tip cells, one standard deviation [N].
    """
    over_clock = [_dots(tendons, i, clock, tendon.residual) for i, tendon in enumerate(tendons)]
    over_pull = [_dots(tendons, i, tendon.pull, tendon.residual) for i, tendon in enumerate(tendons)]
    difference = "simulated − recorded T_tip [N]"
    return (
        Chart("Residual over the recording", along, difference, over_clock, noise),
        Chart("Residual over the pull", _across(tendons), difference, over_pull, noise),
    )


def _dots(tendons: Sequence[FittedTendon], i: int, x: Column, y: Column) -> Line:
    """Samples of tendon i: of one alone in the colours of its phases, of several in one colour each."""
    if len(tendons) == 1:
        return Line(x, y, style="dots", phases=tendons[i].phases)
    return Line(x, y, COLOURS[i % len(COLOURS)], "dots")


def _across(tendons: Sequence[FittedTendon]) -> str:
    return across([tendon.drive for tendon in tendons])


def across(drives: Sequence[str]) -> str:
    """Label of the axis of what drives the tendons, by tension or displacement each."""
    kinds = set(drives)
    return DRIVES[kinds.pop()] if len(kinds) == 1 else "tension [N] or displacement [mm] at the base"


def fitted_model(fitted: FittedRecording, name: str) -> tuple[str, np.ndarray, str]:
    """What the fitted model shows of a channel, as `channel_chart` draws it."""
    return "fitted model", np.asarray(fitted.channels[name].simulated), INK


def channel_chart(
    name: str, over: Over, recorded: np.ndarray, models: Sequence[tuple[str, np.ndarray, str]]
) -> Chart:
    """One channel of a recording of K samples.

    Args:
        name: of the channel.
        over: what it is drawn over.
        recorded: SI, (K,).
        models: what each is called, what it simulates, SI, (K,), and its colour.
    """
    quantity, _, tendon = name.partition(".")
    unit, factor = SHOWN[unit_of(name)]
    words = " of ".join(filter(None, (LABELS.get(quantity, quantity.replace("_", " ")), tendon)))
    samples = Column(f"{words}, recorded", unit, factor * np.asarray(recorded))
    lines = [Line(over.recorded, samples, style="dots", phases=over.phases)]
    lines += [
        Line(over.model, Column(f"{words}, {label}", unit, factor * np.asarray(values)), colour)
        for label, values, colour in models
    ]
    return Chart(words[0].upper() + words[1:], over.label, f"{words} [{unit}]", lines)
