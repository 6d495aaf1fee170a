"""Figures for papers: their widths, their letters, and that nothing is cut off."""

import io
import re

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from calibrate.report.diagnosis_figures import plot_against_rate, plot_rivals
from calibrate.report.fit_figures import plot_profiles
from gtr_jax.errors import InputError
from gtr_jax.plots import printed as module
from gtr_jax.plots.chart import Chart, Column, Line
from gtr_jax.plots.chart_figure import plot_charts
from gtr_jax.plots.loop import plot_loop
from gtr_jax.plots.printed import COLUMN, INCH, PAGE, printed
from gtr_jax.plots.style import WIDTH, drawn_again, figure, png, styled
from gtr_jax.plots.sweep import plot_sensitivity
from gtr_jax.plots.tendons import plot_tendons
from gtr_jax.sweep.sensitivity import Index

T = np.concatenate([np.linspace(0, 40, 30), np.linspace(40, 0, 30)])
BOTH, PARABOLA = T[:, None] * [1.0, 0.5], np.array([4.0, 1.0, 0.0, 1.0, 4.0])
PHASES = np.repeat(["pulling", "transition", "releasing", "rest"], 15)


@styled
def wide():
    fig = Figure(figsize=(1.55 * WIDTH, 3.0), layout="constrained")
    fig.subplots().plot([0, 1])
    return fig


def test_the_users_backend_stays():
    """A figure that a styled function draws in a notebook does not hide the user's own."""
    before = matplotlib.get_backend()
    try:
        matplotlib.use("svg")
        png(wide())
        printed(wide(), "pdf")
        assert matplotlib.get_backend() == "svg"
    finally:
        matplotlib.use(before)


def residual():
    base, left = Column("T_base", "N", T), Column("simulated − recorded", "N", np.sin(T))
    dots = Line(base, left, style="dots", phases=PHASES)
    return Chart("Residual", "tension at the base [N]", "simulated − recorded T_tip [N]", [dots], 0.2)


FIGURES = {
    "loop": lambda: plot_loop(T, 0.6 * T, phases=PHASES, frictionless=T, switch=(12.0, 24.0)),
    "residual": lambda: plot_charts([residual(), residual()], 5.6),
    "profiles": lambda: plot_profiles({"mu": (np.linspace(0.3, 0.4, 5), PARABOLA, PARABOLA)}),
    "tendons": lambda: plot_tendons(BOTH, 0.6 * BOTH, T / 40, ("left", "right")),
    "rate": lambda: plot_against_rate(
        1 + T, 1 + T, np.sin(T), noise=0.1, unit="N", label="with what was missing"
    ),
    "rivals": lambda: plot_rivals(
        ["local-friction.stretch", "none"], np.array([1.0, 0]), np.array([60.0, 0])
    ),
    "sensitivity": lambda: plot_sensitivity({"T_tip": {"mu": Index(0.5, 0.1, 0.6, 0.1, None, None)}}),
}


def sizes_of(svg):
    return [float(re.findall(rf'{side}="([\d.]+)mm"', svg)[0]) for side in ("width", "height")]


@pytest.mark.parametrize("name", FIGURES)
def test_nothing_is_cut_off_in_a_column(name):
    with Image.open(io.BytesIO(printed(FIGURES[name](), "png"))) as image:
        dots = np.asarray(image.convert("L"))
    assert np.concatenate([dots[0], dots[-1], dots[:, 0], dots[:, -1]]).min() == 255
    assert dots.shape[1] == pytest.approx(COLUMN / INCH * 600, abs=2), "600 dots per inch"
    assert np.mean(dots < 128) > 0.001


def test_widths_are_those_of_columns_and_proportions_stay():
    for draw, expected in ((FIGURES["loop"], COLUMN), (wide, PAGE)):
        fig = draw()
        wide_mm, tall_mm = sizes_of(printed(fig, "svg").decode())
        again = drawn_again(fig, COLUMN / INCH / module.LETTERS)
        assert wide_mm == pytest.approx(expected, abs=0.01)
        assert tall_mm / wide_mm == pytest.approx(again.get_figheight() / again.get_figwidth(), rel=1e-4)


def test_letters_stay_letters_and_the_same_figure_gives_the_same_file():
    fig = FIGURES["loop"]()
    svg = printed(fig, "svg")
    assert "tension at the base" in svg.decode() and b"<image" not in svg
    assert printed(FIGURES["loop"](), "svg") == svg
    assert printed(FIGURES["loop"](), "pdf") == printed(fig, "pdf")


def test_pdf_is_a_page_of_that_size_with_the_whole_figure_and_fonts(monkeypatch):
    monkeypatch.setitem(module.LOOK_IN_PRINT, "pdf.compression", 0)
    page = printed(FIGURES["loop"](), "pdf").decode("latin-1")
    box = [float(v) for v in re.findall(r"/MediaBox \[([^\]]*)\]", page)[0].split()]
    assert box[2] == pytest.approx(COLUMN / INCH * 72, abs=0.01)
    assert "/TrueType" in page or "/CIDFontType2" in page
    assert "/Subtype /Image" not in page
    scale = float(re.findall(r"([\d.]+) 0 0 [\d.]+ 0 0 cm", page)[0])
    assert scale == pytest.approx(module.LETTERS, rel=1e-6)
    # Lines reach beyond what would be the edge of the page without the change of scale.
    places = [float(x) for x in re.findall(r"^([\d.]+) [\d.]+ l$", page, flags=re.M)]
    assert box[2] < max(places) <= box[2] / scale + 1


def test_a_report_is_drawn_as_before_after_print():
    fig = FIGURES["loop"]()
    before = png(fig)
    printed(fig, "pdf")
    assert png(fig) == before == png(FIGURES["loop"]())
    assert figure(1.0)[0].get_figwidth() == WIDTH


def test_figures_without_an_effect_are_refused():
    from gtr_jax.app.cli.sweep import _check_figures

    _check_figures((), False, {"--dry-run": True})
    with pytest.raises(InputError, match="--figures: has no effect with --no-plot"):
        _check_figures(("svg",), False, {})
    with pytest.raises(InputError, match="--figures: has no effect with --part"):
        _check_figures(("svg",), True, {"--part": True})


def test_every_command_that_draws_an_answer_writes_figures():
    import importlib

    for name in ("simulate", "fit", "diagnose", "sweep", "design"):
        command = getattr(importlib.import_module(f"gtr_jax.app.cli.{name}"), name)
        (option,) = [p for p in command.params if "--figures" in p.opts]
        assert tuple(option.type.choices) == module.FORMATS, name
