"""The page: sliders on one side, plots on the other, and the thread between them that simulates."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
import time
from collections.abc import Iterator, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import NamedTuple

from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Div, Select
from jinja2 import Environment, PackageLoader

from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import InputError, reason
from gtr_jax.recordings.driving import driven
from gtr_jax.recordings.recording import Recording

from .answers import Answers
from .bodies import Body
from .compared import TENSION, comparable
from .controls import Controls
from .dials import LABEL, Dial, warning
from .figures import Channelsheet, Curvesheet, Plotted
from .ghosts import Ghost, Ghosts
from .knobs import GROUPS
from .latest_only_worker import LatestOnlyWorker
from .model import Curves, Setting, names_of, simulated
from .postures import drawing, midlines
from .pulling import HAND, Pulling
from .shown import Found, Wanted, plotted
from .thread_warnings import thread_warnings

PATIENCE = 0.5  # seconds until the page says that it computes
UNSEEN = 250  # ms after which the curves follow a shape of which no browser says that it is painted


@dataclasses.dataclass(frozen=True)
class Given:
    """What the command was given: the robot, the recording with the options it was read with, the folder to
    write to, and the path that it is shown at.
    """

    config: RobotConfig
    recording: Recording | None
    options: Sequence[str]
    out: Path
    shown_at: str = "runs"


class Judged(NamedTuple):
    """Whether a command would take a robot: why not, "" if it would, and what it would warn of."""

    setting: Setting
    fault: str
    warned: Sequence[str]


class Page:
    """One tab.

    Args:
        document: to fill.
        given: what the command was given.
    """

    def __init__(self, document: Document, given: Given) -> None:
        self._document, self._given = document, given
        setting = Setting.of(self._driven(given.config))
        self._shown: tuple[Wanted, Found] | None = None
        self._owed: Found | None = None  # whose shape is on the page, and its curves not yet
        self._plotted: tuple[Curves | None, str, Sequence[Ghost]] = (None, "", ())
        self._judged: Judged | None = None
        self._refused = False  # whether the line below the title says why nothing newer is shown
        self._copies: dict[tuple[Ghost, str], Plotted] = {}
        self._step: int | None = None
        self._brush: tuple[int, ...] = ()
        self._ghosts_drawn = False
        names = names_of(setting.robot)
        recording = given.recording
        self._body, self._channel = Body(setting.robot.space), Channelsheet(names)
        self._curves = Curvesheet(names, recording is not None and recording.T_tip is not None)
        choices = comparable(setting.robot, recording)
        self._compared = Select(
            name="residual of",
            title="Residual of",
            options=list(choices.items()),
            value=next(iter(choices), TENSION),
            visible=bool(choices),
            width=260,
        )
        self._compared.on_change("value", lambda attr, old, new: self._ask())
        self._curves.samples.selected.on_change("indices", self._brushed)
        self._body.on_painted(self._show_rest)
        self._status = Div(
            name="status", text="computing …", stylesheets=[LABEL], sizing_mode="stretch_width"
        )
        self._at = Dial("step", "Step shown", low=1, high=2, step=1, value=1, moved=self._stepped)
        self._here = Div(name="here", text="", stylesheets=[LABEL], sizing_mode="stretch_width")
        self._controls = Controls(setting, self._moved, self._refuse)
        self._pulling = Pulling(setting.robot, recording, self._repulled)
        self._ghosts = Ghosts(self._present, self._take, self._ask)
        self._answers = Answers(
            document,
            lambda: self._controls.setting,
            lambda config: self._take(Setting.of(self._driven(config))),
            recording=None if recording is None else recording.path,
            compares=bool(choices),
            options=given.options,
            out=given.out,
            shown_at=given.shown_at,
        )
        self._history = self._pulling.history(setting.robot)
        self._worker: LatestOnlyWorker[Wanted] = LatestOnlyWorker(self._work)
        self._judge: LatestOnlyWorker[Setting] = LatestOnlyWorker(self._check)
        self._last: tuple[Wanted, Curves] | None = None
        self._closed = False
        self._lay_out()
        self._ask()

    def close(self) -> None:
        """End what runs for this tab."""
        self._closed = True
        self._worker.close()
        self._judge.close()
        self._answers.close()

    def wait(self) -> None:
        """Wait until nothing runs for this tab any more."""
        self._worker.wait()
        self._judge.wait()
        self._answers.wait()

    def _driven(self, config: RobotConfig) -> RobotConfig:
        """The robot as the recording drives it."""
        return config if self._given.recording is None else driven(config, self._given.recording)[0]

    def _lay_out(self) -> None:
        wide = "stretch_width"
        first, *others = self._body.plots
        body = column(
            first, *([row(*others, sizing_mode=wide)] if others else []), name="body", sizing_mode=wide
        )
        sheet, channel = self._curves, self._channel
        plots = {
            "loop": sheet.loop,
            "time": sheet.time,
            "residual": sheet.residual,
            "traced": sheet.traced,
            "force": channel.force,
            "along": channel.tension,
        }
        for name, plot in plots.items():
            plot.name = name
        self._at.row.name = "sample"
        controls = self._controls
        groups = [name for name in GROUPS if controls.groups[name].children]
        boxes = [self._pulling.box, *(controls.groups[name] for name in groups), controls.terms]
        boxes.append(self._ghosts.box)
        boxes += [
            self._answers.box,
            self._answers.saving,
            self._status,
            self._at.row,
            self._here,
            self._compared,
        ]
        for root in (*boxes, body, *plots.values()):
            self._document.add_root(root)
        given, config = self._given, self._given.config
        self._document.title = f"{config.name}: gtr view"
        self._document.template = Environment(
            loader=PackageLoader("gtr_jax.app", "view"), autoescape=False
        ).get_template("page.html.jinja")
        self._document.template_variables.update(
            robot=escape(config.name),
            source=escape(config.source),
            recording="" if given.recording is None else escape(str(given.recording.path)),
            groups=groups,
        )

    # What the user does

    def _moved(self, setting: Setting) -> None:
        self._answers.show(setting)
        self._ask()

    def _repulled(self) -> None:
        self._history = self._pulling.history(self._controls.setting.robot)
        self._step, self._brush = None, ()
        self._curves.samples.selected.indices = []
        self._body.forget_room()
        self._ask()

    def _take(self, setting: Setting) -> None:
        """Put another robot on the sliders."""
        self._controls.show(setting)
        self._moved(setting)

    def _present(self) -> tuple[Setting, Curves] | None:
        return None if self._shown is None else (self._shown[0].setting, self._shown[1].curves)

    def _stepped(self, value: float) -> None:
        self._step = int(value) - 1 + self._history.padded
        self._ask()

    def _brushed(self, attr: str, old: list[int], new: list[int]) -> None:
        self._brush = tuple(i + self._history.padded for i in sorted(new))
        if new:
            self._step = self._brush[-1]
        self._ask()

    # What is computed, in the thread

    def _ask(self) -> None:
        step = len(self._history) - 1 if self._pulling.way == HAND and self._step is None else self._step
        self._worker.ask(
            Wanted(
                self._controls.setting,
                self._history,
                step,
                tuple(self._ghosts.kept),
                str(self._compared.value),
                self._brush,
            )
        )

    def _work(self, wanted: Wanted) -> None:
        slow = threading.Timer(
            PATIENCE, lambda: self._tell(partial(self._say, "compiling, once for this kind of robot …"))
        )
        slow.start()
        try:
            found: Found | str = self._found(wanted)
        except InputError as fault:
            found = str(fault)
        except Exception as fault:  # of any kind, such as of a spline through what did not converge
            found = f"no shape is found ({reason(fault)}); move the slider back"
        finally:
            slow.cancel()
        self._tell(partial(self._show, wanted, found))

    def _found(self, wanted: Wanted) -> Found:
        began, curves = time.perf_counter(), self._kept(wanted)
        if curves is None:
            curves = simulated(wanted.setting, wanted.history)
        step = curves.largest if wanted.step is None else min(wanted.step, len(curves.time) - 1)
        alike = [ghost for ghost in wanted.ghosts if len(ghost.curves.time) == len(curves.time)]
        self._last = (wanted, curves)
        return Found(
            plotted("", curves, wanted.quantity),
            self._ghosts_plotted(wanted),
            step,
            drawing(curves, step),
            midlines(curves, wanted.brushed),
            [(ghost.colour, drawing(ghost.curves, step)) for ghost in alike],
            time.perf_counter() - began,
        )

    def _ghosts_plotted(self, wanted: Wanted) -> list[Plotted]:
        """The curves of ghosts, each compared once as long as the quantity stays."""
        known, self._copies = self._copies, {}
        for ghost in wanted.ghosts:
            key = ghost, wanted.quantity
            self._copies[key] = known.get(key) or plotted(ghost.colour, ghost.curves, wanted.quantity)
        return list(self._copies.values())

    def _kept(self, wanted: Wanted) -> Curves | None:
        """The curves of the last request, if this one asks for the same."""
        if self._last is None:
            return None
        before, curves = self._last
        alike = before.setting is wanted.setting and before.history is wanted.history
        return curves if alike else None

    def _check(self, setting: Setting) -> None:
        """Whether a command would take a robot, which takes longer than to draw it."""
        fault = ""
        with thread_warnings() as warned:
            try:
                setting.written()
            except InputError as refused:
                fault = str(refused)
            except Exception as refused:  # of any kind, of numbers that no file was written with before
                fault = reason(refused)
        self._tell(partial(self._conclude, Judged(setting, fault, warned)))

    def _tell(self, show) -> None:
        """Have something shown by the thread that the page belongs to."""
        if not self._closed:
            self._document.add_next_tick_callback(show)

    # What is shown

    def _show(self, wanted: Wanted, found: Found | str) -> None:
        if isinstance(found, str):
            self._refuse(found)
            return
        # The shape first, which the browser paints sooner without the curves.
        with self._together():
            self._body.show(found.drawing, found.curves.most)
            if found.ghosts or self._ghosts_drawn:
                self._body.show_ghosts(found.ghosts)
        self._shown, self._owed, self._ghosts_drawn = (wanted, found), found, bool(found.ghosts)
        self._refused = False
        self._document.add_timeout_callback(partial(self._show_unpainted, found), UNSEEN)

    def _show_unpainted(self, found: Found) -> None:
        if self._owed is found:
            self._show_rest()

    def _show_rest(self) -> None:
        """Draw what belongs to the latest shape; what belonged to shapes before it is left out."""
        if self._owed is None or self._shown is None:
            return
        self._owed = None
        with self._together():
            self._draw_rest(*self._shown)
        setting = self._shown[0].setting
        if self._judged is not None and self._judged.setting is setting:
            self._conclude(self._judged)
        else:
            self._judge.ask(setting)

    @contextlib.contextmanager
    def _together(self) -> Iterator[None]:
        """Have the browser told in one message."""
        self._document.hold("combine")
        try:
            yield
        finally:
            self._document.unhold()

    def _draw_rest(self, wanted: Wanted, found: Found) -> None:
        curves = found.curves
        drawn = curves, wanted.quantity, wanted.ghosts
        if self._plotted[:2] != drawn[:2]:
            self._curves.show(*found.plotted[1:])
            count = len(curves.time) - curves.history.padded
            self._at.reach(1, max(count, 2))
        if self._plotted[1:] != drawn[1:]:
            self._curves.show_ghosts(found.others)
        self._plotted = drawn
        self._curves.point_at(curves, found.step)
        self._body.show_brushed(found.brushed)
        self._channel.show(found.drawing.along)
        self._at.show(found.step + 1 - curves.history.padded)
        self._here.text = _where(curves, found.step, names_of(curves.robot))

    def _conclude(self, judged: Judged) -> None:
        """Say below the title what is shown, once it is known whether a command would take it. What was
        refused since then still is: that line stays.
        """
        self._judged, setting = judged, judged.setting
        now = self._controls.setting is setting and not self._refused
        if not now or self._shown is None or self._shown[0].setting is not setting:
            return
        found, curves = self._shown[1], self._shown[1].curves
        steps = len(curves.time) - curves.history.padded
        lines = [warning("No command takes this robot", judged.fault)] if judged.fault else []
        if curves.failed:
            text = f"{curves.failed} of {steps} steps did not converge; do not use these."
            lines.append(warning("Warning", text))
        if not lines:
            lines = [f"{steps} load steps, computed in {1e3 * found.seconds:.0f} ms."]
        self._status.text = "<br>".join([*lines, *(warning("Warning", text) for text in judged.warned)])

    def _refuse(self, fault: str) -> None:
        self._refused = True
        self._status.text = warning("Not shown", fault)

    def _say(self, text: str) -> None:
        self._status.text = escape(text)


def _where(curves: Curves, step: int, names: Sequence[str]) -> str:
    """The step that is shown, in words."""
    each = []
    for i, name in enumerate(names):
        of = f" of {name}" if name else ""
        each.append(f"T_base{of} {curves.T_base[step, i]:.3g} N, T_tip {curves.T_tip[step, i]:.3g} N")
    return escape(f"t = {curves.time[step]:.4g} s: {'; '.join(each)}.")


def fill(document: Document, given: Given, pages: list[Page]) -> None:
    """Fill a new document with a page, which is added to `pages` as long as its tab is open."""
    page = Page(document, given)
    pages.append(page)

    def left(context) -> None:
        page.close()
        pages.remove(page)

    document.on_session_destroyed(left)
