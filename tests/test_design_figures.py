"""What the figures of a design show: marks told apart, tolerances seen, labels within them."""

from typing import Any, cast

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Circle

import gtr_jax as gtr
from design.report.figures import Mark, Near, plot_targets
from gtr_jax.plots.tension import plot_tension
from gtr_jax.simulation.phases import label_phases


@pytest.fixture(scope="module")
def pulled():
    robot = gtr.load_robot("examples/tdcm-1.toml")
    T = np.append(np.linspace(0.0, 45.0, 6), np.linspace(45.0, 0.0, 6)[1:])
    run = gtr.simulate(robot, T, time=1e6 * np.arange(len(T)))
    return robot, run, label_phases(run)


def drawn(fig):
    canvas = FigureCanvasAgg(fig)
    canvas.draw()
    return canvas


def test_a_tolerance_is_seen_and_the_plain_model_s_tip_told_apart(pulled):
    robot, run, phases = pulled
    x, y = (1e3 * float(v) for v in run.tip_pose[5, :2])
    marks = [Mark(x, y, 0.1, 0.25), Mark(x + 4, y, np.nan, 0.0, True)]
    near = [Near((x, y), (x + 0.1, y), 0.1, 0.25, "pose[0]")]
    state = gtr.equilibrium(robot, 45.0)
    radius = np.asarray(robot.backbone.radius(state.s))
    fig = plot_targets([("45 N", state)], radius, np.asarray(run.tip_pose[:, :2]), phases, marks, near)
    drawn(fig)
    whole, magnified = fig.axes
    circle = next(patch for patch in magnified.patches if isinstance(patch, Circle))
    assert circle.get_window_extent().width > 0.3 * magnified.get_window_extent().width
    assert circle.radius == 0.25
    style = {line.get_label(): line.get_marker() for line in cast(Any, fig.legends[0]).legend_handles}
    assert style["wanted"] != style["tip, by the plain model"] != style["tip of this design"]
    single = [line for line in whole.lines if np.size(line.get_xdata()) == 1]
    at = {(round(float(np.ravel(cast(Any, line.get_xdata()))[0]) - x), line.get_marker()) for line in single}
    assert at == {(0, style["wanted"]), (4, style["tip, by the plain model"])}


@pytest.mark.parametrize("name", ["", "the tendon on the outer side"])
def test_what_names_the_tensions_lies_within_the_figure(name, pulled):
    _, run, phases = pulled
    fig = plot_tension(run, phases, pulled=(name, np.asarray(run.T_base)))
    canvas = drawn(fig)
    for text in fig.axes[0].texts:
        box = text.get_window_extent(canvas.get_renderer())
        assert 0 <= box.x0 and box.x1 <= fig.bbox.width, text.get_text()
    assert any("T_{base}" in text.get_text() for text in fig.axes[0].texts)
