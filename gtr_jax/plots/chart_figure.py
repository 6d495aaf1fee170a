"""Charts as figures: each in axes of its own, above one another, with one legend."""

from __future__ import annotations

import itertools
import re
import textwrap
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from .chart import Chart, Line, Span
from .style import (
    GREY,
    INK,
    PALE,
    PHASE_COLOUR,
    figure,
    is_seen,
    legend_above,
    line_by_phase,
    phase_keys,
    styled,
)

DASHED = (0, (4, 2))
LETTER = 0.072  # of the label of an axis: its width [inches]
MARKS: dict[str, dict[str, Any]] = {
    "dots": {"linestyle": "", "marker": "o", "markersize": 2.6, "alpha": 0.6},
    "crosses": {"linestyle": "", "marker": "+", "markersize": 9, "markeredgewidth": 1.6},
    "dashed": {"linewidth": 1.0, "linestyle": DASHED},
    "line": {"linewidth": 0.9},
}
IN_LEGEND = {"markersize": 5, "alpha": 1.0, "linewidth": 1.4}


@styled
def plot_charts(charts: Sequence[Chart], height: float, noted: Sequence[str] = ()) -> Figure:
    """Charts above one another. Those that say the same of an axis share it, and have their titles where they
    share both.

    Args:
        charts: from the top; at least one.
        height: of the figure [inches].
        noted: lines that are written into the lower right corner of the first.
    """
    alike_across, alike_up = len({c.across for c in charts}) == 1, len({c.up for c in charts}) == 1
    fig, rows = figure(height, len(charts), sharex=alike_across, sharey=alike_up)
    for axes, chart in zip(rows, charts, strict=True):
        _draw(axes, chart)
        wide = int((height / len(charts) - 0.5) / LETTER)
        axes.set_ylabel(typeset(textwrap.fill(chart.up, wide)))
        if axes is rows[-1] or not alike_across:
            axes.set_xlabel(typeset(chart.across))
        if len(charts) > 1 and alike_across and alike_up:
            axes.set_title(chart.title, loc="left", fontsize=9)
    if noted:
        place = {"ha": "right", "va": "bottom", "multialignment": "left", "transform": rows[0].transAxes}
        rows[0].text(0.98, 0.04, "\n".join(noted), fontsize=9, color=INK, zorder=6, **place)
    legend_above(fig, _keys(charts))
    return fig


def typeset(words: str) -> str:
    """Words of a chart as paper has them: symbols in italics, that of a tension also behind its name."""
    words = re.sub(r"tension at the (base|tip)([^[]*) \[", r"tension at the \1\2 T_\1 [", words)
    words = re.sub(r"\b(tip|about) ([xyz])\b", r"\1 $\2$", words)
    return re.sub(r"\bT_(base|tip)\b", r"$T_{\1}$", words)


def _draw(axes: Axes, chart: Chart) -> None:
    if chart.noise is not None:
        axes.axhspan(-2 * chart.noise, 2 * chart.noise, color=PALE, linewidth=0, zorder=0)
        axes.axhline(0.0, color=INK, linewidth=0.8, zorder=1.5)
    for span in chart.spans:
        axes.axvspan(span.start, span.end, **_look(span), zorder=0.5)
        axes.annotate(
            span.mark,
            (0.5 * (span.start + span.end), 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color=INK,
        )
    for line in chart.lines:
        if line.band is not None:
            _band(axes, line, line.band.values)
    for line in chart.lines:
        style = MARKS[line.style]
        x, y = np.asarray(line.x.values, float), np.asarray(line.y.values, float)
        if line.phases is None:
            axes.plot(x, y, color=line.colour, **style)
        elif line.style in ("line", "dashed"):
            line_by_phase(axes, x, y, line.phases)
        else:
            for phase, colour in PHASE_COLOUR.items():
                here = line.phases == phase
                if np.any(here):
                    axes.plot(x[here], y[here], color=colour, **style)


def _band(axes: Axes, line: Line, half: np.ndarray) -> None:
    """A band about a line, in pieces between which it turns back, so that it covers itself nowhere."""
    x, y = line.x.values, line.y.values
    pieces = [0, *(np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 1).tolist(), len(x) - 1]
    for a, b in itertools.pairwise(pieces):
        part = slice(a, b + 1)
        low, high = y[part] - half[part], y[part] + half[part]
        axes.fill_between(x[part], low, high, color=PALE, linewidth=0, zorder=0)


def _look(span: Span) -> dict[str, Any]:
    """Of a stretch; a grey one is hatched, lest it pass for a band of noise."""
    if span.colour == GREY:
        return {"facecolor": "none", "edgecolor": GREY, "hatch": "////", "linewidth": 0, "alpha": 0.5}
    return {"color": span.colour, "alpha": 0.25, "linewidth": 0}


def _keys(charts: Sequence[Chart]) -> list[Artist]:
    """Entries of the legend: of a line that is not coloured by phase its label, without the quantity where
    no other line is of the same; phases that occur; bands that are seen; and stretches.
    """
    lines = [line for chart in charts for line in chart.lines]
    kinds = {(_whose(line), line.colour, line.style, line.phases is None) for line in lines}
    known = Counter(name for name, *_ in kinds)
    keys: dict[Any, Artist] = {}
    for line in lines:
        if line.phases is not None:
            marker = "" if line.style in ("line", "dashed") else MARKS[line.style]["marker"]
            keys |= {(key.get_label(), ""): key for key in phase_keys(line.phases, marker=marker)}
            continue
        name = _whose(line) if known[_whose(line)] == 1 else line.y.label
        style = MARKS[line.style] | IN_LEGEND
        keys[name, line.colour] = Line2D([], [], color=line.colour, label=typeset(name), **style)
    for line in lines:
        if line.band is not None and is_seen(float(np.nanmax(line.band.values)), line.y.values):
            name = line.band.label.partition(", ")[0]
            keys[name, PALE] = Patch(color=PALE, label=name)
    for chart in charts:
        keys |= {(span.label, span.colour): Patch(label=span.label, **_look(span)) for span in chart.spans}
        if chart.noise:
            keys["noise", PALE] = Patch(color=PALE, label="noise, ±2 sd")
    return list(keys.values())


def _whose(line: Line) -> str:
    """The label of a line without its quantity."""
    return line.y.label.rpartition(", ")[2]
