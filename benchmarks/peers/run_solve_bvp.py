"""`scipy.integrate.solve_bvp` on the peers' problems; prints JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from .. import measure
from .answer import answer
from .problem import (
    BENDING_STIFFNESS,
    LENGTH,
    OFFSET,
    PROBLEMS,
    TENSION,
    Problem,
    SpatialProblem,
    error,
    strain,
)

NODES = (3, 4, 5, 7, 10, 15)
TOLERANCES = (1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8)


def solver_of(problem: Problem, nodes: int, tolerance: float):
    """A solve from the straight rod; unknowns angle, curvature, x, y, with the Jacobians it may use."""
    fx, fy = (f / BENDING_STIFFNESS for f in problem.tip_force)
    tip_curvature = TENSION * OFFSET / BENDING_STIFFNESS
    s = np.linspace(0.0, LENGTH, nodes)
    straight = np.zeros((4, nodes))
    straight[2] = s
    at_base, at_tip = np.zeros((4, 4)), np.zeros((4, 4))
    at_base[0, 0] = at_base[1, 2] = at_base[2, 3] = at_tip[3, 1] = 1.0

    def slope(_, y):
        cos, sin = np.cos(y[0]), np.sin(y[0])
        return np.stack([y[1], fx * sin - fy * cos, cos, sin])

    def slope_jacobian(_, y):
        cos, sin = np.cos(y[0]), np.sin(y[0])
        J = np.zeros((4, 4, y.shape[1]))
        J[0, 1] = 1.0
        J[1, 0] = fx * cos + fy * sin
        J[2, 0], J[3, 0] = -sin, cos
        return J

    def ends(a, b):
        return np.array([a[0], a[2], a[3], b[1] - tip_curvature])

    def solve():
        return solve_bvp(
            slope,
            ends,
            s,
            straight,
            fun_jac=slope_jacobian,
            bc_jac=lambda a, b: (at_base, at_tip),
            tol=tolerance,
            max_nodes=100_000,
        )

    return solve


def spatial_solver_of(problem: SpatialProblem, nodes: int, tolerance: float):
    """A solve from the straight rod; unknowns the section's rotation as a quaternion and its place, and,
    where a force acts, the place of the tip as parameters. The strain of each section follows from the
    balance of moments, by Newton's method. Derivatives are differences.
    """
    s = np.linspace(0.0, LENGTH, nodes)
    straight = np.zeros((7, nodes))
    straight[0], straight[4] = 1.0, s
    force = np.asarray(problem.tip_force)[:, None]
    start = straight[:, 0]

    def slope(s, y, tip=None):
        w, v, r = y[0], y[1:4], y[4:]

        def turned(a, way=1.0):
            b = 2.0 * np.cross(v, a, axis=0)
            return a + way * w * b + np.cross(v, b, axis=0)

        moment = np.zeros_like(v)
        if tip is not None:
            moment = turned(np.cross(tip[:, None] - r, force, axis=0), -1.0)
        u = strain(problem, s, moment)
        rotating = np.concatenate([-np.sum(u * v, axis=0)[None], w * u + np.cross(v, u, axis=0)]) / 2
        return np.concatenate([rotating, turned(np.eye(3)[:, :1] * np.ones_like(w))])

    def ends(a, b, tip=None):
        return a - start if tip is None else np.concatenate([a - start, b[4:] - tip])

    def solve():
        return solve_bvp(
            slope,
            ends,
            s,
            straight,
            p=straight[4:, -1] if problem.loaded else None,
            tol=tolerance,
            max_nodes=100_000,
        )

    return solve


def of(problem: Problem | SpatialProblem, nodes: int, tolerance: float):
    """A solve, and the unknowns that are the place."""
    if isinstance(problem, SpatialProblem):
        return spatial_solver_of(problem, nodes, tolerance), slice(4, 7)
    return solver_of(problem, nodes, tolerance), slice(2, 4)


def run(quick: bool) -> dict[str, Any]:
    """Every first mesh with every tolerance."""
    points = []
    for problem in PROBLEMS:
        for nodes in NODES[::2] if quick else NODES:
            for tolerance in TOLERANCES[::2] if quick else TOLERANCES:
                solve, tip = of(problem, nodes, tolerance)
                found = solve()
                points.append(
                    {
                        "problem": problem.name,
                        "setting": f"tol {tolerance:g} from {nodes} nodes",
                        "error": error(problem, found.y[tip, -1]),
                        "converged": bool(found.success),
                        "warm_s": measure.shortest(solve, budget=0.2),
                    }
                )
    return {"points": points, "batches": []}


if __name__ == "__main__":
    answer(run, ("scipy", "numpy"))
