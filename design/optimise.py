"""`design.optimise`: search from many starts, look at what was found on a finer mesh, and say what it is."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gtr_jax.config import RobotConfig, load_config
from gtr_jax.errors import InputError

from . import limits as L
from .assemble import Assembled, assemble
from .compare import Comparison, compare
from .gauss_newton import Found, judge_all, search_all
from .lagrangian import minimise_all
from .option import Option, look_at
from .result import Binding, Design, Relaxed, SearchFacts
from .robustness import robustness_of
from .starts import starts
from .target import TargetConfig, load_target
from .task import Evaluation, Task
from .tolerances import tolerance_table
from .verify import verify

FEW_STEPS, MANY_STEPS = 25, 250
WITHIN = 0.5  # of a tolerance, that a search has to come to, so that a finer mesh still finds it there
MESH_SHARE = 0.1  # of a tolerance, by which the mesh of the search may be off
CORRECTIONS = 2
SAME = 0.02  # of the space, between two designs that count as one
LISTED = 8
LANES = 4  # that a second search goes on with
SPREAD_OUT = 2e-3  # margin, in its scale, under which a limit counts as binding


def optimise(
    robot: RobotConfig | str,
    target: TargetConfig | str,
    *,
    against: RobotConfig | None = None,
    resolution: float = 0.5,
    progress: Callable[[str], None] = lambda stage: None,
) -> Design:
    """Choose a robot's routing, and whatever else is free, so that it meets its targets within its limits.

    Args:
        robot: robot file, or its path; of one tendon.
        target: target file, or its path.
        against: a plainer model of the same robot: it is designed with too, and what that design does in
            `robot` is told. A robot with physics terms is compared with itself without them unless given.
        resolution: factor on the mesh of the search; what is found is looked at on one four times finer than
            the default.
        progress: is told each stage.

    Returns:
        The design; where the targets cannot be met, the nearest there is, and what stands in the way.

    Raises:
        InputError: file, key and remedy, in one line.
    """
    began = time.monotonic()
    robot = load_config(robot) if isinstance(robot, str) else robot
    target = load_target(target) if isinstance(target, str) else target
    problem = assemble(robot, target, resolution=resolution)
    progress("compiling and screening designs")
    found = find(problem, progress)
    progress("looking at the designs on a finer mesh")
    options = _options(problem, found)
    best = options[0]
    verified = verify(problem, best)
    progress("sensitivities")
    answer = Design(
        problem=problem,
        options=tuple(options),
        verification=verified,
        binding=_binding(problem, found),
        relaxed=(),
        tolerances=tolerance_table(problem, best),
        robustness=robustness_of(problem, best),
        comparison=None,
        search=SearchFacts(
            found.method, len(found.z), int(np.sum(found.settled)), int(np.sum(found.steps)), 0.0
        ),
    )
    if not (best.reached and best.kept):
        progress("what stands in the way")
        answer = dataclasses.replace(answer, relaxed=_relaxations(problem, found, answer.binding))
    plain = against or _without_terms(robot)
    if plain is not None:
        progress("designing with the plain model")
        answer = dataclasses.replace(answer, comparison=_compared(problem, plain, resolution, progress))
    seconds = time.monotonic() - began
    return dataclasses.replace(answer, search=dataclasses.replace(answer.search, seconds=seconds))


@dataclasses.dataclass(frozen=True, eq=False)
class Lanes:
    """All lanes of a search: coordinates (L, c), merit (L,), how they are judged, multipliers (L, K),
    gradient (L, c), whether they settled (L,), evaluations (L,); the method that found them.
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

    @property
    def order(self) -> np.ndarray:
        """By which lanes are ranked: those that break a limit behind all that keep them, (L,)."""
        short = np.minimum(np.min(self.margins, axis=1, initial=1.0), 0.0)
        return np.where(self.kept, self.cost, 1e12 * (1.0 - short))


def find(problem: Assembled, progress: Callable[[str], None] = lambda stage: None) -> Lanes:
    """Search from all starts.

    Targets are a least squares problem: Gauss-Newton from every start, a few steps, more where none has
    arrived, and once more with residuals of a smaller scale where nothing ever will. Goals and worst cases go
    on from there by L-BFGS-B.
    """
    task, target = problem.task, problem.target
    goal = bool(task.wanted.goal)
    first = task if goal else without_goal(task)
    z, free = starts(first, problem.space, target.search.starts, target.search.seed)
    z, free = jnp.asarray(z), jnp.asarray(free)
    progress("searching")
    if target.search.method == "l-bfgs-b" and not goal:
        return _lanes(problem, minimise_all(task, z, free), np.asarray(free), "l-bfgs-b")
    found = None
    if not goal or task.wanted.pose_state or task.wanted.point_state:
        found = _meet(without_goal(task), z, free)
        if task.spread != "worst" and not goal:
            return _lanes(problem, found, np.asarray(free), "gauss-newton")
        z = found.z
    if goal:
        found = search_all(task, z, free, MANY_STEPS)
    assert found is not None
    progress("searching by L-BFGS-B")
    order = np.argsort(_lanes(problem, found, np.asarray(free), "").order, kind="stable")[:LANES]
    z, free = jnp.asarray(found.z), jnp.asarray(free)
    multipliers = None
    if goal:  # Gauss-Newton's are of half the square of the distance from utopia
        away = jnp.sqrt(2.0 * found.cost[order])
        multipliers = found.multipliers[order] / jnp.where(away > 0, away, 1.0)[:, None]
    polished = minimise_all(task, z[order], free[order], multipliers)
    both = found._replace(settled=found.settled if goal else jnp.zeros_like(found.settled))
    joined = Found(*(jnp.concatenate([a, b]) for a, b in zip(polished, both, strict=True)))
    free = jnp.concatenate([free[order], free])
    return _lanes(problem, joined, np.asarray(free), "gauss-newton, l-bfgs-b")


def _meet(task: Task, z, free) -> Found:
    """Gauss-Newton on the targets from every start: a few steps; more where none has arrived; and once more
    at a smaller scale where nothing ever will.
    """
    found = search_all(task, z, free, FEW_STEPS)
    if not _any_reached(found):
        found = search_all(task, found.z, free, MANY_STEPS)
    if not _any_reached(found):
        found = _nearest(task, found, free)
    return found


def without_goal(task: Task) -> Task:
    """The task of meeting the targets alone, as a sum of squares."""
    spread = "expected" if task.spread == "worst" else task.spread
    wanted = dataclasses.replace(task.wanted, goal="") if task.wanted.goal else task.wanted
    return dataclasses.replace(task, wanted=wanted, spread=spread)


def _any_reached(found: Found) -> bool:
    kept = jnp.min(found.rows, axis=1, initial=1.0) >= 0.0
    return bool(jnp.any((found.cost < 0.5 * WITHIN**2) & kept))


def _nearest(task: Task, found: Found, free) -> Found:
    """The same search with residuals divided by their size: where a target is far out of reach, the limits
    would else weigh too little against it.
    """
    cost = float(np.min(np.where(np.isfinite(found.cost), found.cost, np.inf)))
    size = max(1.0, np.sqrt(2.0 * cost)) if np.isfinite(cost) else 1.0
    smaller = eqx.tree_at(
        lambda t: (t.wanted.pose_scale, t.wanted.point_scale),
        task,
        (task.wanted.pose_scale / size, task.wanted.point_scale / size),
    )
    again = search_all(smaller, found.z, free, MANY_STEPS)
    return again._replace(cost=again.cost * size**2, multipliers=again.multipliers * size)


def _lanes(problem: Assembled, found: Found, free: np.ndarray, method: str) -> Lanes:
    judged = judge_all(problem.task, found.z)
    margins = np.asarray(judged.margins)
    kept = np.min(margins, axis=1, initial=1.0) >= -1e-6
    cost = 0.5 * np.sum(np.asarray(judged.residuals) ** 2, axis=1)
    cost = np.where(np.asarray(judged.converged) & np.isfinite(cost), cost, np.inf)
    return Lanes(
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


def _ranking(problem: Assembled, found: Lanes) -> np.ndarray:
    """Lanes in the order of preference: limits kept first; then those that reach the targets, the one that
    loses the least tension first; then the nearest. Of a goal, the best first.
    """
    reach = found.cost < 0.5 * WITHIN**2
    if problem.task.wanted.goal or problem.task.spread != "nominal":
        return np.lexsort((found.cost, ~found.kept))
    pulled = [i for i, (_, released) in enumerate(problem.task.states) if not released]
    share = np.asarray(found.judged.T_tip)[:, pulled]
    T = np.asarray(problem.task.tensions)[[problem.task.states[i][0] for i in pulled]]
    loss = np.max(1.0 - share / T, axis=1, initial=-1.0) if pulled else np.zeros(len(reach))
    second = np.where(reach, loss, found.cost)
    short = np.minimum(np.min(found.margins, axis=1, initial=1.0), 0.0)
    return np.lexsort((second, ~reach, np.where(found.kept, 0.0, -short)))


def _options(problem: Assembled, found: Lanes) -> list[Option]:
    """The distinct designs found, looked at on a finer mesh, best first."""
    chosen: list[np.ndarray] = []
    options: list[Option] = []
    best = None
    for i in _ranking(problem, found):
        z = found.z[i]
        if not np.isfinite(found.cost[i]):
            continue
        if any(np.max(np.abs(z - other)) < SAME for other in chosen):
            continue
        good = found.kept[i] and (found.cost[i] < 0.5 * WITHIN**2 or bool(problem.task.wanted.goal))
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
    return options


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
        return look_at(problem, space.lower + z * (space.upper - space.lower), resolution=1.0)

    option = built(z)
    if task.wanted.goal or task.spread != "nominal" or not task.wanted.pose_state:
        return z, option
    for _ in range(CORRECTIONS):
        judged = judge_all(task, jnp.asarray(z)[None])
        arrived = 0.5 * float(jnp.sum(judged.residuals**2)) < 0.5 * WITHIN**2
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


def _binding(problem: Assembled, found: Lanes) -> tuple[Binding, ...]:
    """Limits and bounds that the best lane leans on, the hardest first."""
    best = int(_ranking(problem, found)[0])
    space = problem.space
    if not np.isfinite(found.cost[best]):
        return ()
    sizes = _rows_of_limits(problem)
    out, at = [], 0
    for name in sizes:
        rows = slice(at, at + sizes[name])
        at += sizes[name]
        force = float(np.sum(np.abs(found.multipliers[best, rows])))
        near = float(np.min(found.margins[best, rows], initial=1.0))
        if near < SPREAD_OUT and (force > 0 or near < 0):
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


def _rows_of_limits(problem: Assembled) -> dict[str, int]:
    """Rows of the margins by limit, in their order."""
    import jax

    from .limits import channel_margins, stations_of
    from .task import load_margins, robot_of, solve_states, tensions_of

    task = problem.task

    def margins(z):
        robot = robot_of(task, z)
        found = channel_margins(robot, stations_of(robot, task.stations), task.limits, task.given)
        return found | load_margins(task, solve_states(task, robot, tensions_of(task, z)))

    shapes = jax.eval_shape(margins, jnp.zeros(task.lower.shape))
    return {name: shapes[name].shape[0] for name in task.given if name in shapes}


def _relaxations(problem: Assembled, found: Lanes, binding: tuple[Binding, ...]) -> tuple[Relaxed, ...]:
    """Whether the targets could be met with one of the limits that bind put aside."""
    out = []
    task = without_goal(problem.task)
    for bound in binding:
        if bound.kind != "limit" or bound.name in (L.WAVE,):
            continue
        place = task.given.index(bound.name)
        if bound.name == L.WALL and problem.target.limits.wall_clearance == 0.0:
            continue
        eased = dataclasses.replace(task, active=task.active.at[place].set(0.0))
        again = search_all(eased, jnp.asarray(found.z), jnp.asarray(found.free), MANY_STEPS)
        cost = np.where(np.asarray(jnp.min(again.rows, axis=1)) >= -1e-6, np.asarray(again.cost), np.inf)
        best = int(np.argmin(cost))
        if not np.isfinite(cost[best]):
            continue
        values = problem.space.lower + np.asarray(again.z[best]) * (problem.space.upper - problem.space.lower)
        try:
            option = look_at(problem, values, resolution=1.0)
        except InputError:
            continue
        own = next((m for m in option.margins if m.name == bound.name), None)
        if own is not None:
            out.append(Relaxed(bound.name, option.reached, own.value, own.limit, own.unit))
    return tuple(out)


def _without_terms(robot: RobotConfig) -> RobotConfig | None:
    """The robot without its physics terms; None if it has none."""
    if not robot.terms:
        return None
    return robot.model_copy(update={"terms": ()})


def _compared(problem: Assembled, plain: RobotConfig, resolution: float, progress) -> Comparison | None:
    with_plain = assemble(plain, problem.target, resolution=resolution)
    if with_plain.space.lower.shape != problem.space.lower.shape:
        raise InputError(
            f"{plain.source}: has not the numbers of {problem.space.config.source}; compare like robots"
        )
    option = _options(with_plain, find(with_plain, progress))[0]
    return compare(problem, option, plain)
