"""How well a fit knows its parameters: profiles, and draws from the posterior."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gtr_jax.plots.style import (
    BLUE,
    GREY,
    VERMILLION,
    column_width,
    figure,
    legend_above,
    styled,
)

# 95 % quantile of chi-square with one degree of freedom.
LEVEL_95 = 3.84


@styled
def plot_profiles(profiles: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]) -> Figure:
    """How much worse the best fit becomes as one parameter is held away from its estimate.

    Args:
        profiles: by the parameter's label, with unit: its values, the rise of the sum of squares, and the
            rise of a parabola of the standard error, (n,) each.
    """
    fig, rows = figure(1.2 + 1.9 * len(profiles), len(profiles))
    for axes, (label, (values, rise, parabola)) in zip(rows, profiles.items(), strict=True):
        side = np.sign(np.arange(len(values)) - np.argmin(parabola))
        fine = np.linspace(values[0], values[-1], 201)
        for heights, colour, dash in ((parabola, GREY, (0, (4, 2))), (rise, BLUE, "-")):
            root = side * np.sqrt(np.maximum(heights, 0.0))  # nearly straight in the values
            height = np.interp(fine, values, root) ** 2
            axes.plot(fine, height, linewidth=1.6, color=colour, linestyle=dash)
        axes.plot(values, rise, color=BLUE, linestyle="", marker="o", markersize=4)
        axes.locator_params(axis="x", nbins=5)
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.axhline(LEVEL_95, color=VERMILLION, linewidth=1.0)
        axes.set_ylim(0, None)
        axes.set_xlabel(label)
        axes.set_ylabel("Δχ²")
    legend_above(
        fig,
        [
            Line2D([], [], color=BLUE, linewidth=1.8, marker="o", markersize=4, label="profile"),
            Line2D([], [], color=GREY, linestyle=(0, (4, 2)), label="standard error"),
            Line2D([], [], color=VERMILLION, label="95 %"),
        ],
    )
    return fig


@styled
def plot_draws(draws: Mapping[str, np.ndarray]) -> Figure:
    """Draws of parameters: how often each value, and each two against one another.

    Args:
        draws: by the parameter's label, with unit, (n,) each.
    """
    labels, count = list(draws), len(draws)
    fig = Figure(
        figsize=(column_width(), column_width() * min(1.0, 0.35 + 0.22 * count)), layout="constrained"
    )
    grid = fig.subplots(count, count, squeeze=False, sharex="col")
    for i, row in enumerate(labels):
        for j, column in enumerate(labels):
            axes = grid[i, j]
            if j > i:
                axes.set_visible(False)
                continue
            if i == j:
                axes.hist(draws[column], bins=30, color=BLUE)
                axes.set_yticks([])
            else:
                axes.plot(
                    draws[column], draws[row], linestyle="", marker=".", markersize=2, color=BLUE, alpha=0.4
                )
                axes.locator_params(axis="y", nbins=3)
                axes.ticklabel_format(axis="y", useOffset=False)
            axes.locator_params(axis="x", nbins=3)
            axes.ticklabel_format(axis="x", useOffset=False)
            axes.tick_params(labelsize=8)
            if i == count - 1:
                axes.set_xlabel(column)
            if j == 0 and i:
                axes.set_ylabel(row)
    return fig
