"""Errors due to the mesh and the few samples of a likelihood, and its correction for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from calibrate.diagnosis.hypotheses.model import Fitted, model_of
from calibrate.diagnosis.likelihood.likelihood import Likelihood
from calibrate.inference.side_by_side import in_lanes
from calibrate.inference.simulated_rig import SimulatedRig

from .models import Models


def refine(
    likelihood: Likelihood,
    models: Models,
    wanted: Mapping[tuple[str, ...], Fitted],
    fine: Sequence[SimulatedRig],
    kept: Sequence[np.ndarray] | None = None,
) -> Likelihood:
    """The likelihood with corrections for its mesh and samples, computed for some models.

    Args:
        likelihood: to correct.
        models: all models.
        wanted: models to correct for: by names of hypotheses, a fit that has their values.
        fine: all samples, on a fine mesh.
        kept: indices of the samples in the likelihood; all unless given.
    """

    def correction(item):
        names, f = item
        values = model_of(likelihood.base, models.hypotheses(names)).values(models.coordinates(names, f))
        found = []
        for k, (rough, exact) in enumerate(zip(likelihood.rigs, fine, strict=True)):
            here, there = rough(values), exact(values)
            if here is None or there is None:
                return None
            found.append((there.values if kept is None else there.values[:, kept[k]]) - here.values)
        return found

    found = zip(wanted, in_lanes(correction, list(wanted.items())), strict=True)
    return likelihood.corrected({names: more for names, more in found if more is not None})
