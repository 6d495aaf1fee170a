"""Cases that hide two or three effects at once, of the catalogue and drawn as those of the main set are."""

from __future__ import annotations

import numpy as np

from .cases import make, several

__all__ = ["kinds", "make"]

PAIRS = 0.75  # share of them; the others are triples


def kinds(rng: np.random.Generator, count: int) -> list[tuple[str, tuple[str, ...]]]:
    """What the cases hide: pairs, then triples."""
    pairs = round(PAIRS * count)
    sizes = [("pair", 2)] * pairs + [("triple", 3)] * (count - pairs)
    return [(kind, several(rng, n)) for kind, n in sizes]
