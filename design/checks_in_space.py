"""What can be wrong between a target and a robot in space or one of several tendons, and the line that says
so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NoReturn

import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import did_you_mean

from .target import TargetConfig
from .tensions import pull_of

Refuse = Callable[[str, str], NoReturn]


def check_axes(target: TargetConfig, robot: RobotConfig, refuse: Refuse) -> None:
    """Refuse places and directions that are not of as many axes as the robot moves along."""
    space = robot.in_space
    whose = (
        f"{robot.leaves_plane} takes the robot out of the plane" if space else "the robot stays in a plane"
    )
    axes = ("x, y and z" if space else "x and y", 3 if space else 2)

    def check(key: str, place: tuple[float, ...] | None, before: str = "") -> None:
        if place is not None and len(place) != axes[1] + bool(before):
            refuse(key, f"{whose}; give {before}{axes[0]}")

    for i, pose in enumerate(target.pose):
        key = f"pose[{i}]"
        check(f"{key}.tip", pose.tip)
        for name in ("direction", "rotation") if not space else ("angle",):
            if getattr(pose, name) is not None:
                instead = "direction = [0.8, 0.5, 0.2], or a rotation" if space else 'angle = "55 deg"'
                refuse(f"{key}.{name}", f"{whose}; give {instead} instead")
        if pose.direction is not None and pose.rotation is not None:
            refuse(f"{key}.direction", "is given beside rotation, which says the same; remove one of the two")
        if pose.direction is not None and not math.hypot(*pose.direction) > 0:
            refuse(f"{key}.direction", "has no length; give a vector such as [0.8, 0.5, 0.2]")
        if pose.rotation is not None and math.hypot(*pose.rotation) > 2 * np.pi * (1 + 1e-9):
            refuse(f"{key}.rotation", "is more than a full turn; give the axis times the angle")
    for i, shape in enumerate(target.shape):
        for k, point in enumerate(shape.points):
            check(f"shape[{i}].points[{k}]", point, "s, ")
    for i, obstacle in enumerate(target.obstacle):
        check(f"obstacle[{i}].at", obstacle.at)
        check(f"obstacle[{i}].to", obstacle.to)
    goal = target.goal
    if goal is not None and isinstance(goal.direction, tuple):
        if not space:
            refuse("goal.direction", f'{whose}; give an angle, "90 deg"')
        if not math.hypot(*goal.direction) > 0:
            refuse("goal.direction", "has no length; give a vector such as [0, 1, 0]")


def check_pulls(target: TargetConfig, robot: RobotConfig, refuse: Refuse) -> None:
    """Refuse base tensions that are not of the tendons that the robot has, or that pull nothing."""
    names = robot.tendon_names
    loads = [(f"pose[{i}]", load) for i, load in enumerate(target.pose)]
    loads += [(f"shape[{i}]", load) for i, load in enumerate(target.shape)]
    loads += [("goal", target.goal)] if target.goal is not None else []
    _check_free(target, names, refuse)
    for key, load in loads:
        T_base = load.T_base
        if isinstance(T_base, Mapping) and not names:
            refuse(f"{key}.T_base", 'the robot has one tendon; give its tension, "45 N"')
        if not names or T_base is None:
            continue
        if not isinstance(T_base, Mapping):
            refuse(
                f"{key}.T_base",
                f'the robot has several tendons; give the tension of each, {{ {names[0]} = "5 N" }}',
            )
        for name, value in T_base.items():
            if name not in names:
                refuse(f"{key}.T_base.{name}", f"no tendon has this name; {did_you_mean(name, names)}")
            _check_size(f"{key}.T_base.{name}", value, robot, target, refuse)
        if not max(pull_of(robot, T_base)) > 0:  # pyright: ignore[reportArgumentType]
            refuse(f"{key}.T_base", "pulls nothing; give one tendon a positive tension")
        if load.branch == "releasing":
            refuse(
                f"{key}.branch",
                "where several tendons are after a release depends on the order in which they are released; "
                "design on the pulling branch",
            )
    if names and target.T_base_max is not None:
        refuse("T_base_max", "has no effect where nothing is released; remove it")


def _check_size(key: str, value: float, robot: RobotConfig, target: TargetConfig, refuse: Refuse) -> None:
    """Refuse a base tension below the tendon's preload, below zero or above the limit."""
    name = key.rpartition(".")[2]
    preload = next(tendon.preload for own, tendon, _ in robot.strung if own == name)
    if value < preload:
        least = f"the preload of {preload:g} N" if preload else "0 N"
        refuse(key, f"{value:g} N is less than {least}; pull more")
    top = target.limits.max_T_base
    if top is not None and value > top and not target.search.frees_tension:
        refuse("limits.max_T_base", f"{top:g} N, but {key} asks for {value:g} N; change one of the two")


def _check_free(target: TargetConfig, names: tuple[str, ...], refuse: Refuse) -> None:
    """Refuse free tensions of tendons that the robot does not have."""
    for free in target.search.free_tensions:
        _, _, name = free.partition(".")
        if name and not names:
            refuse("search.free", f"'{free}': the robot has one tendon; write T_base")
        if name and name not in names:
            refuse("search.free", f"'{free}': no tendon has this name; {did_you_mean(name, names)}")
