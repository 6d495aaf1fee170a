"""The design problem as numbers to compute with: residuals of the targets, the goal, and the margins of the
limits, as functions of the coordinates of the search.

The coordinates z run from 0 to 1 between the bounds. Residuals are in units of the tolerances.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from gtr_jax.robot.robot import Robot
from gtr_jax.robot.routing import StraightSineStraight
from gtr_jax.simulation.programs import terms_act

from .limits import (
    LEAST_WAVE,
    LOSS,
    OBSTACLE,
    RELEASE,
    TIP,
    LimitValues,
    all_stations,
    channel_margins,
)
from .model import States, states_of
from .obstacles import Obstacles, gaps
from .pose import ANGLE

NEAR = 0.9  # of its tolerance, within which a target is kept where there is a goal


class Wanted(eqx.Module):
    """What the targets ask for, of P poses and Q points.

    Attributes:
        pose: as `pose` has it, (P, pose); any number where not asked for.
        pose_scale: 1/tolerance times the root of the weight, (P, pose); 0 where not asked for. Of the nine
            entries of a rotation, 1/sqrt(2) of it.
        pose_state: state of each pose (static).
        point_s: arc length of the points [m], (Q,). point: where they are to be [m], (Q, axes).
        point_scale: as of poses, (Q,). point_state: state of each (static).
        direction: of the goal [rad], (); in space a unit vector, (3,).
        goal_scale: size of the goal that counts as 1: m, rad or N, ().
        utopia: value of the goal, over its scale, that no design exceeds, ().
        goal: "reach", "bend", "tension" or "" (static). goal_state: its state (static).
    """

    pose: Float[Array, "P pose"]
    pose_scale: Float[Array, "P pose"]
    point_s: Float[Array, " Q"]
    point: Float[Array, "Q axes"]
    point_scale: Float[Array, " Q"]
    direction: Float[Array, "*axes"]
    goal_scale: Float[Array, ""]
    pose_state: tuple[int, ...] = eqx.field(static=True)
    point_state: tuple[int, ...] = eqx.field(static=True)
    utopia: Float[Array, ""]
    goal: str = eqx.field(static=True)
    goal_state: int = eqx.field(static=True)


class Objective(eqx.Module):
    """What designs are judged by, as numbers.

    Attributes:
        robot: the template. index: places of the p numbers that change in it, flattened, (p,).
        lower, upper: bounds of all coordinates, SI, (p+q,).
        tensions: base tensions of the file, increasing [N], (t, *tendons).
        free: which of them, flattened, are coordinates (static), q of them.
        states: number of the tension, and whether on the releasing branch, of each state (static).
        wanted: the targets. limits: the numbers of the limits.
        given: which limits are checked (static). active: 1 for each limit in force, 0 for one put aside,
            (k,).
        draws: relative deviations of friction coefficient and modulus for which a design is evaluated, (D,
            2).
        shares: weight of each, (D,).
        uncertain: places in the robot of the friction coefficients and of the modulus, (u,).
        deviates: which of the two deviations each of them has (static).
        obstacles: what the body must not touch.
        spread: "nominal", "expected" or "worst" (static).
        stations: places at which the channel is looked at (static).
    """

    robot: Robot
    index: Int[Array, " p"]
    lower: Float[Array, " c"]
    upper: Float[Array, " c"]
    tensions: Float[Array, "t *tendons"]
    wanted: Wanted
    limits: LimitValues
    active: Float[Array, " k"]
    draws: Float[Array, "D 2"]
    shares: Float[Array, " D"]
    uncertain: Int[Array, " u"]
    obstacles: Obstacles
    deviates: tuple[int, ...] = eqx.field(static=True)
    free: tuple[int, ...] = eqx.field(static=True)
    states: tuple[tuple[int, bool], ...] = eqx.field(static=True)
    given: tuple[str, ...] = eqx.field(static=True)
    spread: str = eqx.field(static=True)
    stations: int = eqx.field(static=True)

    @property
    def with_terms(self) -> bool:
        """Whether physics terms act."""
        return terms_act(self.robot)


class Evaluation(NamedTuple):
    """One design, judged.

    residuals: in units of the tolerances, (m,); with a goal, its distance from utopia, (1,), while the
    targets become margins. goal: the smaller the better, about 1, (). margins: of the limits in their scales,
    (K,), those put aside far away. pose: of the states, (S, pose). T_tip: (S, *tendons).
    converged: ().
    """

    residuals: Float[Array, " m"]
    goal: Float[Array, ""]
    margins: Float[Array, " K"]
    pose: Float[Array, "S pose"]
    T_tip: Float[Array, "S *tendons"]
    converged: Bool[Array, ""]


def robot_of(objective: Objective, z: Float[Array, " c"]) -> Robot:
    """The robot of a design."""
    flat, unravel = ravel_pytree(objective.robot)
    values = objective.lower + z * (objective.upper - objective.lower)
    robot = unravel(flat.at[objective.index].set(values[: objective.index.shape[0]]))
    return _in_order(robot)


def _in_order(robot: Robot) -> Robot:
    """Give a wave that would end before it begins a least length; a separate limit keeps designs away from
    this.
    """
    for i, tendon in enumerate(robot.tendons):
        routing = tendon.routing
        if isinstance(routing, StraightSineStraight):
            least = routing.w1 + 0.5 * LEAST_WAVE * robot.backbone.length
            w2 = jnp.where(routing.w2 < least, least, routing.w2)
            robot = eqx.tree_at(lambda r, i=i: r.tendons[i].routing.w2, robot, w2)
    return robot


def tensions_of(objective: Objective, z: Float[Array, " c"]) -> Float[Array, "t *tendons"]:
    """Base tensions of a design [N], (t, *tendons)."""
    if not objective.free:
        return objective.tensions
    values = objective.lower + z * (objective.upper - objective.lower)
    flat = objective.tensions.ravel()
    flat = flat.at[jnp.asarray(objective.free)].set(values[objective.index.shape[0] :])
    return flat.reshape(objective.tensions.shape)


def solve_states(objective: Objective, robot: Robot, tensions: Float[Array, "t *tendons"]) -> States:
    """The states of a design."""
    T = tensions[jnp.asarray([number for number, _ in objective.states])]
    released = tuple(r for _, r in objective.states)
    return states_of(robot, T, released, jnp.max(tensions))


def errors_of(wanted: Wanted, states: States) -> Float[Array, " m"]:
    """Residuals of all targets in units of their tolerances: poses, then points."""
    parts = []
    if wanted.pose_state:
        pose = states.pose[jnp.asarray(wanted.pose_state)]
        parts.append(((pose - wanted.pose) * wanted.pose_scale).ravel())
    if wanted.point_state:
        at = jnp.asarray(wanted.point_state)
        there = jax.vmap(lambda i, s: point_at(states, i, s))(at, wanted.point_s)
        parts.append(((there - wanted.point) * wanted.point_scale[:, None]).ravel())
    return jnp.concatenate(parts) if parts else jnp.zeros(0)


def point_at(states: States, i, s) -> Float[Array, " axes"]:
    """The midline of state i at arc length s [m]: a cubic between the nodes, with their directions."""
    node = jnp.clip(jnp.searchsorted(states.s, s, side="left"), 1, states.s.shape[0] - 1)
    start, end = states.s[node - 1], states.s[node]
    h = jnp.where(end > start, end - start, 1.0)
    u = jnp.clip((s - start) / h, 0.0, 1.0)

    values, slopes = states.midline[i], states.tangent[i]
    a, b, da, db = values[node - 1], values[node], slopes[node - 1], slopes[node]
    rise = u * u * (3.0 - 2.0 * u)
    return a + (b - a) * rise + h * u * (1.0 - u) * (da * (1.0 - u) - db * u)


def goal_of(wanted: Wanted, states: States) -> Float[Array, ""]:
    """What is to be made small, about 1; 0 without a goal."""
    if not wanted.goal:
        return jnp.zeros(())
    pose = states.pose[wanted.goal_state]
    if wanted.goal == "reach" and states.shape is not None:
        value = -jnp.sum(pose[:3] * wanted.direction)
    elif wanted.goal == "reach":
        value = -(pose[0] * jnp.cos(wanted.direction) + pose[1] * jnp.sin(wanted.direction))
    elif wanted.goal == "bend" and states.shape is not None:
        value = -_angle_between(*states.tangent[wanted.goal_state, jnp.asarray([0, -1])])
    elif wanted.goal == "bend":
        value = -jnp.sqrt(pose[ANGLE] ** 2 + 1e-8)
    else:
        value = jnp.max(states.T_base)
    return value / wanted.goal_scale


def _angle_between(one: Float[Array, "3"], other: Float[Array, "3"]) -> Float[Array, ""]:
    """Angle between two unit vectors [rad], rounded off at 0 as the bend in the plane is."""
    across = jnp.cross(one, other)
    return jnp.arctan2(jnp.sqrt(jnp.sum(across**2) + 1e-8), jnp.sum(one * other))


def shares_of(T_tip: Float[Array, "*S"], T_base: Float[Array, "*S"]) -> Float[Array, "*S"]:
    """Share of the base tension that reaches the tip; 1 of a tendon that is not pulled."""
    return jnp.where(T_base > 0, T_tip / jnp.where(T_base > 0, T_base, 1.0), 1.0)


def state_margins(objective: Objective, robot: Robot, states: States) -> dict[str, Float[Array, " _"]]:
    """Margins of the limits on tensions and on the deformed body, by limit."""
    margins = load_margins(objective, states)
    if OBSTACLE in objective.given:
        size = jnp.max(robot.backbone.outer_radius)
        apart = gaps(robot, states, objective.obstacles)
        margins[OBSTACLE] = ((apart - objective.limits.obstacle) / size).ravel()
    return margins


def load_margins(objective: Objective, states: States) -> dict[str, Float[Array, " _"]]:
    """Margins of the limits on tensions, by limit."""
    margins = {}
    pulled = jnp.asarray([i for i, (_, released) in enumerate(objective.states) if not released], dtype=int)
    if LOSS in objective.given:
        arrives = shares_of(states.T_tip[pulled], states.T_base[pulled])
        margins[LOSS] = (arrives - (1.0 - objective.limits.loss)).ravel()
    if TIP in objective.given:
        margins[TIP] = ((states.T_tip - objective.limits.tip) / jnp.max(objective.tensions)).ravel()
    if (
        RELEASE in objective.given
    ):  # from the last tension, which with all of them free has to stay the largest
        last = objective.tensions.shape[0] - 1
        others = jnp.asarray([i for i, (number, _) in enumerate(objective.states) if number != last])
        top = states.T_base[objective.states.index((last, False))]
        margins[RELEASE] = (top - states.T_base[others]) / jnp.max(objective.tensions)
    return margins


def evaluate(objective: Objective, z: Float[Array, " c"]) -> Evaluation:
    """Judge one design.

    Args:
        objective: the problem.
        z: coordinates in [0, 1], (c,).
    """
    robot, tensions = robot_of(objective, z), tensions_of(objective, z)
    states = solve_states(objective, robot, tensions)
    margins = channel_margins(
        robot, all_stations(robot, objective.stations), objective.limits, objective.given
    )
    margins |= state_margins(objective, robot, states)
    rows = [
        margins[name] * objective.active[i] + (1.0 - objective.active[i])
        for i, name in enumerate(objective.given)
        if name in margins
    ]
    errors, goal, ok = (
        errors_of(objective.wanted, states),
        goal_of(objective.wanted, states),
        states.converged,
    )
    nominal = errors
    if objective.spread != "nominal":
        errors, goal, ok = _spread(objective, robot, tensions)
    if objective.wanted.goal:
        rows += [NEAR - nominal, NEAR + nominal] if nominal.shape[0] else []
        errors = (goal - objective.wanted.utopia)[None]
    return Evaluation(errors, goal, jnp.concatenate(rows), states.pose, states.T_tip, ok)


def at_draw(objective: Objective, robot: Robot, draw: Float[Array, "2"]) -> Robot:
    """The robot with its friction coefficients and its modulus off by relative steps."""
    flat, unravel = ravel_pytree(robot)
    return unravel(flat.at[objective.uncertain].multiply(1.0 + draw[jnp.asarray(objective.deviates)]))


def _spread(objective: Objective, robot: Robot, tensions):
    """Residuals and goal over the draws of friction and modulus, and whether all converged."""

    def one(draw):
        states = solve_states(objective, at_draw(objective, robot, draw), tensions)
        return errors_of(objective.wanted, states), goal_of(objective.wanted, states), states.converged

    errors, goals, ok = (
        jax.lax.map(one, objective.draws) if objective.with_terms else jax.vmap(one)(objective.draws)
    )
    if objective.spread == "expected":
        return (
            (jnp.sqrt(objective.shares)[:, None] * errors).ravel(),
            jnp.sum(objective.shares * goals),
            jnp.all(ok),
        )
    worst = jnp.max(jnp.sqrt(jnp.sum(errors**2, axis=1) + 1e-12))
    return worst[None], jnp.max(goals), jnp.all(ok)
