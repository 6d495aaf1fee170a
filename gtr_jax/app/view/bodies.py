"""The plot of the body: its outline, its channels coloured by tension, the contact force as a comb, and
markers and what was recorded of them and of the tip.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from bokeh.models import ColorBar, ColumnDataSource, CustomJS, DataRange1d, LinearColorMapper
from bokeh.palettes import Viridis256

from gtr_jax.plots.style import BLUE, INK, VERMILLION
from gtr_jax.plots.views import INSIDE

from .figures import CHOSEN, legend_above, plot
from .postures import Drawing, View

MIDDLE = "#8A8A8A"
_FIRST, _SECOND = slice(None, -1), slice(1, None)  # ends of the pieces of a line
NOTHING: Any = {"xs": [], "ys": []}
ENDS = ("x0", "y0", "x1", "y1")
NO_COLOUR: Any = {"colour": []}
NO_TENSION: Any = {"tension": []}
# Says that a shape stands on the screen, once the frame that shows it has ended.
PAINTED = "requestAnimationFrame(() => setTimeout(() => { this.tags = [performance.now()] }))"


class Side:
    """The body from one side.

    Args:
        axes: what is across and up, two of "xyz".
        colours: of the tension.
        bar: whether its colour bar stands beside it.
    """

    def __init__(self, axes: str, colours: LinearColorMapper, *, bar: bool) -> None:
        empty: Any = {name: [] for name in ENDS}
        self._outline, self._ghosts = ColumnDataSource(NOTHING), ColumnDataSource(NOTHING | NO_COLOUR)
        self._brushed = ColumnDataSource(NOTHING, name="brushed midlines" if bar else "")
        self._middle = ColumnDataSource({"x": [], "y": []}, name="midline" if bar else f"midline {axes}")
        self._channel, self._teeth = ColumnDataSource(empty | NO_TENSION), ColumnDataSource(empty)
        self._markers, self._recorded = (
            ColumnDataSource({"x": [], "y": []}, name=f"{name}{'' if bar else f' {axes}'}")
            for name in ("markers", "recorded places")
        )
        self._room, self._seen = ColumnDataSource({"x": [], "y": []}), np.zeros((0, 2))
        self.plot = plot(
            "The body, its channels coloured by tension" if bar else f"{axes[0]} and {axes[1]}",
            f"{axes[0]} [mm]",
            f"{axes[1]} [mm]",
            height=430 if bar else 330,
            match_aspect=True,
        )
        # Both axes follow what was seen so far, not each shape, which would make the plot jump.
        room = self.plot.scatter("x", "y", source=self._room, alpha=0.0, size=1)
        self.plot.x_range, self.plot.y_range = (DataRange1d(renderers=[room]) for _ in "xy")
        for colour, width in ((INK, 2.0), (INSIDE, 0.5)):
            self.plot.patches(
                "xs", "ys", source=self._outline, line_color=colour, fill_color=colour, line_width=width
            )
        self.plot.multi_line(
            "xs", "ys", source=self._ghosts, line_color="colour", line_width=2, line_dash="dashed"
        )
        self.plot.multi_line(
            "xs", "ys", source=self._brushed, line_color=CHOSEN, line_width=1, line_alpha=0.7
        )
        self.plot.line("x", "y", source=self._middle, color=MIDDLE, line_dash="dotdash")
        self.plot.segment("x0", "y0", "x1", "y1", source=self._teeth, color=BLUE, alpha=0.45, line_width=1.5)
        coloured: Any = {"field": "tension", "transform": colours}
        self.plot.segment(
            "x0", "y0", "x1", "y1", source=self._channel, color=coloured, line_width=4, line_cap="round"
        )
        marked, recorded = ({"legend_label": name} if bar else {} for name in ("marker", "recorded"))
        self.plot.scatter("x", "y", source=self._markers, marker="square", size=7, color=INK, **marked)
        self.plot.scatter(
            "x",
            "y",
            source=self._recorded,
            marker="x",
            size=11,
            line_width=2.5,
            color=VERMILLION,
            **recorded,
        )
        self._says = None
        if bar:
            legend_above(self.plot)
            self._says = self.plot.above[-1]
            self._says.visible = False
            legend = ColorBar(color_mapper=colours, title="T [N]", width=10, label_standoff=5, padding=4)
            self.plot.add_layout(legend, "right")

    def show(self, view: View) -> None:
        """Draw one shape."""
        self._outline.data = _lines(view.outline)
        self._middle.data = _points(view.middle)
        starts, ends = (np.concatenate([line[cut] for line in view.channels]) for cut in (_FIRST, _SECOND))
        tension = np.concatenate([0.5 * (T[_FIRST] + T[_SECOND]) for T in view.tension])
        self._channel.data = _segments(starts, ends) | {"tension": tension.tolist()}
        starts, tips = (np.concatenate(part) for part in zip(*view.teeth, strict=True))
        self._teeth.data = _segments(starts, tips)
        for source, places in ((self._markers, view.markers), (self._recorded, view.recorded)):
            if len(places) or len(source.data["x"]):
                source.data = _points(places)
        shown = bool(len(view.markers) or len(view.recorded))
        if self._says is not None and self._says.visible != shown:
            self._says.visible = shown
        self._make_room(view)

    def on_painted(self, painted: Callable[[], None]) -> None:
        """Have a function called whenever a browser has painted a shape."""
        self._middle.js_on_change("data", CustomJS(code=PAINTED))
        self._middle.on_change("tags", lambda attr, old, new: painted())

    def forget_room(self) -> None:
        """Let the axes follow from here on what is drawn next, and nothing that was drawn before."""
        self._seen = np.zeros((0, 2))

    def show_ghosts(self, ghosts: Sequence[tuple[str, View]]) -> None:
        """Draw shapes that are kept: the midline and channels of each in its colour."""
        lines = [(colour, line) for colour, view in ghosts for line in (view.middle, *view.channels)]
        self._ghosts.data = _lines([line for _, line in lines]) | {"colour": [colour for colour, _ in lines]}

    def show_brushed(self, lines: Sequence[np.ndarray]) -> None:
        """Draw the midlines of brushed samples."""
        if lines or len(self._brushed.data["xs"]):
            self._brushed.data = _lines(lines)

    def _make_room(self, view: View) -> None:
        tips = [ends for _, ends in view.teeth]
        points = np.concatenate([*view.outline, *tips, view.markers, view.recorded, self._seen])
        corners = np.stack([points.min(axis=0), points.max(axis=0)])
        if len(self._seen) != 2 or np.any(corners != self._seen):
            self._seen = corners
            self._room.data = _points(corners)


# Lists, not arrays: each array goes to the browser in two messages of its own, which takes longer than to
# write out the few numbers of a shape.
def _points(points: np.ndarray) -> Any:
    return {"x": points[:, 0].tolist(), "y": points[:, 1].tolist()}


def _lines(lines: Sequence[np.ndarray]) -> Any:
    return {"xs": [line[:, 0].tolist() for line in lines], "ys": [line[:, 1].tolist() for line in lines]}


def _segments(starts: np.ndarray, ends: np.ndarray) -> dict[str, Any]:
    return {name: own.tolist() for name, own in zip(ENDS, (*starts.T, *ends.T), strict=True)}


class Body:
    """The body from one side, or in space from three.

    Args:
        in_space: whether it is in space.
    """

    def __init__(self, in_space: bool) -> None:
        self._colours = LinearColorMapper(palette=Viridis256[::-1], low=0.0, high=1.0)
        axes = ("xy", "xz", "yz") if in_space else ("xy",)
        self._sides = [Side(own, self._colours, bar=i == 0) for i, own in enumerate(axes)]

    @property
    def plots(self) -> list[Any]:
        """The plots, that of x and y first."""
        return [side.plot for side in self._sides]

    def show(self, drawing: Drawing, most: float) -> None:
        """Draw one step; `most` is the largest tension of the history [N]."""
        self._colours.high = most if most > 0 else 1.0
        for side, view in zip(self._sides, drawing.views, strict=True):
            side.show(view)

    def on_painted(self, painted: Callable[[], None]) -> None:
        """Have a function called whenever a browser has painted a shape."""
        self._sides[0].on_painted(painted)

    def forget_room(self) -> None:
        """Let the axes follow what is drawn next, and nothing that was drawn before."""
        for side in self._sides:
            side.forget_room()

    def show_ghosts(self, ghosts: Sequence[tuple[str, Drawing]]) -> None:
        """Draw shapes that are kept."""
        for i, side in enumerate(self._sides):
            side.show_ghosts([(colour, drawing.views[i]) for colour, drawing in ghosts])

    def show_brushed(self, midlines: Sequence[Sequence[np.ndarray]]) -> None:
        """Draw the midlines of brushed samples, from each side."""
        for side, lines in zip(self._sides, midlines, strict=True):
            side.show_brushed(lines)
