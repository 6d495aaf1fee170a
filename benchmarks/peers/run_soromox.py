"""soromox's robots of piecewise constant strain, and in space of polynomial strain too, brought to rest by
Newton's method; prints JSON.

soromox gives forces and energies, not a static solver. So optimistix's Newton, which its environment brings,
solves "elastic force = actuation force + tip force", from the straight robot. The residual is written both
ways that soromox offers: the sum of its forces, or the gradient of its energies. Only bending, and in space
twist, is active, so the rod is inextensible and unshearable.
"""
# pyright: reportMissingImports=false

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import optimistix as optx
from soromox.actuation import ThreadlikeActuator, ThreadlikeRouting
from soromox.systems import LinkSpec, PlanarPCS, PlanarPCSStructure

from .. import measure
from . import lanes, soromox_in_space
from .answer import answer
from .problem import (
    BENDING_STIFFNESS,
    LENGTH,
    LEVELS,
    OFFSET,
    PROBLEMS,
    RADIUS,
    TENSION,
    YOUNGS_MODULUS,
    Problem,
    SpatialProblem,
    cheapest,
    error,
)
from .soromox_in_space import Setting

SEGMENTS = {False: (1, 2, 4, 8), True: (1, 2, 4, 8, 16, 25, 50, 100, 250)}  # by whether a force acts
LARGE = 50  # coordinates, above which only the energies are tried: the forces' Jacobian costs more by then
NEWTON = optx.Newton(rtol=1e-6, atol=1e-6)


def robot_of(segments: int) -> PlanarPCS:
    """The rod in equal segments, bending only; one Gauss point integrates a constant routing exactly."""
    link = LinkSpec.circular(
        length=LENGTH / segments,
        radius=RADIUS,
        density=1000.0,
        reference_strain=[0.0, 1.0, 0.0],
        young_modulus=YOUNGS_MODULUS,
        poisson_ratio=0.3,
    )
    routing = ThreadlikeRouting.linear(
        intercept=jnp.array([0.0, OFFSET, 0.0]), start_segment_index=0, end_segment_index=segments - 1
    )
    return PlanarPCS.from_links(
        [link] * segments,
        structure=PlanarPCSStructure(num_gauss_points=1, strain_selector=[True, False, False] * segments),
        gravity=jnp.zeros(2),
        base_pose=jnp.zeros(3),
        actuators=ThreadlikeActuator.tendons(routing),
        backend="jax",
    )


def settings(problem: Problem | SpatialProblem, quick: bool) -> Iterator[Setting]:
    """Every robot that is tried."""
    if isinstance(problem, SpatialProblem):
        yield from soromox_in_space.settings(problem, quick)
        return
    for n in SEGMENTS[problem.loaded][: 4 if quick else None]:
        yield Setting(f"{n} segment{'s' * (n > 1)}", robot_of(n), n)


def tensions(problem: Problem | SpatialProblem, T):
    """Of the tendons under a tension of the first, the others' in proportion."""
    return T * jnp.asarray(problem.shares if isinstance(problem, SpatialProblem) else [1.0])


def tip_of(robot, q):
    """Place of the tip, (2,) or in space (3,)."""
    tip = robot.forward_kinematics_tips(q)[-1]
    return tip[:3, 3] if tip.ndim == 2 else tip[1:]


def forces(robot, problem: Problem | SpatialProblem):
    """Residual as a sum of generalised forces [N m]; stiffness is over the robot's own."""
    spatial = isinstance(problem, SpatialProblem)
    wrench = jnp.array([*([0.0] * (3 if spatial else 1)), *problem.tip_force])

    def residual(q, T, stiffness):
        out = stiffness * robot.elastic_force(q) - robot.actuation_force(q, tensions(problem, T))
        if problem.loaded:
            out = out - robot.jacobian_inertialframe(q, jnp.asarray(LENGTH)).T @ wrench
        return out

    return residual


def energies(robot, problem: Problem | SpatialProblem):
    """Residual as the gradient of the potential energy [N m]; stiffness is over the robot's own."""
    force = jnp.asarray(problem.tip_force)

    def potential(q, T, stiffness):
        out = stiffness * robot.elastic_energy(q) - tensions(problem, T) @ robot.actuator_coordinates(q)
        return out - force @ tip_of(robot, q) if problem.loaded else out

    return jax.grad(potential)


FORMULATIONS = {"forces": forces, "energies": energies}


def solver_of(problem: Problem | SpatialProblem, setting: Setting, formulation: str):
    """`solve(tension, stiffness=1.0) -> tip, converged, steps`."""
    robot = setting.robot
    residual = FORMULATIONS[formulation](robot, problem)
    # So that the residual is a curvature.
    scale = BENDING_STIFFNESS * LENGTH / (1 if "order" in setting.name else len(robot.L_cum))

    def solve(T, stiffness=1.0):
        found = optx.root_find(
            lambda q, given: residual(q, *given) / scale,
            NEWTON,
            jnp.zeros(setting.size),
            args=(T, stiffness),
            max_steps=50,
            throw=False,
        )
        converged = found.result == optx.RESULTS.successful
        return tip_of(robot, found.value), converged, found.stats["num_steps"]

    return solve


def run(quick: bool) -> dict[str, Any]:
    """Every size, then gradient and batches on those that just reach a level."""
    points, batches = [], []
    T_base = jnp.asarray(TENSION)
    for problem in PROBLEMS:
        known: dict[str, Setting] = {}
        for setting in settings(problem, quick):
            known[setting.name] = setting
            for formulation in FORMULATIONS if setting.size <= LARGE else ("energies",):
                timed = measure.timed(solver_of(problem, setting, formulation), T_base)
                tip, converged, steps = timed.value
                points.append(
                    {
                        "problem": problem.name,
                        "setting": setting.name,
                        "coordinates": setting.size,
                        "formulation": formulation,
                        "steps": int(steps),
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
            solve = solver_of(problem, known[point["setting"]], point["formulation"])
            height = jax.value_and_grad(lambda T, E, solve=solve: solve(T, E)[0][1], argnums=(0, 1))
            point["gradient_s"] = measure.timed(height, T_base, jnp.asarray(1.0)).warm
            found = lanes.batch(solve, point["warm_s"], 1000 if quick else 10_000, threads=False)
            if found:
                batches.append({"problem": problem.name, "setting": point["setting"], **found})
    return {"points": points, "batches": batches}


if __name__ == "__main__":
    answer(run, ("soromox", "jax", "jaxlib", "optimistix"))
