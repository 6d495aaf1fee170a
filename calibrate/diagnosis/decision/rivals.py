"""The models that an experiment is to tell apart."""

from __future__ import annotations

from calibrate.diagnosis.evidence.models import Models
from calibrate.diagnosis.hypotheses.model import Fitted

from .decide import Decision

# Most models, the most probable ones.
MOST = 3


def rivals_of(models: Models, decision: Decision) -> list[Fitted]:
    """Those that the data do not tell apart; where one model is named, that and the most probable other one.
    Fewer than two if there is no other.
    """
    rivals = [models.fits[tuple(sorted(names))] for names in decision.confusion[:MOST]]
    if len(rivals) > 1:
        return rivals
    others = [f for f in models.ranked() if f.names != decision.chosen.names]
    return [decision.chosen, *others[:1]]
