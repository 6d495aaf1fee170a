"""One look for all figures: legible in a text column, and to the colour-blind (Okabe and Ito's palette)."""

from __future__ import annotations

import contextvars
import functools
import io
import weakref
from collections.abc import Callable, Sequence
from typing import Any, Literal, ParamSpec

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

P = ParamSpec("P")

BLUE, ORANGE, GREEN, VERMILLION, PURPLE = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7"
INK, GREY, PALE = "#222222", "#777777", "#DDDDDD"
PHASE_COLOUR = {"pulling": BLUE, "transition": ORANGE, "releasing": GREEN, "rest": GREY}

WIDTH = 5.2  # inches, in reports
DOTS = 200
# Without the backend, which `rc_context` leaves changed: the user's own figures would not show in a notebook.
LOOK: Any = {key: value for key, value in mpl.rcParamsDefault.items() if key != "backend"} | {
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "grid.color": "#EEEEEE",
    "axes.axisbelow": True,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.solid_capstyle": "round",
}


_width = contextvars.ContextVar("width", default=WIDTH)
_again: weakref.WeakKeyDictionary[Figure, Callable[[], Figure]] = weakref.WeakKeyDictionary()


def styled(plot: Callable[P, Figure]) -> Callable[P, Figure]:
    """Draw in this look, whatever the user's matplotlib settings, so that it can be drawn again for print."""

    @functools.wraps(plot)
    def in_style(*args: P.args, **kwargs: P.kwargs) -> Figure:
        with mpl.rc_context(LOOK):
            fig = plot(*args, **kwargs)
        if kwargs.get("axes") is None:  # else it is the caller's figure
            _again[fig] = lambda: in_style(*args, **kwargs)
        return fig

    return in_style


def column_width() -> float:
    """Width of a figure of one column [inches]."""
    return _width.get()


def drawn_again(fig: Figure, wide: float) -> Figure:
    """A figure that a styled function drew, drawn again with columns of another width [inches]."""
    token = _width.set(wide)
    try:
        return _again[fig]()
    finally:
        _width.reset(token)


Into = Axes | Sequence[Axes] | None


def figure(height: float, rows: int = 1, into: Into = None, **grid: Any) -> tuple[Figure, list[Axes]]:
    """A figure of the standard width with `rows` axes above one another; `height` in inches.

    Args:
        height: of the figure [inches].
        rows: how many axes.
        into: axes of the caller to draw into instead, as many.
        grid: as of `Figure.subplots`.

    Raises:
        ValueError: another number of axes is given.
    """
    if into is not None:
        given = own_axes(into, rows)
        own = given[0].get_figure(root=True)
        assert own is not None
        return own, given
    fig = Figure(figsize=(column_width(), height), layout="constrained")
    return fig, list(fig.subplots(rows, 1, squeeze=False, **grid)[:, 0])


def png(fig: Figure, dots: int = DOTS) -> bytes:
    """The figure as PNG, the same bytes for the same figure, with so many dots per inch."""
    stream = io.BytesIO()
    with mpl.rc_context(LOOK):
        fig.savefig(stream, format="png", dpi=dots, metadata={"Software": None})
    return stream.getvalue()


LEGEND = 0.98  # of the width of a figure, that a legend may take


def own_axes(into: Axes | Sequence[Axes], count: int) -> list[Axes]:
    """The caller's axes as a list; ValueError if they are not so many."""
    given = [into] if isinstance(into, Axes) else list(into)
    if len(given) != count:
        raise ValueError(f"axes: this is drawn into {count}, but {len(given)} are given")
    return given


def legend_above(
    fig: Figure, handles: Sequence[Artist], into: Into = None, where: Literal["best", "lower right"] = "best"
) -> None:
    """Legend entries above the axes: in one row, or in as many as the width of the figure asks for; within
    the first of the caller's axes, `where` it is to stand there, where these are drawn into.
    """
    if into is not None:
        first = into if isinstance(into, Axes) else into[0]
        first.legend(handles=list(handles), loc=where)
        return
    for rows in range(1, len(handles) + 1):
        legend = fig.legend(
            handles=list(handles),
            loc="outside upper center",
            ncols=-(-len(handles) // rows),
            handlelength=1.4,
            columnspacing=1.2,
        )
        if legend.get_window_extent().width <= LEGEND * fig.bbox.width:
            return
        if rows < len(handles):
            legend.remove()


THINNEST = 0.005  # of the height of the axes: half the width of a band that is still seen


def is_seen(half_width: float, values: np.ndarray) -> bool:
    """Whether a band about these values, drawn over their range, is wide enough to be seen and spoken of."""
    return half_width > THINNEST * float(np.ptp(values))


def line_by_phase(
    axes: Axes, x: np.ndarray, y: np.ndarray, phases: np.ndarray, *, width: float = 2.2
) -> None:
    """A line whose segment into each point has the colour of that point's phase."""
    points = np.stack([x, y], axis=1)
    colours = [PHASE_COLOUR[phase] for phase in phases[1:]]
    axes.add_collection(
        LineCollection(np.stack([points[:-1], points[1:]], axis=1).tolist(), colors=colours, linewidths=width)
    )
    axes.autoscale_view()


def phase_keys(phases: np.ndarray, *, marker: str = "") -> list[Line2D]:
    """Legend entries for the phases that occur, in their order within a cycle."""
    style: dict[str, Any] = (
        {"marker": marker, "linestyle": "", "markersize": 5} if marker else {"linewidth": 2.2}
    )
    return [Line2D([], [], color=c, label=p, **style) for p, c in PHASE_COLOUR.items() if p in set(phases)]
