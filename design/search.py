"""The search from many starts, by whichever of the two optimisers suits what is asked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .gauss_newton import Found, judge_all, search_all
from .lagrangian import minimise_all
from .objective import Evaluation, Objective, shares_of, tensions_of
from .problem import DesignProblem
from .starts import starts

# Evaluations of a lane: at first, and where more are needed.
FEW_STEPS, MANY_STEPS = 25, 250
WITHIN = 0.5  # of a tolerance that a search must reach, so that a finer mesh still meets it
ARRIVED = 0.5 * WITHIN**2  # half the sum of squares below which a search has arrived
LEAST_MARGIN = -1e-6  # least margin with which a limit counts as kept
LANES = 4  # with which a second search continues
NEARBY = 20.0  # tolerances (root of the sum of squares) within which a start that ran out of steps goes on
REWEIGHTED = 30  # reweightings, at most, towards the least worst case
EVEN = 1e-3  # they end once the weighted error is within this share of the largest


@dataclasses.dataclass(frozen=True, eq=False)
class SearchResult:
    """All lanes of a search: coordinates (L, c), merit (L,), how they are judged, multipliers (L, K),
    gradient (L, c), whether they settled (L,), evaluations (L,); the method that found them. reachable: for a
    robust design, whether the targets can be met without uncertainty; the design itself meets none exactly.
    """

    z: np.ndarray
    free: np.ndarray
    cost: np.ndarray
    kept: np.ndarray
    settled: np.ndarray
    steps: np.ndarray
    margins: np.ndarray
    multipliers: np.ndarray
    gradient: np.ndarray
    judged: Evaluation
    method: str
    reachable: bool = True

    @property
    def order(self) -> np.ndarray:
        """By which lanes are ranked: those that break a limit behind all that keep them, (L,)."""
        short = np.minimum(np.min(self.margins, axis=1, initial=1.0), 0.0)
        return np.where(self.kept, self.cost, 1e12 * (1.0 - short))


def find(problem: DesignProblem, progress: Callable[[str], None] = lambda stage: None) -> SearchResult:
    """Search from all starts.

    Targets are a least squares problem: Gauss-Newton from every start, a few steps, more where none has
    arrived, and once more with residuals of a smaller scale where nothing ever will. Robust designs start
    from those that meet the targets without uncertainty. Goals continue from there by L-BFGS-B.
    """
    objective, target = problem.objective, problem.target
    goal = bool(objective.wanted.goal)
    first = objective if goal else without_goal(objective)
    z, free = starts(first, problem.space, target.search.starts, target.search.seed)
    z, free = jnp.asarray(z), jnp.asarray(free)
    progress("searching")
    if target.search.method == "l-bfgs-b" and not goal and objective.spread == "nominal":
        return result_of(problem, minimise_all(objective, z, free), np.asarray(free), "l-bfgs-b")
    met = None
    if not goal or objective.wanted.pose_state or objective.wanted.point_state:
        met = _meet(nominal(without_goal(objective)), z, free)
        if not goal and objective.spread == "nominal":
            return result_of(problem, met, np.asarray(free), "gauss-newton")
        z = met.z
    if not goal:
        assert met is not None
        progress("allowing for what is not known")
        found = _meet(without_goal(objective), z, free)
        if objective.spread == "worst":
            found, free = _least_worst(without_goal(objective), found, free)
        lanes = result_of(problem, found, np.asarray(free), "gauss-newton")
        return dataclasses.replace(lanes, reachable=_any_reached(met))
    found = search_all(objective, z, free, MANY_STEPS)
    progress("searching by L-BFGS-B")
    order = np.argsort(result_of(problem, found, np.asarray(free), "").order, kind="stable")[:LANES]
    z, free = jnp.asarray(found.z), jnp.asarray(free)
    # Gauss-Newton's multipliers are of half the square of the distance from utopia.
    away = jnp.sqrt(2.0 * found.cost[order])
    multipliers = found.multipliers[order] / jnp.where(away > 0, away, 1.0)[:, None]
    polished = minimise_all(objective, z[order], free[order], multipliers)
    joined = Found(*(jnp.concatenate([a, b]) for a, b in zip(polished, found, strict=True)))
    free = jnp.concatenate([free[order], free])
    return result_of(problem, joined, np.asarray(free), "gauss-newton, l-bfgs-b")


def _least_worst(objective: Objective, found: Found, free) -> tuple[Found, Array]:
    """The least largest error over the draws, from the best of the lanes that make the mean of its square
    least.

    Lawson's algorithm (1961): a draw's weight is multiplied by its own error, again and again, until only
    those that are off the most have any.
    """
    order = np.argsort(np.where(np.isfinite(found.cost), found.cost, np.inf), kind="stable")[:LANES]
    objective = _in_units_of(objective, _size_of(found))
    ends = []
    for lane in order:
        here = Found(*(part[lane : lane + 1] for part in found))
        own, shares, least, best = free[lane : lane + 1], objective.shares, np.inf, here
        for _ in range(REWEIGHTED):
            sizes = _size_by_draw(objective, here.z)
            if float(jnp.max(sizes)) < least and float(jnp.min(here.rows, initial=1.0)) >= LEAST_MARGIN:
                least, best = float(jnp.max(sizes)), here
            if float(jnp.sum(shares * sizes**2)) > ((1 - EVEN) * float(jnp.max(sizes))) ** 2:
                break
            shares = shares * sizes / jnp.sum(shares * sizes)
            weighted = dataclasses.replace(objective, shares=shares)
            here = search_all(weighted, here.z, own, MANY_STEPS)
        ends.append(best)
    return Found(*(jnp.concatenate(parts) for parts in zip(*ends, strict=True))), free[order]


def _size_by_draw(objective: Objective, z) -> Array:
    """Root of the sum of squares of the residuals at each draw, of one design, (D,)."""
    residuals = judge_all(objective, z).residuals.reshape(objective.shares.shape[0], -1)
    return jnp.sqrt(jnp.sum(residuals**2, axis=1) / objective.shares)


def _meet(objective: Objective, z, free) -> Found:
    """Gauss-Newton on the targets from every start: a few steps; where some have arrived, the rest of the way
    for those that are near; more steps for all where none has; and once more at a smaller scale where nothing
    ever will.
    """
    found = search_all(objective, z, free, FEW_STEPS)
    if _any_reached(found):
        return _finished(objective, found, free)
    found = search_all(objective, found.z, free, MANY_STEPS)
    if not _any_reached(found):
        found = _nearest(objective, found, free)
    return found


def _finished(objective: Objective, found: Found, free) -> Found:
    """Continue the starts that ran out of steps near the targets, so that finished designs are compared and
    listed, not points on the way to one.
    """
    near = ~found.settled & (found.cost < 0.5 * NEARBY**2)
    if not bool(jnp.any(near)):
        return found
    again = search_all(
        objective, found.z, jnp.where(near[:, None], free, 0.0), MANY_STEPS
    )  # those held stop at once
    again = again._replace(steps=found.steps + again.steps)

    def chosen(new, old):
        return jnp.where(near.reshape(-1, *[1] * (old.ndim - 1)), new, old)

    return Found(*(chosen(new, old) for new, old in zip(again, found, strict=True)))


def without_goal(objective: Objective) -> Objective:
    """The objective of meeting the targets alone, as a sum of squares."""
    spread = "expected" if objective.spread == "worst" else objective.spread
    wanted = dataclasses.replace(objective.wanted, goal="") if objective.wanted.goal else objective.wanted
    return dataclasses.replace(objective, wanted=wanted, spread=spread)


def nominal(objective: Objective) -> Objective:
    """The same with friction coefficient and modulus as in the file."""
    return dataclasses.replace(objective, spread="nominal", draws=jnp.zeros((1, 2)), shares=jnp.ones(1))


def _any_reached(found: Found) -> bool:
    kept = jnp.min(found.rows, axis=1, initial=1.0) >= 0.0
    return bool(jnp.any((found.cost < ARRIVED) & kept))


def _nearest(objective: Objective, found: Found, free) -> Found:
    """The same search with residuals divided by their size: otherwise, where a target is far out of reach,
    the limits would weigh too little against it.
    """
    size = _size_of(found)
    again = search_all(_in_units_of(objective, size), found.z, free, MANY_STEPS)
    return again._replace(cost=again.cost * size**2, multipliers=again.multipliers * size)


def _size_of(found: Found) -> float:
    """Root of the sum of squares of the best lane's residuals, 1 or more."""
    cost = float(np.min(np.where(np.isfinite(found.cost), found.cost, np.inf)))
    return max(1.0, np.sqrt(2.0 * cost)) if np.isfinite(cost) else 1.0


def _in_units_of(objective: Objective, size: float) -> Objective:
    """The same with residuals divided by their size."""
    return eqx.tree_at(
        lambda t: (t.wanted.pose_scale, t.wanted.point_scale),
        objective,
        (objective.wanted.pose_scale / size, objective.wanted.point_scale / size),
    )


def result_of(problem: DesignProblem, found: Found, free: np.ndarray, method: str) -> SearchResult:
    """Judge the ends of searches; `free`, (L, c), marks the coordinates that each lane may change."""
    judged = judge_all(problem.objective, found.z)
    margins = np.asarray(judged.margins)
    kept = np.min(margins, axis=1, initial=1.0) >= LEAST_MARGIN
    cost = 0.5 * np.sum(np.asarray(judged.residuals) ** 2, axis=1)
    cost = np.where(np.asarray(judged.converged) & np.isfinite(cost), cost, np.inf)
    return SearchResult(
        z=np.asarray(found.z),
        free=free,
        cost=cost,
        kept=kept,
        settled=np.asarray(found.settled),
        steps=np.asarray(found.steps),
        margins=margins,
        multipliers=np.asarray(found.multipliers),
        gradient=np.asarray(found.gradient),
        judged=judged,
        method=method,
    )


def ranking(problem: DesignProblem, found: SearchResult) -> np.ndarray:
    """Lanes in the order in which they are looked at: limits kept first; then those that reach the targets,
    the one that loses the least tension first; then the nearest. Of a goal, the best first.
    """
    reach = found.cost < ARRIVED
    if problem.objective.wanted.goal or problem.objective.spread != "nominal":
        return np.lexsort((found.cost, ~found.kept))
    second = np.where(reach, losses(problem.objective, found), found.cost)
    short = np.minimum(np.min(found.margins, axis=1, initial=1.0), 0.0)
    return np.lexsort((second, ~reach, np.where(found.kept, 0.0, -short)))


def losses(objective: Objective, found: SearchResult) -> np.ndarray:
    """Largest share of its own base tension that any tendon of each lane loses while pulling, (L,)."""
    pulled = [i for i, (_, released) in enumerate(objective.states) if not released]
    if not pulled:
        return np.zeros(len(found.z))
    tensions = np.asarray(jax.vmap(lambda z: tensions_of(objective, z))(jnp.asarray(found.z)))
    T_base = tensions[:, [objective.states[i][0] for i in pulled]]
    arrives = shares_of(jnp.asarray(found.judged.T_tip)[:, jnp.asarray(pulled)], jnp.asarray(T_base))
    return np.max(1.0 - np.asarray(arrives).reshape(len(found.z), -1), axis=1)
