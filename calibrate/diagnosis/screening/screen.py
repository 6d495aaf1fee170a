"""Hypotheses tried beside a fit at finite sizes, before any is refitted."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.hypotheses.hypotheses import Hypothesis
from calibrate.diagnosis.hypotheses.model import FAILED, Fitted, Model
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.inference.side_by_side import in_lanes

# Starts that are refitted, by how many numbers a hypothesis has: each shape may have an optimum of its own.
STARTS_EACH = {1: 2, 2: 3, 3: 5}


class Start(NamedTuple):
    """Where to refit a hypothesis from.

    Attributes:
        x: coordinates, those of the numbers fitted so far first.
        known: columns of the Jacobian there, roughly, by place.
    """

    x: np.ndarray
    known: dict[int, np.ndarray]


class Try(NamedTuple):
    """What a hypothesis changes at one start.

    Attributes:
        x: coordinates of its numbers.
        scales: whether the change grows with the size of the effect.
        moved: change of the white rows, and of the coordinates of the fitted numbers (none), (n + p,).
    """

    x: np.ndarray
    scales: bool
    moved: np.ndarray


class Screened(NamedTuple):
    """A hypothesis before it is refitted.

    Attributes:
        hypothesis: what may be missing.
        gain: drop of the sum of squares at its best start.
        starts: to refit from, best first.
        smallest: size of its first number that would change the whitened residuals by a norm of `SEEN` once
            the other numbers follow; infinite where it changes nothing.
        tries: what it changes at each start, the other numbers as fitted.
    """

    hypothesis: Hypothesis
    gain: float
    starts: list[Start]
    smallest: float
    tries: list[Try]


@dataclasses.dataclass(frozen=True, eq=False)
class _Tried:
    """A start of a hypothesis: coordinates, drop of the sum of squares that it promises, power of what it
    changes beside the numbers fitted, the least sum of squares simulated, and what it changes.
    """

    hypothesis: Hypothesis
    named: Mapping[str, float]
    start: Start
    gain: float = -np.inf
    power: float = 0.0
    cost: float = np.inf
    change: Try | None = None


# Standard errors from which an effect is seen; and how far the fitted numbers may follow in one step, in
# coordinates.
SEEN, FAR = 6.0, 1.5
# Sum of squares of the coordinates from which a base model counts as far off its priors.
FAR_OFF = 9.0
# Share of the drop promised by a slope that is counted on; number of starts tried a second time; iterations
# of a third try; ratio to the fit's sum of squares above which a start with shapes gets no third try
# (presliding that is far too short is hard to solve: half a minute).
PROMISED, AGAIN, QUICK, AMISS = 0.3, 24, 3, 5.0
# The size that a first try asks for, as a share of the size tried, within limits. With a least share of 0.2 a
# drift of the base cell's zero, beside a hysteresis of the tip's that was found before it, promised nothing
# from a start ten times as large, though it gained more than any other second effect.
SHARES = (0.05, 2.0)
# Hypotheses that get a third try beside a model of the search. Without it a gain of the tip cell beside a
# delay between the cells promised too little to be among five; refitted, it left a fiftieth of their best.
FURTHER = 12


def firm_fit(likelihood: Likelihood, base: Fitted) -> Fitted | None:
    """The base model fitted with its priors as heavy as the data, if the data have drawn it far off: the
    residual there may resemble the missing effect much more. None if it is not far off.
    """
    if base.prior < FAR_OFF:
        return None
    return likelihood.refit(
        (), np.clip(base.x, -FAR, FAR), firm=max(likelihood.mean_square(base), base.prior)
    )


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
                s.tries,
            )
        )
    return sorted(found, key=lambda s: -s.gain)


def screen(
    likelihood: Likelihood,
    fitted: Fitted,
    hypotheses: Sequence[Hypothesis],
    *,
    head: Sequence[Hypothesis] | None = None,
    thorough: bool = True,
    reference: float | None = None,
) -> list[Screened]:
    """Try hypotheses beside a fit at finite sizes; the most promising again once the numbers fitted have
    followed; best first.

    Args:
        likelihood: the recordings.
        fitted: the model that they are added to.
        hypotheses: what to add.
        head: effects of the model, none or more; the most promising beside them are tried a third time if
            they are given.
        thorough: whether all starts are tried, or few; beside the base model without `head`, whether several
            starts of each hypothesis are tried a third time.
        reference: sum of squares from which the drop counts, that of the fit unless given; if it is given,
            nothing is tried a third time.
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
        seen = likelihood.simulate(values, fitted.names)
        if seen is None or sum(s.failed for s in seen) > fitted.failed:
            return None
        return likelihood.rows(seen), sum(s.failed for s in seen)

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
        # The size as tried, or as a linear model asks for within limits; the fitted numbers follow.
        wanted = float(np.clip(-(left @ across) / power, *SHARES)) if power > 0 else 1.0
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
            change=Try(x, bool(sizes.any()), moved),
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
        # Where the fitted numbers make up for most of an effect, they follow along a valley too curved for
        # one step. With several shape numbers, each start keeps its own shape.
        h, known = tried.hypothesis, tried.start.known
        if len(h.numbers) > 1 and tried.cost > AMISS * standing:
            return None
        free = h.numbers if len(h.numbers) <= 2 else h.numbers[:1]
        shape = {m.name: tried.named[m.name] for m in h.numbers[len(free) :]}
        own = dataclasses.replace(h, numbers=free, fixed={**h.fixed, **shape})
        x = np.concatenate([fitted.x, [m.at(tried.named[m.name]) for m in free]])
        found = likelihood.refit((*(head or ()), own), x, known=known, exact=False, most=QUICK)
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
    found = in_lanes(first_try, all_tried)

    def ranked_places(places: Iterable[int]) -> list[int]:
        return sorted(places, key=lambda i: -found[i].gain)

    def try_again(places: Sequence[int]) -> None:
        for i, tried in zip(places, in_lanes(second_try, [found[i] for i in places]), strict=True):
            found[i] = tried

    thirds: list[_Tried] = []
    promising = ranked_places(range(len(found)))[: AGAIN if thorough else AGAIN // 2]
    try_again(promising)
    if reference is None and (head is not None or (thorough and not fitted.names)):
        best, able = list[int](), list[int]()
        for h in hypotheses:
            each = 1 if head is not None else STARTS_EACH[min(len(h.numbers), max(STARTS_EACH))]
            mine = ranked_places(i for i, t in enumerate(found) if t.hypothesis is h)
            best += mine[:each]
            # A third try needs the slope that a size gives.
            able += [i for i in mine if n in found[i].start.known][:each]
        if head is not None:
            best, able = ranked_places(best)[:FURTHER], ranked_places(able)[:FURTHER]
        try_again([i for i in dict.fromkeys((*best, *able)) if i not in promising])
        thirds = [t for t in in_lanes(third_try, [found[i] for i in able]) if t is not None]
    screened = []
    for h in hypotheses:
        mine, first = [t for t in (*found, *thirds) if t.hypothesis is h], h.numbers[0]
        least = [
            abs(first.value(first.at(t.named[first.name]) * SEEN / np.sqrt(t.power)) - first.centre)
            for t in mine
            if t.power > 0 and first.size and t.named[first.name] != first.centre
        ]
        ranked = sorted(mine, key=lambda t: -t.gain)
        # The best, then one of each size among the others: shapes go astray from where small sizes lead.
        by_size: dict[float, _Tried] = {}
        for t in ranked:
            if t not in thirds and np.isfinite(t.gain):
                by_size.setdefault(t.named[first.name], t)
        starts = [t.start for t in dict.fromkeys([ranked[0], *by_size.values(), *ranked])]
        changes = [t.change for t in found if t.hypothesis is h and t.change is not None]
        smallest = min(least, default=np.inf)
        screened.append(Screened(h, float(ranked[0].gain), starts, smallest, changes))
    return sorted(screened, key=lambda s: -s.gain)
