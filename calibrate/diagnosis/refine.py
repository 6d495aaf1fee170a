"""What the mesh and the samples of a bench leave out, and how the bench is corrected for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..parallel import in_parallel
from .bench import Bench
from .model import Fitted, model_of
from .models import Models
from .rig import Rig


def refine(
    bench: Bench,
    models: Models,
    wanted: Mapping[tuple[str, ...], Fitted],
    fine: Sequence[Rig],
    kept: Sequence[np.ndarray] | None = None,
) -> Bench:
    """The bench corrected for what its mesh and samples leave out of some models.

    Args:
        bench: to correct.
        models: of which they are.
        wanted: by names of hypotheses, a fit that has the values of these.
        fine: all samples, on a fine mesh.
        kept: those of them on the bench; all unless given.
    """

    def correction(item):
        names, f = item
        values = model_of(bench.base, models.hypotheses(names)).values(models.coordinates(names, f))
        found = []
        for k, (rough, exact) in enumerate(zip(bench.rigs, fine, strict=True)):
            here, there = rough(values), exact(values)
            if here is None or there is None:
                return None
            found.append((there.values if kept is None else there.values[:, kept[k]]) - here.values)
        return found

    found = zip(wanted, in_parallel(correction, list(wanted.items())), strict=True)
    return bench.corrected({names: more for names, more in found if more is not None})
