"""Pairs of effects that hide each other, looked at together."""

import dataclasses
from typing import Any, cast

import numpy as np
import pytest
from test_averaged import Linear, effect

from calibrate.diagnosis.screening.pairs import SURPLUS, promising
from calibrate.diagnosis.screening.screen import Screened, Try, screen
from calibrate.diagnosis.search.search import Start, raced
from calibrate.inference.number import Number


def linear(sizes, columns, seed=5):
    """A base model and effects whose changes are given, and what was tried of each at one size."""
    rng = np.random.default_rng(seed)
    mu = rng.standard_normal(len(next(iter(columns.values()))))
    named = {"mu": mu} | {f"{name}.size": column for name, column in columns.items()}
    seen = 0.3 * mu + sum(sizes[name] * column for name, column in columns.items())
    likelihood = Linear(seen + rng.standard_normal(len(mu)), named)
    base = likelihood.refit((), np.zeros(1))
    screened = []
    for name in columns:
        h = effect(name, -np.inf)
        tries = [
            Try(np.asarray([x]), True, np.concatenate([x * columns[name], np.zeros(1)])) for x in (0.5, -0.5)
        ]
        screened.append(Screened(h, 0.0, [], np.inf, tries))
    return likelihood, base, screened


def hiding(n=200, seed=1):
    """Two changes that nearly cancel, and a third of its own."""
    rng = np.random.default_rng(seed)
    common, rest, other = rng.standard_normal((3, n))
    return {"gain": common + 0.1 * rest, "stiff": -common + 0.1 * rest, "drag": other}


def test_effects_that_hide_each_other_are_found_together():
    likelihood, base, screened = linear({"gain": 3.0, "stiff": 3.0, "drag": 0.0}, hiding())
    columns = likelihood.columns
    alone = [
        base.cost - likelihood.refit((h,), np.zeros(2)).cost
        for h in (screened[0].hypothesis, screened[1].hypothesis)
    ]
    found = promising(base, screened, 3)
    assert max(alone) < 20 and {h.name for h in found[0].hypotheses} == {"gain", "stiff"}
    exact = likelihood.refit(found[0].hypotheses, np.zeros(3))
    # Sizes are tried up to twice what was simulated: that is as far as a slope is trusted.
    assert 0.2 * (base.cost - exact.cost) < found[0].gain <= base.cost - exact.cost + 1e-6
    at = dict(zip(["mu", *(h.numbers[0].name for h in found[0].hypotheses)], found[0].start, strict=True))
    rows = sum((columns[k] * v for k, v in at.items()), -likelihood.seen)
    reached = base.cost - float(rows @ rows + found[0].start @ found[0].start)
    assert reached == pytest.approx(found[0].gain, rel=1e-6)


def test_a_pair_is_refitted_from_where_it_promises_most():
    likelihood, base, screened = linear({"gain": 3.0, "stiff": 3.0, "drag": 0.0}, hiding())
    pair = promising(base, screened, 1)[0]
    fits = raced(cast(Any, likelihood), base, [(pair.hypotheses, Start(pair.start, {}))], 14)
    assert [set(f.names) for f in fits] == [{"gain", "stiff"}]
    assert fits[0].cost < base.cost - pair.gain + 1e-6


def test_nothing_is_promised_of_noise_or_of_one_effect():
    for sizes in ({"gain": 0.0, "stiff": 0.0, "drag": 0.0}, {"gain": 0.0, "stiff": 0.0, "drag": 1.0}):
        _, base, screened = linear(sizes, hiding())
        assert promising(base, screened, 5) == []


def test_two_of_a_kind_or_with_a_number_in_common_are_no_pair():
    _, base, screened = linear({"gain": 3.0, "stiff": 3.0, "drag": 0.0}, hiding())
    same = [s._replace(hypothesis=dataclasses.replace(s.hypothesis, kind="cells")) for s in screened[:2]]
    assert promising(base, same, 5) == []
    shared = Number(name="gain.size", unit="N", centre=0.0, sd=2.0, log=False, size=True)
    common = [
        s._replace(hypothesis=dataclasses.replace(s.hypothesis, numbers=(shared,))) for s in screened[:2]
    ]
    assert promising(base, common, 5) == []
    assert promising(base, [], 5) == [] and SURPLUS > 9


def test_the_screen_keeps_what_it_simulated():
    likelihood, base, screened = linear({"gain": 1.0, "stiff": 0.0, "drag": 0.0}, hiding())
    h = dataclasses.replace(screened[0].hypothesis, starts=({"gain.size": 1.0}, {"gain.size": -1.0}))
    likelihood.simulate = lambda values, names=(): [_Seen(values)]  # type: ignore[attr-defined]
    likelihood.rows = lambda seen: rows_of(likelihood, seen[0].values)  # type: ignore[attr-defined]
    found = screen(cast(Any, likelihood), base, [h], thorough=False)[0]
    assert [float(t.x[0]) for t in found.tries] == [0.5, -0.5]
    np.testing.assert_allclose(found.tries[0].moved[:-1], 0.5 * likelihood.columns["gain.size"], atol=1e-9)
    assert found.tries[0].scales and found.tries[0].moved[-1] == 0.0


@dataclasses.dataclass
class _Seen:
    values: dict[str, float]
    failed: int = 0


def rows_of(likelihood, values):
    numbers = {"mu": likelihood.base[0], "gain.size": effect("gain", -np.inf).numbers[0]}
    return sum(
        (likelihood.columns[k] * numbers[k].at(v) for k, v in values.items() if k in numbers),
        -likelihood.seen,
    )
