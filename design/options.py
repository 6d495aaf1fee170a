"""From lanes of a search to distinct designs on a finer mesh, the best first."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gtr_jax.errors import InputError

from .assemble import Assembled
from .gauss_newton import judge_all, search_all
from .option import Option, look_at
from .search import ARRIVED, FEW_STEPS, Lanes, ranking

MESH_SHARE = 0.1  # of a tolerance, by which the mesh of the search may be off
CORRECTIONS = 2
SAME = 0.02  # of the space, between two designs that count as one
LISTED = 8


def options_of(problem: Assembled, found: Lanes) -> list[Option]:
    """The distinct designs found, looked at on a finer mesh, best first."""
    chosen: list[np.ndarray] = []
    options: list[Option] = []
    best = None
    for i in ranking(problem, found):
        z = found.z[i]
        if not np.isfinite(found.cost[i]):
            continue
        if not is_new(z, chosen):
            continue
        good = found.kept[i] and (found.cost[i] < ARRIVED or bool(problem.task.wanted.goal))
        if best is not None and not good and found.cost[i] > 1.5 * best + 0.5:
            continue  # neither arrived nor as near as the nearest: a search that got stuck
        try:
            options.append(settled_on(problem, z, found.free[i])[1])
        except InputError:
            continue
        best = found.cost[i] if best is None else best
        chosen.append(z)
        if len(options) == LISTED:
            break
    if not options:
        raise InputError(
            f"{problem.target.source}: search: no start led to a robot that can be solved; narrow the bounds "
            "or lower T_base"
        )
    # What the finer mesh finds there counts for more than what the search found.
    return sorted(options, key=lambda o: not (o.kept and (o.reached or bool(problem.task.wanted.goal))))


def is_new(z: np.ndarray, others: list[np.ndarray]) -> bool:
    """Whether coordinates, (c,), are a design apart from others."""
    return all(np.max(np.abs(z - other)) >= SAME for other in others)


def settled_on(problem: Assembled, z: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, Option]:
    """A design on a mesh no coarser than the default, and its coordinates, (c,).

    Where the two meshes differ by more than a share of a tolerance, the search goes on from there for targets
    moved by the difference, so that the finer mesh finds the tip where it is wanted.

    Args:
        problem: what it is a design for.
        z: coordinates, (c,). free: 1 for those that may change, (c,).

    Raises:
        InputError: no robot has such numbers.
    """
    task, space = problem.task, problem.space

    def built(z):
        return look_at(problem, space.values_at(z), resolution=1.0)

    option = built(z)
    if task.wanted.goal or task.spread != "nominal" or not task.wanted.pose_state:
        return z, option
    for _ in range(CORRECTIONS):
        judged = judge_all(task, jnp.asarray(z)[None])
        arrived = 0.5 * float(jnp.sum(judged.residuals**2)) < ARRIVED
        if not arrived or option.miss < MESH_SHARE:
            break
        at = jnp.asarray(task.wanted.pose_state)
        shift = jnp.asarray(option.states.pose)[at] - judged.pose[0, at]
        moved = eqx.tree_at(lambda t: t.wanted.pose, task, task.wanted.pose - shift)
        again = search_all(moved, jnp.asarray(z)[None], jnp.asarray(free)[None], FEW_STEPS)
        try:
            other = built(np.asarray(again.z[0]))
        except InputError:
            break
        if not (other.kept or not option.kept) or other.miss >= option.miss:
            break
        z, option = np.asarray(again.z[0]), other
    return z, option
