"""A fitted model beside its recording, and what is left between them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calibrate.inference.channels import ROTATION, unit_of
from gtr_jax.plots.style import (
    BLUE,
    GREY,
    INK,
    PALE,
    PHASE_COLOUR,
    VERMILLION,
    column_width,
    figure,
    legend_above,
    phase_keys,
    styled,
)

PULL = "tension at the base $T_{base}$ [N]"
DRAWN = "displacement at the base [mm]"


def by_phase(axes, x: np.ndarray, y: np.ndarray, phases: np.ndarray) -> None:
    """Samples as dots in the colours of their phases, on matplotlib axes."""
    for phase, colour in PHASE_COLOUR.items():
        here = phases == phase
        if np.any(here):
            axes.plot(x[here], y[here], linestyle="", marker="o", markersize=2.6, color=colour, alpha=0.6)


@styled
def plot_fit(
    T_base: np.ndarray,
    T_tip: np.ndarray,
    *,
    simulated: tuple[np.ndarray, np.ndarray],
    phases: np.ndarray,
    band: np.ndarray | None = None,
    found: Sequence[str] = (),
    label: str = PULL,
) -> Figure:
    """Recorded tip against base tension, coloured by phase, with the fitted model's loop.

    Args:
        T_base, T_tip: as recorded [N], (K,).
        simulated: base and tip tension of the fitted model [N], (K,) each.
        phases: label of each sample, (K,).
        band: half width of the band drawn about the loop [N], (K,).
        found: what was estimated, a line each, written into the picture.
        label: of what drives the tendon.
    """
    fig, (axes,) = figure(3.9)
    if found:  # in the corner below the pulling branch, where no loop passes
        where = {"ha": "right", "va": "bottom", "multialignment": "left", "transform": axes.transAxes}
        axes.text(0.98, 0.04, "\n".join(found), fontsize=9, color=INK, zorder=6, **where)
    if band is not None and np.any(band > 0):
        x, y = simulated
        pieces = [0, *(np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 1).tolist(), len(x) - 1]
        for a, b in itertools.pairwise(pieces):
            part = slice(a, b + 1)
            low, high = y[part] - band[part], y[part] + band[part]
            axes.fill_between(x[part], low, high, color=PALE, linewidth=0, zorder=0)
    by_phase(axes, T_base, T_tip, phases)
    axes.plot(*simulated, color=INK, linewidth=0.9)
    axes.set_xlabel(label)
    axes.set_ylabel("tension at the tip $T_{tip}$ [N]")
    keys = [*phase_keys(phases, marker="o"), Line2D([], [], color=INK, linewidth=0.9, label="fitted model")]
    legend_above(fig, keys)
    return fig


@styled
def plot_time(
    time: np.ndarray | None,
    T_base: np.ndarray | None,
    T_tip: np.ndarray,
    *,
    simulated: np.ndarray,
    phases: np.ndarray,
) -> Figure:
    """Tension at base and tip over time, as recorded, with the fitted model's at the tip.

    Args:
        time: of the samples [s], (K,); None if it was not recorded: the axis then counts samples.
        T_base, T_tip: as recorded [N], (K,); None where displacement drives the tendon.
        simulated: tip tension of the fitted model [N], (K,).
        phases: label of each sample, (K,).
    """
    fig, (axes,) = figure(3.2)
    at = np.arange(1, len(T_tip) + 1) if time is None else time
    if T_base is not None:
        axes.plot(at, T_base, color=GREY, linewidth=1.0, linestyle=(0, (4, 2)))
    by_phase(axes, at, T_tip, phases)
    axes.plot(at, simulated, color=INK, linewidth=0.9)
    axes.set_xlabel("sample" if time is None else "time [s]")
    axes.set_ylabel("tension [N]")
    base = Line2D([], [], color=GREY, linewidth=1.0, linestyle=(0, (4, 2)), label="base")
    keys = [
        *([] if T_base is None else [base]),
        *phase_keys(phases, marker="o"),
        Line2D([], [], color=INK, linewidth=0.9, label="fitted model, tip"),
    ]
    legend_above(fig, keys)
    return fig


# Label of a quantity; its unit shown, and its size, units shown per SI unit, by SI unit.
LABELS = {
    **{f"tip_{axis}": f"tip ${axis}$" for axis in "xyz"},
    **{name: f"turn about ${name[-1]}$" for name in ROTATION},
    "tip_angle": "tip angle",
    "displacement": "tendon displacement",
    "T_base": "tension at the base",
}
SHOWN = {"m": ("mm", 1e3), "rad": ("°", float(np.degrees(1.0))), "N": ("N", 1.0)}
# From so many channels on, they are drawn lower.
MANY = 6


@styled
def plot_channels(
    at: np.ndarray,
    simulated_at: np.ndarray,
    channels: Mapping[str, tuple[np.ndarray, np.ndarray]],
    *,
    phases: np.ndarray,
    label: str = PULL,
) -> Figure:
    """What was recorded beside the tensions, with the fitted model.

    Args:
        at: what the samples are drawn over, as recorded, (K,).
        simulated_at: the same of the fitted model, (K,).
        channels: by name: recorded and simulated, SI, (K,) each.
        phases: label of each sample, (K,).
        label: of the axis.
    """
    each = 2.2 if len(channels) < MANY else 1.8
    fig, rows = figure(1.0 + each * len(channels), len(channels), sharex=True)
    for axes, (name, (recorded, simulated)) in zip(rows, channels.items(), strict=True):
        quantity, _, tendon = name.partition(".")
        unit, factor = SHOWN[unit_of(name)]
        by_phase(axes, at, factor * recorded, phases)
        axes.plot(simulated_at, factor * simulated, color=INK, linewidth=0.9)
        words = " of ".join(filter(None, (LABELS.get(quantity, quantity.replace("_", " ")), tendon)))
        axes.set_ylabel(f"{words} [{unit}]")
    rows[-1].set_xlabel(label)
    keys = [*phase_keys(phases, marker="o"), Line2D([], [], color=INK, linewidth=0.9, label="fitted model")]
    legend_above(fig, keys)
    return fig


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


@styled
def plot_residual(
    T_base: np.ndarray, residual: np.ndarray, *, phases: np.ndarray, noise: float | None, label: str = PULL
) -> Figure:
    """Residual against base tension and along the recording, coloured by phase, with the band of the noise.

    Args:
        T_base: as recorded [N], (K,).
        residual: of the tip tension [N], (K,).
        phases: label of each sample, (K,).
        noise: one standard deviation of the tip cell's noise [N]; no band if None.
        label: of what drives the tendon.
    """
    fig, rows = figure(5.6, 2, sharey=True)
    for axes, x in zip(rows, (T_base, np.arange(1, len(T_base) + 1)), strict=True):
        if noise:
            axes.axhspan(-2 * noise, 2 * noise, color=PALE, linewidth=0, zorder=0)
        axes.axhline(0, color=INK, linewidth=0.8)
        by_phase(axes, x, residual, phases)
        axes.set_ylabel("simulated $-$ recorded $T_{tip}$ [N]")
    rows[0].set_xlabel(label)
    rows[1].set_xlabel("sample")
    keys: list = phase_keys(phases, marker="o")
    if noise:
        keys.append(Patch(color=PALE, label="noise, ±2 sd"))
    legend_above(fig, keys)
    return fig
