"""The base tension as an unknown: straight runs, their knots, and what noise in it passes on to the tip."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from benchmarks.coverage import Case, noisy, outcome, recorded
from calibrate.inference.coordinates import coordinates, places
from calibrate.inference.number import number_at
from calibrate.inference.predictor import Predictor
from calibrate.inference.weighing import Weighing
from gtr_jax.recordings.base_tension import (
    BaseTension,
    estimate_base,
    exact,
    sharpened,
    straighten,
    turning_points,
)
from gtr_jax.robot.parameters import parameter

HOLDS = np.concatenate(
    [
        np.linspace(0, 45, 250, endpoint=False),
        np.full(100, 45.0),
        np.linspace(45, 5, 250, endpoint=False),
        np.full(50, 5.0),
        np.linspace(5, 30, 200, endpoint=False),
        np.linspace(30, 0, 200),
    ]
)
CORNERS = (250, 350, 600, 650, 850)


def with_noise(T, sd, seed):
    return T + np.random.default_rng(seed).normal(0.0, sd, len(T))


@pytest.mark.parametrize("sd", [0.02, 0.1, 0.3])
def test_ramps_and_holds_are_found(sd):
    errors, peaks = [], []
    for seed in range(10):
        fit = straighten(with_noise(HOLDS, sd, seed), sd)
        assert fit.misfit / fit.degrees == pytest.approx(1.0, abs=0.15)
        assert len(fit.knots) <= 11
        near = np.min(np.abs(fit.knots[:, None] - np.asarray(CORNERS)), axis=0)
        assert np.all(near <= 2 + 30 * sd), "every corner has its knot"
        errors.append(np.sqrt(np.mean((fit.T_base - HOLDS) ** 2)))
        peaks.append(fit.T_base.max() - 45.0)
    assert np.mean(errors) < 0.3 * sd
    assert abs(np.mean(peaks)) < 0.4 * sd, "the highest of a hundred readings lies 2.5 sd above the hold"


def test_nothing_is_smoothed_that_is_not_straight():
    """A coarse staircase of uneven steps far above the noise keeps its readings."""
    T = np.cumsum(np.random.default_rng(2).uniform(1, 6, 12))
    T = np.concatenate([T, T[-2::-1] - 0.7])
    fit = straighten(with_noise(T, 0.02, 3), 0.02)
    assert np.max(np.abs(fit.T_base - T)) < 0.1
    jumps = np.random.default_rng(0).uniform(0, 40, 60)
    assert estimate_base(jumps).sd == 0.0
    np.testing.assert_array_equal(estimate_base(jumps).T_base, jumps)


def test_turning_points_ignore_noise():
    T = np.array([0, 1, 2, 1.9, 3, 4, 3.95, 4.05, 2, 1, 1.1, 0, 2, 5], float)
    assert turning_points(T, 0.5).tolist() == [0, 7, 11, 13]
    assert turning_points(T, 0.05).tolist() == [0, 2, 3, 7, 9, 10, 11, 13]
    assert turning_points(np.full(5, 2.0), 0.1).tolist() == [0, 4]
    assert turning_points(np.array([1.0, 2.0]), 0.1).tolist() == [0, 1]


@pytest.mark.parametrize("sd", [0.03, 0.1])
def test_its_noise_is_told(sd):
    found = [estimate_base(with_noise(HOLDS, sd, seed)) for seed in range(8)]
    assert np.mean([f.sd for f in found]) == pytest.approx(sd, rel=0.05)
    assert estimate_base(HOLDS, sd=0.0).sd == 0.0
    assert estimate_base(with_noise(HOLDS, sd, 0), sd=sd).sd == sd


def test_noise_that_hangs_together_counts_for_less():
    e = np.random.default_rng(1).normal(size=len(HOLDS))
    for k in range(1, len(e)):
        e[k] += 0.6 * e[k - 1]
    fit = estimate_base(HOLDS + 0.05 * e)
    assert fit.tau > 1.5
    assert np.all(fit.believed > 1.2 * fit.sd)


def test_straight_in_time_not_in_samples():
    time = np.cumsum(np.random.default_rng(4).uniform(0.1, 2.0, 300))
    T = 0.2 * time
    fit = straighten(with_noise(T, 0.05, 5), 0.05, time)
    assert len(fit.knots) == 2
    assert np.max(np.abs(fit.T_base - T)) < 0.03


@pytest.mark.parametrize("K", [2, 3, 4])
def test_few_samples(K):
    T = np.arange(float(K))
    for fit in (straighten(T, 0.1), exact(T), estimate_base(T)):
        np.testing.assert_allclose(fit.T_base, T, atol=1e-12)
        np.testing.assert_allclose(fit.at_samples(fit.T_base[fit.knots]), T, atol=1e-12)


def dense(fit: BaseTension) -> np.ndarray:
    return fit.at_samples(np.eye(len(fit.knots)))


def test_the_sums_are_those_of_the_matrices():
    fit = straighten(with_noise(HOLDS, 0.1, 0), 0.1)
    B, rng = dense(fit), np.random.default_rng(0)
    rows, samples = rng.normal(size=(40, 3)), rng.integers(0, len(HOLDS), 40)
    np.testing.assert_allclose(fit.to_knots(rows, samples), B[samples].T @ rows, atol=1e-12)
    weight = rng.uniform(1, 2, 40)
    full = B[samples].T @ (weight[:, None] * B[samples])
    bands = fit.information(weight, samples)
    for offset in range(4):
        np.testing.assert_allclose(bands[3 - offset, offset:], np.diag(full, offset), atol=1e-12)
    assert not np.any(np.triu(full, 4))


def test_weighed_squares_are_those_of_the_full_covariance():
    """|W r|^2 = r' C^-1 r with C = sd_tip^2 + G B (B'B)^-1 B' G' sd_base^2."""
    rng = np.random.default_rng(0)
    fit = straighten(with_noise(HOLDS, 0.1, 0), 0.1)
    K = len(HOLDS)
    slips = (np.arange(K) < 260) | ((np.arange(K) > 500) & (np.arange(K) < 640))
    last = np.maximum.accumulate(np.where(slips, np.arange(K), 0))
    slope = rng.uniform(0.3, 0.6, K)[last]
    weigh = dataclasses.replace(
        Weighing.plain(fit, ("T_tip",), np.array([0.05])), slope=slope[None], last=last[None], sd_base=0.1
    )
    B = dense(fit)
    passed = slope[:, None] * B[last]
    C = 0.05**2 * np.eye(K) + 0.1**2 * passed @ np.linalg.solve(B.T @ B, passed.T)
    r = rng.normal(size=(K, 2))
    weighed = weigh(r[None])
    np.testing.assert_allclose(weighed.T @ weighed, r.T @ np.linalg.solve(C, r), rtol=1e-8)
    assert weigh(r[None, :, 0]).shape == (2 * K,)
    told = np.linalg.slogdet(C / 0.05**2)[1]
    np.testing.assert_allclose(weigh.log_determinant, told, rtol=1e-8)
    half = weigh.only(np.arange(K) < 300)
    np.testing.assert_allclose(half.log_determinant, np.linalg.slogdet(C[:300, :300] / 0.05**2)[1], rtol=1e-8)
    np.testing.assert_allclose(
        np.sum(half(r[None, :, 0]) ** 2), r[:300, 0] @ np.linalg.solve(C[:300, :300], r[:300, 0]), rtol=1e-8
    )
    exactly = Weighing.plain(exact(HOLDS), ("T_tip",), np.array([0.05]))
    np.testing.assert_allclose(exactly(r[None, :, 0])[:K], r[:, 0] / 0.05)
    assert exactly.log_determinant == 0.0


def test_slope_is_that_of_the_base_tension_last_followed(make_robot):
    robot = make_robot()
    at = coordinates(places(robot, ["mu"]), [number_at(parameter(robot, "mu"), float(robot.value("mu")))])
    T_base = np.concatenate([np.linspace(0, 40, 21), np.linspace(40, 2, 20)[1:]])
    found = Predictor(robot, at, T_base)(np.zeros(1))
    assert found is not None
    last = np.maximum.accumulate(np.where(found.slips, np.arange(len(T_base)), 0))
    for k in (10, 25, 38):
        up, down = (np.array(T_base) for _ in range(2))
        up[last[k]] += 1e-4
        down[last[k]] -= 1e-4
        tips = [float(gtr.simulate(robot, T).T_tip[k]) for T in (up, down)]
        assert found.slopes[0][0, k] == pytest.approx((tips[0] - tips[1]) / 2e-4, rel=1e-5)


def test_noise_in_the_base_is_not_taken_for_friction():
    case = Case("coulomb", 0.1, 0.05)
    config, run = recorded(case)
    fit = calibrate.fit(config, noisy(case, run, 0))
    assert fit.noise_base_N == pytest.approx(0.1, rel=0.15)
    assert fit["mu"].value == pytest.approx(0.3, rel=0.01)
    assert fit.chi2_per_n == pytest.approx(1.0, abs=0.2)
    assert np.sqrt(np.mean((fit.T_base - run.T_base) ** 2)) < 0.05
    trusting = calibrate.fit(config, noisy(case, run, 0), noise_base_N=0.0)
    assert trusting.noise_base_N == 0.0
    np.testing.assert_array_equal(trusting.T_base, noisy(case, run, 0).T_base)
    assert trusting.chi2_per_n is not None and trusting.chi2_per_n > 2


def test_a_noise_far_above_the_recordings_is_warned_of():
    case = Case("coulomb", 0.05, 0.05)
    config, run = recorded(case)
    fit = calibrate.fit(config, noisy(case, run, 0), free=("mu",), noise_base_N=2.0)
    assert any("far above the 0.05" in text for text in fit.warnings)


@pytest.mark.parametrize("value", [-1.0, np.nan])
def test_bad_noise_of_the_base(make_config, value):
    recording = dataclasses.replace(recorded(Case("coulomb", 0.1, 0.05))[1])
    with pytest.raises(gtr.InputError, match="noise_base_N"):
        calibrate.fit(make_config(), recording, noise_base_N=value)


@pytest.mark.slow
def test_unbiased_and_covered_at_a_hundred_draws():
    """The independent simulator's run, noise of 0.1 N at the base and 0.05 N at the tip."""
    found = outcome(Case("coulomb", 0.1, 0.05), 100)
    assert abs(found.bias) < 0.01
    assert 0.90 <= found.coverage <= 0.985
    assert found.standard_error == pytest.approx(found.scatter, rel=0.25)
    assert found.chi2 == pytest.approx(1.0, abs=0.1)
    trusting = outcome(Case("coulomb", 0.1, 0.05), 30, trust_base=True)
    assert trusting.coverage < 0.85 and abs(trusting.bias) > 3 * abs(found.bias)


def test_profiles_are_parabolas_where_the_fit_is_regular_and_hold_the_interval():
    case = Case("coulomb", 0.1, 0.05)
    config, run = recorded(case)
    fit = calibrate.fit(config, noisy(case, run, 0), profiled=True)
    assert set(fit.profiles) == {"mu", "E"}
    for name, profile in fit.profiles.items():
        estimate = fit[name]
        assert estimate.sd is not None and profile.lower95 is not None and profile.upper95 is not None
        ends = [estimate.lower95, estimate.upper95]
        assert [profile.lower95, profile.upper95] == pytest.approx(ends, abs=0.25 * estimate.sd)
        np.testing.assert_allclose(profile.rise, profile.parabola, atol=0.5)
        assert np.min(profile.rise) > -0.05, "nothing fits better than the fit"
        assert np.all(np.diff(profile.values) > 0)
    plain = fit.to_json()["profiles"]["mu"]
    assert set(plain) == {"values", "rise", "parabola", "lower95", "upper95"}


def test_profile_of_a_trade_off_is_wider_than_one_parameter_alone():
    """mu is known far better where E is known than beside it; the profile says so too."""
    case = Case("coulomb", 0.05, 0.05)
    config, run = recorded(case)
    both = calibrate.fit(config, noisy(case, run, 2), profiled=True).profiles["mu"]
    exactly = config.without_deviations(config.uncertainty)
    alone = calibrate.fit(exactly, noisy(case, run, 2), free=("mu",), profiled=True).profiles["mu"]
    assert both.lower95 and both.upper95 and alone.lower95 and alone.upper95
    assert both.upper95 - both.lower95 > 1.5 * (alone.upper95 - alone.lower95)


def swing(period, count, high=40.0):
    return 0.5 * high * (1 - np.cos(2 * np.pi * np.arange(count) / period))


STAIR = np.concatenate([np.repeat(np.arange(0, 41, 2.5), 10), np.repeat(np.arange(40, -1, -2.5), 10)])
SMALL = 4.0 - np.abs(4.0 - np.linspace(0, 16, 401) % 8)
HISTORIES = {"swing": swing(100, 350), "slow swing": swing(300, 1050), "stair": STAIR, "small": SMALL}


@pytest.mark.parametrize("name", HISTORIES)
def test_noise_is_told_from_the_tension_of_any_rig(name):
    """0.1 N of noise on both a ramp and what is none: found, and friction with it."""
    config, _ = recorded(Case("coulomb", 0.1, 0.05))
    T_base = HISTORIES[name]
    T_tip = np.asarray(gtr.simulate(gtr.build_robot(config), T_base).T_tip)
    far, chi2 = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noisy_base, noisy_tip = (T + rng.normal(0, sd, len(T)) for T, sd in ((T_base, 0.1), (T_tip, 0.05)))
        run = gtr.Recording(np.round(noisy_base, 2), Path("r.csv"), "", T_tip=np.round(noisy_tip, 2))
        fit = calibrate.fit(config, run, free=("mu",))
        assert fit.noise_base_N == pytest.approx(0.1, rel=0.25)
        assert fit.noise_N == pytest.approx(0.05, rel=0.25)
        assert fit["mu"].sd is not None and "to its noise" in fit.verdict
        far.append((fit["mu"].value - 0.3) / fit["mu"].sd)
        chi2.append(fit.chi2_per_n)
    assert abs(np.mean(far)) < 1.5 and np.max(np.abs(far)) < 3.5
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.25)


def test_a_swing_takes_few_numbers():
    T = with_noise(swing(300, 1050), 0.1, 0)
    fit = estimate_base(T)
    assert fit.size < 45 and not fit.corner.all()
    assert np.sqrt(np.mean((fit.T_base - swing(300, 1050)) ** 2)) < 0.03
    nodes = fit.nodes(0.2)
    turns = 1 + np.flatnonzero(np.diff(fit.T_base)[1:] * np.diff(fit.T_base)[:-1] < 0)
    assert set(turns.tolist()) <= set(nodes.tolist()), "between nodes the tension does not turn"


def test_noise_of_the_base_cell_is_not_taken_from_the_tips():
    config, _ = recorded(Case("coulomb", 0.1, 0.05))
    ramp = np.linspace(0, 40, 300)
    T_tip = with_noise(np.asarray(gtr.simulate(gtr.build_robot(config), ramp).T_tip), 0.05, 1)
    run = gtr.Recording(with_noise(ramp, 0.1, 2), Path("r.csv"), "", T_tip=T_tip)
    fit = calibrate.fit(config, run, free=("mu",))
    assert fit.noise_N == pytest.approx(0.05, rel=0.2)
    assert fit.chi2_per_n == pytest.approx(1.0, abs=0.3)


def test_readings_that_jump_about_are_taken_as_exact_and_it_is_said():
    config, _ = recorded(Case("coulomb", 0.1, 0.05))
    rng = np.random.default_rng(3)
    T_base = rng.uniform(5, 40, 120)
    T_tip = with_noise(np.asarray(gtr.simulate(gtr.build_robot(config), T_base).T_tip), 0.05, 1)
    fit = calibrate.fit(config, gtr.Recording(T_base, Path("r.csv"), "", T_tip=T_tip), free=("mu",))
    assert fit.noise_base_N == 0.0
    assert any("taken as exact" in text for text in fit.warnings)
    np.testing.assert_array_equal(fit.T_base, T_base)


def test_some_samples_say_of_the_base_tension_what_all_do():
    rng = np.random.default_rng(5)
    true = np.concatenate([np.linspace(0, 40, 80), np.linspace(40, 5, 70)[1:], np.linspace(5, 30, 60)[1:]])
    fit = straighten(true + 0.1 * rng.normal(size=len(true)), 0.1)
    kept = np.unique(np.concatenate([fit.knots, np.arange(0, len(true), 3)]))
    some = fit.only(kept)
    assert some.size == fit.size and np.allclose(some.T_base, fit.T_base[kept])
    assert np.allclose(some.at_samples(np.ones(some.size)), 1.0)
    # The information about the numbers, all samples counted, stays what it was.
    whole = fit.information(fit.believed**-2)[-1]
    part = some.information(some.believed**-2)[-1]
    assert np.all(np.abs(np.log(part / whole)) < 0.7)
    # Too few samples of some run: each that is left is a number of its own (test_disturbances.py).
    assert fit.only(np.arange(60)).size == 60


def test_the_tip_tells_where_a_base_tension_bends():
    # A step smaller than the base cell's noise is not seen by it; the tip follows it.
    rng = np.random.default_rng(6)
    true = np.interp(np.arange(120), [0, 50, 55, 75, 119], [0.0, 40.0, 39.7, 39.7, 5.0])
    read = true + 0.25 * rng.normal(size=120)
    fit = straighten(read, 0.25)
    sharper = sharpened(fit, read, true + 0.02 * rng.normal(size=120), 0.02)
    assert len(sharper.knots) > len(fit.knots)
    around = slice(46, 60)
    off, sharp = (np.sqrt(np.mean((f.T_base - true)[around] ** 2)) for f in (fit, sharper))
    assert sharp < 0.7 * off
    # The values are still what the cell says: they do not follow an estimate that is off by a constant.
    shifted = sharpened(fit, read, true + 3.0 + 0.02 * rng.normal(size=120), 0.02)
    assert abs(np.mean(shifted.T_base - true)) < 0.15


def swings(rng):
    """Slow ramps that a motor shakes now and then: a base tension that bends between samples, (3000,)."""
    t = np.arange(3000) / 50
    T = np.interp(t, np.linspace(0, t[-1], 12), rng.uniform(-4, 6, 12))
    for start in np.sort(rng.uniform(0, t[-1], 7)):
        size, rate = rng.uniform(-6, 6), rng.uniform(6, 15)
        T += np.where(t > start, size * np.exp(-(t - start) * 2.0) * np.sin(rate * (t - start)), 0.0)
    return 5 + T


def test_quick_swings_are_known_better_than_their_readings():
    left, sd = [], 0.02
    for seed in range(5):
        T = swings(np.random.default_rng(seed))
        fit = estimate_base(with_noise(T, sd, seed))
        turns = 1 + np.flatnonzero(np.diff(np.sign(np.diff(T))) != 0)
        assert fit.sd == pytest.approx(sd, rel=0.05)
        left.append([np.sqrt(np.mean((fit.T_base - T)[i] ** 2)) for i in (slice(None), turns)])
    every, where_it_turns = np.mean(left, axis=0) / sd
    assert every < 0.5
    assert where_it_turns < 1.15, "what friction holds is decided there"


def test_bends_at_samples_stay_there():
    T = np.tile(HOLDS, 12)
    for seed in range(3):
        fit = straighten(with_noise(T, 0.1, seed), 0.1)
        # Of 72 sharp bends some have a knot on either side, when the first misses by a sample.
        assert len(fit.knots) < 1.5 * 72
        assert np.sqrt(np.mean((fit.T_base - T) ** 2)) < 0.03
