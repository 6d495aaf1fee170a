"""From here on: fit, diagnose, and save as a robot file."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Button, Div, MultiChoice, TextInput

from gtr_jax.config.config import RobotConfig, dump_config, load_config
from gtr_jax.errors import InputError
from gtr_jax.robot.parameters import parameters_of
from gtr_jax.robot.robot import Robot

from .dials import LABEL, MAIN, warning
from .model import Setting
from .runs import Done, Run, free_name

NAME = re.compile(r"[\w.-]+")
NOTHING = (
    "The file says how the tendon was pulled and nothing else. To fit or diagnose, record what a simulation "
    "can be compared with: T_tip_N, the tip's pose, or markers."
)
LEAST = 5.0  # seconds that a command has to end after it was stopped


class Answers:
    """The buttons that fit and diagnose the robot on the sliders, and save it.

    Args:
        document: that they stand in.
        present: gives the robot on the sliders.
        loaded: called with a robot file that was found.
        recording: file to fit; None if there is none.
        compares: whether it has anything that a simulation can be compared with.
        options: of the command line that the recording was read with.
        out: folder that everything is written to.
        shown_at: the path that it is shown at.
    """

    def __init__(
        self,
        document: Document,
        present: Callable[[], Setting],
        loaded: Callable[[RobotConfig], None],
        *,
        recording: Path | None,
        compares: bool,
        options: Sequence[str],
        out: Path,
        shown_at: str,
    ) -> None:
        self._document, self._present, self._loaded = document, present, loaded
        self._recording, self._options, self._out = recording, list(options), out
        self._shown_at = shown_at
        self._run: Run | None = None
        self._offered: tuple[Robot, tuple[str, ...]] | None = None
        self._says = Div(name="run status", text="", stylesheets=[LABEL], sizing_mode="stretch_width")
        self._free = MultiChoice(
            name="free",
            title="Numbers to fit",
            sizing_mode="stretch_width",
            placeholder="mu and E unless chosen",
        )
        look: Any = {"button_type": "primary", "stylesheets": [MAIN]}
        self._fit = Button(label="Fit from here", name="fit", **look)
        self._fit.on_click(partial(self._start, "fit"))
        self._diagnose = Button(label="Diagnose from here", name="diagnose", width=150, **look)
        self._diagnose.on_click(partial(self._start, "diagnose"))
        self._stop = Button(label="Stop", name="stop", width=70, visible=False)
        self._stop.on_click(self._stopped)
        self._found = column(sizing_mode="stretch_width", margin=0)
        if recording is None:
            none = Div(text="Give a recording after the robot to fit or diagnose it.", stylesheets=[LABEL])
            self.box = column(none, name="runs", sizing_mode="stretch_width", margin=0)
        else:
            self._fit.sizing_mode = self._diagnose.sizing_mode = "stretch_width"
            buttons = row(self._fit, self._diagnose, margin=0, sizing_mode="stretch_width")
            parts = [self._free, buttons, self._stop, self._says, self._found]
            self.box = column(*parts, name="runs", sizing_mode="stretch_width", margin=0)
        if not compares:
            self._says.text = NOTHING
            for button in (self._fit, self._diagnose):
                button.update(disabled=True, html_attributes={"title": NOTHING})
        self._name = TextInput(name="file name", title="Name of the file", value="robot")
        self._name.sizing_mode = "stretch_width"
        save = Button(label="Save as robot file", name="save", width=150)
        save.on_click(self._save)
        self._saved = Div(name="saved", text="", stylesheets=[LABEL], sizing_mode="stretch_width")
        self.saving = column(
            self._name, save, self._saved, name="saving", sizing_mode="stretch_width", margin=0
        )
        self.show(present())

    def show(self, setting: Setting) -> None:
        """Offer the numbers of a robot to be fitted."""
        before = self._offered
        if before is not None and before[0] is setting.robot and before[1] == setting.terms:
            return
        self._offered = setting.robot, setting.terms
        names = [
            p.name
            for p in parameters_of(setting.robot).values()
            if p.term is None or p.term.id in setting.terms
        ]
        self._free.options = list(names)
        self._free.value = [name for name in self._free.value if name in names]

    def close(self) -> None:
        """Interrupt what is running."""
        if self._run is not None:
            self._run.stop()

    def wait(self) -> None:
        """Wait until nothing is running, and end what takes too long."""
        if self._run is not None:
            self._run.wait(LEAST)

    def _start(self, command: str) -> None:
        assert self._recording is not None
        chosen = [str(name) for name in self._free.value] if command == "fit" else []
        free = ["--free", ",".join(chosen)] if chosen else []
        try:
            self._run = Run(
                command,
                self._present().written(chosen),
                self._recording,
                [*free, *self._options],
                out=self._out,
                progress=self._from_thread(self._progress),
                done=self._from_thread(self._done),
            )
        except (InputError, OSError) as fault:
            self._says.text = warning("Not done", fault)
            return
        self._busy(True)
        self._says.text = f"<code>{escape(self._run.line)}</code>"

    def _from_thread(self, show: Callable) -> Callable:
        """The same for another thread, which may not touch the page by itself."""
        return lambda *given: self._document.add_next_tick_callback(partial(show, *given))

    def _busy(self, on: bool) -> None:
        self._fit.disabled = self._diagnose.disabled = on
        self._stop.visible = on

    def _stopped(self) -> None:
        if self._run is not None:
            self._run.stop()

    def _progress(self, stage: str) -> None:
        if self._run is not None:
            self._says.text = f"<code>{escape(self._run.line)}</code><br>{escape(stage)}"

    def _done(self, done: Done) -> None:
        self._run = None
        self._busy(False)
        if not done.answered:
            self._says.text = warning("Not done", " ".join(done.says))
            return
        lines = "<br>".join(escape(line) for line in done.says if not line.startswith("report:"))
        report = f"{self._shown_at}/{done.folder.name}/report.html"
        report = f'<a href="{report}" target="_blank">Report of {done.folder.name}</a>'
        self._says.text = f"{lines}<br>{report}"
        self._found.children = [self._button(path) for path in done.robots]
        if done.folder.name.startswith("fit") and done.robots:
            self._load(done.robots[0])

    def _button(self, path: Path) -> Button:
        button = Button(
            label=f"Put {path.parent.name}/{path.name} on the sliders", sizing_mode="stretch_width"
        )
        button.on_click(partial(self._load, path))
        return button

    def _load(self, path: Path) -> None:
        try:
            self._loaded(load_config(path))
        except InputError as fault:
            self._says.text = warning("Not done", fault)

    def _save(self) -> None:
        name = self._name.value.strip().removesuffix(".toml")
        path = self._out / f"{name}.toml"
        try:
            if not NAME.fullmatch(name):
                raise InputError("a name of letters, digits, dots, hyphens and underscores is needed")
            if path.exists():
                raise InputError(
                    f"{path} is there; choose another name, for example {free_name(self._out, name).name}"
                )
            self._out.mkdir(parents=True, exist_ok=True)
            dump_config(self._present().written(), path, note="Written by gtr view.")
        except (InputError, OSError) as fault:
            self._saved.text = warning("Not done", fault)
            return
        self._saved.text = f"written: {escape(str(path))}"
