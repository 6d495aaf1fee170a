"""Glitches: none in sound recordings, all of those that are put in."""

import re
import time as clock
from pathlib import Path

import numpy as np
import pytest

from gtr_jax.files.glitches import LONGEST, find_glitches
from gtr_jax.files.recording import read_recording

ROOT = Path(__file__).parents[1]
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
