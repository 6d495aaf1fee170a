"""Where the searches start: the best of many designs spread over the space, apart from one another."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from .gauss_newton import judge_all
from .objective import Objective
from .space import N_SINE, Space, wave_ends

SCREENED = 256  # designs judged for each number of half waves
APART = 0.12  # of the space, between starts
PENALTY = 1e4  # on the squares of broken limits


def starts(objective: Objective, space: Space, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates to start from, and which of them may change.

    A scrambled Sobol sequence is judged at once; the best that lie apart are taken, `count` for each number
    of half waves. The present robot is among those judged.

    Args:
        objective, space: the problem.
        count: starts for each number of half waves.
        seed: of the sequence.

    Returns:
        z (L, c) in [0, 1], and 1 for each coordinate that may change, else 0, (L, c).
    """
    from scipy.stats import qmc

    names = [v.name for v in space.all]
    draws = qmc.Sobol(len(names), rng=np.random.default_rng(seed)).random(SCREENED)
    draws[0] = _present(space)
    put_in_order(draws, space)
    free = np.ones(len(names))
    if not space.choices:
        return _best(objective, draws, count), np.tile(free, (min(count, len(draws)), 1))
    at = names.index(N_SINE)
    free[at] = 0.0
    chosen = []
    v = space.all[at]
    for choice in space.choices:
        here = draws.copy()
        here[:, at] = (choice - v.lower) / (v.upper - v.lower)
        chosen.append(_best(objective, here, count))
    z = np.concatenate(chosen)
    return z, np.tile(free, (len(z), 1))


def len_of_starts(space: Space, count: int) -> int:
    """How many starts `starts` returns for a count."""
    return min(count, SCREENED) * max(len(space.choices), 1)


def _present(space: Space) -> np.ndarray:
    values = np.array([v.start for v in space.all])
    return np.clip((values - space.lower) / (space.upper - space.lower), 0.0, 1.0)


def put_in_order(draws: np.ndarray, space: Space) -> None:
    """Sort w1 and w2 in place, so that a wave begins before it ends."""
    names = [v.name for v in space.all]
    for ends in wave_ends(names):
        if not set(ends) <= set(names):
            continue
        i, j = map(names.index, ends)
        lower, size = space.lower[[i, j]], (space.upper - space.lower)[[i, j]]
        w = np.sort(lower + draws[:, [i, j]] * size, axis=1)
        draws[:, [i, j]] = np.clip((w - lower) / size, 0.0, 1.0)


def merit(e) -> np.ndarray:
    """How bad designs are, (L,): half the sum of squares and the goal, with a penalty on broken limits."""
    short = jnp.maximum(0.0, -e.margins)
    value = 0.5 * jnp.sum(e.residuals**2, axis=1) + e.goal + PENALTY * jnp.sum(short**2, axis=1)
    return np.asarray(jnp.where(e.converged & jnp.isfinite(value), value, jnp.inf))


def _best(objective: Objective, draws: np.ndarray, count: int) -> np.ndarray:
    order = np.argsort(merit(judge_all(objective, jnp.asarray(draws))), kind="stable")
    ranked = draws[order]
    chosen: list[np.ndarray] = []
    for near in (APART, 0.0):  # first those apart, then whatever is left
        for z in ranked:
            if len(chosen) == min(count, len(draws)):
                break
            gaps = [np.max(np.abs(z - other)) for other in chosen]
            if not gaps or min(gaps) > near:
                chosen.append(z)
    while len(chosen) < min(count, len(draws)):
        chosen.append(ranked[len(chosen)])
    return np.stack(chosen)
