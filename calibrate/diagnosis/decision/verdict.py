"""The verdict of a diagnosis: the quantities that it is decided from, and the one function that decides."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

from calibrate.diagnosis.likelihood.structure import STAYS_SIZE, STAYS_Z, structured

ADEQUATE, MISSING, AMBIGUOUS, UNEXPLAINED = "adequate", "missing-physics", "ambiguous", "unexplained"
PARTLY, DISCOVERED, DIFFER = "partly-explained", "discovered", "recordings-differ"
# Nothing is claimed below this probability that something is missing.
CLAIMED = 0.97
# An effect is named alone above this probability.
ALONE = 0.8


@dataclasses.dataclass(frozen=True)
class Quantities:
    """What a verdict is decided from. The model is the one that would be named.

    Attributes:
        effects: how many the model has.
        missing: probability that something is missing.
        drop: of the sum of squares, from the base model to the model.
        least_drop: drop below which nothing is claimed.
        left, base_left: structure that the model and the base model leave: size in standard deviations of the
            noise, not their squares, and significance. The size of the base model's may be 0.
        may_stay: share of the size that the base model leaves which the model may leave (`STAYS_SHARE`, in
            long recordings `HALF_STAYS`).
        holds: probability of all models that have its effects.
        rivals: number of sets of effects that the data do not tell apart, its own among them.
        regular: whether the residual of what would be shown has a regularity that noise does not have.
        pays: whether effects are among its own that were added because they predict unseen samples; the
            probabilities then count what it leaves as an error of unknown cause.
        law: whether it has a law of no catalogue, which predicts unseen samples.
        differ: whether a number differs between the recordings.
        outside: whether stretches are left out in which something outside any model acts.
    """

    effects: int
    missing: float
    drop: float
    least_drop: float
    left: tuple[float, float]
    base_left: tuple[float, float]
    may_stay: float
    holds: float
    rivals: int
    regular: bool = False
    pays: bool = False
    law: bool = False
    differ: bool = False
    outside: bool = False


class Verdict(NamedTuple):
    """A verdict by its name, why it is given, and whether the base model is shown for it."""

    name: str
    reason: str
    shows_base: bool = False


def verdict(q: Quantities) -> Verdict:
    """The verdict on a model; every verdict of a diagnosis comes from here."""
    sure = q.effects > 0 and q.missing >= CLAIMED
    most_stays = q.left[0] > q.may_stay * q.base_left[0]
    if q.law:
        found = Verdict(DISCOVERED, "a law of no catalogue predicts unseen samples")
    elif q.pays and structured(q.left):
        if not sure:
            found = Verdict(UNEXPLAINED, "structure is left, beside which no effect is sure")
        elif most_stays:
            found = Verdict(UNEXPLAINED, "most of the structure is left")
        else:
            found = Verdict(PARTLY, "effects explain a part of the structure")
    elif not q.pays and (not sure or q.drop < q.least_drop):
        if q.regular:
            found = Verdict(UNEXPLAINED, "no effect is sure, and the residual has a regularity", True)
        elif structured(q.base_left):
            found = Verdict(UNEXPLAINED, "no effect is sure, and structure is left", True)
        else:
            found = Verdict(ADEQUATE, "no effect is sure, and only noise is left", True)
    elif not q.pays and most_stays and q.regular:
        found = Verdict(UNEXPLAINED, "much of the structure is left, with a regularity")
    elif not q.pays and most_stays and structured(q.left, STAYS_Z, STAYS_SIZE):
        found = Verdict(UNEXPLAINED, "much of the structure is left")
    elif q.holds >= ALONE and q.rivals == 1:
        found = Verdict(MISSING, "one set of effects stands out")
    else:
        found = Verdict(AMBIGUOUS, "the data do not tell several sets of effects apart")
    if q.differ and found.name == ADEQUATE:
        found = found._replace(name=DIFFER, reason="a number differs between the recordings")
    if q.outside and found.name in (MISSING, AMBIGUOUS):
        found = found._replace(name=PARTLY, reason="what acts from outside is missing as well")
    if q.outside and found.name in (ADEQUATE, DIFFER):
        found = found._replace(name=UNEXPLAINED, reason="something outside the model acts")
    return found
