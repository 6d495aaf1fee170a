"""Events of a rig, against the blind benchmark's machine: an elastic thread marched in time."""

import dataclasses
import itertools
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr
from benchmarks.blind import machine
from benchmarks.sliding import DT
from benchmarks.sliding import sampled as history
from gtr_jax.config.config import load_config, parse_config
from gtr_jax.examples import CONCEALED_ROBOT
from gtr_jax.mechanics import events
from tests.benchmarks.test_blind import ARM

# One reversal, then a hold in which friction holds the tip; the other with an inner loop before the hold.
HOLD = [(0, 0), (20, 40), (28, 20), (36, 20), (44, 6)]
INNER = [(0, 0), (20, 40), (28, 12), (34, 30), (38, 22), (44, 22), (52, 5), (58, 20)]


def rise(x):
    x = np.clip(x, 0.0, 1.0)
    return x**2 * (3 - 2 * x)


def shaken(share, start, lasts, edge):
    def friction(guides):
        # The machine counts its time from the step before the first sample.
        now = guides.time - DT
        return 1 - share * rise((now - start) / edge) * rise((start + lasts - now) / edge)

    values = {"share": share, "time": start, "duration": lasts, "edge": edge}
    return friction, {f"shaken-sheath.{name}": v for name, v in values.items()}


def moved(change, start, lasts):
    values = {"change": change, "time": start, "duration": lasts}
    return (
        lambda guides: 1 + change * rise((guides.time - DT - start) / lasts),
        {f"sheath-moved.{name}": v for name, v in values.items()},
    )


def ours(values, resolution=1.0):
    robot = gtr.load_robot(CONCEALED_ROBOT, resolution=resolution)
    return robot.with_values(mu=0.3, E=1.5e6, **values)


def by_law(text):
    """The robot with a law of friction."""
    size = {"1-size*(1-exp(-t/60[s]))": 0.7, "1/(1+size*n)": 0.3}[text]
    config = load_config(CONCEALED_ROBOT)
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    form = text.replace("60[s]", "slow")
    term = {"kind": "law", "name": "falls", "acts": "friction", "law": form, "size": size}
    data["terms"] = [term | ({"slow": "60 s"} if "slow" in form else {})]
    return gtr.build_robot(parse_config(data)).with_values(mu=0.3, E=1.5e6)


# Events, and the largest difference of the tip tension that is allowed [N]; its rms may be half of it.
CASES = {
    "shaken in a hold": (HOLD, shaken(0.4, 31.0, 3.0, 1.0), 0.05),
    "shaken until all slips": (HOLD, shaken(0.6, 31.0, 3.0, 1.0), 0.1),
    "shaken while it slips": (HOLD, shaken(0.5, 14.0, 3.0, 1.0), 0.05),
    "shaken off": (HOLD, shaken(1.0, 31.0, 3.0, 1.0), 0.03),
    "moved for less": (HOLD, moved(-0.4, 31.0, 1.0), 0.05),
    "moved for more": (INNER, moved(0.4, 40.0, 1.0), 0.02),
    "shaken in an inner loop": (INNER, shaken(0.5, 39.0, 3.0, 1.0), 0.02),
}


@pytest.mark.parametrize("name", CASES)
def test_the_tip_tension_is_that_of_an_elastic_thread(name):
    corners, (friction, values), allowed = CASES[name]
    time, T_base = history(corners)
    plain = machine.march(ARM, time, T_base)
    arm = dataclasses.replace(ARM, laws=machine.Laws(friction=friction))
    shown = machine.run(arm, time, T_base)
    assert shown.worst < 5e-3 and np.max(np.abs(shown.T_tip - plain.T_tip)) > 0.2
    for resolution in (1.0, 2.0):
        run = gtr.simulate(ours(values, resolution), T_base, time=time)
        assert bool(run.converged.all())
        off = np.asarray(run.T_tip) - shown.T_tip
        assert np.max(np.abs(off)) < allowed and np.sqrt(np.mean(off**2)) < 0.5 * allowed, resolution
        assert np.max(np.abs(np.asarray(run.tip_pose)[:, 2] - shown.pose[:, 2])) < 5e-3
        assert np.max(np.abs(np.asarray(run.displacement) - shown.drawn)) < 5e-5


# Loops with holds, in which friction falls slowly: with time, with cycles, and by a law of either.
LOOPS = [(0, 0), (15, 40), (30, 2), (45, 40), (60, 2), (75, 30), (85, 10), (100, 10)]
FALLS = {
    "drift": (lambda g: 1 - 0.004 * (g.time - DT), {"friction-drift.rate": -0.004}, ""),
    "running in": (lambda g: 1 - 0.15 * g.cycle, {"wear.rate": -0.15}, ""),
    "a law of time": (lambda g: 0.3 + 0.7 * np.exp(-(g.time - DT) / 60), {}, "1-size*(1-exp(-t/60[s]))"),
    "a law of cycles": (lambda g: 1 / (1 + 0.3 * g.cycle), {}, "1/(1+size*n)"),
}


@pytest.mark.parametrize("name", FALLS)
@pytest.mark.parametrize(
    "corners", [HOLD, INNER, pytest.param(LOOPS, marks=pytest.mark.slow)], ids=["hold", "inner", "loops"]
)
def test_what_friction_holds_relaxes_while_friction_falls(name, corners):
    friction, values, law = FALLS[name]
    time, T_base = history(corners)
    plain = machine.march(ARM, time, T_base)
    shown = machine.run(dataclasses.replace(ARM, laws=machine.Laws(friction=friction)), time, T_base)
    assert shown.worst < 5e-3 and np.max(np.abs(shown.T_tip - plain.T_tip)) > 1.0
    run = gtr.simulate(ours(values) if values else by_law(law), T_base, time=time)
    assert bool(run.converged.all())
    off = np.asarray(run.T_tip) - shown.T_tip
    assert np.max(np.abs(off)) < 0.1 and np.sqrt(np.mean(off**2)) < 0.02


@pytest.mark.parametrize("lumped", ["base", "tip"])
def test_what_relaxes_beside_friction_in_one_place(lumped):
    """Friction ahead of the channel and at the anchor, which does not fall."""
    time, T_base = history(LOOPS)
    friction, values, _ = FALLS["drift"]
    laws = machine.Laws(friction=friction, entry=0.1 * (lumped == "base"), exit=0.1 * (lumped == "tip"))
    shown = machine.run(dataclasses.replace(ARM, laws=laws), time, T_base)
    run = gtr.simulate(ours(values | {f"local-friction.{lumped}": 0.1}), T_base, time=time)
    assert bool(run.converged.all()) and shown.worst < 5e-3
    off = np.asarray(run.T_tip) - shown.T_tip
    assert np.max(np.abs(off)) < 0.1 and np.sqrt(np.mean(off**2)) < 0.02
    plain = np.asarray(gtr.simulate(ours(values), T_base, time=time).T_tip)
    tiny = gtr.simulate(ours(values | {f"local-friction.{lumped}": 1e-9}), T_base, time=time)
    np.testing.assert_allclose(np.asarray(tiny.T_tip), plain, atol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_what_relaxes_slips_only_where_friction_gives_way(seed):
    """With peaks, valleys and nodes that have no length of their own: no slip within the limits of friction,
    and towards the base or the tip only at the limit that friction then has.
    """
    draw, n = np.random.default_rng(seed), 30
    tension = np.exp(2 + np.cumsum(draw.normal(size=n) * draw.choice([0.02, 0.2])))
    down, up = draw.uniform(0.0, 0.1, size=(2, n))
    weight = draw.uniform(0.5, 1.5, n)
    weight[[9, 10, 20]], down[[9, 10, 11]], up[[9, 10, 11]] = 1e-12, 0.0, 0.0
    found = np.asarray(events.least(*map(jnp.asarray, (tension, weight, down, up))))
    step = np.diff(np.log(found))
    assert found[0] == pytest.approx(tension[0], rel=1e-14)
    assert np.all(step >= -down[1:] - 1e-12) and np.all(step <= up[1:] + 1e-12)
    slip = np.cumsum((weight * (found - tension))[::-1])[::-1][1:]  # towards the base
    assert np.all(slip[step > -down[1:] + 1e-9] < 1e-10)
    assert np.all(slip[step < up[1:] - 1e-9] > -1e-10)
    assert np.max(np.abs(slip)) > 1e-3


def test_what_relaxes_follows_the_loads_smoothly():
    time, T_base = history(INNER)
    robot = ours({"friction-drift.rate": -0.004})
    once, again = (
        np.asarray(gtr.simulate(robot, scale * T_base, time=time).T_tip) for scale in (1.0, 1 + 1e-10)
    )
    np.testing.assert_allclose(again, once, rtol=1e-9, atol=1e-9)


def test_a_load_without_a_clock_lets_nothing_relax():
    time, T_base = history(HOLD)
    held = gtr.simulate(ours({}), T_base, time=time).tension[-1]
    plain, falls = (
        float(gtr.equilibrium(ours(values), float(T_base[-1]), memory=held).T_tip)
        for values in ({}, {"friction-drift.rate": -0.004})
    )
    assert falls == pytest.approx(plain, rel=1e-9)


# The history, when the end is moved, and how far towards the base [m].
TUGS = {
    "let go a little": (HOLD, 31.0, 2e-4),
    "let go until it slips at the base": (HOLD, 31.0, 1e-3),
    "pulled until it slips at the base": (HOLD, 31.0, -5e-4),
    "let go while the base is released": (HOLD, 22.0, 5e-4),
    "let go in an inner loop": (INNER, 39.0, 5e-4),
}


@pytest.mark.parametrize("name", TUGS)
def test_an_end_that_is_moved_is_that_of_an_elastic_thread(name):
    corners, start, far = TUGS[name]
    time, T_base = history(corners)
    law = machine.Laws(feed=lambda now: far * rise(now - DT - start))
    shown = machine.run(dataclasses.replace(ARM, laws=law), time, T_base)
    first, last = round(start / DT), round((start + 1) / DT)
    change = float(shown.T_tip[last] - shown.T_tip[first])
    assert abs(change) > 1.0
    values = {"tip-moved.tension": change, "tip-moved.time": start, "tip-moved.duration": 1.0}
    # The machine moves the end along a way, the term along a tension: they agree before and after.
    same = (time < start) | (time >= start + 1)
    for resolution in (1.0, 2.0):
        run = gtr.simulate(ours(values, resolution), T_base, time=time)
        assert bool(run.converged.all())
        off = (np.asarray(run.T_tip) - shown.T_tip)[same]
        assert np.max(np.abs(off)) < 0.03 and np.sqrt(np.mean(off**2)) < 0.01
        assert np.max(np.abs(np.asarray(run.tip_pose)[same, 2] - shown.pose[same, 2])) < 3e-3
        assert np.max(np.abs(np.asarray(run.displacement) - shown.drawn)[same]) < 1e-4


def test_what_an_end_leaves_is_the_capstan_from_that_end():
    """In a fixed shape ln T beyond the front of the slip is a line from the end, and T is kept before it."""
    sheath = parse_config(
        {
            "schema": 1,
            "name": "sheath",
            "backbone": {"length": 1.0, "outer_radius": [0.002] * 2, "natural_curvature": 5.0, "rigid": True},
            "routing": {"kind": "parallel", "offset": 0.0},
            "tendon": {"friction_coefficient": 0.1},
        }
    )
    robot = gtr.build_robot(sheath).with_values(**{"tip-moved.tension": -3.0, "tip-moved.time": 1.5})
    run = gtr.simulate(robot, [0.0, 20.0, 20.0, 20.0], time=[0.0, 1.0, 2.0, 3.0])
    pulled = 20 * np.exp(-0.5 * np.asarray(run.s))
    np.testing.assert_allclose(run.tension[1], pulled, rtol=1e-9)
    # A tendon that is pulled slips as a whole: it follows the base again at once.
    np.testing.assert_allclose(run.tension[3], pulled, rtol=1e-9)
    history = np.asarray([0.0, 20.0, 14.0, 14.0, 14.0])
    run = gtr.simulate(robot.with_values(**{"tip-moved.time": 2.5}), history, time=np.arange(5.0))
    T, s = np.asarray(run.tension), np.asarray(run.s)
    end = T[2, -1] - 3.0
    np.testing.assert_allclose(
        T[4], np.clip(T[2], 14 * np.exp(-0.5 * s), end * np.exp(0.5 * (1 - s))), rtol=1e-9
    )


@pytest.mark.parametrize("kind", ["presliding", "several"])
def test_an_end_that_nothing_holds_cannot_be_moved(kind):
    tug = {"tip-moved.tension": -1.0}
    if kind == "several":
        robot = gtr.load_robot(Path(__file__).parents[2] / "examples" / "antagonists.toml").with_values(**tug)
        T_base = np.ones((3, 2))
    else:
        robot, T_base = ours(tug | {"presliding.length": 1e-3}), np.ones(3)
    with pytest.raises(ValueError, match="tip-moved: needs one tendon, and friction that does not build up"):
        gtr.simulate(robot, T_base, time=np.arange(3.0))


def test_shaking_in_finer_steps_and_meshes_converges():
    """The first 0.7 s of a shaking, while the tendon relaxes within itself: the error is that of the mesh."""
    time = np.concatenate([np.linspace(0, 31, 63)[:-1], np.linspace(31, 31.7, 12)])
    T_base = np.interp(time, *np.asarray(HOLD, float).T)
    _, values = shaken(0.6, 31.0, 3.0, 1.0)
    meshes = (1.0, 2.0, 4.0, 8.0)
    *ends, finest = (float(gtr.simulate(ours(values, r), T_base, time=time).T_tip[-1]) for r in meshes)
    off = np.abs(np.asarray(ends) - finest)
    assert np.all(np.diff(off) < 0) and off[0] < 0.03 and off[-1] < 0.005


def test_a_peak_flows_apart_and_stays_apart():
    """A peak of tension that friction no longer holds flows apart: it falls, and the tip tension rises."""
    time, T_base = history(HOLD)
    _, values = shaken(0.2, 31.0, 3.0, 1.0)
    run = gtr.simulate(ours(values), T_base, time=time)
    before, after = (np.asarray(run.tension[round(at / DT)]) for at in (31.0, 33.0))
    assert after[-1] > before[-1] + 0.1 and after.max() < before.max() - 0.1
    assert after[0] == pytest.approx(before[0])
    # The rig is at rest on either side of the event.
    np.testing.assert_array_equal(run.T_tip[round(30 / DT)], run.T_tip[round(31 / DT)])
    np.testing.assert_allclose(run.T_tip[round(33 / DT)], run.T_tip[round(35.5 / DT)], rtol=1e-12)


@pytest.mark.parametrize("size", ["shaken-sheath.share", "sheath-moved.change", "tip-moved.tension"])
def test_an_event_without_size_changes_nothing(size):
    time, T_base = history(INNER)
    kind = size.partition(".")[0]
    found = gtr.simulate(ours({size: 0.0, f"{kind}.time": 39.0}), T_base, time=time, with_terms=[kind])
    plain = gtr.simulate(ours({}), T_base, with_terms=False)
    for name in ("T_tip", "tip_pose", "displacement", "tension"):
        np.testing.assert_allclose(getattr(found, name), getattr(plain, name), rtol=1e-10, atol=1e-12)


GRADIENTS = {
    name: CASES[name][1][1] for name in ("shaken in an inner loop", "shaken while it slips", "moved for less")
}
GRADIENTS["let go"] = {"tip-moved.tension": -2.0, "tip-moved.time": 31.0, "tip-moved.duration": 1.2}


@pytest.mark.parametrize("name", GRADIENTS)
@pytest.mark.slow
def test_gradients_of_events(name):
    values, corners = GRADIENTS[name], INNER if "inner" in name else HOLD
    time, T_base = (a[::2] for a in history(corners))
    # Off the samples, where an event begins between two of them.
    values = {k: v + (0.03 if k.endswith("time") else 0.0) for k, v in values.items()}
    robot = ours(values)
    at = values | {k: float(robot.value(k)) for k in ("mu", "E", "r1")}
    mix = np.random.default_rng(1).normal(size=(len(time), 2)) * np.asarray([1.0, 30.0])

    @jax.jit
    def total(numbers):
        run = gtr.simulate(
            robot.with_values(**numbers), T_base, time=time, solver=gtr.SolverOptions(atol=1e-12)
        )
        return jnp.sum(mix * jnp.stack([run.T_tip, run.tip_pose[:, 2]], axis=1))

    gradient = jax.jit(jax.grad(total))(at)
    for number, value in at.items():

        def slope(step, number=number, value=value):
            ends = [float(total(at | {number: value + way * step * abs(value)})) for way in (1, -1)]
            return (ends[0] - ends[1]) / 2 / step

        exact = (4 * slope(1e-6) - slope(2e-6)) / 3
        assert float(gradient[number]) * abs(value) == pytest.approx(exact, rel=1e-4, abs=1e-3), number


def test_clocks_that_drift_apart():
    """A cell at the tip whose clock runs slow: its sample k is taken at another time than the base's."""
    time, T_base = history(INNER)
    run = gtr.simulate(ours({}), T_base, time=time)
    late = {"time-skew.delay": 0.4, "time-skew.rate": 0.02}
    shown = np.asarray(gtr.reading(ours(late), run).T_tip)
    read = (1 - 0.02) * time - 0.4
    # Simulated where it is read: the tendon has the same history in any steps of time.
    at = np.unique(np.concatenate([time, read[read > 0]]))
    fine = gtr.simulate(ours({}), np.interp(at, time, T_base), time=at)
    exact = np.interp(read, at, np.asarray(fine.T_tip))
    away = np.abs(np.diff(T_base, 2, append=[0, 0])) > 1e-9  # a corner lies between two samples
    assert np.max(np.abs(shown - exact)) < 0.3 and np.median(np.abs(shown - exact)[~away]) < 1e-3
    # The two numbers are one where only one time is seen.
    early = np.asarray(gtr.reading(ours({"time-skew.delay": 0.4 + 0.02 * time[100]}), run).T_tip)
    assert early[100] == pytest.approx(shown[100], abs=1e-12)


def test_free_tendon_is_a_spring_ahead_of_the_channel():
    time, T_base = history(INNER)
    robot = gtr.load_robot(CONCEALED_ROBOT).with_values(preload=2.0)
    plain = gtr.simulate(robot, T_base, time=time)
    long = gtr.simulate(robot.with_values(**{"free-length.compliance": 3e-5}), T_base, time=time)
    np.testing.assert_array_equal(long.T_tip, plain.T_tip)
    np.testing.assert_array_equal(long.tip_pose, plain.tip_pose)
    # The work put in and not given back over a closed loop is the same: a spring takes none.
    spring = np.asarray(long.displacement - plain.displacement)
    np.testing.assert_allclose(spring, 3e-5 * (T_base - 2.0), atol=1e-15)
    pairs = itertools.pairwise(zip(T_base, spring, strict=True))
    work = sum(0.5 * (a[0] + b[0]) * (b[1] - a[1]) for a, b in pairs)
    assert work == pytest.approx(0.5 * 3e-5 * (T_base[-1] ** 2 - T_base[0] ** 2), abs=1e-12)


@pytest.mark.parametrize("rate, sticks", [(0.5, True), (8.0, False)])
def test_breakaway_lets_go_in_bursts(rate, sticks):
    """Stribeck friction is stick-slip where slip is slower than its speed, as on the elastic thread."""
    speed, ratio, step = 2e-4, 0.3, 0.25
    time = np.arange(0.0, 40 / rate, step)
    T_base = 2 + rate * time
    robot = ours({"stribeck-friction.ratio": ratio, "stribeck-friction.speed": speed})
    run = gtr.simulate(robot, T_base, time=time)
    law = machine.Laws(friction=lambda guides: 1 + ratio * np.exp(-((guides.speed / speed) ** 2)))
    thread = machine.march(dataclasses.replace(ARM, laws=law), time, T_base)

    def bursts(T_tip):
        jumps = np.diff(T_tip) > 2 * np.diff(T_base)
        return int(np.sum(jumps[1:] & ~jumps[:-1]))

    counts = [bursts(np.asarray(T_tip)) for T_tip in (run.T_tip, thread.T_tip)]
    if not sticks:
        assert max(counts) <= 1
        return
    assert min(counts) >= 8 and abs(counts[0] - counts[1]) <= 0.25 * max(counts)
    # Between the bursts it stands, with a tip tension between those of the two coefficients.
    low, high = (
        np.asarray(gtr.simulate(ours({}).with_values(mu=mu), T_base).T_tip) for mu in (0.3 * (1 + ratio), 0.3)
    )
    T_tip = np.asarray(run.T_tip)[8:]
    assert np.all(T_tip > low[8:] - 0.1) and np.all(T_tip < high[8:] + 0.1)
    assert np.mean(np.abs(np.diff(T_tip)) < 1e-3) > 0.5
