"""This project's solver on the peers' problems; prints JSON."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

import gtr_jax as gtr
from gtr_jax.config.config import parse_config

from .. import measure
from . import lanes
from .answer import answer
from .problem import (
    LENGTH,
    LEVELS,
    OFFSET,
    POISSONS_RATIO,
    PROBLEMS,
    RADIUS,
    TENSION,
    YOUNGS_MODULUS,
    Problem,
    SpatialProblem,
    cheapest,
    error,
)

RESOLUTIONS = (0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0, 2.0)
FRICTION = 0.3  # for the sake of its cost; nothing else here has any
BODY = 12e-3  # m: a body wide enough for the channel, of a modulus that keeps the bending stiffness


def routings_of(problem: Problem | SpatialProblem) -> list[dict[str, Any]]:
    """The channels as a robot file says them."""
    if isinstance(problem, Problem):
        return [{"kind": "parallel", "offset": OFFSET}]
    return [
        {
            "kind": "helix",
            "radius": channel.radius,
            "tip_radius": channel.tip_radius,
            "turns": channel.turns,
            "start_angle": channel.start_angle,
        }
        for channel in problem.channels
    ]


def robot_of(problem: Problem | SpatialProblem, resolution: float, friction: float = 0.0) -> gtr.Robot:
    """The problem as a robot file says it."""
    file: dict[str, Any] = {
        "schema": 1,
        "name": problem.name,
        "backbone": {
            "length": LENGTH,
            "outer_radius": BODY,
            "youngs_modulus": YOUNGS_MODULUS * (RADIUS / BODY) ** 4,
            "poissons_ratio": POISSONS_RATIO,
        },
    }
    tendon, routings = {"friction_coefficient": friction}, routings_of(problem)
    if len(routings) == 1:
        file |= {"tendon": tendon, "routing": routings[0]}
    else:
        file["tendons"] = [
            {"name": f"tendon{i + 1}", **tendon, "routing": routing} for i, routing in enumerate(routings)
        ]
    if problem.loaded:
        file["loads"] = {"tip_force": list(problem.tip_force)}
    return gtr.build_robot(parse_config(file), resolution=resolution)


def tip_of(problem: Problem | SpatialProblem, robot: gtr.Robot, T):
    """Place of the tip under a tension of the first tendon, the others' in proportion; and whether the solver
    met its tolerance.
    """
    if isinstance(problem, Problem):
        eq = gtr.equilibrium(robot, T)
        return eq.tip_pose[:2], eq.converged
    shares = jnp.asarray(problem.shares)
    eq = gtr.equilibrium(robot, T * shares if len(shares) > 1 else T)
    return eq.tip_position, eq.converged


def default_mesh(problem: Problem | SpatialProblem, T_base) -> dict[str, Any]:
    """Seconds of one solve at the default mesh: robot closed over, passed as an argument, with friction."""

    def warm_s(friction: float) -> float:
        robot = robot_of(problem, 1.0, friction)
        return measure.timed(partial(tip_of, problem, robot), T_base).warm

    return {
        "problem": problem.name,
        "friction_coefficient": FRICTION,
        "closed_over_s": warm_s(0.0),
        "argument_s": measure.timed(partial(tip_of, problem), robot_of(problem, 1.0), T_base).warm,
        "friction_s": warm_s(FRICTION),
    }


def gradient_s(robot: gtr.Robot, problem: Problem | SpatialProblem, T_base) -> float:
    """Seconds of the tip's height with its gradient in the tension and the modulus."""

    def height(T, E):
        return tip_of(problem, robot.with_values(E=E), T)[0][1]

    return measure.timed(
        jax.value_and_grad(height, argnums=(0, 1)), T_base, robot.backbone.youngs_modulus
    ).warm


def run(quick: bool) -> dict[str, Any]:
    """Every mesh, then gradient and batches on those that just reach a level."""
    points, batches = [], []
    T_base = jnp.asarray(TENSION)
    for problem in PROBLEMS:
        for resolution in RESOLUTIONS[1::3] if quick else RESOLUTIONS:
            robot = robot_of(problem, resolution)
            timed = measure.timed(partial(tip_of, problem, robot), T_base)
            tip, converged = timed.value
            points.append(
                {
                    "problem": problem.name,
                    "setting": f"{sum(robot.intervals) + len(robot.intervals)} nodes",
                    "resolution": resolution,
                    "error": error(problem, tip),
                    "converged": bool(converged),
                    "warm_s": timed.warm,
                    "cold_s": timed.cold,
                }
            )
        for level in LEVELS:
            point = cheapest(points, problem.name, level)
            if point is None or "gradient_s" in point:
                continue
            robot = robot_of(problem, point["resolution"])
            point["gradient_s"] = gradient_s(robot, problem, T_base)
            found = lanes.batch(partial(tip_of, problem, robot), point["warm_s"], 1000 if quick else 10_000)
            if found:
                batches.append({"problem": problem.name, "setting": point["setting"], **found})
    return {"points": points, "batches": batches, "default_mesh": [default_mesh(p, T_base) for p in PROBLEMS]}


if __name__ == "__main__":
    answer(run, ("gtr-jax", "jax", "jaxlib"))
