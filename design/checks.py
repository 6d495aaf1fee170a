"""What can be wrong with a target for a robot, and the one line that says so.

These are only the checks that need no search: whether an arm of this length could be there at all, and
whether the file asks for two things at once.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import NoReturn

import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import InputError, did_you_mean
from gtr_jax.units import to_si

from .checks_in_space import check_axes, check_pulls
from .target import FAMILIES, Goal, PoseTarget, ShapeTarget, TargetConfig

FINEST = 1e-5  # finest tolerance, of the length or in rad: meshes are not more exact
# Turns of the tip, and half waves of the channel, beyond which the file must be mistaken.
MOST_TURNS, MOST_WAVES = 2, 100


def check_search(target: TargetConfig) -> None:
    """Refuse a search that makes no sense for any robot; InputError with file, key and remedy."""
    _check_search(target, _refusal(target))


def _refusal(target: TargetConfig) -> Callable[[str, str], NoReturn]:
    def refuse(key: str, says: str) -> NoReturn:
        raise InputError(f"{target.source}: {key}: {says}")

    return refuse


def check_target(target: TargetConfig, robot: RobotConfig) -> None:
    """Refuse a target that no search can meet or that means nothing; InputError with file, key and remedy.

    Args:
        target: its search is checked already.
        robot: its channel of the family that is searched.
    """
    refuse = _refusal(target)
    if robot.backbone.rigid:
        raise InputError(
            f"{robot.source}: backbone.rigid: a sheath of fixed shape reaches no target; give it a "
            "youngs_modulus instead"
        )
    if not target.loads:
        refuse(
            "pose", 'nothing is asked for; add [[pose]] with T_base = "45 N" and tip = ["180 mm", "95 mm"]'
        )
    check_axes(target, robot, refuse)
    check_pulls(target, robot, refuse)
    shortest, length = _lengths(target, robot)
    base = np.asarray(robot.base.position[: 3 if robot.in_space else 2])
    for i, pose in enumerate(target.pose):
        _check_pose(f"pose[{i}]", pose, length, base, refuse)
    for i, shape in enumerate(target.shape):
        _check_shape(f"shape[{i}]", shape, (shortest, length), base, refuse)
    _check_contradictions(target, length, refuse)
    if target.goal is not None:
        _check_goal(target.goal, target, refuse)
    if not robot.tendons:
        _check_tensions(target, robot, refuse)
    _check_limits(target, robot, refuse)


def _mm(value: float) -> str:
    return f"{1e3 * value:.6g} mm"


def _lengths(target: TargetConfig, robot: RobotConfig) -> tuple[float, float]:
    """Least and largest length [m] that the arm may have."""
    search, own = target.search, robot.backbone.length
    names = {"length", "backbone.length"}
    given = next((search.bounds[name] for name in names if name in search.bounds), None)
    if given is None or not names & {*search.free, *(search.routing or ())}:
        return own, own
    lower, upper = (to_si(value, "m", f"{target.source}: search.bounds.length") for value in given)
    return lower, upper


def _check_pose(key: str, pose: PoseTarget, length: float, base: np.ndarray, refuse) -> None:
    if pose.tip is None and pose.turn is None:
        refuse(key, 'asks for nothing; give tip = ["180 mm", "95 mm"], angle = "55 deg", or both')
    _check_numbers(key, pose, length, refuse)
    turn = "direction" if len(base) == 3 else "angle"
    for name, of, given in (
        ("tip_tolerance", "tip", pose.tip),
        ("angle_tolerance", turn, pose.turn),
    ):
        if name in pose.model_fields_set and given is None:
            refuse(f"{key}.{name}", f"has no effect without {of}; add it or leave {name} out")
    away = 0.0 if pose.tip is None else math.dist(pose.tip, base)
    if pose.tip is not None and away > length + pose.near(length):
        refuse(
            f"{key}.tip",
            f"lies {_mm(away)} from the base, out of reach of an arm of {_mm(length)}; "
            "bring it nearer or lengthen the arm",
        )
    if pose.angle is not None and abs(pose.angle) > MOST_TURNS * 2 * math.pi:
        refuse(
            f"{key}.angle",
            f"{pose.angle:g} rad are {pose.angle / (2 * math.pi):.3g} turns; if degrees are meant, write "
            f'"{pose.angle:g} deg"',
        )
    if pose.tip is not None and pose.angle is not None:
        _check_chord(key, pose.tip, pose.angle, length, refuse)


def _check_numbers(key: str, load: PoseTarget | ShapeTarget, length: float, refuse) -> None:
    """Weight and tolerances: positive, and no finer than a design can be verified."""
    for name in ("tip_tolerance", "angle_tolerance", "tolerance", "weight"):
        value = getattr(load, name, None)
        if value is not None and value <= 0:
            refuse(f"{key}.{name}", f"must be positive, is {value:g}; correct it or leave it out")
        finest = {"weight": 0.0, "angle_tolerance": FINEST}.get(name, FINEST * length)
        if value is not None and value < finest:
            word = f"{FINEST:g} rad" if name == "angle_tolerance" else _mm(finest)
            refuse(f"{key}.{name}", f"is finer than what can be verified; give no less than {word}")


def _check_chord(key: str, tip, angle: float, length: float, refuse) -> None:
    """Only a straight arm reaches as far as it is long; other impossible poses are left to the search."""
    if math.hypot(*tip) > length * (1 - 1e-6) and abs(angle) > 0.02:
        refuse(
            f"{key}.angle",
            f"{math.degrees(angle):.3g} deg, but only a straight arm reaches a tip {_mm(math.hypot(*tip))} "
            "away, at 0 deg; change one of the two",
        )


def _check_shape(
    key: str, shape: ShapeTarget, lengths: tuple[float, float], base: np.ndarray, refuse
) -> None:
    shortest, length = lengths
    if not shape.points:
        refuse(f"{key}.points", 'is empty; give [["125 mm", "120 mm", "20 mm"]], each [s, x, y]')
    _check_numbers(key, shape, length, refuse)
    last, near = (0.0, *base), 0.0
    for i, point in enumerate(shape.points):
        place = f"{key}.points[{i}]"
        if not 0 < point[0] <= shortest:
            refuse(
                place, f"s = {_mm(point[0])} lies outside the arm; keep it within 0 mm and {_mm(shortest)}"
            )
        if point[0] <= last[0]:
            refuse(place, f"s = {_mm(point[0])} follows {_mm(last[0])}; s must increase")
        near += shape.near(length)
        apart = math.dist(point[1:], last[1:])
        if apart > point[0] - last[0] + near:
            refuse(
                place,
                f"lies {_mm(apart)} from the point before it, with {_mm(point[0] - last[0])} of arm between "
                "the two; bring them nearer",
            )
        last, near = point, shape.near(length)


def _check_contradictions(target: TargetConfig, length: float, refuse) -> None:
    for (i, a), (j, b) in itertools.combinations(enumerate(target.pose), 2):
        if (a.T_base, a.branch) != (b.T_base, b.branch):
            continue
        for name in ("tip", "angle", "direction", "rotation"):
            one, other = getattr(a, name), getattr(b, name)
            if one is not None and other is not None and one != other:
                refuse(
                    f"pose[{j}].{name}",
                    f"differs from that of pose[{i}] at the same T_base and branch, and the tip can be at "
                    "one place only; remove one of the two",
                )
    places = [(f"pose[{i}].tip", p, (length, *p.tip)) for i, p in enumerate(target.pose) if p.tip is not None]
    places += [
        (f"shape[{i}].points[{k}]", shape, point)
        for i, shape in enumerate(target.shape)
        for k, point in enumerate(shape.points)
    ]
    for (key, a, one), (other_key, b, other) in itertools.combinations(places, 2):
        if a is b or (a.T_base, a.branch) != (b.T_base, b.branch):
            continue
        apart, between = math.dist(one[1:], other[1:]), abs(one[0] - other[0])
        if apart > between + a.near(length) + b.near(length):
            refuse(
                other_key,
                f"lies {_mm(apart)} from {key} at the same T_base and branch, with {_mm(between)} of arm "
                "between the two; change one of the two",
            )


def _check_goal(goal: Goal, target: TargetConfig, refuse) -> None:
    unused = {"reach": (), "bend": ("direction",), "tension": ("branch", "direction")}[goal.kind]
    for name in unused:
        if name in goal.model_fields_set:
            refuse(f"goal.{name}", f"has no effect on a goal of {goal.kind}; leave it out")
    if goal.kind == "tension":
        if goal.T_base is not None:
            refuse("goal.T_base", "is what the goal looks for; remove it and add T_base to search.free")
        if not target.search.frees_tension:
            refuse("search.free", 'the goal asks for the least T_base; add free = ["T_base"] with its bounds')
        if not (target.pose or target.shape):
            refuse("goal.kind", "the least tension for what? add a [[pose]]")
    elif goal.T_base is None:
        refuse("goal", "missing key 'T_base'; add for example T_base = \"45 N\"")
    elif target.search.frees_tension:
        refuse("search.free", f"T_base cannot be free where the goal is {goal.kind}: more would be better")


def _check_tensions(target: TargetConfig, robot: RobotConfig, refuse) -> None:
    largest = target.T_base_max
    top = target.limits.max_T_base
    if largest is not None and top is not None and largest > top:
        refuse("T_base_max", f"{largest:g} N exceeds limits.max_T_base = {top:g} N; change one of the two")
    if largest is not None and not any(load.branch == "releasing" for load in target.loads):
        refuse("T_base_max", 'has no effect where nothing is released; add branch = "releasing" or remove it')
    pulls = [(load.T_base, load.branch) for load in target.loads if isinstance(load.T_base, float)]
    for T_base, branch in pulls:
        where = f"T_base = {T_base:g} N"
        if T_base < 0 or (T_base == 0 and branch == "pulling"):
            refuse("pose.T_base", f"{where} pulls nothing; give a positive tension")
        if top is not None and T_base > top and not target.search.frees_tension:
            refuse("limits.max_T_base", f"{top:g} N, but a target asks for {where}; change one of the two")
        if largest is not None and T_base > largest:
            refuse("T_base_max", f"{largest:g} N is not the largest: a target asks for {where}; raise it")
        if branch == "releasing" and T_base >= max([*(T for T, _ in pulls), largest or 0.0]):
            refuse(
                "T_base_max",
                f"a target on the releasing branch has {where}, the largest of the file; say from where it "
                f'is released, for example T_base_max = "{1.5 * T_base:g} N"',
            )
        if T_base < robot.tendon.preload and branch == "pulling":
            refuse(
                "pose.T_base", f"{where} is less than the preload of {robot.tendon.preload:g} N; pull more"
            )
    floor = target.limits.min_T_tip
    if floor is not None and not target.search.frees_tension:
        for T_base, branch in pulls:
            if branch == "pulling" and floor > T_base:
                refuse(
                    "limits.min_T_tip",
                    f"{floor:g} N cannot reach the tip where a target pulls with {T_base:g} N; lower it",
                )


def _check_search(target: TargetConfig, refuse) -> None:
    search = target.search
    if search.kind is not None and search.kind not in FAMILIES:
        refuse("search.kind", f"unknown kind '{search.kind}'; {did_you_mean(search.kind, FAMILIES)}")
    if search.knots is not None and search.kind not in ("spline", "curve"):
        refuse(
            "search.knots",
            'has no effect without kind = "spline", in space "curve"; add it or leave knots out',
        )
    if search.knots is not None and not 3 <= search.knots <= 40:
        refuse("search.knots", f"must lie between 3 and 40, is {search.knots}; 6 for example")
    if not 1 <= search.starts <= 512:
        refuse("search.starts", f"must lie between 1 and 512, is {search.starts}; 12 for example")
    if search.seed < 0:
        refuse("search.seed", f"cannot be negative, is {search.seed}; 0 for example")
    for value in search.n_sine or ():
        if not 0 < value <= MOST_WAVES:
            refuse("search.n_sine", f"half waves lie between 0 and {MOST_WAVES}, one is {value:g}; remove it")
    if search.n_sine == ():
        refuse("search.n_sine", "is empty; give for example [2, 3, 4]")
    if search.method == "gauss-newton" and target.goal is not None:
        refuse("search.method", 'a goal is not a sum of squares; take "l-bfgs-b" or "auto"')
    if search.method == "l-bfgs-b" and target.goal is None and target.robust.optimise != "nominal":
        refuse(
            "search.method", 'errors over what is not known are least squares; take "gauss-newton" or "auto"'
        )


def _check_limits(target: TargetConfig, robot: RobotConfig, refuse) -> None:
    limits = target.limits
    needs = {"channel_clearance": bool(robot.tendons), "obstacle_clearance": bool(target.obstacle)}
    for name, there in needs.items():
        if name in limits.model_fields_set and not there:
            what = "several tendons" if name == "channel_clearance" else "an [[obstacle]]"
            refuse(f"limits.{name}", f"has no effect without {what}; leave it out")
    for i, obstacle in enumerate(target.obstacle):
        if obstacle.radius <= 0:
            refuse(f"obstacle[{i}].radius", f"must be positive, is {_mm(obstacle.radius)}; correct it")
    for name in ("wall_clearance", "bore_clearance", "channel_diameter", *needs):
        if getattr(limits, name) < 0:
            refuse(f"limits.{name}", f"cannot be negative, is {_mm(getattr(limits, name))}; correct it")
    for name in ("min_channel_radius", "max_T_base", "min_T_tip", "max_base_slope", "max_tip_slope"):
        value = getattr(limits, name)
        if value is not None and value < 0:
            refuse(f"limits.{name}", f"cannot be negative, is {value:g}; correct it")
    for name in ("max_base_slope", "max_tip_slope"):
        value = getattr(limits, name)
        if value is not None and value >= 0.5 * math.pi:
            refuse(
                f"limits.{name}", f'{value:g} rad limits nothing; if degrees are meant, write "{value:g} deg"'
            )
    loss = limits.max_tension_loss
    if loss is not None and not 0 < loss <= 1:
        refuse("limits.max_tension_loss", f"is a share between 0 and 1, not {loss:g}; 0.6 for example")
    inside = limits.wall_clearance + 0.5 * limits.channel_diameter
    if inside >= min(robot.backbone.outer_radius):
        refuse(
            "limits.wall_clearance",
            f"with half the channel {_mm(inside)}, no less than the body's radius of "
            f"{_mm(min(robot.backbone.outer_radius))}: no channel fits; reduce it",
        )
    robust = target.robust
    for name in ("friction_coefficient", "youngs_modulus"):
        value = getattr(robust, name)
        if value is not None and robust.fit is not None:
            refuse(f"robust.{name}", f"{robust.fit} says it already; remove one of the two")
        if value is not None and not 0 <= value < 1:
            refuse(f"robust.{name}", f"is a relative standard deviation below 1, not {value:g}; 0.1 is 10 %")
    if robust.deviations <= 0:
        refuse("robust.deviations", f"must be positive, is {robust.deviations:g}; 2 for example")
