"""Intervals that know what could be missing: numbers averaged over models.

An interval under one model says nothing about effects that the recordings cannot show. Such an effect may be
as large as its prior allows, and mu and E then differ from those of the model by what hides it. So the
distribution of each number is averaged (Hoeting et al. 1999): over the model that is shown, its rivals and
the base model, each with its probability, and over each other effect beside the model that is shown, with
the sizes that data and prior allow.

Which effect is the likeliest on a rig before anything is seen, nobody knows: where some thirty share the
probability that one more acts, one that hides well counts for a few per cent, and the average hardly differs
from the model that is shown. So the interval holds whichever effect it is: it reaches from the least to the
largest end of the averages in which each effect in turn is as likely beforehand as all of them together (a
robust posterior: Berger, TEST 3, 1994).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from calibrate.diagnosis.hypotheses.hypotheses import EVENTS, Hypothesis, is_friction, may_join
from calibrate.diagnosis.hypotheses.model import Fitted, Model, model_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.inference.estimate import NORMAL_95
from calibrate.inference.number import Number
from calibrate.inference.parallel import in_parallel

from .marginal import Marginal
from .models import BELIEVED, HOW_MANY, Models

# Draws of each model; probabilities of the ends of the interval.
DRAWS, ENDS = 4000, (0.025, 0.975)
# Size tried of each effect, in standard deviations of its prior; most shapes of an effect that are tried.
TRIED, SHAPES = 0.3, 4
# An effect is refitted if its probability exceeds the first, beside that of the model, and it can move a
# number by more than the second, in standard errors: a slope at a small size promises too much or too little
# of a large one. Iterations of that refit, and how far it starts from null.
COUNTS, MOVES, MOST, FAR = 1e-3, 0.25, 5, 1.5
# Largest odds of an effect beside the model that is shown: with more it would have been claimed
# (`decide.CLAIMED`).
MOST_ODDS = 32.0
# Models less probable than this are left out of the average, and so is what an effect of no more than this
# share does where it is the likeliest.
LEAST = 1e-3


class Hidden(NamedTuple):
    """An effect that the recordings do not show and do not exclude.

    Attributes:
        name: of the hypothesis.
        number, unit: its size.
        probability: that it acts, beside the model that is shown.
        largest: size that it does not exceed with a probability of 95 %, by amount; SI.
        null: value of the size at which there is no effect.
        mu95: ends of the 95 % interval of mu if it acts, of the first tendon where there are several; None
            where mu is not fitted.
    """

    name: str
    number: str
    unit: str
    probability: float
    largest: float
    null: float
    mu95: tuple[float, float] | None


class Averaged(NamedTuple):
    """Numbers averaged over models.

    Attributes:
        ends: of the 95 % interval of each number, SI, by name, whichever one more effect may act.
        hidden: effects that may act unseen, those that add most to the spread of mu first.
    """

    ends: dict[str, tuple[float, float]]
    hidden: list[Hidden]


@dataclasses.dataclass(frozen=True, eq=False)
class _Component:
    """One model of the average: its numbers, draws of their coordinates (DRAWS, p), and its weight."""

    numbers: tuple[Number, ...]
    draws: np.ndarray
    weight: float

    def values(self, name: str) -> np.ndarray:
        """Draws of a number, SI, (DRAWS,); none where the model does not have it."""
        for n, x in zip(self.numbers, self.draws.T, strict=True):
            if n.name == name:
                return n.values(x)
        return np.zeros(0)


@dataclasses.dataclass(frozen=True, eq=False)
class _Beside:
    """An effect beside the model that is shown, as a Gaussian within bounds.

    Attributes:
        hypothesis: the effect, with its shape fixed and its sizes free, q of them.
        odds: of it against the model alone.
        at: sizes where the density is largest if there are no bounds, coordinates, (q,).
        spread: their covariance, (q, q).
        moved, slope: by how much the model's numbers, and the dimensions that follow, differ from those of
            the model alone at `at`, (p,), and by each size, (p, q).
    """

    hypothesis: Hypothesis
    odds: float
    at: np.ndarray
    spread: np.ndarray
    moved: np.ndarray
    slope: np.ndarray

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the coordinates of the sizes, (q,) each."""
        return Model((), self.hypothesis.numbers, {}).bounds

    def sizes(self, rng: np.random.Generator) -> np.ndarray:
        """Draws of the sizes within their bounds, (DRAWS, q): one after another, given those before."""
        low, high = self.bounds
        found = np.zeros((DRAWS, len(self.at)))
        for i in range(len(self.at)):
            gain = np.linalg.solve(self.spread[:i, :i], self.spread[:i, i])
            mean = self.at[i] + (found[:, :i] - self.at[:i]) @ gain
            sd = np.sqrt(max(self.spread[i, i] - self.spread[i, :i] @ gain, 1e-300))
            found[:, i] = _truncated(mean, sd, low[i], high[i], rng)
        return found


def averaged(
    models: Models,
    chosen: Fitted,
    probability: Mapping[tuple[str, ...], float],
    marginals: Mapping[tuple[str, ...], Marginal],
    *,
    leaves: bool = False,
) -> Averaged:
    """The numbers of a diagnosis averaged over models.

    Args:
        models: all that were refitted to all samples.
        chosen: the one that is shown.
        probability: of each model.
        marginals: the model that is shown, its rivals and the base model with all that is uncertain fitted
            jointly, by names of the effects.
        leaves: whether the model that is shown leaves structure beyond the noise, which then counts as an
            error of unknown cause: an effect that removes little of it must not gain odds.
    """
    rng = np.random.default_rng(0)
    shown = marginals[chosen.names]
    known = {tuple(sorted(names)) for names in marginals}
    components = []
    for names, marginal in marginals.items():
        p = probability.get(names, 0.0)
        if p > LEAST or names == chosen.names:
            drawn = marginal.draws(DRAWS, rng)
            components.append(_Component(marginal.fitted.numbers, drawn, max(p, LEAST)))
    own = max(probability.get(chosen.names, 0.0), LEAST)
    likelihood = models.likelihood
    scale = likelihood.scale_left(chosen) if leaves or likelihood.heavy is not None else models.scale
    others = [h for h in models.of.values() if tuple(sorted((*chosen.names, h.name))) not in known]
    besides = _no_likelier_than_refitted(_beside(models, chosen, shown, others, scale), chosen, probability)
    hidden = [(b, _hidden(shown, b, own * b.odds, rng)) for b in besides]
    parts = [(c, "") for c in components] + [(c, b.hypothesis.name) for b, c in hidden]
    times = len(models.of) - len(chosen.names)  # all other effects are equally likely before anything is seen
    ends = {
        n.name: _whichever_acts(
            [(c.values(n.name), c.weight, effect) for c, effect in parts], times, own * MOST_ODDS
        )
        for n in shown.fitted.numbers
    }
    return Averaged(ends, _told(hidden, shown, sum(c.weight for c, _ in parts)))


def _no_likelier_than_refitted(
    effects: Sequence[_Beside], chosen: Fitted, probability: Mapping[tuple[str, ...], float]
) -> list[_Beside]:
    """The effects, no likelier in all their shapes than the search found them where it refitted them beside
    the model with their shapes free: the slope of one shape can promise what no refit finds.
    """
    refitted = {tuple(sorted(names)): p for names, p in probability.items()}
    own = max(probability.get(chosen.names, 0.0), LEAST)
    total: dict[str, float] = {}
    for b in effects:
        total[b.hypothesis.name] = total.get(b.hypothesis.name, 0.0) + b.odds

    def most(name: str) -> float:
        return refitted.get(tuple(sorted((*chosen.names, name))), np.inf) / own

    return [
        dataclasses.replace(b, odds=b.odds * min(1.0, most(b.hypothesis.name) / total[b.hypothesis.name]))
        if total[b.hypothesis.name] > 0
        else b
        for b in effects
    ]


def _truncated(mean: np.ndarray, sd: float, low: float, high: float, rng: np.random.Generator) -> np.ndarray:
    """Draws of normal variables within bounds, the shape of `mean`: by the inverse of the distribution, from
    the side where it keeps its digits.
    """
    a, b = (low - mean) / sd, (high - mean) / sd
    flip = a > 0
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    share = rng.uniform(size=mean.shape)
    z = ndtri(np.clip(ndtr(a) + share * (ndtr(b) - ndtr(a)), 1e-300, 1.0))
    z = np.clip(z, a, b)
    return mean + sd * np.where(flip, -z, z)


def _hidden(shown: Marginal, b: _Beside, weight: float, rng: np.random.Generator) -> _Component:
    """The model that is shown with another effect beside it."""
    sizes = b.sizes(rng)
    moved = b.moved + (sizes - b.at) @ b.slope.T
    numbers = (*shown.fitted.numbers, *b.hypothesis.numbers)
    return _Component(numbers, np.concatenate([shown.draws(DRAWS, rng) + moved, sizes], axis=1), weight)


def _beside(
    models: Models, chosen: Fitted, shown: Marginal, others: Sequence[Hypothesis], scale: float
) -> list[_Beside]:
    """Each of some other effects beside the model, with its shapes one by one."""
    k, n = len(chosen.names), len(models.of)
    if k + 1 >= len(HOW_MANY) or n <= k:
        return []
    # Of the sets of k + 1 effects, k + 1 share the others with each set of k (`Models.log_prior`).
    prior = HOW_MANY[k + 1] / HOW_MANY[k] * (k + 1) / (n - k)
    taken = {m.name for m in chosen.numbers}
    acting = models.hypotheses(chosen.names)
    items: list[tuple[Hypothesis, float]] = []
    for h in others:
        if h.kind in EVENTS or not may_join(h, acting, taken):
            continue
        shaped = _shapes(h)
        items += [(own, prior / len(shaped)) for own in shaped]

    def one(item: tuple[Hypothesis, float]) -> _Beside | None:
        return _tried(models, chosen, shown, *item, scale)

    return [b for b in in_parallel(one, items) if b is not None]


def _shapes(h: Hypothesis) -> list[Hypothesis]:
    """A hypothesis with its sizes free and each of a few of its shapes fixed; none where it has no size, and
    so no value at which it does nothing.
    """
    sizes = tuple(n for n in h.numbers if n.size)
    rest = [n for n in h.numbers if not n.size]
    if not sizes:
        return []
    shapes = list(dict.fromkeys(tuple(s[n.name] for n in rest) for s in h.starts))
    if len(shapes) > SHAPES:
        shapes = [shapes[i] for i in np.linspace(0, len(shapes) - 1, SHAPES).round().astype(int)]
    return [
        dataclasses.replace(
            h, numbers=sizes, fixed={**h.fixed, **dict(zip((n.name for n in rest), shape, strict=True))}
        )
        for shape in shapes
    ]


def _tried(
    models: Models, chosen: Fitted, shown: Marginal, h: Hypothesis, prior: float, scale: float
) -> _Beside | None:
    """An effect beside the model: by its slope at a small size, and refitted if it may matter; None where the
    simulation breaks down.
    """
    likelihood, p = models.likelihood, len(chosen.x)
    model = model_of(likelihood.base, (*models.hypotheses(chosen.names), h))
    low, high = (side[p:] for side in model.bounds)
    columns = []
    for i in range(len(h.numbers)):
        step = TRIED if high[i] >= TRIED else -TRIED
        x = np.concatenate([chosen.x, np.zeros(len(h.numbers))])
        x[p + i] = step
        # With the mesh's correction of the model itself: the difference of two corrections is not an effect.
        seen = likelihood.simulate(model.values(x), chosen.names)
        if seen is None or sum(s.failed for s in seen) > chosen.failed:
            return None
        columns.append((likelihood.rows(seen) - chosen.rows) / step)
    jacobian = np.concatenate([chosen.jacobian, np.stack(columns, axis=1)], axis=1)
    start = np.concatenate([chosen.x, np.zeros(len(h.numbers))])
    found = _gaussian(likelihood, chosen, h, prior, scale, (start, chosen.rows, jacobian), None)
    sd = np.sqrt(np.diag(shown.covariance))
    reach = np.abs(found.moved) + NORMAL_95 * np.sqrt(
        np.einsum("iq,qr,ir->i", found.slope, found.spread, found.slope)
    )
    if found.odds < COUNTS or np.all(reach < MOVES * sd):
        return found
    size = np.clip(found.at, np.maximum(low, -FAR), np.minimum(high, FAR))
    follow = chosen.x - np.linalg.solve(
        chosen.information(scale), chosen.jacobian.T @ (jacobian[:, p:] @ size) / scale
    )
    refit = likelihood.refit(
        (*models.hypotheses(chosen.names), h),
        np.concatenate([np.clip(follow, chosen.x - FAR, chosen.x + FAR), size]),
        known=dict(enumerate(jacobian.T)),
        most=MOST,
    )
    if refit is None or refit.cost > chosen.cost:
        # The slope promised what is not there: no gain counts.
        return _gaussian(likelihood, chosen, h, prior, scale, (start, chosen.rows, jacobian), chosen.cost)
    return _gaussian(likelihood, chosen, h, prior, scale, (refit.x, refit.rows, refit.jacobian), refit.cost)


def _gaussian(
    likelihood: Likelihood,
    chosen: Fitted,
    h: Hypothesis,
    prior: float,
    scale: float,
    point: tuple[np.ndarray, np.ndarray, np.ndarray],
    cost: float | None,
) -> _Beside:
    """The effect from a linear model at a point.

    The odds of the effect are those of its prior times the ratio of evidences, the integral of prior times
    likelihood over the sizes that are allowed, over the likelihood at null: with the sizes' unbounded
    optimum a and covariance S, it is |S|^(1/2) exp(a' S^-1 a / 2) P / Z, where P and Z are the shares of the
    posterior and of the prior within the bounds, taken size by size.

    Args:
        likelihood, chosen: the recordings, and the model.
        h: the effect.
        prior: odds of the effect before anything is seen.
        scale: variance of the white residuals.
        point: coordinates, rows and Jacobian there.
        cost: of that point if it was refitted.
    """
    x, rows, jacobian = point
    p = len(chosen.x)
    information = jacobian.T @ jacobian / scale + np.eye(len(x))
    cov = np.linalg.inv(information)
    step = -cov @ (jacobian.T @ rows / scale + x)
    at, spread = x[p:] + step[p:], cov[p:, p:]
    low, high = Model((), h.numbers, {}).bounds
    inside = _log_share(at, np.sqrt(np.diag(spread)), low, high)
    before = _log_share(np.zeros(len(at)), np.ones(len(at)), low, high)
    peak = float(at @ np.linalg.solve(spread, at))
    if cost is not None and np.all((at > low) & (at < high)):
        peak = (chosen.cost - cost) / scale
    evidence = 0.5 * float(np.linalg.slogdet(spread)[1]) + 0.5 * peak + inside - before
    # Given the sizes, the other numbers are where the cost is least.
    slope = -np.linalg.solve(information[:p, :p], information[:p, p:])
    moved = x[:p] + step[:p] - chosen.x
    if likelihood.follow is not None:
        less = rows - chosen.rows + jacobian @ step
        ways = jacobian[:, p:] + jacobian[:, :p] @ slope
        further = likelihood.follow.moved(less)
        moved = np.concatenate([moved, further])
        slope = np.concatenate([slope, np.stack([likelihood.follow.moved(c) for c in ways.T], axis=1)])
    slope, moved = _in_order(likelihood, chosen, slope, moved)
    odds = min(prior * float(np.exp(min(BELIEVED * evidence, 50.0))), MOST_ODDS)
    return _Beside(h, odds, at, spread, moved, slope)


def _log_share(mean: np.ndarray, sd: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Log of the share of independent normal distributions within bounds."""
    a, b = (low - mean) / sd, (high - mean) / sd
    a, b = np.where(a > 0, -b, a), np.where(a > 0, -a, b)
    upper = log_ndtr(b)
    return float(np.sum(upper + np.log1p(-np.exp(np.minimum(log_ndtr(a) - upper, -1e-15)))))


def _in_order(
    likelihood: Likelihood, chosen: Fitted, slope: np.ndarray, moved: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows for base numbers, effects and then dimensions, in the order of the jointly fitted model: base
    numbers, dimensions, effects.
    """
    b, p = len(likelihood.base), len(chosen.x)
    order = [*range(b), *range(p, len(moved)), *range(b, p)]
    return slope[order], moved[order]


def _whichever_acts(
    parts: Sequence[tuple[np.ndarray, float, str]], times: float, most: float
) -> tuple[float, float]:
    """The ends within which the 95 % intervals of some mixtures lie: that of the parts as they are, and for
    each effect that in which it has a larger weight.

    Args:
        parts: draws, weight, and the effect beside the model, "" for the models themselves.
        times: by how much the weight of that effect is larger.
        most: largest weight that it may reach.
    """
    some = [part for part in parts if len(part[0])]
    lengths = [len(draws) for draws, _, _ in some]
    values = np.concatenate([draws for draws, _, _ in some])
    weights = np.repeat([w / len(draws) for draws, w, _ in some], lengths)
    effects = sorted({effect for _, _, effect in some})
    of = np.repeat([effects.index(effect) for _, _, effect in some], lengths)
    order = np.argsort(values)
    values, weights, of = values[order], weights[order], of[order]
    mixtures, total = [np.cumsum(weights)], float(weights.sum())
    for i, effect in enumerate(effects):
        own = float(np.sum(weights[of == i]))
        if effect and times * own > LEAST * total:
            larger = max(1.0, min(times, most / own))
            mixtures.append(np.cumsum(np.where(of == i, larger, 1.0) * weights))
    low, high = np.transpose([np.interp(np.asarray(ENDS) * m[-1], m, values) for m in mixtures])
    return float(low.min()), float(high.max())


def _quantiles(parts: Sequence[tuple[np.ndarray, float]]) -> tuple[float, float]:
    """Ends of the 95 % interval of a mixture, of the parts that have the number."""
    low, high = _at(parts, np.asarray(ENDS))
    return float(low), float(high)


def _at(parts: Sequence[tuple[np.ndarray, float]], shares: np.ndarray) -> np.ndarray:
    """Quantiles of a mixture of draws, each with its weight."""
    some = [(draws, w) for draws, w in parts if len(draws)]
    values = np.concatenate([draws for draws, _ in some])
    weights = np.concatenate([np.full(len(draws), w / len(draws)) for draws, w in some])
    order = np.argsort(values)
    upto = np.cumsum(weights[order])
    return np.interp(shares * upto[-1], upto, values[order])


def _told(hidden: Sequence[tuple[_Beside, _Component]], shown: Marginal, total: float) -> list[Hidden]:
    """The effects that may act unseen, those first that add most to the spread of mu; shapes of one effect
    together.
    """
    centre = {n.name: n.value(x) for n, x in zip(shown.fitted.numbers, shown.fitted.x, strict=True)}
    mu = next((n.name for n in shown.fitted.numbers if is_friction(n)), None)
    by_name: dict[str, list[tuple[_Beside, _Component]]] = {}
    for b, c in hidden:
        by_name.setdefault(b.hypothesis.name, []).append((b, c))
    found = []
    for name, parts in by_name.items():
        if not sum(c.weight for _, c in parts) > 0:
            continue
        first = parts[0][0].hypothesis.numbers[0]
        away = [(np.abs(c.values(first.name) - first.centre), c.weight) for _, c in parts]
        share = sum(c.weight for _, c in parts) / total
        mu95, adds = None, 0.0
        if mu is not None:
            draws = [(c.values(mu), c.weight) for _, c in parts]
            mu95 = _quantiles(draws)
            adds = sum(w * float(np.mean((d - centre[mu]) ** 2)) for d, w in draws)
        largest = float(_at(away, np.asarray([0.95]))[0])
        found.append((adds, Hidden(name, first.name, first.unit, share, largest, first.centre, mu95)))
    return [h for _, h in sorted(found, key=lambda f: -f[0])]
