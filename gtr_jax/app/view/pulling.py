"""How the tendons are pulled: by a pull and release, by a recording, or by hand, each with its sliders."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from bokeh.layouts import column
from bokeh.models import Button, Div, RadioButtonGroup, Select

from gtr_jax.numbers import display_unit
from gtr_jax.recordings.recording import Recording
from gtr_jax.robot.robot import Robot

from .dials import LABEL, Dial
from .histories import History, at_rest, by_hand, moved_by, pull_and_release, recorded, usual_pull
from .knobs import FARTHEST, STEPS, rounded
from .model import names_of

LOOP, RECORDING, HAND = "Pull and release", "As recorded", "By hand"


class Pulling:
    """What drives the tendons.

    Args:
        robot: as it is first.
        recording: of it, if there is one.
        changed: called when the history is another one.
    """

    def __init__(self, robot: Robot, recording: Recording | None, changed: Callable[[], None]) -> None:
        self._recording, self._changed = recording, changed
        self._moves: list[np.ndarray] = []
        self._ways = [RECORDING, LOOP, HAND] if recording else [LOOP, HAND]
        self._choice = RadioButtonGroup(
            labels=self._ways,
            active=0,
            name="way",
            sizing_mode="stretch_width",
            html_attributes={"role": "group", "aria-label": "How the tendons are pulled"},
        )
        self._choice.on_change("active", lambda attr, old, new: self._chosen())
        names: list[Any] = [name or "the tendon" for name in names_of(robot)]
        self._tendon = Select(name="tendon", title="Tendon to pull", options=names, value=names[0])
        self._tendon.sizing_mode = "stretch_width"
        self._tendon.on_change("value", lambda attr, old, new: self._chosen())
        self._robot, self._pulls = robot, [_pull(robot, i, recording) for i in range(len(names))]
        rest = at_rest(robot)
        self._ends: list[tuple[Dial, Dial]] = []
        self._hands: list[Dial] = []
        for i, name in enumerate(names_of(robot)):
            of = f" of {name}" if name else ""
            what = "Base tension" if moved_by(robot)[i] == "N" else "Drawn out at the base"
            pull = self._dial(f"pull {i}", i, self._pulls[i], f"Pull{of} to", self._looped)
            release = self._dial(f"release {i}", i, float(rest[i]), f"Release{of} to", self._looped)
            self._ends.append((pull, release))
            self._hands.append(self._dial(f"hand {i}", i, float(rest[i]), f"{what}{of}", self._handed))
        wide: Any = {"sizing_mode": "stretch_width", "margin": 0}
        rows = [dial.row for ends in self._ends for dial in ends]
        self._loop = column(*([self._tendon] if len(names) > 1 else []), *rows, **wide)
        again = Button(label="Begin again", name="begin again", width=110)
        again.on_click(self._begin)
        says = Div(text="Move a slider: the tendon remembers how it was pulled.", stylesheets=[LABEL])
        self._hand = column(says, *(dial.row for dial in self._hands), again, **wide)
        self.box = column(self._choice, self._loop, self._hand, name="pulling", **wide)
        self._visible()

    @property
    def way(self) -> str:
        """LOOP, RECORDING or HAND."""
        return self._ways[self._choice.active or 0]

    def history(self, robot: Robot) -> History:
        """What drives a robot with these tendons."""
        if self.way == RECORDING and self._recording is not None:
            return recorded(robot, self._recording)
        if self.way == HAND:
            return by_hand(robot, self._moves)
        pull, release = (dial.value * self._size(robot, self._index) for dial in self._ends[self._index])
        return pull_and_release(robot, self._index, pull, release)

    @property
    def _index(self) -> int:
        return list(self._tendon.options).index(self._tendon.value)

    def _size(self, robot: Robot, tendon: int) -> float:
        return display_unit(moved_by(robot)[tendon])[1]

    def _dial(self, name: str, tendon: int, value: float, title: str, moved: Callable[[float], None]) -> Dial:
        unit, size = display_unit(moved_by(self._robot)[tendon])
        high = FARTHEST * self._pulls[tendon] / size
        return Dial(
            name,
            f"{title} [{unit}]",
            low=0.0,
            high=high,
            step=rounded(high / STEPS),
            value=float(f"{value / size:.12g}"),
            moved=moved,
            bounds=(0.0, None),
        )

    def _looped(self, value: float) -> None:
        self._changed()

    def _handed(self, value: float) -> None:
        ways = [dial.value * self._size(self._robot, k) for k, dial in enumerate(self._hands)]
        self._moves.append(np.array(ways))
        self._changed()

    def _begin(self) -> None:
        self._let_go()
        self._changed()

    def _let_go(self) -> None:
        """Forget what the hand did."""
        self._moves = []
        for k, (dial, rest) in enumerate(zip(self._hands, at_rest(self._robot), strict=True)):
            dial.show(float(rest) / self._size(self._robot, k))

    def _chosen(self) -> None:
        self._let_go()
        self._visible()
        self._changed()

    def _visible(self) -> None:
        self._loop.visible, self._hand.visible = self.way == LOOP, self.way == HAND
        for i, ends in enumerate(self._ends):
            for dial in ends:
                dial.row.visible = i == self._index


def _pull(robot: Robot, tendon: int, recording: Recording | None) -> float:
    """How far a tendon is pulled: about as far as it was recorded, or so far that the body bends visibly."""
    drives = None if recording is None else recording.T_base
    if recording is not None and moved_by(robot)[tendon] == "m":
        drives = recording.displacement
    if drives is not None:
        most = float(np.nanmax(drives.reshape(len(drives), -1)[:, tendon], initial=0.0))
        if most > 0:
            return rounded(most)
    return usual_pull(robot, tendon)
