"""The blind benchmark's recordings as rigs make them: histories, events, instruments; and how they are
scored.
"""

import dataclasses

import numpy as np
import pytest

import gtr_jax as gtr
from benchmarks.blind import cases, events, exam, hand, instruments, machine, rig, rig_page, rig_score
from benchmarks.blind.effects import CATALOGUE, OUTSIDE

TURNED, MU = 6.0, 0.1
SHEATH = machine.Arm(
    length=1.0,
    outer=lambda s: np.full(np.shape(s), 2e-3),
    bore=lambda s: np.zeros(np.shape(s)),
    modulus=1e9,
    offset=lambda s: np.zeros(np.shape(s)),
    friction=MU,
    links=40,
    stiffness=2e4,
    fixed=TURNED,
)
HOLDS = np.exp(MU * TURNED)


def with_laws(**laws):
    return dataclasses.replace(SHEATH, laws=machine.Laws(**laws))


def test_a_sheath_of_fixed_shape_holds_the_tendon_as_a_capstan():
    T = np.concatenate([np.linspace(0.01, 20, 40), np.linspace(20, 2, 60)[1:]])
    shown = machine.run(SHEATH, 0.1 * np.arange(len(T)), T)
    held = [T[0] / HOLDS]
    for now in T[1:]:
        held.append(float(np.clip(held[-1], now / HOLDS, now * HOLDS)))
    assert np.max(np.abs(shown.T_tip - held)) < 2e-3


@pytest.mark.parametrize("given, factor", [(0.02, 1 / HOLDS), (-0.02, HOLDS)])
def test_a_tip_end_that_is_moved_far_slips_from_the_tip(given, factor):
    # Friction holds the tip's tension between these limits, whatever the end does.
    T = np.append(np.linspace(0.01, 20, 30), np.full(30, 15.0))
    time = 0.1 * np.arange(len(T))
    moved = with_laws(feed=lambda t: given * float(np.clip((t - 4) / 1.5, 0, 1)))
    shown = machine.run(moved, time, T)
    assert machine.run(SHEATH, time, T).T_tip[-1] == pytest.approx(20 / HOLDS, rel=1e-3)
    assert shown.T_tip[-1] == pytest.approx(15 * factor, rel=1e-3)


def test_a_shaken_sheath_lets_both_tensions_meet():
    shake = events.Event("shaken", 4.0, 5.0, 0.0, False, 0.0)
    T = np.append(np.linspace(0.01, 20, 30), np.full(30, 20.0))
    shown = machine.run(with_laws(friction=lambda g: shake.friction(g.time)), 0.1 * np.arange(len(T)), T)
    assert shown.T_tip[38] == pytest.approx(20 / HOLDS, rel=1e-3)
    assert shown.T_tip[-1] == pytest.approx(20, rel=1e-3)


def test_a_march_that_is_lost_is_given_up():
    T = np.linspace(0.01, 20, 5)
    with pytest.raises(machine.Lost):
        machine.run(SHEATH, 0.1 * np.arange(5), T, most=1e-300)
    assert machine.run(SHEATH, 0.1 * np.arange(5), T, most=1e-5).worst < 1e-5


def test_an_event_lasts_from_its_start_to_its_end():
    there = events.Event("tip-moved", 4.0, 6.0, 1e-3, True, 0.1)
    stays = dataclasses.replace(there, back=False)
    assert [there.feed(t) for t in (4.0, 5.0, 6.0)] == pytest.approx([0, 1e-3, 0])
    assert [stays.feed(t) for t in (4.0, 6.0, 9.0)] == pytest.approx([0, 1e-3, 1e-3])
    assert there.pull(np.asarray([3.0, 6.0, 20.0])) == pytest.approx([1, 0.9, 1])


@pytest.mark.parametrize("seed", range(6))
def test_histories_are_those_of_a_hand_or_a_motor(seed):
    driven = hand.drive(np.random.default_rng(seed), 20.0)
    steps = np.diff(driven.sampled)
    assert hand.SAMPLES[0] <= len(driven.sampled) <= hand.SAMPLES[1] and np.all(steps > 0)
    assert 0.8 * hand.RATE[0] < 1 / np.median(steps) < 1.5 * hand.RATE[1]
    T = driven.T_base
    assert T.min() > 0 and 15 < T.max() <= 20.5
    # Rests, several pulls, and slow ramps beside quick ones.
    assert np.mean(T < 0.02 * T.max()) > 0.02
    loaded = T > 0.25 * T.max()
    assert np.sum(np.diff(loaded.astype(int)) == 1) >= 2
    half_a_second = round(0.5 / hand.FINE)
    rates = np.abs(T[half_a_second:] - T[:-half_a_second])[loaded[half_a_second:]] / 0.5
    slow, quick = np.quantile(rates, [0.1, 0.995])
    assert quick > 30 * slow


def test_instruments_spoil_what_the_key_says_and_nothing_else():
    rng = np.random.default_rng(3)
    time = 0.02 * np.arange(6000)
    pull = 10 * (1 - np.cos(2 * np.pi * time / 20))
    true = {"T_base": pull + 1, "T_tip": 0.5 * pull + 1}
    seen = instruments.read(rng, time, true, 20.0)
    told, kept = seen.told, time[seen.kept]
    assert 1e-3 <= abs(told["delay_s"]) <= 0.03 and np.all(np.diff(seen.time) >= 0)
    assert np.max(np.abs(seen.time - kept)) < 6e-3
    assert not any(np.any((kept > a + 0.01) & (kept < b - 0.01)) for a, b in told["gaps_s"])
    late = {"T_base": true["T_base"], "T_tip": np.interp(time - told["delay_s"], time, true["T_tip"])}
    total = 0
    for cell in instruments.CELLS:
        off = np.abs(seen.cells[cell] - late[cell][seen.kept])
        bound = 8 * told["noise_N"][cell] + 1.2 * abs(told["drift_N"][cell])
        spoilt = np.zeros(len(kept), bool)
        for rows in seen.spoilt[cell].values():
            spoilt[rows] = True
        total += spoilt.sum()
        assert np.all(off[~spoilt] < bound)
        assert np.mean(off[spoilt] > bound) > 0.7
    assert total >= 4


def test_every_case_hides_two_to_four_effects_that_differ():
    drawn = rig.kinds(np.random.default_rng(1), 100)
    several = [hidden for kind, hidden in drawn if kind == "rig"]
    assert len(several) == 80 and all(hidden == () for kind, hidden in drawn if kind == "sound")
    assert {len(hidden) for hidden in several} == {2, 3, 4}
    for hidden in several:
        terms = [rig.term(h) for h in hidden]
        assert len(set(terms)) == len(terms) and len(rig.TWINS & set(terms)) <= 1
        assert sum(h in OUTSIDE for h in hidden) <= 1
    assert {h for hidden in several for h in hidden} == {*CATALOGUE, *OUTSIDE} - rig.LEFT_OUT
    assert 0.1 < np.mean([any(h in OUTSIDE for h in hidden) for hidden in several]) < 0.4


def test_a_case_is_what_its_key_says(tmp_path, monkeypatch):
    monkeypatch.setattr(hand, "SAMPLES", (300, 400))
    monkeypatch.setattr(rig, "EVENTFUL", 1.0)
    monkeypatch.setattr(rig, "SHEATHED", 1.0)
    hidden = ("drift", "tip-gain")
    one, two = (rig.make("rig", hidden, np.random.default_rng(12)) for _ in range(2))
    assert one is not None and two is not None and one.rows == two.rows and one.key == two.key
    cases.write(one, tmp_path, tmp_path / "key.json")
    config, recording = gtr.load_config(tmp_path / "robot.toml"), [*one.rows]
    key = one.key
    assert config.name == key["robot"] == "sheath" and key["terms"] == ["friction-drift", "tip-gain"]
    assert len(recording) == len(key["clean"]["T_tip"]) == len(key["clean"]["T_base"])
    assert key["events"] and all(0 < e["start_s"] < e["end_s"] < key["seconds"] for e in key["events"])
    assert all(rig.ORDINARY[0] < size < rig.ORDINARY[1] for size in key["sizes"].values())
    # Readings are the clean ones but for the noise, the drift, the delay and what is spoilt.
    read = np.asarray([float(row["T_base_N"]) for row in recording])
    bound = 8 * key["noise_N"]["T_base"] + 1.2 * abs(key["drift_N"]["T_base"])
    spoilt = [row for rows in key["spoilt"]["T_base"].values() for row in rows]
    off = np.delete(np.abs(read - key["clean"]["T_base"]), spoilt)
    assert np.all(off < bound)


def key(hidden, *, robot="one-bend", happened=(), outside=(), **more):
    return {
        "kind": "rig" if hidden or outside else "sound",
        "hidden": [*hidden, *outside],
        "terms": sorted(CATALOGUE[h][0] for h in hidden),
        "outside": list(outside),
        "always": list(rig.ALWAYS),
        "sizes": dict.fromkeys([*hidden, *outside], 0.02),
        "robot": robot,
        "pose": False,
        "displacement": False,
        "seconds": 100.0,
        "events": [{"kind": "shaken", "start_s": a, "end_s": b} for a, b in happened],
        "spoilt": {"T_base": {"glitch": [7, 8], "dropout": []}, "T_tip": {"glitch": [], "dropout": [20]}},
        "delay_s": 0.01,
        "noise_N": {"T_base": 0.03, "T_tip": 0.03},
        "clean": {"T_base": [1.0] * 50, "T_tip": [1.0] * 50},
    } | more


def answer(verdict, named=(), probability=0.99, **more):
    return {
        "verdict": verdict,
        "named": list(named),
        "sets": [sorted(named)] if named else [],
        "models": [{"terms": list(named), "probability": probability}],
        "tool": "test",
        "seconds": 10.0,
    } | more


def test_sets_are_scored_term_by_term_and_twins_count_as_one():
    sheath = rig_score.Rig("a", key(["tip-gain", "drift"], robot="sheath"), answer("missing-physics"))
    one = dataclasses.replace(
        sheath, answer=answer("missing-physics", ["friction-asymmetry", "friction-drift"])
    )
    assert one.exact and not one.wrong
    bends = dataclasses.replace(one, key=key(["tip-gain", "drift"]))
    assert not bends.exact and bends.wrong and bends.named & bends.truth == {"friction-drift"}
    doubtful = dataclasses.replace(bends, answer=bends.answer | {"models": []} | {"named_probability": 0.8})
    assert not doubtful.wrong
    # What the instruments always do is neither right nor wrong.
    delayed = dataclasses.replace(one, answer=answer("missing-physics", ["time-skew"]))
    assert not delayed.named and not delayed.claims and not delayed.wrong
    # Of rivals, the most probable counts, and what all hold is as sure as all together.
    rivals = answer("ambiguous", sets=[["friction-drift", "wear"], ["friction-drift", "presliding"]])
    rivals["models"] = [
        {"terms": ["friction-drift", "wear"], "probability": 0.6},
        {"terms": ["friction-drift", "presliding"], "probability": 0.4},
    ]
    open_ = rig_score.Rig("b", key(["drift"]), rivals)
    assert open_.named == {"friction-drift", "wear"} and open_.sure == {"friction-drift"} and not open_.wrong


@pytest.mark.parametrize(
    "hidden, outside, happened, named, right",
    [
        (["drift", "viscous"], [], [], ["friction-drift"], True),
        (["drift"], ["snag"], [], ["friction-drift"], True),
        (["drift"], [], [(5, 6)], ["friction-drift"], True),
        (["drift"], [], [], ["friction-drift"], False),
        (["drift", "viscous"], [], [], ["friction-drift", "wear"], False),
    ],
)
def test_partly_explained_is_right_where_all_named_is_there_and_something_is_left(
    hidden, outside, happened, named, right
):
    found = key(hidden, outside=outside, happened=happened)
    assert rig_score.Rig("a", found, answer("partly-explained", named)).partly_right == right


def test_events_glitches_delay_and_misfit_are_scored():
    said = answer("partly-explained", ["friction-drift"])
    said["episodes"] = [{"start_s": 10.0, "end_s": 12.0}]
    said["masked"] = [{"channel": "T_base", "first": 7, "last": 9}]
    said["parameters"] = {"time-skew.delay": [None, 0.012, 0.002]}
    said["intervals"] = {"time-skew.delay": [[0.011, 0.013], [0.008, 0.014]]}
    said["held_out"] = [{"rms_N": 0.5}, {"rms_N": 0.05}]
    case = rig_score.Rig("a", key(["drift"], happened=[(11.9, 12.3), (12.2, 12.3), (40, 41)]), said)
    assert case.found() == [True, True, False] and case.excluded() == pytest.approx(0.02, abs=2e-3)
    shaken = said | {
        "parameters": {"shaken-sheath.time": [None, 39, 1], "shaken-sheath.duration": [None, 2, 1]}
    }
    assert dataclasses.replace(case, answer=shaken).found() == [True, True, True]
    assert dataclasses.replace(case, answer=said | {"left_out": said["episodes"], "episodes": []}).found()[0]
    assert len(case.masked() & case.spoilt()) == 2 and len(case.masked()) == len(case.spoilt()) == 3
    assert case.delay() == pytest.approx(0.002)
    assert case.explained == pytest.approx(1 - (0.05**2 - 0.03**2) / (0.5**2 - 0.03**2))
    rows = {what: reached for what, _, reached in rig_score.overview([case])}
    assert rows["events found"].startswith("67 % (2/3;")
    assert rows["rows of glitches and dropouts that are left out"].startswith("67 % (2/3;")
    assert rows["partly-explained, and rightly so"].startswith("100 % (1/1;")
    told = rows["95 % interval of the delay averaged over models holds the truth"]
    assert told.startswith("100 % (1/1;") and "under the model shown 0 % (0/1;" in told
    # An answer without these keys has found none of it.
    bare = dataclasses.replace(case, answer=answer("unexplained"))
    assert (
        bare.found() == [False] * 3 and not bare.masked() and bare.delay() is None and bare.explained is None
    )


def test_a_law_that_is_found_is_told():
    """It counts as detected, and of an effect outside the catalogue as told if it is the right one."""
    law = {"acts": "friction", "of": "t"}
    strange = key(["drift"], outside=["breathing"])
    right, wrong = (
        rig_score.Rig("a", strange, answer("discovered", law={**law, "of": of})) for of in ("t", "T")
    )
    assert right.claims and wrong.claims and right.strange_told and not wrong.strange_told
    assert rig_score.Rig("b", key([]), answer("discovered", law=law)).claims
    assert rig_score.Rig("c", strange, answer("unexplained")).strange_told


def test_the_section_reports_refused_files_and_every_effect(tmp_path):
    scored = [
        rig_score.Rig("a", key(["drift", "tip-gain"]), answer("missing-physics", ["friction-drift"])),
        rig_score.Rig("b", key(["drift"], outside=["snag"]), answer("unexplained")),
        rig_score.Rig("c", key([]), {"verdict": "refused", "says": "glitches", "tool": "test"}),
        rig_score.Rig("d", key([]), answer("adequate")),
    ]
    rig_page.write(scored, tmp_path, "seed 0", 5)
    text = (tmp_path / "rig.md").read_text(encoding="utf-8")
    assert "| answered: the file is read and there is a verdict | 100 % | 75 % (3/4;" in text
    assert "| false alarms on sound recordings without events | ≤ 2 % | 50 % (1/2;" in text
    assert "| drift | friction-drift | 2 | 2.0% | 1 | 0 of 2 |" in text
    assert "| snag | – | 1 |" in text and "1 recordings were refused" in text
    lines = (tmp_path / "proof/rig-cases.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 5 and (tmp_path / "proof/rig-effects.png").stat().st_size > 5000


def test_a_case_that_the_machine_cannot_make_is_left_out_and_told(tmp_path, capsys):
    def never(kind, hidden, rng):
        return None

    assert exam._one((1, 7, "rig", ("creep",), tmp_path, never)) is None
    assert "case 7 of seed 1 is left out" in capsys.readouterr().out
