"""Several tendons on one body: friction by slip against closed forms, the law of one, and symmetries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from tests.conftest import ROUTINGS

MU, E, R, L = 0.3, 1.2e6, 0.01, 0.25
STIFFNESS = E * np.pi / 4 * 0.014**4
PULL = np.linspace(0.0, 20.0, 11)
LOOP = np.concatenate([PULL, PULL[::-1][1:], PULL[1:8], PULL[6:2:-1]])


def tendon(name, routing, mu=MU, preload=0.0):
    return {"name": name, "routing": routing, "friction_coefficient": mu, "preload": preload}


def parallel(offset):
    return {"kind": "parallel", "offset": offset}


def strung(*tendons, resolution=1.0, **rest):
    data = {
        "schema": 1,
        "backbone": {"length": L, "outer_radius": 0.014, "youngs_modulus": E, "density": 1000.0},
        "tendons": list(tendons),
        **rest,
    }
    return gtr.build_robot(gtr.RobotConfig.model_validate(data), resolution=resolution)


@pytest.fixture(scope="module")
def pair():
    return strung(tendon("left", parallel(R), preload=5.0), tendon("right", parallel(-R), preload=5.0))


@pytest.fixture(scope="module")
def pulled(pair):
    history = np.stack([np.linspace(5.0, 20.0, 21), np.full(21, 5.0)], axis=1)
    return gtr.simulate(pair, history)


def test_antagonist_held_is_dragged_to_the_tip(pulled):
    """Pulled by A, the other held at B: EI phi' = R (A e^(-mu phi) - B e^(mu phi)), in closed form."""
    A, B = 20.0, 5.0
    rate = MU * R / STIFFNESS * np.sqrt(A * B)
    phi = np.log(np.sqrt(A / B) * np.tanh(rate * L + np.arctanh(np.sqrt(B / A)))) / MU
    assert bool(jnp.all(pulled.converged))
    assert float(pulled.tip_pose[-1, 2]) == pytest.approx(phi, rel=1e-7)
    ends = [A * np.exp(-MU * phi), B * np.exp(MU * phi)]
    assert np.asarray(pulled.T_tip[-1]) == pytest.approx(ends, rel=1e-7)
    assert np.all(np.asarray(pulled.slip_direction[1:]) == [1, -1])
    assert np.all(gtr.label_phases(pulled)[1:] == ["pulling", "releasing"])


def test_displacements_are_what_the_body_turns(pulled):
    """A parallel channel shortens by R phi: the pulled tendon comes out by it, the other goes in."""
    turned = R * np.asarray(pulled.tip_pose[:, 2])
    np.testing.assert_allclose(pulled.displacement, np.stack([turned, -turned], axis=1), atol=1e-9)


def test_beside_a_slack_tendon_nothing_changes(make_robot):
    """The law by slip and the law by tension against the base agree where both hold; what is left is the
    presliding length, 2e-6 of the body's.
    """
    alone = make_robot(routing=parallel(R), backbone={"outer_radius": 0.014, "youngs_modulus": E})
    both = strung(tendon("pulled", parallel(R)), tendon("slack", ROUTINGS["cross"]))
    one = gtr.simulate(alone, LOOP)
    two = gtr.simulate(both, np.stack([LOOP, 0 * LOOP], axis=1))
    assert bool(jnp.all(two.converged))
    assert np.max(np.abs(two.T_tip[:, 0] - one.T_tip)) < 1e-3 * 20.0
    assert np.max(np.abs(two.tip_pose[:, 2] - one.tip_pose[:, 2])) < 1e-3
    assert np.all(np.asarray(two.T_tip[:, 1]) == 0)


def test_two_halves_are_one(make_robot):
    alone = make_robot(routing=ROUTINGS["wave"], backbone={"outer_radius": 0.014, "youngs_modulus": E})
    both = strung(tendon("a", ROUTINGS["wave"]), tendon("b", ROUTINGS["wave"]))
    one = gtr.simulate(alone, LOOP)
    two = gtr.simulate(both, np.stack([LOOP / 2, LOOP / 2], axis=1))
    assert bool(jnp.all(two.converged))
    assert np.max(np.abs(two.T_tip.sum(axis=1) - one.T_tip)) < 1e-3 * 20.0
    np.testing.assert_allclose(two.T_tip[:, 0], two.T_tip[:, 1], rtol=0, atol=2e-3)


def test_mirrored_pair(pair):
    rng = np.random.default_rng(1)
    history = np.cumsum(rng.uniform(-2, 2, (24, 2)), axis=0) + 8.0
    there, back = gtr.simulate(pair, history), gtr.simulate(pair, history[:, ::-1])
    assert bool(jnp.all(there.converged & back.converged))
    np.testing.assert_allclose(there.T_tip, back.T_tip[:, ::-1], rtol=0, atol=1e-7)
    np.testing.assert_allclose(there.tip_pose[:, 2], -back.tip_pose[:, 2], rtol=0, atol=1e-9)


def test_friction_only_dissipates(pair):
    """Around a closed loop of both tensions the base does work on the robot, never the other way."""
    t = np.linspace(0, 2 * np.pi, 49)
    loop = np.stack([9 - 4 * np.cos(t), 9 - 4 * np.sin(t)], axis=1)
    run = gtr.simulate(pair, np.concatenate([loop, loop]))
    assert bool(jnp.all(run.converged))
    once = slice(48, 97)
    T, u = np.asarray(run.T_base[once]), np.asarray(run.displacement[once])
    work = np.sum(0.5 * (T[1:] + T[:-1]) * np.diff(u, axis=0))
    assert work > 1e-3, "J"
    assert np.all(np.abs(np.asarray(run.mobilisation)) <= 1)


def test_tension_never_changes_faster_than_friction_allows(pair):
    rng = np.random.default_rng(2)
    history = np.abs(np.cumsum(rng.uniform(-3, 3, (24, 2)), axis=0)) + 1.0
    run = gtr.simulate(pair, history)
    eq = gtr.equilibrium_at(pair, run, 17)
    np.testing.assert_allclose(eq.tension, run.tension[17], atol=1e-6)
    drop = np.abs(np.diff(np.log(np.asarray(eq.tension)), axis=1))
    assert np.all(drop <= MU * np.diff(np.asarray(eq.wrap), axis=1) * (1 + 1e-9) + 1e-12)


def test_a_tendon_on_the_axis_and_a_rigid_sheath_still_slip():
    """Their channels never change length: the tendon's own stretch, however small, tells the direction."""
    sheath = {"length": L, "outer_radius": 0.014, "rigid": True, "natural_curvature": 4.0}
    both = strung(tendon("axis", parallel(0.0)), tendon("side", parallel(R)), backbone=sheath)
    run = gtr.simulate(both, np.stack([LOOP, LOOP], axis=1))
    assert bool(jnp.all(run.converged))
    loss = np.exp(-MU * 4.0 * L)
    np.testing.assert_allclose(run.T_tip[10], 20.0 * loss, rtol=1e-6)
    held = np.asarray(run.T_tip[11])
    assert held == pytest.approx(20.0 * loss, rel=2e-2), "locked at the tip as release begins"
    np.testing.assert_allclose(run.T_tip[18], 4.0 / loss, rtol=1e-6)


@pytest.mark.slow
def test_gradients_through_a_history():
    robot = strung(
        tendon("a", parallel(0.008), 0.3, 1.0),
        tendon("b", parallel(-0.006), 0.2, 2.0),
        loads={"tip_force": [0.02, -0.05]},
    )
    turns = np.arange(5.0)
    t = np.linspace(0.0, 4.0, 17)
    history = jnp.stack(
        [
            jnp.asarray(np.interp(t, turns, [1, 12, 3, 9, 5])),
            jnp.asarray(np.interp(t, turns, [2, 2, 10, 4, 4])),
        ],
        axis=1,
    )
    names = ("mu.a", "mu.b", "offset.a", "E", "tip_force_y")
    start = jnp.stack([robot.value(name) for name in names])

    @jax.jit
    def outputs(values):
        own = dict(zip(names, values, strict=True))
        run = gtr.simulate(robot.with_values(**own), history)
        return jnp.concatenate([run.T_tip.ravel(), run.tip_pose[:, 2], run.displacement.ravel() / R])

    slopes = jax.jit(jax.jacfwd(outputs))(start)
    for i, name in enumerate(names):
        step = 1e-5 * float(jnp.abs(start[i]))
        above, below = outputs(start.at[i].add(step)), outputs(start.at[i].add(-step))
        difference = np.asarray(above - below) / (2 * step)
        error = np.abs(np.asarray(slopes[:, i]) - difference)
        assert np.max(error) < 2e-5 * np.max(np.abs(difference)), name
    weights = jnp.asarray(np.random.default_rng(0).normal(size=slopes.shape[0]))
    backward = jax.jit(jax.grad(lambda values: outputs(values) @ weights))(start)
    np.testing.assert_allclose(backward, weights @ slopes, rtol=1e-9)


def test_shapes_and_names(pair):
    assert pair.tendon_names == ("left", "right")
    assert {"mu.left", "mu.right", "offset.left", "preload.right", "E"} <= set(gtr.parameters_of(pair))
    assert float(pair.with_values(**{"mu.right": 0.1}).value("tendons.right.friction_coefficient")) == 0.1
    with pytest.raises(ValueError, match="left, right"):
        gtr.equilibrium(pair, 3.0)
    with pytest.raises(ValueError, match=r"\(steps, 2\)"):
        gtr.simulate(pair, PULL)
    with pytest.raises(ValueError, match="one tendon"):
        gtr.release_switch(pair, 3.0)
    with pytest.raises(ValueError, match="2 tendons"):
        _ = pair.routing
    first = gtr.equilibrium(pair, [8.0, 5.0])
    again = gtr.equilibrium(pair, [8.0, 6.0], memory=first)
    run = gtr.simulate(pair, [[8.0, 5.0], [8.0, 6.0]])
    np.testing.assert_allclose(again.tension, run.tension[1], atol=1e-6)
    onward = gtr.equilibrium(pair, [8.0, 6.0], memory=gtr.equilibrium_at(pair, run, 0))
    np.testing.assert_allclose(onward.tension, run.tension[1], atol=1e-6)
    # From a held state, too: the same load moves nothing, and a turn goes on as in the history.
    loads = [[0.0, 0.0], [8.0, 5.0], [8.0, 6.0], [7.9, 5.9], [7.0, 5.5]]
    run = gtr.simulate(pair, loads)
    held = gtr.equilibrium(pair, loads[3], memory=gtr.equilibrium_at(pair, run, 3))
    np.testing.assert_allclose(held.tension, run.tension[3], atol=1e-6)
    turned = gtr.equilibrium(pair, loads[4], memory=gtr.equilibrium_at(pair, run, 3))
    np.testing.assert_allclose(turned.tension, run.tension[4], atol=1e-6)
    with pytest.raises(ValueError, match="give the equilibrium before"):
        gtr.equilibrium(pair, [8.0, 6.0], memory=first.tension[0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_random_robots_and_histories_converge(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 4))
    kinds = list(ROUTINGS)
    tendons = [
        tendon(
            f"t{i}", ROUTINGS[kinds[rng.integers(len(kinds))]], rng.uniform(0.05, 0.6), rng.choice([0, 1.0])
        )
        for i in range(count)
    ]
    loads = {"gravity_angle": rng.uniform(-3, 3), "tip_force": list(rng.uniform(-0.1, 0.1, 2))}
    robot = strung(*tendons, loads=loads if seed % 2 else {})
    knots = rng.uniform(0, 15, (9, count))
    turns = np.arange(9.0)
    history = np.stack([np.interp(np.linspace(0, 8, 49), turns, knots[:, i]) for i in range(count)], axis=1)
    run = gtr.simulate(robot, history)
    assert bool(jnp.all(run.converged)), np.flatnonzero(~np.asarray(run.converged))
    assert bool(jnp.all(run.tension >= 0))


def test_small_cycles_settle_within_what_friction_can_hold():
    """Both partly locked, the tensions of a pair are not unique: what remains is bounded, and does not depend
    on the number of steps.
    """
    robot = strung(tendon("pulled", parallel(0.008)), tendon("held", parallel(-0.005), 0.2, 3.2))
    ends = []
    for steps in (4, 8):
        ramp = np.linspace(0, 10, 2 * steps + 1)[1:]
        cycle = np.concatenate([np.linspace(10, 8, steps + 1)[1:], np.linspace(8, 10, steps + 1)[1:]])
        left = np.concatenate([ramp, np.tile(cycle, 8)])
        run = gtr.simulate(robot, np.stack([left, np.full_like(left, 3.2)], axis=1))
        assert bool(jnp.all(run.converged))
        after = np.asarray(run.T_tip)[len(ramp) - 1 :: len(cycle), 1]
        assert np.all(np.diff(after) < 0.005), "it settles, never climbs"
        wrap = float(gtr.equilibrium_at(robot, run, -1).wrap[1, -1])
        assert np.all(np.abs(np.log(after / 3.2)) <= 0.2 * wrap * (1 + 1e-6))
        assert np.abs(np.diff(after))[-1] < 0.25 * np.abs(np.diff(after))[0]
        ends.append(after[-1])
    assert ends[0] == pytest.approx(ends[1], rel=0.01)


def random_histories(count, steps=40, largest=18.0):
    """Base tensions of two tendons [N], (count, steps, 2): ramps, both in antiphase, one held, one slack."""
    rng = np.random.default_rng(5)
    found = []
    for kind in range(count):
        corners = rng.uniform(0.0, largest, (6, 2))
        corners[0] = 1.0
        if kind % 4 == 1:
            corners[:, 1] = largest - corners[:, 0]
        if kind % 4 == 2:
            corners[:, 0] = 3.0
        if kind % 4 == 3:
            corners[2:4, 1] = 0.0
        at = np.linspace(0, len(corners) - 1, steps)
        found.append(np.stack([np.interp(at, np.arange(len(corners)), c) for c in corners.T], axis=1))
    return found


@pytest.mark.parametrize("kind", ["tendon-stretch", pytest.param("presliding", marks=pytest.mark.slow)])
def test_a_term_of_no_size_changes_nothing(pair, kind):
    """The program with physics terms and that without solve one law; it was off by up to 1.3 N of 17."""
    for history in random_histories(4):
        plain, held = gtr.simulate(pair, history), gtr.simulate(pair, history, with_terms=(kind,))
        assert bool(jnp.all(plain.converged)) and bool(jnp.all(held.converged))
        np.testing.assert_allclose(held.T_tip, plain.T_tip, rtol=0, atol=1e-5)
        np.testing.assert_allclose(held.tip_pose, plain.tip_pose, rtol=0, atol=1e-7)
        np.testing.assert_allclose(held.displacement, plain.displacement, rtol=0, atol=1e-7)


def test_a_short_presliding_is_none_and_a_long_one_is_not(pair):
    (history,) = random_histories(1)
    plain = gtr.simulate(pair, history)

    def off(length):
        robot = pair.with_values(**{"presliding.length": length})
        run = gtr.simulate(robot, history, with_terms=("presliding",))
        assert bool(jnp.all(run.converged))
        return float(np.max(np.abs(run.T_tip - plain.T_tip)))

    assert off(1e-12) < 0.03 < off(2e-3)


@pytest.mark.slow
def test_gradients_with_terms_agree_with_differences(pair):
    """Forwards by every number, and backwards, through a history in which tendons stick and slip."""
    terms = ("tendon-stretch", "presliding", "viscous-friction", "stiffening")
    given = {
        "mu.left": 0.3,
        "E": E,
        "presliding.length": 4e-4,
        "tendon-stretch.compliance": 2e-4,
        "viscous-friction.coefficient": 3.0,
        "stiffening.coefficient": 1e-4,
    }
    history = np.array([[5, 5], [8, 5.3], [12, 5.5], [16, 6], [12, 7], [8, 9], [6, 11], [7, 10], [10, 9.0]])

    @jax.jit
    def shown(values):
        robot = pair.with_values(**values)
        run = gtr.simulate(robot, history, time=1.0 * np.arange(len(history)), with_terms=terms)
        return jnp.concatenate([run.T_tip, run.tip_pose, run.displacement], axis=1)

    slopes = jax.jit(jax.jacfwd(shown))(given)
    for name, value in given.items():
        step = 1e-4 * value
        there, back = shown({**given, name: value + step}), shown({**given, name: value - step})
        want = (there - back) / (2 * step)
        size = np.max(np.abs(want), axis=0)
        assert np.max(np.abs(slopes[name] - want) / size) < 1e-5, name
    backwards = jax.jit(jax.grad(lambda mu: shown({**given, "mu.left": mu})[5, 0]))(given["mu.left"])
    assert float(backwards) == pytest.approx(float(slopes["mu.left"][5, 0]), rel=1e-9)


@pytest.mark.parametrize("kinds", [(), ("tendon-stretch",)], ids=["without terms", "with one"])
def test_native_code_gives_the_same(pair, kinds):
    from gtr_jax.mechanics import SolverOptions
    from gtr_jax.simulation.history import loads_of
    from gtr_jax.simulation.natively import steps_natively
    from gtr_jax.simulation.programs import structure_of

    history = random_histories(2)[1]
    loads = loads_of(jnp.asarray(history), jnp.arange(len(history), dtype=float), None)
    native = steps_natively(pair, structure_of(pair, kinds), loads, SolverOptions(), None)
    run = gtr.simulate(pair, history, with_terms=kinds)
    assert native.converged.all()
    np.testing.assert_allclose(native.T_tip, run.T_tip, rtol=0, atol=1e-9)
    np.testing.assert_allclose(native.displacement, run.displacement, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(native.slip_direction, run.slip_direction)
    np.testing.assert_allclose(native.slip_front, run.slip_front, rtol=1e-12)
