"""From the base model to what may be missing: screen, refit, combine."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..parallel import in_parallel
from .bench import MOST_ITERATIONS, Bench
from .hypotheses import Hypothesis
from .locate import misfit
from .model import FAILED, Fitted, Model, model_of

MU_STARTS = (0.03, 0.08, 0.15, 0.25, 0.4, 0.65)
# Hypotheses refitted, and those added to one that is known.
SHORTLIST, SECOND = 14, 3
# Starts by how many numbers a hypothesis has: shapes have optima of their own.
STARTS_EACH, ONE_EACH = {1: 2, 2: 3, 3: 5}, {1: 1, 2: 1, 3: 2}
# A drop of the sum of squares that is worth a refit.
WORTH, SECOND_WORTH = 6.0, 9.0
# Prior probability of no, one, two and three missing effects.
HOW_MANY = (0.5, 0.35, 0.12, 0.03)
# Iterations of a refit from each start and before some are given up: those that lack this share of what the
# best explains, first after so many, then after as many again, and are `HOPELESS` above it. Friction at the
# base of a catheter explained 0.94 of what the best did after four; in the end it left half as much as that.
BEGIN, BEHIND = 4, (0.2, 0.05)
# No law is exact: shares of what an effect does that its law may have wrong, with their probabilities, in so
# many independent ways. A rival must not win, nor a second effect be named, by what a law misses; nor must a
# law that leaves much be taken for right where another leaves nothing.
INEXACT, WAYS = {0.0: 0.55, 0.03: 0.2, 0.07: 0.15, 0.15: 0.07, 0.3: 0.03}, 4
# By how much the noise may be taken too small, in variance; and how far log-probabilities are believed: noise
# is not quite what it is taken for. Both chosen on some 350 blind recordings of development for the mean log
# of the probability given to the truth; less scale or more belief called more of the sound ones otherwise.
LARGEST_SCALE, BELIEVED = 1.3, 0.8
# Models this much less likely than the best, in log, are not refitted once the noise is known better.
HOPELESS = 40.0
# Single effects to which others are added: those as close to the best in log, or so many of them where even
# the best leaves structure of this significance.
CLOSE, HEADS, ASTRAY = 12.0, 5, 4.0


def base_fit(bench: Bench, start: np.ndarray | None = None) -> Fitted | None:
    """The base model fitted: noise and fit in turn, from the best of several starts unless one is given."""
    model = model_of(bench.base, ())
    numbers = model.numbers
    at = np.zeros(len(numbers)) if start is None else start
    if start is None:
        others = [0.0] * (len(numbers) - 1)
        starts = [np.zeros(len(numbers)), *(np.asarray([numbers[0].at(mu), *others]) for mu in MU_STARTS)]

        def rough(start):
            seen = bench.simulate(model.values(start))
            if seen is None:
                return np.inf
            return float(np.sum([np.sum(r[0] ** 2) for r in bench.residuals(seen)]))

        costs = in_parallel(rough, starts)
        if not np.isfinite(min(costs)):
            return None
        at = starts[int(np.argmin(costs))]
    seen = bench.simulate(model.values(at))
    fitted = None
    for _ in range(3):
        if seen is None:
            return None
        bench.weigh(model.values(at), seen)
        fitted = bench.refit((), at)
        if fitted is None:
            return None
        at, seen = fitted.x, fitted.seen
    return fitted


class Start(NamedTuple):
    """Where to refit a hypothesis from.

    Attributes:
        x: coordinates, those of the numbers fitted so far first.
        known: columns of the Jacobian there, roughly, by place.
    """

    x: np.ndarray
    known: dict[int, np.ndarray]


class Screened(NamedTuple):
    """A hypothesis before it is refitted.

    Attributes:
        hypothesis: what may be missing.
        gain: drop of the sum of squares at its best start.
        starts: to refit from, best first.
        smallest: size of its first number that would change the white residuals by `SEEN` in all once the
            others follow; infinite where it changes nothing.
    """

    hypothesis: Hypothesis
    gain: float
    starts: list[Start]
    smallest: float


@dataclasses.dataclass(frozen=True, eq=False)
class _Tried:
    """A start of a hypothesis: coordinates, drop of the sum of squares that it promises, power of what it
    changes beside the numbers fitted, and the least sum of squares simulated.
    """

    hypothesis: Hypothesis
    named: Mapping[str, float]
    start: Start
    gain: float = -np.inf
    power: float = 0.0
    cost: float = np.inf


# Standard errors that count as seen, and how far the numbers fitted may follow at once.
SEEN, FAR = 6.0, 1.5
# Sum of squares of the coordinates from which a base model counts as far off its priors.
FAR_OFF = 9.0
# Share of the drop that a slope promises which is counted on; how many starts are tried a second time;
# iterations of a third try; sum of squares, in those of the fit, from which a start with shapes gets none
# (presliding that is far too short is hard to solve: half a minute).
PROMISED, AGAIN, QUICK, AMISS = 0.3, 24, 3, 5.0


def firm_fit(bench: Bench, base: Fitted) -> Fitted | None:
    """The base model fitted with its priors as heavy as the data, where those have drawn it far off: what is
    missing may be much more like it there. None where it is not far off.
    """
    if base.prior < FAR_OFF:
        return None
    return bench.refit((), np.clip(base.x, -FAR, FAR), firm=max(bench.mean_square(base), base.prior))


def merged(one: Sequence[Screened], other: Sequence[Screened]) -> list[Screened]:
    """Two screens of the same hypotheses, the better starts first."""
    by_name, found = {s.hypothesis.name: s for s in other}, []
    for s in one:
        o = by_name[s.hypothesis.name]
        first, second = (s, o) if s.gain >= o.gain else (o, s)
        found.append(
            Screened(
                s.hypothesis,
                first.gain,
                [start for pair in zip(first.starts, second.starts, strict=False) for start in pair],
                s.smallest,
            )
        )
    return sorted(found, key=lambda s: -s.gain)


def screen(
    bench: Bench,
    fitted: Fitted,
    hypotheses: Sequence[Hypothesis],
    *,
    thorough: bool = True,
    reference: float | None = None,
) -> list[Screened]:
    """Try hypotheses beside a fit at finite sizes; the most promising again once the numbers fitted have
    followed; best first.

    Args:
        bench: the recordings.
        fitted: the model that they are added to.
        hypotheses: what to add.
        thorough: whether all starts are tried, or few.
        reference: sum of squares from which the drop counts; that of the fit unless given, and then nothing
            is tried a third time.
    """
    standing = fitted.cost if reference is None else reference
    J = np.concatenate([fitted.jacobian, np.eye(len(fitted.x))])
    q, upper = np.linalg.qr(J)
    r0, still = np.concatenate([fitted.rows, fitted.x]), np.zeros(len(fitted.x))
    left, n = r0 - q @ (q.T @ r0), len(fitted.x)
    low, high = (np.asarray([n.bounds[k] for n in fitted.numbers]) for k in (0, 1))
    columns = {i: fitted.jacobian[:, i] for i in range(n)}

    def simulated(numbers, x, fixed):
        values = dict(fitted.values) | Model((), numbers, fixed).values(x)
        seen = bench.simulate(values, fitted.names)
        if seen is None or sum(s.failed for s in seen) > fitted.failed:
            return None
        return bench.rows(seen), sum(s.failed for s in seen)

    def cost(rows, x, failed):
        return float(np.sum(rows**2) + np.sum(x**2) + FAILED * failed)

    def first_try(tried: _Tried) -> _Tried:
        h = tried.hypothesis
        x = tried.start.x[n:]
        ran = simulated(h.numbers, x, h.fixed)
        if ran is None:
            return tried
        rows, failed = ran
        moved = np.concatenate([rows - fitted.rows, still])
        across = moved - q @ (q.T @ moved)
        power = float(across @ across)
        # As large as tried, or as its slope asks for, within a factor; the numbers fitted follow.
        wanted = float(np.clip(-(left @ across) / power, 0.2, 2.0)) if power > 0 else 1.0
        share = min((float(np.sum((left + s * across) ** 2)), s) for s in (1.0, wanted))[1]
        sizes = np.asarray([number.size and not number.log for number in h.numbers])
        own = np.where(sizes, share * x, x)
        share = share if sizes.any() else 1.0
        follow = np.linalg.solve(upper, -(q.T @ (r0 + share * moved)))
        both = np.concatenate([np.clip(fitted.x + np.clip(follow, -FAR, FAR), low, high), own])
        # Far from the fit a slope promises too much, but not nothing.
        promised = PROMISED * (standing - cost(left + share * across, still, failed))
        known = dict(columns)
        if h.numbers[0].size and x[0] != 0:
            known[n] = (rows - fitted.rows) / x[0]
        first = cost(rows, fitted.x, failed)
        return dataclasses.replace(
            tried,
            start=Start(both, known),
            gain=max(standing - first, promised),
            power=power,
            cost=first,
        )

    def second_try(tried: _Tried) -> _Tried:
        h, both = tried.hypothesis, tried.start.x
        ran = simulated((*fitted.numbers, *h.numbers), both, h.fixed)
        if ran is None:
            return tried
        rows, failed = ran
        second = min(tried.cost, cost(rows, both[:n], failed))
        return dataclasses.replace(tried, gain=max(tried.gain, standing - second), cost=second)

    def third_try(tried: _Tried) -> _Tried | None:
        # Where the numbers fitted make up for most of an effect they follow along a valley too bent for one
        # step. Of several shapes each start has its own.
        h, known = tried.hypothesis, tried.start.known
        if n not in known or (len(h.numbers) > 1 and tried.cost > AMISS * standing):
            return None
        free = h.numbers if len(h.numbers) <= 2 else h.numbers[:1]
        shape = {m.name: tried.named[m.name] for m in h.numbers[len(free) :]}
        own = dataclasses.replace(h, numbers=free, fixed={**h.fixed, **shape})
        x = np.concatenate([fitted.x, [m.at(tried.named[m.name]) for m in free]])
        found = bench.refit((own,), x, known=known, exact=False, most=QUICK)
        if found is None:
            return None
        at = np.asarray([m.at(shape[m.name]) for m in h.numbers[len(free) :]])
        start = Start(np.concatenate([found.x, at]), dict(enumerate(found.jacobian.T)))
        return dataclasses.replace(tried, start=start, gain=standing - found.cost - float(at @ at))

    all_tried = [
        _Tried(h, s, Start(np.concatenate([fitted.x, [m.at(s[m.name]) for m in h.numbers]]), {}))
        for h in hypotheses
        for s in (h.starts if thorough else h.few)
    ]
    found = in_parallel(first_try, all_tried)

    def ranked_places(places: Iterable[int]) -> list[int]:
        return sorted(places, key=lambda i: -found[i].gain)

    def try_again(places: Sequence[int]) -> None:
        for i, tried in zip(places, in_parallel(second_try, [found[i] for i in places]), strict=True):
            found[i] = tried

    thirds: list[_Tried] = []
    promising = ranked_places(range(len(found)))[: AGAIN if thorough else AGAIN // 2]
    try_again(promising)
    if thorough and reference is None and not fitted.names:
        best: list[int] = []
        for h in hypotheses:
            mine = ranked_places(i for i, t in enumerate(found) if t.hypothesis is h)
            best += mine[: STARTS_EACH[len(h.numbers)]]
        try_again([i for i in best if i not in promising])
        thirds = [t for t in in_parallel(third_try, [found[i] for i in best]) if t is not None]
    screened = []
    for h in hypotheses:
        mine, first = [t for t in (*found, *thirds) if t.hypothesis is h], h.numbers[0]
        least = [
            abs(first.value(first.at(t.named[first.name]) * SEEN / np.sqrt(t.power)) - first.centre)
            for t in mine
            if t.power > 0 and first.size and t.named[first.name] != first.centre
        ]
        ranked = sorted(mine, key=lambda t: -t.gain)
        # The best, then of the others one of each size: from where small ones lead, shapes go astray.
        by_size: dict[float, _Tried] = {}
        for t in ranked:
            if t not in thirds and np.isfinite(t.gain):
                by_size.setdefault(t.named[first.name], t)
        starts = [t.start for t in dict.fromkeys([ranked[0], *by_size.values(), *ranked])]
        screened.append(Screened(h, float(ranked[0].gain), starts, min(least, default=np.inf)))
    return sorted(screened, key=lambda s: -s.gain)


def refit_best(
    bench: Bench,
    head: Sequence[Hypothesis],
    fitted: Fitted,
    screened: Sequence[Screened],
    starts: Mapping[int, int],
    most: int = MOST_ITERATIONS,
) -> list[Fitted]:
    """Refit each hypothesis beside a model, from its best start, or several where it has a shape: a few
    iterations from each, and on from the best of them unless it is hopeless.

    Args:
        bench: the recordings.
        head, fitted: the model, and its fit.
        screened: what to add, with starts.
        starts: how many are taken, by how many numbers a hypothesis has.
        most: iterations.
    """
    items = [
        (s.hypothesis, start) for s in screened for start in s.starts[: starts[len(s.hypothesis.numbers)]]
    ]

    def begin(item):
        h, start = item
        return bench.refit((*head, h), start.x, known=start.known, exact=False, most=BEGIN)

    begun, best = in_parallel(begin, items), []
    for s in screened:
        mine = [f for (h, _), f in zip(items, begun, strict=True) if h is s.hypothesis and f is not None]
        if mine:
            best.append((s.hypothesis, min(mine, key=lambda f: f.cost)))
    for behind, more in zip(BEHIND, (min(BEGIN, most - BEGIN), most - 2 * BEGIN), strict=True):
        if more <= 0:
            break
        least = min((f.cost for _, f in best), default=0.0)
        near = least + max(HOPELESS, behind * (fitted.cost - least))

        def go_on(item, near=near, more=more):
            h, f = item
            if f.cost >= near:
                return h, f
            found = bench.refit((*head, h), f.x, jacobian=f.jacobian, exact=False, most=more)
            return h, found or f

        best = in_parallel(go_on, best)
    return [f for _, f in best]


class Models:
    """All models refitted so far, and how probable they are.

    Args:
        bench: the recordings.
        hypotheses: the catalogue.
    """

    def __init__(self, bench: Bench, hypotheses: Sequence[Hypothesis]):
        self.bench = bench
        self.of = {h.name: h for h in hypotheses}
        self.fits: dict[tuple[str, ...], Fitted] = {}
        # Computed from all fits, when first asked for.
        self._scale: float | None = None
        self._excess: float | None = None

    def add(self, fits: Sequence[Fitted]) -> None:
        """Keep fits; of two of the same model the better."""
        self._scale = self._excess = None
        for f in fits:
            key = tuple(sorted(f.names))
            if key not in self.fits or f.cost < self.fits[key].cost:
                self.fits[key] = f

    @property
    def base(self) -> Fitted:
        """The fit without any hypothesis."""
        return self.fits[()]

    @property
    def scale(self) -> float:
        """Variance of white residuals by which models are compared: that of the best fit, within limits."""
        if self._scale is None:
            least = min(self.bench.mean_square(f) for f in self.fits.values())
            self._scale = float(np.clip(least, 1.0, LARGEST_SCALE))
        return self._scale

    def log_likelihood(self, fitted: Fitted) -> float:
        """Log of the probability of the data at the fit, up to a constant: of white noise, and in `WAYS`
        directions of what the effects' laws may have wrong.
        """
        each = self._by_share(fitted)
        return float(np.logaddexp.reduce(each)) - 0.5 * (fitted.cost - fitted.prior - fitted.chi2)

    def _by_share(self, fitted: Fitted) -> np.ndarray:
        """Log of the probability of the data and of each share that the laws may have wrong (`INEXACT`)."""
        squares = fitted.chi2 / self.scale
        explained = max(self.base.chi2 - fitted.chi2, 0.0) / self.scale
        beyond = max(squares - self.bench.readings, 0.0) + WAYS
        each = []
        for share, weight in INEXACT.items():
            more = share**2 * explained / WAYS
            fits = squares - beyond * more / (1 + more)
            each.append(np.log(weight) - 0.5 * WAYS * np.log1p(more) - 0.5 * fits)
        return np.asarray(each)

    def inexactness(self, fitted: Fitted) -> float:
        """Share of what the effects do that their laws have wrong, root mean square, given the data."""
        each = self._by_share(fitted)
        weights = np.exp(each - np.logaddexp.reduce(each))
        return float(np.sqrt(np.sum(weights * np.square(list(INEXACT)))))

    def log_posterior(self, fitted: Fitted) -> float:
        """Log of the posterior probability, up to a constant.

        What laws may have wrong must not make an effect of what noise does: against the base model the best
        effect counts no more than it would if laws were exact and all that it leaves were noise.
        """
        if self._excess is None:
            effects = [f for f in self.fits.values() if f.names]
            best = max(effects, key=self._believed, default=None)
            more = 0.0 if best is None else self._believed(best) - self._believed(self.base)
            self._excess = 0.0 if best is None else max(0.0, more - BELIEVED * self._plain_odds(best))
        return self._believed(fitted) - (self._excess if fitted.names else 0.0)

    def _believed(self, fitted: Fitted) -> float:
        return BELIEVED * (self.log_likelihood(fitted) + fitted.volume() + self.log_prior(fitted))

    def _plain_odds(self, fitted: Fitted) -> float:
        """Log of the odds against the base model, laws being exact and what the best leaves noise."""
        scale = max(1.0, min(self.bench.mean_square(f) for f in self.fits.values()))
        gain = 0.5 * (self.base.cost - self.base.prior - fitted.cost + fitted.prior) / scale
        return (
            gain + fitted.volume() - self.base.volume() + self.log_prior(fitted) - self.log_prior(self.base)
        )

    def log_prior(self, fitted: Fitted) -> float:
        """Log of the prior probability of a model's effects."""
        n, k = len(self.of), len(fitted.names)
        ways = float(np.prod([(n - i) / (i + 1) for i in range(k)]))
        return float(np.log(HOW_MANY[k] / ways))

    def ranked(self) -> list[Fitted]:
        """The models, the most probable first."""
        return sorted(self.fits.values(), key=lambda f: (-self.log_posterior(f), f.names))

    def probabilities(self) -> dict[tuple[str, ...], float]:
        """Probability of each model among those refitted, the most probable first."""
        ranked = self.ranked()
        logs = np.asarray([self.log_posterior(f) for f in ranked])
        share = np.exp(logs - logs.max())
        return {f.names: float(p) for f, p in zip(ranked, share / share.sum(), strict=True)}

    def hypotheses(self, names: Sequence[str]) -> list[Hypothesis]:
        """Of a model."""
        return [self.of[name] for name in names]

    def coordinates(self, names: Sequence[str], fitted: Fitted) -> np.ndarray:
        """Coordinates of a model from a fit of one with the same effects and more."""
        known = {n.name: v for n, v in zip(fitted.numbers, fitted.x, strict=True)}
        numbers = model_of(self.bench.base, self.hypotheses(names)).numbers
        return np.asarray([known[n.name] for n in numbers])

    def reweigh(self) -> None:
        """Take the noise anew from the best model, and refit those that matter."""
        ranked = self.ranked()
        top = ranked[0]
        self.bench.weigh(top.values, top.seen)
        kept = [
            f for f in ranked if not f.names or self.log_posterior(f) > self.log_posterior(top) - HOPELESS
        ]
        kept += [f for f in ranked if len(f.names) == 1 and f not in kept][: max(0, HEADS + 1 - len(kept))]

        def again(f):
            return self.bench.refit(self.hypotheses(f.names), f.x, most=5)

        self.fits = {}
        self.add([f for f in in_parallel(again, kept) if f is not None])


def add_to(models: Models, head: Fitted, progress: Callable[[str], None]) -> None:
    """Refit the most promising further effects beside those of a model."""
    progress(f"adding to {' + '.join(head.names)}")
    taken = {n.name for n in head.numbers}
    others = [h for h in models.of.values() if not taken & {n.name for n in h.numbers}]
    screened = screen(models.bench, head, others, thorough=False)
    wanted = [s for s in screened if s.gain > SECOND_WORTH][:SECOND]
    models.add(refit_best(models.bench, models.hypotheses(head.names), head, wanted, ONE_EACH, 6))


def combine(models: Models, progress: Callable[[str], None]) -> None:
    """Add second and third effects to the best models while that makes them more probable, and take out what
    is no longer needed.
    """
    singles = [f for f in models.ranked() if len(f.names) == 1]
    if not singles:
        return
    # What two effects do may be done half by a third: where one is not enough, more than the best are tried.
    size, significance = misfit(models.bench, singles[0])
    astray = significance > ASTRAY and size > 0.2
    least = models.log_posterior(singles[0]) - CLOSE
    heads = singles[:HEADS] if astray else [f for f in singles[:2] if models.log_posterior(f) > least]
    for head in heads:
        add_to(models, head, progress)
    best = models.ranked()[0]
    if len(best.names) == 2:
        add_to(models, best, progress)
    best, tried = models.ranked()[0], {f.names for f in heads}
    if len(best.names) < 2:
        return
    # A refit can stop short in a narrow valley that those of several effects have come through: what is left
    # of these starts where they end.
    for name in best.names:
        alone = _part(models, (name,), best)
        if alone is not None and (name,) not in tried:
            add_to(models, alone, progress)
    for pair in itertools.combinations(best.names, 2):
        _part(models, pair, best)


def _part(models: Models, names: tuple[str, ...], whole: Fitted) -> Fitted | None:
    """Refit some of the effects of a model from where that is; the better of this and any earlier fit."""
    if tuple(sorted(names)) != tuple(sorted(whole.names)):
        start = models.coordinates(names, whole)
        found = models.bench.refit(models.hypotheses(names), start, exact=len(names) == 1)
        models.add([] if found is None else [found])
    return models.fits.get(tuple(sorted(names)))
