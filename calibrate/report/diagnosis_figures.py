"""What a diagnosis weighs, and what it proposes: rates, branches, laws, rivals, an experiment."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calibrate.diagnosis.laws.found import FoundLaw
from gtr_jax.numbers import display_unit
from gtr_jax.plots.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    PALE,
    VERMILLION,
    column_width,
    figure,
    legend_above,
    styled,
)
from gtr_jax.terms.law import VARIABLES


@styled
def plot_against_rate(
    rates: np.ndarray,
    since: np.ndarray,
    residual: np.ndarray,
    *,
    noise: float,
    label: str,
    unit: str,
    along: str = "rate of $T_{base}$ [N/s]",
) -> Figure:
    """What is left of a channel against the rate of the base tension, and the time since that last turned.

    Args:
        rates: of the base tension [N/s], (K,).
        since: time since the last reversal of the base tension [s], (K,).
        residual: simulated minus recorded, in `unit`, (K,).
        noise: standard deviation of the noise, likewise.
        label: which model is shown.
        along: label of the axis of the rate.
    """
    fig = Figure(figsize=(column_width(), 2.6), layout="constrained")
    left, right = fig.subplots(1, 2, sharey=True)
    keys: list[Artist] = []
    for way, colour, what in ((1, BLUE, "base rising"), (-1, GREEN, "base falling")):
        inside = way * rates > 0
        for axes, x in ((left, np.abs(rates)), (right, since)):
            style = {"linestyle": "", "marker": "o", "markersize": 1.6, "color": colour, "alpha": 0.4}
            axes.plot(x[inside], residual[inside], **style)
        keys.append(Line2D([], [], linestyle="", marker="o", markersize=4, color=colour, label=what))
    for axes in (left, right):
        axes.axhspan(-2 * noise, 2 * noise, color=PALE, linewidth=0, zorder=0)
        axes.set_xscale("log")
    left.set_xlabel(along)
    right.set_xlabel("time since reversal [s]")
    left.set_ylabel(f"simulated − recorded [{unit}]")
    left.set_title(label, loc="left", fontsize=9)
    legend_above(fig, keys)
    return fig


@styled
def plot_branches(
    branches: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], label: str, *, along: str
) -> Figure:
    """Half the difference D and half the sum S of ln(T_tip/T_base) on release and pull, at matched tension.

    Args:
        branches: base tension [N], D and S, (n,) each: of the recording, the model before, and after.
        label: what the model after has.
        along: label of the axis of the base tension.
    """
    fig, rows = figure(4.2, 2, sharex=True)
    styles = [
        ({"marker": "o", "linestyle": "", "markersize": 4, "color": GREY}, "recorded"),
        ({"color": VERMILLION, "linewidth": 1.2}, "best fit without"),
        ({"color": BLUE, "linewidth": 1.2}, label),
    ]
    for (at, D, S), (style, _) in zip(branches, styles, strict=False):
        rows[0].plot(at, D, **style)
        rows[1].plot(at, S, **style)
    rows[0].set_ylabel("D: friction [–]")
    rows[1].set_ylabel("S: gains, offsets [–]")
    rows[1].set_xlabel(along)
    legend_above(fig, [Line2D([], [], label=what, **style) for style, what in styles[: len(branches)]])
    return fig


@styled
def plot_law(found: FoundLaw) -> Figure:
    """A law that was found, with its 95 % band, over the range of its variable that the recordings cover."""
    fig, (axes,) = figure(3.2)
    (x_unit, x_size), (y_unit, y_size) = (display_unit(u) for u in (found.of_unit, found.unit))
    x, y, lower, upper = found.x / x_size, *(v / y_size for v in (found.y, found.lower, found.upper))
    axes.fill_between(x, lower, upper, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(x, y, color=BLUE, linewidth=1.4)
    axes.axhline(1.0 if found.acts == "friction" else 0.0, color=GREY, linewidth=0.8, linestyle="--")
    axes.set_xlabel(f"{VARIABLES[found.of].says} {found.of}{f' [{x_unit}]' if x_unit else ''}")
    axes.set_ylabel(textwrap.fill(f"{found.changes}{f' [{y_unit}]' if y_unit else ''}", 24))
    keys = [
        Line2D([], [], color=BLUE, label="the law"),
        Patch(color=BLUE, alpha=0.2, label="95 %"),
        Line2D([], [], color=GREY, linestyle="--", linewidth=0.8, label="without it"),
    ]
    legend_above(fig, keys)
    return fig


@styled
def plot_rivals(names: Sequence[str], probability: np.ndarray, delta: np.ndarray) -> Figure:
    """How probable each model is, and by how much it fits better than the base model.

    Args:
        names: of the models, the most probable first.
        probability: of each, (n,).
        delta: root of the drop of the sum of squares, (n,).
    """
    n = len(names)
    fig = Figure(figsize=(column_width(), 1.1 + 0.34 * n), layout="constrained")
    left, right = fig.subplots(1, 2, sharey=True)
    at = np.arange(n)[::-1]
    left.barh(at, delta, color=[BLUE if i == 0 else GREY for i in range(n)], height=0.6)
    right.barh(at, probability, color=[BLUE if i == 0 else GREY for i in range(n)], height=0.6)
    left.set_yticks(at, names, fontsize=8)
    left.set_xlabel("better by\n[standard errors]")
    right.set_xlabel("probability")
    right.set_xlim(0, 1)
    for y, p in zip(at, probability, strict=True):
        right.text(min(p + 0.02, 0.8), y, f"{p:.2g}", va="center", fontsize=8, color=INK)
    return fig


@styled
def plot_history(
    time: np.ndarray,
    T_base: np.ndarray,
    T_tip: np.ndarray | None = None,
    *,
    drawn: Sequence[bool] = (False,),
    names: Sequence[str] = ("",),
) -> Figure:
    """A load history to drive: base tension [N] over time [s], (K,) each; or, for a check of the cells, the
    weights on the base cell and on the tip cell [N].

    Args:
        time: [s], (K,).
        T_base, T_tip: tensions [N], (K,); or of several tendons T_base alone, (K, tendons).
        drawn: which tendons displacement drives, of which `T_base` is that [m].
        names: of the tendons.
    """
    if any(drawn) or T_base.ndim == 2:
        fig, rows = figure(1.0 + 1.1 * len(names), len(names), sharex=True)
        each = T_base.T if T_base.ndim == 2 else [T_base]
        for axes, one, by_draw, name in zip(rows, each, drawn, names, strict=True):
            axes.plot(time, 1e3 * one if by_draw else one, color=BLUE)
            axes.set_ylabel("displacement [mm]" if by_draw else "$T_{base}$ [N]")
            axes.set_title(name, loc="left", fontsize=9)
        rows[-1].set_xlabel("time [s]")
        return fig
    fig, (axes,) = figure(2.2)
    axes.set_xlabel("time [s]")
    if T_tip is None:
        axes.plot(time, T_base, color=BLUE)
        axes.set_ylabel("$T_{base}$ [N]")
        return fig
    axes.plot(time, T_base, color=BLUE, marker="o", ms=3, label="base cell")
    axes.plot(time, T_tip, color=VERMILLION, marker="s", ms=3, ls="--", label="tip cell")
    axes.set_ylabel("weight on the cell [N]")
    axes.legend(frameon=False, fontsize=8)
    return fig
