"""Draws from a posterior, and whether the chains that drew them agree."""

from __future__ import annotations

import dataclasses

import numpy as np

# Chains that agree have a potential scale reduction below this.
AGREED = 1.01


@dataclasses.dataclass(frozen=True, eq=False)
class Posterior:
    """Draws of the p free numbers, SI, from several chains, n each.

    Attributes:
        names: of the free numbers.
        draws: (chains, n, p).
        lower95, upper95: 2.5 and 97.5 % quantiles, (p,).
        sd: standard deviations, (p,).
        effective: effective sample sizes, (p,).
        rhat: split potential scale reductions, (p,).
        divergences: divergent transitions of the sampler.
    """

    names: tuple[str, ...]
    draws: np.ndarray
    lower95: np.ndarray
    upper95: np.ndarray
    sd: np.ndarray
    effective: np.ndarray
    rhat: np.ndarray
    divergences: int

    @property
    def converged(self) -> bool:
        """Whether the chains agree and none diverged."""
        return self.divergences == 0 and bool(np.all(self.rhat < AGREED))
