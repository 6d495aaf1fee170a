"""One design, looked at on a mesh of its own: where it brings the tip, and how far it is from every limit."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.numbers import quantity
from gtr_jax.robot.robot import Robot

from . import limits as L
from .model import States, states_of
from .objective import goal_of, point_at, shares_of
from .obstacles import gaps as obstacle_gaps
from .pose import ANGLE, distance, turn
from .problem import DesignProblem, wanted_pose
from .space import on_common_mesh
from .tensions import Pull

PLACES = 2001  # stations along the body, at which limits are checked
ROUNDING = 1e-9  # relative excess over a tolerance or limit that still counts as kept
NOTHING = 0.01  # of a tolerance: a smaller miss is given as "less than" this


@dataclasses.dataclass(frozen=True)
class TargetError:
    """How near one target is.

    Attributes:
        name: "pose[0]", "shape[0]".
        T_base: base tension [N], of several tendons of each. branch: "pulling" or "releasing".
        wanted, found: pose of the tip as `pose` has it, NaN where not asked for; of a shape, at the point
            that is farthest off its place.
        distance: of the tip, or of the point that is farthest off [m]; NaN if not asked for.
        turn: angle by which it is off [rad]; NaN if not asked for.
        tip_tolerance [m], angle_tolerance [rad]: as given.
    """

    name: str
    T_base: Pull
    branch: str
    wanted: tuple[float, ...]
    found: tuple[float, ...]
    distance: float
    turn: float
    tip_tolerance: float
    angle_tolerance: float

    @property
    def size(self) -> float:
        """The larger of the two errors, in units of its tolerance."""
        tip = self.distance / self.tip_tolerance if self.distance == self.distance else 0.0
        return max(tip, abs(self.turn) / self.angle_tolerance if self.turn == self.turn else 0.0)

    @property
    def within(self) -> bool:
        """Whether it is within its tolerances."""
        near = not self.distance > self.tip_tolerance * (1 + ROUNDING)
        return near and not abs(self.turn) > self.angle_tolerance * (1 + ROUNDING)

    @property
    def distance_says(self) -> str:
        """The distance in words, to two digits, three if missed; a dash if it was not asked for."""
        return off_by(self.distance, self.tip_tolerance, "m")

    @property
    def turn_says(self) -> str:
        """The angle in degrees, in the same way."""
        return off_by(abs(self.turn), self.angle_tolerance, "rad")


@dataclasses.dataclass(frozen=True)
class Margin:
    """One limit.

    Attributes:
        name: as in the target file.
        value: what the design has, at its worst. limit: what it has to keep.
        margin: the room left, negative where the limit is broken. unit: SI, of all three.
        where: arc length [m] of the worst place; NaN if it has none.
    """

    name: str
    value: float
    limit: float
    margin: float
    unit: str
    where: float

    @property
    def kept(self) -> bool:
        """Whether the limit is kept."""
        return self.margin >= -ROUNDING * max(1.0, abs(self.limit))


@dataclasses.dataclass(frozen=True, eq=False)
class Option:
    """One design.

    Attributes:
        config: its robot file.
        values: what was searched, by name, SI.
        tensions: base tensions [N].
        states: solved, on the mesh it was looked at on.
        errors: of the targets. margins: of the limits.
        goal: value of the goal, SI; NaN without one.
        loss: largest share of the base tension lost while pulling, of any tendon; NaN if nothing pulls.
        converged: whether every equilibrium met its tolerance.
        lane: of the search that led to it; -1 for a robot that was not searched for.
    """

    config: RobotConfig
    values: dict[str, float]
    tensions: np.ndarray
    states: States
    errors: tuple[TargetError, ...]
    margins: tuple[Margin, ...]
    goal: float
    loss: float
    converged: bool
    lane: int = -1

    @property
    def reached(self) -> bool:
        """Whether every target is within its tolerance."""
        return self.converged and all(e.within for e in self.errors)

    @property
    def kept(self) -> bool:
        """Whether every limit is kept."""
        return all(m.kept for m in self.margins)

    @property
    def miss(self) -> float:
        """Largest error in units of its tolerance."""
        return max((e.size for e in self.errors), default=0.0)


def off_by(value: float, tolerance: float, unit: str) -> str:
    """An error in words: below a hundredth of its tolerance, only that bound is given.

    Args:
        value: of the error, not negative. tolerance: its tolerance. unit: SI, of both.
    """
    if value < NOTHING * tolerance:
        return f"less than {quantity(NOTHING * tolerance, unit, 2)}"
    return quantity(value, unit, 2 if value <= tolerance else 3)


def loads_of(problem: DesignProblem, tensions: np.ndarray):
    """The states of a problem as `states_of` takes them, for base tensions [N], (t, *tendons): those of each,
    whether each lies on the releasing branch, and the largest.
    """
    states = problem.objective.states
    T = jnp.asarray(np.asarray(tensions)[[number for number, _ in states]])
    return T, tuple(released for _, released in states), jnp.asarray(np.max(tensions))


@eqx.filter_jit
def solve(robot: Robot, T, released: tuple[bool, ...], largest) -> States:
    """The states of a robot, compiled."""
    return states_of(robot, T, released, largest)


def look_at(problem: DesignProblem, values: np.ndarray, *, resolution: float) -> Option:
    """Build a design as its file would and solve it.

    Args:
        problem: what it is a design for.
        values: coordinates of the search, SI, (c,).
        resolution: factor on the mesh.

    Raises:
        InputError: no robot has such numbers.
    """
    space = problem.space
    config = space.design(values)
    tensions = space.tensions_at(values)
    robot = on_common_mesh(space, config, resolution)
    named = {v.name: float(x) for v, x in zip(space.all, values, strict=True)}
    return judge(problem, config, robot, tensions, named)


def judge(
    problem: DesignProblem,
    config: RobotConfig,
    robot: Robot,
    tensions: np.ndarray,
    values: dict[str, float] | None = None,
) -> Option:
    """The states of any robot against the targets and limits of a problem."""
    T, released, largest = loads_of(problem, tensions)
    states = solve(robot, T, released, largest)
    pulled = [i for i, r in enumerate(released) if not r]
    shares = np.asarray(shares_of(states.T_tip, jnp.asarray(T)))[pulled]
    goal = float(goal_of(problem.objective.wanted, states) * problem.objective.wanted.goal_scale)
    if problem.target.goal is None:
        goal = float("nan")
    elif problem.target.goal.kind != "tension":
        goal = -goal
    return Option(
        config=config,
        values=values or {},
        tensions=np.asarray(tensions, float),
        states=states,
        errors=_errors(problem, states, T),
        margins=_margins(problem, robot, states, tensions),
        goal=goal,
        loss=float(1.0 - shares.min()) if pulled else float("nan"),
        converged=bool(states.converged),
    )


def _errors(problem: DesignProblem, states: States, T) -> tuple[TargetError, ...]:
    target, wanted, length = problem.target, problem.objective.wanted, problem.space.config.backbone.length
    out, nan, in_space = [], float("nan"), problem.space.config.in_space
    poses = np.asarray(states.pose)
    for i, (pose, state) in enumerate(zip(target.pose, wanted.pose_state, strict=True)):
        asked = wanted_pose(pose, in_space=in_space)
        gap = poses[state] - asked
        if not in_space:  # signed, and not reduced to a full turn
            turned = float(gap[ANGLE])
        else:
            turned = float(turn(gap, direction=pose.turn != "rotation"))
        out.append(
            TargetError(
                f"pose[{i}]",
                pull_at(T, state),
                pose.branch,
                tuple(asked.tolist()),
                tuple(poses[state].tolist()),
                float(distance(gap)),
                turned,
                pose.near(length),
                pose.angle_tolerance,
            )
        )
    done = 0
    rest = [nan] * (poses.shape[-1] - wanted.point.shape[-1])
    for i, shape in enumerate(target.shape):
        state = wanted.point_state[done]
        done += len(shape.points)
        there = np.array([np.asarray(point_at(states, state, jnp.asarray(p[0]))) for p in shape.points])
        off = np.linalg.norm(there - np.asarray(shape.points)[:, 1:], axis=1)
        worst = int(np.argmax(off))
        out.append(
            TargetError(
                f"shape[{i}]",
                pull_at(T, state),
                shape.branch,
                (*shape.points[worst][1:], *rest),
                (*there[worst].tolist(), *rest),
                float(off[worst]),
                nan,
                shape.near(length),
                nan,
            )
        )
    return tuple(out)


def pull_at(T, state: int) -> Pull:
    """The base tensions of one state [N]: a number, or of several tendons one for each."""
    pull = np.asarray(T)[state].tolist()
    return tuple(pull) if isinstance(pull, list) else pull


def _margins(
    problem: DesignProblem, robot: Robot, states: States, tensions: np.ndarray
) -> tuple[Margin, ...]:
    own, given, body = problem.target.limits, problem.objective.given, robot.backbone
    channels = L.all_stations(robot, PLACES)
    s = np.concatenate([at.s for at in channels])
    away = np.concatenate([at.away for at in channels])
    edge, nan = 0.5 * own.channel_diameter, float("nan")
    out = []

    def least(name: str, values: np.ndarray, limit: float, unit: str, places: Any = s) -> None:
        worst = int(np.argmin(values))
        where = nan if places is None else float(places[worst])
        out.append(Margin(name, float(values[worst]), limit, float(values[worst]) - limit, unit, where))

    def most(name: str, values: np.ndarray, limit: float, unit: str, places: Any = s) -> None:
        worst = int(np.argmax(values))
        where = nan if places is None else float(places[worst])
        out.append(Margin(name, float(values[worst]), limit, limit - float(values[worst]), unit, where))

    least(L.WALL, np.asarray(body.radius(jnp.asarray(s))) - away - edge, own.wall_clearance, "m")
    if L.BORE in given:
        apart = away - 0.5 * np.asarray(body.bore_diameter)[:, None] - edge
        bored = np.concatenate([at.bored for at in channels], axis=1)
        least(L.BORE, np.where(bored, apart, np.inf).min(axis=0), own.bore_clearance, "m")
    if L.APART in given:
        pairs = list(itertools.combinations(channels, 2))
        gaps = np.concatenate([np.asarray(L.channel_gap(*pair)) for pair in pairs]) - own.channel_diameter
        least(L.APART, gaps, own.channel_clearance, "m", np.concatenate([one.s for one, _ in pairs]))
    if L.OBSTACLE in given:
        apart = np.asarray(obstacle_gaps(robot, states, problem.objective.obstacles))
        nearest = apart.min(axis=(0, 1))
        least(L.OBSTACLE, nearest, own.obstacle_clearance, "m", np.asarray(states.s)[1:])
    if own.min_channel_radius is not None:
        bend = np.abs(np.concatenate([L.channel_curvature(robot, at) for at in channels]))
        least(L.RADIUS, 1.0 / np.maximum(bend, 1e-6), own.min_channel_radius, "m")
    for name, place, limit in (
        (L.BASE_SLOPE, np.argmin, own.max_base_slope),
        (L.TIP_SLOPE, np.argmax, own.max_tip_slope),
    ):
        if limit is not None:
            ends = [(at, int(place(at.s))) for at in channels]
            slope = np.array([float(at.slant[end]) for at, end in ends])
            most(name, slope, limit, "rad", np.array([float(at.s[end]) for at, end in ends]))
    released = np.asarray([r for _, r in problem.objective.states])
    if own.max_tension_loss is not None and not np.all(released):
        share = np.asarray(shares_of(states.T_tip, states.T_base))[~released]
        most(L.LOSS, 1.0 - share.ravel(), own.max_tension_loss, "", None)
    if own.min_T_tip is not None:
        least(L.TIP, np.asarray(states.T_tip).ravel(), own.min_T_tip, "N", None)
    if L.WAVE in given:
        kinks = [np.asarray(tendon.routing.kinks()) for tendon in robot.tendons]
        waves = np.concatenate([ends[1:] - ends[:1] for ends in kinks])
        least(L.WAVE, waves, L.LEAST_WAVE * float(body.length), "m", None)
    if L.RELEASE in given:
        others = [tensions[number] for number, _ in problem.objective.states if number != len(tensions) - 1]
        least(L.RELEASE, np.asarray(tensions[-1:], float), float(max(others)), "N", None)
    if own.max_T_base is not None:
        most("max_T_base", np.ravel(np.asarray(tensions, float)), own.max_T_base, "N", None)
    return tuple(out)
