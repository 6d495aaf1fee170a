"""What every figure owes its reader: nothing is cut off; and its caller: axes of their own."""

from typing import cast

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gtr_jax.plots.chart import Chart, Column, Line, Span
from gtr_jax.plots.chart_figure import plot_charts, typeset
from gtr_jax.plots.loop import plot_loop
from gtr_jax.plots.sweep import plot_curves, plot_maps, plot_sensitivity
from gtr_jax.plots.tendons import plot_tendons
from gtr_jax.simulation.phases import PULLING, RELEASING, REST, TRANSITION
from gtr_jax.sweep.sensitivity import Index


def course(phases):
    """Both tensions over time, with a model that fits the tip."""
    time = Column("time", "s", np.arange(1.0 * len(phases)))
    base, tip = (
        Column(f"T_{end}, recorded", "N", size * time.values) for end, size in (("base", 2), ("tip", 1))
    )
    model = Column("T_tip, fitted model", "N", time.values)
    lines = [
        Line(time, base, style="dashed"),
        Line(time, tip, style="dots", phases=phases),
        Line(time, model),
    ]
    return Chart("Tensions", "time [s]", "tension [N]", lines)


@pytest.mark.parametrize("phases", [[PULLING], [PULLING, TRANSITION, RELEASING, REST]])
def test_a_legend_lies_within_the_figure(phases):
    fig = plot_charts([course(np.repeat(phases, 40 // len(phases)))], 3.2)
    (legend,) = fig.legends
    fig.canvas.draw()
    box = legend.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= fig.bbox.width
    assert len(legend.get_texts()) == 2 + len(phases)


def test_a_figure_draws_what_its_chart_says():
    """Samples, bands and stretches lie where the chart has them; axes are named, with their units."""
    x, half = Column("T_base", "N", T), Column("95 % of samples, half width", "N", 0.0 * T + 3.0)
    left = Column("simulated − recorded, best fit", "N", np.array([1.0, -1, np.nan, 2, 0]))
    line = Line(x, Column("T_tip, best fit", "N", 0.5 * T), "#D55E00", band=half)
    spans = [Span(5, 8, "episode", "1", "#E69F00")]
    charts = [
        Chart("Loop", "tension at the base [N]", "tension at the tip [N]", [line]),
        Chart("Left", "time [s]", "simulated − recorded T_tip [N]", [Line(x, left)], 0.5, spans),
    ]
    fig = plot_charts(charts, 5.0)
    loop, rest = fig.axes
    np.testing.assert_array_equal(loop.lines[0].get_xydata(), np.stack([T, 0.5 * T], axis=1))
    band = np.concatenate([path.vertices for piece in loop.collections for path in piece.get_paths()])
    assert (band[:, 1].min(), band[:, 1].max()) == (-3, 13)
    np.testing.assert_array_equal(rest.lines[-1].get_ydata(), left.values)
    noise, episode = (cast(Rectangle, patch).get_bbox() for patch in rest.patches)
    assert (noise.y0, noise.y1) == (-1, 1) and (episode.x0, episode.x1) == (5, 8)
    assert [t.get_text() for t in rest.texts] == ["1"]
    assert loop.get_xlabel() == "tension at the base $T_{base}$ [N]" and rest.get_xlabel() == "time [s]"
    named = [text.get_text() for text in fig.legends[0].get_texts()]
    lines = ["$T_{tip}$, best fit", "simulated − recorded, best fit"]
    assert named == [*lines, "95 % of samples", "episode", "noise, ±2 sd"]


def test_charts_share_an_axis_that_says_the_same():
    one, other = course(np.repeat(PULLING, 40)), course(np.repeat(RELEASING, 40))
    above, below = plot_charts([one, other], 5.0).axes
    assert not above.get_xlabel() and below.get_xlabel() == "time [s]"
    assert above.get_title(loc="left") == "Tensions", "where both are shared"


def test_symbols_are_set_as_paper_has_them():
    assert typeset("tension at the base of left [N]") == "tension at the base of left $T_{base}$ [N]"
    assert typeset("T_tip, fitted model") == "$T_{tip}$, fitted model"
    assert typeset("turn about z [°]") == "turn about $z$ [°]" and typeset("tip x [mm]") == "tip $x$ [mm]"


def indices():
    return {name: {"mu": Index(0.5), "E": Index(0.4)} for name in ("T_tip", "tip_x")}


def grid(*names):
    values = np.arange(6.0).reshape(2, 3)
    data = {n: xarray.DataArray(values, {"mu": [0.1, 0.2], "E": [1.0, 2.0, 3.0]}, name=n) for n in names}
    return data


T = np.array([0.0, 10, 20, 10, 0])
OF_THE_CALLER = {
    "loop": (1, lambda axes: plot_loop(T, T, phases=np.repeat(PULLING, 5), frictionless=T, axes=axes[0])),
    "tendons": (2, lambda axes: plot_tendons(T[:, None], T[:, None], T, ["left"], axes=axes)),
    "maps": (2, lambda axes: plot_maps(grid("T_tip", "tip_x"), axes=axes)),
    "curves": (1, lambda axes: plot_curves({k: v[0] for k, v in grid("T_tip").items()}, axes=axes)),
    "sensitivity": (2, lambda axes: plot_sensitivity(indices(), axes=axes)),
}


@pytest.mark.parametrize("name", OF_THE_CALLER)
def test_plots_draw_into_axes_of_the_caller(name):
    count, draw = OF_THE_CALLER[name]
    own = Figure(figsize=(7, 4))
    axes = [own.add_subplot(1, count + 1, k + 1) for k in range(count)]
    free = own.add_subplot(1, count + 1, count + 1)
    assert draw(axes) is own and own.get_size_inches().tolist() == [7, 4]
    assert all(each.has_data() for each in axes) and not free.has_data()
    assert any(each.get_xlabel() for each in axes)
    assert not own.legends, "keys stand within the axes"


def test_another_number_of_axes_is_refused():
    own = Figure()
    with pytest.raises(ValueError, match=r"axes: this is drawn into 2, but 1 are given"):
        plot_tendons(T[:, None], T[:, None], T, ["left"], axes=[own.add_subplot()])
    assert not own.axes[0].has_data()
