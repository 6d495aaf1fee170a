"""What the figures of a design show: marks told apart, tolerances seen, labels within them."""

from typing import Any, cast

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Circle

import gtr_jax as gtr
from design.option import TargetError
from design.report.figures import Mark, Near, plot_targets
from design.report.playback import Way, design_playback, tendons_playback
from gtr_jax.plots.tension import plot_tension
from gtr_jax.simulation.displacement import by_tension
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


@pytest.mark.parametrize("space", [False, True])
def test_a_design_s_pull_and_release_can_be_gone_through(make_robot, space):
    """Charts mark what a target asks for at the step that reaches it, on its branch."""
    helix = {"routing": {"kind": "helix", "radius": 0.008, "turns": 0.5, "start_angle": 0.5}}
    robot = make_robot(0.3, **(helix if space else {}))
    T = np.concatenate([np.linspace(0, 8, 9), np.linspace(7, 0, 8)])
    run = gtr.simulate(robot, T)
    wanted = (0.2, -0.05, 0.01, *[np.nan] * 9) if space else (0.2, np.nan, np.nan)
    error = TargetError("pose[0]", 3.0, "releasing", wanted, wanted, 0.0, np.nan, 1e-3, 1e-2)
    data = design_playback(robot, run, label_phases(run), [error]).data
    assert data["of"] == 17 and data["first"] == 13  # 3 N on the way back
    titles = [chart["title"] for chart in data["charts"]]
    assert titles == ["Tip x", "Tip y", *(["Tip z"] if space else []), "Angle", "Loop"]
    marks = {
        chart["title"]: [data["columns"][line["y"]]["values"] for line in chart["lines"][1:]]
        for chart in data["charts"]
    }
    np.testing.assert_allclose(marks["Tip x"][0][13], 200.0)
    assert [v for v in marks["Tip x"][0] if v is not None] == [200.0]
    assert bool(marks["Tip y"]) is space and not marks["Loop"]
    assert data["body"]["space"] is space


def test_the_direction_that_is_asked_for_is_drawn_beside_the_tip_s(make_robot):
    """In space a chart tells how far the tip's direction is from the one asked for, 0 where it is reached."""
    helix = {"routing": {"kind": "helix", "radius": 0.008, "turns": 0.5, "start_angle": 0.5}}
    robot = make_robot(0.3, **helix)
    run = gtr.simulate(robot, np.linspace(0, 8, 9))
    direction = np.asarray(run.tip_rotation)[5, :, 0]
    rotation = np.full((3, 3), np.nan)
    rotation[:, 0] = direction
    wanted = (np.nan, np.nan, np.nan, *rotation.ravel())
    error = TargetError("pose[0]", 5.0, "pulling", wanted, wanted, np.nan, 0.0, 1e-3, 1e-2)
    data = design_playback(robot, run, label_phases(run), [error]).data
    (chart,) = (chart for chart in data["charts"] if chart["title"] == "Direction")
    off, asked = (np.array(data["columns"][line["y"]]["values"], float) for line in chart["lines"])
    assert off[5] < 1e-3 < off[4] and off[0] > 1.0
    assert asked[5] == 0.0 and np.isnan(np.delete(asked, 5)).all()


@pytest.mark.parametrize("name", ["three-tendons", "antagonists"])
def test_the_ways_of_several_tendons_to_their_targets_can_be_gone_through(name):
    """One way after the other, each from its preloads, with bands that tell them apart."""
    robot = by_tension(gtr.load_robot(f"examples/{name}.toml"))
    count, ways = len(robot.tendon_names), []
    for i, top in enumerate((2.0, 3.0)):
        pull = np.linspace(0.1, top, 5)[:, None] * np.arange(1.0, count + 1)
        run = gtr.simulate(robot, pull)
        place = np.asarray(run.tip_position)[-1]
        wanted = (*place, *[np.nan] * 9) if robot.space else (*place[:2], np.nan)
        error = TargetError(f"pose[{i}]", tuple(pull[-1]), "pulling", wanted, wanted, 0.0, np.nan, 1e-3, 1e-2)
        ways.append(Way(f"{top:g} N", run, pull, [error]))
    data = tendons_playback(robot, ways).data
    assert data["of"] == 10 and data["first"] == 4 and data["starts"] == [5]
    assert data["body"]["samples"] == list(range(10)) and data["body"]["space"] is robot.space
    charts = {chart["title"]: chart for chart in data["charts"]}
    assert {"Tip x", "Angle", "Tensions", "Drawn out"} <= set(charts)
    assert [(span["start"], span["end"]) for span in charts["Tensions"]["spans"]] == [(0.5, 5.5), (5.5, 10.5)]
    own, *marks = (data["columns"][line["y"]]["values"] for line in charts["Tip x"]["lines"])
    for k, mark in zip((4, 9), marks, strict=True):
        assert [i for i, value in enumerate(mark) if value is not None] == [k]
        np.testing.assert_allclose(mark[k], own[k], rtol=1e-5)
    drawn = [data["columns"][line["y"]]["values"] for line in charts["Drawn out"]["lines"]]
    assert len(drawn) == count and all(values[9] != values[4] for values in drawn)
