"""The plots of the page: loop, tensions and residual over time with linked samples, and along the channel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

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

from gtr_jax.plots.style import BLUE, GREEN, GREY, INK, PURPLE, VERMILLION

from .compared import Compared
from .model import Curves
from .postures import Along

# Orange and sky blue of the palette, darker: lines on white need a contrast of 3.
AMBER, SKY = "#B37A00", "#3B8FC4"
TENDONS = (BLUE, VERMILLION, GREEN, PURPLE, AMBER, INK)
GHOSTS = (AMBER, PURPLE, GREEN, SKY, VERMILLION, GREY)
CHOSEN = VERMILLION
HEIGHT = 300
# Columns of the samples, of each tendon: what is simulated, and what that is compared with.
SHOWN, COMPARED = ("T_base", "T_tip"), ("recorded_base", "recorded_tip")
CHOSEN_ONE = ("residual", "traced", "recorded_traced")


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


class Plotted(NamedTuple):
    """Curves to draw in a colour: the simulation, what the residual is of, and what the last plot shows."""

    colour: str
    curves: Curves
    residual: Compared | None
    traced: Compared


class Curvesheet:
    """The plots over a history: tip against base tension, both over time, the residual of one quantity where
    it was recorded, and one other quantity beside what was recorded of it. Samples brushed in one are lit up
    in all.

    Args:
        names: of the tendons; [""] for one.
        recorded: whether there is a recording with tip tensions.
    """

    def __init__(self, names: Sequence[str], recorded: bool) -> None:
        self._names = names
        self._shown: tuple = ()
        tensions = [f"{name}_{i}" for name in SHOWN for i in range(len(names))]
        both = [f"{name}_{i}" for name in (*COMPARED, *CHOSEN_ONE) for i in range(len(names))]
        empty: list[float] = []
        every = ("time", *tensions, *both)
        self.samples = ColumnDataSource({name: empty for name in every}, name="samples")
        self._now = ColumnDataSource({name: empty for name in tensions}, name="now")
        self._ghosts = {
            part: ColumnDataSource({"xs": [], "ys": [], "colour": []})
            for part in ("loop", "time", "residual", "traced")
        }
        self.loop = plot("Tension at the tip against the base", "T_base [N]", "T_tip [N]", select="both")
        self.time = plot("Tensions over time", "time [s]", "tension [N]", select="width")
        self.residual = plot("Simulated minus recorded", "time [s]", "residual", select="width")
        self.residual.add_layout(Span(location=0, dimension="width", line_color=GREY, line_width=1))
        self.residual.visible = False
        self.traced = plot("Over time", "time [s]", "", select="width")
        self.residual.x_range = self.traced.x_range = self.time.x_range
        parts = {"loop": self.loop, "time": self.time, "residual": self.residual, "traced": self.traced}
        for part, fig in parts.items():
            fig.multi_line(
                "xs", "ys", source=self._ghosts[part], line_color="colour", line_width=2, line_dash="dashed"
            )
        for i in range(len(names)):
            self._draw(i, recorded)
        for fig in (self.loop, self.time):
            legend_above(fig)
        self._cursor = Span(dimension="height", line_color=CHOSEN, line_width=1.5)
        for fig in (self.time, self.residual, self.traced):
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
        look = {"size": 4, "color": INK if not several else colour, "alpha": 0.35}
        self.traced.scatter("time", f"recorded_traced_{i}", source=self.samples, **look, **_lit(1.0))
        self.traced.line("time", f"traced_{i}", **thin)
        self.traced.scatter("time", f"traced_{i}", **dots)
        self.loop.scatter(*names, **dots)
        self.time.scatter("time", names[1], **dots)
        self.loop.scatter(
            *names, source=self._now, size=11, fill_color="white", line_color=CHOSEN, line_width=3
        )

    def show(self, curves: Curves, residual: Compared | None, traced: Compared) -> None:
        """Draw a simulation.

        Args:
            curves: the simulation.
            residual: what the residual is of; None where nothing was recorded.
            traced: what the last plot shows.
        """
        at = slice(curves.history.padded, None)
        columns: dict[str, Any] = {"T_base": curves.T_base, "T_tip": curves.T_tip}
        columns |= {"recorded_base": curves.recorded_base, "recorded_tip": curves.recorded_tip}
        columns |= {"residual": None if residual is None else residual.residual}
        columns |= {"traced": traced.simulated, "recorded_traced": traced.recorded}
        data: dict[str, Any] = {"time": curves.time[at].tolist()}
        absent = {}
        for name, values in columns.items():
            for i in range(len(self._names)):
                if values is None or i >= values.shape[1] or np.all(np.isnan(values[:, i])):
                    absent[f"{name}_{i}"] = np.full(len(data["time"]), np.nan)
                else:
                    # A list: each array goes to the browser in two messages of its own.
                    data[f"{name}_{i}"] = values[at, i].tolist()
        shown = curves.history, residual and residual.label, traced.label, sorted(absent)
        if shown == self._shown:  # only what a slider changes
            same = "time", *(name for name in data if name.startswith("recorded"))
            self.samples.data.update({name: values for name, values in data.items() if name not in same})
        else:
            self.samples.data = data | absent
            self._name(residual, traced)
        self._shown = shown

    def _name(self, residual: Compared | None, traced: Compared) -> None:
        """Say what the plots show that show one quantity at a time or another."""
        self.residual.visible = residual is not None
        if residual is not None:
            self.residual.title.text = f"Simulated minus recorded: {residual.label}"
            self.residual.yaxis.axis_label = f"residual [{residual.unit}]"
        self.traced.title.text = f"{traced.label[:1].upper()}{traced.label[1:]}"
        self.traced.yaxis.axis_label = f"{traced.label} [{traced.unit}]"
        for fig in (self.residual, self.traced):
            fig.html_attributes = {"role": "img", "aria-label": f"Plot: {fig.title.text}"}

    def point_at(self, curves: Curves, step: int) -> None:
        """Mark one step in all plots."""
        self._cursor.location = float(curves.time[step])
        self._now.data = {
            f"{name}_{i}": [float(values[step, i])]
            for i in range(len(self._names))
            for name, values in (("T_base", curves.T_base), ("T_tip", curves.T_tip))
        }

    def show_ghosts(self, ghosts: Sequence[Plotted]) -> None:
        """Draw curves that are kept, each in its colour."""
        rows: dict[str, tuple[list, list, list]] = {part: ([], [], []) for part in self._ghosts}
        for colour, curves, residual, traced in ghosts:
            at = slice(curves.history.padded, None)
            for i in range(len(self._names)):
                drawn = {
                    "loop": (curves.T_base[:, i], curves.T_tip[:, i]),
                    "time": (curves.time, curves.T_tip[:, i]),
                }
                if residual is not None and i < residual.simulated.shape[1]:
                    drawn["residual"] = (curves.time, residual.residual[:, i])
                if i < traced.simulated.shape[1]:
                    drawn["traced"] = (curves.time, traced.simulated[:, i])
                for part, (x, y) in drawn.items():
                    for column, values in zip(rows[part], (x[at], y[at], colour), strict=True):
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
