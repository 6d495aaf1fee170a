"""Physics terms that act on one of several tendons."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from calibrate.planning.model import _without_events
from gtr_jax.app.view.knobs import knobs_of
from gtr_jax.app.view.model import Setting
from gtr_jax.config.config import config_text, parse_config
from gtr_jax.config.toml_file import read_toml
from gtr_jax.errors import InputError
from gtr_jax.simulation.sensing import cells_show, true_base
from gtr_jax.terms import REGISTRY

T = np.stack([[0.0, 4, 8, 5, 2, 6], [1.0, 1, 2, 3, 3, 2]], axis=1)
CLOCK = 0.5 * np.arange(len(T))
PLANE = ({"kind": "parallel", "offset": 0.01}, {"kind": "parallel", "offset": -0.008})
SPACE = ({"kind": "straight", "radius": 0.01, "angle": 0.2}, {"kind": "helix", "radius": 0.009, "turns": 0.5})


def robot(make_robot, routings, terms, **more):
    tendons = [
        {"name": name, "friction_coefficient": 0.2, "routing": routing}
        for name, routing in zip(("left", "right"), routings, strict=True)
    ]
    return make_robot(0.3, tendons=tendons, backbone={"poissons_ratio": 0.4}, terms=terms, **more)


def typical(kind, **more):
    return {"kind": kind, **{q.name: float(q.typical) for q in REGISTRY[kind].quantities}, **more}


def shows(robot):
    run = gtr.simulate(robot, T, time=CLOCK)
    assert np.all(run.converged)
    return run


CELLS = ("base-gain", "crosstalk", "low-pass", "time-skew", "cell-hysteresis", "zero-drift", "saturation")


@pytest.mark.slow
def test_cells_of_one_tendon_leave_the_other_alone(make_robot):
    tension, time = (jnp.asarray(T), jnp.asarray(0.8 * T)), jnp.asarray(CLOCK)
    for kind in CELLS:
        own, every = (
            robot(make_robot, SPACE, [typical(kind, **whose)]) for whose in ({"tendon": "left"}, {})
        )
        for cell, none in enumerate(tension):
            found, all_ = (cells_show(arm, *tension, time)[cell] for arm in (own, every))
            np.testing.assert_allclose(found[:, 0], all_[:, 0], rtol=1e-12, err_msg=kind)
            np.testing.assert_array_equal(found[:, 1], none[:, 1], err_msg=kind)
        shown = cells_show(own, *tension, time).T_base
        if REGISTRY[kind].true_base:
            np.testing.assert_allclose(true_base(own, shown, time), T, atol=1e-9, err_msg=kind)


GROUPS = {
    "plane": (PLANE, ("wear", "adhesion", "tendon-stretch", "clearance", "local-friction", "presliding")),
    "space": (
        SPACE,
        ("wear", "adhesion", "tendon-stretch", "clearance", "local-friction", "stribeck-friction"),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("where", GROUPS)
def test_a_term_of_each_tendon_is_that_of_all(make_robot, where):
    routings, kinds = GROUPS[where]
    every = shows(robot(make_robot, routings, [typical(kind) for kind in kinds]))
    both = [typical(kind, tendon=tendon) for kind in kinds for tendon in ("left", "right")]
    each = shows(robot(make_robot, routings, both))
    one = shows(robot(make_robot, routings, both[::2]))
    for quantity in ("T_tip", "displacement", "slip"):
        np.testing.assert_allclose(getattr(each, quantity), getattr(every, quantity), rtol=1e-9, atol=1e-12)
    away = np.abs(np.asarray(one.T_tip - every.T_tip))
    assert away[:, 1].max() > 3 * away[:, 0].max() and away[:, 1].max() > 0.05


def test_numbers_of_a_tendon_have_names_and_gradients(make_robot):
    terms = [typical("tip-gain", gain=1.03, tendon="left")]
    arm = robot(make_robot, SPACE, terms)
    assert float(arm.value("tip-gain.gain.left")) == 1.03 and float(arm.value("tip-gain.gain.right")) == 1.0

    def read(gain):
        other = arm.with_values(**{"tip-gain.gain.right": gain})
        return cells_show(other, jnp.asarray(T), jnp.asarray(0.8 * T), jnp.asarray(CLOCK)).T_tip[3]

    slope = jax.jacobian(read)(jnp.asarray(1.1))
    assert slope[0] == 0 and float(slope[1]) == pytest.approx(float(read(1.1)[1]) / 1.1)


def config(make_config, terms, **more):
    tendons = [
        {"name": name, "friction_coefficient": 0.2, "routing": routing}
        for name, routing in zip(("left", "right"), SPACE, strict=True)
    ]
    return make_config(tendons=tendons, backbone={"poissons_ratio": 0.4}, terms=terms, **more)


@pytest.mark.slow
def test_it_is_fitted_and_written(make_config, tmp_path):
    truth = config(make_config, [typical("tip-gain", gain=1.05, tendon="left")])
    run = gtr.simulate(gtr.build_robot(truth), T)
    noise = 1e-3 * np.random.default_rng(1).normal(size=T.shape)
    recording = gtr.Recording(
        T_base=T, T_tip=np.asarray(run.reading.T_tip) + noise, path=tmp_path / "r.csv", sha256=""
    )
    start = truth.with_values({"terms.tip-gain:left.gain": 1.0})
    fit = calibrate.fit(start, recording, free=("tip-gain.gain.left", "mu.left", "mu.right"), noise_N=1e-3)
    found = fit["tip-gain.gain.left"]
    assert found.sd is not None and abs(found.value - 1.05) < 4 * found.sd < 0.08
    assert fit.config is not None and fit.config.terms[0].tendon == "left"
    (tmp_path / "robot.toml").write_text(config_text(fit.config))
    again = parse_config(read_toml(tmp_path / "robot.toml"))
    assert again.term_values["tip-gain"]["gain"].tolist() == [found.value, 1.0]
    more = again.with_values({"terms.crosstalk:right.share": 0.02})
    assert [(t.kind, t.tendon) for t in more.terms] == [("tip-gain", "left"), ("crosstalk", "right")]


@pytest.mark.slow
def test_the_diagnosis_tells_on_which_tendon_an_effect_acts(tmp_path):
    """A gain of the left tip cell; the cell of the right one is sound."""

    def arm(*terms):
        routing = {"kind": "helix", "radius": 0.009}
        tendons = [
            {"name": "left", "routing": routing | {"turns": 0.4, "start_angle": 0.2}},
            {"name": "right", "routing": routing | {"turns": -0.3, "start_angle": 2.2}},
        ]
        body = {"length": 0.25, "outer_radius": 0.012, "youngs_modulus": 1e6, "poissons_ratio": 0.4}
        return parse_config(
            {
                "schema": 1,
                "backbone": body,
                "tendons": [{**tendon, "friction_coefficient": 0.2} for tendon in tendons],
                "terms": terms,
            }
        )

    way = np.linspace(0.0, 2 * np.pi, 100)
    pulled = np.stack([2 - 2 * np.cos(1.5 * way), 1.5 - 1.5 * np.cos(2 * way)], axis=1)
    run = gtr.simulate(gtr.build_robot(arm({"kind": "tip-gain", "gain": 1.06, "tendon": "left"})), pulled)
    rng = np.random.default_rng(3)
    place = np.asarray(run.tip_position) + 1e-4 * rng.normal(size=(len(way), 3))
    recording = gtr.Recording(
        T_base=pulled,
        T_tip=np.asarray(run.reading.T_tip) + 5e-3 * rng.normal(size=pulled.shape),
        path=tmp_path / "rec.csv",
        sha256="",
        **dict(zip(("tip_x", "tip_y", "tip_z"), place.T, strict=True)),
    )
    found = calibrate.diagnose(arm(), recording)
    assert found.verdict == "missing-physics" and found.named == ["tip-gain"], found.says
    gain = next(c for c in found.parameters if c.name == "tip-gain.gain.left")
    assert gain.after is not None and gain.sd is not None and abs(gain.after - 1.06) < 4 * gain.sd < 0.01
    assert found.config is not None
    assert [(term.kind, term.tendon) for term in found.config.terms] == [("tip-gain", "left")]


def test_the_live_page_has_sliders_of_each_tendon(make_config):
    terms = [typical("tip-gain", gain=1.05, tendon=name) for name in ("left", "right")]
    setting = Setting.of(config(make_config, terms))
    assert setting.terms == ("tip-gain",)
    knobs = {knob.name: knob for knob in knobs_of(setting.robot, setting.terms, config=setting.config)}
    assert knobs["tip-gain.gain.right"].label == "gain of right"
    moved = setting.with_value("tip-gain.gain.right", 1.02).written()
    assert moved.term_values["tip-gain"]["gain"].tolist() == [1.05, 1.02]
    without = setting.without_term("tip-gain")
    assert np.all(np.asarray(without.changed.terms["tip-gain"]["gain"]) == 1.0)


def test_its_card_shows_the_number_of_the_tendon(make_robot):
    card = robot(make_robot, SPACE, [typical("tip-gain", gain=1.05, tendon="left")])._repr_html_()
    assert card is not None and "tip-gain.gain.left" in card and "tip-gain.gain.right" not in card


def test_what_happens_once_on_a_tendon_is_not_planned_for(make_config):
    once = config(make_config, [typical("shaken-sheath", tendon="left")])
    assert np.all(once.term_values["shaken-sheath"]["share"] == [0.5, 0.0])
    assert np.all(_without_events(once).term_values["shaken-sheath"]["share"] == 0.0)


WRONG = {
    "no such tendon": (
        [{"kind": "tip-gain", "gain": 1.1, "tendon": "up"}],
        "no tendon 'up'; one of left, right",
    ),
    "of the body": ([{"kind": "stiffening", "coefficient": 1e-4, "tendon": "left"}], "acts on the body"),
    "twice": (2 * [{"kind": "tip-gain", "gain": 1.1, "tendon": "left"}], "is given twice; remove one"),
    "all and one": (
        [{"kind": "tip-gain", "gain": 1.1}, {"kind": "tip-gain", "gain": 1.2, "tendon": "left"}],
        "is given twice; remove one, or give each a tendon of its own",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_no_tendon_can_have_is_refused(make_config, name):
    terms, words = WRONG[name]
    with pytest.raises(InputError, match=words) as refused:
        config(make_config, terms)
    assert "\n" not in str(refused.value)


def test_the_only_tendon_needs_no_name(make_config):
    with pytest.raises(InputError, match="the robot has one tendon; leave tendon out"):
        make_config(terms=[{"kind": "tip-gain", "gain": 1.1, "tendon": "left"}])
