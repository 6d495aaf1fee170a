"""Sliders and fields: a number with both, one row each, that answer to mouse, keyboard and screen reader."""

from __future__ import annotations

from collections.abc import Callable
from html import escape

from bokeh.layouts import column, row
from bokeh.models import CustomJS, Div, Slider, Spinner

from .knobs import Knob

RED = "#A33C00"  # of warnings, dark enough to be read
PRIMARY, PRESSED = "#2A6FA8", "#1F5685"  # of the buttons that begin something, under white letters
FIELD = 92  # px, the width of a field
# Slider and field follow each other in the browser; the slider's range grows to what is typed.
MOVED = "f.value = parseFloat(this.value.toPrecision(6))"
TYPED = """
if (this.value == null) return
if (Math.abs(this.value - s.value) <= 1e-5 * Math.abs(s.value)) return  // what the slider itself has said
s.start = Math.min(s.start, this.value)
s.end = Math.max(s.end, this.value)
s.value = this.value
"""
SLIM = """
    .noUi-target { height: 6px; margin-top: 11px; }
    .noUi-handle { width: 16px !important; height: 18px !important; }
    .noUi-handle { top: -7px !important; right: -8px !important; }
    .noUi-handle:focus-visible { outline: 3px solid #0072B2; outline-offset: 1px; }
"""
LABEL = ":host { color: #222222; font-size: 13px; line-height: 1.25; }"
MAIN = f"""
    .bk-btn-primary {{ background-color: {PRIMARY}; border-color: {PRIMARY}; }}
    .bk-btn-primary:hover, .bk-btn-primary:active {{ background-color: {PRESSED}; border-color: {PRESSED}; }}
"""
FOCUS = "input:focus-visible { outline: 3px solid #0072B2; outline-offset: 1px; }"


def warning(begin: str, text: object) -> str:
    """A warning as HTML, told by its first words and its colour."""
    return f'<span style="color: {RED}"><b>{begin}:</b> {escape(str(text))}</span>'


class Dial:
    """A number with a slider and a field, under its name.

    Args:
        name: of the slider, in tests; the field's is this and " field".
        title: what it is, with its unit.
        low, high, step: of the slider, in that unit.
        value: in that unit.
        moved: called with the new value when the user moves it.
        bounds: what the field takes.
        says: more on what it is, shown under the pointer.
    """

    def __init__(
        self,
        name: str,
        title: str,
        *,
        low: float,
        high: float,
        step: float,
        value: float,
        moved: Callable[[float], None],
        bounds: tuple[float | None, float | None] = (None, None),
        says: str = "",
    ) -> None:
        self._moved, self._set = moved, False
        about = {"aria-label": title} | ({"title": says} if says else {})
        self._slider = Slider(
            name=name,
            title=None,
            start=min(low, value),
            end=max(high, value),
            step=step,
            value=value,
            show_value=False,
            sizing_mode="stretch_width",
            stylesheets=[SLIM],
            html_attributes={"role": "group", **about},
        )
        self._field = Spinner(
            name=f"{name} field",
            value=value,
            step=step,
            low=bounds[0],
            high=bounds[1],
            mode="float",
            width=FIELD,
            stylesheets=[FOCUS],
            html_attributes={"role": "group", **about},
        )
        self._slider.js_on_change("value", CustomJS(args={"f": self._field}, code=MOVED))
        typed = CustomJS(args={"s": self._slider}, code=TYPED)
        self._field.js_on_change("value", typed)
        self._slider.on_change("value", self._changed)
        label = Div(text=escape(title), stylesheets=[LABEL], margin=(4, 5, 0, 5), html_attributes=about)
        self.row = column(
            label,
            row(self._slider, self._field, sizing_mode="stretch_width", margin=0),
            sizing_mode="stretch_width",
            margin=0,
        )

    @property
    def value(self) -> float:
        """The value, in the unit of the title."""
        return float(self._slider.value)

    def show(self, value: float) -> None:
        """Set the value without calling `moved`."""
        self._set = True
        self._slider.update(
            start=min(self._slider.start, value), end=max(self._slider.end, value), value=value
        )
        self._field.value = value
        self._set = False

    def reach(self, low: float, high: float) -> None:
        """Set the ends, without calling `moved`."""
        self._set = True
        self._slider.update(start=low, end=high)
        self._field.update(low=low, high=high)
        self._set = False

    def _changed(self, attr: str, old: float, new: float) -> None:
        if not self._set:
            self._moved(float(new))


def dial_of(knob: Knob, value: float, moved: Callable[[str, float], None]) -> Dial:
    """A number of the robot as a slider.

    Args:
        knob: the number.
        value: [SI].
        moved: called with the number's name and the new value [SI].
    """
    bounds = tuple(None if b is None else knob.shown(b) for b in (knob.lower, knob.upper))
    return Dial(
        knob.name,
        knob.title,
        low=knob.shown(knob.low),
        high=knob.shown(knob.high),
        step=knob.shown(knob.step),
        value=knob.shown(value),
        moved=lambda shown: moved(knob.name, shown * knob.size),
        bounds=(bounds[0], bounds[1]),
        says=f"{knob.says} ({knob.key})" if knob.says else knob.key,
    )
