"""From designs that meet the targets, along their family, to designs that lose less tension.

Where more numbers are free than the targets fix, the designs that meet them are a family, and a search for
the targets ends anywhere in it. Here the limit on the loss is lowered step by step, and the search continues
from where it ended as long as any lane still arrives.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .gauss_newton import BACK_OFF, search_all
from .limits import LOSS
from .objective import Objective
from .problem import DesignProblem
from .search import ARRIVED, SearchResult, losses, result_of

HIT = 0.05  # of a tolerance, within which the targets stay: a tolerance is not spent to save tension
FIRST, LONGEST, SHORTEST = 0.1, 0.3, 0.002  # steps of the limit on the loss, of the loss
MOST_STEPS = 60  # evaluations of a lane for each limit


def with_less_loss(problem: DesignProblem, found: SearchResult) -> SearchResult:
    """The lanes of a search, followed by copies of the lanes that could be moved to less tension loss.

    There are no copies where nothing arrived, where the loss does not decide, or with physics terms, whose
    derivatives cost ten evaluations each.

    Args:
        problem: what is searched for.
        found: the search.
    """
    objective = problem.objective
    arrived = found.kept & (found.cost < ARRIVED)
    decides = not objective.wanted.goal and objective.spread == "nominal" and LOSS in objective.given
    if not decides or objective.with_terms or not np.any(arrived):
        return found
    least, moved, here = float(np.min(losses(objective, found)[arrived])), np.zeros(len(found.z), bool), found
    step, spent = FIRST, np.zeros(len(found.z), int)
    while step >= SHORTEST and least > 0.0:
        free = jnp.asarray(np.where(arrived[:, None], found.free, 0.0))  # lanes that are held stop at once
        ends = search_all(_drawn_in(objective, (1.0 - step) * least), jnp.asarray(here.z), free, MOST_STEPS)
        there = result_of(problem, ends, found.free, found.method)
        lost = losses(objective, there)
        good = arrived & (there.cost < 0.5 * HIT**2) & there.kept & (lost < least)
        spent += there.steps
        if np.any(good):
            here = _each(lambda old, new, own=good: _where(own, new, old), here, there)
            least, moved, step = float(np.min(lost[good])), moved | good, min(1.5 * step, LONGEST)
        else:
            step *= 0.5
    both = _each(
        lambda first, rest: np.concatenate([np.asarray(first), np.asarray(rest)[moved]]), found, here
    )
    steps = np.concatenate([found.steps + spent, np.zeros(int(moved.sum()), int)])
    return dataclasses.replace(both, steps=steps)


def _drawn_in(objective: Objective, loss: float) -> Objective:
    """The objective with another limit on the loss, raised by BACK_OFF because the search aims inside its
    limits.
    """
    return eqx.tree_at(lambda t: t.limits.loss, objective, jnp.asarray(loss + BACK_OFF, dtype=float))


def _where(own: np.ndarray, new: Any, old: Any) -> np.ndarray:
    return np.where(own.reshape(-1, *[1] * (np.ndim(old) - 1)), new, old)


def _each(change: Any, one: SearchResult, other: SearchResult) -> SearchResult:
    """Two searches put together, lane after lane."""
    arrays = [f.name for f in dataclasses.fields(SearchResult) if f.name not in ("method", "reachable")]
    parts = {
        name: jax.tree_util.tree_map(change, getattr(one, name), getattr(other, name)) for name in arrays
    }
    return dataclasses.replace(one, **parts)
