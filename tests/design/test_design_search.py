"""`design.optimise`: targets reached, limits kept, gradients, what cannot be reached said so."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import design
import gtr_jax as gtr
from design import gauss_newton, lagrangian, literal
from design.distinct import distinct_options
from design.least_loss import with_less_loss
from design.objective import evaluate
from design.option import look_at, off_by
from design.problem import problem_of
from design.search import ARRIVED, find, losses
from design.space import on_common_mesh
from gtr_jax.units import quantity_text
from tests.conftest import CROSS, PARALLEL, SINE, WAVE

LIMITS = {"wall_clearance": "1.5 mm", "min_channel_radius": "10 mm", "max_tension_loss": 0.8}
SPLINE = {"kind": "spline", "knots": 5}
BOUNDS = {"T_base": ["10 N", "50 N"], "E": ["0.8 MPa", "2 MPa"]}
TOP = {"T_base_max": "30 N"}
TIGHT = gtr.SolverOptions(atol=1e-13)


def target(pose=None, **sections):
    data = {"schema": 1, "limits": LIMITS, **sections}
    return design.parse_target(data | ({"pose": [pose]} if pose else {}))


def pose_of(robot, T_base=25.0, after=None):
    before = None if after is None else gtr.equilibrium(robot, after)
    x, y, angle = map(float, gtr.equilibrium(robot, T_base, memory=before).tip_pose)
    return {"T_base": T_base, "tip": [x, y], "angle": angle}


CASES = {
    "sine": (SINE, {}, {}),
    "wave": (WAVE, {"search": {"n_sine": [6]}}, {}),
    "cross": (CROSS, {}, {}),
    "spline": (SINE, {"search": SPLINE}, {}),
    "releasing": (SINE, TOP, {"branch": "releasing", "T_base": 12.0}),
    "tension": (SINE, {"search": {"free": ["T_base", "E"], "bounds": BOUNDS}}, {}),
}


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=[pytest.mark.slow] if c in ("wave", "cross") else []) for c in CASES]
)
def test_derivatives_of_residuals_and_margins(case, make_config):
    """Every coordinate of every family, knots, tension and modulus included, against central differences."""
    routing, sections, load = CASES[case]
    pose = {"T_base": 25.0, "tip": [0.2, 0.05], "angle": 0.4, **load}
    problem = problem_of(make_config(routing=routing), target(pose, **sections))
    objective = problem.objective
    z = jnp.asarray(np.random.default_rng(3).uniform(0.45, 0.6, objective.lower.shape[0]))
    if case in ("sine", "releasing"):
        z = z.at[2].set(0.2).at[3].set(0.7)

    @jax.jit
    def values(z):
        e = evaluate(objective, z)
        return jnp.concatenate([e.residuals, e.margins[:3], e.T_tip])

    found = np.asarray(jax.jacfwd(values)(z))
    h = 1e-5
    for i in range(len(z)):
        near, far = ((values(z.at[i].add(k * h)) - values(z.at[i].add(-k * h))) / (2 * k * h) for k in (1, 2))
        difference = np.asarray(4 * near - far) / 3
        scale = np.max(np.abs(difference))
        np.testing.assert_allclose(found[:, i], difference, rtol=2e-5, atol=2e-6 * scale)


@pytest.mark.parametrize(
    "case",
    [
        "sine",
        pytest.param("spline", marks=pytest.mark.slow),
        pytest.param("releasing", marks=pytest.mark.slow),
    ],
)
def test_a_hidden_routing_s_pose_is_reached_within_the_limits(case, make_config):
    routing, sections, load = CASES[case]
    hidden = {**SINE, "r1": -0.0085, "r2": 0.0096, "w1": 0.05, "w2": 0.17}
    robot = gtr.build_robot(make_config(routing=hidden))
    after = 30.0 if load else None
    pose = pose_of(robot, load.get("T_base", 25.0), after) | load
    problem = problem_of(make_config(routing=routing), target(pose, **sections))
    found = find(problem)
    good = np.flatnonzero(found.kept & (found.cost < 0.125))
    assert len(good) >= 2
    values = problem.space.lower + found.z[good[0]] * (problem.space.upper - problem.space.lower)
    option = look_at(problem, values, resolution=4.0)
    assert option.reached and option.kept
    assert option.errors[0].distance < 1e-3 * 0.25 and abs(option.errors[0].turn) < 1e-3


CATHETER = {
    "length": 0.08,
    "outer_radius": [1.6e-3, 1.3e-3],
    "bores": [{"from": 0.0, "to": 0.08, "diameter": 0.8e-3}],
    "youngs_modulus": 20e6,
}
LUMEN = {"kind": "straight-sine-straight", "r1": -0.8e-3, "r2": 0.8e-3, "w1": 0.02, "w2": 0.05}


@pytest.mark.slow
def test_the_least_loss_is_that_of_a_scan(make_config):
    """Of the family of designs that bend the tip to one angle: r1 scanned, r2 solved for each."""
    config = make_config(routing=SINE)
    wanted = {"T_base": 25.0, "angle": 0.3}
    problem = problem_of(config, target(wanted, search={"routing": ["r1", "r2"], "starts": 4}))
    found = with_less_loss(problem, find(problem))
    lost = losses(problem.objective, found)[found.kept & (found.cost < ARRIVED)]
    space = problem.space
    least = 1.0
    for r1 in np.linspace(-0.018, 0.018, 73):
        z = np.stack(
            [np.full(161, (r1 - space.lower[0]) / (space.upper - space.lower)[0]), np.linspace(0, 1, 161)]
        )
        judged = gauss_newton.judge_all(problem.objective, jnp.asarray(z.T))
        kept = np.min(np.asarray(judged.margins), axis=1) >= gauss_newton.BACK_OFF
        off, loss = np.asarray(judged.residuals)[:, 2], 1.0 - np.asarray(judged.T_tip)[:, 0] / 25.0
        for i in np.flatnonzero((off[1:] * off[:-1] <= 0) & kept[1:] & kept[:-1]):
            share = off[i] / (off[i] - off[i + 1])
            least = min(least, float(loss[i] + share * (loss[i + 1] - loss[i])))
    assert least < 1.0
    assert np.min(lost) == pytest.approx(least, rel=0.01)


@pytest.mark.slow
def test_the_design_that_loses_least_is_chosen_with_a_free_tension(make_config):
    """A share of the tension that the design itself has; only valid, distinct designs are listed."""
    config = make_config(routing=LUMEN, backbone=CATHETER, tendon={"friction_coefficient": 0.12})
    limits = {"wall_clearance": 1.5e-4, "bore_clearance": 1e-4, "channel_diameter": 3e-4}
    search = {"free": ["T_base"], "bounds": {"T_base": ["1 N", "10 N"]}}
    pose = {"T_base": "4 N", "tip": ["60 mm", "42 mm"], "tip_tolerance": "0.5 mm"}
    problem = problem_of(config, target(pose, search=search, limits=limits))
    found = find(problem)
    options = distinct_options(problem, found)
    assert len(options) > 1
    for option in options:
        assert option.reached and option.kept and option.loss >= options[0].loss
        assert option.loss == pytest.approx(1.0 - float(option.states.T_tip[0]) / option.values["T_base"])
    places = [np.array([o.values[v.name] for v in problem.space.all]) for o in options]
    span = problem.space.upper - problem.space.lower
    for i, place in enumerate(places):
        assert all(np.max(np.abs(place - other) / span) > 0.019 for other in places[:i])
    for z in found.z:  # no lane, whatever it was taken for, is a valid design that loses less
        try:
            other = look_at(problem, problem.space.values_at(z), resolution=4.0)
        except gtr.InputError:
            continue
        assert not (other.reached and other.kept) or other.loss > options[0].loss - 1e-4


def test_starts_near_the_targets_are_finished():
    """Points on the way to a design are none: on the example all that arrive stop by themselves."""
    problem = problem_of(
        gtr.load_config("examples/tdcm-1.toml"), design.load_target("examples/tdcm-1-target.toml")
    )
    found = find(problem)
    near = found.cost < 0.5
    assert np.sum(near) >= 2
    assert np.all(found.settled[near]) and np.all(found.cost[near] < 1e-4)


@pytest.fixture(scope="module")
def answer():
    """A design of TD-CM I with all that goes with it."""
    robot = gtr.load_config("examples/tdcm-1.toml").with_values({"youngs_modulus": "1.06 MPa"})
    data = robot.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["uncertainty"] = {"friction_coefficient": 0.1, "youngs_modulus": 0.05}
    robot = type(robot).model_validate(data)
    wanted = design.load_target("examples/tdcm-1-target.toml")
    return design.optimise(robot, wanted)


def test_answer_of_an_example(answer):
    assert answer.verdict == "reached"
    assert answer.best.reached and answer.best.kept
    assert all(option.reached and option.kept for option in answer.options)
    assert answer.best.loss == min(option.loss for option in answer.options)
    assert answer.best.loss < 0.485  # a plain search ends at 0.579
    others = len(answer.options) - 1
    assert (f"{others} other design" in answer.says) == (others > 0)
    v = answer.verification
    assert v.fine_moved[0] < 1e-5 and v.steps_moved[0] < 1e-8
    assert v.literal_moved[0] < 5e-5 and v.literal_moved[1] < 3e-4
    data = answer.to_json()
    json.dumps(data, allow_nan=False)
    assert {m["name"] for m in data["limits"]} >= {"wall_clearance", "bore_clearance", "max_tension_loss"}
    assert all(m["margin"] >= 0 for m in data["limits"])
    table = answer.to_pandas()
    assert len(table) == len(answer.options) and table["reached"].all() and table["limits_kept"].all()
    assert table.loc[0, "r1_m"] == answer.best.values["r1"]
    assert table.loc[0, "T_base_N"] == answer.best.tensions[0]
    assert table["tension_loss"].tolist() == [option.loss for option in answer.options]


def test_a_designed_robot_is_written_in_numbers_for_people(answer):
    """Rounded before anything is judged, so that the file is the design that was judged."""
    routing = answer.config.model_dump(context={"unit_strings": True})["routing"]
    assert max(len(str(routing[name])) for name in ("r1", "r2", "w1", "w2")) <= len("-12.34567 mm")
    assert all(answer.best.values[name] == getattr(answer.config.routing, name) for name in ("r1", "w2"))


def test_numbers_of_a_space_are_rounded_in_the_units_of_the_files(make_config):
    """To a millionth of what is searched, and so that the file reads back to the equal float."""
    bounds = {"E": ["0.8 MPa", "2 MPa"], "T_base": ["5 N", "50 N"]}
    search = {"free": ["E", "T_base", "natural_curvature"], "bounds": bounds | {"natural_curvature": [-1, 1]}}
    space = problem_of(make_config(routing=SINE), target({"T_base": 20.0, "angle": 0.3}, search=search)).space
    rng = np.random.default_rng(1)
    for _ in range(50):
        values = space.lower + rng.uniform(size=len(space.all)) * (space.upper - space.lower)
        short = space.rounded(values)
        assert np.all(np.abs(short - values) <= 1e-6 * (space.upper - space.lower))
        assert all(len(str(quantity_text(x, v.unit))) <= 15 for x, v in zip(short, space.all, strict=True))
    np.testing.assert_array_equal(space.rounded(space.upper), space.upper)


@pytest.mark.parametrize(
    ("off", "says"),
    [(1e-9, "less than 0.0025 mm"), (0.0123456e-3, "0.012 mm"), (12.3456e-3, "12.3 mm"), (np.nan, "–")],
)
def test_an_error_has_two_digits_and_none_below_its_tolerance(off, says):
    assert off_by(off, 0.25e-3, "m") == says


def test_tolerances_are_those_of_differences(answer):
    """The table's derivatives against the tip of the designed robot with one dimension changed."""
    for row in answer.tolerances:
        name = row.parameter.name
        if name not in ("r1", "w2", "E", "outer_radius_tip", "mu"):
            continue
        robot = on_common_mesh(answer.problem.space, answer.config, 1.0)  # as the table: kinks of the wrap
        h = 1e-5 * abs(row.value)  # leave a mesh 3e-4 of a slope
        ends = [
            np.asarray(
                gtr.equilibrium(robot.with_values(**{name: row.value + d}), 45.0, solver=TIGHT).tip_pose
            )
            for d in (h, -h)
        ]
        slope = (ends[0] - ends[1]) / (2 * h)
        assert row.moves == pytest.approx(np.hypot(slope[0], slope[1]), rel=1e-4)
        assert row.turns == pytest.approx(abs(slope[2]), rel=1e-4)


def test_spread_is_that_of_draws(answer):
    """Root mean square error over friction and modulus, against a thousand random robots."""
    rng = np.random.default_rng(0)
    robot = gtr.build_robot(answer.config)
    draws = rng.normal(size=(1000, 2)) * [0.1, 0.05]

    @jax.jit
    def tips(draws):
        def one(d):
            changed = robot.with_values(mu=robot.value("mu") * (1 + d[0]), E=robot.value("E") * (1 + d[1]))
            return gtr.equilibrium(changed, 45.0, with_terms=False).tip_pose

        return jax.lax.map(one, draws)

    wanted = answer.problem.target.pose[0]
    gap = np.asarray(tips(jnp.asarray(draws))) - np.array([*wanted.tip, wanted.angle])
    spread = answer.robustness.spreads[0]
    assert spread.rms == pytest.approx(np.sqrt(np.mean(gap[:, 0] ** 2 + gap[:, 1] ** 2)), rel=0.08)
    assert spread.rms_turn == pytest.approx(np.sqrt(np.mean(gap[:, 2] ** 2)), rel=0.08)
    assert spread.worst > spread.rms


@pytest.mark.slow
def test_what_cannot_be_reached_is_said_with_what_binds(make_config):
    """A parallel channel bends further the farther out it lies: the wall is what stands in the way."""
    config = make_config(routing=PARALLEL)
    far = pose_of(gtr.build_robot(make_config(routing={"kind": "parallel", "offset": 0.0125})))
    wanted = {k: far[k] for k in ("T_base", "angle")}
    answer = design.optimise(config, target(wanted, search={"starts": 4}))
    assert answer.verdict == "not-reached"
    assert "wall_clearance" in [b.name for b in answer.binding if b.kind == "limit"]
    assert answer.best.kept and not answer.best.reached
    assert answer.best.values["offset"] == pytest.approx(0.0115, abs=2e-5)
    [relaxed] = [r for r in answer.relaxed if r.name == "wall_clearance"]
    assert relaxed.reached and relaxed.value == pytest.approx(0.0005, abs=2e-5)
    assert "wall_clearance" in answer.says and "not reachable" in answer.says


@pytest.mark.slow
def test_goal_is_at_its_closed_form(make_config):
    """The largest bend of a parallel tendon lies as far out as the wall allows: ln(1 + mu R T L/EI)/mu."""
    backbone = {"outer_radius": [0.012, 0.012]}
    config = make_config(routing=PARALLEL, backbone=backbone, tendon={"friction_coefficient": 0.3})
    wanted = target(goal={"kind": "bend", "T_base": "20 N"}, search={"starts": 4})
    answer = design.optimise(config, wanted)
    assert answer.verdict == "optimal"
    R, EI = 0.012 - 0.0015, 1.06e6 * np.pi * 0.012**4 / 4
    assert abs(answer.best.goal) == pytest.approx(np.log1p(0.3 * R * 20 * 0.25 / EI) / 0.3, rel=3e-3)
    assert answer.best.kept


@pytest.mark.slow
def test_both_optimisers_find_the_same(make_config):
    hidden = {**SINE, "r1": -0.0085, "r2": 0.0096, "w1": 0.05, "w2": 0.17}
    pose = pose_of(gtr.build_robot(make_config(routing=hidden)))
    objective = problem_of(make_config(routing=SINE), target(pose)).objective
    z = jnp.asarray([[0.3, 0.75, 0.25, 0.6]])
    one = gauss_newton.search_all(objective, z, jnp.ones((1, 4)), 60)
    other = lagrangian.minimise_all(objective, one.z + 0.02, jnp.ones((1, 4)))
    assert float(one.cost[0]) < 1e-4
    assert float(other.cost[0]) < 0.05
    assert float(jnp.min(other.rows)) >= 0.0


@pytest.mark.parametrize("released", [None, 30.0], ids=["pulling", "releasing"])
@pytest.mark.parametrize(
    "loads", [{}, {"gravity_angle": -1.2, "tip_force": [0.03, -0.05]}], ids=["free", "loaded"]
)
def test_the_literal_integrals_agree(released, loads, make_config):
    robot = gtr.build_robot(make_config(routing=SINE, loads=loads), resolution=4)
    T = 25.0 if released is None else 12.0
    eq = gtr.equilibrium(robot, T, memory=None if released is None else gtr.equilibrium(robot, released))
    s = np.asarray(eq.s)
    found = literal.solve_literal(robot, T, released_from=released, start=(s, np.zeros_like(s)))
    assert found.settled
    np.testing.assert_allclose(found.pose[:2], np.asarray(eq.tip_pose)[:2], atol=2e-5)
    assert found.pose[2] == pytest.approx(float(eq.tip_pose[2]), abs=2e-4)
    assert found.T_tip == pytest.approx(float(eq.T_tip), rel=1e-4)


def test_margins_of_a_searched_channel_are_those_of_a_fine_one(make_config):
    """What the search takes for the least margin is so on 2001 places too, to its back-off."""
    problem = problem_of(
        make_config(routing=WAVE), target({"T_base": 20.0, "angle": 0.3}, search={"n_sine": [6]})
    )
    z = jnp.asarray([[0.8, 0.72, 0.2]])
    rows = np.asarray(gauss_newton.judge_all(problem.objective, z).margins[0])
    values = problem.space.lower + np.asarray(z[0]) * (problem.space.upper - problem.space.lower)
    option = look_at(problem, values, resolution=1.0)
    wall = next(m for m in option.margins if m.name == "wall_clearance")
    count = problem.objective.stations
    assert rows[: 2 * count].min() * 0.02 == pytest.approx(wall.margin, abs=gauss_newton.BACK_OFF * 0.02)


@pytest.mark.slow
def test_an_expected_error_is_less_than_that_of_the_nominal_design(make_config):
    known = {"friction_coefficient": 0.2, "youngs_modulus": 0.2}
    pose = {"T_base": 25.0, "angle": 0.9}
    robust = {"optimise": "expected", **known}
    problem = problem_of(make_config(routing=PARALLEL), target(pose, robust=robust, search={"starts": 3}))
    found = find(problem)
    nominal = problem_of(make_config(routing=PARALLEL), target(pose, search={"starts": 3}))
    exact = find(nominal)
    kept = np.flatnonzero(found.kept)
    best = found.z[kept[np.argmin(found.cost[kept])]]
    at = exact.z[np.argmin(exact.cost)]
    cost = [
        0.5 * float(jnp.sum(evaluate(problem.objective, jnp.asarray(z)).residuals ** 2)) for z in (best, at)
    ]
    assert cost[0] < 0.999 * cost[1]
    slope = jax.grad(lambda z: 0.5 * jnp.sum(evaluate(problem.objective, z).residuals ** 2))(
        jnp.asarray(best)
    )
    assert float(jnp.max(jnp.abs(slope))) < 1e-3 * cost[0]


def test_with_free_tensions_a_release_stays_one(make_config):
    """From the last tension of the file: designs in which another is larger break a limit."""
    bounds = {"T_base": ["5 N", "50 N"]}
    pose = {"T_base": 12.0, "branch": "releasing", "angle": 0.3}
    objective = problem_of(
        make_config(routing=PARALLEL), target(pose, search={"free": ["T_base"], "bounds": bounds}, **TOP)
    ).objective
    sound, wrong = (evaluate(objective, jnp.asarray(z)).margins for z in ([0.7, 0.2, 0.6], [0.7, 0.6, 0.2]))
    assert float(jnp.min(sound)) > 0.0
    assert float(jnp.min(wrong)) == pytest.approx(-18.0 / 30.0)


@pytest.mark.slow
def test_the_least_worst_error_is_that_of_a_scan(make_config):
    """Of one offset, tried at four hundred places, to the share at which the reweighting stops."""
    robust = {"optimise": "worst", "friction_coefficient": 0.2, "youngs_modulus": 0.2}
    pose = {"T_base": 25.0, "angle": 0.9}
    problem = problem_of(make_config(routing=PARALLEL), target(pose, robust=robust, search={"starts": 3}))
    found = find(problem)
    z = jnp.linspace(0.0, 1.0, 401)[:, None]
    judged = gauss_newton.judge_all(problem.objective, z)
    kept = np.asarray(jnp.min(judged.margins, axis=1)) >= 0.0
    scanned = np.where(kept, np.asarray(judged.residuals)[:, 0], np.inf)
    best = int(np.argmin(np.where(found.kept, found.cost, np.inf)))
    assert np.sqrt(2 * found.cost[best]) < 1.002 * np.min(scanned)
    assert found.z[best] == pytest.approx(np.asarray(z[np.argmin(scanned)]), abs=5e-3)


@pytest.mark.slow
def test_a_robust_design_of_what_cannot_be_reached_is_not_called_one(make_config):
    robust = {"optimise": "expected", "friction_coefficient": 0.1}
    wanted = target({"T_base": 25.0, "angle": 2.5}, robust=robust, search={"starts": 3})
    answer = design.optimise(make_config(routing=PARALLEL), wanted)
    assert answer.verdict == "not-reached"
    assert "not reachable" in answer.says and "wall_clearance" in answer.says
    wanted = target({"T_base": 25.0, "angle": 0.9}, robust=robust, search={"starts": 3})
    answer = design.optimise(make_config(routing=PARALLEL), wanted)
    assert answer.verdict == "optimal"
    assert "deg rms" in answer.says and "mm" not in answer.says.partition("lost")[0]


@pytest.mark.slow
def test_benchmark_finds_hidden_routings():
    from benchmarks import design as study

    result = study.study(study.families()[3], 2, 1, 5)
    assert result["both"] == result["literal_within"] == 2
    assert result["peers"].keys() == {"least_squares (trf)", "L-BFGS-B", "SLSQP"}
    assert "2 of 2 targets" in study.table([result], study.measure.machine())
