"""Numbers averaged over models, against sums over a grid in problems that are linear."""

import dataclasses
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from calibrate.diagnosis.evidence import averaged as subject
from calibrate.diagnosis.evidence.averaged import averaged
from calibrate.diagnosis.evidence.marginal import Marginal
from calibrate.diagnosis.evidence.models import BELIEVED, HOW_MANY, Models
from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis
from calibrate.diagnosis.hypotheses.model import Fitted, Point, model_of
from calibrate.inference.number import Number

MU = Number(name="mu", unit="", centre=0.2, sd=0.5, log=False)
N_OF_OTHERS = 4


def effect(name, lower=0.0, *, size=True):
    number = Number(name=f"{name}.size", unit="N", centre=0.0, sd=2.0, log=False, lower=lower, size=size)
    return Hypothesis(name=name, kind=name, numbers=(number,), starts=({number.name: 1.0},))


@dataclasses.dataclass
class Linear:
    """A likelihood whose rows are linear in all coordinates: columns by name of the number."""

    seen: np.ndarray
    columns: dict[str, np.ndarray]
    base: tuple[Number, ...] = (MU,)
    follow: Any = None
    heavy: float | None = None
    dimensions: tuple[Number, ...] = ()
    effects: tuple[Hypothesis, ...] = ()

    def at(self, model, x):
        seen = self.simulate(model.values(x))
        return None if seen is None else Point(model.values(x), cast(Any, ()), self.rows(seen))

    def simulate(self, values, names=()):
        return [SimpleNamespace(values=values, failed=0)]

    def rows(self, seen):
        known = {n.name: n for n in (MU, *(n for h in self.effects for n in h.numbers))}
        return sum((self.columns[k] * known[k].at(v) for k, v in seen[0].values.items()), -self.seen)

    def refit(self, hypotheses, start, **_):
        model = model_of(self.base, hypotheses)
        J = np.stack([self.columns[n.name] for n in model.numbers], axis=1)
        low, high = model.bounds
        x = np.clip(np.linalg.solve(J.T @ J + np.eye(len(J.T)), J.T @ self.seen), low, high)
        rows = J @ x - self.seen
        return Fitted(
            names=model.names,
            numbers=model.numbers,
            x=x,
            values=model.values(x),
            rows=rows,
            jacobian=J,
            chi2=float(rows @ rows),
            prior=float(x @ x),
            seen=(),
            failed=0,
            dimensions={},
        )


def problem(hidden, others=N_OF_OTHERS, true=(0.4, 1.0), seed=3, lower=0.0):
    """Rows that depend on mu and on an effect whose column is nearly along that of mu."""
    rng = np.random.default_rng(seed)
    J, off = rng.standard_normal(60), rng.standard_normal(60)
    columns = {"mu": 3 * J, "drag.size": 3 * (hidden * J + np.sqrt(1 - hidden**2) * off) / 4}
    columns |= {f"other-{k}.size": np.zeros(60) for k in range(others)}
    seen = true[0] * columns["mu"] + true[1] * columns["drag.size"] + rng.standard_normal(60)
    of = [effect("drag", lower), *(effect(f"other-{k}") for k in range(others))]
    likelihood = Linear(seen, columns, effects=tuple(of))
    models = Models(cast(Any, likelihood), of)
    models.likelihood.mean_square = lambda f: 1.0  # type: ignore[method-assign]
    models.likelihood.readings = 60  # type: ignore[misc]
    models.add([cast(Fitted, likelihood.refit((), np.zeros(1)))])
    fitted = models.base
    marginal = Marginal(cast(Any, likelihood), fitted, np.linalg.inv(fitted.information()), ({},))
    return likelihood, models, marginal


def on_a_grid(likelihood, lower):
    """Ends of the 95 % interval of mu, and odds of the effect, from sums over a grid."""
    a = np.linspace(max(lower / 2.0, -6.0), 6.0, 3001)
    J, column = likelihood.columns["mu"], likelihood.columns["drag.size"]
    precision = J @ J + 1
    mean = (J @ (likelihood.seen[:, None] - column[:, None] * a)) / precision
    left = column[:, None] * a + J[:, None] * mean - likelihood.seen[:, None]
    log = -0.5 * (np.sum(left**2, axis=0) + mean**2)
    plain = J @ likelihood.seen / precision
    none = -0.5 * (np.sum((J * plain - likelihood.seen) ** 2) + plain**2)
    prior = norm.pdf(a) / (1 - norm.cdf(lower / 2.0))
    evidence = np.trapezoid(np.exp(log - none) * prior, a)
    weight = np.exp(log - none) * prior
    one = HOW_MANY[1] / HOW_MANY[0]
    odds = min(one / (1 + N_OF_OTHERS) * evidence**BELIEVED, subject.MOST_ODDS)
    grid = np.linspace(-3, 3, 6001)
    with_it = np.sum(
        weight[:, None] * norm.cdf((grid[None] - mean[:, None]) * np.sqrt(precision)), axis=0
    ) / np.sum(weight)
    alone = norm.cdf((grid - plain) * np.sqrt(precision))
    # The other effects change nothing: their odds are those of the prior. Each effect may have the odds of
    # all.
    free = 1 + one * N_OF_OTHERS / (1 + N_OF_OTHERS)
    likely = min(one * evidence**BELIEVED, subject.MOST_ODDS)
    mixtures = [(free, odds), (free, likely), (free + one * N_OF_OTHERS / (1 + N_OF_OTHERS), odds)]
    ends = [
        np.interp([0.025, 0.975], (without * alone + with_ * with_it) / (without + with_), grid)
        for without, with_ in mixtures
    ]
    low, high = np.transpose(ends)
    return MU.centre + MU.sd * np.asarray([low.min(), high.max()]), odds


@pytest.mark.parametrize(("hidden", "lower"), [(0.999, 0.0), (0.999, -np.inf), (0.5, 0.0), (0.95, -1.0)])
def test_the_average_is_that_of_a_grid(hidden, lower):
    likelihood, models, marginal = problem(hidden, lower=lower)
    found = averaged(models, models.base, {(): 1.0}, {(): marginal})
    ends, odds = on_a_grid(likelihood, lower)
    narrow = marginal.interval(0)
    np.testing.assert_allclose(found.ends["mu"], ends, atol=0.06 * (ends[1] - ends[0]))
    drag = next(h for h in found.hidden if h.name == "drag")
    total = 1 + odds + HOW_MANY[1] / HOW_MANY[0] * N_OF_OTHERS / (1 + N_OF_OTHERS)
    assert drag.probability == pytest.approx(odds / total, rel=0.02)
    assert found.ends["mu"][0] <= narrow[0] + 1e-3 and found.hidden[0] is drag


def test_a_hidden_effect_widens_the_interval_until_it_holds_the_truth():
    # The effect takes nearly the same way as mu: mu alone moves to make up for it.
    _, models, marginal = problem(0.9999, true=(0.4, 0.6))
    truth = MU.value(0.4)
    low, high = marginal.interval(0)
    assert not low < truth < high
    found = averaged(models, models.base, {(): 1.0}, {(): marginal})
    assert found.ends["mu"][0] < truth < found.ends["mu"][1]


def test_the_interval_holds_whichever_effect_acts():
    """Two effects with a few per cent each move the number to either side: the average of all hardly shows
    them, those in which one of them has the share of all effects do.
    """
    rng = np.random.default_rng(1)
    draws = rng.standard_normal((3, 200_000)) + np.asarray([[0.0], [-9.0], [9.0]])
    weights = dict(zip(("", "down", "up"), (1.0, 0.02, 0.01), strict=True))
    parts = [(d, w, name) for d, (name, w) in zip(draws, weights.items(), strict=True)]
    low, high = subject._whichever_acts(parts, 1.0, 9.0)
    plain = norm.ppf(0.025 * 1.03 - 0.02), -norm.ppf(0.025 * 1.03 - 0.01)
    assert (low, high) == pytest.approx(plain, abs=0.03)
    low, high = subject._whichever_acts(parts, 20.0, 9.0)
    # 0.4 of 1.41 below and 0.2 of 1.22 above.
    assert low == pytest.approx(-9 + norm.ppf(0.025 * 1.41 / 0.4), abs=0.02)
    assert high == pytest.approx(9 + norm.ppf(1 - 0.025 * 1.22 / 0.2), abs=0.02)
    # No effect gets more than the largest odds: it would have been claimed.
    less = subject._whichever_acts(parts, 20.0, 0.1)
    assert low < less[0] and less[1] < high
    assert subject._whichever_acts(parts[:1], 20.0, 9.0) == pytest.approx((-1.96, 1.96), abs=0.02)


def test_effects_that_change_nothing_leave_the_interval():
    likelihood, models, marginal = problem(0.5, true=(0.4, 0.0))
    likelihood.columns["drag.size"] = np.zeros(60)
    found = averaged(models, models.base, {(): 1.0}, {(): marginal})
    np.testing.assert_allclose(found.ends["mu"], marginal.interval(0), rtol=0.02)
    assert {h.name for h in found.hidden} == set(models.of)
    # A size that may be anything: 95 % of half a normal distribution.
    assert found.hidden[0].largest == pytest.approx(2.0 * norm.ppf(0.975), rel=0.03)


def test_beside_an_effect_the_odds_are_those_of_sets_of_two():
    likelihood, models, _ = problem(0.5, true=(0.4, 0.5))
    own = models.hypotheses(["drag"])
    models.add([cast(Fitted, likelihood.refit(own, np.zeros(2)))])
    fitted = models.fits[("drag",)]
    marginal = Marginal(cast(Any, likelihood), fitted, np.linalg.inv(fitted.information()), ({}, {}))
    found = averaged(models, fitted, {("drag",): 1.0}, {("drag",): marginal})
    # The other effects change nothing, so that their odds are those of the prior (`Models.log_prior`).
    n, one = len(models.of), dataclasses.replace(fitted, names=("drag", "other-0"))
    odds = np.exp(models.log_prior(one) - models.log_prior(fitted))
    assert odds == pytest.approx(HOW_MANY[2] / HOW_MANY[1] * 2 / (n - 1))
    total = 1 + odds * N_OF_OTHERS
    assert [h.probability for h in found.hidden] == pytest.approx([odds / total] * N_OF_OTHERS)


def test_rivals_count_with_their_probability():
    _, models, marginal = problem(0.5, true=(0.4, 0.0))
    fitted = dataclasses.replace(marginal.fitted, names=("rival",), x=marginal.fitted.x + 1.0)
    rival = dataclasses.replace(marginal, fitted=fitted)
    both: dict[tuple[str, ...], Marginal] = {(): marginal, ("rival",): rival}
    found = averaged(models, models.base, {(): 0.7, ("rival",): 0.3}, both)
    assert found.ends["mu"][1] > rival.interval(0)[0]
    without = averaged(models, models.base, {(): 0.7, ("rival",): 1e-5}, both)
    assert without.ends["mu"][1] < rival.interval(0)[0]


@pytest.mark.parametrize(("mean", "low", "high"), [(0.0, 0.0, np.inf), (-6.0, 0.0, np.inf), (9.0, -1.0, 1.0)])
def test_draws_within_bounds(mean, low, high):
    rng = np.random.default_rng(0)
    found = subject._truncated(np.full(20000, mean), 1.0, low, high, rng)
    exact = truncnorm(low - mean, high - mean, loc=mean)
    assert np.all((found >= low) & (found <= high))
    assert np.mean(found) == pytest.approx(exact.mean(), abs=4 * exact.std() / np.sqrt(20000))
    assert np.std(found) == pytest.approx(exact.std(), rel=0.05)
    share = subject._log_share(np.asarray([mean]), np.ones(1), np.asarray([low]), np.asarray([high]))
    assert share == pytest.approx(np.log(norm.cdf(high - mean) - norm.cdf(low - mean)), rel=1e-3)


def test_effects_without_a_size_have_no_null_to_be_hidden_at():
    assert subject._shapes(effect("saturation", size=False)) == []
    many = dataclasses.replace(
        effect("patch"),
        numbers=(*effect("patch").numbers, dataclasses.replace(MU, name="patch.start")),
        starts=tuple({"patch.size": s, "patch.start": v} for v in np.linspace(0, 1, 9) for s in (1.0, 2.0)),
    )
    shapes = subject._shapes(many)
    assert [s.fixed["patch.start"] for s in shapes] == [0.0, 0.375, 0.625, 1.0]
    assert all(len(s.numbers) == 1 for s in shapes)


def test_a_breakdown_leaves_the_effect_out():
    likelihood, models, marginal = problem(0.5)
    plain = likelihood.simulate

    def fails(values, names=()):
        return None if "drag.size" in values else plain(values, names)

    likelihood.simulate = fails  # type: ignore[method-assign]
    found = averaged(models, models.base, {(): 1.0}, {(): marginal})
    assert "drag" not in {h.name for h in found.hidden}


def test_an_effect_that_was_refitted_is_no_likelier_than_the_refit_says():
    _, models, marginal = problem(0.5, true=(0.4, 3.0))
    # The slope of this effect promises much; the search refitted it and found next to nothing.
    promised = averaged(models, models.base, {(): 1.0}, {(): marginal})
    refitted = averaged(models, models.base, {(): 0.95, ("drag",): 0.05}, {(): marginal})
    before, after = (
        next(h.probability for h in found.hidden if h.name == "drag") for found in (promised, refitted)
    )
    others = 1 + HOW_MANY[1] / HOW_MANY[0] * N_OF_OTHERS / (1 + N_OF_OTHERS)
    assert before > 0.5
    assert after == pytest.approx(0.05 / 0.95 / (0.05 / 0.95 + others), rel=1e-6)
    # So mu may be as without the effect, too.
    assert refitted.ends["mu"][1] > promised.ends["mu"][1]
