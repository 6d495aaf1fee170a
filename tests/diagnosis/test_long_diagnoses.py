"""Long recordings: their samples, heavy tails, and what instruments add beside every hypothesis."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from test_episodes import SHEATH, K, likelihood_of, part

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.hypotheses.hypotheses import (
    INSTRUMENT_NUMBERS,
    instrument_numbers,
    zero_drift,
)
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.diagnosis.outside.episodes import AFTER_GAP, episodes
from calibrate.diagnosis.outside.leave_out import from_outside
from calibrate.fitting.fit import part_of
from calibrate.inference.samples import MOST, corners, some_samples
from calibrate.inference.simulated_rig import SimulatedRig
from gtr_jax import Recording
from gtr_jax.config.config import parse_config
from gtr_jax.recordings.base_tension import exact

CONFIG = parse_config(SHEATH)


def by_hand(samples: int, **values: float) -> Recording:
    """A sheath pulled by hand: swings of all sizes; what both cells show at 40 Hz."""
    rng = np.random.default_rng(3)
    time = np.arange(samples) / 40.0
    knots = np.arange(0, time[-1] + 1, 0.6)
    T = np.interp(time, knots, 8 + 3 * np.sin(knots / 4) + rng.normal(scale=2.0, size=len(knots)))
    T = np.maximum(T, 0.2) * np.minimum(time / 5, 1) + 0.05
    robot = gtr.build_robot(CONFIG).with_values(**{"mu": 0.07, **values})
    run = gtr.simulate(robot, T, time=time)
    shown = np.asarray(run.reading.T_tip) + 0.01 * rng.normal(size=samples)
    base = T + 0.01 * rng.normal(size=samples)
    return Recording(T_base=base, path=Path("hand.csv"), sha256="", T_tip=shown, time=time)


def test_corners_are_those_of_the_curve():
    t = np.arange(101.0)
    T = np.interp(t, [0, 30, 31, 70, 100], [0, 6, 2, 9, 9])
    assert corners(t, T, 50).tolist()[:1] == [0] and corners(t, T, 50).tolist()[-1] == 100
    assert set(corners(t, T, 5)) == {0, 30, 31, 70, 100}
    assert len(corners(t, T, 3)) == 3
    # Between as many as are asked for, the curve is as straight as it can be.
    rng = np.random.default_rng(0)
    wild = np.cumsum(rng.normal(size=len(t)))
    off = [
        np.max(np.abs(np.interp(t, t[k], wild[k]) - wild)) for k in (corners(t, wild, n) for n in (5, 20, 60))
    ]
    assert off[0] > off[1] > off[2]


def test_few_samples_give_nearly_what_all_give():
    recording = by_hand(4000)
    robot = gtr.build_robot(CONFIG)
    whole, _ = part_of("hand", robot, CONFIG, recording, ("T_tip",), noise_N=None, noise_base_N=0.01)
    values = {"mu": 0.07, "time-skew.delay": 0.01}
    all_of_it = SimulatedRig(whole, robot)(values)
    kept = some_samples(whole, 140)
    assert 300 < len(kept) <= 5 * 140 and kept[0] == 0 and kept[-1] == 3999
    assert len(some_samples(whole, 1200)) <= MOST
    few = SimulatedRig(whole.only(kept), robot)(values)
    evenly = np.unique(np.linspace(0, 3999, len(kept)).astype(int))
    plain = SimulatedRig(whole.only(evenly), robot)(values)
    assert all_of_it is not None and few is not None and plain is not None
    off = np.sqrt(np.mean((few.values[0] - all_of_it.values[0, kept]) ** 2))
    even = np.sqrt(np.mean((plain.values[0] - all_of_it.values[0, evenly]) ** 2))
    assert off < 0.03 and off < 0.3 * even


def test_heavy_tails_count_far_readings_a_little_more():
    rows = np.asarray([-30.0, -1e-3, 0.0, 1e-3, 0.5, 4.0, 30.0])
    assert Likelihood((), ()).robustify(rows) is rows
    c = 4.0
    robustify = Likelihood((), (), heavy=c).robustify(rows)
    np.testing.assert_allclose(robustify**2, c**2 * np.log1p(rows**2 / c**2))
    assert np.all(np.sign(robustify) == np.sign(rows)) and np.all(np.diff(robustify) > 0)
    assert robustify[3] == pytest.approx(1e-3, rel=1e-6) and robustify[-1] < 9


def test_an_episode_behind_a_gap_says_so_and_is_no_event():
    row = np.zeros(K)
    row[100:140] = 0.8
    plain = part()
    time = plain.time + np.where(np.arange(K) >= 100, 7.0, 0.0)
    gapped = dataclasses.replace(plain, time=time)
    (found,) = episodes(*likelihood_of(gapped, row))  # type: ignore[arg-type]
    assert found.kind == AFTER_GAP and "after a gap" in found.says
    (other,) = episodes(*likelihood_of(plain, row))  # type: ignore[arg-type]
    assert other.kind != AFTER_GAP
    stretches = from_outside([found], {"rig": 10 * K}, {"rig": []})
    assert stretches is not None and not stretches["rig"][0].outside
    stretches = from_outside([other], {"rig": 10 * K}, {"rig": []})
    assert stretches is not None and stretches["rig"][0].outside


def test_what_instruments_add_is_little_and_zeros_are_read_while_slack():
    time = np.linspace(0.0, 100.0, 2001)
    T = np.maximum(8 * np.sin(time / 4), 0.0)
    assert zero_drift(time, T) == 0.0
    assert zero_drift(time, T + 1e-3 * time) == pytest.approx(1e-3, rel=0.05)
    assert zero_drift(time, T + 3.0) is None  # never slack
    own = dataclasses.replace(part(), T_base=exact(T[:K]), recorded=0.5 * T[None, :K], time=time[:K])
    numbers = {n.name: n for n in instrument_numbers(own)}
    assert set(numbers) == INSTRUMENT_NUMBERS and not any(n.size for n in numbers.values())
    drift = numbers["zero-drift.tip"]
    low, high = drift.bounds
    assert drift.value(low) == pytest.approx(-drift.value(high)) and high < 4
    assert np.ptp(time[:K]) * drift.value(high) < 0.01 * 8  # N in the whole recording


@pytest.mark.slow
def test_a_delay_and_a_drift_are_no_missing_physics_and_hide_none():
    recording = by_hand(3000, **{"time-skew.delay": 0.012, "zero-drift.tip": 1e-3})
    found = calibrate.diagnose(CONFIG, recording, experiment=False)
    assert found.verdict == "adequate" and found.named == [], found.says
    told = {c.name: c for c in found.instruments}
    assert told["time-skew.delay"].after == pytest.approx(0.012, abs=1e-3)
    assert told["zero-drift.tip"].after == pytest.approx(1e-3, abs=2e-4)
    assert "time-skew.delay" in found.says and found.rms[1] < 0.015 < found.rms[0]
    wears = by_hand(3000, **{"time-skew.delay": 0.012, "friction-drift.rate": -5e-3})
    found = calibrate.diagnose(CONFIG, wears, experiment=False)
    assert found.verdict == "missing-physics" and found.named == ["friction-drift"], found.says
    assert {c.name for c in found.instruments} == INSTRUMENT_NUMBERS
