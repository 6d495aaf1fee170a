"""A load history for the page: what `playback.js` needs for charts of its samples and the body among them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gtr_jax.plots.chart import Chart, Column, Line
from gtr_jax.plots.style import PHASE_COLOUR

from .page import Playback

MOST = 4000  # samples in charts
PEAKS = 8  # of the quantities that are told, whose peaks a long history keeps
DIGITS = 6  # of a value: more than a chart or a load cell shows
CAPTION = (
    "Play the history, or go through it with the slider, the arrow keys, or a click into a chart. Drag a box "
    "to zoom; Shift and drag moves what is seen; the wheel zooms the chart that was clicked last, or with "
    "Ctrl any; a double click shows all."
)


def playback(
    charts: Sequence[Chart],
    *,
    clock: Column,
    told: Sequence[Column],
    unit: str,
    first: int = 0,
    body: Mapping[str, Any] | None = None,
    stills: Sequence[str] = (),
    title: str = "",
    starts: Sequence[int] = (),
) -> Playback:
    """A history of K samples as a part of a page.

    Args:
        charts: to draw, in this order, after the body.
        clock: time, or the number, of the samples.
        told: columns whose present values are told above the charts; at least one.
        unit: what a sample is called.
        first: the sample that is shown first.
        body: from `motion.body_of`, or None.
        stills: as of `Playback`.
        title: above them, where a page has several.
        starts: samples, counted from 0, at which the history starts again, so that no line leads there.
    """
    lines = [line for chart in charts for line in chart.lines]
    used = [c for line in lines for c in (line.x, line.y, line.band) if c is not None]
    columns = list(dict.fromkeys([clock, *told, *used]))
    lists = list({id(line.phases): line.phases for line in lines if line.phases is not None}.values())
    K = len(clock.values)
    kept = kept_samples([np.asarray(c.values, float) for c in told[:PEAKS]], MOST)
    if first not in kept:
        kept = np.sort([*kept, first])

    def one(line: Line) -> dict[str, Any]:
        which = [i for i, own in enumerate(lists) if own is line.phases]
        return {
            "x": columns.index(line.x),
            "y": columns.index(line.y),
            "colour": line.colour,
            "style": line.style,
            "phases": which[0] if which else None,
            "band": None if line.band is None else columns.index(line.band),
        }

    data = {
        "unit": unit,
        "of": K,
        "numbers": (kept + 1).tolist(),
        "clock": columns.index(clock),
        "first": int(np.flatnonzero(kept == first)[0]),
        "starts": np.searchsorted(kept, starts).tolist(),
        "columns": [
            {"label": c.label, "unit": c.unit, "values": _short(np.asarray(c.values, float)[kept])}
            for c in columns
        ],
        "phases": [_phases(own[kept]) for own in lists],
        "told": [columns.index(column) for column in told],
        "charts": [
            {
                "title": chart.title,
                "across": chart.across,
                "up": chart.up,
                "says": f"{chart.title}: {chart.up} over {chart.across}.",
                "lines": [one(line) for line in chart.lines],
                "noise": chart.noise,
                "spans": [span._asdict() for span in chart.spans],
                "clock": all(line.x is clock for line in chart.lines),
            }
            for chart in charts
        ],
        "body": body,
    }
    fewer = f" {len(kept):,} of {K:,} samples are shown." if len(kept) < K else ""
    turned = " Drag the body, or press its arrow keys, to turn it." if body and body["space"] else ""
    return Playback(data, f"{CAPTION}{turned}{fewer}", tuple(stills), title)


def kept_samples(columns: Sequence[np.ndarray], most: int) -> np.ndarray:
    """Which samples of a long recording charts show: of each stretch those where a quantity is least and
    largest, so that peaks stay, and others at even steps; the first and the last always.

    Args:
        columns: quantities, (K,) each; NaN where there is no reading.
        most: samples to keep, about.
    """
    K = len(columns[0])
    if most >= K:
        return np.arange(K)
    ends = np.linspace(0, K, max(most // (2 * len(columns)), 1) + 1).astype(int)
    picked: list[int] = []
    for values in columns:
        read = np.isfinite(values)
        known = np.where(read, values, np.median(values[read]) if read.any() else 0.0)
        picked += [a + int(pick(known[a:b])) for a, b in itertools.pairwise(ends) for pick in _ENDS]
    peaks = np.unique(picked)
    return np.unique([*peaks, *np.linspace(0, K - 1, max(most - len(peaks), 2)).astype(int)])


_ENDS = (np.argmin, np.argmax)


def _short(values: np.ndarray) -> list[float | None]:
    return [float(f"{v:.{DIGITS}g}") if np.isfinite(v) else None for v in values]


def _phases(labels: np.ndarray) -> dict[str, Any]:
    # A line has the colour of its later end, so that the first sample's is seen nowhere unless it is alone.
    labels = np.concatenate([labels[1:2], labels[1:]]) if len(labels) > 1 else labels
    names = [name for name in PHASE_COLOUR if name in set(labels.tolist())]
    return {
        "names": names,
        "colours": [PHASE_COLOUR[name] for name in names],
        "of": "".join(str(names.index(label)) for label in labels.tolist()),
    }
