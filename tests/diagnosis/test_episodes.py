"""Misfit located in time, what is left out for it, and the verdict where part of a misfit is explained."""

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.decision import decide
from calibrate.diagnosis.diagnose import _on_all
from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.hypotheses.hypotheses import EVENTS, Hypothesis
from calibrate.diagnosis.likelihood.held_out import _when_known
from calibrate.diagnosis.outside.episodes import ALONE, RELAXES, SLIPPING, TOGETHER, _kind, _runs, episodes
from calibrate.diagnosis.outside.leave_out import ASKED, Stretch, asked_for, from_outside, left_out, without
from calibrate.diagnosis.prepare import Prepared, prepare
from calibrate.diagnosis.search import forward_search
from calibrate.inference.number import Number
from calibrate.inference.setup import Observation
from gtr_jax import InputError, Recording
from gtr_jax.config.config import parse_config
from gtr_jax.recordings.base_tension import exact

K = 400
ALL = np.ones(K, bool)
TENDON = SimpleNamespace(name="", drive="tension")


def test_noise_and_laws_that_are_wrong_everywhere_make_no_episodes():
    rng = np.random.default_rng(1)
    sd = np.full(K, 0.1)
    for _ in range(50):
        assert _runs(0.1 * rng.normal(size=K), sd, ALL) == []
    everywhere = 2.0 * np.sin(np.arange(K) / 9)
    assert _runs(everywhere + 0.1 * rng.normal(size=K), sd, ALL) == []


def test_an_episode_is_found_where_it_is():
    rng = np.random.default_rng(2)
    row, sd = 0.1 * rng.normal(size=K), np.full(K, 0.1)
    row[100:130] += 2.0
    row[300:306] -= 2.0
    row[350] += 9.0  # a single reading is none
    assert _runs(row, sd, ALL) == [(100, 129), (300, 305)]
    # What changes sign is two, and what is not compared is none.
    row[130:150] -= 2.0
    assert _runs(row, sd, ALL)[:2] == [(100, 129), (130, 149)]
    assert _runs(row, sd, ALL & (np.arange(K) < 290))[-1] == (130, 149)


def test_what_an_episode_looks_like():
    still, falls, rises = np.full(20, 10.0), np.linspace(10, 6, 20), np.linspace(4, 6, 20)
    assert _kind(falls, rises, held=0.0) == SLIPPING
    assert _kind(falls, rises, held=1.0) == RELAXES  # |ln(4/10)| falls to 0
    assert _kind(still, np.linspace(5, 7, 20), held=1.0) == RELAXES
    assert _kind(still, np.linspace(5, 3, 20), held=1.0) == ALONE  # away from the base
    assert _kind(falls, np.linspace(5, 3, 20), held=1.0) == TOGETHER


def part(time=True, name="rig"):
    t = np.linspace(0.0, 39.9, K)
    T = 10 + 5 * np.sin(t / 3)
    return Observation(
        name=name,
        path="rig.csv",
        robot=cast(Any, SimpleNamespace(tendons=(TENDON,), tendon_names=())),
        config=None,
        T_base=exact(T),
        channels=("T_tip",),
        recorded=0.5 * T[None, :],
        time=t if time else None,
        trial=None,
        noise_N=None,
    )


def likelihood_of(part, residual, slips=None):
    """The likelihood of one recording whose simulation is off by a residual, (K,)."""
    seen = SimpleNamespace(
        values=(part.T_tip + residual)[None], slips=np.zeros(part.samples, bool) if slips is None else slips
    )
    likelihood = SimpleNamespace(
        rigs=[SimpleNamespace(part=part)],
        residuals=lambda seen: [residual[None, :]],
        noise=[[SimpleNamespace(sd=0.05)]],
        weighs=[SimpleNamespace(passed=np.zeros((1, part.samples)))],
    )
    return likelihood, SimpleNamespace(seen=[seen])


def test_episodes_say_when_and_how_much_and_end_where_the_tendon_slips_again():
    row = np.zeros(K)
    row[100:120], row[200:210] = 0.8, -0.5
    slips = np.zeros(K, bool)
    slips[150] = True
    first, second = episodes(*likelihood_of(part(), row, slips))  # type: ignore[arg-type]
    assert (first.first, first.last, first.until, second.first, second.until) == (100, 119, 149, 200, K - 1)
    assert first.start_s == pytest.approx(10.0) and first.mean_N == pytest.approx(0.8)
    assert first.share > second.share and "too high by 0.8 N" in first.says and "10 to 11.9 s" in first.says
    # Of a recording that is simulated at some of its samples, places are those of the recording.
    some = part().only(np.arange(0, K, 2))
    (thin, *_) = episodes(*likelihood_of(some, row[::2]))  # type: ignore[arg-type]
    assert (thin.first, thin.last) == (100, 118)
    (plain, *_) = episodes(*likelihood_of(part(time=False), row))  # type: ignore[arg-type]
    assert plain.start_s is None and "samples 101 to 120" in plain.says


def recording(time=True):
    p = part(time)
    return Recording(T_base=p.T_base.T_base, path=Path("rig.csv"), sha256="", T_tip=p.T_tip, time=p.time)


def test_stretches_that_a_user_leaves_out():
    found = asked_for({"rig": recording()}, [(9.95, 12.05), (37.95, np.inf)])
    assert found == {"rig": [Stretch(100, 120, ASKED), Stretch(380, 399, ASKED)]}
    assert asked_for({"rig": recording(time=False)}, []) == {"rig": []}
    last = "no sample lies there; the recordings last from 0 to 39.9 s"
    with pytest.raises(InputError, match=re.escape(last)):
        asked_for({"rig": recording()}, [(50.0, 60.0)])
    with pytest.raises(InputError, match=re.escape("rig.csv: --exclude needs the time of the samples")):
        asked_for({"rig": recording(time=False)}, [(1.0, 2.0)])
    out = without(part(), [Stretch(100, 119, ASKED)])
    assert int((~out.counted).sum()) == 20 and without(part(), []).counted.all()
    # Of some of the samples, those that are left out stay left out.
    thin = out.only(np.arange(0, K, 3))
    assert (~thin.counted).sum() == 6  # 102, 105, ... 117
    (said,) = left_out(thin, [Stretch(100, 119, ASKED)], np.full((1, thin.samples), 0.3))
    assert said.size == pytest.approx(0.3) and said.samples == 6
    assert said.start_s == pytest.approx(10.2) and said.end_s == pytest.approx(11.7)


def test_episodes_from_outside_are_left_out_unless_they_are_too_many():
    row = np.zeros(K)
    row[100:120] = 0.8
    found = episodes(*likelihood_of(part(), row))  # type: ignore[arg-type]
    slips = np.zeros(K, bool)
    slips[125:] = True
    forgotten = episodes(*likelihood_of(part(), row, slips))  # type: ignore[arg-type]
    assert from_outside(found, {"rig": K}, {"rig": []}) is None  # held to the end: most of the recording
    assert from_outside(forgotten, {"rig": K}, {"rig": []}, [(11.0, 11.3)]) is None  # an event's time is off
    assert without(part(), [Stretch(0, K - 21, ASKED)]).counted.sum() == 20
    with pytest.raises(InputError, match="--exclude leaves 19 samples to compare"):
        without(part(), [Stretch(0, K - 20, ASKED)])
    stretches = from_outside(forgotten, {"rig": K}, {"rig": [Stretch(0, 3, ASKED)]})
    assert stretches is not None and [(s.first, s.last) for s in stretches["rig"]] == [(0, 3), (100, 124)]
    while_slipping = episodes(*likelihood_of(part(), row, np.ones(K, bool)))  # type: ignore[arg-type]
    assert from_outside(while_slipping, {"rig": K}, {"rig": []}) is None


def number(name, **more):
    return Number(name=name, unit="", centre=0.0, sd=1.0, log=False, size=True, **more)


def test_when_an_event_happens_is_not_asked_of_other_cycles():
    event = Hypothesis("sheath-moved", "sheath-moved", (number("change"), number("time")), ({},))
    gain = Hypothesis("base-gain", "base-gain", (number("gain"),), ({},))
    numbers = [number("mu"), *gain.numbers, *event.numbers]
    fitted = SimpleNamespace(
        numbers=numbers, x=np.asarray([0.1, 0.2, 0.3, 0.4]), values={"change": 0.3, "time": 12.0}
    )
    own, start = _when_known([gain, event], fitted)  # type: ignore[arg-type]
    assert own[0].numbers == gain.numbers and own[0].fixed == {}
    assert [n.name for n in own[1].numbers] == ["change"] and own[1].fixed == {"time": 12.0}
    np.testing.assert_array_equal(start, [0.1, 0.2, 0.3])
    assert {"sheath-moved", "shaken-sheath"} <= EVENTS


def test_part_of_a_misfit(monkeypatch):
    best, base = SimpleNamespace(names=("h1",)), SimpleNamespace(names=())
    fits = {("h1",): best, (): base}
    sure = {("h1",): 0.999, (): 0.001}
    models = SimpleNamespace(
        likelihood=SimpleNamespace(scale_left=lambda f: 1.0, heavy=None),
        base=base,
        fits=fits,
        probabilities_given_discrepancy=lambda f: sure,
        of={},
    )
    nearest = decide.Decision(
        verdict="unexplained",
        chosen=cast(Any, base),
        confusion=[],
        probability={},
        left=(9, 99),
        base_left=(10.0, 900.0),
    )
    monkeypatch.setattr(decide, "pattern_in", lambda likelihood, f: None)
    monkeypatch.setattr(decide, "_told_apart", lambda *some: ([("h1",)], True))

    def verdict(left):
        monkeypatch.setattr(decide, "misfit", lambda likelihood, f: left)
        return decide.decide_partly(models, best, nearest)  # type: ignore[arg-type]

    found = verdict((3.0, 80.0))
    assert found.verdict == "partly-explained" and found.confusion == [("h1",)] and found.chosen is best
    assert verdict((8.0, 800.0)).verdict == "unexplained"  # most of the structure stays
    # In a long recording, where every effect pays on unseen cycles, half of it in squares may stay.
    assert verdict((6.0, 500.0)).verdict == "unexplained"
    models.likelihood.heavy = 4.0
    assert verdict((6.0, 500.0)).verdict == "partly-explained"
    assert verdict((8.0, 800.0)).verdict == "unexplained"
    models.likelihood.heavy = None
    sure[("h1",)], sure[()] = 0.5, 0.5
    assert verdict((3.0, 80.0)).verdict == "unexplained"


def test_an_effect_pays_on_unseen_samples_or_is_not_kept(monkeypatch):
    head, good, little, uneven = (SimpleNamespace(names=n, cost=9.0) for n in ((), ("a",), ("b",), ("c",)))
    by = {
        (): [4.0, 4.0, 4.0, 4.0],
        ("a",): [2.0, 3.0, 2.0, 5.0],
        ("b",): [3.9, 3.9, 3.9, 3.9],
        ("c",): [0.0, 4.1, 4.1, 4.1],
    }
    monkeypatch.setattr(
        forward_search,
        "by_fold",
        lambda likelihood, models, pieces: np.asarray(
            [[[s, 1, s, 1] for s in by[f.names]] for _, f in models]
        ),
    )
    likelihood = SimpleNamespace(heavy=None, scale_left=lambda f: 1.0)
    models = SimpleNamespace(likelihood=likelihood, hypotheses=lambda names: [])
    unseen = forward_search.Unseen(models)  # type: ignore[arg-type]
    assert unseen.best(head, [good, little]) is good  # type: ignore[arg-type]
    assert unseen.best(head, [little]) is None  # type: ignore[arg-type]
    assert unseen.best(head, [uneven]) is None and unseen.best(head, []) is None  # type: ignore[arg-type]


SHEATH = {
    "schema": 1,
    "name": "sheath",
    "backbone": {
        "length": "1000 mm",
        "outer_radius": "2 mm",
        "youngs_modulus": "1 GPa",
        "natural_curvature": "10 rad/m",
        "rigid": True,
    },
    "routing": {"kind": "parallel", "offset": "0 mm"},
    "tendon": {"friction_coefficient": 0.05},
}


def test_a_smaller_model_is_no_rival_where_it_predicts_worse():
    best = SimpleNamespace(names=("h1", "h2"))
    models = SimpleNamespace(of={n: SimpleNamespace(kind=n) for n in ("h1", "h2", "h3")})
    found = decide.Decision(
        verdict="ambiguous",
        chosen=cast(Any, best),
        confusion=[("h1", "h2"), ("h1",)],
        probability={("h1", "h2"): 0.7, ("h1",): 0.25, (): 0.05},
        left=(0.1, 1.0),
        base_left=(10.0, 900.0),
    )
    told = decide.narrowed(models, found, [("h1",)])  # type: ignore[arg-type]
    assert told.verdict == "missing-physics" and told.confusion == [("h1", "h2")]
    assert decide.narrowed(models, found, []) is found  # type: ignore[arg-type]
    other = dataclasses.replace(found, confusion=[*found.confusion, ("h3",)])
    assert decide.narrowed(models, other, [("h1",)]).verdict == "ambiguous"  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_sheath_that_moves_and_a_tip_end_that_is_pulled(tmp_path):
    # Cycles of pull and release; a cell's gain is wrong, the sheath moves at 31 s, and at 57.5 s, held by
    # friction, the tip end is pulled and let go.
    rng = np.random.default_rng(5)
    time = np.linspace(0.0, 80.0, 1601)  # shifted below: events count from the first sample
    T = 6 + 5 * np.sin(2 * np.pi * time / 16 - np.pi / 2)
    config = parse_config(SHEATH)
    robot = gtr.build_robot(config)
    true = robot.with_values(
        **{
            "mu": 0.07,
            "sheath-moved.change": -0.25,
            "sheath-moved.time": 31.0,
            "sheath-moved.duration": 0.3,
        }
    )
    run = gtr.simulate(true, T, time=time)
    tip = 1.2 * np.asarray(run.T_tip) + 0.02 * rng.normal(size=len(time))
    pulled = (time > 57.5) & (time < 58.3)
    tip[pulled] += 1.5 * np.sin(np.pi * (time[pulled] - 57.5) / 0.8)
    recorded = Recording(T_base=T, path=tmp_path / "rig.csv", sha256="", T_tip=tip, time=time + 1000.0)
    found = calibrate.diagnose(config, recorded, noise_base_N=0.0)
    assert found.verdict == "partly-explained", found.says
    kinds = {kind for names in found.confusion_set for kind in names}
    assert {"sheath-moved", "tip-gain"} <= kinds and "shaken-sheath" not in kinds, found.says
    moved = next(c for c in found.parameters if c.name == "sheath-moved.time")
    assert moved.after == pytest.approx(31.0, abs=0.5)
    ends = [(e.start_s, e.end_s) for e in found.left_out if e.start_s is not None and e.end_s is not None]
    assert any(start < 1058.3 and end > 1057.5 for start, end in ends)
    assert sum(e.samples for e in found.left_out) < 0.1 * len(time)
    assert found.held_out[-1]["rms"] < 0.05 and (found.share_explained or 0.0) > 0.95
    says = found.to_json()
    assert says["left_out"] and "share_explained" in says
    # The same, told by the user.
    asked = calibrate.diagnose(config, recorded, noise_base_N=0.0, exclude=[(1057.5, 1058.4)])
    assert all(e.why == ASKED for e in asked.left_out) and "Left out of the fit as asked" in asked.says
    assert dataclasses.asdict(asked.left_out[0])["samples"] >= 10
    # Gains of the two cells are twins, and must come as a set.
    sets = [{*names} for names in found.confusion_set]
    assert (
        {"tip-gain", "sheath-moved"} in sets and {"base-gain", "sheath-moved"} in sets and found.named == []
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("true", "kind"),
    [
        ({"sheath-moved.change": -0.25, "sheath-moved.time": 31.0}, "sheath-moved"),
        ({"wear.rate": -0.05}, "wear"),
    ],
)
def test_an_event_replaces_an_effect_that_goes_on_only_where_it_happened(tmp_path, true, kind):
    rng = np.random.default_rng(6)
    time = np.linspace(0.0, 64.0, 801)
    T = 6 + 5 * np.sin(2 * np.pi * time / 16 - np.pi / 2)
    config = parse_config(SHEATH)
    run = gtr.simulate(gtr.build_robot(config).with_values(mu=0.07, **true), T, time=time)
    tip = np.asarray(run.T_tip) + 0.02 * rng.normal(size=len(time))
    recorded = Recording(T_base=T, path=tmp_path / "rig.csv", sha256="", T_tip=tip, time=time)
    ready = prepare(config, recorded, noise_base_N=0.0)
    assert isinstance(ready, Prepared)
    models = Models(ready.likelihood, ready.hypotheses)
    wear = ready.likelihood.refit(models.hypotheses(["wear"]), np.zeros(len(ready.likelihood.base) + 1))
    assert wear is not None
    models.add([ready.base, wear])
    whole = _on_all(models, ready.rough, ready.exact)
    assert whole is not None
    found = forward_search._with_event_instead(whole, whole.fits["wear",])
    assert found.names == (kind,)
    if kind == "sheath-moved":
        assert found.values["sheath-moved.time"] == pytest.approx(31.0, abs=0.5)
