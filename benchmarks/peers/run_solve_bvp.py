"""`scipy.integrate.solve_bvp` on the peers' problems; prints JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_bvp

from .. import measure
from .answer import answer
from .problem import BENDING_STIFFNESS, LENGTH, OFFSET, PROBLEMS, TENSION, Problem, error

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


def run(quick: bool) -> dict[str, Any]:
    """Every first mesh with every tolerance."""
    points = []
    for problem in PROBLEMS:
        for nodes in NODES[::2] if quick else NODES:
            for tolerance in TOLERANCES[::2] if quick else TOLERANCES:
                solve = solver_of(problem, nodes, tolerance)
                found = solve()
                points.append(
                    {
                        "problem": problem.name,
                        "setting": f"tol {tolerance:g} from {nodes} nodes",
                        "error": error(problem, found.y[2:, -1]),
                        "converged": bool(found.success),
                        "warm_s": measure.shortest(solve, budget=0.2),
                    }
                )
    return {"points": points, "batches": []}


if __name__ == "__main__":
    answer(run, ("scipy", "numpy"))
