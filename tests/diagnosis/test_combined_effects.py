"""Several effects beside each other: which are kept, and when all of them are named."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from calibrate.diagnosis.decision import decide
from calibrate.diagnosis.likelihood.locate import between_samples
from calibrate.diagnosis.search import forward_search

# Recordings of the machine of the blind benchmark, of seeds that it does not score.
DATA = Path(__file__).parents[1] / "data/combined"


VARIANTS = (("a.tip", "b"), ("b", "a.base"), ("b", "a.near"))


def fitted(cost, *names):
    return SimpleNamespace(names=names, cost=cost, chi2=cost)


@pytest.mark.parametrize(("needed", "kept"), [(900.0, ("a", "b")), (120.0, ("a",))])
def test_an_effect_that_the_cost_needs_is_kept_though_the_parts_held_out_miss_it(monkeypatch, needed, kept):
    """Without b the parts held out are predicted as well; the cost rises by 800 variances, or by 20."""
    head, start, without_b = fitted(100.0, "a", "b"), fitted(5000.0), fitted(needed, "a")
    fits = {("a",): without_b, ("b",): fitted(9000.0, "b")}
    models = SimpleNamespace(
        likelihood=SimpleNamespace(scale_left=lambda f: 1.0, refit=lambda own, start, exact: fits[own]),
        hypotheses=lambda names: names,
        coordinates=lambda names, f: np.zeros(0),
        add=lambda fits: None,
        stored=lambda f: f,
    )
    unseen = SimpleNamespace(totals=lambda fits: (np.ones((len(fits), 2)), np.full(len(fits), 2.0)))
    monkeypatch.setattr(forward_search, "in_lanes", lambda f, items: [f(i) for i in items])
    args = cast(tuple[Any, Any, Any, Any], (models, unseen, head, start))
    assert forward_search._without_idle(*args).names == kept


@pytest.mark.parametrize(
    ("alone", "between", "verdict", "chosen"),
    [
        # 39 % of what the first effect explains is left by it: no error of a law is as large.
        (fitted(550.0, "a"), 0.0, "missing-physics", ("a", "b")),
        # 20 % is left, which an inexact law could: the evidence with that allowance decides as before.
        (fitted(310.0, "a"), 0.0, "as-before", ()),
        # The model found later has not the effect that was found first: the same.
        (fitted(550.0, "c"), 0.0, "as-before", ()),
        # It has another variant of it.
        (fitted(550.0, "a.tip"), 0.0, "missing-physics", ("a", "b")),
        # 20 % is left by a gain, which is exact by definition.
        (fitted(310.0, "gain"), 0.0, "missing-physics", ("a", "b", "gain")),
        # And by a delay, whose tension between the samples is not known so well.
        (fitted(310.0, "delay"), 150.0, "as-before", ()),
    ],
)
def test_all_effects_are_named_where_an_error_of_one_law_cannot_be_what_is_left(
    monkeypatch, alone, between, verdict, chosen
):
    exact = {"gain": "base-gain", "delay": "time-skew"}
    base, whole = fitted(3000.0), fitted(200.0, "a", "b", *(set(alone.names) & set(exact)))
    kinds = {"a": "a", "a.tip": "a", "b": "b", "c": "c"} | exact
    models = SimpleNamespace(
        base=base,
        probabilities_given_discrepancy=lambda f: {("a", "b"): 1.0},
        stored=lambda f: f,
        fits={alone.names: alone} if alone.names[0] in exact else {},
        likelihood=SimpleNamespace(scale_left=lambda f: 1.0),
        of={name: SimpleNamespace(kind=kind) for name, kind in kinds.items()},
    )
    before = SimpleNamespace(verdict="as-before", chosen=base)
    monkeypatch.setattr(decide, "decide", lambda m: before)
    monkeypatch.setattr(decide, "between_samples", lambda likelihood, f: between)
    monkeypatch.setattr(decide, "misfit", lambda likelihood, f: (0.1, 0.3))
    monkeypatch.setattr(decide, "_told_apart", lambda *some: ([("a", "b")], True))
    nearest = decide.Decision(
        verdict="missing-physics",
        chosen=cast(Any, alone),
        confusion=[alone.names],
        probability={alone.names: 1.0},
        left=(1.2, 24.0),
        base_left=(3.3, 270.0),
    )
    found = decide.decide_combined(cast(Any, models), cast(Any, whole), nearest)
    assert (found.verdict, found.chosen.names) == (verdict, chosen)
    if chosen:
        assert found.confusion == [("a", "b")] and found.left == (0.1, 0.3)


@pytest.mark.parametrize("time", [[0, 1, 2, 3, 4, 5], [0, 1, 2, 2, 3, 4]])
@pytest.mark.parametrize("names", [(), ("left", "right")])
def test_a_delay_may_leave_what_the_tension_turns_between_two_samples(time, names):
    """A kink of 2 N/s at 2 s, read half a second late: half a newton, in the intervals on either side."""
    T = 2.0 * np.maximum(np.asarray(time, float) - 2.0, 0.0)
    channels = ("T_tip", "tip_x") if not names else ("T_tip.left", "T_tip.right")
    part = SimpleNamespace(
        time=np.asarray(time, float),
        tips=1 if not names else 2,
        channels=channels,
        drives=[None] * max(len(names), 1),
        robot=SimpleNamespace(tendon_names=names),
    )
    rig = SimpleNamespace(part=part, where=(slice(None), slice(None)))
    likelihood = SimpleNamespace(
        rigs=[rig], white=lambda rows: np.concatenate(rows).ravel(), robustify=lambda z: z
    )
    delay = {"time-skew.delay": 0.5} if not names else {"time-skew.delay.right": 0.5}
    fitted = SimpleNamespace(values=delay, seen=[SimpleNamespace(values=np.stack([T, T]))])
    late = np.asarray(time, float) - 0.5
    beside = np.count_nonzero((late > 1) & (late < 3))
    assert between_samples(cast(Any, likelihood), cast(Any, fitted)) == pytest.approx(beside * 0.5**2)
    fitted.values = {}
    assert between_samples(cast(Any, likelihood), cast(Any, fitted)) == 0.0


def test_a_model_is_judged_again_once_a_much_better_fit_of_it_is_found(monkeypatch):
    judged: list[float] = []

    def by_fold(likelihood, models, pieces):
        judged.extend(f.cost for _, f in models)
        return np.asarray([[[f.cost, 1, f.cost, 1]] * 4 for _, f in models])

    monkeypatch.setattr(forward_search, "by_fold", by_fold)
    likelihood = SimpleNamespace(heavy=None, scale_left=lambda f: 1.0)
    unseen = forward_search.Unseen(
        cast(Any, SimpleNamespace(likelihood=likelihood, hypotheses=lambda names: names))
    )
    head = cast(Any, fitted(1000.0))
    for cost, pays in ((990.0, False), (985.0, False), (600.0, True), (598.0, True)):
        assert (unseen.best(head, [cast(Any, fitted(cost, "a"))]) is not None) is pays
    assert judged == [1000.0, 990.0, 600.0]


@pytest.mark.parametrize(
    ("costs", "sizes", "pays", "head", "replaced"),
    [
        # As many numbers: the better fit is taken, and is known to stand in place of the other.
        ((100.0, 60.0), (2, 2), False, ("b", "a.base"), {"a.base": "a.tip"}),
        # One more number: only if it pays on unseen samples.
        ((100.0, 60.0), (2, 3), False, ("a.tip", "b"), {}),
        ((100.0, 60.0), (2, 3), True, ("b", "a.base"), {"a.base": "a.tip"}),
        # About as good: the one that is there stays.
        ((100.0, 95.0), (2, 2), True, ("a.tip", "b"), {}),
        # The best has more numbers and does not pay: the next best that needs none.
        ((100.0, 59.0, 60.0), (2, 3, 2), False, ("b", "a.near"), {"a.near": "a.tip"}),
    ],
)
def test_a_better_variant_stands_in_place_of_an_effect(monkeypatch, costs, sizes, pays, head, replaced):
    was, *others = (fitted(c, *n) for c, n in zip(costs, VARIANTS, strict=False))
    for f, size in zip((was, *others), sizes, strict=True):
        f.x = np.zeros(size)
    models = SimpleNamespace(likelihood=SimpleNamespace(scale_left=lambda f: 1.0), stored=lambda f: f)
    monkeypatch.setattr(forward_search, "settled", lambda models, fits: fits)
    monkeypatch.setattr(forward_search, "add_variants", lambda m, f, name: others if name == "a.tip" else [])
    unseen = SimpleNamespace(best=lambda f, fits: fits[0] if pays else None)
    found, instead = forward_search._best_variants(cast(Any, models), cast(Any, unseen), cast(Any, was))
    assert (found.names, instead) == (head, replaced)


@pytest.mark.slow
def test_a_gain_is_found_beside_a_delay():
    """Friction makes up for most of a gain of the tip's cell, along a valley too curved for one step: beside
    the delay a crosstalk and a low-pass promised more, and left fifty times as much.
    """
    found, sets = diagnosed("delay-and-gain")
    assert ["time-skew", "tip-gain"] in sets and all("time-skew" in names for names in sets), found.says
    best = next(r for r in found.rivals if sorted(r.names) == ["time-skew", "tip-gain"])
    assert best.values["tip-gain.gain"] == pytest.approx(1.1166, abs=0.01)  # as it was made
    assert best.values["time-skew.delay"] == pytest.approx(3.260, abs=0.05)
    assert best.chi2_per_n < 1.5


@pytest.mark.slow
def test_a_curve_of_friction_is_found_beside_a_delay_and_crosstalk():
    """Of its starts, only those far from the usual speed promise anything: a law of no catalogue, friction of
    the slip speed with a knee, was told in its place.
    """
    found, sets = diagnosed("delay-crosstalk-stribeck")
    assert ["crosstalk", "stribeck-friction", "time-skew"] in sets, found.says
    assert found.verdict != "discovered"


@pytest.mark.slow
def test_friction_of_a_stretch_is_found_beside_a_delay():
    """Beside the delay, friction at the base was refitted and left half as much again; what was left was told
    as a law of no catalogue, friction between two places.
    """
    found, sets = diagnosed("delay-and-patch")
    assert ["local-friction", "time-skew"] in sets, found.says
    assert found.verdict != "discovered" and "local-friction.end" in {c.name for c in found.parameters}


def diagnosed(name: str) -> tuple[calibrate.Diagnosis, list[list[str]]]:
    """The diagnosis of a recording of `DATA`, and the sets of effects that it names."""
    robot = gtr.load_config(DATA / name / "robot.toml")
    found = calibrate.diagnose(robot, gtr.read_recording(DATA / name / "recording.csv"), experiment=False)
    return found, [sorted(names) for names in found.confusion_set] or [sorted(found.named)]
