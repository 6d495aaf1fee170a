"""Pictures of a sweep: maps and curves of a grid, parallel coordinates of a sample, sensitivity indices."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from gtr_jax.numbers import number
from gtr_jax.sweep.sensitivity import Index
from gtr_jax.units import display_of

from .style import BLUE, GREY, INK, ORANGE, PALE, WIDTH, column_width, figure, styled

if TYPE_CHECKING:
    import xarray

COLOURS = "viridis"
MISSING = "#F2D5D0"
LINES = 400  # of parallel coordinates
FINEST = 400  # cells of a map along a side


def label(array: xarray.DataArray) -> str:
    """Name and unit of a quantity, as an axis says it."""
    unit = display_of(_unit(array))[0]
    return f"{array.name} [{unit}]" if unit else str(array.name)


def title(array: xarray.DataArray) -> str:
    """What a quantity is, as the title of its map, in lines that fit one."""
    says = array.attrs.get("long_name", "")
    return textwrap.fill(f"{array.name}: {says}" if says else str(array.name), 46)


def shown(array: xarray.DataArray) -> np.ndarray:
    """Its values in the unit people write them in."""
    return np.asarray(array.values, dtype=float) / display_of(_unit(array))[1]


def _unit(array: xarray.DataArray) -> str:
    unit = array.attrs.get("units", "1")
    return "" if unit == "1" else unit


def _spaced_by_ratio(values: np.ndarray) -> bool:
    """Whether values are evenly spaced by their logarithms, over a range where that shows."""
    if len(values) < 3 or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) < 0.1 * np.abs(ratios).max() and np.ptp(steps) > 0.3 * np.abs(steps).max())


def _by_ratio(axes: Axes, which: str) -> None:
    """A log scale, its ticks as plain numbers."""
    (axes.set_xscale if which == "x" else axes.set_yscale)("log")
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _fixed(data: xarray.DataArray, dims: Sequence[str]) -> tuple[xarray.DataArray, str]:
    """A slice that has these dimensions only, the others at their middle value, and words for that."""
    held, words = {}, []
    for dim in data.dims:
        if dim not in dims:
            held[dim] = data.sizes[dim] // 2
            at = data[dim]
            words.append(f"{dim} = {number(float(shown(at)[held[dim]]), display_of(_unit(at))[0], 3)}")
    return data.isel(held), ", ".join(words)


@styled
def plot_maps(data: Mapping[str, xarray.DataArray], *, axes: Axes | Sequence[Axes] | None = None) -> Figure:
    """Outputs over the two longest dimensions of a grid, the others at their middle values.

    Args:
        data: arrays over the same grid of at least two dimensions of two values, by name.
        axes: to draw into, one for each output; a figure is made unless given.
    """
    first = next(iter(data.values()))
    by_length = sorted(first.dims, key=lambda d: -first.sizes[d])[:2]
    across, up = [str(d) for d in first.dims if d in by_length]
    columns = min(len(data), 2)
    rows = -(-len(data) // columns)
    if axes is None:
        wide = column_width() if columns == 1 else 1.55 * WIDTH
        fig = Figure(figsize=(wide, 3.4 * rows), layout="constrained")
        panels = list(fig.subplots(rows, columns, squeeze=False).ravel())
    else:
        fig, panels = figure(0.0, len(data), axes)
    words = ""
    for panel, array in zip(panels, data.values(), strict=False):
        part, words = _fixed(array, (across, up))
        part = part.transpose(up, across)
        part = part[:: -(-part.shape[0] // FINEST), :: -(-part.shape[1] // FINEST)]
        x, y = part[across], part[up]
        panel.set_facecolor(MISSING)
        drawn = panel.pcolormesh(
            shown(x),
            shown(y),
            np.ma.masked_invalid(shown(part)),
            cmap=COLOURS,
            shading="nearest",
            rasterized=True,
        )
        bar = fig.colorbar(drawn, ax=panel)
        bar.set_label(label(array))
        bar.outline.set_visible(False)
        panel.grid(False)
        panel.set_title(title(array), loc="left", fontsize=9)
        for scale, values in (("x", x), ("y", y)):
            if _spaced_by_ratio(np.asarray(values.values, dtype=float)):
                _by_ratio(panel, scale)
        panel.set_xlabel(label(x))
        panel.set_ylabel(label(y))
    for panel in panels[len(data) :]:
        panel.set_visible(False)
    if words and axes is None:
        fig.suptitle(words, fontsize=9, color=GREY)
    return fig


@styled
def plot_curves(data: Mapping[str, xarray.DataArray], *, axes: Axes | Sequence[Axes] | None = None) -> Figure:
    """Outputs over the only dimension of a grid that has several values.

    Args:
        data: arrays over the same grid, by name.
        axes: to draw into, one for each output; a figure is made unless given.
    """
    first = next(iter(data.values()))
    dim = max(first.dims, key=lambda d: first.sizes[d])
    fig, panels = figure(1.9 * len(data) + 0.4, len(data), axes, sharex=True)
    for panel, array in zip(panels, data.values(), strict=True):
        part, _ = _fixed(array, (str(dim),))
        panel.plot(shown(part[dim]), shown(part), color=BLUE, linewidth=2)
        panel.set_ylabel(label(array))
    x = first[dim]
    if _spaced_by_ratio(np.asarray(x.values, dtype=float)):
        _by_ratio(panels[-1], "x")
    panels[-1].set_xlabel(label(x))
    return fig


@styled
def plot_parallel(
    points: Mapping[str, xarray.DataArray], output: xarray.DataArray, *, axes: Axes | None = None
) -> Figure:
    """Points of a sample as lines through what was varied, coloured by an output.

    Args:
        points: coordinates (n,) by name.
        output: values (n,); points without a number are left out.
        axes: to draw into; a figure is made unless given.
    """
    known = np.flatnonzero(np.isfinite(np.asarray(output.values, dtype=float)))
    some = known[:: -(-len(known) // LINES)] if len(known) else known
    value = shown(output)[some]
    columns = [*points.values(), output]
    scaled, ends = [], []
    for column in columns:
        own = shown(column)[known]
        low, high = (float(own.min()), float(own.max())) if len(own) else (0.0, 1.0)
        ends.append((low, high))
        scaled.append((shown(column)[some] - low) / ((high - low) or 1.0))
    if axes is None:
        fig = Figure(figsize=(max(column_width(), 1.25 * len(columns)), 3.6), layout="constrained")
        axes = fig.subplots()
    else:
        fig, (axes,) = figure(0.0, 1, axes)
    order = np.argsort(value)
    lines = np.stack(scaled, axis=1)[order]
    places = np.arange(len(columns))
    colours = mpl.colormaps[COLOURS](lines[:, -1] if len(lines) else [])
    axes.add_collection(
        LineCollection(
            [np.stack([places, y], axis=1) for y in lines], colors=list(colours), linewidths=0.8, alpha=0.6
        )
    )
    _parallel_axes(axes, columns, ends)
    return fig


def _parallel_axes(
    axes: Axes, columns: Sequence[xarray.DataArray], ends: Sequence[tuple[float, float]]
) -> None:
    last = len(columns) - 1
    for i, (low, high) in enumerate(ends):
        axes.plot([i, i], [0, 1], color=INK if i == last else GREY, linewidth=1.6 if i == last else 1.0)
        for height, value, side in ((-0.03, low, "top"), (1.03, high, "bottom")):
            axes.text(i, height, number(value, digits=3), ha="center", va=side, fontsize=9)
    axes.set_xlim(-0.4, last + 0.4)
    axes.set_ylim(-0.12, 1.12)
    axes.set_xticks(range(len(columns)), [label(column) for column in columns])
    axes.tick_params(length=0)
    axes.set_yticks([])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)


@styled
def plot_sensitivity(
    indices: Mapping[str, Mapping[str, Index]], *, axes: Axes | Sequence[Axes] | None = None
) -> Figure:
    """Sensitivity indices as bars: total effects behind, first-order ones in front, or mean changes.

    Args:
        indices: by parameter, by output.
        axes: to draw into, one for each output; a figure is made unless given.
    """
    names = list(next(iter(indices.values())))
    fig, panels = figure(
        (0.35 + 0.26 * len(names)) * len(indices) + 0.9, len(indices), axes, sharex=_shares(indices)
    )
    for panel, (output, of) in zip(panels, indices.items(), strict=True):
        places = np.arange(len(names))[::-1]
        for place, name in zip(places, names, strict=True):
            index = of[name]
            if index.effect is not None:
                panel.barh(place, index.effect, color=BLUE, height=0.6)
                continue
            if index.total is not None:
                panel.barh(place, index.total, color=PALE, height=0.7, xerr=index.total_sd, ecolor=GREY)
            panel.barh(place, index.first, color=BLUE, height=0.4, xerr=index.first_sd, ecolor=ORANGE)
        panel.set_yticks(places, names)
        panel.set_title(output, loc="left", fontsize=10)
        panel.grid(axis="y", visible=False)
    if _shares(indices):
        panels[-1].set_xlim(left=0)
        known = all(i.first_sd is None for of in indices.values() for i in of.values())
        panels[-1].set_xlabel(
            "share of the variance:\nblue alone, grey together with others"
            + ("" if known else "\n(lines: one standard deviation)")
        )
    else:
        panels[-1].set_xlabel("mean size of the change over the whole range [SI]")
    return fig


def _shares(indices: Mapping[str, Mapping[str, Index]]) -> bool:
    return all(index.effect is None for of in indices.values() for index in of.values())
