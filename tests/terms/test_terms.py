"""Physics terms: dormant at null, one program, the independent simulator, limits, composition."""

import itertools
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from benchmarks.terms import compared
from gtr_jax.report.term_pages import page
from gtr_jax.report.terms import description
from gtr_jax.simulation.programs import unmoved_in
from gtr_jax.terms import (
    REGISTRY,
    cell_hysteresis,
    low_pass,
    null_values,
    saturation,
    viscoelastic_body,
    viscous_friction,
)
from gtr_jax.terms.term import Bent
from gtr_jax.terms.unmoved import NO_SLIP
from tests.conftest import SINE

REFERENCE = Path(__file__).parents[1] / "data" / "reference"
DOCS = Path(__file__).parents[2] / "docs" / "terms"
MECHANICAL = [term for term in REGISTRY.values() if not term.of_cells]
LOADS = {"gravity_angle": -1.2, "tip_force": [0.0, -0.05]}


def way(*corners, steps=12):
    """A load history through corners."""
    parts = [np.linspace(a, b, steps + 1)[1:] for a, b in itertools.pairwise(corners)]
    return np.concatenate([[corners[0]], *parts])


LOOP = way(0, 24, 9, 18, 18, 2, 20)
CLOCK = 0.7 * np.arange(len(LOOP))


def typical(term, **changes):
    """A term's typical numbers, by name of the parameter."""
    return {name: float(q.typical) for name, q in named(term).items()} | changes


def named(term):
    """Its quantities by name of the parameter."""
    return {f"{term.id}.{q.name}": q for q in term.quantities}


@pytest.fixture
def robot(make_robot):
    return make_robot(routing=SINE)


@pytest.mark.parametrize("loads", [{}, LOADS], ids=["free", "loaded"])
def test_null_is_the_base_model(make_robot, loads):
    robot = make_robot(routing=SINE, loads=loads)
    plain = gtr.simulate(robot, LOOP, with_terms=False)
    null = gtr.simulate(robot, LOOP, with_terms=True, solver=gtr.SolverOptions(atol=1e-12))
    for name in ("T_tip", "tip_pose", "tension", "curvature", "displacement", "slip"):
        np.testing.assert_allclose(getattr(null, name), getattr(plain, name), atol=1e-8, err_msg=name)


def test_switching_terms_that_may_act_compiles_nothing(robot):
    run = jax.jit(lambda robot: gtr.simulate(robot, LOOP, time=CLOCK).T_tip)
    null = {name: float(q.null) for term in MECHANICAL for name, q in named(term).items()}
    every = robot.with_values(**null)
    assert robot.acting == () and set(every.acting) == {term.id for term in MECHANICAL}
    tips = [run(every)]
    for term in MECHANICAL:
        tips.append(run(every.with_values(**typical(term))))
    assert run._cache_size() == 1  # pyright: ignore[reportAttributeAccessIssue]
    tips.append(gtr.simulate(robot, LOOP).T_tip)
    np.testing.assert_allclose(tips[-1], tips[0], rtol=1e-12)
    changed = [float(np.max(np.abs(tip - tips[0]))) for tip in tips[1:-1]]
    silent = {"gravity-error", "tendon-stretch", "contact"}  # no weight, no data in tensions, not touched
    for term, change in zip(MECHANICAL, changed, strict=True):
        assert change > 1e-4 or term.id in silent, (term.id, change)


def test_a_traced_robot_holds_the_terms_that_may_act(robot):
    """Those of its file and those that were set, inside the traced function too."""
    acting = robot.with_values(**typical(REGISTRY["stribeck-friction"]))
    exact = gtr.simulate(acting, LOOP, time=CLOCK).T_tip
    run = jax.jit(lambda robot: gtr.simulate(robot, LOOP, time=CLOCK).T_tip)
    np.testing.assert_allclose(run(acting), exact, rtol=1e-9)
    assert np.max(np.abs(run(robot) - exact)) > 1e-3

    def set_inside(robot, ratio):
        changed = robot.with_values(**{"stribeck-friction.ratio": ratio})
        return gtr.simulate(changed, LOOP, time=CLOCK).T_tip

    # What was set past `with_values` counts as soon as that, or an untraced call, sees it.
    past = eqx.tree_at(lambda r: r.terms["stribeck-friction"], robot, acting.terms["stribeck-friction"])
    assert past.acting == () and past.with_values(mu=past.value("mu")).acting == acting.acting
    np.testing.assert_array_equal(gtr.simulate(past, LOOP, time=CLOCK).T_tip, exact)
    # A term that may act, but is at its null, is no reason to refuse.
    null = robot.with_values(**{"stribeck-friction.ratio": 0.0})
    switch = jax.jit(lambda robot: gtr.release_switch(robot, 30.0).T_base)
    assert float(switch(null)) == pytest.approx(float(gtr.release_switch(robot, 30.0).T_base), rel=1e-9)
    ratio = acting.value("stribeck-friction.ratio")
    others = {n: v for n, v in typical(REGISTRY["stribeck-friction"]).items() if not n.endswith(".ratio")}
    np.testing.assert_allclose(jax.jit(set_inside)(robot.with_values(**others), ratio), exact, rtol=1e-9)


@pytest.mark.parametrize("folder", sorted(REFERENCE.iterdir()), ids=lambda p: p.name)
def test_the_independent_simulator(folder):
    c = compared(folder)
    assert c.converged
    # That simulator keeps the tension of a held stretch, though a creeping body bends it, and of points that
    # friction could hold, though they slip: docs/mechanics.md, and test_held.py and test_sliding.py for
    # the laws that take its place. They agree until the first release.
    first = {"viscoelastic-body": 63, "viscous-friction": 71}.get(folder.name)
    missed = np.mean(c.tension[:first] > c.allowed)
    assert missed <= (0.05 if folder.name == "stribeck-friction" else 0.0), c.tension.max()
    assert c.angle[:first].max() <= c.allowed_angle


def tips(robot, values, history=LOOP, time=CLOCK, atol=1e-12):
    run = gtr.simulate(robot.with_values(**values), history, time=time, solver=gtr.SolverOptions(atol=atol))
    assert bool(run.converged.all())
    return np.asarray(run.T_tip)


def test_presliding_over_no_length_is_coulomb(robot):
    coulomb, off = tips(robot, {}), []
    for length in (8e-4, 2e-4, 5e-5, 2e-5):
        found = tips(robot, {"presliding.length": length}, atol=1e-9)
        off.append(np.sqrt(np.mean((found - coulomb) ** 2)))
    assert all(b < 0.6 * a for a, b in itertools.pairwise(off)) and off[-1] < 0.06, off


@pytest.mark.parametrize("elements", [0.0, 1.0])
def test_presliding_is_exact_for_steps_of_any_size(robot, elements):
    values = {"presliding.length": 1e-3, "presliding.elements": elements}
    ends = [tips(robot, values, way(0, 24, steps=n), np.arange(n + 1.0))[-1] for n in (2, 12, 96)]
    np.testing.assert_allclose(ends, ends[-1], rtol=1e-8)


@pytest.mark.parametrize("elements", [0.0, 1.0])
def test_sharp_reversals_with_short_presliding_converge(robot, elements):
    history = np.array([0, 24, 3, 23, 4, 22, 22, 0.5, 24, 0, 24, 23.9, 24, 1, 12, 11, 13, 0])
    reach = float(np.ptp(gtr.simulate(robot, history).displacement))
    for share in (0.01, 0.03, 0.1, 0.5):
        run = gtr.simulate(
            robot.with_values(**{"presliding.length": share * reach, "presliding.elements": elements}),
            history,
        )
        assert bool(run.converged.all()), share
        assert float(run.T_tip.min()) >= 0.0


def test_what_does_not_converge_is_flagged(robot):
    run = gtr.simulate(robot.with_values(**{"presliding.length": 1e-7}), way(0, 24, 3, steps=3))
    missed, flagged = np.asarray(run.residual_norm) > 1e-9, ~np.asarray(run.converged)
    assert missed.any() and np.all(flagged[missed])
    # Friction follows the slip, so that what was missed is never known to be forgotten.
    np.testing.assert_array_equal(flagged, np.arange(len(missed)) >= np.argmax(missed))


def test_viscoelastic_limits(robot):
    def angle(values, time):
        run = gtr.simulate(robot.with_values(**values), LOOP, time=time)
        assert bool(run.converged.all())
        return np.asarray(run.tip_pose[:, 2])

    branch = {"viscoelastic-body.ratio": 0.3}
    soft = angle({}, CLOCK)
    np.testing.assert_allclose(angle(branch | {"viscoelastic-body.time": 1e-7}, CLOCK), soft, atol=1e-4)
    stiff = angle({"E": 1.3 * robot.value("E")}, CLOCK)
    np.testing.assert_allclose(angle(branch | {"viscoelastic-body.time": 1e9}, CLOCK), stiff, atol=1e-4)
    # All at rest: the branch has relaxed.
    eq = gtr.equilibrium(robot.with_values(**branch), 20.0)
    np.testing.assert_allclose(eq.tip_pose, gtr.equilibrium(robot, 20.0).tip_pose, atol=1e-7)


def test_creep_relaxes_as_the_branch_says(make_robot):
    """Without friction, base tension held: kappa = (1 - g/(1 + g) exp(-t/(tau (1 + g)))) T R/EI."""
    robot = make_robot(
        routing={"kind": "parallel", "offset": 0.006},
        backbone={"outer_radius": [0.01, 0.01], "youngs_modulus": 3e6},
        tendon={"friction_coefficient": 0.0},
    )
    g, tau = 0.25, 3.0
    time = np.concatenate([[0.0, 1e-6], np.linspace(0.0, 20.0, 200)[1:] + 1e-6])
    T_base = np.concatenate([[0.0], np.full(200, 2.0)])
    values = {"viscoelastic-body.ratio": g, "viscoelastic-body.time": tau}
    run = gtr.simulate(robot.with_values(**values), T_base, time=time)
    kappa = np.asarray(run.curvature[:, -1])
    relaxed = gtr.equilibrium(robot, 2.0).curvature[-1]
    # The arm is R(1 - R kappa)/nu = R where the channel is parallel: bending is linear.
    exact = float(relaxed) * (1 - g / (1 + g) * np.exp(-time[1:] / (tau * (1 + g))))
    np.testing.assert_allclose(kappa[1:], exact, rtol=2e-3)


def test_branches_of_several_times_relax_each_by_itself():
    """Bent at once and held: the moment is the sum of ratio/4 exp(-t/t_j), t_j ten to the spreads apart."""
    p = {"ratio": jnp.asarray(0.4), "time": jnp.asarray(3.0), "spread": jnp.asarray(0.7)}
    kept, before, t, found, wanted = jnp.zeros((5,)), 0.0, 0.0, [], []
    times = 3.0 * 10.0 ** (0.7 * np.array([-1.5, -0.5, 0.5, 1.5]))
    for dt in (1e-9, 0.1, 0.5, 2.0, 10.0, 60.0):
        q, kept = viscoelastic_body.bend(p, jnp.asarray(1.5), Bent(0.0, before, kept, jnp.asarray(dt)))
        before, t = 1.5, t + (dt if dt > 1e-6 else 0.0)
        found.append(float(q))
        wanted.append(1.5 * 0.1 * np.sum(np.exp(-t / times)))
        assert float(kept[0]) == pytest.approx(float(q), rel=1e-12)
    np.testing.assert_allclose(found, wanted, rtol=1e-7)


@pytest.mark.parametrize("exponent", [0.4, 1.0, 1.7])
def test_viscous_friction_follows_a_power_of_the_speed(exponent):
    p = {"coefficient": jnp.asarray(20.0), "exponent": jnp.asarray(exponent)}
    speed = np.array([2e-3, 1e-2, 5e-2])
    found = np.asarray(viscous_friction.by_speed(p, jnp.asarray(speed)))
    np.testing.assert_allclose(found, 20.0 * 0.01 * (speed / 0.01) ** exponent, rtol=0.01)
    np.testing.assert_allclose(viscous_friction.by_speed(p, jnp.asarray(-speed)), -found)
    slow = np.asarray(viscous_friction.by_speed(p, jnp.linspace(0.0, 1e-3, 50)))
    assert np.all(np.diff(slow) > 0)


def test_adhesion_never_pulls_the_tendon_below_nothing(robot):
    run = gtr.simulate(robot.with_values(**{"adhesion.drag": 8.0}), way(0, 0.5, 0, 6, 0, 0.2))
    assert bool(run.converged.all())
    assert float(run.tension.min()) == 0.0


def test_a_stop_that_is_not_touched_changes_nothing(robot):
    free = gtr.simulate(robot, LOOP, time=CLOCK)
    reach = float(jnp.max(free.tip_pose[:, 1]))
    stop = {"contact.stiffness": 1e4, "contact.distance": reach + 1e-3}
    np.testing.assert_allclose(tips(robot, stop), free.T_tip, atol=1e-9)
    stop["contact.distance"] = 0.5 * reach
    run = gtr.simulate(robot.with_values(**stop), LOOP, time=CLOCK)
    assert bool(run.converged.all())
    assert 0.5 * reach < float(jnp.max(run.tip_pose[:, 1])) < 0.6 * reach


def test_stretch_is_what_a_spring_gives(make_robot):
    """A rigid sheath: the tendon is drawn out by the integral of T/EA, and by what its anchor gives way."""
    robot = make_robot(
        backbone={"rigid": True, "natural_curvature": 5.0, "youngs_modulus": 0.0},
        routing={"kind": "parallel", "offset": 0.0},
    )
    values = {"tendon-stretch.compliance": 1e-4, "tendon-stretch.anchor": 1e-5}
    run = gtr.simulate(robot.with_values(**values), [0.0, 10.0])
    length, mu = float(robot.backbone.length), float(robot.value("mu"))
    wrap = 5.0 * length
    stretch = 1e-4 * 10 * length * (1 - np.exp(-mu * wrap)) / (mu * wrap)
    assert float(run.displacement[-1]) == pytest.approx(stretch + 1e-5 * float(run.T_tip[-1]), rel=1e-5)
    assert float(run.T_tip[-1]) == pytest.approx(10 * np.exp(-mu * wrap), rel=1e-9)


def test_slip_and_its_speed(robot):
    run = gtr.simulate(robot, LOOP, time=CLOCK)
    np.testing.assert_allclose(run.slip[:, 0], run.displacement, atol=1e-15)
    np.testing.assert_allclose(run.slip[:, -1], 0.0, atol=1e-12)
    moved = np.diff(np.asarray(run.slip[:, 0])) / np.diff(CLOCK)
    np.testing.assert_allclose(run.slip_speed[1:, 0], moved, atol=1e-12)


@pytest.mark.parametrize("kind", ["free", "loaded", "two tendons"])
@pytest.mark.slow
def test_any_three_terms_together(make_robot, kind):
    rng = np.random.default_rng(11)
    if kind == "two tendons":
        robot = gtr.load_robot(Path(__file__).parents[2] / "examples" / "antagonists.toml")
        history = np.stack([way(0, 9, 3, 8, 1), way(2, 2, 5, 1, 4)], axis=1)
    else:
        robot = make_robot(routing=SINE, loads=LOADS if kind == "loaded" else {})
        history = way(0, 24, 9, 18, 2)
    clock = 0.7 * np.arange(len(history))
    run = jax.jit(lambda robot: gtr.simulate(robot, history, time=clock, with_terms=True))
    failed = []
    for _ in range(25):
        chosen = rng.choice(len(MECHANICAL), 3, replace=False)
        values = {}
        for i in chosen:
            values |= typical(MECHANICAL[i])
        if "superelastic.strain" in values:
            values["superelastic.strain"] = 0.1  # these bodies are of rubber, strained so far, not of metal
        done = run(robot.with_values(**values))
        assert float(jnp.min(done.tension)) >= 0.0
        if not bool(done.converged.all()):
            failed.append([MECHANICAL[i].id for i in chosen])
    assert not failed, failed


def test_terms_are_documented():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    for term in REGISTRY.values():
        assert f"({term.id}.md)" in index
        assert (DOCS / f"{term.id}.md").read_text(encoding="utf-8") == page(term, heading=1)
        assert (DOCS / f"{term.id}.png").exists()
        assert term.says.endswith(".") and term.law and term.seen and term.told_apart
        for q in term.quantities:
            assert q.usual[0] < q.usual[1] and (q.name in description(term))


def test_files_hold_any_term(make_robot, tmp_path):
    text = (Path(__file__).parents[2] / "examples" / "tdcm-1.toml").read_text()
    for term in REGISTRY.values():
        table = description(term).split("in a robot file:\n\n")[1]
        file = tmp_path / f"{term.id}.toml"
        file.write_text(text + "\n" + table + "\n")
        config = gtr.load_config(file)
        written = tmp_path / "written.toml"
        gtr.dump_config(config, written)
        assert gtr.load_config(written) == config
        robot = gtr.load_robot(file)
        for q in term.quantities:
            assert float(robot.value(f"{term.id}.{q.name}")) == pytest.approx(float(q.typical))
    assert json.loads(json.dumps(null_values()))["presliding"]["length"] == 0.0


def test_a_simulation_is_told_with_terms(robot):
    from gtr_jax.report.simulation import verdict
    from gtr_jax.report.simulation_answer import answer_simulation

    loop = way(0, 24, 2, steps=30)
    answer = answer_simulation(robot.with_values(**{"presliding.length": 4e-4}), loop)
    assert answer.converged and "N reach the tip (" in verdict(answer)
    # Presliding takes its slip, then the phases are those of Coulomb friction.
    phases = answer.phases.tolist()
    assert phases[25] == "pulling" and phases[32] == "transition" and phases[-1] == "releasing"


@pytest.mark.slow
def test_preload_strings_without_friction(make_robot):
    robot = make_robot(routing=SINE, tendon={"friction_coefficient": 0.3, "preload": 5.0})
    for values in ({"presliding.length": 6e-4}, {"adhesion.drag": 1e-9}, {"local-friction.base": 1e-9}):
        case = robot.with_values(**values)
        assert float(gtr.simulate(case, [5.0, 6.0]).T_tip[0]) == pytest.approx(5.0, abs=1e-6)
        assert float(gtr.equilibrium(case, 5.0).T_tip) == pytest.approx(5.0, abs=1e-6)
    plain, null = (gtr.simulate(robot, LOOP + 5.0, with_terms=w) for w in (False, True))
    np.testing.assert_allclose(null.displacement, plain.displacement, atol=1e-9)


def test_friction_never_pushes(robot):
    run = gtr.simulate(robot.with_values(**{"friction-drift.rate": -0.01}), LOOP, time=1e3 * CLOCK)
    late = np.arange(len(LOOP)) > 1
    np.testing.assert_allclose(run.T_tip[late], LOOP[late], rtol=1e-9)


def test_a_tension_that_is_no_number_is_flagged(robot):
    T_base = np.array(LOOP)
    T_base[20] = np.nan
    run = gtr.simulate(robot.with_values(**{"stiffening.coefficient": 0.01}), T_base)
    assert np.flatnonzero(~np.asarray(run.converged)).tolist() == [20]
    assert float(run.T_tip[21]) > 1.0


def test_terms_that_cannot_act_are_refused(make_robot):
    sheath = {"rigid": True, "natural_curvature": 4.0}
    for terms, says in (
        ([{"kind": "presliding", "length": 6e-4}], "presliding: .* add the term tendon-stretch"),
        ([{"kind": "viscous-friction", "coefficient": 20.0}], "viscous-friction: .* add the term tendon-str"),
        ([{"kind": "stiffening", "coefficient": 0.01}], "no effect on a backbone with rigid"),
    ):
        with pytest.raises(gtr.InputError, match=says):
            make_robot(routing=SINE, backbone=sheath, terms=terms)
    for term, says in (
        ({"kind": "local-friction", "factor": 4.0}, "must bound a stretch"),
        ({"kind": "saturation"}, "give one of tip, base"),
        ({"kind": "cell-hysteresis", "tip": 3.0}, "width must exceed"),
        ({"kind": "cell-hysteresis", "tip": 1.6, "spread": 0.3}, "the more the larger the spread"),
        ({"kind": "cell-hysteresis", "tip": 0.1, "width": 0.0}, "width"),
        ({"kind": "cell-hysteresis", "tip": 0.1, "spread": 300.0}, "spread"),
        ({"kind": "saturation", "tip": 3.0, "knee": 7.0}, "knee must be at most twice the lower limit"),
        ({"kind": ["wear"]}, "unknown kind"),
        ({"kind": "presliding", "length": -1.0}, "at least 0"),
    ):
        with pytest.raises(gtr.InputError, match=says):
            make_robot(routing=SINE, terms=[term])
    rigid = make_robot(routing=SINE, backbone=sheath)
    slow = np.arange(float(len(LOOP)))
    for name, value in (("presliding.length", 6e-4), ("viscous-friction.coefficient", 20.0)):
        unable = rigid.with_values(**{name: value})
        with pytest.raises(gtr.InputError, match=f"terms.{name.partition('.')[0]}: {NO_SLIP}"):
            gtr.simulate(unable, LOOP, time=slow)
        # The null of its size does nothing, and a tendon that stretches slips.
        assert unmoved_in(rigid.with_values(**{name: 0.0})) == []
        assert unmoved_in(unable.with_values(**{"tendon-stretch.compliance": 1e-4})) == []
        # A fit of it is refused in the same words, free or not.
        seen = gtr.Recording(T_base=LOOP, T_tip=LOOP, time=slow, path=Path("rec.csv"), sha256="")
        for robot, free in ((unable, "mu"), (rigid, ("mu", name))):
            with pytest.raises(gtr.InputError, match=f"terms.{name.partition('.')[0]}: {NO_SLIP}"):
                calibrate.fit(robot, seen, free=free)
    # Friction at rest is more than that of a fast slip.
    assert unmoved_in(rigid.with_values(**{"stribeck-friction.ratio": 0.2})) == []
    run = gtr.simulate(rigid.with_values(**{"adhesion.drag": 1.0}), LOOP)
    assert set(gtr.label_phases(run).tolist()) >= {"pulling", "releasing"}
    with pytest.raises(ValueError, match="goes back at step 3"):
        gtr.simulate(rigid, [1.0, 2.0, 3.0], time=[0.0, 1.0, 0.5])
    with pytest.raises(ValueError, match="zero-drift depends on it"):
        gtr.true_base(rigid.with_values(**{"zero-drift.base": 0.1}), np.array([1.0, 2.0]))


def test_times_are_asked_for(robot):
    creeping = robot.with_values(**{"viscous-friction.coefficient": 10.0})
    with pytest.raises(ValueError, match="viscous-friction depends on it; give the time"):
        gtr.simulate(creeping, LOOP)
    with pytest.raises(ValueError, match="time: one value for each of the"):
        gtr.simulate(creeping, LOOP, time=CLOCK[:-1])
    with pytest.raises(ValueError, match="without physics terms"):
        gtr.release_switch(creeping, 20.0)


SHORT = way(0, 24, 9, 18, 18, 2, steps=7)
TICKS = 0.7 * np.arange(len(SHORT))
BASE_CELL = ("base-gain.gain", "base-offset.force")


@pytest.fixture(scope="module")
def mixture():
    """A robot, a fixed mixture of what is shown along a history, and its gradient by all terms' numbers."""
    robot = gtr.load_robot(Path(__file__).parents[2] / "examples" / "tdcm-1.toml")
    mix = np.random.default_rng(3).normal(size=(len(SHORT), 5)) * np.array([1.0, 30.0, 30.0, 5.0, 300.0])

    def total(values):
        case = robot.with_values(**values)
        run = gtr.simulate(case, SHORT, time=TICKS, with_terms=True, solver=gtr.SolverOptions(atol=1e-12))
        shown = gtr.reading(case, run)
        columns = [shown.T_tip[:, None], run.tip_pose, run.displacement[:, None]]
        return jnp.sum(jnp.asarray(mix) * jnp.concatenate(columns, axis=1)), jnp.all(run.converged)

    return robot, jax.jit(total), jax.jit(jax.value_and_grad(total, has_aux=True))


def difference(total, values, name, scale, one_sided, step=2e-6):
    """Of the mixture by one number, of second order in the step or better."""

    def at(h):
        value, converged = total(values | {name: values[name] + h * scale})
        assert bool(converged), name
        return float(value)

    if one_sided:
        return (-3 * at(0) + 4 * at(step) - at(2 * step)) / (2 * step * scale)
    near, far = ((at(k * step) - at(-k * step)) / (2 * k * step * scale) for k in (1, 2))
    return (4 * near - far) / 3


# No derivative at null: presliding acts as the root of its length, a delay moves samples across corners, an
# end that is let go slips in another direction than one that is pulled, a stop without stiffness is not known
# to be touched, and limits and rounding have steps.
KINKED = {
    "presliding.length",
    "time-skew.delay",
    "time-skew.rate",
    "tip-moved.tension",
    "contact.stiffness",
    "saturation.tip",
    "quantisation.tip",
}
# What creeps: a stretch that stops loses what its speed gave it, however little. The base model cannot,
# so the slope is asked for just beyond null.
CREEPING = {"viscous-friction.coefficient", "stribeck-friction.ratio", "viscoelastic-body.ratio"}
# Friction that falls lets go what is locked, friction that rises moves nothing: two slopes meet at null, and
# the gradient there is that of rising friction.
LOOSENING = {"friction-drift.rate", "wear.rate"}


def numbers(robot):
    """All numbers of terms that change what is shown, at null, with the size of a change."""
    of = {
        f"{t.id}.{q.name}": q for t in REGISTRY.values() if t.true_base is None or t.tip for q in t.quantities
    }
    values = {name: float(q.null) for name, q in of.items()}
    scales = {name: abs(float(q.typical)) or 0.1 for name, q in of.items()}
    bounded = {n: q.lower is not None and float(q.null) <= q.lower for n, q in of.items()}
    for name in ("mu", "E", "r1"):
        values[name] = float(robot.value(name))
        scales[name], bounded[name] = abs(values[name]), False
    return values, scales, bounded


@pytest.mark.slow
def test_gradients_at_null(mixture):
    robot, total, with_gradient = mixture
    values, scales, bounded = numbers(robot)
    (_, converged), gradient = with_gradient(values)
    assert bool(converged)
    for name, slope in gradient.items():
        if name not in KINKED | CREEPING:
            rising = bounded[name] or name in LOOSENING
            exact = difference(total, values, name, scales[name], rising, 1e-5)
            assert float(slope) * scales[name] == pytest.approx(exact * scales[name], rel=2e-4, abs=5e-4), (
                name
            )


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CREEPING))
def test_gradients_just_beyond_null(mixture, name):
    robot, total, with_gradient = mixture
    values, scales, _ = numbers(robot)
    values |= {name: 0.01 * scales[name]}
    (_, converged), gradient = with_gradient(values)
    assert bool(converged)
    exact = difference(total, values, name, scales[name], False, 2e-3)
    assert float(gradient[name]) * scales[name] == pytest.approx(exact * scales[name], rel=0.02, abs=5e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LOOSENING))
def test_gradients_where_friction_falls(mixture, name):
    robot, total, with_gradient = mixture
    values, scales, _ = numbers(robot)
    (_, _), rising = with_gradient(values)
    values |= {name: -0.5 * scales[name]}
    (_, converged), gradient = with_gradient(values)
    assert bool(converged)
    exact = difference(total, values, name, scales[name], False, 1e-5) * scales[name]
    assert float(gradient[name]) * scales[name] == pytest.approx(exact, rel=2e-4, abs=5e-4)
    assert abs(exact - float(rising[name]) * scales[name]) > 5e-3


@pytest.mark.slow
@pytest.mark.parametrize("term", MECHANICAL, ids=lambda t: t.id)
def test_gradients_at_typical_values(mixture, term):
    robot, total, with_gradient = mixture
    values, scales, bounded = numbers(robot)
    values |= typical(term)
    if term.id == "contact":
        # From 0.010 to 0.016 m the step that leaves the stop has two roots, some 0.5 N apart, and rounding
        # decides which is found.
        values["contact.distance"] = 0.018
    (_, converged), gradient = with_gradient(values)
    assert bool(converged)
    own = [f"{term.id}.{q.name}" for q in term.quantities]
    for name in [*own, "mu", "E", "r1", "adhesion.drag"]:
        one_sided = bounded[name] and values[name] == 0.0
        exact = difference(total, values, name, scales[name], one_sided, 1e-5)
        assert float(gradient[name]) * scales[name] == pytest.approx(
            exact * scales[name], rel=2e-4, abs=5e-4
        ), name


def cells(robot, values, time=CLOCK, run=None):
    case = robot.with_values(**values)
    return gtr.reading(case, run or gtr.simulate(case, LOOP, time=time))


BASE = [t for t in REGISTRY.values() if t.true_base]


@pytest.mark.parametrize("chosen", [[t] for t in BASE] + [BASE], ids=lambda c: "+".join(t.id for t in c))
def test_the_base_cell_is_read_backwards(robot, chosen):
    values = {}
    for term in chosen:
        values |= {name: v for name, v in typical(term).items() if not name.endswith(".tip")}
    case = robot.with_values(**values)
    shown = gtr.reading(case, gtr.simulate(case, LOOP, time=CLOCK)).T_base
    assert float(np.max(np.abs(shown - LOOP))) > 1e-3
    np.testing.assert_allclose(gtr.true_base(case, shown, CLOCK), LOOP, atol=1e-9)


@pytest.mark.parametrize(
    "values",
    [
        {"cell-hysteresis.base": 0.4, "cell-hysteresis.width": 1.5, "cell-hysteresis.spread": 0.3},
        {"low-pass.base": 0.5, "low-pass.second": 0.8},
    ],
    ids=lambda values: next(iter(values)).partition(".")[0],
)
def test_cells_of_more_than_one_element_are_read_backwards(robot, values):
    case, plain = (robot.with_values(**v) for v in (values, dict(list(values.items())[:-1])))
    run = gtr.simulate(case, LOOP, time=CLOCK)
    shown, otherwise = (gtr.reading(c, run).T_base for c in (case, plain))
    assert float(np.max(np.abs(shown - otherwise))) > 0.02
    np.testing.assert_allclose(gtr.true_base(case, shown, CLOCK), LOOP, atol=1e-9)


def test_two_lags_in_series():
    # A ramp through two equal lags: y = r (t - 2 tau) + r (t + 2 tau) exp(-t/tau).
    clock, lag, slope = np.linspace(0.0, 3.0, 3001), 0.4, 2.0
    wanted = slope * (clock - 2 * lag) + slope * (clock + 2 * lag) * np.exp(-clock / lag)
    found = low_pass.shown_by(*map(jnp.asarray, (lag, 1.0, slope * clock, clock)))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


def test_a_saturated_cell_bends_over_within_its_knee():
    limit, knee = 8.0, 2.0
    T = np.array([6.9, 7.0, 7.5, 8.0, 8.5, 9.0, 9.1])
    found = saturation.cut(jnp.asarray(limit), jnp.asarray(knee), jnp.asarray(T))
    np.testing.assert_allclose(found, [6.9, 7.0, 7.4375, 7.75, 7.9375, 8.0, 8.0])
    # Continuous, with its slope, where the knee begins and ends.
    slope = jax.vmap(jax.grad(lambda T: saturation.cut(limit, knee, T)))
    slopes = slope(jnp.array([7 - 1e-9, 7 + 1e-9, 9.0]))
    np.testing.assert_allclose(slopes, [1.0, 1.0, 0.0], atol=1e-8)


def test_elements_of_a_hysteretic_cell_give_way_one_after_the_other():
    force, width, spread = 0.8, 2.0, 0.2
    over = 2.0 * 10.0 ** (0.2 * np.array([-1.5, -0.5, 0.5, 1.5]))
    T = np.linspace(0.0, 5.0, 11)
    wanted = T - force * np.mean(np.minimum(T[:, None] / over, 1.0), axis=1)
    found = cell_hysteresis.lagging(*map(jnp.asarray, (force, width, spread, T)))
    np.testing.assert_allclose(found, wanted, rtol=1e-12)
    # Turning back, each element takes twice its width.
    back = 5.0 - T
    found = cell_hysteresis.lagging(*map(jnp.asarray, (force, width, spread, np.concatenate([T, back]))))
    wanted = back - force * (1 - 2 * np.mean(np.minimum(T[:, None] / (2 * over), 1.0), axis=1))
    np.testing.assert_allclose(found[11:], wanted, rtol=1e-12)
    one = cell_hysteresis.lagging(*map(jnp.asarray, (force, width, 0.0, T)))
    np.testing.assert_allclose(one, T - force * np.minimum(T / width, 1.0), rtol=1e-12)


def test_what_the_tips_cell_shows(robot):
    run = gtr.simulate(robot, LOOP, time=CLOCK)
    T = np.asarray(run.T_tip)

    def shown(**values):
        named = {k.replace("__", ".").replace("_", "-"): v for k, v in values.items()}
        return np.asarray(cells(robot, named, run=run).T_tip)

    np.testing.assert_allclose(shown(tip_gain__gain=1.1, tip_offset__force=0.2), 1.1 * T + 0.2)
    np.testing.assert_allclose(shown(crosstalk__share=0.1), T + 0.1 * LOOP)
    np.testing.assert_allclose(shown(zero_drift__tip=0.01), T + 0.01 * CLOCK)
    np.testing.assert_allclose(shown(saturation__tip=8.0), np.minimum(T, 8.0))
    np.testing.assert_allclose(shown(quantisation__tip=0.5), 0.5 * np.round(T / 0.5))
    np.testing.assert_allclose(shown(time_skew__delay=0.7)[1:], T[:-1], atol=1e-12)
    held = T - shown(cell_hysteresis__tip=0.3, cell_hysteresis__width=1.0)
    assert np.max(np.abs(held)) == pytest.approx(0.3) and held[5] > 0 > held[-14]
    # A ramp: y = r (t - tau) + r tau e^(-t/tau).
    lag, slope = 1.3, (T[1] - T[0]) / 0.7
    np.testing.assert_allclose(
        shown(low_pass__tip=lag)[1], slope * (0.7 - lag + lag * np.exp(-0.7 / lag)), rtol=1e-12
    )
    # In their order: gain before offset, both before saturation, the last of all quantisation.
    all_of = shown(tip_gain__gain=1.1, tip_offset__force=0.2, saturation__tip=8.1, quantisation__tip=0.5)
    np.testing.assert_allclose(all_of, 0.5 * np.round(np.minimum(1.1 * T + 0.2, 8.1) / 0.5))


@pytest.mark.slow
def test_gradients_of_cells_in_action(mixture):
    robot, total, with_gradient = mixture
    values, scales, _ = numbers(robot)
    for term in REGISTRY.values():
        if term.tip and term.id not in ("saturation", "quantisation"):
            values |= {name: v for name, v in typical(term).items() if not name.endswith(".base")}
    values["time-skew.delay"] = 0.31
    (_, converged), gradient = with_gradient(values)
    assert bool(converged)
    for name in values:
        kind = name.partition(".")[0]
        if kind in REGISTRY and REGISTRY[kind].tip and kind not in ("saturation", "quantisation"):
            if not name.endswith(".base"):
                exact = difference(total, values, name, scales[name], False, 1e-5)
                assert float(gradient[name]) * scales[name] == pytest.approx(
                    exact * scales[name], rel=2e-4, abs=5e-4
                ), name
