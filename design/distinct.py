"""From lanes of a search to distinct designs on a finer mesh, the best first."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gtr_jax.errors import InputError
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.clearance import place_in_section

from .gauss_newton import Found, judge_all, search_all
from .objective import Objective
from .option import Option, look_at
from .problem import DesignProblem
from .search import ARRIVED, FEW_STEPS, SearchResult, ranking
from .starts import len_of_starts

FINER = 4.0  # mesh on which designs are compared, over the default
MESH_SHARE = 0.1  # of a tolerance, by which the mesh of the search may be off
CORRECTIONS = 2  # searches for targets moved by the mesh's error, at most
SAME = 0.02  # difference in any coordinate, of the range searched, below which two designs count as one
SAME_CHANNEL = 1e-3  # of the largest radius: difference below which two channels count as one
PLACES = 201  # stations along the body, at which channels are compared
LISTED = 8  # designs, at most


class _Seen(NamedTuple):
    """A design that is listed: coordinates, (c,), its option, and places of its channels in the section [m],
    (tendons, PLACES, 2).
    """

    z: np.ndarray
    option: Option
    R: np.ndarray


def distinct_options(problem: DesignProblem, found: SearchResult) -> list[Option]:
    """The distinct designs found, each looked at on a mesh four times finer than the default, best first.

    If any design is valid, only valid ones are returned: they keep every limit and, unless they are robust
    designs (which allow for uncertain friction and modulus), every tolerance. The first one loses the least
    tension; with a goal it is the best; of robust designs it has the least error. If none is valid, the
    nearest ones are returned.

    Args:
        problem: what they are designs for.
        found: the search.

    Raises:
        InputError: no lane led to a robot that can be solved.
    """
    sound: list[_Seen] = []
    others: list[_Seen] = []
    best = None
    for lane in ranking(problem, found):
        cost = found.cost[lane]
        if not np.isfinite(cost) or not is_new(found.z[lane], [seen.z for seen in sound]):
            continue
        good = found.kept[lane] and (cost < ARRIVED or bool(problem.objective.wanted.goal))
        if best is not None and not good and cost > 1.5 * best + 0.5:
            continue  # neither arrived nor as near as the nearest: a search that got stuck
        try:
            seen = _looked_at(problem, found, int(lane))
        except InputError:
            continue
        best = cost if best is None else best
        listed = sound if is_valid(problem, seen.option) else others
        if not any(_same(problem, seen, other) for other in listed):
            listed.append(seen)
        if len(sound) == LISTED:
            break
    if not sound and not others:
        raise InputError(
            f"{problem.target.source}: search: no start led to a robot that can be solved; narrow the bounds "
            "or lower T_base"
        )
    if not sound:
        return [seen.option for seen in others[:LISTED]]
    return sorted((seen.option for seen in sound), key=lambda option: _preference(problem, option))


def is_valid(problem: DesignProblem, option: Option) -> bool:
    """Whether a design can be offered: it keeps its limits and, unless it is a robust design, its targets are
    within their tolerances.
    """
    robust = problem.objective.spread != "nominal" and not problem.objective.wanted.goal
    return option.converged and option.kept and (robust or option.reached)


def by_loss(problem: DesignProblem) -> bool:
    """Whether valid designs are chosen from by the tension they lose."""
    return not problem.objective.wanted.goal and problem.objective.spread == "nominal"


def _preference(problem: DesignProblem, option: Option) -> float:
    """Sorting key, the less the better; constant where the order of the search is kept."""
    if problem.objective.spread != "nominal":
        return 0.0
    if problem.target.goal is not None:
        return option.goal if problem.target.goal.kind == "tension" else -option.goal
    return option.loss if option.loss == option.loss else option.miss


def is_new(z: np.ndarray, others: list[np.ndarray]) -> bool:
    """Whether coordinates, (c,), differ from those of all other designs."""
    return all(np.max(np.abs(z - other)) >= SAME for other in others)


def _same(problem: DesignProblem, one: _Seen, other: _Seen) -> bool:
    """Whether two designs are one: near in all coordinates, or in all but those of the channel, with the same
    channel.
    """
    if not is_new(one.z, [other.z]):
        return True
    rest = [i for i, v in enumerate(problem.space.all) if not v.of_channel]
    if not is_new(np.append(one.z[rest], 0.0), [np.append(other.z[rest], 0.0)]):
        near = SAME_CHANNEL * max(one.option.config.backbone.outer_radius)
        return bool(np.max(np.abs(one.R - other.R)) < near)
    return False


def _looked_at(problem: DesignProblem, found: SearchResult, lane: int) -> _Seen:
    z, _ = settled_on(problem, found.z[lane], found.free[lane])
    values = problem.space.rounded(problem.space.values_at(z))
    option = dataclasses.replace(look_at(problem, values, resolution=FINER), lane=lane)
    robot = build_robot(option.config)
    s = np.linspace(0.0, option.config.backbone.length, PLACES)
    places = [place_in_section(tendon, s, option.config.backbone.length) for tendon in robot.tendons]
    return _Seen(z, option, np.stack(places))


def settled_on(problem: DesignProblem, z: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, Option]:
    """A design on a mesh no coarser than the default, and its coordinates, (c,).

    Where the two meshes differ by more than a share of a tolerance, the search goes on from there for targets
    moved by the difference, so that the finer mesh finds the tip where it is wanted.

    Args:
        problem: what it is a design for.
        z: coordinates, (c,). free: 1 for those that may change, (c,).

    Raises:
        InputError: no robot has such numbers.
    """
    objective, space = problem.objective, problem.space

    def built(z):
        return look_at(problem, space.rounded(space.values_at(z)), resolution=1.0)

    option = built(z)
    if objective.wanted.goal or objective.spread != "nominal" or not objective.wanted.pose_state:
        return z, option
    for _ in range(CORRECTIONS):
        judged = judge_all(objective, jnp.asarray(z)[None])
        arrived = 0.5 * float(jnp.sum(judged.residuals**2)) < ARRIVED
        if not arrived or option.miss < MESH_SHARE:
            break
        at = jnp.asarray(objective.wanted.pose_state)
        shift = jnp.asarray(option.states.pose)[at] - judged.pose[0, at]
        moved = eqx.tree_at(lambda t: t.wanted.pose, objective, objective.wanted.pose - shift)
        again = _search_from(moved, problem, z, free)
        try:
            other = built(np.asarray(again.z[0]))
        except InputError:
            break
        if not (other.kept or not option.kept) or other.miss >= option.miss:
            break
        z, option = np.asarray(again.z[0]), other
    return z, option


def _search_from(objective: Objective, problem: DesignProblem, z: np.ndarray, free: np.ndarray) -> Found:
    """A search from one start; in space by the program of the search from all starts, whose other lanes are
    held and stop at once, because another would take long to compile.
    """
    lanes = len_of_starts(problem.space, problem.target.search.starts) if objective.robot.space else 1
    start, may = np.tile(z, (lanes, 1)), np.zeros((lanes, len(z)))
    may[0] = free
    return search_all(objective, jnp.asarray(start), jnp.asarray(may), FEW_STEPS)
