"""The robots that the benchmarks run on, as robot files would say it."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from gtr_jax import Robot, build_robot
from gtr_jax.config.config import parse_config


class System(NamedTuple):
    """A robot with the base tension [N] it is pulled to."""

    name: str
    file: dict[str, Any]
    T_base: float

    def robot(self, resolution: float = 1.0) -> Robot:
        """The robot on a mesh of this resolution."""
        return build_robot(parse_config(self.file), resolution=resolution)


_TDCM_1 = {
    "schema": 1,
    "name": "TD-CM I",
    "backbone": {
        "length": "250 mm",
        "outer_radius": ["20 mm", "13 mm"],
        "bores": [
            {"from": "0 mm", "to": "20 mm", "diameter": "14 mm"},
            {"from": "80 mm", "to": "250 mm", "diameter": "14 mm"},
        ],
        "youngs_modulus": "1.06 MPa",
        "density": "1070 kg/m^3",
    },
    "routing": {
        "kind": "straight-sine-straight",
        "r1": "-10 mm",
        "r2": "10 mm",
        "w1": "20 mm",
        "w2": "80 mm",
    },
    "tendon": {"friction_coefficient": 0.36},
}
_CONE = {"length": "400 mm", "outer_radius": ["30 mm", "15 mm"], "youngs_modulus": "1.0 MPa"}
_LOADS = {"gravity_angle": "-90 deg", "tip_force": ["0 N", "-0.2 N"]}

_SOFT_ARM = {"length": "200 mm", "outer_radius": ["12 mm", "9 mm"], "youngs_modulus": "1.2 MPa"}
_LEFT = {"kind": "parallel", "offset": "8 mm"}
_PULLED = {"friction_coefficient": 0.3, "preload": "1 N"}
HELIX = System(
    "helix",
    {
        "schema": 1,
        "name": "helix",
        "backbone": {"length": "250 mm", "outer_radius": "12 mm", "youngs_modulus": "1.2 MPa"},
        "routing": {"kind": "helix", "radius": "8 mm", "turns": 0.5, "start_angle": "30 deg"},
        "tendon": {"friction_coefficient": 0.3},
    },
    8.0,
)
ANTAGONISTS = System(
    "antagonists",
    {
        "schema": 1,
        "name": "antagonists",
        "backbone": _SOFT_ARM,
        "tendons": [
            {"name": "left", "routing": _LEFT, **_PULLED},
            {"name": "right", "routing": {"kind": "parallel", "offset": "-8 mm"}, **_PULLED},
        ],
    },
    15.0,
)
ONE_OF_THEM = System(
    "one of the antagonists",
    {"schema": 1, "name": "left", "backbone": _SOFT_ARM, "routing": _LEFT, "tendon": _PULLED},
    15.0,
)
PARALLEL = System(
    "parallel",
    {
        "schema": 1,
        "name": "parallel",
        "backbone": {"length": "0.4 m", "outer_radius": "12 mm", "youngs_modulus": "2 MPa"},
        "routing": {"kind": "parallel", "offset": "8 mm"},
        "tendon": {"friction_coefficient": 0.3},
    },
    20.0,
)
TDCM_1 = System("TD-CM I", _TDCM_1, 45.0)
TDCM_1_LOADED = System("TD-CM I, loaded", _TDCM_1 | {"loads": _LOADS}, 45.0)
CONE_WAVE = System(
    "cone wave",
    {
        "schema": 1,
        "name": "cone wave",
        "backbone": _CONE,
        "routing": {
            "kind": "converging-sine",
            "R_max": "15 mm",
            "r_min": "7.5 mm",
            "n_sine": 10,
            "sigma": 0.3,
        },
        "tendon": {"friction_coefficient": 0.3},
    },
    60.0,
)
CROSSING = System(
    "crossing wave",
    {
        "schema": 1,
        "name": "crossing wave",
        "backbone": _CONE,
        "routing": {"kind": "crossing-sine", "R_max": "20 mm", "r_min": "8 mm", "n_sine": 5},
        "tendon": {"friction_coefficient": 0.3},
    },
    40.0,
)
LATE_WAVE = System(
    "late wave",
    {
        "schema": 1,
        "name": "late wave",
        "backbone": _CONE,
        "routing": {
            "kind": "straight-sine-straight",
            "r1": "-14 mm",
            "r2": "14 mm",
            "w1": "200 mm",
            "w2": "260 mm",
        },
        "tendon": {"friction_coefficient": 0.3},
    },
    40.0,
)
CATHETER = System(
    "catheter",
    {
        "schema": 1,
        "name": "catheter",
        "backbone": {
            "length": "120 mm",
            "outer_radius": "3 mm",
            "bores": [{"from": "0 mm", "to": "120 mm", "diameter": "3 mm"}],
            "youngs_modulus": "40 MPa",
            "natural_curvature": [["0 mm", "0 rad/m"], ["90 mm", "0 rad/m"], ["120 mm", "8 rad/m"]],
        },
        "routing": {"kind": "parallel", "offset": "2 mm"},
        "tendon": {"friction_coefficient": 0.3},
    },
    12.0,
)
STUDIED = (PARALLEL, TDCM_1, CONE_WAVE, TDCM_1_LOADED)
LOOPED = (TDCM_1, CATHETER, CONE_WAVE, CROSSING, LATE_WAVE, TDCM_1_LOADED)


def draws(system: System, count: int, seed: int = 0) -> dict[str, jnp.ndarray]:
    """Random friction, modulus and tension around a system's own, (count,) each."""
    rng = np.random.default_rng(seed)
    E = float(system.robot().backbone.youngs_modulus)
    return {
        "mu": jnp.asarray(rng.uniform(0.05, 0.8, count)),
        "E": jnp.asarray(E * rng.uniform(0.6, 2.0, count)),
        "T_base": jnp.asarray(system.T_base * rng.uniform(0.05, 1.5, count)),
    }
