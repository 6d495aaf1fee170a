"""The sliders of the robot: its numbers in groups, and its physics terms, which come and go."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from typing import Any

from bokeh.layouts import column
from bokeh.models import Button, Column, Div, Select

from gtr_jax.errors import InputError

from .dials import LABEL, Dial, dial_of
from .knobs import GROUPS, Knob, knobs_of
from .model import Setting

HEADING = ":host { color: #222222; font-size: 14px; } p { margin: 0; }"
CHOOSE = "choose a term …"


class Controls:
    """All numbers of a robot as sliders.

    Args:
        setting: the robot.
        changed: called with the robot when a slider was moved, or a term added or taken away.
        refused: called with what is wrong with a number that the robot cannot have.
    """

    def __init__(
        self, setting: Setting, changed: Callable[[Setting], None], refused: Callable[[str], None]
    ) -> None:
        self.setting, self._changed, self._refused = setting, changed, refused
        self._dials: dict[str, Dial] = {}
        self._rows: dict[str, list[Any]] = {}
        self.groups = {name: column(name=name, sizing_mode="stretch_width", margin=0) for name in GROUPS}
        self.terms = column(name="terms", sizing_mode="stretch_width", margin=0)
        self._added = Select(name="add term", title="Add a physics term, without effect at first")
        self._added.sizing_mode = "stretch_width"
        self._added.on_change("value", self._add)
        self.show(setting)

    def show(self, setting: Setting) -> None:
        """Put another robot on the sliders, without calling `changed`."""
        self.setting = setting
        knobs = knobs_of(setting.robot, setting.terms, config=setting.config)
        self._show_values(knobs)
        for name, group in self.groups.items():
            own = [knob for knob in knobs if knob.group == name]
            if any(knob.name not in self._dials for knob in own) or len(own) != len(group.children):
                group.children = [self._row(knob) for knob in own]
        self._show_terms(knobs)

    def _show_values(self, knobs: Sequence[Knob]) -> None:
        """Set the sliders there are; those of terms that were on the page before are still there."""
        for knob in knobs:
            if knob.name in self._dials:
                self._dials[knob.name].show(knob.shown(self._value(knob)))

    def _value(self, knob: Knob) -> float:
        return float(self.setting.values.get(knob.name, knob.value))

    def _row(self, knob: Knob) -> Column:
        self._dials[knob.name] = dial_of(knob, self._value(knob), self._moved)
        return self._dials[knob.name].row

    def _moved(self, name: str, value: float) -> None:
        try:
            self.setting = self.setting.with_value(name, value)
        except InputError as fault:
            self._refused(str(fault))
            return
        self._changed(self.setting)

    def _show_terms(self, knobs: Sequence[Knob]) -> None:
        terms = self.setting.terms
        self._rows |= {term: self._rows_of(term, knobs) for term in terms if term not in self._rows}
        rows = [row for term in terms for row in self._rows[term]]
        names = [(term.id, term.id) for term in self.setting.addable]
        self._added.options = [("", CHOOSE), *names]
        self._added.value = ""
        none = [] if rows else [Div(text="None of them acts yet.", stylesheets=[LABEL])]
        self.terms.children = [*none, *rows, self._added]

    def _rows_of(self, term: str, knobs: Sequence[Knob]) -> list[Any]:
        """What stands on the page for a term."""
        gone = Button(
            label="Take away",
            name=f"remove {term}",
            width=96,
            html_attributes={"role": "group", "aria-label": f"Take away the term {term}"},
        )
        gone.on_click(partial(self._remove, term))
        heading = Div(
            text=f"<p><b>{term}</b>: {escape(self.setting.catalogue[term].says)}</p>", stylesheets=[HEADING]
        )
        return [heading, *(self._row(knob) for knob in knobs if knob.term == term), gone]

    def _add(self, attr: str, old: str, new: str) -> None:
        if new and new not in self.setting.terms:
            self._with(self.setting.with_term(new))

    def _remove(self, term: str) -> None:
        self._with(self.setting.without_term(term))

    def _with(self, setting: Setting) -> None:
        self.setting = setting
        knobs = knobs_of(setting.robot, setting.terms, config=setting.config)
        self._show_values(knobs)
        self._show_terms(knobs)
        self._changed(setting)
