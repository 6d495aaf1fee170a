"""From the probabilities of the models to a verdict that can be defended."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import stats

from .bench import Fitted
from .locate import Waves, misfit, waves
from .search import HOW_MANY, Models, Screened

UNSEEN = "an effect too small to see"
ADEQUATE, MISSING, AMBIGUOUS, UNEXPLAINED = "adequate", "missing-physics", "ambiguous", "unexplained"
# An effect is named alone above this probability; a set holds the models that together reach the second, of
# those above the third.
ALONE, TOGETHER, LEAST = 0.8, 0.95, 0.03
# Models whose predictions differ by less than this many standard errors are one to these data.
ALIKE = 2.5
# Structure left: significance, size in standard deviations of the noise, and share of the base model's.
LEFT_Z, LEFT_SIZE, LEFT_SHARE = 6.0, 0.35, 0.42
# Size beyond which it is no noise even where neighbours do not go together, as in ringing.
MUCH = 1.35
# Below this probability of anything missing nothing is claimed.
CLAIMED = 0.9


@dataclasses.dataclass(frozen=True)
class Decision:
    """A verdict.

    Attributes:
        verdict: "adequate", "missing-physics", "ambiguous" or "unexplained".
        chosen: the model that is shown; the base model where nothing is named.
        confusion: models that the data do not tell apart, the most probable first; by names of hypotheses.
        probability: of each model, the most probable first; `with_unseen` adds that of an effect too small to
            see.
        left: structure the chosen model leaves: size in standard deviations of the noise, and significance.
        base_left: the same of the base model.
        waves: how the residual swings, where the base model is shown; None unless it does.
    """

    verdict: str
    chosen: Fitted
    confusion: list[tuple[str, ...]]
    probability: dict[tuple[str, ...], float]
    left: tuple[float, float]
    base_left: tuple[float, float]
    waves: Waves | None = None


def with_unseen(decision: Decision, models: Models, screened: Sequence[Screened]) -> Decision:
    """The same with the probability that an effect is there which is too small for these recordings to show:
    where nothing is seen that is not nothing. It takes its share from that of nothing missing and the others.
    """
    n, share = len(models.of), 0.0
    for s in screened:
        first = s.hypothesis.numbers[0]
        # Of what was refitted the probability has its small sizes in it; contact and saturation have no size.
        if first.size and np.isfinite(s.smallest) and (s.hypothesis.name,) not in models.fits:
            share += float(2 * stats.norm.cdf(abs(first.at(first.centre + s.smallest))) - 1)
    unseen = decision.probability[()] * HOW_MANY[1] / HOW_MANY[0] * share / n
    scaled = {names: p / (1 + unseen) for names, p in decision.probability.items()}
    return dataclasses.replace(decision, probability=scaled | {(UNSEEN,): unseen / (1 + unseen)})


def _apart(a: Fitted, b: Fitted) -> float:
    """By how many standard errors two models' predictions differ."""
    return float(np.linalg.norm(a.rows - b.rows))


def decide(models: Models) -> Decision:
    """The verdict."""
    probability = models.probabilities()
    ranked: Sequence[Fitted] = models.ranked()
    best, base = ranked[0], models.base
    base_left, left = misfit(models.bench, base), misfit(models.bench, best)
    nothing = probability[()]
    if not best.names or 1 - nothing < CLAIMED:
        swings = None if structured(base_left) else waves(models.bench, base)
        verdict = UNEXPLAINED if structured(base_left) or swings else ADEQUATE
        return Decision(verdict, base, [], probability, base_left, base_left, swings)
    if structured(left) and left[0] > LEFT_SHARE * base_left[0]:
        return Decision(UNEXPLAINED, best, [], probability, left, base_left)
    confusion, total = [], 0.0
    for f in ranked:
        if not f.names:
            continue
        larger = any(set(c) < set(f.names) for c in confusion)
        alike = len(f.names) <= len(best.names) and _apart(f, best) < ALIKE
        if (total < TOGETHER and not larger and probability[f.names] > LEAST) or alike:
            confusion.append(f.names)
        total += probability[f.names]
    # A model with more effects that holds the best speaks for the best as well.
    holds = sum(p for names, p in probability.items() if set(best.names) <= set(names))
    alone = holds >= ALONE and len(confusion) == 1
    return Decision(MISSING if alone else AMBIGUOUS, best, confusion, probability, left, base_left)


def structured(left: tuple[float, float]) -> bool:
    """Whether what is left, by size and significance, or by size alone, is more than noise."""
    return (left[1] > LEFT_Z and left[0] > LEFT_SIZE) or left[0] > MUCH
