"""From the probabilities of the models to a verdict that can be defended."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from calibrate.diagnosis.evidence.models import HOW_MANY, INEXACT, Models
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.locate import between_samples, misfit
from calibrate.diagnosis.outside.patterns import Pattern, pattern_in
from calibrate.diagnosis.screening.screen import SEEN, Screened
from gtr_jax.terms import REGISTRY

if TYPE_CHECKING:
    from calibrate.diagnosis.laws.discovery import Discovery

UNSEEN = "an effect too small to see"
ADEQUATE, MISSING, AMBIGUOUS, UNEXPLAINED = "adequate", "missing-physics", "ambiguous", "unexplained"
PARTLY, DISCOVERED = "partly-explained", "discovered"
# An effect is named alone above the first probability. Otherwise a set holds the models that together reach
# the second, each of them above the third.
ALONE, TOGETHER, LEAST = 0.8, 0.98, 0.03
# Most models in a set if less probable ones are taken in because the best cannot be named alone.
MOST = 5
# Models whose predictions differ by less than this many standard errors count as one for these data.
ALIKE = 2.5
# Structure left by the base model counts above this significance and this size in standard deviations of the
# noise.
LEFT_Z, LEFT_SIZE = 6.0, 0.35
# Size above which structure counts even if neighbouring samples are not correlated. One repeat in four with
# three times the noise has a size of 1.4; one of 206 sound recordings reached 1.47.
VAST = 2.5
# Structure left by the best effect counts above this significance, size and share of the size that the base
# model leaves; the second share holds where the size exceeds `MUCH`.
STAYS_Z, STAYS_SIZE, STAYS_SHARE, MUCH = 2.2, 0.3, (0.55, 0.42), 1.35
# In a long recording, where every effect pays on unseen cycles, half of what is left in squares may stay.
HALF_STAYS = 0.71
# Some of several effects may be all there is if they explain this share of what all explain: laws are not
# exact.
NEARLY_ALL = 0.95
# Effects that are exact by definition: an offset, a gain, a share of the other reading, a delay. Errors of
# what these explain are this part of those of a law of matter. In some recordings a delay between the cells
# explains 560 standard deviations: with 30 % of those allowed, the stretch of a tendon beside it, 42, was
# taken for an error of the delay.
DEFINED = frozenset(kind for kind, term in REGISTRY.items() if term.exact)
OF_DEFINED = 0.1
# Effects by which a cell shows the tension of times between the samples.
LATE = frozenset(kind for kind, term in REGISTRY.items() if term.read_at)
# Nothing is claimed below this probability that something is missing, nor below a drop of `SEEN` standard
# errors: errors of the mesh and of the first-order dimensions may be as large. In a long recording, those of
# the base tension's corners grow with the readings: nothing is claimed below this drop of the sum of squares
# for each of the tip's. On a sound recording made as rigs make them viscous friction gained 0.015; on another
# an offset and a saturation of the tip's cell, which were there, 0.4.
CLAIMED, FOR_EACH = 0.97, 0.03


@dataclasses.dataclass(frozen=True)
class Decision:
    """A verdict.

    Attributes:
        verdict: "adequate", "missing-physics", "ambiguous", "partly-explained", "discovered" or
            "unexplained".
        chosen: the model that is shown; the base model where nothing is named.
        confusion: models that the data do not tell apart, the most probable first; by names of hypotheses.
        probability: of each model, the most probable first; `with_unseen` adds that of an effect too small to
            see.
        left: structure the chosen model leaves: size in standard deviations of the noise, and significance.
        base_left: the same for the base model.
        pattern: a regularity in the chosen model's residual that noise does not have; None if there is none.
    """

    verdict: str
    chosen: Fitted
    confusion: list[tuple[str, ...]]
    probability: dict[tuple[str, ...], float]
    left: tuple[float, float]
    base_left: tuple[float, float]
    pattern: Pattern | None = None


def with_unseen(decision: Decision, models: Models, screened: Sequence[Screened]) -> Decision:
    """Add the probability of an effect that is too small for these recordings to show, which is not
    negligible where nothing is seen. All other probabilities are scaled down for it.
    """
    n, share = len(models.of), 0.0
    for s in screened:
        first = s.hypothesis.numbers[0]
        # The probability of a refitted hypothesis already covers small sizes; contact and saturation have no
        # size.
        if first.size and np.isfinite(s.smallest) and (s.hypothesis.name,) not in models.fits:
            share += float(2 * ndtr(abs(first.at(first.centre + s.smallest))) - 1)
    unseen = decision.probability[()] * HOW_MANY[1] / HOW_MANY[0] * share / n
    scaled = {names: p / (1 + unseen) for names, p in decision.probability.items()}
    return dataclasses.replace(decision, probability=scaled | {(UNSEEN,): unseen / (1 + unseen)})


def _apart(a: Fitted, b: Fitted) -> float:
    """By how many standard errors two models' predictions differ."""
    return float(np.linalg.norm(a.rows - b.rows))


def decide(models: Models) -> Decision:
    """The verdict."""
    probability = models.probabilities()
    best, base = models.fits[tuple(sorted(next(iter(probability))))], models.base
    base_left, left = misfit(models.likelihood, base), misfit(models.likelihood, best)
    nothing = probability[()]
    if not best.names or 1 - nothing < CLAIMED or base.cost - best.cost < least_drop(models):
        pattern = pattern_in(models.likelihood, base)
        verdict = UNEXPLAINED if structured(base_left) or pattern else ADEQUATE
        return Decision(
            verdict=verdict,
            chosen=base,
            confusion=[],
            probability=probability,
            left=base_left,
            base_left=base_left,
            pattern=pattern,
        )
    if most_stays(left, base_left):
        pattern = pattern_in(models.likelihood, best)
        if pattern or structured(left, STAYS_Z, STAYS_SIZE):
            return Decision(
                verdict=UNEXPLAINED,
                chosen=best,
                confusion=[],
                probability=probability,
                left=left,
                base_left=base_left,
                pattern=pattern,
            )
    confusion, alone = _told_apart(models, best, probability)
    return Decision(
        verdict=MISSING if alone else AMBIGUOUS,
        chosen=best,
        confusion=confusion,
        probability=probability,
        left=left,
        base_left=base_left,
    )


def least_drop(models: Models) -> float:
    """Drop of the sum of squares below which nothing is claimed."""
    if models.likelihood.heavy is None:
        return SEEN**2
    parts = [rig.part for rig in models.likelihood.rigs]
    return max(SEEN**2, FOR_EACH * sum(part.explained * int(part.counted.sum()) for part in parts))


def narrowed(models: Models, decision: Decision, beaten: Sequence[tuple[str, ...]]) -> Decision:
    """The decision without some of the models that the evidence does not tell apart, because they predict
    samples that the fit has not seen worse than the one that is shown.

    Args:
        models: all that were refitted.
        decision: the decision.
        beaten: names of the hypotheses of these models.
    """
    if decision.verdict != AMBIGUOUS or not beaten:
        return decision
    confusion = [names for names in decision.confusion if names not in beaten]
    own = _kinds(models, decision.chosen.names)
    holds = sum(
        p for names, p in decision.probability.items() if own <= _kinds(models, names) or names in beaten
    )
    alone = holds >= ALONE and len({_kinds(models, names) for names in confusion}) == 1
    return dataclasses.replace(decision, confusion=confusion, verdict=MISSING if alone else decision.verdict)


def decide_partly(models: Models, chosen: Fitted, nearest: Decision) -> Decision:
    """The verdict where a model leaves structure beyond the noise: its effects explain part of the misfit, or
    too little of it to be named.

    Args:
        models: all that were refitted.
        chosen: the model.
        nearest: what was decided before effects were added to it.
    """
    left = misfit(models.likelihood, chosen)
    pattern = pattern_in(models.likelihood, chosen)
    probability = models.probabilities_given_discrepancy(chosen)
    found = dataclasses.replace(
        nearest, chosen=chosen, left=left, probability=probability, pattern=pattern, confusion=[]
    )
    most = most_stays(left, nearest.base_left, long=models.likelihood.heavy is not None)
    if not chosen.names or 1 - probability[()] < CLAIMED or most:
        return dataclasses.replace(found, verdict=UNEXPLAINED)
    confusion, _ = _told_apart(models, chosen, probability, models.likelihood.scale_left(chosen))
    return dataclasses.replace(found, verdict=PARTLY, confusion=confusion)


def decide_combined(models: Models, chosen: Fitted, nearest: Decision) -> Decision:
    """The verdict where effects that pay on unseen samples leave nothing beyond the noise beside some that
    alone leave more than an error of their laws could: then the others do not make up for that error.

    Args:
        models: all that were refitted.
        chosen: the model with all of these effects.
        nearest: what was decided before effects were added.
    """
    alone = models.stored(nearest.chosen)
    within = max(alone.chi2 - chosen.chi2, 0.0) <= _of_inexact_laws(models, alone)
    # The variant of an effect may have changed beside the others.
    own, more = _kinds(models, alone.names), _kinds(models, chosen.names)
    fewer = len(alone.names) < len(chosen.names) and own <= more
    if within or not fewer:
        return decide(models)
    probability = models.probabilities_given_discrepancy(chosen)
    confusion, single = _told_apart(models, chosen, probability, models.likelihood.scale_left(chosen))
    return dataclasses.replace(
        nearest,
        verdict=MISSING if single else AMBIGUOUS,
        chosen=chosen,
        confusion=confusion,
        probability=probability,
        left=misfit(models.likelihood, chosen),
        pattern=None,
    )


def _of_inexact_laws(models: Models, fitted: Fitted) -> float:
    """Largest sum of squares that a model may leave because its laws are not exact."""
    defined = [name for name in fitted.names if models.of[name].kind in DEFINED]
    part = models.fits.get(tuple(sorted(defined)), models.base)
    by_definition, by_laws = models.base.chi2 - part.chi2, max(part.chi2 - fitted.chi2, 0.0)
    late = LATE & _kinds(models, fitted.names)
    more = between_samples(models.likelihood, fitted, late) if late else 0.0
    return max(INEXACT) ** 2 * (by_laws + OF_DEFINED**2 * by_definition) + more


def decide_discovered(models: Models, discovery: Discovery, nearest: Decision) -> Decision:
    """The verdict where a law of no catalogue predicts unseen samples.

    Args:
        models: all that were refitted, those with laws among them.
        discovery: the law.
        nearest: what was decided without it.
    """
    shown = discovery.fitted
    return dataclasses.replace(
        nearest,
        verdict=DISCOVERED,
        chosen=shown,
        confusion=[shown.names, *discovery.possible] if discovery.possible else [],
        probability=models.probabilities_given_discrepancy(shown),
        left=misfit(models.likelihood, shown),
        base_left=misfit(models.likelihood, models.base),
        pattern=None,
    )


def most_stays(left: tuple[float, float], base_left: tuple[float, float], *, long: bool = False) -> bool:
    """Whether a model leaves so large a share of the structure that the base model leaves that its effects
    are not what is missing; in a long recording, not a part of it.
    """
    return left[0] > (HALF_STAYS if long else STAYS_SHARE[left[0] > MUCH]) * base_left[0]


def _told_apart(
    models: Models, best: Fitted, probability: dict[tuple[str, ...], float], scale: float = 1.0
) -> tuple[list[tuple[str, ...]], bool]:
    """Models that the data do not tell apart, the best first, and whether one effect or combination stands
    out.

    Args:
        models, best: the models, and the one that is shown.
        probability: of each, the most probable first.
        scale: variance of the white residuals.
    """

    # A larger model that contains the effects of the best one supports it as well.
    own = _kinds(models, best.names)
    holds = sum(p for names, p in probability.items() if own <= _kinds(models, names))
    confusion, total = [], 0.0
    for names in [best.names, *(names for names in probability if names != best.names)]:
        f = models.fits[tuple(sorted(names))]
        if not names:
            continue
        larger = any(set(c) < set(names) for c in confusion)
        alike = len(names) <= len(best.names) and _apart(f, best) < ALIKE * np.sqrt(scale)
        counts = probability[names] > LEAST or (holds < ALONE and len(confusion) < MOST)
        if (total < TOGETHER and not larger and counts) or alike:
            confusion.append(names)
        total += probability[names]
    confusion += [
        names
        for names in probability
        if names not in confusion and _nearly(models.fits[tuple(sorted(names))], best, models.base)
    ]
    return confusion, holds >= ALONE and len({_kinds(models, names) for names in confusion}) == 1


def _kinds(models: Models, names: tuple[str, ...]) -> frozenset[str]:
    """The terms of some hypotheses: variants of a term count as one effect."""
    return frozenset(models.of[name].kind for name in names)


def _nearly(fitted: Fitted, best: Fitted, base: Fitted) -> bool:
    """Whether some of the effects of the best model explain nearly all that it does."""
    if not fitted.names or not set(fitted.names) < set(best.names):
        return False
    return base.chi2 - fitted.chi2 > NEARLY_ALL * (base.chi2 - best.chi2)


def structured(left: tuple[float, float], z: float = LEFT_Z, size: float = LEFT_SIZE) -> bool:
    """Whether the structure left is more than noise, by size and significance or by size alone."""
    return (left[1] > z and left[0] > size) or left[0] > VAST
