"""What a chart shows, said once: `chart_figure.py` draws it on paper, `report/playback.py` writes it for the
browser.

A label reads "quantity, whose": "T_tip, recorded". Colours mean the same everywhere: black is the model that
was fitted, vermillion a model before and blue after something was put in, grey what was recorded or does not
count, and phases have those of `style.PHASE_COLOUR`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from .style import GREY


@dataclass(frozen=True, eq=False)
class Column:
    """A quantity of K samples: what to call it, its unit and its values as shown, NaN where there is none."""

    label: str
    unit: str
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Line:
    """One quantity over another; dots, crosses or a line of one colour, or in the colours of phases, (K,)
    labels; about it a band, of which `band` is half the height.
    """

    x: Column
    y: Column
    colour: str = GREY
    style: Literal["line", "dashed", "dots", "crosses"] = "line"
    phases: np.ndarray | None = None
    band: Column | None = None


class Span(NamedTuple):
    """A stretch of the axis across, in its unit: what it is, a mark that is written above it, its colour."""

    start: float
    end: float
    label: str
    mark: str
    colour: str


@dataclass(frozen=True, eq=False)
class Chart:
    """Lines over common axes.

    Attributes:
        title, across, up: of the chart and of its axes, with units.
        lines: in the order in which they are drawn.
        noise: standard deviation of what is drawn; a band of two of it lies about zero. None for no band.
        spans: stretches across that are told apart by colour.
    """

    title: str
    across: str
    up: str
    lines: Sequence[Line]
    noise: float | None = None
    spans: Sequence[Span] = ()


def clock_of(time: np.ndarray | None, samples: int) -> tuple[Column, str]:
    """What the courses of a recording run along, and the label of that axis: time, or numbers of samples."""
    if time is None:
        return Column("sample", "", np.arange(1.0, samples + 1)), "sample"
    return Column("time", "s", np.asarray(time)), "time [s]"
