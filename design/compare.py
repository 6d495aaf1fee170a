"""How a design made with a plainer model performs under the physics that was found."""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.config.config import RobotConfig

from .option import Option, judge
from .problem import DesignProblem
from .space import on_common_mesh


@dataclasses.dataclass(frozen=True, eq=False)
class Comparison:
    """A design made with the plain model: as that model predicts it, and as it really is.

    Attributes:
        source: of the plain model.
        believed: the design as the plain model sees it.
        actual: the same channel in the robot with its physics terms.
    """

    source: str
    believed: Option
    actual: Option


def compare(problem: DesignProblem, believed: Option, plain: RobotConfig) -> Comparison:
    """Put a design made with the plain model into the robot as it is.

    Args:
        problem: of the robot with its physics terms.
        believed: the design that the plain model led to.
        plain: that model.
    """
    values = np.array([believed.values[v.name] for v in problem.space.all])
    config = problem.space.design(values)
    robot = on_common_mesh(problem.space, config, 1.0)
    actual = judge(problem, config, robot, problem.space.tensions_at(values), believed.values)
    own = plain.source == problem.space.config.source
    source = f"{plain.source} without its terms" if own else plain.source
    return Comparison(source, believed, actual)
