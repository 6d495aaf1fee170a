"""The model behind the live page: its curves are those of `simulate`, by programs that are compiled once."""

import builtins
import dataclasses
import re
import threading
from pathlib import Path

import jax
import numpy as np
import pytest
from command_line import RECORDED, RECORDING, run_gtr
from conftest import SINE

import gtr_jax as gtr
from gtr_jax.app.view import bodies, dials, figures
from gtr_jax.app.view.compared import comparable, compared
from gtr_jax.app.view.histories import (
    HELD,
    History,
    at_rest,
    by_hand,
    pull_and_release,
    recorded,
    shortened,
    usual_pull,
)
from gtr_jax.app.view.knobs import knobs_of, rounded
from gtr_jax.app.view.latest_only_worker import LatestOnlyWorker
from gtr_jax.app.view.model import Setting, simulated
from gtr_jax.app.view.postures import MIDLINES, drawing, midlines
from gtr_jax.app.view.runs import free_name
from gtr_jax.recordings.recording import Recording, seeks_glitches
from gtr_jax.robot.parameters import parameters_of
from gtr_jax.simulation.markers import marker_places

HELIX = {"kind": "helix", "radius": "4 mm", "turns": 0.5, "start_angle": "30 deg"}


@pytest.fixture
def setting(make_config):
    return Setting.of(make_config(routing=SINE))


@pytest.fixture
def compiled():
    """Counts what is compiled from here on."""
    events = []

    def counted(event: str, duration_secs: float, **more: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            events.append(event)

    jax.monitoring.register_event_duration_secs_listener(counted)
    yield events
    jax.monitoring.unregister_event_duration_listener(counted)


def test_curves_are_those_of_simulate_and_no_slider_compiles_anything(setting, compiled):
    history = pull_and_release(setting.robot, 0, 10.0, 1.0)
    moves = {"mu": 0.1, "r1": -0.008, "length": 0.21, "presliding.length": 1e-3, "outer_radius_tip": 0.013}
    held = setting.with_term("presliding").with_value("E", 2e6)
    for name, value in moves.items():  # the first move of each
        drawing(simulated(held.with_value(name, 1.01 * value), history), 4)
    del compiled[:]
    found = {}
    for name, value in moves.items():
        held = held.with_value(name, value)
        found[name] = simulated(held, history)
        drawing(found[name], 50)
    back = simulated(held.with_value("presliding.length", 0.0), history)
    assert compiled == []
    robot = setting.robot.with_values(E=2e6)
    for name, value in moves.items():
        robot = robot.with_values(**{name: value})
        run = gtr.simulate(robot, history.T_base, time=history.time)
        np.testing.assert_allclose(found[name].T_tip[:, 0], run.T_tip, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(found[name].tip_angle, run.tip_pose[:, 2], rtol=1e-8, atol=1e-9)
    run = gtr.simulate(robot.with_values(**{"presliding.length": 0.0}), history.T_base, time=history.time)
    np.testing.assert_allclose(back.T_tip[:, 0], run.T_tip, rtol=1e-8, atol=1e-9)


def test_the_drawn_body_ends_where_the_tip_is_and_its_forces_are_those_of_the_tendon(setting):
    curves = simulated(setting, pull_and_release(setting.robot, 0, 10.0, 0.0))
    step = curves.largest
    assert curves.T_base[step, 0] == 10.0
    shape = drawing(curves, step)
    (view,), (along,) = shape.views, shape.along
    assert view.middle[-1] == pytest.approx(1e3 * np.asarray(curves.run.tip_pose)[step, :2], rel=1e-4)
    assert (along.tension[0], along.tension[-1]) == pytest.approx((10.0, float(curves.T_tip[step, 0])))
    # While all of the tendon slips, friction is the friction coefficient times what presses.
    mu = float(setting.robot.value("mu"))
    np.testing.assert_allclose(along.friction, mu * along.normal, rtol=1e-2, atol=1e-2)


def test_a_robot_in_space_is_drawn_from_three_sides(make_config):
    setting = Setting.of(make_config(routing=HELIX))
    curves = simulated(setting, pull_and_release(setting.robot, 0, 5.0, 0.0))
    shape = drawing(curves, curves.largest)
    assert [view.axes for view in shape.views] == ["xy", "xz", "yz"]
    assert curves.run.shape is not None
    tip = 1e3 * np.asarray(curves.run.shape.position)[curves.largest, -1]
    for view in shape.views:
        assert view.middle[-1] == pytest.approx(tip[["xyz".index(axis) for axis in view.axes]], rel=1e-6)
        # The channel lies within the body.
        points = np.concatenate(view.outline)
        for channel in view.channels:
            assert np.all(channel >= points.min(axis=0) - 1e-6)
            assert np.all(channel <= points.max(axis=0) + 1e-6)
    moved = setting.with_value("tip_force_z", 0.5).with_value("tip_moment_x", 0.01).written()
    assert (moved.loads.tip_force, moved.loads.tip_moment) == ((0, 0, 0.5), (0.01, 0, 0))
    assert gtr.build_robot(moved).value("tip_force_z") == 0.5


@pytest.mark.parametrize("routing", [SINE, HELIX])
def test_midlines_of_brushed_steps_are_those_of_the_body(make_config, routing):
    setting = Setting.of(make_config(routing=routing))
    curves = simulated(setting, pull_and_release(setting.robot, 0, 8.0, 0.0))
    views = drawing(curves, 30).views
    found = midlines(curves, [10, 30])
    assert [len(lines) for lines in found] == [2] * len(views)
    for view, lines in zip(views, found, strict=True):
        assert lines[1][-1] == pytest.approx(view.middle[-1], abs=1e-3)
        assert np.max(np.abs(lines[0][-1] - view.middle[-1])) > 1.0 or view.axes == "yz"
    many = midlines(curves, range(5, 75))[0]
    assert len(many) == MIDLINES
    ends = [midlines(curves, [step])[0][0] for step in (5, 74)]
    np.testing.assert_allclose([many[0], many[-1]], ends)
    assert midlines(curves, []) == [[]] * len(views)


def test_the_comb_in_space_is_that_in_the_plane(make_config):
    """A planar robot computed in space has the comb that it has in the plane, and none out of it."""
    flat, space = (Setting.of(make_config(routing=SINE, **more)) for more in ({}, {"space": True}))
    combs = []
    for setting in (flat, space):
        curves = simulated(setting, pull_and_release(setting.robot, 0, 8.0, 0.0))
        combs.append([view.teeth[0] for view in drawing(curves, curves.largest).views])
    (starts, ends), (shown, tips) = combs[0][0], combs[1][0]
    heights = np.linalg.norm(ends - starts, axis=1), np.linalg.norm(tips - shown, axis=1)
    assert heights[0].max() == pytest.approx(heights[1].max(), rel=0.05)
    way, own = ((b - a)[np.argmax(h)] for a, b, h in ((starts, ends, heights[0]), (shown, tips, heights[1])))
    assert way @ own > 0.95 * np.linalg.norm(way) * np.linalg.norm(own)
    _, (across, above), _ = combs[1]
    np.testing.assert_allclose(above[:, 1], across[:, 1], atol=1e-6)


def test_markers_and_what_was_recorded_of_them_are_drawn(make_config):
    markers = [{"name": "m", "at": "100 mm", "offset": ["0 mm", "5 mm", "0 mm"]}]
    setting = Setting.of(make_config(routing=SINE, markers=markers))
    n = 30
    T_base, place = np.linspace(0.0, 5.0, n), np.linspace(0.0, 0.01, n)
    recording = Recording(
        T_base,
        Path("r.csv"),
        "",
        T_tip=0.8 * T_base,
        tip_x=0.2 - place,
        tip_y=place,
        markers={"m_x": 0.1 + 0 * place, "m_y": np.where(place > 0.005, np.nan, place)},
    )
    curves = simulated(setting, recorded(setting.robot, recording))
    (late,), (early,) = (drawing(curves, step).views for step in (n - 1, 3))
    np.testing.assert_allclose(late.recorded, [[190.0, 10.0]])
    np.testing.assert_allclose(early.recorded[1], [100.0, 1e3 * place[3]])
    expected = marker_places(curves.robot, curves.run)[3, 0, :2]
    np.testing.assert_allclose(early.markers, [1e3 * np.asarray(expected)], atol=1e-6)


def test_all_that_a_recording_has_is_compared_in_units_that_people_read(make_config):
    markers = [{"name": "m", "at": "100 mm", "offset": ["0 mm", "5 mm", "0 mm"]}]
    setting = Setting.of(make_config(routing=SINE, markers=markers))
    T_base = np.linspace(0.0, 5.0, 30)
    run = gtr.simulate(setting.robot, T_base)
    place, pose = np.asarray(marker_places(setting.robot, run))[:, 0], np.asarray(run.tip_pose)
    recording = Recording(
        T_base,
        Path("r.csv"),
        "",
        tip_x=pose[:, 0] + 1e-3,
        tip_angle=pose[:, 2] - np.radians(2.0),
        displacement=np.asarray(run.displacement) + 2e-3,
        markers={"m_y": place[:, 1] - 3e-3},
    )
    off = {"tip_x": (-1.0, "mm"), "tip_angle": (2.0, "deg"), "displacement": (-2.0, "mm"), "m_y": (3.0, "mm")}
    found = comparable(setting.robot, recording)
    assert {*found} == {*off} and found["tip_angle"] == "the tip's angle"
    curves = simulated(setting, History(T_base, None, np.arange(30.0), recording=recording))
    for quantity, (residual, unit) in off.items():
        one = compared(curves, quantity)
        assert one.unit == unit
        np.testing.assert_allclose(one.residual, np.full((30, 1), residual), atol=1e-6)
    assert np.all(np.isnan(compared(curves, "T_tip").residual))


def test_every_number_has_a_slider_that_reaches_beyond_it(make_config):
    for config in (make_config(routing=SINE), make_config(routing=HELIX)):
        setting = Setting.of(config)
        knobs = {
            knob.name: knob for knob in knobs_of(setting.robot, ("presliding", "tip-gain"), config=config)
        }
        entries = {
            p.name: p
            for p in parameters_of(setting.robot).values()
            if np.isfinite(float(setting.robot.value(p.name)))
            and (p.term is None or p.term.id in ("presliding", "tip-gain"))
        }
        assert {*knobs} == {*entries}
        for name, knob in knobs.items():
            lower, upper = entries[name].lower, entries[name].upper
            assert knob.low < knob.high and knob.low <= knob.value <= knob.high
            assert lower is None or knob.low >= lower
            assert upper is None or knob.high <= upper
            assert not (entries[name].positive and knob.low <= 0)
    assert knobs["gravity_angle"].title == "gravity angle [deg]"
    assert knobs["gravity_angle"].shown(knobs["gravity_angle"].high) == 180.0
    assert knobs["tip-gain.gain"].says
    assert all(knob.says for knob in knobs.values())


def test_sliders_say_what_the_numbers_are():
    examples = Path(__file__).parents[2] / "examples"
    for file in sorted(examples.glob("**/*.toml")):
        try:
            config = gtr.load_config(file)
        except gtr.InputError:  # of a sweep or of targets
            continue
        setting = Setting.of(config)
        knobs = knobs_of(setting.robot, tuple(setting.catalogue), config=config)
        silent = [k.key for k in knobs if not k.says]
        assert silent == [], file
        # The unit is in the title, in which people read it; a sentence stands by itself, on one line.
        odd = [k.says for k in knobs if re.search(r" \[[^],]*\]|\n|^Likewise|instead, as in", k.says)]
        assert odd == [], file
    config = gtr.load_config(examples / "rig/robot.toml")
    knobs = {knob.name: knob for knob in knobs_of(gtr.build_robot(config), (), config=config)}
    assert knobs["r1"].title == "offset at the base (r1) [mm]"
    assert knobs["w2"].title == "arc length where it joins the second straight (w2) [mm]"
    assert knobs["bore_1_diameter"].says == "Diameter of the concentric bore."
    assert knobs["outer_radius_tip"].says.startswith("Outer radius at the base and at the tip")


def test_numbers_that_only_space_has_have_words_of_their_own(make_config):
    config = make_config(routing=HELIX)
    knobs = {knob.name: knob for knob in knobs_of(gtr.build_robot(config), (), config=config)}
    about_y = knobs["natural_curvature_y"].says
    assert about_y.startswith("Curvature of the unloaded backbone about y, out of the plane")
    assert about_y.endswith("[s, curvature] pairs from base to tip.")  # brackets of a list stay
    assert knobs["gravity_z"].says == "Acceleration of gravity along x, y and z, instead of gravity_angle."


def test_offsets_at_knots_have_words(make_config):
    table = {"kind": "table", "knots": [[0.0, 0.01], [0.1, 0.002], [0.25, 0.008]]}
    config = make_config(routing=table)
    labels = [k.label for k in knobs_of(gtr.build_robot(config), (), config=config) if k.group == "Channel"]
    assert labels == ["offset at knot 0", "offset at knot 1", "offset at knot 2"]


@pytest.mark.parametrize(
    ("amount", "next_one"), [(0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (30.0, 50.0), (7e-4, 1e-3)]
)
def test_steps_are_round(amount, next_one):
    assert rounded(amount) == next_one


def test_a_setting_becomes_a_robot_file(setting):
    held = setting.with_value("mu", 0.41).with_term("presliding").with_value("presliding.length", 2e-3)
    config = held.written()
    again = Setting.of(config)
    assert again.terms == ("presliding",)
    for name in ("mu", "presliding.length", "E"):
        assert float(again.robot.value(name)) == pytest.approx(float(held.changed.value(name)))
    gone = held.without_term("presliding")
    assert float(gone.changed.value("presliding.length")) == 0.0
    assert "presliding" in [term.id for term in gone.addable]
    assert gone.written().terms == ()
    assert (
        float(gtr.build_robot(again.without_term("presliding").written()).value("presliding.length")) == 0.0
    )
    with pytest.raises(gtr.InputError, match="bore"):
        setting.with_value("bore_0_diameter", 0.5).written()


RIG = Path(__file__).parents[2] / "examples/rig/robot.toml"


@pytest.mark.parametrize("term", [term.id for term in Setting.of(gtr.load_config(RIG)).addable])
def test_a_term_is_added_without_effect_and_stands_in_the_file_once_it_has_one(term):
    """Whatever the term: commands refuse those of several sizes at null values."""
    setting = Setting.of(gtr.load_config(RIG)).with_term(term)
    assert setting.written() == setting.config
    known = setting.catalogue[term]
    numbers = [f"{term}.{q.name}" for q in known.quantities]
    chosen = setting.written(free=["mu", *numbers])  # a fit finds the numbers of terms that are not there
    assert [own.id for own in chosen.terms] == ([term] if len(known.sizes) == 1 else [])
    size = next(q for q in known.quantities if q.size)
    moved = setting.with_value(f"{term}.{size.name}", size.typical)
    assert [own.id for own in moved.written().terms] == [term]
    # And back, from the file that has it.
    again = Setting.of(moved.written()).with_value(f"{term}.{size.name}", size.null)
    assert again.written() is not None
    assert gtr.build_robot(again.without_term(term).written()).acting == setting.robot.acting


def test_a_setting_that_no_command_takes_is_refused_in_their_words(capsys, tmp_path):
    setting = Setting.of(gtr.load_config(RECORDED)).with_value("r1", -0.025)
    low = next(knob.low for knob in knobs_of(setting.robot, (), config=setting.config) if knob.name == "r1")
    assert low < -0.025  # the slider reaches there
    with pytest.raises(gtr.InputError, match="the tendon leaves the body at s = ") as fault:
        setting.written()
    file = tmp_path / "robot.toml"
    file.write_text(Path(RECORDED).read_text().replace('r1 = "-9 mm"', 'r1 = "-25 mm"'))
    done = run_gtr(capsys, "simulate", file, "--pull", "5", "-o", tmp_path / "run")
    assert done.err == f"error: {fault.value}\n".replace(str(RECORDED), str(file))


def test_terms_that_a_robot_cannot_have_together_are_refused_in_a_line(make_config):
    setting = (
        Setting.of(make_config(routing=SINE)).with_term("tip-moved").with_value("tip-moved.tension", 2.0)
    )
    history = pull_and_release(setting.robot, 0, 10.0, 0.0)
    with pytest.raises(gtr.InputError, match=r"tip-moved: .*take a term off the page"):
        simulated(setting.with_term("presliding").with_value("presliding.length", 1e-3), history)


def test_a_hand_pulls_through_steps_that_are_remembered(setting):
    moves = [np.array([T]) for T in (2.0, 8.0, 5.0)]
    history = by_hand(setting.robot, moves)
    assert len(history) == HELD
    assert history.T_base[history.padded :] == pytest.approx([0.0, 2.0, 8.0, 5.0])
    assert history.time[history.padded :] == pytest.approx([0.0, 1.0, 2.0, 3.0])
    whole = simulated(setting, history).T_tip[-1, 0]
    alone = gtr.simulate(setting.robot, [0.0, 2.0, 8.0, 5.0]).T_tip[-1]
    assert whole == pytest.approx(float(alone), rel=1e-9)
    fresh = gtr.equilibrium(setting.robot, 5.0).T_tip
    assert whole > float(fresh) + 0.1  # friction holds what the release let go


def test_a_long_history_keeps_its_turning_points():
    up, down = np.linspace(0.0, 10.0, 60), np.linspace(10.0, 3.0, 60)[1:]
    again = np.linspace(3.0, 6.0, 30)[1:]
    moves = [np.array([T]) for T in np.concatenate([up, down, again])]
    kept = np.array(shortened(moves, HELD))[:, 0]
    assert len(kept) <= HELD
    assert (kept[0], kept[-1]) == (0.0, 6.0)
    assert {10.0, 3.0} <= {*kept}
    zigzag = [np.array([T]) for T in [0.0, *np.tile([1.0, 0.5], 80), 0.75]]
    left = np.array(shortened(zigzag, HELD))[:, 0]
    assert len(left) <= HELD and left[-1] == 0.75


def test_a_recording_is_pulled_as_a_fit_would():
    config = gtr.load_config(RECORDED)
    recording = gtr.read_recording(RECORDING)
    setting = Setting.of(config)
    history = recorded(setting.robot, recording)
    curves = simulated(setting.with_value("mu", 0.2611).with_value("E", 1.335e6), history)
    assert recording.T_tip is not None
    residual = compared(curves, "T_tip").residual[:, 0]
    np.testing.assert_allclose(residual, curves.T_tip[:, 0] - recording.T_tip)
    assert np.sqrt(np.mean(residual**2)) < 0.05 * np.ptp(recording.T_tip)
    gained = setting.with_term("base-gain").with_value("base-gain.gain", 1.1)
    # What a cell at the base adds is taken off before the tendon is pulled, and shown again.
    np.testing.assert_allclose(simulated(gained, history).T_base[:, 0], history.T_base, atol=1e-9)


def test_the_first_pull_bends_the_body_visibly(setting):
    pull = usual_pull(setting.robot, 0)
    curves = simulated(setting, pull_and_release(setting.robot, 0, pull, 0.0))
    assert 0.2 < np.max(np.abs(np.asarray(curves.run.angle))) < 3.0
    assert at_rest(setting.robot) == pytest.approx([0.0])


def test_requests_that_are_overtaken_are_left_out():
    done, begun, go_on, last = [], threading.Event(), threading.Event(), threading.Event()

    def work(request):
        done.append(request)
        begun.set()
        go_on.wait(10)
        if request == 3:
            last.set()

    latest = LatestOnlyWorker(work)
    latest.ask(0)
    assert begun.wait(10)
    for request in (1, 2, 3):
        latest.ask(request)
    go_on.set()
    assert last.wait(10)
    latest.close()
    latest.wait()
    assert done == [0, 3]


def test_tendons_that_displacement_drives_are_drawn_out_as_far_as_they_should_be(make_config):
    tendon = {"drive": "displacement", "friction_coefficient": 0.2, "axial_stiffness": 4000.0}
    setting = Setting.of(make_config(routing=HELIX, tendon=tendon))
    history = pull_and_release(setting.robot, 0, 0.004, 0.002)
    curves = simulated(setting, history)
    assert history.displacement is not None and np.max(curves.T_base) > 1.0
    np.testing.assert_allclose(curves.displacement[:, 0], history.displacement, atol=1e-9)
    assert curves.failed == 0


def test_names_in_the_folder_are_free(tmp_path):
    assert free_name(tmp_path, "fit").name == "fit-1"
    (tmp_path / "fit-1").mkdir()
    (tmp_path / "fit-2.toml").write_text("")
    assert free_name(tmp_path, "fit").name == "fit-3"


def test_without_bokeh_the_command_says_what_to_install(capsys, monkeypatch):
    real = builtins.__import__

    def absent(name, *rest, **more):
        if name.partition(".")[0] == "bokeh":
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", absent)
    done = run_gtr(capsys, "view", RECORDED)
    assert (done.status, done.out) == (2, "")
    assert done.err == "error: gtr view needs Bokeh, which is not installed; pip install 'gtr-jax[view]'\n"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--drop", "1:2"], "--drop: has no effect without a recording; leave it out"),
        (["--port", "70000"], "--port: 70000 is not a port; leave it out for a free one"),
    ],
)
def test_options_that_cannot_be_are_refused(capsys, tmp_path, arguments, says):
    done = run_gtr(capsys, "view", RECORDED, "--no-browser", "-o", tmp_path, *arguments)
    assert (done.status, done.err) == (2, f"error: {says}\n")


@pytest.mark.parametrize("header", ["time_s,T_base_N", "T_base_N,tip_x_m"])
def test_glitches_cannot_be_kept_where_none_are_looked_for(capsys, tmp_path, header):
    """In a bare history, and in rows that are not in time."""
    history = tmp_path / "history.csv"
    np.savetxt(history, np.c_[np.arange(9.0), np.arange(9.0) / 9], delimiter=",", header=header, comments="")
    done = run_gtr(capsys, "view", RIG, history, "--keep-glitches", "--no-browser", "-o", tmp_path)
    says = f"--keep-glitches: has no effect on {history}, in which no glitches are looked for; leave it out"
    assert (done.status, done.out, done.err) == (2, "", f"error: {says}\n")


def test_glitches_are_looked_for_where_something_is_measured_in_time():
    recording = gtr.read_recording(RIG.parent / "tuesday.csv")
    assert seeks_glitches(recording.quantities, measured=True)
    untold = dataclasses.replace(recording, T_tip=None)
    assert seeks_glitches(untold.quantities, measured=True)
    assert not seeks_glitches(untold.quantities, measured=False)
    # Of displacements alone, which drive the tendon.
    drawn = dataclasses.replace(untold, tip_angle=None, T_base=np.full_like(recording.T_base, np.nan))
    assert not seeks_glitches(drawn.quantities, measured=True)


def test_a_robot_with_a_law_of_its_own_has_its_sliders():
    config = gtr.load_config(Path(__file__).parents[2] / "examples/tdcm-1-law.toml")
    setting = Setting.of(config)
    own = [knob.name for knob in knobs_of(setting.robot, setting.terms, config=config) if knob.term]
    assert own and all(name.partition(".")[0] == setting.terms[0] for name in own)


def contrast(one, other="#FFFFFF"):
    """Of two colours, as the Web Content Accessibility Guidelines define it: 1 to 21."""

    def luminance(colour):
        parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    low, high = sorted(map(luminance, (one, other)))
    return (high + 0.05) / (low + 0.05)


def test_letters_and_lines_have_the_contrast_that_the_guidelines_ask_for():
    assert contrast("#000000") == pytest.approx(21.0) and contrast("#777777") == pytest.approx(4.48, abs=0.01)
    letters = [dials.PRIMARY, dials.PRESSED, dials.RED, *re.findall("color: (#[0-9a-fA-F]{6})", dials.LABEL)]
    style = (Path(dials.__file__).parent / "page.css").read_text()
    letters += re.findall(r"[ {]color: (#[0-9a-fA-F]{6})", style)
    assert len(letters) > 5
    assert {colour: contrast(colour) for colour in letters if contrast(colour) < 4.5} == {}
    lines = [*figures.TENDONS, *figures.GHOSTS, figures.CHOSEN, bodies.MIDDLE]
    assert {colour: contrast(colour) for colour in lines if contrast(colour) < 3.0} == {}
