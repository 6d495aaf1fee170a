"""The files of real robots that ship predict what they were not fitted to."""

import numpy as np
import pytest

import gtr_jax as gtr
from examples.robots.pages import DOCS, WIDTH, insist, wrapped
from examples.robots.tentacle import FOLDER, distances, holds, rms
from examples.robots.wrist_trials import Trial, left_out, scatter
from examples.robots.wrist_verdicts import Remedy, alike, helped, mended, nearly, settled, way
from examples.robots.wrists import COUNT, REST_KEYS, SHARED, WRISTS
from examples.robots.wrists import FOLDER as WRISTS_FOLDER
from gtr_jax.plots.shape import curve_of
from gtr_jax.plots.straight import notches_of
from gtr_jax.robot.parameters import parameters_of
from gtr_jax.simulation.history import equilibrium_at

LEFT = sorted(file.stem for file in WRISTS_FOLDER.glob("*-*.toml"))


@pytest.mark.slow
def test_the_tentacle_predicts_the_holds_that_it_was_not_fitted_to():
    config = gtr.load_config(FOLDER / "fitted.toml")
    found = distances(gtr.build_robot(config), "test")
    plain = distances(gtr.load_robot(FOLDER / "tentacle.toml"), "test")
    assert found.shape == (7, 4)
    assert rms(found) < 10.0 < rms(plain)


def test_recordings_of_the_tentacle_are_parted_and_have_their_notice():
    (trained, pulls, _), (judged, both, _) = holds("train"), holds("test")
    assert (len(trained), len(judged)) == (8, 7)
    assert not set(trained) & set(judged)
    assert np.all(np.sum(pulls > 0, axis=1) == 1)
    assert np.sum(np.all(both > 0, axis=1)) == 4
    assert "MIT License" in (FOLDER / "NOTICE").read_text(encoding="utf-8")


@pytest.mark.parametrize("wrist", WRISTS)
def test_wrists_close_one_notch_after_the_other(wrist):
    config = gtr.load_config(WRISTS_FOLDER / f"{wrist}.toml")
    assert len(config.backbone.notches[0].ends) == COUNT
    run = gtr.simulate(gtr.build_robot(config), np.linspace(0.0, 6.0, 13))
    assert np.all(run.converged)
    found = np.asarray(gtr.marker_angles(gtr.build_robot(config), run))
    assert np.all(np.diff(found[4]) < 0)
    closed = config.backbone.notches[0].height / (0.81e-3 + 0.6865e-3)
    assert found[-1] == pytest.approx(closed, rel=0.05)


def test_the_files_that_fits_and_diagnoses_leave_ship():
    each = {f"{wrist}-{kind}" for wrist in WRISTS for kind in ("fitted", "diagnosed")}
    assert set(LEFT) == each | {"wrist-both-fitted"}


@pytest.mark.parametrize("name", LEFT)
def test_they_predict_from_the_file_alone(name):
    """Notches bend by more than at rest, the one at the base first, and none beyond its closing."""
    config = gtr.load_config(WRISTS_FOLDER / f"{name}.toml")
    assert config.term_values["superelastic"]["softening"] > 0.5
    assert config.tendon.friction_coefficient > 0.1
    robot = gtr.build_robot(config)
    run = gtr.simulate(robot, np.linspace(0.0, 2.0, 11))
    assert np.all(run.converged)
    rest, *_, bent = each = np.asarray(gtr.marker_angles(robot, run))
    closed = config.backbone.notches[0].height / (0.81e-3 + 0.6865e-3)
    assert np.all((bent > rest + np.deg2rad(5.0)) & (bent < 1.05 * closed))
    first, *_, last = each[7] - rest  # at 1.4 N
    assert first > last + np.deg2rad(1.0)


def test_the_file_for_a_third_wrist_is_straight_and_says_how_well_its_numbers_are_known():
    config = gtr.load_config(WRISTS_FOLDER / "wrist-both-fitted.toml")
    assert all(angle == 0.0 for angle in config.backbone.notches[0].natural_angle)
    known = {key: config.deviation(key) or 0.0 for key in config.uncertainty}
    assert all(1.0 < np.degrees(known[key]) < 4.0 for key in REST_KEYS)
    robot = gtr.build_robot(config)
    names, ones = parameters_of(robot), [gtr.load_robot(WRISTS_FOLDER / f"{w}-fitted.toml") for w in WRISTS]
    for name in SHARED:
        value, sd = float(robot.value(name)), known[names[name].key]
        assert all(abs(float(one.value(name)) - value) < 2.5 * sd for one in ones), name


def test_the_tentacle_from_its_fitted_file_keeps_its_numbers():
    config = gtr.load_config(FOLDER / "fitted.toml")
    run = gtr.simulate(gtr.build_robot(config), [[0.0, 0.0], [5.0, 2.0]])
    assert np.all(run.converged)
    assert (config.deviation("base.position.0") or 0.0) > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wrist90", "wrist150"])
def test_a_bent_wrist_is_drawn_where_it_is(name):
    """Its axis is shortened where its notches close: the tip is the simulated one, and the rims of the closed
    first notch meet.
    """
    robot = gtr.load_robot(WRISTS_FOLDER / f"{name}-fitted.toml")
    run = gtr.simulate(robot, np.linspace(0.0, 2.5, 26))
    state = equilibrium_at(robot, run, 25)
    curve = curve_of(state, np.asarray(robot.backbone.radius(state.s)), notches_of(robot))
    np.testing.assert_allclose(curve.middle[-1], 1e3 * np.asarray(run.tip_position)[25, :2], atol=1e-9)
    start, end, _ = notches_of(robot)[0]
    rim = curve.outline[: len(curve.s)]
    before, after = (np.flatnonzero(np.isclose(curve.s, at)) for at in (start, end))
    assert np.linalg.norm(rim[before[0]] - rim[after[-1]]) < 0.02  # of 0.5 and 0.8 mm
    last = np.max(np.linalg.norm(np.diff(curve.middle, axis=0), axis=1))
    assert last < 0.2  # no jump between panels


def test_notches_are_drawn_where_they_are_cut():
    """The outline of a straight wrist lacks what its notches take."""
    config = gtr.load_config(WRISTS_FOLDER / "wrist150.toml").with_values(dict.fromkeys(REST_KEYS, 0.0))
    robot = gtr.build_robot(config)
    state = gtr.equilibrium(robot, 0.0)
    curve = curve_of(state, np.asarray(robot.backbone.radius(state.s)), notches_of(robot))
    x, y = curve.outline.T
    area = 0.5 * abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    assert area == pytest.approx(11.0 * 1.62 - COUNT * 0.8 * 1.4, rel=1e-6)
    assert y[(x > 1.3) & (x < 1.9)].max() == pytest.approx(0.81 - 1.4)


BEFORE = {"wrist90": 0.51, "wrist150": 1.09}
PLATEAU = Remedy("a plateau", 2, 0.44, {"wrist90": 0.59, "wrist150": 0.99})
MODULUS = Remedy("a modulus", 1, 0.46, {"wrist90": 0.63, "wrist150": 1.00})
FRICTION = Remedy("a friction", 1, 0.60, {"wrist90": 0.69, "wrist150": 0.95})


def test_what_the_wrists_disagree_about_follows_from_the_errors():
    each = [FRICTION, MODULUS, PLATEAU]
    assert nearly(0.71, each) == [PLATEAU, MODULUS]
    assert mended(0.71, each) == (
        "**A plateau (two numbers more, 0.44°) mends most**, a modulus (one number more, 0.46°) nearly as "
        "much, a friction (one number more, 0.60°) less."
    )
    assert mended(0.71, [FRICTION]) == "**A friction (one number more, 0.60°) mends most**."
    assert mended(0.40, each) == "Nothing of this mends the 0.40° of one set."


def test_what_the_held_out_trials_say_of_it_follows_from_the_errors():
    assert helped(PLATEAU.out, BEFORE) == "helps wrist150 and harms wrist90"
    assert helped(BEFORE, BEFORE) == "changes nothing"
    close = settled(BEFORE, [PLATEAU, MODULUS])
    assert "each helps wrist150 and harms wrist90. They differ by 0.04° at most" in close
    assert close.endswith("cannot settle which it is.")
    better = Remedy("a better one", 1, 0.45, {"wrist90": 0.40, "wrist150": 0.80})
    assert settled(BEFORE, [PLATEAU, better]).endswith(
        "The held-out trials of both are met best by a better one."
    )
    assert settled(BEFORE, [PLATEAU, FRICTION]).endswith("do not agree on which it is.")
    assert settled(BEFORE, [better]).endswith("that helps wrist90 and wrist150.")
    assert (way((1, 2), (4, 3)), way((1, 2), (3, 4))) == ("the other way around", "the same way around")
    assert alike({"a": 0.9, "b": 0.3}, {"a": 0.5, "b": 0.4}) == (
        "In a that is more than within any trial: the trials are not alike. "
        "In b that is no more than within a trial, and does not tell them apart."
    )


def test_the_scatter_of_angles_lies_between_a_fitted_curve_and_samples_left_out():
    random = np.random.default_rng(0)
    T = np.linspace(0.0, 3.0, 15)
    found = np.empty((20, 2))
    for i in range(len(found)):
        noise = np.deg2rad(0.3) * random.standard_normal((15, COUNT))
        trial = [Trial(T, np.deg2rad(20.0) * np.tanh(T)[:, None] + noise)]
        found[i] = scatter(trial), left_out(trial)
    fitted, left = np.sqrt(np.mean(found**2, axis=0))
    assert fitted < 0.3 < left


def test_a_page_is_not_written_where_what_it_concludes_does_not_hold():
    insist({"one": True})
    with pytest.raises(SystemExit, match="do not: two"):
        insist({"one": True, "two": False})


def test_prose_of_a_page_is_wrapped_and_says_the_same():
    words = " ".join(f"word{i}" for i in range(60))
    text = f"# {words}\n\n{words}\n\n| {words} |\n| --- |\n\n- {words}\n- two\n\n> {words}\n> {words}\n"
    found = wrapped(text)
    head, prose, table, items, quoted = found.rstrip("\n").split("\n\n")
    assert (head, table) == (f"# {words}", f"| {words} |\n| --- |")
    assert prose.split() == words.split()
    assert [line[:2] for line in items.split("\n")] == ["- ", *["  "] * (items.count("\n") - 1), "- "]
    assert all(line.startswith("> ") for line in quoted.split("\n"))
    assert max(len(line) for part in (prose, items, quoted) for line in part.split("\n")) <= WIDTH
    assert wrapped(found) == found
    # No number or dash that would begin a list comes to the beginning of a line.
    assert all(line.startswith("x") for line in wrapped("x" * 148 + " 4. x - " + "x" * 140).splitlines())


@pytest.mark.parametrize("name", ["giraffe", "tentacle", "wrists"])
def test_the_pages_are_wrapped(name):
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert wrapped(text) == text
