"""Native code in lanes: each lane gives what it gives alone, to the last bit, and what JAX gives."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from calibrate.inference.side_by_side import in_lanes, simulated
from gtr_jax.native import program
from gtr_jax.simulation.history import loads_of
from gtr_jax.simulation.natively import LANES, Native, Run, ready, steps_natively
from gtr_jax.simulation.programs import structure_with
from gtr_jax.terms import REGISTRY
from tests.conftest import SINE

LOOP = np.array([0.0, 8, 16, 24, 18, 9, 14, 18, 10, 2, 12, 20])
CLOCK = 0.7 * np.arange(len(LOOP))
NUMBER = jax.ShapeDtypeStruct((), jnp.float64)


def in_four(step, rows, fixed=NUMBER, given=None):
    """Run steps on rows (K, numbers) in lanes, which go on to the next four rows at once; (K, outputs)."""
    count = rows.shape[1]
    code = program.Program(
        lambda fixed: jnp.zeros(()),
        lambda fixed, carried, row: (carried, step(fixed, *row)),
        fixed,
        (NUMBER,) * count,
        ("test", step),
        lanes=4,
    )
    at_once = rows.reshape(-1, 4, count).transpose(0, 2, 1)
    given = np.zeros((1, 4)) if given is None else np.repeat(given.reshape(-1, 1), 4, axis=1)
    return code(given, at_once).transpose(0, 2, 1).reshape(len(rows), -1)


FAR = [0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 0.5, 709.5, 709.79, -745.0, -745.2, 1e-310, 5e-324]
FAR += [1e7, -3e8]
FUNCTIONS = {
    "exp": (jnp.exp, np.exp, 2),
    "expm1": (jnp.expm1, np.expm1, 3),
    "log": (jnp.log, np.log, 2),
    "log1p": (jnp.log1p, np.log1p, 2),
    "sin": (jnp.sin, np.sin, 2),
    "cos": (jnp.cos, np.cos, 2),
    "tanh": (jnp.tanh, np.tanh, 4),
}


def scattered(count, seed):
    """Numbers of all sizes, and special ones."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=count - len(FAR)) * 10.0 ** rng.uniform(-8, 2.5, count - len(FAR))
    return np.concatenate([spread, FAR])


def units_off(found, wanted):
    """Largest difference of finite numbers in units in the last place; others must be alike."""
    with np.errstate(all="ignore"):
        alike = (found == wanted) | (np.isnan(found) & np.isnan(wanted))
        off = np.abs(found - wanted) / np.spacing(np.abs(wanted))
    assert np.all(np.isfinite(off[~alike]))
    return np.max(off, where=~alike, initial=0.0)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_right_in_their_last_places(name):
    traced, exact, most = FUNCTIONS[name]
    x = scattered(20_000, 1)
    with np.errstate(all="ignore"):
        wanted = exact(x)
    found = in_four(lambda fixed, x: traced(x), x[:, None])[:, 0]
    assert units_off(found, wanted) <= most


def test_angles_of_all_quarters_are_right():
    y, x = scattered(20_000, 2), np.random.default_rng(3).permutation(scattered(20_000, 4))
    both = np.isinf(x) & np.isinf(y)
    found = in_four(lambda fixed, y, x: jnp.arctan2(y, x), np.stack([y, x], axis=1))[:, 0]
    assert units_off(found[~both], np.arctan2(y, x)[~both]) <= 3


def test_powers_are_as_right_as_their_exponent():
    rng = np.random.default_rng(5)
    x = np.concatenate([10.0 ** rng.uniform(-3, 3, 4000), [0.0, 0.0, 0.0, 1.0, -2.0, -2.0, -2.0, np.nan]])
    y = np.concatenate([rng.uniform(-4, 4, 4000), [0.0, 2.5, -1.0, np.nan, 3.0, 2.0, 0.5, 0.0]])
    with np.errstate(all="ignore"):
        wanted = np.power(x, y)
    found = in_four(lambda fixed, x, y: jnp.power(x, y), np.stack([x, y], axis=1))[:, 0]
    assert units_off(found[:4000], wanted[:4000]) <= 2 + 2 * 4 * np.log(1e3)
    np.testing.assert_allclose(found[4000:], wanted[4000:], rtol=4e-16)


def _turns(fixed, x):
    """A loop that lanes leave at different turns, with a branch that lanes take differently inside it, a scan
    whose carry is the same in all lanes, and a row at a place of each its own.
    """

    def body(state):
        k, x = state
        x = jax.lax.cond(x > 3, lambda x: x / 2, lambda x: x - 0.75, x)
        return k + 1, x

    k, left = jax.lax.while_loop(lambda state: state[1] > 0, body, (0, x))
    total, each = jax.lax.scan(lambda n, row: (n + 1, row * n), 0, fixed)
    return k, left, total, jnp.take(fixed, jnp.clip(k, 0, 2)[None])[0], each[2]


def test_lanes_leave_loops_and_branches_by_themselves():
    x = np.random.default_rng(6).uniform(-1, 40, 40)
    fixed = np.array([1.5, -2.0, 4.0])
    found = in_four(_turns, x[:, None], jax.ShapeDtypeStruct((3,), jnp.float64), fixed)
    for row, one in zip(found, x, strict=True):
        np.testing.assert_array_equal(row, np.asarray(_turns(jnp.asarray(fixed), jnp.asarray(one)), float))


TERMS = (
    "presliding",
    "viscous-friction",
    "stribeck-friction",
    "pressure-dependent-friction",
    "adhesion",
    "local-friction",
    "stiffening",
    "body-hysteresis",
    "contact",
    "sheath-moved",
)


def typical(kind):
    return {f"{kind}.{q.name}": float(q.typical) for q in REGISTRY[kind].quantities}


def test_each_lane_gives_what_it_gives_alone(make_robot):
    """Robots on which different terms act, under different loads, in one program."""
    plain = make_robot(0.4, routing=SINE)
    robots = [plain, *(plain.with_values(**typical(kind)) for kind in TERMS)]
    structure = structure_with(plain, TERMS)
    native = Native(plain)
    runs = [
        Run(ready(robot, jnp.asarray(T)), loads_of(jnp.asarray(T), jnp.asarray(CLOCK), None))
        for robot, T in zip(robots, (LOOP * (1 + 0.03 * i) for i in range(len(robots))), strict=True)
    ]
    alone = [native.side_by_side([run], structure)[0] for run in runs]
    for start in range(len(runs)):
        group = [(start + k) % len(runs) for k in range(LANES)]
        for i, found in zip(group, native.side_by_side([runs[i] for i in group], structure), strict=True):
            for name in ("T_tip", "tip_pose", "displacement", "converged", "iterations"):
                np.testing.assert_array_equal(getattr(found, name), getattr(alone[i], name), err_msg=name)
    for robot, run, found in zip(robots, runs, alone, strict=True):
        scalar = steps_natively(robot, structure, run.loads)
        np.testing.assert_allclose(found.T_tip, scalar.T_tip, rtol=1e-8, atol=1e-9)
        np.testing.assert_array_equal(found.converged, scalar.converged)


def test_terms_that_do_not_act_are_passed_over(make_robot):
    plain = make_robot(0.4, routing=SINE)
    loads = loads_of(jnp.asarray(LOOP), jnp.asarray(CLOCK), None)
    few = steps_natively(plain, structure_with(plain, ()), loads)
    many = steps_natively(plain, structure_with(plain, ("stribeck-friction", "stiffening")), loads)
    np.testing.assert_allclose(many.T_tip, few.T_tip, rtol=1e-9, atol=1e-9)


def test_threads_that_ask_are_served_together(make_robot, monkeypatch):
    plain = make_robot(0.2, routing=SINE)
    robots = [plain.with_values(mu=0.2 + 0.02 * i) for i in range(12)]
    structure, native = structure_with(robots[0], ()), Native(robots[0])
    loads = loads_of(jnp.asarray(LOOP), jnp.asarray(CLOCK), None)
    runs = [Run(ready(robot, jnp.asarray(LOOP)), loads) for robot in robots]
    sizes, real = [], Native.side_by_side

    def counted(self, runs, structure):
        sizes.append(len(runs))
        return real(self, runs, structure)

    wanted = [native.side_by_side([run], structure)[0].T_tip for run in runs]
    monkeypatch.setattr(Native, "side_by_side", counted)
    found = in_lanes(lambda run: simulated(native, structure, [run])[0].T_tip, runs)
    np.testing.assert_array_equal(found, wanted)
    assert sum(sizes) == len(runs) and max(sizes) <= LANES
    sizes.clear()
    simulated(native, structure, runs)
    assert sizes == [LANES] * 3


def test_an_interrupted_thread_leaves_its_work_to_others(make_robot, monkeypatch):
    robot = make_robot(0.3, routing=SINE)
    structure, native = structure_with(robot, ()), Native(robot)
    run = Run(ready(robot, jnp.asarray(LOOP)), loads_of(jnp.asarray(LOOP), jnp.asarray(CLOCK), None))
    real, times = Native.side_by_side, []

    def interrupted(self, runs, structure):
        times.append(len(runs))
        if len(times) < 4:
            raise KeyboardInterrupt
        return real(self, runs, structure)

    monkeypatch.setattr(Native, "side_by_side", interrupted)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            simulated(native, structure, [run])
    assert len(simulated(native, structure, [run, run])) == 2


def test_a_fault_stays_with_the_run_that_has_it(make_robot, monkeypatch):
    robot = make_robot(0.3, routing=SINE)
    structure, native = structure_with(robot, ()), Native(robot)
    good = Run(ready(robot, jnp.asarray(LOOP)), loads_of(jnp.asarray(LOOP), jnp.asarray(CLOCK), None))
    bad, real = good._replace(drawn=np.zeros(3)), Native.side_by_side

    def side_by_side(self, runs, structure):
        if any(run.drawn is not None for run in runs):
            raise gtr.InputError("no")
        return real(self, runs, structure)

    monkeypatch.setattr(Native, "side_by_side", side_by_side)
    together = threading.Barrier(2)

    def ask(run):
        together.wait()
        try:
            return simulated(native, structure, [run])
        except gtr.InputError:
            return None

    found = in_lanes(ask, [good, bad])
    assert found[0] is not None and found[1] is None


def test_long_chains_of_operations_are_written():
    def step(fixed, x):
        y = x * jnp.linspace(0.0, 1.0, 30)
        for _ in range(500):
            y = jnp.sqrt(y + 0.5)
        return y

    x = np.linspace(0.1, 2.0, 8)
    wanted = np.stack([np.asarray(step(None, jnp.asarray(one))) for one in x])
    np.testing.assert_allclose(in_four(step, x[:, None]), wanted, rtol=1e-12)


def test_booleans_are_ordered():
    def step(fixed, x):
        return jnp.maximum(x > 0, x > 1), jnp.minimum(x > 0, x > 1)

    found = in_four(lambda fixed, x: jnp.stack(step(fixed, x)), np.array([[-1.0], [0.5], [2.0], [0.0]]))
    np.testing.assert_array_equal(found, [[0, 0], [1, 0], [1, 1], [0, 0]])


def test_a_fault_reaches_whoever_asked(make_robot, monkeypatch):
    robot = make_robot(0.3, routing=SINE)
    structure, native = structure_with(robot, ()), Native(robot)
    run = Run(ready(robot, jnp.asarray(LOOP)), loads_of(jnp.asarray(LOOP), jnp.asarray(CLOCK), None))
    waiting = threading.Barrier(2)

    def broken(self, runs, structure):
        raise gtr.InputError("no")

    monkeypatch.setattr(Native, "side_by_side", broken)
    told = []

    def ask(_):
        waiting.wait()
        with pytest.raises(gtr.InputError, match="no"):
            simulated(native, structure, [run])
        told.append(True)

    in_lanes(ask, [0, 1])
    assert len(told) == 2
