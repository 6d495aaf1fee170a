"""Laws of a robot file: they do what terms of the catalogue do, have gradients, and are fitted and found."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import RESTATED, table

import calibrate
import gtr_jax as gtr
from benchmarks.blind import machine
from calibrate.diagnosis.hypotheses.hypotheses import catalogue
from calibrate.inference.simulated_rig import PROGRAMS, program_for
from gtr_jax.config.config import load_config, parse_config
from gtr_jax.config.law_section import LawSection
from gtr_jax.examples import CONCEALED_ROBOT
from gtr_jax.simulation.history import loads_of, reading
from gtr_jax.simulation.natively import steps_natively
from gtr_jax.simulation.programs import structure_of, structure_with
from gtr_jax.simulation.sensing import cells_show, true_base
from gtr_jax.terms import Quantity, catalogue_of, stiffening
from gtr_jax.terms.law import Law, term_of_law
from gtr_jax.terms.term import Bent, Clock
from tests.benchmarks.test_blind import ARM

SINE = {"kind": "straight-sine-straight", "r1": -0.01, "r2": 0.01, "w1": 0.03, "w2": 0.1}
T_BASE = np.concatenate([np.linspace(0, 30, 8), np.linspace(30, 4, 8)[1:], np.linspace(4, 16, 5)[1:]])
TIME = 0.5 * np.arange(len(T_BASE))
RESTATED_SIZE = (Quantity("size", "m^2", 0.0, 0.02, "", (0.0, 0.05), size=True),)
CELLS = {"tip-gain", "base-gain", "zero-drift"}


def natively(robot, kinds=None):
    """Tip tension, pose and displacement of the loop, of steps that all converged."""
    structure = structure_of(robot, None) if kinds is None else structure_with(robot, kinds)
    loads = loads_of(jnp.asarray(T_BASE), jnp.asarray(TIME), None)
    run = steps_natively(robot, structure, loads)
    assert run.converged.all()
    return np.column_stack([run.T_tip, run.tip_pose, run.displacement])


@pytest.mark.parametrize(
    "kinds",
    [
        ("adhesion", "wear", "friction-drift", "stiffening", "tendon-stretch", "pressure-dependent-friction"),
        ("viscous-friction", "stribeck-friction"),
        *(pytest.param((kind,), marks=pytest.mark.slow) for kind in RESTATED if kind not in CELLS),
    ],
    ids="+".join,
)
def test_laws_that_restate_terms_give_the_same_loop(make_robot, kinds):
    terms = [{"kind": kind, **RESTATED[kind][0]} for kind in kinds]
    laws = [table(name=f"my-{kind}", **RESTATED[kind][1]) for kind in kinds]
    theirs, ours = make_robot(routing=SINE, terms=terms), make_robot(routing=SINE, terms=laws)
    assert ours.acting and {*structure_of(ours, None).terms} == {f"my-{kind}" for kind in kinds}
    plain = natively(make_robot(routing=SINE))
    expected, found = natively(theirs), natively(ours)
    assert np.max(np.abs(expected - plain)) > 1e-3
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


TWO = [
    {"name": "left", "friction_coefficient": 0.3, "routing": {"kind": "parallel", "offset": 0.008}},
    {"name": "right", "friction_coefficient": 0.2, "routing": {**SINE, "r1": 0.008, "r2": -0.008}},
]


@pytest.mark.slow
@pytest.mark.parametrize(
    "sections",
    [{"tendons": TWO}, {"routing": {"kind": "helix", "radius": 0.008, "turns": 0.5}}],
    ids=["two tendons", "in space"],
)
def test_laws_restate_terms_for_every_robot(make_robot, sections):
    kinds = ("adhesion", "stiffening", "pressure-dependent-friction", "stribeck-friction")
    terms = [{"kind": kind, **RESTATED[kind][0]} for kind in kinds]
    laws = [table(name=f"my-{kind}", **RESTATED[kind][1]) for kind in kinds]
    # Of the place and the tension, so that friction at a tension reads the channel.
    laws[2]["law"] = f"({laws[2]['law']}) * (1 + 0 * s / far)"
    laws[2]["far"] = "1 m"
    T = np.stack([T_BASE[:12], 0.5 * T_BASE[:12][::-1]], axis=1) if "tendons" in sections else T_BASE[:12]
    runs = []
    for given in (terms, laws, []):
        robot = make_robot(resolution=0.35, terms=given, **sections)
        runs.append(gtr.simulate(robot, T, time=TIME[:12]))
        assert bool(jnp.all(runs[-1].converged))
    theirs, ours, plain = (np.asarray(run.T_tip) for run in runs)
    assert np.max(np.abs(theirs - plain)) > 0.1
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(runs[1].tip_pose, runs[0].tip_pose, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("kind", sorted(CELLS))
def test_laws_of_cells_show_what_terms_show(make_robot, kind):
    theirs = make_robot(terms=[{"kind": kind, **RESTATED[kind][0]}])
    ours = make_robot(terms=[table(name="cell", **RESTATED[kind][1])])
    T_tip, time = jnp.asarray(0.6 * T_BASE), jnp.asarray(TIME)
    for robot in (theirs, ours):
        assert structure_of(robot, None).terms == ()
    expected, found = (cells_show(robot, jnp.asarray(T_BASE), T_tip, time) for robot in (theirs, ours))
    assert max(float(jnp.max(jnp.abs(expected[i] - true))) for i, true in ((0, T_BASE), (1, T_tip))) > 0.05
    for i in (0, 1):
        np.testing.assert_allclose(found[i], expected[i], rtol=1e-12)
    np.testing.assert_allclose(true_base(ours, expected.T_base, time), T_BASE, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])
def test_a_bending_law_of_the_place_is_a_stiffness_that_changes_along_the_body(make_robot, space):
    """Against a table of EI that rises evenly to 1.4 times as much at the tip."""
    routing = {"kind": "helix", "radius": 0.008, "turns": 0.5} if space else SINE
    law = table(acts="bending", law="size*k*s/reach", size=0.4, reach="250 mm")
    ends = [[0.0, 0.05], [0.25, 0.07]]
    body = {"outer_radius": 0.015, "youngs_modulus": None} | ({"torsional_stiffness": 0.04} if space else {})

    def made(stiffness, terms=()):
        backbone = {**body, "bending_stiffness": stiffness}
        return make_robot(0.25, routing=routing, backbone=backbone, terms=list(terms))

    ours, theirs, plain = made(0.05, [law]), made(ends), made(0.05)
    runs = [gtr.simulate(robot, T_BASE[:12], time=TIME[:12]) for robot in (ours, theirs, plain)]
    assert all(bool(jnp.all(run.converged)) for run in runs)
    found, expected, without = (np.asarray(run.tip_position) for run in runs)
    assert np.max(np.abs(expected - without)) > 2e-3
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(runs[0].T_tip, runs[1].T_tip, atol=1e-8)


def test_a_bending_law_must_leave_some_stiffness(make_robot):
    law = table(acts="bending", law="size*k*s/reach", size=-0.9, reach="250 mm")
    assert make_robot(terms=[law]).acting
    with pytest.raises(gtr.InputError, match=r"leaves -0\.2 of the stiffness at s = 250 mm"):
        make_robot(terms=[{**law, "size": -1.2}])


def test_a_law_of_the_base_cell_is_read_backwards_with_its_gradient(make_robot):
    cell = table(acts="base_cell", law="T + size * sin(T / period)", size="0.8 N", period="3 N")
    robot = make_robot(terms=[cell, {"kind": "base-offset", "force": 0.3}])
    T = jnp.asarray(T_BASE)
    shown = cells_show(robot, T, T, jnp.asarray(TIME)).T_base
    # The law of the file acts on the true tension, before the terms of the catalogue.
    np.testing.assert_allclose(shown, T + 0.8 * jnp.sin(T / 3) + 0.3, rtol=1e-14)
    np.testing.assert_allclose(true_base(robot, shown, TIME), T, rtol=1e-12, atol=1e-12)

    def back(size):
        term = robot.catalogue["law"]
        assert term.true_base is not None
        return term.true_base({**robot.terms["law"], "size": size}, shown - 0.3, Clock(jnp.asarray(TIME), T))

    slope = jax.jvp(back, (jnp.asarray(0.8),), (jnp.asarray(1.0),))[1]
    exact = -jnp.sin(T / 3) / (1 + 0.8 / 3 * jnp.cos(T / 3))
    np.testing.assert_allclose(slope, exact, rtol=1e-9, atol=1e-11)


MIXED = [
    table(
        name="grip",
        acts="friction",
        law="1 + size * exp(-p / fade) * (1 + s / far) * (1 + n)",
        size=0.3,
        fade="40 N/m",
        far="0.2 m",
    ),
    table(
        name="seal",
        acts="drag",
        law="size * (1 - T / (T + most)) * sqrt(1 + t / late)",
        size="2 N/m",
        most="20 N",
        late="5 s",
    ),
    table(name="fold", acts="bending", law="size * tanh(k / scale)^3", size="2 1/m", scale="4 1/m"),
    table(name="cell", acts="tip_cell", law="T + size * abs(sin(T / period))", size="0.1 N", period="7 N"),
]
SIZES = {"grip": "dimensionless", "seal": "N/m", "fold": "1/m", "cell": "N"}


def test_null_laws_are_the_base_model(make_robot):
    less = {"size": 0.0, "usual": {"size": [0.0, 1.0]}}
    null = [{**law, **less, "units": {"size": SIZES[law["name"]]}} for law in MIXED]
    robot, plain = make_robot(routing=SINE, terms=null), make_robot(routing=SINE)
    assert structure_of(robot, None).terms == ()
    kinds = ("grip", "seal", "fold")
    np.testing.assert_allclose(natively(robot, kinds), natively(plain), rtol=1e-9, atol=1e-11)


@pytest.fixture(scope="module")
def mixed():
    """A number of what the cells show as a function of all numbers of four laws and of mu."""
    data = {
        "schema": 1,
        "backbone": {"length": 0.25, "outer_radius": [0.02, 0.013], "youngs_modulus": 1.06e6},
        "routing": SINE,
        "tendon": {"friction_coefficient": 0.3},
        "terms": MIXED,
    }
    robot = gtr.build_robot(parse_config(data), resolution=0.35)
    values = {
        f"{law.name}.{q.name}": float(robot.terms[law.name][q.name])
        for law in robot.laws
        for q in law.numbers
    }
    values |= {"mu": 0.3}
    T, time = jnp.asarray([0.0, 12.0, 30.0, 20.0, 5.0]), jnp.asarray([0.0, 1.0, 2.0, 3.0, 4.0])

    def shown(values):
        moved = robot.with_values(**values)
        run = gtr.simulate(moved, T, time=time)
        cells = reading(moved, run).T_tip
        return jnp.sum(cells * jnp.asarray([0.0, 1.0, 0.3, -0.7, 0.5])) + 10 * run.tip_pose[2, 2]

    return values, jax.jit(shown), jax.jit(jax.value_and_grad(shown))


def test_gradients_of_laws_against_differences(mixed):
    values, _, with_gradient = mixed
    gradient = with_gradient(values)[1]

    def slope(name, at, step):
        ends = [float(with_gradient(values | {name: at * (1 + way * step)})[0]) for way in (1, -1)]
        return (ends[0] - ends[1]) / (2 * step)

    for name, at in values.items():
        near, far = (slope(name, at, step) for step in (5e-4, 1e-3))
        assert float(gradient[name]) * at == pytest.approx((4 * near - far) / 3, rel=1e-5, abs=1e-7), name


@pytest.mark.slow
def test_a_batch_of_laws_is_a_loop_over_them(mixed):
    values, shown, _ = mixed
    factors = np.asarray([0.5, 1.0, 1.7])
    rows = {name: jnp.asarray(at * factors) for name, at in values.items()}
    batch = eqx.filter_vmap(shown)(rows)
    each = [float(shown({name: column[i] for name, column in rows.items()})) for i in range(len(factors))]
    np.testing.assert_allclose(batch, each, rtol=1e-10)


@pytest.mark.parametrize("size", [0.5, -0.5])
def test_a_law_of_what_is_drawn_out_is_that_of_an_elastic_thread(size):
    """A tendon that catches, or comes free, at one place of its way: against the blind machine."""
    corners = np.asarray([(0, 0), (10, 40), (14, 12), (17, 30), (21, 5), (26, 30)])
    time = np.arange(0.0, 26.0, 0.0625)
    T_base = np.interp(time, *corners.T)
    config = load_config(CONCEALED_ROBOT).model_dump(mode="json", by_alias=True, exclude_none=True)
    law = "1+size*exp(-((d-at)/width)^2)"
    snag = table(name="snag", acts="friction", law=law, size=size, at="3.8 mm", width="0.9 mm")
    robot = gtr.build_robot(parse_config(config | {"terms": [snag]})).with_values(mu=0.3, E=1.5e6)
    catches = machine.Laws(friction=lambda g: 1 + size * np.exp(-(((g.drawn - 3.8e-3) / 0.9e-3) ** 2)))
    plain, shown = (machine.run(arm, time, T_base) for arm in (ARM, dataclasses.replace(ARM, laws=catches)))
    run = gtr.simulate(robot, T_base, time=time)
    assert bool(run.converged.all()) and np.max(np.abs(shown.T_tip - plain.T_tip)) > 1.5
    off = np.asarray(run.T_tip) - shown.T_tip
    assert np.max(np.abs(off)) < 0.15 and np.sqrt(np.mean(off**2)) < 0.03
    assert np.max(np.abs(np.asarray(run.displacement) - shown.drawn)) < 5e-5
    structure = structure_of(robot, None)
    found = steps_natively(robot, structure, loads_of(jnp.asarray(T_base), jnp.asarray(time), None))
    np.testing.assert_allclose(found.T_tip, run.T_tip, atol=1e-8)


@pytest.mark.parametrize("text", ["size * k^3", "size * k * abs(k)", "size * sin(k / 9)"])
def test_bending_laws_in_space_bend_along_the_vector_of_both_bendings(text):
    own = Law("fold", "bending", text, RESTATED_SIZE)
    term, p = term_of_law(own), {"size": jnp.asarray(0.02)}
    assert term.bend is not None and term.bend_in_space is not None and term.not_in_space == ""
    rest, soft = (jnp.zeros(()), jnp.asarray(0.5), jnp.asarray(-0.2)), (jnp.asarray(3.0),) * 3
    at = Bent(rest, rest, (jnp.zeros((0,)),) * 3, jnp.asarray(1.0), soft)
    for angle in (0.3, 2.0, 4.5):
        strain = (jnp.asarray(0.7), 0.5 + 4 * jnp.cos(angle), -0.2 + 4 * jnp.sin(angle))
        extra, _ = term.bend_in_space(p, strain, at)
        flat = Bent(jnp.zeros(()), jnp.zeros(()), jnp.zeros((0,)), jnp.asarray(1.0))
        size = float(term.bend(p, jnp.asarray(4.0), flat)[0])
        np.testing.assert_allclose(extra, [0.0, size * np.cos(angle), size * np.sin(angle)], atol=1e-14)
        if text.endswith("k^3"):
            theirs, _ = stiffening.bend_in_space({"coefficient": p["size"]}, strain, at)
            np.testing.assert_allclose(extra, theirs, rtol=1e-12, atol=1e-15)
    in_space, in_plane = term.bend_in_space, term.bend
    straight = jax.jacfwd(lambda y: in_space(p, (rest[0], y, rest[2]), at)[0][1])(rest[1])
    slope = jax.grad(lambda k: in_plane(p, k, flat)[0])(0.0)
    assert float(straight) == pytest.approx(float(slope), abs=1e-12)


def test_a_program_of_a_diagnosis_takes_laws_in(make_robot):
    robot = make_robot(routing=SINE)
    assert program_for(robot, {"adhesion"}) == PROGRAMS[1]
    assert program_for(robot, {"seal"}) == ("seal",)
    assert program_for(robot, {"seal", "presliding"}) == (*PROGRAMS[3], "seal")


NULL = table(
    name="seal", acts="drag", law="size * exp(-p / fade)", size="0 N/m", fade="40 N/m",
    usual={"size": ["0 N/m", "10 N/m"], "fade": ["10 N/m", "200 N/m"]},
)  # fmt: skip


def test_a_null_law_is_a_hypothesis_and_terms_are_left_out(make_robot):
    given = {"timed": True, "largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    robot = make_robot(terms=[NULL])
    of = {h.name: h for h in catalogue(robot, **given)}
    assert of["seal"].kind == "seal"
    size, fade = of["seal"].numbers
    assert (size.name, size.size, size.lower) == ("seal.size", True, 0.0)
    assert (fade.name, fade.log, fade.size) == ("seal.fade", True, False)
    assert fade.centre == pytest.approx(np.sqrt(10 * 200))
    assert all(s["seal.size"] > 0 and 5 < s["seal.fade"] < 400 for s in of["seal"].starts)
    less = {h.name for h in catalogue(robot, **given, without=("seal", "local-friction"))}
    assert set(of) - less == {"seal", "local-friction.base", "local-friction.tip", "local-friction.stretch"}
    acting = make_robot(terms=[{**NULL, "size": "2 N/m"}])
    assert "seal" not in {h.name for h in catalogue(acting, **given)}
    assert "seal" not in {h.name for h in catalogue(make_robot(), **given)}


def test_terms_that_do_not_exist_cannot_be_left_out(make_config):
    T = np.concatenate([np.linspace(0, 20, 21), np.linspace(20, 0, 21)[1:]])
    recording = gtr.Recording(path=Path("r.csv"), sha256="", time=np.arange(41.0), T_base=T, T_tip=0.8 * T)
    with pytest.raises(gtr.InputError, match="without: no term 'preslidin'; the nearest are presliding, "):
        calibrate.diagnose(make_config(), recording, without=("preslidin",))
    with pytest.raises(gtr.InputError, match="without: no term 'seal'"):
        calibrate.diagnose(make_config(), recording, without=("seal",))


def recorded(robot, samples=60, noise=0.03, seed=3):
    """A recording of two loops, with what the cells add."""
    corners = [0, 30, 3, 20, 2]
    T = np.interp(np.linspace(0, 4, samples), np.arange(5), corners)
    time = np.arange(samples) * 0.5
    run = gtr.simulate(robot, T, time=time)
    draw = np.random.default_rng(seed)
    return gtr.Recording(
        path=Path("r.csv"),
        sha256="",
        time=time,
        T_base=np.asarray(run.reading.T_base) + draw.normal(0, noise, samples),
        T_tip=np.asarray(run.reading.T_tip) + draw.normal(0, noise, samples),
    )


@pytest.mark.slow
def test_the_parameters_of_a_law_are_fitted(make_config):
    truth = make_config(routing=SINE, terms=[{**NULL, "size": "5 N/m", "fade": "60 N/m"}])
    recording = recorded(gtr.build_robot(truth))
    start = make_config(routing=SINE, terms=[{**NULL, "size": "1 N/m"}], tendon={"friction_coefficient": 0.2})
    fit = calibrate.fit(start, recording, free=("mu", "seal.size", "seal.fade"))
    assert fit.converged
    of = {e.name: e for e in fit.estimates}
    for name, value in (("mu", 0.3), ("seal.size", 5.0), ("seal.fade", 60.0)):
        sd = of[name].sd
        assert sd is not None and abs(of[name].value - value) < 4 * sd < 0.5 * value, name
    assert fit.config is not None
    (seal,) = (term for term in fit.config.terms if isinstance(term, LawSection))
    assert seal.parameters == pytest.approx({"size": of["seal.size"].value, "fade": of["seal.fade"].value})


@pytest.mark.slow
def test_a_diagnosis_names_a_law(make_config):
    truth = make_config(routing=SINE, terms=[{**NULL, "size": "6 N/m", "fade": "40 N/m"}])
    recording = recorded(gtr.build_robot(truth), samples=120)
    found = calibrate.diagnose(make_config(routing=SINE, terms=[NULL]), recording, without=("adhesion",))
    assert found.verdict == "missing-physics" and found.named == ["seal"], found.says
    size = next(c for c in found.parameters if c.name == "seal.size")
    assert size.lower95 is not None and size.upper95 is not None and size.lower95 < 6.0 < size.upper95
    assert "seal" in found.catalogue and found.config is not None and found.config.laws[0].name == "seal"
    unaware = calibrate.diagnose(make_config(routing=SINE), recording, without=("adhesion",))
    assert "seal" not in unaware.catalogue and "adhesion" not in unaware.settings["hypotheses"]


def test_laws_stand_before_the_catalogue_and_change_nothing_in_it():
    own = Law("fold", "bending", "size * k^3", RESTATED_SIZE)
    assert [*catalogue_of((own,))] == ["fold", *catalogue_of(())]
