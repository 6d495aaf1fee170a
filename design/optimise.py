"""`design.optimise`: search from many starts, look at what was found on a finer mesh, and say what it is."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable

import numpy as np

from gtr_jax.config.config import RobotConfig, load_config
from gtr_jax.errors import InputError

from .binding import binding_of, relaxations
from .compare import compare
from .distinct import distinct_options
from .least_loss import with_less_loss
from .problem import RESOLUTION, DesignProblem, problem_of
from .result import NEAREST, Design, SearchFacts
from .robustness import robustness_of
from .search import SearchResult, find
from .target import TargetConfig, load_target
from .tolerances import tolerance_table
from .verify import verify


def optimise(
    robot: RobotConfig | str | os.PathLike[str],
    target: TargetConfig | str | os.PathLike[str],
    *,
    against: RobotConfig | None = None,
    resolution: float = RESOLUTION,
    progress: Callable[[str], None] = lambda stage: None,
) -> Design:
    """Choose a robot's routing, and whatever else is free, so that it meets its targets within its limits.

    Args:
        robot: robot file, or its path.
        target: target file, or its path.
        against: a plainer model of the same robot. A second design is made with it, and the answer tells how
            this design performs in `robot`. A robot with physics terms is compared with itself without them
            unless given.
        resolution: factor on the mesh of the search; what is found is looked at on one four times finer than
            the default.
        progress: called with a line of text at each stage.

    Returns:
        The design; where the targets cannot be met, the nearest there is, and what stands in the way.

    Raises:
        InputError: file, key and remedy, in one line.
    """
    began = time.monotonic()
    robot = load_config(robot) if isinstance(robot, str | os.PathLike) else robot
    target = load_target(target) if isinstance(target, str | os.PathLike) else target
    problem = problem_of(robot, target, resolution=resolution)
    plain = against or _without_terms(robot)
    other = None if plain is None else _problem_like(problem, plain, resolution)
    progress("compiling and screening designs")
    starts, found = _searched(problem, progress)
    progress("checking the designs on a finer mesh")
    options = distinct_options(problem, found)
    best = options[0]
    verified = verify(problem, best)
    progress("sensitivities")
    answer = Design(
        problem=problem,
        options=tuple(options),
        verification=verified,
        binding=binding_of(problem, found, best.lane),
        relaxed=(),
        tolerances=tolerance_table(problem, best),
        robustness=robustness_of(problem, best),
        comparison=None,
        search=SearchFacts(
            found.method,
            len(starts.z),
            int(np.sum(starts.settled)),
            int(np.sum(found.steps)),
            found.reachable,
            0.0,
        ),
    )
    if answer.verdict == NEAREST:
        progress("what stands in the way")
        answer = dataclasses.replace(answer, relaxed=relaxations(problem, found, answer.binding))
    if plain is not None and other is not None:
        progress("designing with the plain model")
        option = distinct_options(other, _searched(other, progress)[1])[0]
        answer = dataclasses.replace(answer, comparison=compare(problem, option, plain))
    seconds = time.monotonic() - began
    return dataclasses.replace(answer, search=dataclasses.replace(answer.search, seconds=seconds))


def _searched(problem: DesignProblem, progress: Callable[[str], None]) -> tuple[SearchResult, SearchResult]:
    """The search from all starts, and the same with its lanes followed to less tension loss."""
    found = find(problem, progress)
    progress("towards less tension lost")
    return found, with_less_loss(problem, found)


def _without_terms(robot: RobotConfig) -> RobotConfig | None:
    """The robot without its physics terms; None if it has none."""
    if not robot.terms:
        return None
    return robot.model_copy(update={"terms": ()})


def _problem_like(problem: DesignProblem, plain: RobotConfig, resolution: float) -> DesignProblem:
    """The same problem for a plainer model; InputError if its free numbers differ."""
    other = problem_of(plain, problem.target, resolution=resolution)
    if [v.name for v in other.space.all] != [v.name for v in problem.space.all]:
        raise InputError(
            f"{plain.source}: does not have the numbers of {problem.space.config.source} that may change; "
            "compare "
            "robots with channels of one kind"
        )
    return other
