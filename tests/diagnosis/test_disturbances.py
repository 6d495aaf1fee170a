"""Events from outside found from readings, slow noise of a cell, and what a thinned recording stands for."""

import dataclasses
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rigs import pulled, ramps

from calibrate.diagnosis.decision.decide import least_drop
from calibrate.diagnosis.likelihood.likelihood import without_zero
from calibrate.diagnosis.likelihood.recording_length import LongRecordings, ShortRecordings
from calibrate.diagnosis.outside.disturbances import FEW, behind_gaps, disturbances, within
from calibrate.diagnosis.outside.leave_out import ASKED, Stretch, without
from calibrate.inference.setup import Observation
from calibrate.inference.weighing import Weighing
from gtr_jax.recordings.base_tension import estimate_base, straighten, with_slow_noise
from gtr_jax.recordings.base_tension.slow import NONE, slow_noise

RATE = 50.0
NOISE = 0.02


def history() -> tuple[np.ndarray, np.ndarray]:
    """Three pulls and releases with rests: time [s] and base tension [N]."""
    cycle = ((0.0, 4.0), (30.0, 6.0), (30.0, 3.0), (10.0, 4.0), (25.0, 3.0), (0.0, 6.0))
    return ramps(*cycle, *cycle, *cycle, (0.0, 4.0), rate=RATE)


def moved(T_base: np.ndarray, time: np.ndarray, events: Sequence[tuple[float, float]]) -> np.ndarray:
    """Tip tension of a sheath of fixed shape; at each event its end is moved, so that it changes by so much
    [N] within 0.1 s and the tendon stays there until it slips again.
    """
    low, high, tip, found = np.exp(-0.5), np.exp(0.5), float(T_base[0]), []
    for k, base in enumerate(T_base.tolist()):
        for at, size in events:
            if at <= time[k] < at + 0.1:
                tip += size / (0.1 * RATE)
                high, low = np.inf, 0.0
            elif at + 0.1 <= time[k] < at + 0.2:
                high, low = np.exp(0.5), np.exp(-0.5)
        tip = min(max(tip, base * low), base * high)
        found.append(tip)
    return np.asarray(found)


def made(tip: np.ndarray, T_base: np.ndarray, time: np.ndarray, seed: int = 0) -> tuple[Observation, Any]:
    """A recording, and what a model without the events simulates of it."""
    rng = np.random.default_rng(seed)
    base = estimate_base(T_base + NOISE * rng.normal(size=len(time)), time)
    robot = SimpleNamespace(tendons=[SimpleNamespace(name="", drive="tension")])
    part = Observation(
        name="rig",
        path="rig.csv",
        robot=cast("Any", robot),
        config=None,
        T_base=base,
        channels=("T_tip",),
        recorded=(tip + NOISE * rng.normal(size=len(time)))[None],
        time=time,
        trial=None,
        noise_N=None,
    )
    plain = pulled(T_base)
    low, high = np.isclose(plain, T_base * np.exp(-0.5)), np.isclose(plain, T_base * np.exp(0.5))
    seen = SimpleNamespace(values=plain[None], slips=low | high, direction=np.where(low, 1.0, -1.0))
    return part, seen


def found_in(events: Sequence[tuple[float, float]], seed: int = 0) -> tuple[list[Stretch], np.ndarray]:
    time, T_base = history()
    part, seen = made(moved(T_base, time, events), T_base, time, seed)
    slope = np.where(seen.direction > 0, np.exp(-0.5), np.exp(0.5))
    return disturbances(part, part, seen, slope), time


def test_a_sound_recording_has_no_disturbances():
    for seed in range(10):
        assert found_in([], seed)[0] == []


@pytest.mark.parametrize("size", [-4.0, 3.0])
def test_a_moved_tip_is_found_and_left_out_until_it_is_forgotten(size):
    found, time = found_in([(11.5, size)])
    (only,) = found
    assert only.outside and "T_tip goes from" in only.why and only.why.startswith("11.")
    start, end = time[only.first], time[only.last]
    assert 10.9 < start <= 11.5
    # The first release takes the tip along again: it begins at 13 s.
    plain, real = pulled(history()[1]), moved(history()[1], time, [(11.5, size)])
    forgotten = time[np.flatnonzero(np.abs(plain - real) > 0.05)[-1]]
    assert forgotten - 0.3 < end < forgotten + 1.0


def test_what_happens_all_the_time_is_a_law():
    events = [(t, 1.5) for t in np.arange(10.2, 12.8, 0.65)] + [(t, 1.5) for t in (37.0, 38.0, 63.0, 64.0)]
    assert len(events) > FEW
    assert len(found_in(events)[0]) <= FEW


def test_a_tip_that_catches_up_is_no_event():
    """Static friction above the sliding one: the tip stays behind and jumps onto the sliding branch."""
    time, T_base = history()
    tip, found, held = 0.0, [], True
    for base in T_base.tolist():
        low, high = base * np.exp(-0.5), base * np.exp(0.5)
        static = base * np.exp(0.7)
        if tip > static or (not held and tip > high):
            tip, held = high, False
        elif tip < low:
            tip, held = low, False
        else:
            held = True
        found.append(tip)
    part, seen = made(np.asarray(found), T_base, time)
    slope = np.where(seen.direction > 0, np.exp(-0.5), np.exp(0.5))
    assert disturbances(part, part, seen, slope) == []


def test_clocks_that_are_apart_or_coarse_and_what_is_left_out_already():
    time, T_base = history()
    late = np.interp(time - 0.12, time, pulled(T_base))
    part, seen = made(late, T_base, time)
    slope = np.where(seen.direction > 0, np.exp(-0.5), np.exp(0.5))
    assert disturbances(part, part, seen, slope, delay=0.12) == []
    # A clock that counts tenths of seconds only.
    part, seen = made(moved(T_base, time, [(11.5, -4.0)]), T_base, time)
    coarse = dataclasses.replace(part, time=np.floor(time / 0.1) * 0.1)
    (only,) = disturbances(coarse, coarse, seen, slope)
    assert 10.8 < time[only.first] <= 11.5
    assert behind_gaps(coarse, coarse, seen) == []
    still = dataclasses.replace(part, time=np.zeros(len(time)))
    assert disturbances(still, still, seen, slope) == behind_gaps(still, still, seen) == []
    # What is left out already is not found again.
    out = without(part, [Stretch(540, 700, ASKED)])
    assert disturbances(out, out, seen, slope) == []
    narrowly = without(part, [Stretch(575, 582, ASKED)])
    assert disturbances(narrowly, narrowly, seen, slope) == []


def test_no_more_is_left_out_than_a_share():
    stretches = [Stretch(0, 99, "a"), Stretch(90, 149, "b"), Stretch(400, 599, "c"), Stretch(700, 720, "d")]
    assert within(stretches, 1000) == [Stretch(0, 149, "a; b"), Stretch(700, 720, "d")]
    assert within(stretches, 2000)[1] == Stretch(400, 599, "c")


def test_behind_a_move_of_the_tip_displacements_are_counted_anew():
    time, T_base = history()
    part, _ = made(pulled(T_base), T_base, time)
    part = dataclasses.replace(
        part, channels=("T_tip", "displacement"), recorded=np.stack([part.T_tip, 0.01 + 0 * part.T_tip])
    )
    assert without(part, [Stretch(100, 120, ASKED)]).since is None
    out = without(part, [Stretch(100, 120, "moved", outside=True)])
    assert out.since is not None and out.since[120] == 0 and out.since[121] == 1
    residual = np.where(np.arange(len(time)) > 110, 3e-3, 1e-3) * np.ones((2, 1))
    left = without_zero(out, residual, out.counted)
    np.testing.assert_array_equal(left[0], residual[0])
    assert np.all(np.abs(left[1, out.counted]) < 1e-15)
    # The same where residuals are weighed.
    weigh = Weighing.plain(out.T_base, out.channels, np.asarray([0.02, 1e-4]))
    weigh = dataclasses.replace(weigh, since=out.since).only(out.counted)
    assert np.all(np.abs(weigh.centred(residual)[1, out.counted]) < 1e-15)
    assert np.all(np.abs(dataclasses.replace(weigh, since=None).centred(residual)[1, out.counted]) > 1e-5)
    thin = out.only(np.arange(0, len(time), 7))
    np.testing.assert_array_equal(thin.since, out.since[::7])


def test_slow_noise_is_measured_where_the_rig_rests():
    time, T_base = history()
    for slow in (0.0, 0.015):
        found = []
        for seed in range(12):
            rng = np.random.default_rng(seed)
            e, keep = rng.normal(size=len(time)), np.exp(-1 / (0.6 * RATE))
            for k in range(1, len(e)):
                e[k] = keep * e[k - 1] + np.sqrt(1 - keep**2) * e[k]
            read = T_base + NOISE * rng.normal(size=len(time)) + slow * e
            base = with_slow_noise(straighten(read, NOISE, time), read, time)
            found.append(base.slow)
            assert (base.slow == 0) or np.all(base.believed > 0.9 * base.slow)
        assert np.median(found) == pytest.approx(slow, rel=0.35, abs=1e-9)
    assert slow_noise(read, time, np.zeros(len(time), bool)) == NONE
    assert with_slow_noise(base, read, None) is base


def test_a_sample_stands_for_the_recorded_ones_around_it():
    time, T_base = history()
    rng = np.random.default_rng(0)
    base = straighten(T_base + 0.05 * rng.normal(size=len(time)), 0.05, time)
    # Every sample of the first rest and a few of what follows.
    kept = np.unique(np.concatenate([np.arange(190), base.knots, np.arange(190, len(time), 40)]))
    thin = base.only(kept)
    assert thin.size == base.size and thin.stands_for.sum() == len(time)
    assert np.all(thin.believed[:180] == base.believed[:180])
    assert np.median(thin.believed[200:]) < 0.3 * base.sd
    # Averages of slow noise fall less.
    slow = dataclasses.replace(thin, slow=0.02, lasts=30.0)
    assert np.all(slow.believed**2 > thin.believed**2 + 0.05 * 0.02**2)
    # Knots that the samples do not determine: each sample has the error that all samples leave of it, more
    # where it shares its run with others.
    at = np.arange(0, len(time), 317)
    few = base.only(at)
    assert few.size == len(few.T_base) and few.sd == base.sd
    B = _dense(base)
    within = np.linalg.inv(B.T @ B) * base.sd**2
    run = np.searchsorted(base.knots, at, side="right")
    shared = np.bincount(run)[run]
    expected = shared * np.einsum("ki,ij,kj->k", B[at], within, B[at])
    np.testing.assert_allclose(few.believed**2, expected, rtol=1e-6)
    # What one sample may be off by is no more than all of its noise.
    slow = dataclasses.replace(base, slow=0.05, lasts=30.0)
    assert (
        np.all(slow.error <= np.hypot(base.believed, 0.05) * (1 + 1e-12))
        and slow.error.max() < slow.believed.max()
    )


def _dense(base) -> np.ndarray:
    return base.at_samples(np.eye(base.size))


def test_what_follows_a_gap_is_left_out_until_it_is_forgotten():
    time, T_base = history()
    part, seen = made(pulled(T_base), T_base, time)
    # A gap while the load rises, one while it stands, and one while the tendon is slack.
    kept = np.ones(len(time), bool)
    for start, end in ((7.0, 8.0), (11.3, 11.8), (27.2, 28.0)):
        kept &= (time < start) | (time > end)
    rows = np.flatnonzero(kept)
    gappy = dataclasses.replace(part.only(rows), origin=None)
    thin = SimpleNamespace(
        values=seen.values[:, rows], slips=seen.slips[rows], direction=seen.direction[rows]
    )
    (only,) = behind_gaps(gappy, gappy, cast("Any", thin))
    assert not only.outside and "a gap of 1 s" in only.why
    assert 8.0 <= time[rows][only.first] < 8.1 and time[rows][only.last] < 8.3
    assert behind_gaps(part, part, cast("Any", seen)) == []


def test_what_has_to_be_gained_grows_with_a_long_recording():
    part = SimpleNamespace(explained=1, counted=np.ones(3000, bool))
    long, short = (
        SimpleNamespace(likelihood=SimpleNamespace(rigs=[SimpleNamespace(part=part)], rules=rules))
        for rules in (LongRecordings(), ShortRecordings())
    )
    assert least_drop(cast("Any", long)) == pytest.approx(90.0)
    assert least_drop(cast("Any", short)) == 36.0
