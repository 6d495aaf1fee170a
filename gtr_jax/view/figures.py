"""The plots of the page: loop, tensions and residual over time with linked samples, and along the channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import (
    BoxSelectTool,
    ColumnDataSource,
    ResetTool,
    SaveTool,
    Span,
    TapTool,
    WheelZoomTool,
)
from bokeh.plotting import figure

from gtr_jax.plots.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, VERMILLION

from .model import Curves
from .postures import Along

TENDONS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, INK)
GHOSTS = (ORANGE, PURPLE, GREEN, "#56B4E9", VERMILLION, GREY)
CHOSEN = VERMILLION
HEIGHT = 300
# Columns of the samples, of each tendon: what is simulated, and what that is compared with.
SHOWN, COMPARED = ("T_base", "T_tip"), ("recorded_base", "recorded_tip", "residual")


def plot(title: str, x: str, y: str, *, select: Any = "", height: int = HEIGHT, **more: Any) -> Any:
    """An empty plot in the page's look; `select` is "both" or "width" where samples can be brushed."""
    tools: list[Any] = [WheelZoomTool(), ResetTool(), SaveTool()]
    drag = BoxSelectTool(dimensions=select) if select else None
    fig: Any = figure(
        title=title,
        x_axis_label=x,
        y_axis_label=y,
        height=height,
        sizing_mode="stretch_width",
        tools=[*tools, *([drag, TapTool()] if drag else [])],
        active_drag=drag,
        toolbar_location="above",
        output_backend="canvas",
        html_attributes={"role": "img", "aria-label": f"Plot: {title}"},
        **more,
    )
    fig.toolbar.logo = None
    fig.toolbar.autohide = True
    fig.grid.grid_line_color = "#E6E6E6"
    fig.outline_line_color = None
    fig.axis.axis_line_color = fig.axis.major_tick_line_color = GREY
    fig.axis.minor_tick_line_color = None
    fig.axis.axis_label_text_font_style = "normal"
    fig.axis.axis_label_text_color = fig.axis.major_label_text_color = INK
    fig.title.text_color = INK
    fig.min_border_right = 12
    return fig


def legend_above(fig: Any) -> None:
    """Put a plot's legend above it, where it hides nothing."""
    legend = fig.legend[0]
    fig.center = [part for part in fig.center if part is not legend]
    fig.add_layout(legend, "above")
    legend.update(
        orientation="horizontal",
        ncols=4,
        border_line_color=None,
        padding=0,
        margin=0,
        spacing=14,
        label_standoff=4,
        glyph_width=18,
        label_text_font_size="12px",
        label_text_color=INK,
        background_fill_alpha=0.0,
    )


class Curvesheet:
    """The plots over a history: tip against base tension, both over time, the residual where tip tensions
    were recorded, and the angle of the tip. Samples brushed in one are lit up in all.

    Args:
        names: of the tendons; [""] for one.
        recorded: whether there is a recording with tip tensions.
    """

    def __init__(self, names: Sequence[str], recorded: bool) -> None:
        self._names, self._history = names, None
        tensions = [f"{name}_{i}" for name in SHOWN for i in range(len(names))]
        both = [f"{name}_{i}" for name in COMPARED for i in range(len(names))]
        empty: list[float] = []
        every = ("time", "tip_angle", *tensions, *both)
        self.samples = ColumnDataSource({name: empty for name in every}, name="samples")
        self._now = ColumnDataSource({name: empty for name in tensions}, name="now")
        self._ghosts = {
            part: ColumnDataSource({"xs": [], "ys": [], "colour": []})
            for part in ("loop", "time", "residual", "angle")
        }
        self.loop = plot("Tension at the tip against the base", "T_base [N]", "T_tip [N]", select="both")
        self.time = plot("Tensions over time", "time [s]", "tension [N]", select="width")
        self.residual = plot("Simulated minus recorded", "time [s]", "residual of T_tip [N]", select="width")
        self.residual.add_layout(Span(location=0, dimension="width", line_color=GREY, line_width=1))
        self.residual.visible = recorded
        self.angle = plot("Angle of the tip", "time [s]", "angle [deg]", select="width")
        self.residual.x_range = self.angle.x_range = self.time.x_range
        parts = {"loop": self.loop, "time": self.time, "residual": self.residual, "angle": self.angle}
        for part, fig in parts.items():
            fig.multi_line(
                "xs", "ys", source=self._ghosts[part], line_color="colour", line_width=2, line_dash="dashed"
            )
        for i in range(len(names)):
            self._draw(i, recorded)
        for fig in (self.loop, self.time):
            legend_above(fig)
        self._cursor = Span(dimension="height", line_color=CHOSEN, line_width=1.5)
        for fig in (self.time, self.residual, self.angle):
            fig.add_layout(self._cursor)

    def _draw(self, i: int, recorded: bool) -> None:
        several = len(self._names) > 1
        of = f" {self._names[i]}" if several else ""
        colour = TENDONS[i % len(TENDONS)]
        names = (f"T_base_{i}", f"T_tip_{i}")
        if recorded:
            look = {"size": 4, "color": INK if not several else colour, "alpha": 0.35}
            at = {"source": self.samples, **look, **_lit(1.0)}
            self.loop.scatter(f"recorded_base_{i}", f"recorded_tip_{i}", legend_label=f"recorded{of}", **at)
            self.time.scatter("time", f"recorded_tip_{i}", legend_label=f"recorded{of}", **at)
        line = {"source": self.samples, "color": colour, "line_width": 2, "nonselection_alpha": 0.6}
        dots = {"source": self.samples, "size": 4, "color": colour, "alpha": 0.0, **_lit(0.0)}
        self.loop.line(*names, legend_label=f"simulated{of}", **line)
        self.time.line("time", names[1], legend_label=f"T_tip{of}", **line)
        self.time.line(
            "time",
            names[0],
            legend_label=f"T_base{of}",
            **(line | {"color": GREY if not several else colour}),
            line_dash="dotted",
        )
        thin = line | {"line_width": 1.5}
        self.residual.line("time", f"residual_{i}", **thin)
        self.residual.scatter("time", f"residual_{i}", **dots)
        if i == 0:
            self.angle.line("time", "tip_angle", **(thin | {"color": INK}))
            self.angle.scatter("time", "tip_angle", **dots)
        self.loop.scatter(*names, **dots)
        self.time.scatter("time", names[1], **dots)
        self.loop.scatter(
            *names, source=self._now, size=11, fill_color="white", line_color=CHOSEN, line_width=3
        )

    def show(self, curves: Curves) -> None:
        """Draw a simulation."""
        at = slice(curves.history.padded, None)
        data: dict[str, Any] = {"time": curves.time[at], "tip_angle": np.degrees(curves.tip_angle[at])}
        none = np.full(len(data["time"]), np.nan)
        compared = curves.recorded_base, curves.recorded_tip, curves.residual
        for names, each in ((SHOWN, (curves.T_base, curves.T_tip)), (COMPARED, compared)):
            for name, values in zip(names, each, strict=True):
                for i in range(len(self._names)):
                    data[f"{name}_{i}"] = none if values is None else values[at, i]
        # As lists: each array goes to the browser in two messages of its own.
        data = {name: values.tolist() for name, values in data.items()}
        if curves.history is self._history:  # only what a slider changes
            gone = "time", *(name for name in data if name.startswith("recorded"))
            self.samples.data.update({name: v for name, v in data.items() if name not in gone})
        else:
            self.samples.data = data
            self.residual.visible = curves.residual is not None
        self._history = curves.history

    def point_at(self, curves: Curves, step: int) -> None:
        """Mark one step in all plots."""
        self._cursor.location = float(curves.time[step])
        self._now.data = {
            f"{name}_{i}": [float(values[step, i])]
            for i in range(len(self._names))
            for name, values in (("T_base", curves.T_base), ("T_tip", curves.T_tip))
        }

    def show_ghosts(self, ghosts: Sequence[tuple[str, Curves]]) -> None:
        """Draw curves that are kept, each in its colour."""
        rows: dict[str, tuple[list, list, list]] = {part: ([], [], []) for part in self._ghosts}
        for colour, curves in ghosts:
            at = slice(curves.history.padded, None)
            time = curves.time[at]
            for i in range(len(self._names)):
                drawn = {
                    "loop": (curves.T_base[at, i], curves.T_tip[at, i]),
                    "time": (time, curves.T_tip[at, i]),
                }
                if curves.residual is not None:
                    drawn["residual"] = (time, curves.residual[at, i])
                if i == 0:
                    drawn["angle"] = (time, np.degrees(curves.tip_angle[at]))
                for part, (x, y) in drawn.items():
                    for column, values in zip(rows[part], (x, y, colour), strict=True):
                        column.append(values)
        for part, (xs, ys, colours) in rows.items():
            self._ghosts[part].data = {"xs": xs, "ys": ys, "colour": colours}


def _lit(alpha: float) -> dict[str, Any]:
    """How chosen samples look, and the others beside them."""
    return {
        "selection_color": CHOSEN,
        "selection_alpha": 0.9,
        "nonselection_alpha": 0.25 * alpha,
    }


class Channelsheet:
    """The plots along the channel: contact force and friction per length, and tension.

    Args:
        names: of the tendons; [""] for one.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._sources = [
            ColumnDataSource({"s": [], "tension": [], "normal": [], "friction": []}) for _ in names
        ]
        self.force = plot("Force on the channel", "s [mm]", "force per length [N/m]")
        self.tension = plot("Tension along the tendon", "s [mm]", "tension [N]")
        self.tension.x_range = self.force.x_range
        for i, (name, source) in enumerate(zip(names, self._sources, strict=True)):
            of = f" {name}" if len(names) > 1 else ""
            colour = TENDONS[i % len(TENDONS)]
            look = {"source": source, "line_width": 2}
            self.force.line("s", "normal", legend_label=f"contact{of}", color=colour, **look)
            friction = VERMILLION if len(names) == 1 else colour
            self.force.line(
                "s", "friction", legend_label=f"friction{of}", color=friction, line_dash="dashed", **look
            )
            self.tension.line("s", "tension", color=colour, **look)
        legend_above(self.force)

    def show(self, along: Sequence[Along]) -> None:
        """Draw one step."""
        for source, own in zip(self._sources, along, strict=True):
            columns = {"s": own.s, "tension": own.tension, "normal": own.normal, "friction": own.friction}
            source.data = {name: values.tolist() for name, values in columns.items()}
