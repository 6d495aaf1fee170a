"""The chosen design solved again: on a mesh four times finer, step by step along its loads, and by the
paper's own integrals.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.simulation.history import simulate
from gtr_jax.simulation.programs import terms_act

from .distinct import FINER
from .literal import solve_literal
from .option import Option, look_at
from .problem import DesignProblem
from .space import on_common_mesh

STEPS = 12  # of each branch


@dataclasses.dataclass(frozen=True, eq=False)
class Verification:
    """How far independent solutions of the chosen design are from the first one.

    Attributes:
        fine_moved: largest distance of a tip [m], and angle [rad], from the default mesh to the finer one.
        steps_moved: the same from one load step to many.
        literal_moved: the same from the simulator, on the finer mesh, to the literal integrals; NaN where
            these do not apply.
        literal_says: why they do not apply, or "".
        converged: whether all of it was solved.
    """

    fine_moved: tuple[float, float]
    steps_moved: tuple[float, float]
    literal_moved: tuple[float, float]
    literal_says: str
    converged: bool


def _apart(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between poses (S, 3)."""
    gap = np.asarray(one) - np.asarray(other)
    return float(np.max(np.hypot(gap[:, 0], gap[:, 1]))), float(np.max(np.abs(gap[:, 2])))


def verify(problem: DesignProblem, option: Option) -> Verification:
    """Solve a design again, three ways.

    Args:
        problem: what it is a design for.
        option: on the finer mesh.
    """
    robot = on_common_mesh(problem.space, option.config, FINER)
    default = look_at(problem, np.array([option.values[v.name] for v in problem.space.all]), resolution=1.0)
    states = problem.objective.states
    top = float(np.max(option.tensions))
    stepped, ok = [], True
    # With physics terms on the default mesh: a march with slip on the finer one takes minutes.
    acting = terms_act(robot)
    along = on_common_mesh(problem.space, option.config, 1.0) if acting else robot
    for number, released in states:
        T = float(option.tensions[number])
        preload = option.config.tendon.preload
        history = np.linspace(preload, top if released else T, STEPS + 1)[1:]
        tail = np.linspace(top, T, STEPS + 1)[1:] if released else np.full(STEPS, T)
        run = simulate(along, np.concatenate([history, tail]), time=1e6 * np.arange(2 * STEPS))
        stepped.append(np.asarray(run.tip_pose[-1]))
        ok = ok and bool(np.all(np.asarray(run.converged)))
    poses = np.asarray(option.states.pose)
    same = np.asarray(default.states.pose) if acting else poses
    literal, says = (float("nan"), float("nan")), ""
    if acting:
        says = "the paper has no physics terms"
    else:
        solved = []
        s = np.asarray(option.states.s)
        for number, released in states:
            found = solve_literal(
                robot,
                float(option.tensions[number]),
                released_from=top if released else None,
                start=(s, np.zeros_like(s)),
            )
            ok = ok and found.settled
            solved.append(found.pose)
        literal = _apart(poses, np.stack(solved))
    return Verification(
        _apart(np.asarray(default.states.pose), poses),
        _apart(same, np.stack(stepped)),
        literal,
        says,
        ok and option.converged and default.converged,
    )
