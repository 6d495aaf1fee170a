"""How many problems at once are timed in JAX: the same arrangements for every solver written in it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import measure
from .problem import TENSION

ENOUGH_S = 8.0  # for one pass over all lanes, as the single solve predicts it


def tensions(count: int, seed: int = 0) -> jnp.ndarray:
    """Base tensions of the lanes [N], (count,): the problem's within a factor of two."""
    return jnp.asarray(TENSION * np.random.default_rng(seed).uniform(0.5, 1.5, count))


def batch(solve: Callable, single_s: float, count: int, *, threads: bool = True) -> dict[str, Any] | None:
    """Seconds per lane of `solve(tension) -> (tip, converged, ...)` over many tensions.

    Args:
        solve: one lane.
        single_s: what a single solve takes.
        count: lanes; fewer where they would take too long.
        threads: also try half of the lanes in each of two threads. Not for a batched dense solve: two of them
            at once wait for each other for ever in jaxlib 0.10 on two cores.

    Returns None where that leaves under a hundred.
    """
    count = min(count, int(ENOUGH_S / single_s))
    if count < 100:
        return None
    lanes = tensions(count)
    halves = (lanes[: count // 2], lanes[count // 2 :])
    whole = jax.jit(jax.vmap(solve))
    chunked = jax.jit(lambda T: jax.lax.map(solve, T, batch_size=min(250, count)))
    found = {
        "vmap": measure.timed(whole, lanes, jit=False),
        "lax.map over 250": measure.timed(chunked, lanes, jit=False),
    }
    if threads:
        with ThreadPoolExecutor(2) as pool:

            def both(fn):
                return lambda: list(pool.map(lambda half: jax.block_until_ready(fn(half)), halves))

            found["vmap in two threads"] = measure.timed(both(whole), jit=False)
            found["lax.map over 250 in two threads"] = measure.timed(both(chunked), jit=False)
    best = min(found, key=lambda name: found[name].warm)
    return {
        "count": count,
        "arrangement": best,
        "lane_s": found[best].warm / count,
        "lane_s_by_arrangement": {name: t.warm / count for name, t in found.items()},
        "converged_share": float(jnp.mean(found["vmap"].value[1])),
    }
