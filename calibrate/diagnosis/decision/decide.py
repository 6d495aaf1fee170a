"""The quantities that a verdict is decided from, gathered from the models, and the model that is shown."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from calibrate.diagnosis.evidence.models import HOW_MANY, INEXACT, Models
from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.locate import between_samples, misfit
from calibrate.diagnosis.likelihood.structure import may_stay, structured
from calibrate.diagnosis.outside.patterns import Pattern, pattern_in
from calibrate.diagnosis.screening.screen import SEEN, Screened
from gtr_jax.terms import REGISTRY

from .verdict import ALONE, AMBIGUOUS, MISSING, UNEXPLAINED, Quantities, Verdict, verdict

if TYPE_CHECKING:
    from calibrate.diagnosis.laws.discovery import Discovery

UNSEEN = "an effect too small to see"
# A set that the data do not tell apart holds the models that together reach the first probability, each of
# them above the second.
TOGETHER, LEAST = 0.98, 0.03
# Most models in a set if less probable ones are taken in because the best cannot be named alone.
MOST = 5
# Models whose predictions differ by less than this many standard errors count as one for these data.
ALIKE = 2.5
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


@dataclasses.dataclass(frozen=True)
class Decision:
    """A verdict, and the model that is shown.

    Attributes:
        quantities: what the verdict is decided from.
        chosen: the model that is shown; the base model where nothing is named.
        confusion: models that the data do not tell apart, the most probable first; by names of hypotheses.
        probability: of each model, the most probable first; `with_unseen` adds that of an effect too small to
            see.
        pattern: a regularity in the chosen model's residual that noise does not have; None if there is none.
    """

    quantities: Quantities
    chosen: Fitted
    confusion: list[tuple[str, ...]]
    probability: dict[tuple[str, ...], float]
    pattern: Pattern | None = None

    @property
    def told(self) -> Verdict:
        """The verdict and its reason."""
        return verdict(self.quantities)

    @property
    def verdict(self) -> str:
        """The verdict by its name."""
        return self.told.name

    @property
    def left(self) -> tuple[float, float]:
        """Structure that the model shown leaves: size in standard deviations of the noise, significance."""
        return self.base_left if self.told.shows_base else self.quantities.left

    @property
    def base_left(self) -> tuple[float, float]:
        """The same for the base model."""
        return self.quantities.base_left


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


def _gathered(
    models: Models,
    fitted: Fitted,
    probability: dict[tuple[str, ...], float],
    confusion: list[tuple[str, ...]],
    holds: float,
) -> Quantities:
    """The quantities of a model.

    Args:
        models: all that were refitted.
        fitted: the model.
        probability: of each.
        confusion: models that the data do not tell apart.
        holds: probability of all models that have the effects of the model.
    """
    left = misfit(models.likelihood, fitted)
    return Quantities(
        effects=len(fitted.names),
        missing=1 - probability[()],
        drop=models.base.cost - fitted.cost,
        least_drop=least_drop(models),
        left=left,
        base_left=misfit(models.likelihood, models.base),
        may_stay=may_stay(left),
        holds=holds,
        rivals=len({_kinds(models, names) for names in confusion}),
    )


def decide(models: Models) -> Decision:
    """The decision by the evidence of the models."""
    probability = models.probabilities()
    best = models.fits[tuple(sorted(next(iter(probability))))]
    confusion, holds = _told_apart(models, best, probability)
    quantities = _gathered(models, best, probability, confusion, holds)
    chosen = models.base if verdict(quantities).shows_base else best
    # A regularity takes time to find: it is looked for where it would leave the recording unexplained.
    looked_for = verdict(dataclasses.replace(quantities, regular=True)).name == UNEXPLAINED
    pattern = pattern_in(models.likelihood, chosen) if looked_for else None
    quantities = dataclasses.replace(quantities, regular=pattern is not None)
    named = verdict(quantities).name in (MISSING, AMBIGUOUS)
    return Decision(quantities, chosen, confusion if named else [], probability, pattern)


def least_drop(models: Models) -> float:
    """Drop of the sum of squares below which nothing is claimed: that of `SEEN` standard errors, because
    errors of the mesh and of the first-order dimensions may be as large; more in long recordings.
    """
    parts = [rig.part for rig in models.likelihood.rigs]
    return max(SEEN**2, models.likelihood.rules.least_drop(parts))


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
    rivals = len({_kinds(models, names) for names in confusion})
    quantities = dataclasses.replace(decision.quantities, holds=holds, rivals=rivals)
    return dataclasses.replace(decision, quantities=quantities, confusion=confusion)


def decide_extended(models: Models, chosen: Fitted, nearest: Decision) -> Decision:
    """The decision on a model to which effects were added that pay on unseen samples, because structure was
    left.

    Where the model leaves structure too, its effects explain part of the misfit, or too little of it to be
    named. Where it leaves none, all its effects are named if those found by the evidence alone leave more
    than an error of their laws could; else the others may only make up for that error, and the evidence
    decides.

    Args:
        models: all that were refitted.
        chosen: the model.
        nearest: what was decided before effects were added to it.
    """
    left = misfit(models.likelihood, chosen)
    if not structured(left) and not _adds_to_inexact_laws(models, chosen, nearest):
        return decide(models)
    probability = models.probabilities_given_discrepancy(chosen)
    confusion, holds = _told_apart(models, chosen, probability, models.likelihood.scale_left(chosen))
    pattern = pattern_in(models.likelihood, chosen) if structured(left) else None
    quantities = dataclasses.replace(
        _gathered(models, chosen, probability, confusion, holds),
        base_left=nearest.base_left,
        regular=pattern is not None,
        may_stay=models.likelihood.rules.may_stay(left),
        pays=True,
    )
    if verdict(quantities).name == UNEXPLAINED:
        confusion = []
    return Decision(quantities, chosen, confusion, probability, pattern)


def _adds_to_inexact_laws(models: Models, chosen: Fitted, nearest: Decision) -> bool:
    """Whether a model adds effects to those found by the evidence alone that leave more than an error of
    their laws could.
    """
    alone = models.stored(nearest.chosen)
    within = max(alone.chi2 - chosen.chi2, 0.0) <= _of_inexact_laws(models, alone)
    # The variant of an effect may have changed beside the others.
    own, more = _kinds(models, alone.names), _kinds(models, chosen.names)
    return not within and len(alone.names) < len(chosen.names) and own <= more


def _of_inexact_laws(models: Models, fitted: Fitted) -> float:
    """Largest sum of squares that a model may leave because its laws are not exact."""
    defined = [name for name in fitted.names if models.of[name].kind in DEFINED]
    part = models.fits.get(tuple(sorted(defined)), models.base)
    by_definition, by_laws = models.base.chi2 - part.chi2, max(part.chi2 - fitted.chi2, 0.0)
    late = LATE & _kinds(models, fitted.names)
    more = between_samples(models.likelihood, fitted, late) if late else 0.0
    return max(INEXACT) ** 2 * (by_laws + OF_DEFINED**2 * by_definition) + more


def decide_discovered(models: Models, discovery: Discovery) -> Decision:
    """The decision where a law of no catalogue predicts unseen samples.

    Args:
        models: all that were refitted, those with laws among them.
        discovery: the law.
    """
    shown = discovery.fitted
    probability = models.probabilities_given_discrepancy(shown)
    confusion = [shown.names, *discovery.possible] if discovery.possible else []
    quantities = _gathered(models, shown, probability, confusion, probability[shown.names])
    return Decision(dataclasses.replace(quantities, law=True), shown, confusion, probability)


def _told_apart(
    models: Models, best: Fitted, probability: dict[tuple[str, ...], float], scale: float = 1.0
) -> tuple[list[tuple[str, ...]], float]:
    """Models that the data do not tell apart, the best first, and the probability of all that have the
    effects of the best one.

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
    return confusion, holds


def _kinds(models: Models, names: tuple[str, ...]) -> frozenset[str]:
    """The terms of some hypotheses: variants of a term count as one effect."""
    return frozenset(models.of[name].kind for name in names)


def _nearly(fitted: Fitted, best: Fitted, base: Fitted) -> bool:
    """Whether some of the effects of the best model explain nearly all that it does."""
    if not fitted.names or not set(fitted.names) < set(best.names):
        return False
    return base.chi2 - fitted.chi2 > NEARLY_ALL * (base.chi2 - best.chi2)
