"""From the robot and target files to the problem to compute with."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np

from gtr_jax.files.config import RobotConfig
from gtr_jax.robot.parameters import places_of

from . import limits as L
from .checks import check_target
from .objective import Objective, Wanted
from .space import Space, build_space
from .target import TargetConfig
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
        config: robot file, of one tendon.
        target: target file.
        resolution: factor on the mesh of the search.

    Raises:
        InputError: with file, key and remedy.
    """
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
        uncertain=places_of(robot, ["mu", "E"]),
        free=tuple(space.tensions.index(v.start) for v in space.free_tensions),
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
            asked.append((space.tensions.index(load.T_base), load.branch == "releasing"))
    if any(released for _, released in asked):
        asked.append((len(space.tensions) - 1, False))
    if target.goal is not None and target.goal.kind == "tension" and not asked:
        asked.append((len(space.tensions) - 1, False))
    return tuple(sorted(set(asked)))


def _stations(space: Space) -> int:
    waves = max(space.choices, default=0.0) or float(getattr(space.robot.routing, "n_sine", 0.0))
    wanted = max(STATIONS - 1, int(np.ceil(PER_HALF_WAVE * waves)))
    if space.config.routing.kind == "table":
        pieces = len(space.config.routing.knots) - 1
        wanted = int(np.ceil(wanted / pieces)) * pieces
    return wanted + 1


def limits_given(target: TargetConfig, space: Space) -> tuple[str, ...]:
    """Names of the limits that are looked at."""
    own = target.limits
    given = [L.WALL]
    if space.config.backbone.bores:
        given.append(L.BORE)
    given += [
        name
        for name in (L.RADIUS, L.BASE_SLOPE, L.TIP_SLOPE, L.LOSS, L.TIP)
        if getattr(own, name) is not None
    ]
    if space.free_tensions and any(load.branch == "releasing" for load in target.loads):
        given.append(L.RELEASE)
    if {"w1", "w2"} & {v.name for v in space.variables}:
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
        radius=number(own.min_channel_radius),
        loss=number(ANY_LOSS if own.max_tension_loss is None else own.max_tension_loss),
        tip=number(own.min_T_tip),
        base_slope=number(own.max_base_slope),
        tip_slope=number(own.max_tip_slope),
    )


def _wanted(target: TargetConfig, space: Space, states: tuple[tuple[int, bool], ...]) -> Wanted:
    length = space.config.backbone.length

    def state(load) -> int:
        return states.index((space.tensions.index(load.T_base), load.branch == "releasing"))

    # Weights over the least of them: a design whose sum of squares counts as arrived is then within every
    # tolerance.
    least = min((t.weight for t in (*target.pose, *target.shape)), default=1.0)
    pose, scale = np.zeros((len(target.pose), 3)), np.zeros((len(target.pose), 3))
    for i, p in enumerate(target.pose):
        if p.tip is not None:
            pose[i, :2], scale[i, :2] = p.tip, np.sqrt(p.weight / least) / p.near(length)
        if p.angle is not None:
            pose[i, 2], scale[i, 2] = p.angle, np.sqrt(p.weight / least) / p.angle_tolerance
    points, point_scale, point_state = [], [], []
    for shape in target.shape:
        points += shape.points
        point_scale += [np.sqrt(shape.weight / least) / shape.near(length)] * len(shape.points)
        point_state += [state(shape)] * len(shape.points)
    at = np.asarray(points, float).reshape(-1, 3)
    goal = target.goal
    if goal is not None:  # with a goal, a target is kept in x and y separately: a square within its circle
        scale[:, :2] *= np.sqrt(2.0)
        point_scale = [np.sqrt(2.0) * v for v in point_scale]
    sizes = {"reach": length, "bend": 1.0, "tension": max(space.tensions)}
    own = state(goal) if goal is not None and goal.T_base is not None else 0
    return Wanted(
        pose=jnp.asarray(pose),
        pose_scale=jnp.asarray(scale),
        point_s=jnp.asarray(at[:, 0]),
        point=jnp.asarray(at[:, 1:]),
        point_scale=jnp.asarray(np.asarray(point_scale, float)),
        utopia=jnp.asarray(UTOPIA[goal.kind] if goal else 0.0),
        direction=jnp.asarray(goal.direction if goal else 0.0, dtype=float),
        goal_scale=jnp.asarray(sizes[goal.kind] if goal else 1.0, dtype=float),
        pose_state=tuple(state(p) for p in target.pose),
        point_state=tuple(point_state),
        goal=goal.kind if goal else "",
        goal_state=own,
    )
