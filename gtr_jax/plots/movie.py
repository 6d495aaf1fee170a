"""A movie of a simulation: the body as it moves, its channels coloured by tension, and the loop beside it."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib import animation
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

from gtr_jax.errors import InputError, reason
from gtr_jax.interpreters import program

from .style import GREY, INK, LOOK, PALE, PHASE_COLOUR, VERMILLION
from .tendons import COLOURS
from .views import COLOURS as TENSIONS
from .views import INSIDE, Drawn, Posture, Strung, drawn

ENDINGS = (".gif", ".mp4")
FFMPEG = "ffmpeg"
FRAMES = 120  # most
RATE = 15  # frames per second
HELD = 10  # frames for which the last one stands
POINTS, CORNERS = 60, 16  # a body is drawn at, and of a section in space
DOTS = 100  # per inch
YAW, PITCH = np.radians(60.0), np.radians(25.0)  # from where a body in space is seen
FILL = "#EBEBEB"
AXIS_COLOURS = ("#D55E00", "#009E73", "#0072B2")


class Loop(NamedTuple):
    """Tensions of a history of K steps: base and tip [N], (K, tendons); and the phase of each step, (K,), of
    an only tendon, None of several.
    """

    T_base: np.ndarray
    T_tip: np.ndarray
    phases: np.ndarray | None


def check_movie(name: str) -> None:
    """InputError if no movie of this name can be written."""
    path = Path(name)
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"--movie {name}: must end in .gif or .mp4; give for example motion.gif")
    if path.name != name:
        raise InputError(
            f"--movie {name}: is a name in the run folder, without folders of its own; give {path.name}"
        )
    if path.suffix.lower() == ".mp4" and program(FFMPEG) is None:
        raise InputError(
            f"--movie {name}: needs ffmpeg, which is not on the PATH; install it, or give {path.stem}.gif"
        )


def write_movie(
    path: Path, body: Strung, postures: Sequence[Posture], *, steps: Sequence[int], loop: Loop, space: bool
) -> None:
    """Write a movie, GIF or MP4 by the ending of its path.

    Args:
        path: to write.
        body: the body and its channels.
        postures: its shape in each frame, named.
        steps: which of the K steps each frame shows.
        loop: the tensions.
        space: whether the body leaves the plane of x and y.

    Raises:
        InputError: ffmpeg fails.
    """
    gif = path.suffix.lower() == ".gif"
    with mpl.rc_context(LOOK | {"animation.ffmpeg_path": program(FFMPEG) or FFMPEG}):
        writer: Any = (animation.PillowWriter if gif else animation.FFMpegWriter)(fps=RATE)
        picture = _Picture(
            [drawn(body, p, POINTS, CORNERS if space else 2) for p in postures], body, loop, space=space
        )
        try:
            with writer.saving(picture.fig, str(path), DOTS):
                for k, (step, posture) in enumerate(zip(steps, postures, strict=True)):
                    picture.show(k, step, posture)
                    for _ in range(1 + HELD * (k == len(postures) - 1)):
                        writer.grab_frame()
        except (subprocess.CalledProcessError, BrokenPipeError) as fault:
            raise InputError(
                f"--movie {path.name}: ffmpeg cannot write it ({reason(fault)}); give {path.stem}.gif"
            ) from None


class _Picture:
    """The two axes, and what changes in them from frame to frame."""

    def __init__(self, shapes: list[Drawn], body: Strung, loop: Loop, *, space: bool):
        self.shapes, self.loop, self.ends = shapes, loop, body.ends
        # MP4 asks for even numbers of dots.
        self.fig = Figure(figsize=(8.4, 4.0), layout="constrained")
        left, right = self.fig.subplots(1, 2, width_ratios=[1.15, 1])
        self.sides = _axonometric() if space else np.eye(3)[:2]
        rest = _outline(shapes[0], self.sides)
        self._frame(left, space=space)
        for collection in _body(left, PALE, INSIDE):
            collection.set_verts(rest)
        self.body = _body(left, GREY, FILL)
        most = max(float(np.max(shape.tension)) for shape in shapes)
        norm = Normalize(0.0, most if most > 0 else 1.0)
        style: dict[str, Any] = {"cmap": TENSIONS, "norm": norm, "linewidths": 2.6, "zorder": 3}
        self.channels = [LineCollection([], **style) for _ in body.offsets]
        for channel in self.channels:
            channel.set_capstyle("round")
            left.add_collection(channel)
        (self.markers,) = left.plot([], [], "s", color=VERMILLION, markersize=4, zorder=4)
        scale = ScalarMappable(norm, TENSIONS)
        bar = self.fig.colorbar(scale, ax=left, location="bottom", shrink=0.6, aspect=30)
        bar.set_label("tension [N]")
        self._draw_loop(right, body.names)
        self.title = self.fig.suptitle("step", fontsize=10)
        self.fig.draw_without_rendering()
        self.fig.set_layout_engine("none")  # nothing moves from frame to frame, and it takes half the time

    def _frame(self, axes: Axes, *, space: bool) -> None:
        seen = np.concatenate([(shape.sections @ self.sides.T).reshape(-1, 2) for shape in self.shapes])
        low, high = seen.min(axis=0), seen.max(axis=0)
        margin = 0.06 * float(np.max(high - low))
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(low[1] - margin, high[1] + margin)
        axes.set_aspect("equal", adjustable="box")
        if not space:
            axes.set_xlabel("x [mm]")
            axes.set_ylabel("y [mm]")
            return
        axes.set_axis_off()
        size = float(np.max(high - low))
        power = 10.0 ** np.floor(np.log10(0.3 * size))
        length = max(m for m in (1, 2, 5) if m * power <= 0.3 * size) * power
        axes.add_artist(
            AnchoredSizeBar(axes.transData, length, f"{length:g} mm", "lower right", frameon=False)
        )
        for arrow, name, colour in zip(0.12 * size * self.sides.T, "xyz", AXIS_COLOURS, strict=True):
            corner = low + np.array([0.0, 0.04 * size])
            axes.plot(*np.stack([corner, corner + arrow]).T, color=colour, linewidth=1.6)
            x, y = corner + 1.25 * arrow
            axes.text(x, y, name, color=colour, ha="center", va="center")

    def _draw_loop(self, axes: Axes, names: Sequence[str]) -> None:
        T_base, T_tip, phases = self.loop
        several = {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(names)}
        if phases is None:
            keys, self.colours = several, [[colour] * len(T_base) for colour in several.values()]
        else:
            keys = {name: colour for name, colour in PHASE_COLOUR.items() if name in set(phases[1:].tolist())}
            self.colours = [[PHASE_COLOUR[phase] for phase in phases[1:]]]
        self.traces = [LineCollection([], linewidths=2.2) for _ in self.colours]
        for trace in self.traces:
            axes.add_collection(trace)
        axes.plot(T_base, T_tip, color=PALE, linewidth=1.2, zorder=1)
        (self.now,) = axes.plot([], [], "o", color=INK, markersize=6, zorder=4)
        axes.legend(handles=[Line2D([], [], color=c, linewidth=2.2, label=name) for name, c in keys.items()])
        axes.set_xlabel("tension at the base $T_{base}$ [N]")
        axes.set_ylabel("tension at the tip $T_{tip}$ [N]")

    def show(self, k: int, step: int, posture: Posture) -> None:
        """Change to frame k, which shows a step of the history."""
        shape = self.shapes[k]
        polygons = _outline(shape, self.sides)
        for collection in self.body:
            collection.set_verts(polygons)
        for lines, channel, tension, end in zip(
            self.channels, shape.channels, shape.tension, self.ends, strict=True
        ):
            run = shape.s <= end * (1 + 1e-9)
            points, own = (channel @ self.sides.T)[run], tension[run]
            lines.set_segments(list(np.stack([points[:-1], points[1:]], axis=1)))
            lines.set_array(0.5 * (own[1:] + own[:-1]))
        self.markers.set_data(*(1e3 * posture.markers @ self.sides.T).T)
        T_base, T_tip, _ = self.loop
        for i, (trace, colours) in enumerate(zip(self.traces, self.colours, strict=True)):
            points = np.stack([T_base[: step + 1, i], T_tip[: step + 1, i]], axis=1)
            trace.set_segments(list(np.stack([points[:-1], points[1:]], axis=1)))
            trace.set_colors(colours[:step] or ["none"])
        self.now.set_data(T_base[step], T_tip[step])
        self.title.set_text(posture.name)


def _body(axes: Axes, rim: str, inside: str) -> list[PolyCollection]:
    """Two collections, for the polygons whose union is a body: its rim, and before it what is inside."""
    pair = [
        PolyCollection([], facecolor=rim, edgecolor=rim, linewidth=1.6),
        PolyCollection([], facecolor=inside, edgecolor=inside, linewidth=0.2),
    ]
    for collection in pair:
        axes.add_collection(collection)
    return pair


def _axonometric() -> np.ndarray:
    """The directions to the right and up of a view from the side and above, (2, 3)."""
    right = [np.sin(YAW), -np.cos(YAW), 0.0]
    return np.array([right, [np.sin(PITCH) * np.cos(YAW), np.sin(PITCH) * np.sin(YAW), np.cos(PITCH)]])


def _outline(shape: Drawn, sides: np.ndarray) -> Any:
    """Polygons whose union is the body as it is seen [mm]."""
    rims = shape.sections @ sides.T
    back = np.roll(rims, 1, axis=1)
    quads = np.stack([rims[:-1], back[:-1], back[1:], rims[1:]], axis=2).reshape(-1, 4, 2)
    return [*rims, *quads]
