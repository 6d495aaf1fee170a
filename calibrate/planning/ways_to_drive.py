"""What may be done to a rig before it is driven: nothing, turning it, or hanging a weight from the tip."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from gtr_jax import Robot
from gtr_jax.robot.robot import sections
from gtr_jax.terms import REGISTRY

# The weight to hang from the tip would deflect a straight body, across it, by this share of the length; it is
# at most this share of the largest base tension.
DEFLECTION, HEAVIEST = 0.1, 0.2
TURNED = "the rig turned to the left by a right angle"
Values = Mapping[str, float]
# Terms that add to a dead load, by the load: the first of them adds what a person does to the rig.
ADDED = {
    load: [kind for kind, term in REGISTRY.items() if term.adds_to == load]
    for load in ("gravity", "tip_force")
}


def _axes(robot: Robot) -> str:
    """The axes in which a robot may be bent."""
    return "xyz" if robot.space else "xy"


def _gravity(robot: Robot) -> np.ndarray:
    """Acceleration of gravity as the robot file has it [m/s^2], (axes,)."""
    if robot.space:
        return np.asarray(robot.loads.gravity_vector())
    angle = float(robot.loads.gravity_angle)
    return float(robot.loads.gravity) * np.asarray([np.cos(angle), np.sin(angle)])


def _down(robot: Robot) -> np.ndarray:
    """Direction of gravity as the robot file has it, (axes,)."""
    if robot.space:
        g = _gravity(robot)
        return g / max(float(np.linalg.norm(g)), 1e-12)
    angle = float(robot.loads.gravity_angle)
    return np.asarray([np.cos(angle), np.sin(angle)])


def _acts(robot: Robot, values: Values, kind: str) -> np.ndarray:
    """Components of a term that turns with gravity, from `values` if they are there, else from the robot."""
    names = [f"{kind}.{axis}" for axis in _axes(robot)]
    return np.asarray([float(values.get(name, robot.value(name))) for name in names])


def turned(robot: Robot, values: Values) -> dict[str, float]:
    """Values of a robot whose rig is turned to the left by a right angle. Gravity and dead forces keep their
    direction in space: what pulled to the right of the base tangent then pulls against it.
    """
    known = {"gravity": _gravity(robot), "tip_force": np.asarray(robot.loads.tip_force)}
    after = dict(values)
    for load, kinds in ADDED.items():
        for i, kind in enumerate(kinds):
            own = known[load] if i == 0 else np.zeros_like(known[load])
            x, y, *_ = own + _acts(robot, values, kind)
            after |= {f"{kind}.x": y - own[0], f"{kind}.y": -x - own[1]}
    return after


def weighed(robot: Robot, weight: np.ndarray, values: Values) -> dict[str, float]:
    """Values of a robot with a known weight (axes,) [N] hung from its tip."""
    kind = ADDED["tip_force"][0]
    force = _acts(robot, values, kind) + weight
    return dict(values) | {f"{kind}.{axis}": float(f) for axis, f in zip(_axes(robot), force, strict=True)}


def weight_to_hang(robot: Robot, largest: float) -> np.ndarray:
    """Weight [N] of one digit along gravity, (axes,), that would bend a straight body moderately if across
    it.

    Args:
        robot: whose file says where gravity pulls.
        largest: base tension [N], of which it is a small share at most.
    """
    compliance = float(jnp.mean(sections(robot).compliance))
    force = 3 * DEFLECTION / (compliance * float(robot.backbone.length) ** 2)
    return float(f"{min(force, HEAVIEST * largest):.0e}") * _down(robot)


class Way(NamedTuple):
    """A load history and what is done to the rig: in words, "" for nothing, and to its values."""

    name: str
    done: str
    changed: Callable[[Values], Values]


def ways_to_drive(histories: Sequence[str], robot: Robot, largest: float) -> list[Way]:
    """What may be driven: every history with the rig as it is; where the file says which way gravity pulls,
    the first one with the rig turned as well, or a weight hung from the tip.
    """
    found = [Way(name, "", dict) for name in histories]
    if robot.backbone.rigid or not np.any(_gravity(robot)):
        return found
    weight = weight_to_hang(robot, largest)
    return [
        *found,
        Way(histories[0], TURNED, functools.partial(turned, robot)),
        Way(
            histories[0],
            f"a weight of {np.linalg.norm(weight):g} N hung from the tip",
            functools.partial(weighed, robot, weight),
        ),
    ]
