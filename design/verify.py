"""The chosen design solved again: on a mesh four times finer, step by step along its loads, and by the
paper's own integrals.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.displacement import by_tension
from gtr_jax.simulation.history import Simulation, simulate
from gtr_jax.simulation.programs import terms_act

from .distinct import FINER
from .literal import solve_literal
from .literal_in_space import solve_in_space
from .option import Option, look_at
from .pose import distance, in_space, turn
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
        displacement: how far each tendon is drawn out at each state, in many load steps [m], (S, *tendons).
    """

    fine_moved: tuple[float, float]
    steps_moved: tuple[float, float]
    literal_moved: tuple[float, float]
    literal_says: str
    converged: bool
    displacement: np.ndarray


def _apart(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Largest distance [m] and angle [rad] between poses (S, pose)."""
    gap = np.asarray(one) - np.asarray(other)
    return float(np.max(distance(gap))), float(np.max(turn(gap)))


def verify(problem: DesignProblem, option: Option) -> Verification:
    """Solve a design again, three ways.

    Args:
        problem: what it is a design for.
        option: on the finer mesh.
    """
    robot = on_common_mesh(problem.space, option.config, FINER)
    default = look_at(problem, np.array([option.values[v.name] for v in problem.space.all]), resolution=1.0)
    states = problem.objective.states
    top = np.max(option.tensions, axis=0)  # before a release, which one tendon only has
    stepped, drawn, ok = [], [], True
    # With physics terms on the default mesh: a march with slip on the finer one takes minutes.
    acting = terms_act(robot)
    along = by_tension(on_common_mesh(problem.space, option.config, 1.0) if acting else robot)
    preload = np.asarray(robot.per_tendon(lambda tendon: tendon.preload))
    for number, released in states:
        T = np.asarray(option.tensions[number])
        history = np.linspace(preload, top if released else T, STEPS + 1)[1:]
        tail = np.linspace(top, T, STEPS + 1)[1:] if released else np.repeat(T[None], STEPS, axis=0)
        run = simulate(along, np.concatenate([history, tail]), time=1e6 * np.arange(2 * STEPS))
        stepped.append(np.asarray(pose_at_end(run)))
        drawn.append(np.asarray(run.displacement[-1]))
        ok = ok and bool(np.all(np.asarray(run.converged)))
    poses = np.asarray(option.states.pose)
    same = np.asarray(default.states.pose) if acting else poses
    literal, says = (float("nan"), float("nan")), _no_literal(robot)
    if not says:
        solved = []
        for number, released in states:
            found, settled = _literal(
                robot, option, float(option.tensions[number]), float(top) if released else None
            )
            ok = ok and settled
            solved.append(found)
        literal = _apart(poses, np.stack(solved))
    return Verification(
        _apart(np.asarray(default.states.pose), poses),
        _apart(same, np.stack(stepped)),
        literal,
        says,
        ok and option.converged and default.converged,
        np.stack(drawn),
    )


def pose_at_end(run: Simulation) -> np.ndarray:
    """Pose of the tip at the last step of a history, as `pose` has it."""
    if run.shape is None:
        return np.asarray(run.tip_pose[-1])
    return np.asarray(in_space(run.tip_position[-1], run.tip_rotation[-1]))


def _no_literal(robot: Robot) -> str:
    """Why the literal integrals do not solve a robot; "" if they do."""
    if terms_act(robot):
        return "the paper has no physics terms"
    if robot.backbone.notches:
        return "the paper has no notches"
    if robot.tendon_names:
        return "the paper has them for one tendon"
    if robot.tendon.to is not None or robot.tendon.guides is not None:
        return "the paper has them for a channel that guides the tendon from base to tip"
    return ""


def _literal(
    robot: Robot, option: Option, T_base: float, released_from: float | None
) -> tuple[np.ndarray, bool]:
    """Pose of the tip by the literal integrals, and whether they settled."""
    if robot.space:
        found = solve_in_space(robot, T_base, released_from=released_from)
        return np.concatenate([found.place, found.rotation.ravel()]), found.settled
    s = np.asarray(option.states.s)
    flat = solve_literal(robot, T_base, released_from=released_from, start=(s, np.zeros_like(s)))
    return flat.pose, flat.settled
