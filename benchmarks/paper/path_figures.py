"""Figures of the eight paths: shapes with forces on the channel; tension, curvature and wrap along them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gtr_jax.numbers import number
from gtr_jax.plots.shape import along_curve, curve_of, draw_body, draw_ribbon
from gtr_jax.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    VERMILLION,
    WIDTH,
    figure,
    legend_above,
    styled,
)

from .paths import T_BASE, State

COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
SCALE = 0.03  # mm drawn per N/m


@styled
def plot_shapes(states: Mapping[int, State]) -> Figure:
    """The deformed shapes with the normal force and the friction drawn along the channel, all at one scale.

    Args:
        states: four paths.
    """
    curves = {}
    for path, state in states.items():
        radius = np.asarray(state.robot.backbone.radius(state.pulled.s))
        curves[path] = curve_of(state.pulled, radius), curve_of(state.frictionless, radius)
    fig = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    for axes, (path, (pulled, free)) in zip(
        fig.subplots(2, 2, sharex=True, sharey=True).ravel(), curves.items(), strict=True
    ):
        axes.plot(*free.middle.T, color=GREY, linestyle=(0, (4, 2)), linewidth=1.2)
        draw_body(axes, pulled, INK)
        axes.plot(*pulled.channel.T, color=GREEN, linewidth=1.1)
        forces = states[path].forces
        for values, sign, colour in ((forces.normal, 1.0, BLUE), (forces.friction, -1.0, VERMILLION)):
            height = sign * SCALE * np.abs(along_curve(pulled, forces, np.asarray(values)))
            draw_ribbon(axes, pulled, height, colour)
        peaks = [
            number(float(np.max(np.abs(values))), digits=3) for values in (forces.normal, forces.friction)
        ]
        axes.set_title(f"path {path}: up to {peaks[0]} and {peaks[1]} N/m", fontsize=9)
        axes.set_aspect("equal", adjustable="box")
    fig.supxlabel("x [mm]", fontsize=10)
    fig.supylabel("y [mm]", fontsize=10)
    legend_above(
        fig,
        [
            Patch(facecolor=BLUE, alpha=0.4, label=f"$f_n$, 1 mm = {1 / SCALE:.0f} N/m"),
            Patch(facecolor=VERMILLION, alpha=0.4, label="$f_f$, same scale"),
            Line2D([], [], color=GREY, linestyle=(0, (4, 2)), label="no friction"),
        ],
    )
    return fig


@styled
def plot_along(states: Mapping[int, State]) -> Figure:
    """Tension, curvature of the tendon and wrap along the robot.

    Args:
        states: four paths.
    """
    fig, (tension, curvature, wrap) = figure(6.4, 3, sharex=True)
    keys = []
    for colour, (path, state) in zip(COLOURS, states.items(), strict=True):
        s = 1e3 * np.asarray(state.pulled.s)
        tension.plot(s, state.pulled.tension, color=colour, linewidth=1.8)
        there = np.asarray(state.forces.length) > 0
        middle = np.where(there, 1e3 * np.asarray(state.forces.s), np.nan)
        curvature.plot(middle, np.asarray(state.forces.normal_projection), color=colour, linewidth=1.3)
        wrap.plot(s, state.pulled.wrap, color=colour, linewidth=1.8)
        keys.append(Line2D([], [], color=colour, linewidth=2, label=f"path {path}"))
    base = T_BASE[next(iter(states))]
    tension.axhline(base, color=GREY, linestyle=(0, (4, 2)), linewidth=1.2)
    tension.text(398, base, "no friction", color=GREY, ha="right", va="bottom", fontsize=9)
    tension.set_ylim(0, 1.12 * base)
    tension.set_ylabel("tension $T$ [N]")
    curvature.set_ylabel("tendon curvature $\\kappa_c$ [1/m]")
    curvature.set_ylim(0, None)
    wrap.set_ylabel("wrap θ [rad]")
    wrap.set_ylim(0, None)
    wrap.set_xlabel("s along the backbone [mm]")
    wrap.set_xlim(0, 400)
    legend_above(fig, keys)
    return fig


@styled
def plot_factor(moved: Mapping[int, float], length: float, turned: Mapping[int, float]) -> Figure:
    """What the factor missing in eq. (16) does to the tip of each path.

    Args:
        moved: distance between the two tips [m], by path.
        length: of the robot [m].
        turned: angle between them [rad], by path.
    """
    fig, (distance, angle) = figure(4.2, 2, sharex=True)
    paths = list(moved)
    distance.bar(paths, [1e3 * moved[p] for p in paths], color=BLUE, width=0.6)
    for p in paths:
        distance.text(p, 1e3 * moved[p] + 2, f"{100 * moved[p] / length:.0f} %", ha="center", fontsize=9)
    distance.set_ylim(0, 1.15e3 * max(moved.values()))
    distance.set_ylabel("tip moved [mm]\n(% of L)")
    angle.bar(paths, [np.degrees(turned[p]) for p in paths], color=ORANGE, width=0.6)
    angle.axhline(0, color=GREY, linewidth=0.8)
    angle.set_ylabel("tip turned [°]")
    angle.set_xlabel("path")
    angle.set_xticks(paths)
    for axes in (distance, angle):
        axes.grid(False, axis="x")
    return fig
