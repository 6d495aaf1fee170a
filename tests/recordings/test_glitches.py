"""Glitches: none in sound recordings, all of those that are put in."""

import re
import time as clock
from pathlib import Path

import numpy as np
import pytest

from benchmarks import glitches as rigs
from gtr_jax.recordings.cleaning.excursions import LONGEST
from gtr_jax.recordings.cleaning.glitches import find_glitches
from gtr_jax.recordings.recording import read_recording

ROOT = Path(__file__).parents[2]
SHARED = ROOT.parent / "shared/data"
SOUND = sorted([*SHARED.glob("*/*/recording.csv"), *ROOT.glob("gtr_jax/examples/*.csv")])
SOUND += sorted(ROOT.glob("tests/data/**/*.csv"))


def channels_of(recording):
    """Every channel of a recording under its name."""
    found = {}
    for name in ("T_base", "T_tip", "displacement", "tip_x", "tip_y", "tip_angle"):
        values = getattr(recording, name)
        if values is not None:
            found |= {f"{name}.{i}": v for i, v in enumerate(np.atleast_2d(values.T))}
    return found


@pytest.mark.parametrize("path", SOUND, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_sound_recordings_have_none(path):
    header = path.read_text().partition("\n")[0]
    if "T_base_N" not in header:
        pytest.skip("no recording")
    recording = read_recording(path, need_tip=False, tendons=re.findall(r"T_base_N\.(\w+)", header))
    assert find_glitches(channels_of(recording), recording.time) == []


def driven(rng, kind, K):
    """A base tension of one kind, (K,), without noise."""
    t = np.arange(K)
    if kind == "sine":
        return 10 + 9 * np.sin(2 * np.pi * t / rng.uniform(40, 400) + rng.uniform(0, 6))
    if kind == "triangle":
        period = int(rng.integers(12, 300))
        return 12 * np.abs((t / period) % 1 - 0.5)
    if kind == "steps":
        return np.repeat(rng.uniform(0, 20, K), rng.integers(4, 60))[:K]
    if kind == "ragged steps":
        return np.repeat(rng.uniform(0, 20, K), rng.integers(4, 60, K))[:K]
    if kind == "ramps":
        turns = np.cumsum(rng.integers(5, 80, K))
        turns = turns[turns < K]
        return np.interp(t, [0, *turns, K], rng.uniform(0, 20, len(turns) + 2))
    if kind == "ramps and holds":
        turns = np.sort(rng.choice(K, K // 25, replace=False))
        levels = np.repeat(rng.uniform(0, 20, len(turns) // 2 + 2), 2)[1 : len(turns) + 1]
        return np.interp(t, turns, levels)
    return np.full(K, rng.uniform(0, 20))


KINDS = ("sine", "triangle", "steps", "ragged steps", "ramps", "ramps and holds", "still")


def played(T, share, width):
    """What comes through friction: the tip tension of a base tension, by a play operator, (K,)."""
    tip, out = share * T[0], np.empty_like(T)
    for k, value in enumerate(T):
        tip = min(max(tip, share * value - width), share * value + width)
        out[k] = tip
    return out


def cells(rng, kind, K):
    """Both cells of a random sound recording, with noise and a resolution of any size."""
    T_base = driven(rng, kind, K)
    T_tip = played(T_base, rng.uniform(0.3, 0.9), rng.uniform(0, 2))
    found = {}
    for name, values in (("T_base", T_base), ("T_tip", T_tip)):
        values = values + rng.choice([0.0, 0.0, 0.003, 0.03, 0.3, 2.0]) * rng.standard_normal(K)
        step = rng.choice([0.0, 0.0, 0.01, 0.1, 1.0])
        found[name] = np.round(values / step) * step if step else values
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_random_sound_recordings_have_none(kind):
    rng = np.random.default_rng(KINDS.index(kind))
    for case in range(150):
        found = cells(rng, kind, int(rng.integers(20, 2000)))
        time = None if case % 2 else np.cumsum(rng.uniform(0.005, 0.015, len(found["T_base"])))
        assert find_glitches(found, time) == [], case


@pytest.mark.parametrize("kind", ("sine", "triangle", "ragged steps", "ramps", "ramps and holds", "still"))
def test_what_is_put_in_is_found(kind):
    rng = np.random.default_rng(10 + KINDS.index(kind))
    put = missed = wrong = 0
    for _ in range(100):
        K = int(rng.integers(200, 3000))
        T_base = driven(rng, kind, K)
        found = {"T_base": T_base, "T_tip": played(T_base, 0.6, 1.0)}
        found = {name: v + 0.01 * rng.standard_normal(K) for name, v in found.items()}
        expected = set()
        for at in np.arange(30, K - 30, 60)[: K // 200]:
            name = rng.choice(["T_base", "T_tip"])
            where, width = int(at + rng.integers(20)), int(rng.integers(1, 4))
            size = rng.choice([-1, 1]) * 10 ** rng.uniform(1.7, 2.5)
            pairs = [(name, where), (name, where + width + 1)] if rng.random() < 0.5 else [(name, where)]
            if rng.random() < 0.3:
                pairs += [("T_tip" if name == "T_base" else "T_base", where)]
            for channel, first in pairs:
                found[channel][first : first + width] += size * rng.uniform(0.7, 1.3, width)
                expected.add((channel, first, first + width - 1))
        seen = {(g.channel, g.first, g.last) for g in find_glitches(found, 0.01 * np.arange(K))}
        put, missed, wrong = put + len(expected), missed + len(expected - seen), wrong + len(seen - expected)
    # Among steps of up to 20 N a few samples apart, an excursion of 50 N may be one more of them.
    assert put > 300 and wrong == 0
    assert missed <= (0.01 * put if kind == "ragged steps" else 0)


def test_the_good_sample_between_two_glitches_is_kept():
    x = 5 + np.sin(np.arange(200) / 20)
    x[[80, 82]] = 150
    x[[100, 101, 102, 104, 105, 106]] = -40
    found = [(g.first, g.last) for g in find_glitches({"T": x}, None)]
    assert found == [(80, 80), (82, 82), (100, 102), (104, 106)]


@pytest.mark.parametrize(
    "run",
    [
        *((13.9, 154.0), (154.0, 13.9), (7.5, -126.0), (-126.0, 7.5), (50.0, -60.0)),
        *((3.0, 80.0, 200.0), (80.0, 3.0, 200.0), (150.0, 2.0, 150.0)),
        *((2.0, 150.0, 3.0, 70.0), (1.5, 2.5, 90.0, 1.2)),
    ],
    ids=str,
)
@pytest.mark.parametrize("at", (200, 900))  # slack, and while releasing from 9 N
@pytest.mark.parametrize("both", (False, True))
def test_the_smaller_sample_beside_a_glitch_is_one_too(run, at, both):
    rng = np.random.default_rng(at)
    t = 0.01 * np.arange(2000)
    T_base = np.interp(t, [0, 4, 8, 12, 16, 20], [0, 0, 12, 6, 10, 0])
    cells = {"T_base": T_base, "T_tip": pulled(T_base)}
    cells = {name: x + 0.01 * rng.standard_normal(2000) for name, x in cells.items()}
    assert find_glitches(cells, t) == []
    for name in ("T_base", "T_tip") if both else ("T_tip",):
        cells[name][at : at + len(run)] += run
    found = [(g.channel, g.first, g.last) for g in find_glitches(cells, t)]
    assert found == [(name, at, at + len(run) - 1) for name in ("T_base", "T_tip")[not both :]]


def test_a_glitch_takes_no_sound_sample_along():
    # Beside steps, turning points, and snaps, whose samples lie where their own neighbours allow.
    for levels in ([5.0, 5.0, 9.0, 9.0], [5.0, 7.0, 9.0, 7.0], [9.0, 5.0, 5.3, 5.6]):
        T = np.interp(np.arange(200), [0, 98, 99, 101, 102, 200], [*levels[:2], *levels[1:3], *levels[2:]])
        T = T + 0.01 * np.random.default_rng(0).standard_normal(200)
        T[100] = 154.0
        assert [(g.first, g.last) for g in find_glitches({"T": T}, None)] == [(100, 100)]


def test_dropouts():
    rng = np.random.default_rng(0)
    x = 5 + np.sin(np.arange(6000) / 20) + 0.01 * rng.standard_normal(6000)
    y = 0.6 * x + 0.01 * rng.standard_normal(6000)
    for values in (x, y):
        values[100] = 0.0
        values[300 : 300 + LONGEST] = 0.0
    x[[400, 401, 500]] = np.nan
    found = [(g.channel, g.first, g.last, g.kind) for g in find_glitches({"x": x, "y": y}, None)]
    long = (300, 299 + LONGEST, "dropout")
    assert found == [
        *((name, 100, 100, "dropout") for name in "xy"),
        *((name, *long) for name in "xy"),
        ("x", 400, 401, "dropout"),
        ("x", 500, 500, "dropout"),
    ]


def test_a_pull_that_both_cells_show_is_none_where_others_are_as_fast():
    T = np.repeat([0.0, 10.0, 0.0, 10.0, 0.0], [60, 2, 100, 30, 40])
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, len(T)))
    assert find_glitches({"T_base": T + noise[0], "T_tip": 0.6 * T + noise[1]}, None) == []
    assert [g.first for g in find_glitches({"T_base": T + noise[0], "T_tip": noise[1]}, None)] == [60]


def test_recordings_as_rigs_make_them():
    there = found = wrong = extra = 0
    rng = np.random.default_rng(0)
    for drawn in rigs.recordings(90210, 25):
        spoilt = rigs.kinds(drawn.read.spoilt).keys()
        masked = rigs.masked(drawn.read.cells, drawn.read.time)
        there, found, wrong = there + len(spoilt), found + len(masked & spoilt), wrong + len(masked - spoilt)
        extra += len(rigs.masked(rigs.sound(rng, drawn), drawn.read.time))
    assert there > 600
    assert found >= 0.94 * there
    assert wrong <= 0.005 * found and extra <= 2


def pulled(T_base, low=0.5, high=0.9, loose=()):
    """What Coulomb friction lets through of a base tension, (K,); at the samples `loose` friction is gone."""
    tip, out = low * T_base[0], np.empty_like(T_base)
    for k, base in enumerate(T_base.tolist()):
        tip = 0.7 * base if k in loose else min(max(tip, low * base), high * base)
        out[k] = tip
    return out


def seen(cells, sd=0.01, seed=0):
    """Cells with noise of 0.1 % of some 10 N, in grains of 2 mN."""
    rng = np.random.default_rng(seed)
    return {n: np.round((v + sd * rng.standard_normal(len(v))) / 2e-3) * 2e-3 for n, v in cells.items()}


def jagged(rate):
    """Sharp reversals: 12 N in as few as three samples each way."""
    turns = np.cumsum(np.tile([3, 5, 8, max(int(0.4 * rate), 4)], 30))
    return np.interp(np.arange(turns[-1]), turns, np.tile([12.0, 0.5, 10.0, 3.0], 30))


def swinging(rate):
    """Sudden releases, after which the load swings at 2.5 Hz."""
    t = np.arange(0, 4, 1 / rate)
    one = 4 + 6 * np.exp(-t) * np.cos(2 * np.pi * 2.5 * t)
    return np.concatenate([*[np.concatenate([np.full(int(rate), 10.0), one]) for _ in range(5)]])


def bursting(rate):
    """Stick-slip of the base: slow rise, sudden fall."""
    return 6 + 2.0 * ((np.arange(int(40 * rate)) / (0.35 * rate)) % 1)


@pytest.mark.parametrize("rate", (20, 50, 100))
@pytest.mark.parametrize("history", (jagged, swinging, bursting))
def test_quick_moves_are_none(history, rate):
    T_base = history(rate)
    time = np.arange(len(T_base)) / rate
    for seed in range(5):
        cells = seen({"T_base": T_base, "T_tip": pulled(T_base)}, seed=seed)
        assert find_glitches(cells, time) == []


@pytest.mark.parametrize("rate", (20, 50, 100))
def test_events_are_none(rate):
    t = np.arange(0, 60, 1 / rate)
    T_base = np.interp(t, [0, 5, 25, 30, 50, 60], [0.5, 12, 12, 6, 6, 0.5])
    tapped = {int(k * rate) + j for k in (8, 15, 35, 44) for j in range(max(rate // 25, 1))}
    tip = pulled(T_base, loose=tapped)
    moved = np.where((t > 20) & (t < 20.5), -2.0, 0.0) + np.where(t > 40, 1.0, 0.0)
    jerk = np.interp(t, [18, 18 + 1 / rate, 19, 60], [0, -1.5, 0, 0])
    for cells in (
        {"T_base": T_base, "T_tip": tip},
        {"T_base": T_base, "T_tip": tip + moved},
        {"T_base": T_base + jerk, "T_tip": tip + moved},
    ):
        assert find_glitches(seen(cells), t) == []


def test_a_pull_and_back_that_friction_allows_is_kept_and_one_that_it_does_not_is_none():
    t = np.arange(0, 40, 0.02)
    T_base = np.interp(t, [0, 5, 5.02, 11, 20, 30, 40], [0.5, 0.5, 12, 12, 4, 12, 0.5])
    T_base[900:902] = 14.0  # on release: the tip crosses the whole band of friction, and back
    tip = pulled(T_base)
    assert tip[899] < 5.3 and tip[900] == pytest.approx(7.0) and tip[902] < 5.3
    cells = {"T_base": T_base, "T_tip": tip}
    assert find_glitches(seen(cells), t) == []
    cells["T_tip"] = np.where(np.isin(np.arange(len(t)), (900, 901)), 15.0, tip)
    found = [(g.channel, g.first, g.last) for g in find_glitches(seen(cells), t)]
    assert found == [("T_base", 900, 901), ("T_tip", 900, 901)]


def test_glitches_in_a_swing():
    T_base = swinging(50)
    cells = seen({"T_base": T_base, "T_tip": pulled(T_base)})
    steps = np.abs(np.diff(T_base))
    cells["T_base"][70:72] += 1.5
    assert steps[60:80].max() > 1.5 / 4  # the former rule asked for four times the steps around
    assert [(g.first, g.last) for g in find_glitches(cells, None)] == [(70, 71)]


def test_dropouts_of_a_cell_that_is_often_at_zero():
    t = np.arange(0, 60, 0.02)
    T_base = np.maximum(np.interp(t, [0, 10, 20, 25, 50, 60], [0, 0, 12, 8, 0, 0]), 0)
    cells = seen({"T_base": T_base, "T_tip": pulled(T_base)}, sd=1.5e-3)
    assert np.mean(cells["T_base"] == 0) > 0.05
    assert find_glitches(cells, t) == []
    cells["T_base"][1100:1107] = 0.0
    cells["T_tip"][1600:1604] = 0.0
    found = [(g.channel, g.first, g.last, g.kind) for g in find_glitches(cells, t)]
    assert found == [("T_base", 1100, 1106, "dropout"), ("T_tip", 1600, 1603, "dropout")]


def test_a_supply_that_fails_while_the_tension_falls_to_slack():
    rng = np.random.default_rng(5)
    t = np.arange(0, 40, 0.02)
    T_base = np.maximum(np.interp(t, [0, 10, 20, 20.2, 30, 40], [0, 0, 20, 0, 0, 15]), 0)
    cells = {"T_base": T_base, "T_tip": pulled(T_base)}
    # Cells that resolve 0.03 N and are slack for a quarter of the time: single zeros are ordinary.
    cells = {
        name: 0.03 * np.round((x + 0.06 * rng.standard_normal(len(x))) / 0.03) for name, x in cells.items()
    }
    assert 100 < np.sum(cells["T_base"] == 0.0)
    assert find_glitches(cells, t) == []
    for x in cells.values():
        x[1005:1011] = 0.0  # from 10 N on, down to where the tension is 0 in truth
    found = [(g.channel, g.first, g.last, g.kind) for g in find_glitches(cells, t)]
    assert found == [("T_base", 1005, 1010, "dropout"), ("T_tip", 1005, 1010, "dropout")]
    # A cell that is not connected changes nothing; a number that is missing beside it neither.
    more = {name: x.copy() for name, x in cells.items()} | {"T_base.right": np.zeros(len(t))}
    more["T_base"][1011] = np.nan
    told = [g for g in find_glitches(more, t) if np.isfinite(g.size)]
    assert [(g.channel, g.first) for g in told] == [("T_base", 1005), ("T_tip", 1005)]
    # Of a cell alone, or of cells that show slack as exactly 0, nothing is known.
    assert find_glitches({"T_base": cells["T_base"]}, t) == []
    assert find_glitches({name: np.where(x < 0.3, 0.0, x) for name, x in cells.items()}, t) == []


def test_a_supply_that_fails_where_the_tendon_is_never_slack():
    rng = np.random.default_rng(0)
    base = np.where(np.arange(2000) < 1008, 10.0, 4.0)
    cells = {
        name: share * base + 0.02 * rng.standard_normal(2000)
        for name, share in (("T_base", 1), ("T_tip", 0.6))
    }
    for x in cells.values():
        x[1005:1011] = x[400:404] = 0.0
    found = [(g.channel, g.first, g.last) for g in find_glitches(cells, None)]
    assert found == [(name, *rows) for rows in ((400, 403), (1005, 1010)) for name in cells]


@pytest.mark.parametrize(
    "turns",
    [
        ([0, 0.2, 10, 20, 30, 40], [0, 0, 10, 3, 12, 2]),
        ([0, 10, 20, 20.3, 30, 40], [5, 10, 0, 0, 12, 2]),
        ([0, 10, 20, 30, 39.8, 40], [5, 10, 2, 12, 0, 0]),
        ([0, 10, 20, 20.02, 20.3, 40], [5, 10, 10, 0, 0, 12]),
    ],
)
@pytest.mark.parametrize(
    "step, sd", [(0.0122, 0.002), (0.0122, 0.003), (0.01, 0.004), (0.02, 0.003), (0.05, 0.01), (0.0125, 0.02)]
)
def test_rest_at_zero_is_no_dropout(turns, step, sd):
    t = np.arange(0, 40, 0.02)
    T_base = np.interp(t, *turns)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        cells = {
            name: step * np.round((share * T_base + sd * rng.standard_normal(len(t))) / step)
            for name, share in (("T_base", 1.0), ("T_tip", 0.6))
        }
        assert find_glitches(cells, t) == []


def test_beside_a_glitch_of_the_other_cell_a_smaller_one_is_found():
    rng = np.random.default_rng(3)
    base, tip = 10 + 0.01 * rng.standard_normal(2000), 6 + 0.01 * rng.standard_normal(2000)
    tip[500] = tip[499] + 0.055
    tip[800] = tip[799] + 0.055
    assert find_glitches({"T_base": base, "T_tip": tip}, None) == []
    base[500] = 20.0
    found = [(g.channel, g.first) for g in find_glitches({"T_base": base, "T_tip": tip}, None)]
    assert found == [("T_base", 500), ("T_tip", 500)]


def test_bursts_and_gaps_are_none():
    rng = np.random.default_rng(0)
    x = 5 + 0.01 * rng.standard_normal(1000)
    x[::5] += 3.0
    assert find_glitches({"x": x}, None) == []
    y, time = 5 + 0.01 * rng.standard_normal(100), 0.01 * np.arange(100.0)
    y[50] = 9.0
    assert [g.first for g in find_glitches({"y": y}, time)] == [50]
    time[50:] += 10.0
    assert find_glitches({"y": y}, time) == []


@pytest.mark.parametrize("K", range(9))
def test_short_channels(K):
    assert find_glitches({"x": np.arange(float(K)), "y": np.zeros(K)}, None) == []


def test_a_million_samples_take_less_than_a_second():
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(1_000_000)
    x = 10 + 8 * np.sin(t / 3) + 0.02 * rng.standard_normal(len(t))
    x[5000::10000] += 50.0
    began = clock.process_time()
    assert len(find_glitches({"T_base": x, "T_tip": 0.6 * x}, t)) == 200
    assert clock.process_time() - began < 1.0
