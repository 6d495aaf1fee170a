"""The pictures of the notched wrists: the robots, and what models say of their trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

import gtr_jax as gtr
from gtr_jax.plots.shape import curve_of, draw_body
from gtr_jax.plots.straight import notches_of, plot_straight
from gtr_jax.plots.style import BLUE, GREEN, GREY, INK, PURPLE, VERMILLION, styled

from .wrist_trials import COUNT, Trial, predicted

DRAWN = (0.0, 1.0, 2.5)  # N, of the shapes that are drawn


@styled
def bodies(robots: Mapping[str, gtr.Robot]) -> Figure:
    """Each wrist as it is made, and bent by its tendon."""
    fig = Figure(figsize=(9.6, 6.0), layout="constrained")
    axes = fig.subplots(2, len(robots), height_ratios=(1, 3), squeeze=False)
    for (above, below), (wrist, robot) in zip(axes.T, robots.items(), strict=True):
        plot_straight(robot, axes=above)
        above.set_title(wrist, fontsize=10)
        for texts in list(above.texts):
            texts.remove()
        for T, colour in zip(DRAWN, (GREY, INK, PURPLE), strict=True):
            state = gtr.equilibrium(robot, T)
            curve = curve_of(state, np.asarray(robot.backbone.radius(state.s)), notches_of(robot))
            draw_body(below, curve, colour)
            below.plot(*curve.channel.T, color=GREEN, linewidth=1.4)
            below.plot([], [], color=colour, label=f"{T:g} N")
        below.plot([], [], color=GREEN, label="tendon")
        below.set_aspect("equal")
        below.set_xlabel("x [mm]")
        below.set_ylabel("y [mm]")
    fig.legend(*axes[1, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return fig


@styled
def recorded(robots: Mapping[str, Mapping[str, gtr.Robot]], seen: Mapping[str, Sequence[Trial]]) -> Figure:
    """Angles of the notches against the base tension in the trials that were not trained on."""
    fig = Figure(figsize=(9.6, 6.4), layout="constrained")
    axes = fig.subplots(len(robots), COUNT, sharex=True, sharey="row")
    for row, wrist in zip(axes, robots, strict=True):
        later = seen[wrist][1:]
        T = np.linspace(0.0, max(trial.T_base.max() for trial in later), 60)
        lines = {
            name: np.rad2deg(gtr.marker_angles(robot, gtr.simulate(robot, T)))
            for name, robot in robots[wrist].items()
        }
        for i, at in enumerate(row):
            for (name, line), colour in zip(lines.items(), (GREY, BLUE), strict=True):
                at.plot(T, line[:, i], color=colour, label=name)
            for trial in later:
                at.plot(
                    trial.T_base,
                    np.rad2deg(trial.angles[:, i]),
                    ".",
                    color=VERMILLION,
                    ms=4,
                    label="measured",
                )
            at.set_title(f"{wrist}, notch {i + 1}", fontsize=9)
        row[0].set_ylabel("angle of the notch [°]")
    fig.supxlabel("tension at the base [N]", fontsize=10)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    once = dict(zip(labels, handles, strict=True))
    fig.legend(once.values(), once.keys(), loc="outside upper center", ncols=3)
    return fig


@styled
def models(robots: Mapping[str, Mapping[str, gtr.Robot]], seen: Mapping[str, Sequence[Trial]]) -> Figure:
    """Angles of the notches of both models, and their held-out errors by notch."""
    fig = Figure(figsize=(9.6, 5.8), layout="constrained")
    axes = fig.subplots(2, 2, width_ratios=(3, 2))
    for (left, right), wrist in zip(axes, robots, strict=True):
        T = np.linspace(0.0, 2.0, 60)
        for (name, robot), colour, width in zip(
            robots[wrist].items(), (GREY, BLUE), (-0.2, 0.2), strict=True
        ):
            angles = np.rad2deg(gtr.marker_angles(robot, gtr.simulate(robot, T)))
            for i in range(COUNT):
                left.plot(T, angles[:, i], color=colour, lw=1.4, label=name if i == 0 else None)
            errors = [predicted(robot, trial, False) - trial.angles for trial in seen[wrist][1:]]
            each = np.rad2deg(np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))
            right.bar(np.arange(1, COUNT + 1) + width, each, 0.38, color=colour)
        left.set_title(f"{wrist}: notches 1 (upper) to {COUNT} (lower)", fontsize=9)
        left.set_xlabel("tension at the base [N]")
        left.set_ylabel("angle of each notch [°]")
        right.set_title("trials that no model was fitted to", fontsize=9)
        right.set_xlabel("notch")
        right.set_ylabel("rms error [°]")
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return fig
