"""Which limits and bounds bind a design, and what would happen without them."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax.errors import InputError

from . import limits as L
from .gauss_newton import search_all
from .limits import all_stations, channel_margins
from .objective import Objective, robot_of, solve_states, state_margins, tensions_of
from .option import look_at
from .problem import DesignProblem
from .result import Binding, Relaxed
from .search import LEAST_MARGIN, MANY_STEPS, SearchResult, nominal, without_goal

NEAR = 2e-3  # margin, in its scale, under which a limit counts as binding


def binding_of(problem: DesignProblem, found: SearchResult, best: int) -> tuple[Binding, ...]:
    """Limits and bounds that bind the best lane of the search, the strongest first."""
    space = problem.space
    if not np.isfinite(found.cost[best]):
        return ()
    sizes = rows_of_limits(problem)
    out, at = [], 0
    for name in sizes:
        rows = slice(at, at + sizes[name])
        at += sizes[name]
        force = float(np.sum(np.abs(found.multipliers[best, rows])))
        near = float(np.min(found.margins[best, rows], initial=1.0))
        if near < NEAR and (force > 0 or near < 0):
            out.append(Binding(name, "limit", force))
    z, gradient = found.z[best], found.gradient[best]
    for i, v in enumerate(space.all):
        for end, pushed in ((0.0, gradient[i] > 0), (1.0, gradient[i] < 0)):
            if found.free[best, i] and abs(z[i] - end) < 1e-6 and pushed:
                bound = v.lower if end == 0.0 else v.upper
                out.append(
                    Binding(
                        v.name, "least" if end == 0 else "largest", abs(float(gradient[i])), bound, v.unit
                    )
                )
    return tuple(sorted(out, key=lambda b: -b.force))


def rows_of_limits(problem: DesignProblem) -> dict[str, int]:
    """Rows of the margins by limit, in their order."""
    objective = problem.objective

    def margins(z):
        robot = robot_of(objective, z)
        found = channel_margins(
            robot, all_stations(robot, objective.stations), objective.limits, objective.given
        )
        states = solve_states(objective, robot, tensions_of(objective, z))
        return found | state_margins(objective, robot, states)

    shapes = jax.eval_shape(margins, jnp.zeros(objective.lower.shape))
    return {name: shapes[name].shape[0] for name in objective.given if name in shapes}


def _without(problem: DesignProblem, objective: Objective, name: str) -> Objective | None:
    """The objective with a limit put aside. Of a wall only what was asked for is dropped, because the channel
    must stay in the body and out of its bores and of other channels; None if no wall was asked for.
    """
    own = problem.target.limits
    walls = {L.WALL: ("wall", 0.5), L.BORE: ("bore", 0.5), L.APART: ("apart", 1.0)}
    if name not in walls:
        return dataclasses.replace(
            objective, active=objective.active.at[objective.given.index(name)].set(0.0)
        )
    if getattr(own, name) == 0.0:
        return None
    field, share = walls[name]
    edge = jnp.asarray(share * own.channel_diameter)
    return dataclasses.replace(objective, limits=dataclasses.replace(objective.limits, **{field: edge}))


def relaxations(
    problem: DesignProblem, found: SearchResult, binding: tuple[Binding, ...]
) -> tuple[Relaxed, ...]:
    """Whether the targets could be met if one of the binding limits were put aside."""
    out = []
    objective = nominal(without_goal(problem.objective))
    for bound in binding:
        if bound.kind != "limit" or bound.name in (L.WAVE, L.RELEASE):
            continue
        eased = _without(problem, objective, bound.name)
        if eased is None:
            continue
        again = search_all(eased, jnp.asarray(found.z), jnp.asarray(found.free), MANY_STEPS)
        kept = np.asarray(jnp.min(again.rows, axis=1)) >= LEAST_MARGIN
        cost = np.where(kept, np.asarray(again.cost), np.inf)
        best = int(np.argmin(cost))
        if not np.isfinite(cost[best]):
            continue
        values = problem.space.values_at(np.asarray(again.z[best]))
        try:
            option = look_at(problem, values, resolution=1.0)
        except InputError:
            continue
        own = next((m for m in option.margins if m.name == bound.name), None)
        if own is not None:
            out.append(Relaxed(bound.name, option.reached, own.value, own.limit, own.unit))
    return tuple(out)
