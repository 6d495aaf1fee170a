"""From the robot and target files to the problem to compute with."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from gtr_jax.config.config import RobotConfig
from gtr_jax.robot.parameters import parameters_of, places_of
from gtr_jax.robot.robot import Robot
from gtr_jax.robot.stiffness import stiffness_of

from . import limits as L
from .checks import check_search, check_target
from .objective import Objective, Wanted
from .obstacles import Obstacles
from .pose import DIRECTION, PLANE, SPACE
from .space import Space, build_space, wave_ends, with_family
from .target import Goal, PoseTarget, TargetConfig
from .tensions import pull_of
from .uncertainty import Uncertainty, uncertainty_of

RESOLUTION = 0.5  # factor on the default mesh, for the search
# Stations of the channel, at least: in all, and for each half wave.
STATIONS, PER_HALF_WAVE = 65, 40
ANY_LOSS = 2.0  # limit on the share of tension lost that no design comes near
UTOPIA = {"reach": -1.0, "bend": -2.0 * np.pi, "tension": 0.0}  # of the goal over its scale


@dataclasses.dataclass(frozen=True, eq=False)
class DesignProblem:
    """A design problem: the files, the space, what is not known, and the numbers to compute with."""

    target: TargetConfig
    space: Space
    uncertainty: Uncertainty
    objective: Objective


def problem_of(config: RobotConfig, target: TargetConfig, *, resolution: float = RESOLUTION) -> DesignProblem:
    """Check the two files against each other and set the problem up.

    Args:
        config: robot file.
        target: target file.
        resolution: factor on the mesh of the search.

    Raises:
        InputError: with file, key and remedy.
    """
    check_search(target)
    config = with_family(config, target)
    check_target(target, config)
    space = build_space(config, target, resolution=resolution)
    robot = space.robot
    robot = robot.with_values(**{v.name: float(robot.value(v.name)) for v in space.variables})
    space = dataclasses.replace(space, robot=robot)
    known = uncertainty_of(config, target)
    states = states_asked_for(target, space)
    given = limits_given(target, space)
    draws, shares = known.points(target.robust.optimise, target.robust.deviations)
    variables = [v.name for v in space.variables]
    uncertain = uncertain_in(robot)
    objective = Objective(
        robot=robot,
        index=places_of(robot, variables) if variables else jnp.zeros(0, dtype=int),
        lower=jnp.asarray(space.lower),
        upper=jnp.asarray(space.upper),
        tensions=jnp.asarray(space.tensions, dtype=float),
        wanted=_wanted(target, space, states),
        limits=_limit_values(target),
        active=jnp.ones(len(given)),
        draws=jnp.asarray(draws),
        shares=jnp.asarray(shares),
        uncertain=places_of(robot, list(uncertain)),
        obstacles=_obstacles(target, 3 if config.in_space else 2),
        deviates=tuple(uncertain.values()),
        free=tuple(v.place for v in space.free_tensions),
        states=states,
        given=given,
        spread=target.robust.optimise,
        stations=_stations(space),
    )
    return DesignProblem(target, space, known, objective)


def states_asked_for(target: TargetConfig, space: Space) -> tuple[tuple[int, bool], ...]:
    """Number of the tension and whether on the releasing branch, of every state that is asked for; where any
    is a release, the pull before it too.
    """
    asked = []
    for load in target.loads:
        if load.T_base is not None:
            number = space.tensions.index(pull_of(space.config, load.T_base))
            asked.append((number, load.branch == "releasing"))
    if any(released for _, released in asked):
        asked.append((len(space.tensions) - 1, False))
    if target.goal is not None and target.goal.kind == "tension" and not asked:
        asked.append((len(space.tensions) - 1, False))
    return tuple(sorted(set(asked)))


def _stations(space: Space) -> int:
    own = [float(getattr(tendon.routing, "n_sine", 0.0)) for tendon in space.robot.tendons]
    waves = max(space.choices, default=0.0) or max(own)
    wanted = max(STATIONS - 1, int(np.ceil(PER_HALF_WAVE * waves)), *map(_for_turns, _turns(space)))
    knots = [len(routing.knots) for _, _, routing in space.config.strung if hasattr(routing, "knots")]
    if knots:
        pieces = max(knots) - 1
        wanted = int(np.ceil(wanted / pieces)) * pieces
    return wanted + 1


def _turns(space: Space) -> list[float]:
    """The most turns about the axis that each helix may take; 0 without one."""
    bounds = {v.name: max(abs(v.lower), abs(v.upper)) for v in space.variables}
    names = [name for name in parameters_of(space.robot) if name.partition(".")[0] == "turns"]
    return [0.0, *(bounds.get(name, abs(float(space.robot.value(name)))) for name in names)]


def _for_turns(turns: float) -> int:
    return int(np.ceil(2.0 * PER_HALF_WAVE * turns)) if turns > 1.0 else 0


def limits_given(target: TargetConfig, space: Space) -> tuple[str, ...]:
    """Names of the limits that are looked at."""
    own = target.limits
    given = [L.WALL]
    if space.config.backbone.bores:
        given.append(L.BORE)
    if space.config.tendons:
        given.append(L.APART)
    if target.obstacle:
        given.append(L.OBSTACLE)
    given += [
        name
        for name in (L.RADIUS, L.BASE_SLOPE, L.TIP_SLOPE, L.LOSS, L.TIP)
        if getattr(own, name) is not None
    ]
    if space.free_tensions and any(load.branch == "releasing" for load in target.loads):
        given.append(L.RELEASE)
    if wave_ends(v.name for v in space.variables):
        given.append(L.WAVE)
    if L.LOSS not in given and target.goal is None and target.robust.optimise == "nominal":
        given.append(L.LOSS)  # for `least_loss`, which sets it
    return tuple(given)


def _limit_values(target: TargetConfig) -> L.LimitValues:
    own = target.limits

    def number(value: float | None):
        return jnp.asarray(0.0 if value is None else value, dtype=float)

    edge = 0.5 * own.channel_diameter
    return L.LimitValues(
        wall=number(own.wall_clearance + edge),
        bore=number(own.bore_clearance + edge),
        apart=number(own.channel_clearance + own.channel_diameter),
        obstacle=number(own.obstacle_clearance),
        radius=number(own.min_channel_radius),
        loss=number(ANY_LOSS if own.max_tension_loss is None else own.max_tension_loss),
        tip=number(own.min_T_tip),
        base_slope=number(own.max_base_slope),
        tip_slope=number(own.max_tip_slope),
    )


def _wanted(target: TargetConfig, space: Space, states: tuple[tuple[int, bool], ...]) -> Wanted:
    length, in_space = space.config.backbone.length, space.config.in_space
    axes, size = (3, SPACE) if in_space else (2, PLANE)

    def state(load) -> int:
        number = space.tensions.index(pull_of(space.config, load.T_base))
        return states.index((number, load.branch == "releasing"))

    # Weights over the least of them: a design whose sum of squares counts as arrived is then within every
    # tolerance.
    least = min((t.weight for t in (*target.pose, *target.shape)), default=1.0)
    pose, scale = np.zeros((len(target.pose), size)), np.zeros((len(target.pose), size))
    for i, p in enumerate(target.pose):
        weight = np.sqrt(p.weight / least)
        wanted = wanted_pose(p, in_space=in_space)
        asked = np.isfinite(wanted)
        pose[i, asked] = wanted[asked]
        scale[i, :axes] = weight / p.near(length)
        scale[i, axes:] = weight / (p.angle_tolerance * (np.sqrt(2.0) if p.turn == "rotation" else 1.0))
        scale[i, ~asked] = 0.0
    points, point_scale, point_state = [], [], []
    for shape in target.shape:
        points += shape.points
        point_scale += [np.sqrt(shape.weight / least) / shape.near(length)] * len(shape.points)
        point_state += [state(shape)] * len(shape.points)
    at = np.asarray(points, float).reshape(-1, 1 + axes)
    goal = target.goal
    if (
        goal is not None
    ):  # with a goal, a target is kept in x, y (and z) separately: a square within its circle
        scale[:, :axes] *= np.sqrt(axes)
        point_scale = [np.sqrt(axes) * v for v in point_scale]
        if in_space:  # likewise the entries of a direction, or of a rotation
            scale[:, axes:] *= 3.0
    sizes = {"reach": length, "bend": 1.0, "tension": np.max(space.tensions)}
    own = state(goal) if goal is not None and goal.T_base is not None else 0
    return Wanted(
        pose=jnp.asarray(pose),
        pose_scale=jnp.asarray(scale),
        point_s=jnp.asarray(at[:, 0]),
        point=jnp.asarray(at[:, 1:]),
        point_scale=jnp.asarray(np.asarray(point_scale, float)),
        utopia=jnp.asarray(UTOPIA[goal.kind] if goal else 0.0),
        direction=jnp.asarray(_heading(goal, in_space=in_space)),
        goal_scale=jnp.asarray(sizes[goal.kind] if goal else 1.0, dtype=float),
        pose_state=tuple(state(p) for p in target.pose),
        point_state=tuple(point_state),
        goal=goal.kind if goal else "",
        goal_state=own,
    )


def wanted_pose(pose: PoseTarget, *, in_space: bool) -> np.ndarray:
    """What a pose asks for, as `pose` has it, NaN where it asks for nothing."""
    if not in_space:
        nothing = (np.nan, np.nan)
        return np.array([*(pose.tip or nothing), np.nan if pose.angle is None else pose.angle])
    wanted = np.full(SPACE, np.nan)
    if pose.tip is not None:
        wanted[:3] = pose.tip
    if pose.direction is not None:
        wanted[DIRECTION] = np.asarray(pose.direction) / np.linalg.norm(pose.direction)
    if pose.rotation is not None:
        wanted[3:] = Rotation.from_rotvec(pose.rotation).as_matrix().ravel()
    return wanted


def _heading(goal: Goal | None, *, in_space: bool) -> np.ndarray:
    """Direction of a goal: an angle in the plane [rad], a unit vector in space."""
    said = goal.direction if goal else 0.0
    if not in_space:
        return np.asarray(said, float)
    vector = np.asarray(said if isinstance(said, tuple) else (np.cos(said), np.sin(said), 0.0), float)
    return vector / np.linalg.norm(vector)


def _obstacles(target: TargetConfig, axes: int) -> Obstacles:
    ends = [(o.at, o.at if o.to is None else o.to) for o in target.obstacle]
    both = np.asarray(ends, float).reshape(-1, 2, axes)
    radius = np.asarray([o.radius for o in target.obstacle], float)
    return Obstacles(jnp.asarray(both[:, 0]), jnp.asarray(both[:, 1]), jnp.asarray(radius))


def uncertain_in(robot: Robot) -> dict[str, int]:
    """The friction coefficients of a robot, and the numbers that say how stiff it is, by name: which of the
    two deviations of `Uncertainty` each has.
    """
    friction = [name for name in parameters_of(robot) if name.partition(".")[0] == "mu"]
    return {**dict.fromkeys(friction, 0), **dict.fromkeys(stiffness_of(robot), 1)}
