"""More effects where what was found leaves structure beyond the noise, each kept only if it pays on unseen
samples.

The search for combinations (`search.combine`) asks whether a further effect is more probable, and allows for
laws that are not exact: where much is left whatever is added, that allowance covers it. Real recordings leave
much, for several reasons at once. There a further effect has to show that it predicts cycles that the fit has
not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calibrate.diagnosis.decision.decide import STAYS_SIZE, STAYS_Z, structured
from calibrate.diagnosis.evidence.models import HOW_MANY, Models
from calibrate.diagnosis.hypotheses.hypotheses import EVENTS, Hypothesis
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.held_out import by_fold
from calibrate.diagnosis.likelihood.locate import misfit
from calibrate.diagnosis.outside.episodes import episodes
from calibrate.diagnosis.outside.events import event_hypotheses
from calibrate.diagnosis.screening.screen import STARTS_EACH, Screened, screen
from calibrate.inference.side_by_side import in_lanes

from .search import ONE_EACH, SECOND_WORTH, add_variants, refit_best, without
from .twins import settled, swapped, twins_of

# Effects that are tried at each stage, those of them that are judged on unseen samples, and iterations of a
# refit.
TRIED, JUDGED, ITERATIONS = 6, 2, 8
# An effect is kept if it lowers the sum of squares of what is explained on unseen samples by this share, and
# is better in more than this share of the parts.
PAYS, MOST_PARTS = 0.1, 0.5
# Other cycles do not tell when an event happens. It is kept if the cost drops by this many variances of what
# is left, correlation counted, and by `PAYS`. Nor is an effect taken out that lowers the cost as much, though
# the parts held out miss it: where a recording has no cycles, each holds what no other shows.
SURE = 25.0
# Starts of an event that are refitted, by how many numbers it has.
EVENT_STARTS = {2: 5, 3: 4}
# Effects whose refits differ by less than this many variances of what is left are tried in place of each
# other.
NEAR = 8.0
# Effects tried in place of one of several, those that promise this share of what it does beside the others.
EXCHANGED, PROMISES = 4, 0.15


def forward_search(models: Models, start: Fitted, progress: Callable[[str], None]) -> Fitted:
    """Add effects to a model while they pay on unseen samples, first the most promising, from all their
    starts if none does; choose the variant of each effect again beside the others; take out those that then
    do not pay; and refit the models in which an effect is replaced by one that did nearly as well. All refits
    are added to `models`.

    Args:
        models: all that were refitted, to all samples.
        start: the model that leaves structure.
        progress: called with a line at each stage.

    Returns:
        The best model found: `start` if nothing pays.
    """
    if start.names:
        progress(f"trying events in place of {' and '.join(start.names)}")
        start = _with_event_instead(models, start)
    head = start
    instead, unseen = _alike(models, start), Unseen(models)
    while len(head.names) + 1 < len(HOW_MANY):
        progress(f"adding to {' + '.join(head.names) or 'the base model'} what pays on unseen samples")
        best, fits = _one_more(models, unseen, head)
        if best is None and structured(misfit(models.likelihood, head), STAYS_Z, STAYS_SIZE):
            progress("nothing does: trying every start of every effect")
            best, fits = _one_more(models, unseen, head, thorough=True)
        if best is None:
            break
        new = _new(best, head)
        near = NEAR * models.likelihood.scale_left(best)
        instead[new] = tuple(_new(f, head) for f in fits if f is not best and f.cost - best.cost < near)
        head, replaced = _best_variants(models, unseen, best)
        for variant, old in replaced.items():
            instead[variant] = (*instead.pop(old, ()), old)
    head = _without_idle(models, unseen, head, start)
    parts = [f for f in models.fits.values() if f.names and set(f.names) < set(head.names)]
    for name, others in twins_of(models, head).items():
        instead[name] = instead.get(name, ()) + others
    swaps = [*swapped(models, head, instead), *_exchanged(models, head)]
    rivals = [models.stored(f) for f in settled(models, [head, *parts, *swaps])]
    probability = models.probabilities_given_discrepancy(models.stored(head))
    return max(rivals, key=lambda f: probability[f.names])


def _one_more(
    models: Models, unseen: Unseen, head: Fitted, *, thorough: bool = False
) -> tuple[Fitted | None, list[Fitted]]:
    """The model with a further effect that pays, None if none does, and all that were refitted."""
    fits = _refitted_beside(models, head, thorough)
    models.add(fits)
    lasting = [f for f in fits if models.of[_new(f, head)].kind not in EVENTS]
    event = _event(models, head, fits)
    if event is not None:
        return settled(models, [event])[0], fits
    return unseen.best(head, lasting[:JUDGED]), fits


def beaten(models: Models, best: Fitted, others: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Those models with some of the effects of the best one that predict unseen samples worse by enough."""
    smaller = [names for names in others if set(names) < set(best.names)]
    unseen = Unseen(models)
    fits = [models.fits[tuple(sorted(names))] for names in smaller]
    return [names for names, f in zip(smaller, fits, strict=True) if unseen.best(f, [best]) is not None]


def _alike(models: Models, start: Fitted) -> dict[str, tuple[str, ...]]:
    """For each effect of a model, those with which it would be about as good instead."""
    near = NEAR * models.likelihood.scale_left(start)
    found: dict[str, tuple[str, ...]] = dict.fromkeys(start.names, ())
    for f in models.fits.values():
        other, own = set(f.names) - set(start.names), set(start.names) - set(f.names)
        if len(f.names) == len(start.names) and len(other) == 1 and abs(f.cost - start.cost) < near:
            found[own.pop()] += (other.pop(),)
    return found


def _exchanged(models: Models, head: Fitted) -> list[Fitted]:
    """The model with each of its effects replaced by another that does nearly as well beside the rest, or
    better: beside fewer effects, in whose company it was chosen, another may have seemed far worse.
    """
    if len(head.names) < 2:
        return []
    near, found = NEAR * models.likelihood.scale_left(head), list[Fitted]()
    for name in head.names:
        parent = without(models, head, name)
        if parent is None:
            continue
        others = [h for h in models.addable(parent) if h.name not in head.names]
        least = PROMISES * (parent.cost - head.cost)
        own = models.hypotheses(parent.names)
        tried = screen(models.likelihood, parent, others, head=own, thorough=False)
        wanted = [s for s in tried if s.gain > least]
        fits = refit_best(models.likelihood, own, parent, wanted[:EXCHANGED], ONE_EACH, ITERATIONS)
        found += [f for f in fits if f.cost < head.cost + near]
    return found


def _best_variants(models: Models, unseen: Unseen, head: Fitted) -> tuple[Fitted, dict[str, str]]:
    """The model with each of its effects in the variant that fits best beside the others, one with more
    numbers only if it pays on unseen samples; and for each variant taken the effect in whose place it stands.
    """
    head, replaced = settled(models, [head])[0], dict[str, str]()
    for name in head.names:
        fits = sorted((models.stored(f) for f in add_variants(models, head, name)), key=lambda f: f.cost)

        def pays(f: Fitted, head=head) -> bool:
            if f.cost >= head.cost - NEAR * models.likelihood.scale_left(f):
                return False
            return len(f.x) <= len(head.x) or unseen.best(head, [f]) is not None

        better = next(filter(pays, fits), None)
        if better is not None:
            replaced[_new(better, head)] = name
            head = better
    return head, replaced


def _new(fitted: Fitted, head: Fitted) -> str:
    return next(name for name in fitted.names if name not in head.names)


def _with_event_instead(models: Models, head: Fitted) -> Fitted:
    """The model with one of its effects replaced by an event, where that is sure and fits better: the search
    for combinations knows no events, and a change at one time then passes for a lasting one.
    """
    best = head
    for names in ([n for n in head.names if n != name] for name in head.names):
        known = models.fits.get(tuple(sorted(names)))
        start = models.coordinates(names, head) if known is None else known.x
        parent = models.likelihood.refit(models.hypotheses(names), start, exact=False)
        if parent is None:
            continue
        models.add([parent])
        parent = models.stored(parent)
        fits = _refitted(models, parent, screen(models.likelihood, parent, _events(models, parent)))
        models.add(fits)
        event = _event(models, parent, fits)
        if event is not None and event.cost < best.cost - NEAR * models.likelihood.scale_left(event):
            best = event
    return best if best is head else settled(models, [best])[0]


def _events(models: Models, head: Fitted) -> list[Hypothesis]:
    """Events that may be what a model lacks, known to the models from now on."""
    found = episodes(models.likelihood, head)
    events = event_hypotheses(models.likelihood, found, [models.of[n].kind for n in head.names])
    models.of |= {h.name: h for h in events}
    return events


def _refitted_beside(models: Models, head: Fitted, thorough: bool) -> list[Fitted]:
    """The most promising further effects, refitted beside those of a model, the best first; thoroughly from
    all their starts, else from few.
    """
    likelihood, own = models.likelihood, models.hypotheses(head.names)
    lasting = screen(likelihood, head, models.addable(head), head=own, thorough=thorough)
    tried = [*lasting, *screen(likelihood, head, _events(models, head))]
    return _refitted(models, head, tried, STARTS_EACH if thorough else ONE_EACH)


def _refitted(
    models: Models, head: Fitted, screened: Sequence[Screened], starts: Mapping[int, int] = ONE_EACH
) -> list[Fitted]:
    """The most promising of some effects, refitted beside those of a model, the best first; from so many
    starts, by how many numbers an effect has.
    """
    best = sorted(screened, key=lambda s: -s.gain)
    wanted = [s for s in best if s.gain > SECOND_WORTH][:TRIED]
    own = models.hypotheses(head.names)
    lasting = [s for s in wanted if s.hypothesis.kind not in EVENTS]
    fits = refit_best(models.likelihood, own, head, lasting, starts, ITERATIONS)
    # When an event happens is found from several starts: the cost has a minimum beside each.
    at_once = [s for s in wanted if s.hypothesis.kind in EVENTS]
    fits += refit_best(models.likelihood, own, head, at_once, EVENT_STARTS, ITERATIONS)
    # A fit with more effects must not be worse than its parent: that is where it is null.
    return sorted((f for f in fits if f.cost < head.cost), key=lambda f: f.cost)


def _event(models: Models, head: Fitted, fits: Sequence[Fitted]) -> Fitted | None:
    """The best of some fits, if it adds an event that is sure beside all that is left."""
    best = next(iter(fits), None)
    if best is None or models.of[_new(best, head)].kind not in EVENTS:
        return None
    sure = head.cost - best.cost > SURE * models.likelihood.scale_left(best)
    return best if sure and best.chi2 < (1 - PAYS) * head.chi2 else None


class Unseen:
    """How well models predict unseen samples; each is judged once, and again where a fit is found that is
    much better than the one judged. By what is explained; or, where rows far off count less, by all rows.

    Args:
        models: all that were refitted.
        pieces: as of `held_out.folds`.
        rows: whether all rows judge in any case.
    """

    def __init__(self, models: Models, *, pieces: bool = False, rows: bool = False):
        self.models, self.pieces = models, pieces
        self.rows = rows or models.likelihood.heavy is not None
        # Of each model, the cost of the fit that was judged, and what it leaves of each part.
        self._known: dict[tuple[str, ...], tuple[float, np.ndarray]] = {}

    def shared(self, models: Models | None = None, *, rows: bool = False) -> Unseen:
        """The same with what is known already, for other models of the same recordings; with all rows as the
        judge if asked for.
        """
        other = Unseen(models or self.models, pieces=self.pieces, rows=self.rows or rows)
        other._known = self._known
        return other

    def folds(self, fits: Sequence[Fitted]) -> np.ndarray:
        """What each model leaves of each part, (models, folds, 4), as of `by_fold`."""
        new = [f for f in fits if not self._judged(f)]
        if new:
            own = [(self.models.hypotheses(f.names), f) for f in new]
            found = by_fold(self.models.likelihood, own, pieces=self.pieces)
            self._known |= {f.names: (f.cost, each) for f, each in zip(new, found, strict=True)}
        return np.stack([self._known[f.names][1] for f in fits])

    def _judged(self, f: Fitted) -> bool:
        """Whether a fit was judged, or one of the same model that is about as good: a part is refitted from
        where the fit ended, in few iterations.
        """
        if f.names not in self._known:
            return False
        return f.cost > self._known[f.names][0] - NEAR * self.models.likelihood.scale_left(f)

    def squares(self, fits: Sequence[Fitted]) -> np.ndarray:
        """Sum of squares, of what is explained (SI) or of the rows, of each model on each part, (models,
        folds); infinite where a refit fails.
        """
        folds = self.folds(fits)
        told = folds[..., 2 if self.rows else 0]
        return np.where(folds[..., 1] > 0, told, np.inf)

    def totals(self, fits: Sequence[Fitted]) -> tuple[np.ndarray, np.ndarray]:
        """Their squares on the parts on which all are judged, (models, folds), and the sums, (models,); no
        part and zeros where a refit fails on each.
        """
        squares = self.squares(fits)
        squares = squares[:, np.all(np.isfinite(squares), axis=0)]
        return squares, squares.sum(axis=1)

    def best(self, head: Fitted, fits: Sequence[Fitted]) -> Fitted | None:
        """The fit that predicts unseen samples best, if it does so better than the head by enough, and in
        most parts; else None.
        """
        if not fits:
            return None
        squares, total = self.totals([head, *fits])
        if not squares.size:
            return None
        best = 1 + int(np.argmin(total[1:]))
        better = np.mean(squares[best] < squares[0])
        return fits[best - 1] if total[best] < (1 - PAYS) * total[0] and better > MOST_PARTS else None


def _without_idle(models: Models, unseen: Unseen, head: Fitted, start: Fitted) -> Fitted:
    """The model without effects that no longer pay beside the others."""
    while len(head.names) > max(len(start.names), 1):
        smaller = [tuple(n for n in head.names if n != name) for name in head.names]
        needed = head.cost + SURE * models.likelihood.scale_left(head)

        def refit(names, head=head):
            own = models.hypotheses(names)
            return models.likelihood.refit(own, models.coordinates(names, head), exact=False)

        fits = [f for f in in_lanes(refit, smaller) if f is not None]
        models.add(fits)
        fits = [f for f in (models.stored(f) for f in fits) if f.cost < needed]
        if not fits:
            return head
        squares, total = unseen.totals([head, *fits])
        if not squares.size:
            return head
        least = 1 + int(np.argmin(total[1:]))
        if total[0] < (1 - PAYS) * total[least]:
            return head
        head = fits[least - 1]
    return head
