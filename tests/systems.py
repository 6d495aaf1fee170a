"""Systems with closed-form state and gradient: a new solver or routing gets its tests from these in a few
lines.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import root_scalar
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc


@dataclasses.dataclass(frozen=True)
class System:
    """A robot (sections of its file), a load, and what must come out.

    Attributes:
        name: for the test's id.
        sections: keyword arguments of `make_robot`.
        T_base: [N].
        exact: parameters (by short name, SI) -> {"T_tip": ..., "angle": ..., "x": ..., "y": ...}; any subset.
        at: the parameters the closed form depends on, with their values.
    """

    name: str
    sections: dict
    T_base: float
    exact: Callable[..., dict[str, float]]
    at: dict[str, float]


def _second_moment(radius: float) -> float:
    return math.pi / 4 * radius**4


def parallel(mu: float, T_base: float) -> System:
    """Parallel tendon: T(s) = T_b/(1 + mu R T_b s/EI), phi = ln(1 + mu R T_b s/EI)/mu; mu -> 0 a circular
    arc.
    """
    length, radius, modulus, offset = 0.25, 0.01, 3e6, 0.006

    def exact(mu=mu, E=modulus, offset=offset):
        a = offset * T_base * length / (E * _second_moment(radius))
        if mu == 0:
            x, y = math.sin(a) / a * length, (1 - math.cos(a)) / a * length
            return {"T_tip": T_base, "angle": a, "x": x, "y": y}
        return {"T_tip": T_base / (1 + mu * a), "angle": math.log1p(mu * a) / mu}

    sections = {
        "routing": {"kind": "parallel", "offset": offset},
        "backbone": {"length": length, "outer_radius": [radius, radius], "youngs_modulus": modulus},
        "tendon": {"friction_coefficient": mu},
    }
    return System(
        f"parallel-mu{mu}-T{T_base}", sections, T_base, exact, {"mu": mu, "E": modulus, "offset": offset}
    )


def elastica(load: float) -> System:
    """Cantilever with a dead tip force across the base tangent, no tendon force; load = P L^2/EI (elliptic
    integrals).
    """
    length, radius, modulus = 0.4, 0.004, 2e7
    force = load * modulus * _second_moment(radius) / length**2

    def exact(E=modulus, tip_force_y=force):
        a = tip_force_y * length**2 / (E * _second_moment(radius))

        def shot(angle):
            m = (1 + math.sin(angle)) / 2
            return ellipk(m) - ellipkinc(math.asin(1 / math.sqrt(2 * m)), m) - math.sqrt(a)

        angle = root_scalar(shot, bracket=(1e-9, math.pi / 2 - 1e-12), xtol=1e-15, rtol=1e-14).root
        m = (1 + math.sin(angle)) / 2
        swing = ellipe(m) - ellipeinc(math.asin(1 / math.sqrt(2 * m)), m)
        y = length * (1 - 2 * swing / math.sqrt(a))
        return {"angle": angle, "x": length * math.sqrt(2 * math.sin(angle) / a), "y": y}

    sections = {
        "routing": {"kind": "parallel", "offset": 0.001},
        "backbone": {"length": length, "outer_radius": [radius, radius], "youngs_modulus": modulus},
        "tendon": {"friction_coefficient": 0.3},
        "loads": {"tip_force": [0.0, force]},
    }
    return System(f"elastica-{load}", sections, 0.0, exact, {"E": modulus, "tip_force_y": force})


SYSTEMS = (
    parallel(0.0, 6.0),
    parallel(0.3, 6.0),
    parallel(0.8, 25.0),
    elastica(0.5),
    elastica(3.0),
    elastica(8.0),
)


def exact_gradient(system: System, output: str, name: str) -> float:
    """Derivative of the closed form by a central difference of high order (the closed form is smooth and
    exact).
    """
    x = system.at[name]
    h = 1e-3 * x
    points = np.array([1.0, 2.0, 3.0])
    weights = np.array([3 / 4, -3 / 20, 1 / 60])
    total = 0.0
    for k, w in zip(points, weights, strict=True):
        up = system.exact(**{**system.at, name: x + k * h})[output]
        down = system.exact(**{**system.at, name: x - k * h})[output]
        total += w * (up - down)
    return total / h
