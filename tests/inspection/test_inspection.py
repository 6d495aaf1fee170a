"""What an inspection says of recordings whose truth is known."""

import json
from pathlib import Path

import numpy as np
import pytest
from rigs import CYCLE, MU_THETA, REST, pulled, ramps, recorded, recording

from gtr_jax.errors import InputError
from gtr_jax.inspection.inspection import inspect
from gtr_jax.inspection.mapping import Mapping
from gtr_jax.inspection.noise import noise, resolution
from gtr_jax.inspection.report.figures import close_up, plot_channels
from gtr_jax.inspection.report.inspection import inspection_report
from gtr_jax.inspection.sampling import sampling
from gtr_jax.inspection.slip import PULLING, RELEASING, TRANSITION
from gtr_jax.inspection.still import still
from gtr_jax.recordings.recording import read_recording, write_recording
from gtr_jax.recordings.signals.differences import from_differences
from gtr_jax.recordings.signals.stretches import runs
from gtr_jax.recordings.signals.turning import MOST, extremes, turning_points, turns_of_long

THREE = ramps(REST, *CYCLE, *CYCLE, *CYCLE)


def says(found, severity=None):
    """All findings as one text."""
    return " ".join(f.says for f in found.findings if severity in (None, f.severity))


# Sampling


def test_the_clock_is_described():
    time = np.arange(1000) / 50.0
    time[600:] += 1.0
    time[800] = time[799]
    found = sampling(time, 1000)
    assert found.rate_Hz == pytest.approx(50.0)
    assert found.duration_s == pytest.approx(20.98)
    assert [(g.first, g.last) for g in found.gaps] == [(599, 600)]
    assert found.missing_s == pytest.approx(1.0)
    assert (found.repeated, found.reversed, found.reversed_at) == (1, 0, None)
    assert found.jitter == pytest.approx(0.0, abs=1e-9)


def test_stamps_that_run_backwards_are_counted():
    time = np.arange(100) / 10.0
    time[50] = 4.0
    found = sampling(time, 100)
    assert (found.reversed, found.reversed_at) == (1, 50)
    assert found.rate_Hz == pytest.approx(10.0)


def test_jitter_is_half_the_spread_of_most_steps():
    steps = np.tile([0.008, 0.012, 0.012, 0.016], 200)
    assert sampling(np.cumsum(steps), 800).jitter == pytest.approx(1 / 3)


def test_a_recording_without_a_clock_has_only_samples():

    assert sampling(None, 5).rate_Hz is None
    still_clock = sampling(np.zeros(5), 5)
    assert still_clock.rate_Hz is None and still_clock.repeated == 4


# Signals


def test_runs_of_what_holds():
    holds = np.asarray([1, 1, 0, 1, 0, 0, 1, 1, 1], bool)
    assert runs(holds) == [(0, 1), (3, 3), (6, 8)]
    assert runs(holds, 3) == [(6, 8)]
    assert runs(np.zeros(4, bool)) == []


def test_turning_points_of_a_long_signal_are_those_of_all_its_samples():
    t = np.linspace(0.0, 60.0, 3 * MOST)
    x = 5 * np.sin(t) + np.random.default_rng(0).normal(0, 0.05, len(t))
    assert np.array_equal(turns_of_long(x, 1.0), turning_points(x, 1.0))


def test_extremes_hold_the_largest_and_the_smallest_of_every_block():
    x = np.random.default_rng(0).normal(size=1003)
    kept = extremes(x, 50)
    assert len(kept) <= 2 * 50 + 4
    assert kept[0] == 0 and kept[-1] == 1002
    assert x[kept].max() == x.max() and x[kept].min() == x.min()
    assert np.array_equal(extremes(x, 2000), np.arange(1003))


def test_still_stretches_are_found_to_a_sample():
    x = np.concatenate([np.linspace(0, 5, 200), np.full(60, 5.0), np.linspace(5, 0, 200), np.zeros(80)])
    (a, b), (c, d) = still(x, 0.05, 20)
    assert abs(a - 200) <= 3 and abs(b - 260) <= 3
    assert abs(c - 459) <= 3 and d == len(x) - 1
    assert still(x, 0.05, 1000) == []


# Cells


@pytest.mark.parametrize("step", [0.002, 0.01, 0.25])
def test_the_resolution_is_the_step_of_the_readings(step):
    rng = np.random.default_rng(1)
    x = np.round((rng.normal(0, 3 * step, 500) + np.linspace(0, 100 * step, 500)) / step) * step
    assert resolution(x * (1 + 1e-15)) == pytest.approx(step, rel=1e-6)
    assert resolution(x.astype(np.float32).astype(float)) == pytest.approx(step, rel=1e-3)


def test_readings_of_any_value_have_no_resolution():
    assert resolution(np.random.default_rng(1).normal(size=5000)) is None
    assert resolution(np.zeros(10)) is None


def test_white_and_slow_noise_are_told_apart():
    rng = np.random.default_rng(2)
    white = rng.normal(0, 0.02, 20_000)
    slow = np.zeros(20_000)
    for k in range(1, len(slow)):
        slow[k] = 0.8 * slow[k - 1] + rng.normal(0, 0.03 * np.sqrt(1 - 0.64))
    quiet = [(0, 19_999)]
    assert noise(white, quiet).white_N == pytest.approx(0.02, rel=0.05)
    assert (noise(white, quiet).slow_N or 0.0) < 0.006
    both = noise(white + slow, quiet)
    assert both.white_N == pytest.approx(0.02, rel=0.2)
    assert both.slow_N == pytest.approx(0.03, rel=0.25)
    assert from_differences(white) == pytest.approx(0.02, rel=0.05)


def test_noise_of_a_recording_is_that_of_its_cells():
    found = inspect(recording(recorded(*THREE, noise=0.02)))
    for cell in (found.base, found.tip):
        assert cell.noise.white_N == pytest.approx(0.02, rel=0.1)
        assert cell.noise.moving_N == pytest.approx(0.02, rel=0.1)
        assert cell.resolution_N is None and not cell.saturated and not cell.dead


def test_creeping_ends_of_still_stretches_are_no_noise():
    found = inspect(read_recording(Path(__file__).parents[2] / "examples/rig/monday.csv"))
    assert found.base.noise.total_N == pytest.approx(0.1, rel=0.2)  # as record.py beside it made them
    assert found.tip.noise.total_N == pytest.approx(0.05, rel=0.2)
    assert found.base.resolution_N == pytest.approx(0.01)


def test_noise_in_motion_only_is_noticed():
    columns = recorded(*THREE, noise=0.01)
    moves = columns["T_base"] > 0.5
    shaking = np.random.default_rng(5).normal(0, 0.1, len(moves)) * moves
    found = inspect(recording(columns | {"T_base": columns["T_base"] + shaking}))
    assert found.base.noise.white_N == pytest.approx(0.01, rel=0.2)
    assert found.base.noise.moving_N == pytest.approx(0.1, rel=0.2)
    assert "noisier in motion" in says(found)


def test_zeros_and_their_drift_are_those_of_the_cells():
    columns = recorded(*THREE, zeros=(0.3, -0.2))
    late = columns["time"] > 30.0
    columns["T_tip"] = columns["T_tip"] + 0.15 * late
    found = inspect(recording(columns))
    assert found.base.zero_before is not None and found.tip.zero_before is not None
    assert found.base.zero_before.value_N == pytest.approx(0.3, abs=0.01)
    assert found.tip.zero_before.value_N == pytest.approx(-0.2, abs=0.01)
    assert found.base.drift_N == pytest.approx(0.0, abs=0.01)
    assert found.tip.drift_N == pytest.approx(0.15, abs=0.02)
    assert "base shows 0.3" in says(found, "note") or "base shows 0.3" in says(found, "problem")
    assert "zero of the cell at the tip moved" in says(found)
    assert found.friction.mu_theta == pytest.approx(MU_THETA, abs=0.02)


def test_a_recording_that_is_never_unloaded_has_no_zeros():
    found = inspect(recording(recorded(*ramps((15.0, 5.0), (5.0, 5.0), (15.0, 5.0), (5.0, 5.0), start=5.0))))
    assert found.base.zero_before is None and found.base.drift_N is None
    assert "No stretch is unloaded" in says(found)


def test_a_saturated_cell_is_found():
    columns = recorded(*THREE)
    columns["T_base"] = np.minimum(columns["T_base"], 13.0)
    found = inspect(recording(columns))
    assert len(found.base.saturated) == 3 and not found.base.dead and not found.tip.saturated
    # 2 of 15 N are cut off a ramp of 3 N/s, up and down
    assert sum(len(s.where) for s in found.base.saturated) == pytest.approx(3 * 80 * 4 / 3, rel=0.05)
    assert "end of its range" in says(found, "problem")


@pytest.mark.parametrize("cell", ["T_base", "T_tip"])
def test_a_dead_cell_is_found(cell):
    columns = recorded(*THREE)
    columns[cell] = columns[cell].copy()
    columns[cell][500:620] = columns[cell][500]
    found = inspect(recording(columns))
    dead = (found.base if cell == "T_base" else found.tip).dead
    assert [(s.where.first, s.where.last) for s in dead] == [(500, 619)]
    assert dead[0].other_N > 1.0
    assert "repeats one reading" in says(found, "problem")
    assert not (found.tip if cell == "T_base" else found.base).dead


def test_friction_that_holds_a_coarse_tip_is_no_dead_cell():
    found = inspect(recording(recorded(*THREE, noise=0.0, step=0.05)))
    assert not found.tip.dead and not found.tip.saturated
    assert not found.base.dead and not found.base.saturated
    assert found.base.resolution_N == pytest.approx(0.05)


@pytest.mark.parametrize("name", ["coulomb", "adhesion", "viscous-friction", "stribeck-friction"])
def test_simulations_without_noise_have_no_stuck_cell(name):
    found = inspect(read_recording(Path(__file__).parents[1] / "data/reference" / name / "recording.csv"))
    assert not says(found, "problem")


# Load


def test_cycles_rates_and_repeats():
    legs = (REST, (10.0, 5.0), (4.0, 2.0), (10.0, 4.0), (0.0, 5.0), (0.0, 1.0), *CYCLE, *CYCLE)
    found = inspect(recording(recorded(*ramps(*legs))))
    load = found.cycles
    assert [round(c.peak_N) for c in load.cycles] == [10, 10, 15, 15]
    assert [c.inner for c in load.cycles] == [False, True, False, False]
    assert load.inner == 1 and load.repeats == (3, 4)
    # The rest before the first pull counts as part of its way.
    assert [c.pull_N_per_s for c in load.cycles][1:] == pytest.approx([1.5, 15 / 6, 15 / 7], rel=0.25)
    assert load.rates_N_per_s["50%"] == pytest.approx(3.0, rel=0.1)
    assert load.decades is not None and load.decades < 0.6


def test_rates_over_two_decades_are_counted_so():
    legs = (REST, (15.0, 50.0), (0.0, 0.5), (0.0, 2.0), (15.0, 0.5), (0.0, 50.0), (0.0, 2.0))
    found = inspect(recording(recorded(*ramps(*legs))))
    assert found.cycles.decades == pytest.approx(2.0, abs=0.2)
    assert next(n for n in found.needs if "rate" in n.question).there


def test_holds_are_stretches_under_load():
    legs = (REST, (10.0, 5.0), (10.0, 6.0), (0.0, 5.0), (0.0, 3.0))
    found = inspect(recording(recorded(*ramps(*legs))))
    (hold,) = found.holds
    assert hold.start_s == pytest.approx(9.0, abs=0.3) and hold.end_s == pytest.approx(15.0, abs=0.3)
    need = next(n for n in found.needs if "creep" in n.question)
    assert need.there and "1 hold" in need.says
    assert len(found.rest) == 2


def test_a_slow_ramp_is_no_hold():
    found = inspect(recording(recorded(*ramps(REST, (15.0, 300.0), (0.0, 300.0), REST), rate=10.0)))
    assert not found.holds


def test_phases_are_those_of_the_capstan():
    fine, T_base = THREE
    columns = recorded(fine, T_base, noise=0.0)
    found = inspect(recording(columns))
    true = np.interp(columns["time"], fine, T_base)
    ratio = np.interp(columns["time"], fine, pulled(T_base)) / np.maximum(true, 1e-9)
    loaded = true > 1.0
    label = found.phases.label
    sure = loaded & (found.phases.step_N < 1.0)
    pulling = sure & (np.abs(ratio - np.exp(-MU_THETA)) < 1e-3)
    releasing = sure & (np.abs(ratio - np.exp(MU_THETA)) < 1e-3)
    locked = sure & ~pulling & ~releasing
    for true_of, phase in ((pulling, PULLING), (releasing, RELEASING), (locked, TRANSITION)):
        assert np.mean(label[true_of] == phase) > 0.9


@pytest.mark.parametrize(
    ("pull", "release", "symmetric"), [(0.5, 0.5, True), (0.1, 0.1, True), (0.6, 0.3, False)]
)
def test_rough_friction(pull, release, symmetric):
    found = inspect(recording(recorded(*THREE, pull=pull, release=release))).friction
    assert found.mu_theta == pytest.approx((pull + release) / 2, abs=0.01)
    assert found.both == pytest.approx((release - pull) / 2, abs=0.01)
    assert found.symmetric is symmetric
    assert found.base_leads is True


def test_swapped_cells_are_noticed():
    columns = recorded(*THREE)
    columns["T_base"], columns["T_tip"] = columns["T_tip"], columns["T_base"]
    found = inspect(recording(columns))
    assert found.friction.base_leads is False
    assert "wrong way round" in says(found, "problem")


# Delay


def stairs(seed: int, seconds: float = 60.0) -> tuple[np.ndarray, np.ndarray]:
    """Pulls and releases at rates that change all the time, with little reversals, as by hand."""
    rng = np.random.default_rng(seed)
    fine, T_base = ramps(*((15.0, 4.0), (0.0, 4.0)) * int(seconds / 8))
    knots = np.arange(0.0, seconds + 1, 0.15)
    unsteady = np.interp(fine, knots, rng.normal(0.0, 0.25, len(knots)))
    return fine, np.maximum(T_base + unsteady * (T_base > 1.0), 0.0)


@pytest.mark.parametrize("late", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("rate", [40.0, 80.0, 500.0])
def test_the_delay_is_found_within_its_error(late, rate):
    for seed in range(3):
        found = inspect(recording(recorded(*stairs(seed), late=late, rate=rate, jitter=0.1, seed=seed))).delay
        assert found.seconds is not None and found.sd_s is not None, found.why_not
        assert found.seconds == pytest.approx(late, abs=2.5 * found.sd_s)
        assert found.sd_s < 0.25 / rate + 2e-3


@pytest.mark.parametrize("seconds", [1.5, 6.0])
def test_loops_without_delay_give_none(seconds):
    fine = np.arange(0.0, 60.0, 1 / 2000)
    T_base = 8 * (1 - np.cos(2 * np.pi * fine / seconds))
    for seed in range(3):
        found = inspect(recording(recorded(fine, T_base, seed=seed, jitter=0.1))).delay
        assert found.seconds is None or abs(found.seconds) < 2.5 * (found.sd_s or 0.0)


def test_even_ramps_do_not_tell_the_delay():
    found = inspect(recording(recorded(*THREE, late=0.02)))
    assert found.delay.seconds is None and "too evenly" in found.delay.why_not
    need = next(n for n in found.needs if "clocks" in n.question)
    assert not need.there and "too evenly" in need.says


def test_a_delay_that_matters_is_a_problem():
    found = inspect(recording(recorded(*stairs(1), late=0.03, noise=0.005)))
    assert "late by" in says(found, "problem")


# The whole


def test_many_cycles_are_drawn_all_and_a_few_close_up():
    fine = np.arange(0.0, 60.0, 1 / 500)
    columns = recorded(fine, 8 * (1 - np.cos(2 * np.pi * fine / 2)))
    rig = recording(columns)
    found = inspect(rig)
    assert len(found.cycles.cycles) == 30
    report = inspection_report([found], [rig], names=["rig"], mappings=[Mapping((), (), ())])
    assert [f.name for f in report.figures][:3] == ["channels", "cycles", "loop"]
    largest = close_up(found)
    assert 6.0 < columns["time"][largest][-1] - columns["time"][largest][0] < 11.0


def test_bands_and_crosses_are_few_artists_however_many_there_are(tmp_path):
    legs = ((6.0, 2.0), (6.0, 1.0), (1.0, 2.0), (1.0, 1.0)) * 12
    columns = recorded(*ramps(*legs, start=1.0))
    columns["T_base"][500::700] += 40.0
    columns["T_tip"][300::700] -= 40.0
    time = columns["time"]
    write_recording(tmp_path / "a.csv", columns)
    rig = read_recording(tmp_path / "a.csv")
    found = inspect(rig)
    crosses = len(rig.masked)
    assert crosses > 10 and len(found.holds) > 10
    axes = plot_channels(rig, found).axes[0]
    assert len(axes.collections) == 1  # the holds
    spans = axes.collections[0].get_paths()
    assert len(spans) == len(found.holds)
    lines = [line for line in axes.lines if line.get_marker() == "x"]
    assert [np.size(line.get_xdata()) for line in lines] == [
        sum(m.channel == name for m in rig.masked) for name in ("T_base", "T_tip")
    ]
    low, high = axes.get_ylim()
    at = {"T_base": 500, "T_tip": 300}
    for line, name in zip(lines, at, strict=True):
        assert np.asarray(line.get_xdata())[0] == pytest.approx(time[at[name]])
        assert low < np.min(line.get_ydata()) and np.max(line.get_ydata()) < high


def test_a_sound_recording_has_no_problem():
    found = inspect(recording(recorded(*THREE)))
    assert not says(found, "problem")
    assert found.says.startswith("No problem found: 3 pulls up to 15")
    assert "apparent mu·theta 0.5" in found.says


def test_gaps_and_backward_stamps_are_findings():
    columns = recorded(*THREE)
    kept = (columns["time"] < 10.0) | (columns["time"] > 12.0)
    found = inspect(recording({k: v[kept] for k, v in columns.items()}))
    assert len(found.sampling.gaps) == 1 and "gap" in says(found, "problem")
    time = columns["time"].copy()
    time[300] -= 1.0
    found = inspect(recording(columns | {"time": time}))
    assert "run backwards" in says(found, "problem") and found.delay.seconds is None


def test_a_recording_without_time_is_inspected():
    columns = recorded(*THREE)
    del columns["time"]
    found = inspect(recording(columns))
    assert len(found.cycles.cycles) == 3 and found.cycles.decades is None
    assert found.friction.mu_theta == pytest.approx(MU_THETA, abs=0.01)
    assert "no column of time" in says(found) and "without a clock" in found.says


def test_glitches_are_counted_and_leave_no_gap(tmp_path):
    columns = recorded(*THREE, step=0.001)
    columns["T_tip"][1000] += 140.0
    columns["T_base"][1500] -= 5.0
    write_recording(tmp_path / "rig.csv", columns)
    found = inspect(read_recording(tmp_path / "rig.csv"))
    assert sorted((m.channel, m.samples) for m in found.masked) == [("T_base", 1), ("T_tip", 1)]
    assert not found.sampling.gaps and found.sampling.samples == len(columns["time"])
    assert found.tip.highest_N < 20.0
    assert "1 sample of T_tip left out as glitch, up to 140 N off" in says(found)


def test_the_answer_is_plain_json():
    data = inspect(recording(recorded(*THREE))).to_json()
    json.dumps(data, allow_nan=False)
    assert data["base"]["noise"]["white_N"] == pytest.approx(0.01, rel=0.1)
    assert sum(data["phases"].values()) == pytest.approx(1.0)
    assert data["cycles"]["cycles"][0]["where"]["start_s"] > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"T_tip": None}, "no T_tip"),
        ({"tendons": ("left", "right")}, "several tendons"),
        ({"T_base": np.full(3036, 2.0)}, "throughout"),
    ],
)
def test_what_cannot_be_inspected_is_refused(change, message):
    columns = recorded(*THREE)
    change = {k: v[: len(columns["time"])] if isinstance(v, np.ndarray) else v for k, v in change.items()}
    with pytest.raises(InputError, match=message):
        inspect(recording(columns | change))


def test_a_short_recording_is_refused():
    columns = {k: v[:10] for k, v in recorded(*THREE).items()}
    with pytest.raises(InputError, match="needs 20"):
        inspect(recording(columns))


@pytest.mark.parametrize("seed", range(5))
def test_anything_goes_without_a_warning(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(20, 400))
    columns = {"T_base": rng.normal(0, 1, n).cumsum(), "T_tip": rng.normal(0, 1, n).cumsum()}
    if seed % 2:
        columns["time"] = np.cumsum(rng.exponential(0.1, n))
    json.dumps(inspect(recording(columns)).to_json(), allow_nan=False)
