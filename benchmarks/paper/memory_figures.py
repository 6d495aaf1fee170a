"""Figures of the tendon's memory: loops, maps of slip along the tendon, tension at the turns."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gtr_jax.plots.style import (
    BLUE,
    GREEN,
    INK,
    PALE,
    VERMILLION,
    WIDTH,
    figure,
    legend_above,
    line_by_phase,
    phase_keys,
    styled,
)
from gtr_jax.simulation.history import Simulation
from gtr_jax.simulation.slipping import SLIP_TOLERANCE

DOTS = (0, (1, 1.5))


def slip_map(run: Simulation) -> np.ndarray:
    """+1 where the tendon slips towards the base in a step, -1 towards the tip, 0 where locked, (K-1, N)."""
    change = np.diff(np.asarray(run.tension), axis=0)
    return np.where(np.abs(change) > SLIP_TOLERANCE * float(np.max(run.T_base)), np.sign(change), 0.0)


@styled
def plot_loops(stories: Mapping[str, tuple[Simulation, np.ndarray]]) -> Figure:
    """Tip against base tension of four histories, by phase.

    Args:
        stories: simulation and phases, by name.
    """
    fig = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    grid = fig.subplots(2, 2, sharex=True, sharey=True)
    for axes, (name, (run, phases)) in zip(grid.flat, stories.items(), strict=True):
        line_by_phase(axes, np.asarray(run.T_base), np.asarray(run.T_tip), phases, width=1.6)
        axes.set_title(name, loc="left", fontsize=10, color=INK)
        axes.set_xlim(0, 47)
        axes.set_ylim(0, None)
    for axes in grid[-1]:
        axes.set_xlabel("$T_{base}$ [N]")
    for axes in grid[:, 0]:
        axes.set_ylabel("$T_{tip}$ [N]")
    legend_above(fig, phase_keys(np.concatenate([phases[1:] for _, phases in stories.values()])))
    return fig


@styled
def plot_map(run: Simulation) -> Figure:
    """Tensions at both ends, and slip along the tendon, against the path the base tension has gone.

    Args:
        run: the simulation.
    """
    T_base, s = np.asarray(run.T_base), np.asarray(run.s)
    path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(T_base)))])
    fig, (ends, plane) = figure(5.4, 2, sharex=True, height_ratios=[1, 1.3])
    ends.plot(path, T_base, color=INK, linewidth=1.4)
    ends.plot(path, run.T_tip, color=VERMILLION, linewidth=1.6)
    ends.set_ylabel("tension [N]")
    ends.set_ylim(0, None)
    keep = np.concatenate([[True], np.diff(s) > 0])
    slips = slip_map(run)[:, keep][:, 1:]
    plane.pcolormesh(
        path,
        1e3 * s[keep],
        slips.T,
        cmap=ListedColormap([GREEN, PALE, BLUE]),
        norm=BoundaryNorm([-1.5, -0.5, 0.5, 1.5], 3),
        rasterized=True,
    )
    plane.grid(False)
    plane.set_xlim(0, path[-1])
    plane.set_ylabel("s along the backbone [mm]")
    plane.set_xlabel("path of $T_{base}$ [N]")
    keys = [
        Line2D([], [], color=INK, linewidth=1.4, label="$T_{base}$"),
        Line2D([], [], color=VERMILLION, linewidth=1.6, label="$T_{tip}$"),
        Patch(color=BLUE, label="slips to base"),
        Patch(color=GREEN, label="to tip"),
        Patch(color=PALE, label="locked"),
    ]
    legend_above(fig, keys)
    return fig


@styled
def plot_tensions(run: Simulation, steps: np.ndarray) -> Figure:
    """Tension along the tendon at some steps where it has just slipped, and all of it at the last.

    Args:
        run: the simulation.
        steps: which, in order.
    """
    fig, (axes,) = figure(4.2)
    s, slips = 1e3 * np.asarray(run.s), slip_map(run)
    for k in steps:
        tension, here = np.asarray(run.tension[k]), slips[k - 1] != 0
        colour = BLUE if run.slip_direction[k] > 0 else GREEN
        front = int(np.argmin(here)) if not here.all() else len(s)
        axes.plot(s[:front], tension[:front], color=colour, linewidth=1.8)
        if k == steps[-1]:
            beyond = slice(max(front - 1, 0), None)
            axes.plot(s[beyond], tension[beyond], color=INK, linewidth=2.0, linestyle=DOTS, zorder=4)
        axes.plot(0, tension[0], marker="o", markersize=3.5, color=colour, clip_on=False)
    axes.set_xlim(0, s[-1])
    axes.set_ylim(0, None)
    axes.set_xlabel("s along the backbone [mm]")
    axes.set_ylabel("tension of the tendon [N]")
    keys = [
        Line2D([], [], color=BLUE, linewidth=1.8, label="end of a pull"),
        Line2D([], [], color=GREEN, linewidth=1.8, label="end of a release"),
        Line2D([], [], color=INK, linewidth=2.0, linestyle=DOTS, label="locked at the end"),
    ]
    legend_above(fig, keys)
    return fig
