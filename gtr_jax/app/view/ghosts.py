"""What-if copies: curves and shape kept under a name, drawn dashed beside the present ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from html import escape

from bokeh.layouts import column, row
from bokeh.models import Button, Div, Row, TextInput

from .dials import LABEL
from .figures import GHOSTS
from .model import Curves, Setting


@dataclasses.dataclass(frozen=True, eq=False)
class Ghost:
    """A robot that was kept, its curves, and the colour that they are drawn in."""

    name: str
    colour: str
    setting: Setting
    curves: Curves


class Ghosts:
    """The robots that are kept, as a list on the page.

    Args:
        present: gives the robot on the sliders and its curves; None while there are none.
        taken: called with a robot that the user takes back to the sliders.
        changed: called when there is one more, or one fewer.
    """

    def __init__(
        self,
        present: Callable[[], tuple[Setting, Curves] | None],
        taken: Callable[[Setting], None],
        changed: Callable[[], None],
    ) -> None:
        self._present, self._taken, self._changed = present, taken, changed
        self.kept: list[Ghost] = []
        self._name = TextInput(name="ghost name", title="Name", sizing_mode="stretch_width")
        keep = Button(label="Keep these curves", name="keep ghost", width=150)
        keep.on_click(self._keep)
        self._keep_button = keep
        self._list = column(sizing_mode="stretch_width", margin=0)
        self.box = column(self._name, keep, self._list, name="ghosts", sizing_mode="stretch_width", margin=0)

    def _keep(self) -> None:
        present = self._present()
        if present is None:
            return
        free = [colour for colour in GHOSTS if colour not in [ghost.colour for ghost in self.kept]]
        name = self._name.value.strip() or f"copy {len(self.kept) + 1}"
        self.kept.append(Ghost(name, free[0], *present))
        self._name.value = ""
        self._show()

    def _remove(self, ghost: Ghost) -> None:
        self.kept.remove(ghost)
        self._show()

    def _show(self) -> None:
        self._list.children = [self._row(ghost) for ghost in self.kept]
        self._keep_button.disabled = len(self.kept) == len(GHOSTS)
        self._changed()

    def _row(self, ghost: Ghost) -> Row:
        dash = f'<span style="color: {ghost.colour}; font-weight: bold" aria-hidden="true">- - -</span>'
        says = Div(text=f"{dash} {escape(ghost.name)}", stylesheets=[LABEL], sizing_mode="stretch_width")
        back = Button(
            label="Take back",
            name=f"take back {ghost.name}",
            width=90,
            html_attributes=_about(f"Take {ghost.name} back to the sliders"),
        )
        back.on_click(lambda: self._taken(ghost.setting))
        gone = Button(
            label="Remove",
            name=f"remove {ghost.name}",
            width=76,
            html_attributes=_about(f"Remove {ghost.name}"),
        )
        gone.on_click(lambda: self._remove(ghost))
        return row(says, back, gone, sizing_mode="stretch_width", margin=0)


def _about(text: str) -> dict[str, str]:
    return {"role": "group", "aria-label": text}
