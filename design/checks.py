"""What can be wrong with a target for a robot, and the one line that says so.

Only what no search is needed for: whether an arm of this length could be there at all, and whether the file
asks for two things at once.
"""

from __future__ import annotations

import itertools
import math

from gtr_jax.config import RobotConfig
from gtr_jax.errors import InputError, did_you_mean

from .target import FAMILIES, Goal, PoseTarget, ShapeTarget, TargetConfig

NEAR = 1e-9


def check_target(target: TargetConfig, robot: RobotConfig) -> None:
    """Refuse a target that no search can meet or that means nothing; InputError with file, key and remedy."""

    def refuse(key: str, says: str) -> None:
        raise InputError(f"{target.source}: {key}: {says}")

    if robot.tendons:
        raise InputError(f"{robot.source}: tendons: a design is of a robot with one tendon; keep one")
    if robot.backbone.rigid:
        raise InputError(
            f"{robot.source}: backbone.rigid: a sheath of fixed shape reaches no target; give it a "
            "youngs_modulus instead"
        )
    if not target.loads:
        refuse(
            "pose", 'nothing is asked for; add [[pose]] with T_base = "45 N" and tip = ["180 mm", "95 mm"]'
        )
    length = robot.backbone.length
    for i, pose in enumerate(target.pose):
        _check_pose(f"pose[{i}]", pose, length, refuse)
    for i, shape in enumerate(target.shape):
        _check_shape(f"shape[{i}]", shape, length, refuse)
    _check_contradictions(target, refuse)
    if target.goal is not None:
        _check_goal(target.goal, target, refuse)
    _check_tensions(target, robot, refuse)
    _check_search(target, refuse)
    _check_limits(target, robot, refuse)


def _mm(value: float) -> str:
    return f"{1e3 * value:.6g} mm"


def _check_pose(key: str, pose: PoseTarget, length: float, refuse) -> None:
    if pose.tip is None and pose.angle is None:
        refuse(key, 'asks for nothing; give tip = ["180 mm", "95 mm"], angle = "55 deg", or both')
    if pose.tip is not None and math.hypot(*pose.tip) > length * (1 + NEAR):
        refuse(
            f"{key}.tip",
            f"lies {_mm(math.hypot(*pose.tip))} from the base, out of reach of an arm of {_mm(length)}; "
            "bring it nearer or lengthen the arm",
        )
    if pose.tip is not None and pose.angle is not None:
        _check_chord(key, pose.tip, pose.angle, length, refuse)
    for name in ("tip_tolerance", "angle_tolerance", "weight"):
        value = getattr(pose, name)
        if value is not None and value <= 0:
            refuse(f"{key}.{name}", f"must be positive, is {value:g}; correct it or leave it out")


def _check_chord(key: str, tip, angle: float, length: float, refuse) -> None:
    """Only a straight arm reaches as far as it is long; what else cannot be is for the search."""
    if math.hypot(*tip) > length * (1 - 1e-6) and abs(angle) > 0.02:
        refuse(
            f"{key}.angle",
            f"{math.degrees(angle):.3g} deg, but only a straight arm reaches a tip {_mm(math.hypot(*tip))} "
            "away, at 0 deg; change one of the two",
        )


def _check_shape(key: str, shape: ShapeTarget, length: float, refuse) -> None:
    if not shape.points:
        refuse(f"{key}.points", 'is empty; give [["125 mm", "120 mm", "20 mm"]], each [s, x, y]')
    for name in ("tolerance", "weight"):
        value = getattr(shape, name)
        if value is not None and value <= 0:
            refuse(f"{key}.{name}", f"must be positive, is {value:g}; correct it or leave it out")
    last = (0.0, 0.0, 0.0)
    for i, point in enumerate(shape.points):
        place = f"{key}.points[{i}]"
        if not 0 < point[0] <= length * (1 + NEAR):
            refuse(place, f"s = {_mm(point[0])} lies outside the arm; keep it within 0 mm and {_mm(length)}")
        if point[0] <= last[0]:
            refuse(place, f"s = {_mm(point[0])} follows {_mm(last[0])}; s must increase")
        apart = math.hypot(point[1] - last[1], point[2] - last[2])
        if apart > (point[0] - last[0]) * (1 + NEAR):
            refuse(
                place,
                f"lies {_mm(apart)} from the point before it, with {_mm(point[0] - last[0])} of arm between "
                "the two; bring them nearer",
            )
        last = point


def _check_contradictions(target: TargetConfig, refuse) -> None:
    for (i, a), (j, b) in itertools.combinations(enumerate(target.pose), 2):
        if (a.T_base, a.branch) != (b.T_base, b.branch):
            continue
        for name in ("tip", "angle"):
            one, other = getattr(a, name), getattr(b, name)
            if one is not None and other is not None and one != other:
                refuse(
                    f"pose[{j}].{name}",
                    f"differs from that of pose[{i}] at the same T_base and branch, and the tip can be at "
                    "one place only; remove one of the two",
                )


def _check_goal(goal: Goal, target: TargetConfig, refuse) -> None:
    if goal.kind == "tension":
        if goal.T_base is not None:
            refuse("goal.T_base", "is what the goal looks for; remove it and add T_base to search.free")
        if "T_base" not in (*target.search.free, *(target.search.routing or ())):
            refuse("search.free", 'the goal asks for the least T_base; add free = ["T_base"] with its bounds')
        if not (target.pose or target.shape):
            refuse("goal.kind", "the least tension for what? add a [[pose]]")
    elif goal.T_base is None:
        refuse("goal", "missing key 'T_base'; add for example T_base = \"45 N\"")
    elif "T_base" in target.search.free:
        refuse("search.free", f"T_base cannot be free where the goal is {goal.kind}: more would be better")


def _check_tensions(target: TargetConfig, robot: RobotConfig, refuse) -> None:
    largest = target.T_base_max
    top = target.limits.max_T_base
    if largest is not None and top is not None and largest > top:
        refuse("T_base_max", f"{largest:g} N exceeds limits.max_T_base = {top:g} N; change one of the two")
    tensions = [load.T_base for load in target.loads if load.T_base is not None]
    for load in target.loads:
        if load.T_base is None:
            continue
        where = f"T_base = {load.T_base:g} N"
        if load.T_base < 0 or (load.T_base == 0 and load.branch == "pulling"):
            refuse("pose.T_base", f"{where} pulls nothing; give a positive tension")
        if top is not None and load.T_base > top and "T_base" not in target.search.free:
            refuse("limits.max_T_base", f"{top:g} N, but a target asks for {where}; change one of the two")
        if largest is not None and load.T_base > largest:
            refuse("T_base_max", f"{largest:g} N is not the largest: a target asks for {where}; raise it")
        if load.branch == "releasing" and load.T_base >= max([*tensions, largest or 0.0]):
            refuse(
                "T_base_max",
                f"a target on the releasing branch has {where}, the largest of the file; say from where it "
                f'is released, for example T_base_max = "{1.5 * load.T_base:g} N"',
            )
        if load.T_base < robot.tendon.preload and load.branch == "pulling":
            refuse(
                "pose.T_base", f"{where} is less than the preload of {robot.tendon.preload:g} N; pull more"
            )
    floor = target.limits.min_T_tip
    if floor is not None and "T_base" not in target.search.free:
        for load in target.loads:
            if load.T_base is not None and load.branch == "pulling" and floor > load.T_base:
                refuse(
                    "limits.min_T_tip",
                    f"{floor:g} N cannot arrive of the {load.T_base:g} N that a target pulls with; lower it",
                )


def _check_search(target: TargetConfig, refuse) -> None:
    search = target.search
    if search.kind is not None and search.kind not in FAMILIES:
        refuse("search.kind", f"unknown kind '{search.kind}'; {did_you_mean(search.kind, FAMILIES)}")
    if search.knots is not None and search.kind != "spline":
        refuse("search.knots", 'has no effect without kind = "spline"; add it or leave knots out')
    if search.knots is not None and not 3 <= search.knots <= 40:
        refuse("search.knots", f"must lie between 3 and 40, is {search.knots}; 6 for example")
    if not 1 <= search.starts <= 512:
        refuse("search.starts", f"must lie between 1 and 512, is {search.starts}; 12 for example")
    for value in search.n_sine or ():
        if value <= 0:
            refuse("search.n_sine", f"half waves must be positive, one is {value:g}; remove it")
    if search.n_sine == ():
        refuse("search.n_sine", "is empty; give for example [2, 3, 4]")
    if search.method == "gauss-newton" and target.goal is not None:
        refuse("search.method", 'a goal is no sum of squares; take "l-bfgs-b" or "auto"')


def _check_limits(target: TargetConfig, robot: RobotConfig, refuse) -> None:
    limits = target.limits
    for name in ("wall_clearance", "bore_clearance", "channel_diameter"):
        if getattr(limits, name) < 0:
            refuse(f"limits.{name}", f"cannot be negative, is {_mm(getattr(limits, name))}; correct it")
    for name in ("min_channel_radius", "max_T_base", "min_T_tip", "max_base_slope", "max_tip_slope"):
        value = getattr(limits, name)
        if value is not None and value < 0:
            refuse(f"limits.{name}", f"cannot be negative, is {value:g}; correct it")
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
    for name in ("friction_coefficient", "youngs_modulus"):
        value = getattr(target.robust, name)
        if value is not None and value < 0:
            refuse(f"robust.{name}", f"a standard deviation cannot be negative, is {value:g}; correct it")
    if target.robust.deviations <= 0:
        refuse("robust.deviations", f"must be positive, is {target.robust.deviations:g}; 2 for example")
