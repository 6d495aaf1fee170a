"""From the base model to what may be missing: refit, combine."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calibrate.diagnosis.evidence.models import HEADS, HOPELESS, Models
from calibrate.diagnosis.hypotheses.hypotheses import EVENTS, Hypothesis, is_friction
from calibrate.diagnosis.hypotheses.model import Fitted, model_of
from calibrate.diagnosis.likelihood.likelihood import MOST_ITERATIONS, Likelihood
from calibrate.diagnosis.likelihood.locate import misfit
from calibrate.diagnosis.screening.pairs import Pair
from calibrate.diagnosis.screening.screen import STARTS_EACH, Screened, Start, screen
from calibrate.inference.side_by_side import in_lanes

# Friction coefficients that the base model is tried from.
MU_STARTS = (0.03, 0.08, 0.15, 0.25, 0.4, 0.65)
# Number of hypotheses refitted beside the base model, and of pairs that are begun from there.
SHORTLIST, PAIRS = 14, 8
# Starts of a further effect by how many numbers it has, one or several.
ONE_EACH, SEVERAL_EACH = {1: 1, 2: 1, 3: 2}, {1: 2, 2: 3, 3: 4}


class Effort(NamedTuple):
    """How further effects are sought beside a model: how many are refitted, from how many starts, and with
    how many iterations.
    """

    most: int
    starts: Mapping[int, int]
    iterations: int


# Where one effect is enough a second is looked for in brief; where structure is left, thoroughly, from all
# starts: the slopes beside a wrong or lonely effect order the others badly.
BRIEF, THOROUGH = Effort(3, ONE_EACH, 6), Effort(5, SEVERAL_EACH, 10)
# Drop of the sum of squares that is worth a refit: of a first effect, and of a further one.
WORTH, SECOND_WORTH = 6.0, 9.0
# Iterations of each of the first two stages of a refit. After each stage, hypotheses are given up that lag
# the best by more than this share of what it explains, and by more than `HOPELESS`. Friction at the base of a
# catheter explained 0.94 of what the best did after four iterations; in the end it left half as much as the
# best.
BEGIN, BEHIND = 4, (0.2, 0.05)
# Others are added to single effects whose log posterior is this close to the best, or to `HEADS` of them
# where even the best leaves structure of this significance.
CLOSE, ASTRAY = 12.0, 4.0
# Pairs that a third effect is added to where structure is left.
BEAM = 2


def base_fit(likelihood: Likelihood, start: np.ndarray | None = None) -> tuple[Likelihood, Fitted] | None:
    """Weigh the likelihood and fit the base model, in turn, from the best of several starts unless one is
    given; None where that fails.
    """
    model = model_of(likelihood.base, ())
    numbers = model.numbers
    at = np.zeros(len(numbers)) if start is None else start
    if start is None:
        starts = [np.zeros(len(numbers))]
        starts += [np.asarray([n.at(mu) if is_friction(n) else 0.0 for n in numbers]) for mu in MU_STARTS]

        def rough(start):
            seen = likelihood.simulate(model.values(start))
            if seen is None:
                return np.inf
            left = zip(likelihood.residuals(seen), likelihood.rigs, strict=True)
            return float(np.sum([np.sum(r[: rig.part.explained] ** 2) for r, rig in left]))

        costs = in_lanes(rough, starts)
        if not np.isfinite(min(costs)):
            return None
        at = starts[int(np.argmin(costs))]
    seen = likelihood.simulate(model.values(at))
    if seen is None:
        return None
    found = None
    for _ in range(3):
        likelihood = likelihood.weighed(model.values(at), seen)
        fitted = likelihood.refit((), likelihood.scanned(model, at))
        if fitted is None:
            return None
        at, seen, found = fitted.x, fitted.seen, (likelihood, fitted)
    return found


def refit_best(
    likelihood: Likelihood,
    head: Sequence[Hypothesis],
    fitted: Fitted,
    screened: Sequence[Screened],
    starts: Mapping[int, int],
    most: int = MOST_ITERATIONS,
) -> list[Fitted]:
    """Refit each hypothesis beside a model, from its best start, or several where it has a shape: a few
    iterations from each, and on from the best of them unless it is hopeless.

    Args:
        likelihood: the recordings.
        head, fitted: the model, and its fit.
        screened: what to add, with starts.
        starts: how many are taken, by how many numbers a hypothesis has.
        most: iterations.
    """
    items = [
        ((*head, s.hypothesis), start)
        for s in screened
        for start in s.starts[: starts[min(len(s.hypothesis.numbers), max(starts))]]
    ]
    return raced(likelihood, fitted, items, most)


def raced(
    likelihood: Likelihood,
    reference: Fitted,
    items: Sequence[tuple[tuple[Hypothesis, ...], Start]],
    most: int,
) -> list[Fitted]:
    """Refit models, each from its starts: a few iterations from each, and on from the best of them unless it
    lags the best of all.

    Args:
        likelihood: the recordings.
        reference: the model that all of them extend.
        items: hypotheses of the model, and a start; starts of one model share the hypotheses.
        most: iterations.
    """

    def begin(item):
        own, start = item
        return likelihood.refit(own, start.x, known=start.known, exact=False, most=BEGIN)

    best: dict[tuple[str, ...], tuple[tuple[Hypothesis, ...], Fitted]] = {}
    for (own, _), f in zip(items, in_lanes(begin, items), strict=True):
        key = tuple(h.name for h in own)
        if f is not None and (key not in best or f.cost < best[key][1].cost):
            best[key] = own, f
    found = list(best.values())
    for behind, more in zip(BEHIND, (min(BEGIN, most - BEGIN), most - 2 * BEGIN), strict=True):
        if more <= 0:
            break
        least = min((f.cost for _, f in found), default=0.0)
        near = least + max(HOPELESS, behind * (reference.cost - least))

        def go_on(item, near=near, more=more):
            own, f = item
            if f.cost >= near:
                return own, f
            again = likelihood.refit(own, f.x, jacobian=f.jacobian, exact=False, most=more)
            return own, again or f

        found = in_lanes(go_on, found)
    return [f for _, f in found]


def add_to(models: Models, head: Fitted, progress: Callable[[str], None], effort: Effort = BRIEF) -> None:
    """Refit the most promising further effects beside those of a model."""
    progress(f"adding to {' + '.join(head.names)}")
    own = models.hypotheses(head.names)
    screened = screen(models.likelihood, head, models.addable(head), head=own, thorough=effort is THOROUGH)
    wanted = [s for s in screened if s.gain > SECOND_WORTH][: effort.most]
    models.add(refit_best(models.likelihood, own, head, wanted, effort.starts, effort.iterations))


def add_variants(models: Models, head: Fitted, name: str) -> list[Fitted]:
    """Refit a model with one of its effects in each other variant, thoroughly: where friction acts locally,
    which cell drifts, on which tendon, or whether its clock does, was chosen in other company. Those that do
    more than the model without the effect are added to the models, and returned.
    """
    kind = models.of[name].kind
    alike = {h.name for h in models.of.values() if h.kind == kind} - set(head.names)
    parent = without(models, head, name) if alike and kind not in EVENTS else None
    if parent is None:
        return []
    variants = [h for h in models.addable(parent) if h.name in alike]
    own = models.hypotheses(parent.names)
    tried = [s for s in screen(models.likelihood, parent, variants, head=own) if s.gain > 0]
    fits = refit_best(models.likelihood, own, parent, tried, STARTS_EACH)
    # From where the model is, too, if the variant has numbers of the effect in whose place it stands.
    known = {n.name: v for n, v in zip(head.numbers, head.x, strict=True)}
    for h in variants:
        numbers = model_of(models.likelihood.base, (*own, h)).numbers
        if any(n.name in known for n in h.numbers):
            start = np.asarray([known.get(n.name, 0.0) for n in numbers])
            again = models.likelihood.refit((*own, h), start)
            fits += [] if again is None else [again]
    fits = [f for f in fits if f.cost < parent.cost]
    models.add(fits)
    return fits


def without(models: Models, head: Fitted, name: str) -> Fitted | None:
    """A model without one of its effects, refitted once; None where that fails."""
    names = tuple(n for n in head.names if n != name)
    if tuple(sorted(names)) not in models.fits:
        less = models.likelihood.refit(models.hypotheses(names), models.coordinates(names, head))
        models.add([] if less is None else [less])
    return models.fits.get(tuple(sorted(names)))


def add_pairs(models: Models, pairs: Sequence[Pair], progress: Callable[[str], None]) -> None:
    """Refit pairs from the base model where they promise more than the best single effect explains."""
    least = min((f.cost for f in models.fits.values() if len(f.names) == 1), default=models.base.cost)
    wanted = [pair for pair in pairs if pair.gain > models.base.cost - least + SECOND_WORTH]
    if wanted:
        progress(f"trying {len(wanted)} pairs that promise more together")
        items = [(pair.hypotheses, Start(pair.start, {})) for pair in wanted]
        models.add(raced(models.likelihood, models.base, items, MOST_ITERATIONS))


def combine(models: Models, pairs: Sequence[Pair], progress: Callable[[str], None]) -> None:
    """Add second and third effects to the best models while that makes them more probable, take out what is
    no longer needed, and try each effect of the best in its other variants.

    Args:
        models: the base model and single effects.
        pairs: that promise more together than alone, from the base model.
        progress: called with a line at each stage.
    """
    singles = [f for f in models.ranked() if len(f.names) == 1]
    if not singles:
        return
    # A third effect may do half of what two others do together: where one effect is not enough, others are
    # added to more than the best.
    size, significance = misfit(models.likelihood, singles[0])
    astray = significance > ASTRAY and size > 0.2
    least = models.log_posterior(singles[0]) - CLOSE
    heads = singles[:HEADS] if astray else [f for f in singles[:2] if models.log_posterior(f) > least]
    effort = THOROUGH if astray else BRIEF
    for head in heads:
        add_to(models, head, progress, effort)
    if astray:
        add_pairs(models, pairs, progress)
    best = models.ranked()[0]
    if len(best.names) == 2:
        add_to(models, best, progress, effort)
        if astray:
            close = models.log_posterior(best) - CLOSE
            others = [f for f in models.ranked() if len(f.names) == 2 and f.names != best.names]
            for other in [f for f in others if models.log_posterior(f) > close][: BEAM - 1]:
                add_to(models, other, progress)
    best, tried = models.ranked()[0], {f.names for f in heads}
    if len(best.names) < 2:
        return
    # A refit can stop short in a narrow valley that a refit of more effects has passed: so the parts of the
    # best model are refitted from where it ended.
    for name in best.names:
        alone = _part(models, (name,), best)
        if alone is not None and (name,) not in tried:
            add_to(models, alone, progress)
    for pair in itertools.combinations(best.names, 2):
        _part(models, pair, best)
    best = models.ranked()[0]
    for name in best.names if len(best.names) > 1 else ():
        add_variants(models, best, name)


def _part(models: Models, names: tuple[str, ...], whole: Fitted) -> Fitted | None:
    """Refit some of the effects of a model, starting from its fit; return the better of this and any earlier
    fit.
    """
    if tuple(sorted(names)) != tuple(sorted(whole.names)):
        start = models.coordinates(names, whole)
        found = models.likelihood.refit(models.hypotheses(names), start, exact=len(names) == 1)
        models.add([] if found is None else [found])
    return models.fits.get(tuple(sorted(names)))
