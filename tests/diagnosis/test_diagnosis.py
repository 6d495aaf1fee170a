"""The diagnosis: noise, coordinates, evidence, what it names in labelled recordings, and what it writes."""

import dataclasses
import itertools
import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run_gtr

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.answer.sentence import sentence, sets_in_words
from calibrate.diagnosis.base.prepare import Prepared, prepare
from calibrate.diagnosis.decision import decide
from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.hypotheses.hypotheses import (
    EVENTS,
    Hypothesis,
    base_numbers,
    catalogue,
    may_join,
    number_of,
)
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.diagnosis.likelihood.locate import cycles_of, ratio_of_branches
from calibrate.diagnosis.likelihood.recording_length import ShortRecordings
from calibrate.diagnosis.outside.patterns import Pattern, pattern_in
from calibrate.diagnosis.screening.screen import screen
from calibrate.fitting.fit import part_of
from calibrate.inference.number import Number
from calibrate.inference.simulated_rig import SimulatedRig, at_samples, between
from calibrate.inference.simulation_cache import SimulationCache
from calibrate.inference.weighing import Weighing
from calibrate.planning.load_histories import checks, menu, more_histories
from calibrate.planning.proposal import propose
from calibrate.planning.ways_to_drive import turned, weighed, weight_to_hang
from gtr_jax.config.config import parse_config
from gtr_jax.recordings.base_tension import exact
from gtr_jax.recordings.signals.noise import Noise, of_residual
from gtr_jax.simulation.natively import Brief
from gtr_jax.simulation.sensing import cells_show
from gtr_jax.terms import REGISTRY

REFERENCE = Path(__file__).parents[1] / "data" / "reference"
LABELLED = Path(__file__).parents[1] / "data" / "labelled"


def case(number):
    folder = LABELLED / f"case-{number:03d}"
    recording = gtr.read_recording(folder / "recording.csv")
    return gtr.load_config(folder / "robot.toml"), recording, json.loads((folder / "truth.json").read_text())


@pytest.mark.parametrize("rho", [0.0, 0.4])
def test_noise_is_told_from_a_misfit(rho):
    rng, n = np.random.default_rng(1), 4000
    noise = np.zeros(n)
    for k in range(1, n):
        noise[k] = rho * noise[k - 1] + rng.normal() * np.sqrt(1 - rho**2)
    found = of_residual(0.05 * noise + 2.0 * np.sin(np.arange(n) / 200), 1e-6)
    assert found.sd == pytest.approx(0.05, rel=0.1) and found.rho == pytest.approx(rho, abs=0.06)


@pytest.mark.parametrize(("rho", "least"), [(0.0, 0.8), (0.25, 0.6), (0.5, 0.33)])
def test_slow_noise_of_short_recordings_is_not_underestimated(rho, least):
    # What sums over neighbours scatter by is what a false alarm is made of: with no correlation taken for
    # granted it came out at 0.17 of what it is where neighbours go together by 0.5.
    rng, found = np.random.default_rng(2), []
    for _ in range(200):
        noise = rng.normal(size=80)
        for k in range(1, len(noise)):
            noise[k] = rho * noise[k - 1] + noise[k] * np.sqrt(1 - rho**2)
        seen = of_residual(noise, 1e-9)
        found.append(seen.sd**2 * (1 + seen.rho) / (1 - seen.rho) * (1 - rho) / (1 + rho))
    assert least < np.median(found) < 1.7


def models_of(squares):
    """Models of 500 readings, by what each leaves."""
    fits: Any = {}
    for names, chi2 in squares.items():
        volume, rows = -2.0 * len(names), np.full(4, chi2)
        fits[names] = SimpleNamespace(
            names=names, cost=chi2, prior=0.0, chi2=chi2, rows=rows, volume=lambda v=volume: v
        )
    likelihood: Any = SimpleNamespace(
        readings=500, rigs=[], rules=ShortRecordings(), mean_square=lambda f: f.chi2 / 500
    )
    known = {name for names in squares for name in names} | {f"h{k}" for k in range(35)}
    hypotheses: Any = [SimpleNamespace(name=name, kind=name.partition(".")[0]) for name in sorted(known)]
    models = Models(likelihood, hypotheses)
    models.fits = fits
    return models


def probabilities(squares):
    """Of the same."""
    return models_of(squares).probabilities()


def test_a_law_may_be_wrong_by_a_share_of_what_it_does():
    # Were laws exact, a rival that leaves 120 more would be out of the question.
    p = probabilities({(): 10_000.0, ("h1",): 500.0, ("h2",): 620.0})
    assert p[("h1",)] > p[("h2",)] > 1e-4 and p[()] < 1e-12
    # A second effect is not proven by a little of what the first leaves, but by much of it.
    assert probabilities({(): 10_000.0, ("h1",): 525.0, ("h1", "h2"): 500.0})[("h1",)] > 0.5
    assert probabilities({(): 10_000.0, ("h1",): 2500.0, ("h1", "h2"): 500.0})[("h1", "h2")] > 0.9
    # A residual that is large for another reason makes no effect of what takes away little of it.
    assert probabilities({(): 1500.0, ("h1",): 1485.0})[()] > 0.5


def test_a_regularity_is_no_noise():
    # The noise of a recording is not known here: it may be of any size, as it is where neighbours swing.
    rng, K, waves = np.random.default_rng(3), 120, 15
    T = 22.5 - 22.5 * np.cos(np.linspace(0, 6 * np.pi, K)) + rng.uniform(0, 6, K)
    tip = 0.8 * T
    period = np.ptp(tip) / waves
    rings = np.exp(-0.3 * np.arange(8)) * np.sin(1.2 * np.arange(8))
    ringing = np.convolve(np.diff(tip, prepend=tip[0]), rings)[:K]

    def found(z, timed=True):
        tendon = SimpleNamespace(name="", drive="tension")
        robot = SimpleNamespace(tendons=(tendon,), tendon_names=())
        part = SimpleNamespace(
            name="r", samples=K, channels=("T_tip",), robot=robot, tips=1, explained=1, others=()
        )
        part.recorded, part.smallest, part.noise_N = (z + tip)[None], [0.0], None
        part.counted = np.ones(K, bool)
        part.drives, part.pulled = (SimpleNamespace(T_base=T),), [T]
        part.time, part.places = 0.5 * np.arange(K) if timed else None, np.arange(K)
        likelihood = Likelihood(
            rigs=(cast(Any, SimpleNamespace(part=part, where=[0])),),
            base=(),
            noise=[[Noise(1.0, 0.0)]],
            weighs=[Weighing.plain(exact(T), ("T_tip",), np.ones(1))],
        )
        rows = np.concatenate([z, np.zeros(K)])
        slope = np.concatenate([tip, np.zeros(K)])[:, None]
        seen = [SimpleNamespace(values=tip[None])]
        fitted = SimpleNamespace(rows=rows, jacobian=slope, x=np.zeros(1), seen=seen)
        return pattern_in(likelihood, cast(Fitted, fitted))

    by_tension = found(rng.normal(size=K) + 1.6 * np.sin(2 * np.pi * tip / period))
    assert by_tension is not None and by_tension.along in ("T_tip", "T_base")
    wanted = period if by_tension.along == "T_tip" else period / 0.8
    assert by_tension.period_N == pytest.approx(wanted, rel=0.1) and 0.4 < by_tension.share < 0.7
    by_sample = found(rng.normal(size=K) + 1.6 * ringing / np.std(ringing))
    assert by_sample is not None and by_sample.along == "sample" and "ringing" in by_sample.says
    bump = np.exp(-0.5 * ((T - 19.0) / 1.5) ** 2)
    at_a_tension = found(rng.normal(size=K) + 4.0 * bump)
    assert at_a_tension is not None
    wanted = 19.0 if at_a_tension.along == "T_base" else 0.8 * 19.0
    assert at_a_tension.at_N == pytest.approx(wanted, rel=0.05)
    assert 1.5 < at_a_tension.width_N < 6.0 and "bulges" in at_a_tension.says
    standing = rng.normal(size=K)
    standing[24:30] += tip[23] - tip[24:30]
    stands = found(standing)
    assert stands is not None and stands.along == "time" and stands.chance < 1e-4 and stands.share > 0.6
    (only,) = stands.stands
    # The reading that is held may belong to them, where the model has come off it.
    assert 22 <= only.first <= 26 and only.last == 29 and only.readings == 30 - only.first
    assert only.time_s == (0.5 * only.first, 14.5)
    many = f"{only.readings} consecutive readings"
    assert f"stand still, {many} (1" in stands.says and "to 14.5 s" in stands.says
    untimed = found(standing, timed=False)
    assert untimed is not None and " s, " not in untimed.says and "consecutive readings (" in untimed.says
    # Isolated spikes do not hide it, but more elsewhere does. Readings that move, less than the model or as
    # much, do not stand; neither do few, or those that a recording begins with.
    spiked = standing.copy()
    spiked[[60, 80]] = 60.0
    assert (again := found(spiked)) is not None and again.stands == stands.stands
    elsewhere, slow, few, first = (rng.normal(size=K) for _ in range(4))
    elsewhere[24:30] = standing[24:30]
    elsewhere[[60, 61, 80, 81]] = 40.0
    slow[24:40] += 0.65 * (tip[23] - tip[24:40])
    few[28:32] += tip[27] - tip[28:32]
    first[:14] += tip[14] - tip[:14]
    bad = rng.normal(size=K) + np.where(np.abs(np.arange(K) - 27) < 4, 12.0, 0.0)
    for z in (elsewhere, slow, few, first, bad):
        assert (other := found(z)) is None or other.along != "time"
    # A smooth misfit of pull and release is none, and neither is what is left of an exact model.
    u, way = T / 45, np.sign(np.diff(T, prepend=-1.0))
    for size in (0.02, 5.0):
        assert found(size * way * u * (1 - u) + min(size, 1.0) * rng.normal(size=K)) is None
    assert found(0.01 * np.sin(2 * np.pi * tip / period)) is None
    # Noise is none, whether it is small, large or has outliers.
    assert sum(found(3.0 * rng.normal(size=K)) is not None for _ in range(200)) <= 1
    assert sum(found(rng.standard_t(3, size=K)) is not None for _ in range(200)) <= 1


def decision(monkeypatch, squares, left=None, pattern=None):
    """Of models of 500 readings, by what each leaves; structure by names, none unless given."""
    said = {(): (5.0, 50.0), **(left or {})}
    monkeypatch.setattr(decide, "misfit", lambda likelihood, f: said.get(f.names, (0.0, 0.0)))
    monkeypatch.setattr(
        decide, "pattern_in", lambda likelihood, f: pattern if f.names in (left or {}) else None
    )
    return decide.decide(models_of(squares))


def test_nothing_is_claimed_of_a_small_drop(monkeypatch):
    sound = {(): (0.1, 1.0)}
    assert decision(monkeypatch, {(): 544.0, ("h1",): 510.0}, sound).verdict == "adequate"
    assert decision(monkeypatch, {(): 560.0, ("h1",): 510.0}, sound).verdict == "missing-physics"


def test_what_stays_is_unexplained(monkeypatch):
    squares = {(): 10_000.0, ("h1",): 3000.0}
    # A law may leave structure that is significant, but not most of it.
    assert decision(monkeypatch, squares, {("h1",): (2.0, 30.0)}).verdict == "missing-physics"
    assert decision(monkeypatch, squares, {("h1",): (2.2, 30.0)}).verdict == "unexplained"
    some = {(): (2.0, 50.0), ("h1",): (1.0, 30.0)}
    assert decision(monkeypatch, squares, some).verdict == "missing-physics"
    some[("h1",)] = (1.2, 30.0)
    assert decision(monkeypatch, squares, some).verdict == "unexplained"
    small = {(): (0.5, 12.0), ("h1",): (0.4, 3.0)}
    assert decision(monkeypatch, squares, small).verdict == "unexplained"
    # Noise with outliers has size, and no significance.
    small[("h1",)] = (0.4, 1.0)
    assert decision(monkeypatch, squares, small).verdict == "missing-physics"
    rings = Pattern("r", "sample", 1e-9, 0.5)
    found = decision(monkeypatch, squares, small, rings)
    assert found.verdict == "unexplained" and found.pattern is rings
    sound, bad_repeat, vast = ({(): (size, 0.5)} for size in (0.1, 1.5, 2.6))
    assert decision(monkeypatch, {(): 510.0}, sound).verdict == "adequate"
    assert decision(monkeypatch, {(): 510.0}, bad_repeat).verdict == "adequate"
    assert decision(monkeypatch, {(): 510.0}, vast).verdict == "unexplained"
    assert decision(monkeypatch, {(): 510.0}, sound, rings).verdict == "unexplained"


def test_sets_hold_what_laws_may_have_wrong(monkeypatch):
    # One of two effects that explains nearly all may be all there is.
    found = decision(monkeypatch, {(): 10_000.0, ("h1",): 900.0, ("h2",): 8000.0, ("h1", "h2"): 500.0})
    assert found.verdict == "ambiguous" and found.confusion == [("h1", "h2"), ("h1",)]
    found = decision(monkeypatch, {(): 10_000.0, ("h1",): 3000.0, ("h2",): 8000.0, ("h1", "h2"): 500.0})
    assert found.verdict == "missing-physics" and found.confusion == [("h1", "h2")]
    # Two variants of a term are one name; two terms are a set.
    variants = {(): 10_000.0, ("h1.base",): 500.0, ("h1.tip",): 500.5}
    found = decision(monkeypatch, variants)
    assert found.verdict == "missing-physics" and len(found.confusion) == 2
    assert decision(monkeypatch, {(): 10_000.0, ("h1",): 500.0, ("h2",): 500.5}).verdict == "ambiguous"


def test_coordinates_of_a_number():
    for n in (
        Number("a", "m", 0.0, 2.0, False, 0.0),
        Number("b", "", 1.0, 0.1, True, 0.0),
        number_of(REGISTRY["presliding"], REGISTRY["presliding"].quantities[0]),
    ):
        for x in (0.3, 1.2):
            assert n.at(n.value(x)) == pytest.approx(x)
    assert Number("a", "m", 0.0, 2.0, False, 0.0).value(-1.0) == 0.0
    assert Number("b", "", 1.0, 0.1, True, 0.0).bounds == (-8.0, 8.0)


def test_every_term_is_a_hypothesis_unless_it_cannot_act(make_robot):
    def kinds(robot, timed=True, displaced=False):
        given = {"largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
        return {h.kind for h in catalogue(robot, timed=timed, displaced=displaced, **given)}

    never = {"gravity-error", "quantisation", "hyperelastic", "superelastic"} | EVENTS
    assert {"shaken-sheath", "sheath-moved", "tip-moved"} == EVENTS
    assert set(REGISTRY) - kinds(make_robot()) == never | {"free-length"}
    assert set(REGISTRY) - kinds(make_robot(), displaced=True) == never
    metal = make_robot(backbone={"youngs_modulus": 50e9})
    assert set(REGISTRY) - kinds(metal, displaced=True) == never - {"superelastic"}
    assert "viscous-friction" not in kinds(make_robot(), timed=False)
    assert "adhesion" not in kinds(make_robot(terms=[{"kind": "adhesion", "drag": 1.0}]))
    sheath = {"rigid": True, "natural_curvature": 4.0}
    assert not kinds(make_robot(backbone=sheath)) & {"stiffening", "contact", "tip-load"}
    for h in catalogue(make_robot(), timed=True, largest_tip=10.0, travel=np.array([0.0, 0.1]), bend=5.0):
        for start in h.starts:
            assert set(start) == {n.name for n in h.numbers}
            for n in h.numbers:
                low, high = n.bounds
                assert low <= n.at(start[n.name]) <= high, (h.name, n.name)
        assert 1 <= len(h.few) <= 2 and all(start in h.starts for start in h.few)


def test_what_acts_beside_another_effect_does_nothing_at_its_null(make_robot):
    given = {"timed": True, "largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    robot = make_robot()
    of = {h.name: h for h in catalogue(robot, **given) if REGISTRY[h.kind].of_cells}
    clock = jnp.linspace(0.0, 6.0, 61)
    T = 8.0 * jnp.sin(clock) ** 2
    at = cast(Any, SimpleNamespace(time=clock))

    def shown(kind: str, *given: Any):
        values = {name: value for each in given for name, value in each.items()}
        own: Any = {q.name: q.null for q in REGISTRY[kind].quantities}
        own |= {name.partition(".")[2]: value for name, value in values.items()}
        return [hook(own, T, at) for hook in (REGISTRY[kind].tip, REGISTRY[kind].base) if hook is not None]

    joined = set()
    for one, other in itertools.permutations(of.values(), 2):
        if one.kind == other.kind and may_join(other, [one]):
            joined.add((one.name, other.name))
            names = {n.name for n in other.numbers}
            sizes = {f"{one.kind}.{q.name}": q.null for q in REGISTRY[one.kind].sizes}
            null = {name: value for name, value in sizes.items() if name in names}
            assert may_join(one, [other])
            for start, more in itertools.product(one.few, other.few):
                for a, b in zip(shown(one.kind, start), shown(one.kind, start, more, null), strict=True):
                    np.testing.assert_array_equal(a, b, err_msg=f"{one.name} beside {other.name}")
    assert ("low-pass.tip", "low-pass.base") in joined
    assert ("low-pass.tip", "low-pass.base-second") not in joined
    assert ("saturation.base", "saturation.tip-knee") not in joined


@pytest.mark.parametrize("name", ["cell-hysteresis.tip-spread", "cell-hysteresis.base-spread"])
def test_a_hysteretic_cell_starts_from_numbers_that_a_cell_can_have(make_robot, name):
    given = {"timed": True, "largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    (h,) = (h for h in catalogue(make_robot(), **given) if h.name == name)
    fault = REGISTRY[h.kind].fault
    assert fault is not None and len(h.starts) >= 3
    for start in h.starts:
        own = {"tip": 0.0, "base": 0.0} | {key.partition(".")[2]: value for key, value in start.items()}
        assert not fault(own, 0.25), start
    assert len({start["cell-hysteresis.width"] for start in h.few}) == 2


def test_a_law_may_be_named_as_a_form_of_a_term_is():
    config, _, _ = case(11)
    law = {"kind": "law", "name": "heat-spread", "acts": "friction", "law": "1/(1+size*n)", "size": 0.0}
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["terms"] = [law | {"usual": {"size": [0.0, 1.0]}}]
    given = {"timed": True, "largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    (h,) = (h for h in catalogue(gtr.build_robot(parse_config(data)), **given) if "heat-spread" in h.name)
    assert [number.name for number in h.numbers] == ["heat-spread.size"]


def test_cycles_and_branches():
    T = np.concatenate([np.linspace(0, 10, 11), np.linspace(10, 1, 10)[1:], np.linspace(1, 9, 9)[1:]])
    assert cycles_of(T).tolist() == [1] * 19 + [2] * 9
    phases = np.where(np.gradient(T) > 0, "pulling", "releasing")
    mu = 0.4
    tip = T * np.exp(np.where(phases == "pulling", -mu, mu))
    _, D, S = ratio_of_branches(T, tip, phases)
    np.testing.assert_allclose(D, mu)
    np.testing.assert_allclose(S, 0.0, atol=1e-12)


def test_the_menu_is_driveable():
    for name, (time, T) in (menu(20.0, 80, 15.0) | more_histories(20.0, 80, 15.0)).items():
        assert len(time) == len(T) == 80 and np.all(np.diff(time) > 0), name
        assert T.min() >= 0 and T.max() <= 20.0 + 1e-9


def test_a_sound_recording_is_adequate():
    config, recording, _ = case(11)
    found = calibrate.diagnose(config, recording)
    assert found.verdict == "adequate" and found.named == [] and found.converged
    assert found.probability[""] > 0.9
    assert found.rms[0] == pytest.approx(found.noise, rel=0.15)
    assert found.smallest_detectable["presliding.length"] < 5e-4


@pytest.mark.slow
def test_readings_that_stand_still_are_left_out_and_unexplained():
    """A cell that hangs says nothing about the robot, whose numbers come from the other readings."""
    config, recording, _ = case(11)
    tip = np.array(recording.T_tip)
    for first, after in ((10, 15), (36, 41)):
        tip[first:after] = tip[first]
    found = calibrate.diagnose(config, dataclasses.replace(recording, T_tip=tip))
    assert found.verdict == "unexplained" and found.named == []
    assert found.says.startswith("Readings stand still for a while where the model moves")
    assert (
        "In the rest nothing is missing" in found.says and "because readings stand still there" in found.says
    )
    # In the first stretch friction holds the model as well; of the second, the first reading is as it was.
    (stretch,) = found.left_out
    assert (stretch.first, stretch.last) == (37, 40) and stretch.outside
    assert found.pattern is None and found.rms[1] < 1.3 * found.expected
    sound = calibrate.diagnose(config, recording)
    mu, was = (next(c for c in d.parameters if c.name == "mu") for d in (found, sound))
    assert mu.after == pytest.approx(was.after, abs=2 * cast(float, was.sd))
    # What a sentence says of the residual, its numbers carry.
    seen = dataclasses.replace(found, verdict="adequate", rms=(0.9, 0.9), noise=0.3, expected=0.3)
    assert "is 0.9 N where the noise is 0.3 N, which is more" in sentence(seen, ())
    assert "is 0.4 N where the noise is 0.3 N." in sentence(dataclasses.replace(seen, rms=(0.4, 0.4)), ())
    named = dataclasses.replace(found, verdict="missing-physics", named=["presliding"], left=(1.2, 30.0))
    assert "Structure of 1.2 standard deviations" in sentence(named, ("presliding",))
    assert "Structure" not in sentence(dataclasses.replace(named, left=(0.3, 30.0)), ("presliding",))


@pytest.fixture(scope="module")
def asymmetry(tmp_path_factory):
    """Case 5 diagnosed at the command line."""
    out = tmp_path_factory.mktemp("diagnosed") / "out"
    folder = LABELLED / "case-005"
    return folder, out


def test_the_command_names_an_effect(asymmetry, capsys):
    folder, out = asymmetry
    outcome = run_gtr(
        capsys, "diagnose", folder / "robot.toml", folder / "recording.csv", "--next", "-o", out
    )
    assert outcome.status == 0 and outcome.out.startswith("missing-physics: Missing: friction-asymmetry")
    data = json.loads((out / "diagnosis.json").read_text())
    truth = json.loads((folder / "truth.json").read_text())
    assert data["named"] == ["friction-asymmetry"] and data["converged"]
    ratio = data["parameters"]["friction-asymmetry.ratio"]
    assert abs(ratio["value"] - truth["parameters"]["asym"]) < 3 * ratio["sd"]
    mu = data["parameters"]["mu"]
    assert abs(mu["after"] - truth["mu"]) < 3 * mu["sd"] < abs(mu["before"] - truth["mu"]) * 3
    held = data["fit"]["held_out_rms_N"]
    assert held["after"] < 0.5 * held["before"] and held["after"] < 1.3 * data["fit"]["noise_N"]
    assert data["where"] and data["where"][0]["excess_rms"] > 0.05
    # What it found is a robot file for every other command, and the experiment a history.
    robot = gtr.load_robot(out / "diagnosed.toml")
    assert float(robot.value("friction-asymmetry.ratio")) == pytest.approx(ratio["value"])
    history = np.genfromtxt(out / "next-experiment.csv", delimiter=",", names=True)
    driven = history["weight_base_N" if "weight_base_N" in (history.dtype.names or ()) else "T_base_N"]
    assert len(driven) >= 18 and driven.max() <= 1.01 * 45
    page = (out / "report.html").read_text()
    assert "friction-asymmetry" in page and "http" not in page.split("<body")[1].split("settings")[0][:2000]
    (text,) = re.findall(r'<script type="application/json">(.*?)</script>', page)
    played = json.loads(text)
    titles = [chart["title"] for chart in played["charts"]]
    assert titles[:5] == ["Loop", "Tensions", "What is left", "Tip x", "Tip y"]
    rows = np.genfromtxt(out / "diagnosis.csv", delimiter=",", names=True, usecols=range(5))
    columns = {c["label"]: np.array(c["values"], float) for c in played["columns"]}
    np.testing.assert_allclose(columns["T_tip, recorded"], rows["T_tip_N"], rtol=1e-4, atol=1e-9)
    assert len(played["body"]["steps"]) > 20 and played["body"]["samples"][-1] == len(rows) - 1
    for name in ("loop.png", "residual.png", "rivals.png", "next-experiment.png", "diagnosis.csv"):
        assert (out / name).exists(), name


def screened_by(simulates, failed):
    """Starts of a hypothesis with a size and a shape, and its gain, beside a fit with steps that failed: its
    length and size at each start, best first.
    """
    u = np.linspace(0, 1, 40)
    mu, size = Number("mu", "", 0.3, 1.5, True), Number("a.size", "", 0.0, 1.0, False, 0.0, np.inf, True)
    length = Number("a.length", "", 1.0, 1.0, True)
    starts = tuple({"a.size": s, "a.length": w} for s in (0.3, 1.0) for w in (0.4, 2.5))
    rows = 10 * np.sin(3 * u)

    def simulate(values, names=()):
        return (SimpleNamespace(failed=failed, v=values),) if simulates(values["a.size"]) else None

    def left(seen):
        v = seen[0].v
        return rows - 10 * v["a.size"] * np.sin(3 * u / v["a.length"]) + np.log(v["mu"] / 0.3) * 10 * u

    likelihood: Any = SimpleNamespace(simulate=simulate, rows=left, refit=lambda *a, **k: None)
    fitted: Any = SimpleNamespace(
        cost=float(rows @ rows) + 1e3 * failed,
        rows=rows,
        jacobian=10 * u[:, None] * mu.sd,
        x=np.zeros(1),
        numbers=(mu,),
        values={"mu": 0.3},
        names=(),
        failed=failed,
    )
    found = screen(likelihood, fitted, [Hypothesis("a", "a", (size, length), starts)])[0]
    return [(length.value(s.x[2]), size.value(s.x[1])) for s in found.starts], found.gain, float(rows @ rows)


def test_starts_that_cannot_be_simulated_come_last():
    starts, _, _ = screened_by(lambda size: size < 0.6, failed=0)
    assert [size for _, size in starts[2:]] == [1.0, 1.0]


def test_steps_that_fail_are_nothing_to_explain():
    starts, gain, there = screened_by(lambda size: True, failed=2)
    assert len(starts) == 4 and 0 < gain <= there


@pytest.mark.slow
def test_a_rough_stretch_is_among_the_first():
    # Mu and E follow it along a valley, from each place that it may have: no one step tells.
    folder, rng = REFERENCE / "local-friction-stretch", np.random.default_rng(2)
    run = gtr.read_recording(folder / "recording.csv")
    noise = {"T_tip": 0.05, "tip_x": 3e-4, "tip_y": 3e-4, "tip_angle": 5e-3, "displacement": 1e-4}
    noisy = {
        name: np.asarray(getattr(run, name)) + sd * rng.normal(size=len(run)) for name, sd in noise.items()
    }
    ready = prepare(gtr.load_config(folder / "robot.toml"), dataclasses.replace(run, **noisy))
    assert isinstance(ready, Prepared)
    screened = screen(ready.likelihood, ready.base, ready.hypotheses)
    assert screened[0].hypothesis.name == "local-friction.stretch"


@pytest.mark.slow
def test_presliding_is_named():
    config, recording, truth = case(0)
    found = calibrate.diagnose(config, recording)
    assert found.verdict == "missing-physics" and found.named == ["presliding"]
    length = next(c for c in found.parameters if c.name == "presliding.length")
    assert length.after == pytest.approx(truth["parameters"]["x0"], rel=0.1)


@pytest.mark.slow
def test_a_set_is_closed_under_simulation():
    # A recording made by any model of the set has the same set.
    config, recording, _ = case(5)
    robot, T, time = gtr.build_robot(config), jnp.asarray(recording.T_base), jnp.arange(float(len(recording)))
    rng = np.random.default_rng(5)

    def diagnosed(values):
        own = robot.with_values(**values)
        shown = cells_show(own, T, gtr.simulate(own, T, time=time).T_tip, time)
        noisy = np.asarray(shown.T_tip) + 0.04 * rng.normal(size=len(T))
        made = {"T_base": np.asarray(shown.T_base), "T_tip": noisy, "time": np.asarray(time)}
        return calibrate.diagnose(config, gtr.Recording(path=Path("r.csv"), sha256="", **made))

    found = diagnosed({"mu": 0.4, "tip-gain.gain": 1.06})
    assert found.verdict == "ambiguous" and ["tip-gain"] in found.confusion_set
    values = {r.names: r.values for r in found.rivals}
    for names in found.confusion_set:
        again = diagnosed(values[tuple(names)])
        assert sorted(again.confusion_set) == sorted(found.confusion_set), names


def test_data_that_cannot_be_diagnosed():
    config, recording, _ = case(11)
    T_base, T_tip = np.asarray(recording.T_base), np.asarray(recording.T_tip)

    def verdict(**columns):
        given = {"T_base": T_base, "T_tip": T_tip, **columns}
        return calibrate.diagnose(config, gtr.Recording(path=Path("r.csv"), sha256="", **given))

    swapped = verdict(T_base=T_tip, T_tip=T_base)
    assert swapped.verdict == "bad-data" and "swap the columns" in swapped.says
    assert "never changes" in verdict(T_tip=np.full_like(T_tip, 3.0)).says
    assert "too few" in verdict(T_base=T_base[:12], T_tip=T_tip[:12]).says
    two = gtr.load_config(Path(__file__).parents[2] / "examples" / "antagonists.toml")
    with pytest.raises(gtr.InputError, match="for a robot of 2 tendons"):
        calibrate.diagnose(two, recording)


def test_an_interrupted_diagnosis_goes_on_where_it_stopped(tmp_path, monkeypatch):
    config, recording, _ = case(11)
    steps = tmp_path / "deep" / "run.steps"
    whole = calibrate.diagnose(config, recording)

    def interrupt(said):
        if "hypotheses" in said:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        calibrate.diagnose(config, recording, steps=steps, progress=interrupt)
    done, simulated = len(SimulationCache(steps)), []
    assert done > 20
    real = SimulatedRig._simulated
    monkeypatch.setattr(
        SimulatedRig, "_simulated", lambda rig, keys: simulated.extend(keys) or real(rig, keys)
    )
    again = calibrate.diagnose(config, recording, steps=steps)
    assert again.to_json() == whole.to_json()
    # What was done is not done again; and once all is, nothing is.
    assert len(simulated) == len(SimulationCache(steps)) - done
    simulated.clear()
    assert calibrate.diagnose(config, recording, steps=steps).to_json() == whole.to_json() and not simulated


@pytest.mark.slow
def test_a_simulation_does_not_depend_on_those_before_it(make_robot):
    robot = make_robot()
    T = np.concatenate([np.linspace(0.0, 20.0, 21), np.linspace(20.0, 0.0, 21)[1:]])
    recording = gtr.Recording(path=Path("r.csv"), sha256="", time=np.arange(41.0), T_base=T, T_tip=0.8 * T)
    part, _ = part_of("r", robot, None, recording, ("T_tip",), noise_N=0.02, noise_base_N=0.02)
    given = {"timed": True, "largest_tip": 8.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    hypotheses = [h for h in catalogue(robot, **given, displaced=True) if h.few]
    plain = {"mu": 0.2, "E": float(robot.value("E"))}
    tried = [plain, *(plain | dict(h.few[0]) | dict(h.fixed) for h in hypotheses)]
    assert {"free-length", "tip-gain", "tip-load"} <= {h.name.partition(".")[0] for h in hypotheses}
    before, after = SimulatedRig(part, robot), SimulatedRig(part, robot)
    forth = [before(values) for values in tried]
    back = [after(values) for values in reversed(tried)][::-1]
    nothing = forth[0]
    for values, one, other in zip(tried, forth, back, strict=True):
        assert one is not None and other is not None and nothing is not None
        np.testing.assert_array_equal(one.values, other.values)
        # What a cell that saturates showed cannot be told from what it lost.
        same = values is plain or "saturation.base" in values
        assert same == np.array_equal(one.values, nothing.values), values


def test_friction_of_the_speed_takes_several_steps_for_each_sample(make_robot, monkeypatch):
    robot = make_robot()
    T = np.concatenate([np.linspace(0.0, 20.0, 11), np.linspace(20.0, 4.0, 9)[1:], np.linspace(4, 15, 8)[1:]])
    clock = np.cumsum(np.where(np.arange(len(T)) % 3 == 0, 0.8, 0.3))
    recording = gtr.Recording(path=Path("r.csv"), sha256="", time=clock, T_base=T, T_tip=0.8 * T)
    part, _ = part_of("r", robot, None, recording, ("T_tip",), noise_N=0.02, noise_base_N=0.02)
    rig = SimulatedRig(part, robot)
    row = rig.channels.index("T_tip")
    plain = {"mu": 0.3, "E": float(robot.value("E"))}
    k = np.arange(4 * len(T) - 3) / 4
    for values, places in (
        (plain, np.arange(len(T))),
        (plain | {"adhesion.drag": 2.0}, np.arange(len(T))),
        (plain | {"viscous-friction.coefficient": 60.0}, k),
    ):
        seen = rig(values)
        finer = [np.interp(places, np.arange(len(T)), column) for column in (T, clock)]
        run = gtr.simulate(robot.with_values(**values), finer[0], time=finer[1])
        assert seen is not None and seen.failed == 0 and run.converged.all()
        want = np.asarray(run.T_tip)[:: (len(places) - 1) // (len(T) - 1)]
        np.testing.assert_allclose(seen.values[row], want, atol=1e-8)
    by_samples = gtr.simulate(robot.with_values(**values), T, time=clock)
    assert np.max(np.abs(want - by_samples.T_tip)) > 0.05
    # No more than so many in all.
    monkeypatch.setattr("calibrate.inference.simulated_rig.MOST_STEPS", 2 * len(T) - 1)
    seen = SimulatedRig(part, robot)(values)
    assert seen is not None
    np.testing.assert_allclose(seen.values[row], by_samples.T_tip, atol=1e-8)


def test_a_sample_converges_if_all_parts_of_its_step_do():
    values = np.arange(9.0)
    run = Brief(*cast(Any, [values] * len(Brief._fields)))._replace(converged=np.arange(9) != 6)
    assert at_samples(run, 4).converged.tolist() == [True, True, False]
    assert at_samples(run, 4).T_tip.tolist() == [0.0, 4.0, 8.0]
    assert between(np.array([[0.0, 8.0], [4.0, 0.0]]), 4)[:, 1].tolist() == [8.0, 6.0, 4.0, 2.0, 0.0]


def test_the_file_of_steps_is_left_where_no_answer_was_written(tmp_path, monkeypatch, capsys):
    folder, out = LABELLED / "case-011", tmp_path / "out"
    given = ["diagnose", folder / "robot.toml", folder / "recording.csv", "-o", out]

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("gtr_jax.app.cli.diagnose.write_answer", interrupt)
    outcome = run_gtr(capsys, *given)
    assert outcome.status == 130 and "resumes from there" in outcome.err
    assert (tmp_path / ".out.steps").exists() and not out.exists()
    monkeypatch.undo()
    outcome = run_gtr(capsys, *given)
    assert outcome.status == 0 and "resuming the interrupted run" in outcome.err
    assert not (tmp_path / ".out.steps").exists() and (out / "report.html").exists()


def test_a_broken_file_of_steps_is_begun_anew(tmp_path):
    path = tmp_path / "steps"
    path.write_bytes(b"no database" * 1000)
    memory = SimulationCache(path)
    assert len(memory) == 0
    memory.put(b"a", np.arange(3.0))
    memory.close()
    again = SimulationCache(path)
    kept = again.get(b"a")
    assert kept is not None and np.array_equal(kept, np.arange(3.0)) and again.get(b"b") is None
    # Nothing is made before anything is kept.
    unused = SimulationCache(tmp_path / "no" / "steps")
    assert len(unused) == 0 and unused.get(b"a") is None and not (tmp_path / "no").exists()


def test_names_of_channels_are_checked():
    config, recording, _ = case(11)
    for wrong, says in (("nonsense", "must be one of"), (("tip_y", "tip_z"), "must be one of")):
        with pytest.raises(gtr.InputError, match=says):
            calibrate.diagnose(config, recording, channels=wrong)


def test_tensions_in_other_units_are_refused():
    config, recording, _ = case(11)
    other = dataclasses.replace(recording, T_base=1e3 * recording.T_base)
    with pytest.raises(gtr.InputError, match=r"T_base reaches .* grams-force"):
        calibrate.diagnose(config, other)
    other = dataclasses.replace(recording, T_base=4 * recording.T_base)
    found = calibrate.diagnose(config, dataclasses.replace(other, T_tip=1e2 * np.asarray(recording.T_tip)))
    assert found.verdict == "bad-data" and "units" in found.says and ".." not in found.says


def test_a_sheaths_own_compliance_stays(make_robot):
    sheath = {"rigid": True, "natural_curvature": 4.0}
    given = {"timed": True, "largest_tip": 10.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    terms = [{"kind": "tendon-stretch", "compliance": 2e-4}]
    for robot, fixed in (
        (make_robot(backbone=sheath, terms=terms), {}),
        (make_robot(backbone=sheath), {"tendon-stretch.compliance": 5e-5}),
    ):
        presliding = next(h for h in catalogue(robot, **given) if h.kind == "presliding")
        assert presliding.fixed == fixed


@pytest.mark.slow
def test_uncertain_dimensions_are_not_missing_physics():
    # A wave whose ends lie 3 % off the file's, which says 3 %: with pose, E alone cannot follow.
    config, _, _ = case(11)
    made = gtr.build_robot(config)
    values = {
        "mu": 0.25,
        "R_max": 1.03 * float(made.value("R_max")),
        "r_min": 0.97 * float(made.value("r_min")),
    }
    rng = np.random.default_rng(4)
    T = np.concatenate([np.linspace(0, 45, 15), np.linspace(45, 3, 15)[1:], np.linspace(3, 30, 10)[1:]])
    run = gtr.simulate(made.with_values(**values), T)
    pose = np.asarray(run.tip_pose) + rng.normal(size=(len(T), 3)) * (2e-4, 2e-4, 2e-3)
    recording = gtr.Recording(
        path=Path("made.csv"),
        sha256="",
        T_base=T,
        T_tip=np.asarray(run.T_tip) + 0.03 * rng.normal(size=len(T)),
        tip_x=pose[:, 0],
        tip_y=pose[:, 1],
        tip_angle=pose[:, 2],
    )
    known = config.model_copy(
        update={"uncertainty": {**config.uncertainty, "routing.R_max": 0.03, "routing.r_min": 0.03}}
    )
    found = calibrate.diagnose(known, recording)
    assert found.verdict == "adequate"
    moved = {c.name: c for c in found.parameters}
    sd = moved["R_max"].sd
    assert sd is not None and moved["R_max"].after == pytest.approx(values["R_max"], abs=3 * sd)
    assert sd < 0.03 * values["R_max"]
    surprised = calibrate.diagnose(config, recording)
    assert surprised.verdict != "adequate"


def test_known_weights_tell_cells_apart(make_robot):
    # One cell at a time, from nothing to the largest and back: what a gain of either does is seen alone.
    hung, alone = checks(40.0, 15.0).values()
    time, base, tip = hung
    assert np.all(np.diff(time) > 0) and not np.any((base > 0) & (tip > 0))
    assert base.max() == tip.max() == 40.0 and base[0] == base[-1] == tip[0] == tip[-1] == 0.0
    gains = {"base-gain": (1.1, 1.0), "tip-gain": (1.0, 1.1)}
    for kind, (of_base, of_tip) in gains.items():
        robot = make_robot(terms=[{"kind": kind, "gain": 1.1}])
        shown = cells_show(robot, *map(jnp.asarray, (base, tip, time)))
        assert np.allclose(shown.T_base, of_base * base) and np.allclose(shown.T_tip, of_tip * tip)
    # What a cell reads of nothing, and how that drifts, is seen with nothing on it.
    time, base, tip = alone
    assert not base.any() and not tip.any() and time[-1] > 60.0
    robot = make_robot(terms=[{"kind": "tip-offset", "force": "0.3 N"}])
    assert np.allclose(cells_show(robot, *map(jnp.asarray, (base, tip, time))).T_tip, 0.3)


def test_a_rig_turned_or_weighed_down_is_the_robot_file_said_so(make_robot):
    # Turned to the left, gravity that pulled to the right of the base pulls against it; so does a dead force.
    T = np.linspace(0.0, 8.0, 9)
    body = {"density": "3000 kg/m^3", "youngs_modulus": "300 kPa"}

    def pose(**loads):
        return np.asarray(gtr.simulate(make_robot(backbone=body, loads=loads), T).tip_pose)[:, :2]

    lying = make_robot(backbone=body, loads={"gravity_angle": "-90 deg", "tip_force": [0.01, -0.02]})
    stood = lying.with_values(**turned(lying, {"mu": 0.1}))
    told = pose(gravity_angle="180 deg", tip_force=[-0.02, -0.01])
    before = np.asarray(gtr.simulate(lying, T).tip_pose)[:, :2]
    assert np.abs(told - before).max() > 1e-3
    found = np.asarray(gtr.simulate(stood.with_values(mu=lying.value("mu")), T).tip_pose)[:, :2]
    np.testing.assert_allclose(found, told, atol=1e-8)
    # A load that the file does not know turns as well.
    values = turned(lying, {"tip-load.x": 0.03, "tip-load.y": 0.0})
    np.testing.assert_allclose([values["tip-load.x"], values["tip-load.y"]], [-0.03, -0.02])
    # So does one that the file has as a term, and a weight comes on top of it.
    termed = make_robot(terms=[{"kind": "tip-load", "x": 0.03, "y": -0.05}])
    values = turned(termed, {})
    np.testing.assert_allclose([values["tip-load.x"], values["tip-load.y"]], [-0.05, -0.03])
    values = weighed(termed, np.asarray([0.0, -0.01]), {})
    np.testing.assert_allclose([values["tip-load.x"], values["tip-load.y"]], [0.03, -0.06])
    assert np.hypot(*weight_to_hang(lying, 0.05)) == pytest.approx(0.01)
    weight = weight_to_hang(lying, 8.0)
    assert weight[0] == pytest.approx(0.0, abs=1e-12) and weight[1] < 0
    hung = lying.with_values(**weighed(lying, weight, {}))
    told = pose(gravity_angle="-90 deg", tip_force=[0.01, -0.02 + weight[1]])
    np.testing.assert_allclose(np.asarray(gtr.simulate(hung, T).tip_pose)[:, :2], told, atol=1e-8)
    assert 0.01 < np.abs(told - before).max() / float(lying.backbone.length) < 0.3


@pytest.mark.parametrize(
    ("rivals", "known", "best"),
    [
        ({"gravity-error": {"x": 4.0}, "tip-load": {"x": 0.05}}, 20.0, "the rig turned"),
        pytest.param(
            {"zero-drift.tip": {"tip": 2e-3}, "friction-drift": {"rate": 5e-4}},
            50.0,
            "a rest of",
            marks=pytest.mark.slow,
        ),
        ({"tip-gain": {"gain": 1.1}, "base-gain": {"gain": 1 / 1.1}}, 20.0, "hang known weights"),
    ],
)
def test_the_experiment_that_tells_rivals_apart(make_robot, rivals, known, best):
    robot = make_robot(loads={"gravity_angle": "-90 deg"})
    T = np.concatenate([np.linspace(0.0, 20.0, 21), np.linspace(20.0, 0.0, 21)[1:]])
    recording = gtr.Recording(path=Path("r.csv"), sha256="", time=np.arange(41.0), T_base=T, T_tip=0.8 * T)
    part, _ = part_of("r", robot, None, recording, ("T_tip",), noise_N=0.02, noise_base_N=0.02)
    base = base_numbers(robot, {})
    given = {"timed": True, "largest_tip": 20.0, "travel": np.array([0.0, 0.1]), "bend": 5.0}
    of = {h.name: h for h in catalogue(robot, **given)}
    start = {"mu": 0.2, "E": float(robot.value("E"))}

    def fitted(name, values):
        kind = name.partition(".")[0]
        own = start | {n.name: n.centre for n in of[name].numbers}
        own |= {f"{kind}.{key}": value for key, value in values.items()}
        numbers = (*base, *of[name].numbers)
        x = np.asarray([n.at(own[n.name]) for n in numbers])
        told = known * np.eye(len(x))
        return Fitted((name,), numbers, x, own, np.zeros(len(x)), told, 0.0, 0.0, (), 0, {})

    models = [fitted(name, values) for name, values in rivals.items()]
    found = propose(models, SimulatedRig(part, robot), [0.02], named=True)
    assert found is not None
    assert best in found.says and max(dict(found.menu).values()) > 6
    assert ("diagnosed.toml" in found.says) == ("rig turned" in found.says)
    assert (found.T_tip is not None) == found.says.startswith("Take the tendon off")
    done = [name for name, _ in found.menu if "hung from the tip" in name]
    assert len(done) == 2 and any("read the cells" in name for name, _ in found.menu)


@pytest.mark.parametrize(
    ("sets", "words"),
    [
        ([["drag"]], ["drag"]),
        ([["drag"], ["creep"]], ["drag", "creep"]),
        (
            [["drag", "creep"], ["drag", "creep", "contact"], ["patch"], ["patch", "kink", "entry"]],
            ["drag with creep (alone or beside contact)", "patch (alone or beside kink and entry)"],
        ),
        # The most probable is told first though it adds to another, and each larger one once.
        (
            [["drag", "creep"], ["creep", "kink"], ["creep"], ["creep", "drag", "kink"]],
            ["drag with creep (alone or beside kink)", "creep (alone or beside kink)"],
        ),
    ],
)
def test_sets_that_add_to_another_are_told_beside_it(sets, words):
    assert sets_in_words(sets) == words
