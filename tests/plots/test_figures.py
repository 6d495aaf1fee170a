"""What every figure owes its reader: nothing is cut off; and its caller: axes of their own."""

import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure

from calibrate.report.fit_figures import plot_time
from gtr_jax.plots.loop import plot_loop
from gtr_jax.plots.sweep import plot_curves, plot_maps, plot_sensitivity
from gtr_jax.plots.tendons import plot_tendons
from gtr_jax.simulation.phases import PULLING, RELEASING, REST, TRANSITION
from gtr_jax.sweep.sensitivity import Index


@pytest.mark.parametrize("phases", [[PULLING], [PULLING, TRANSITION, RELEASING, REST]])
def test_a_legend_lies_within_the_figure(phases):
    t = np.arange(40.0)
    fig = plot_time(t, t, t, simulated=t, phases=np.repeat(phases, 40 // len(phases)))
    (legend,) = fig.legends
    fig.canvas.draw()
    box = legend.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= fig.bbox.width
    assert len(legend.get_texts()) == 2 + len(phases)


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
