"""What a simulation in space shows: where the tip stands and points, and the body from three sides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from gtr_jax.numbers import number
from gtr_jax.plots.views import Posture, Strung, plot_views
from gtr_jax.recordings.formats.quantities import AXES, QUATERNION
from gtr_jax.robot.clearance import place_in_section
from gtr_jax.robot.robot import Robot
from gtr_jax.robot.rotation import quaternion_of

from ..simulation.history import Simulation
from ..simulation.markers import marker_places
from ..simulation.solution import Equilibrium
from .page import Figure


def pose_facts(run: Simulation, step: int) -> dict[str, Any]:
    """Where the tip stands and points in a step."""
    place = np.asarray(run.tip_position[step])
    quaternion = np.asarray(quaternion_of(run.tip_rotation[step]))
    return {
        **{f"tip_{axis}_m": float(place[i]) for i, axis in enumerate(AXES)},
        **{name: float(quaternion[i]) for i, name in enumerate(QUATERNION)},
        "tip_turned_rad": float(turned(run)[step]),
    }


def tip_angle(run: Simulation) -> np.ndarray:
    """Angle of the tip to the base at every step [rad], (K,): in the plane signed, in space between both."""
    return np.asarray(run.tip_pose)[:, 2] if run.shape is None else turned(run)


def turned(run: Simulation) -> np.ndarray:
    """Angle between the directions of tip and base at every step [rad], (K,)."""
    assert run.shape is not None
    base, tip = (np.asarray(run.shape.rotation)[:, node, :, 0] for node in (0, -1))
    return np.arctan2(np.linalg.norm(np.cross(base, tip), axis=1), np.sum(base * tip, axis=1))


def pose_rows(top: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Rows of a table on the tip's pose, from `pose_facts`."""
    place = ", ".join(number(1e3 * top[f"tip_{axis}_m"]) for axis in AXES)
    quaternion = ", ".join(number(top[name], digits=4) for name in QUATERNION)
    return [
        ("tip there: x, y, z", f"{place} mm"),
        ("tip there: angle to the base", number(float(np.degrees(top["tip_turned_rad"])), "°")),
        ("tip there: quaternion x, y, z, w", quaternion),
    ]


def strung_of(robot: Robot, state: Equilibrium | Simulation) -> Strung:
    """The body and its channels at the nodes of a solution, for pictures."""
    length, s = float(robot.backbone.length), np.asarray(state.s)
    return Strung(
        s,
        np.asarray(robot.backbone.radius(state.s)),
        np.stack([place_in_section(tendon, s, length) for tendon in robot.tendons]),
        np.array([length if tendon.to is None else float(tendon.to) for tendon in robot.tendons]),
        robot.tendon_names,
    )


def _posture(name: str, run: Simulation, places: np.ndarray, step: int) -> Posture:
    assert run.shape is not None
    tension = np.atleast_2d(np.asarray(run.tension[step]))
    position, frames = np.asarray(run.shape.position[step]), np.asarray(run.shape.rotation[step])
    return Posture(name, position, frames, tension, places[step])


def shape_figure(
    robot: Robot, run: Simulation, rest: Equilibrium, named: Sequence[tuple[str, int]]
) -> Figure:
    """The body from three sides.

    Args:
        robot, run: as simulated.
        rest: with slack tendons.
        named: names and steps of the shapes drawn besides.
    """
    assert rest.shape is not None
    places = np.asarray(marker_places(robot, run))
    tension = np.atleast_2d(np.asarray(rest.tension))
    still = Posture("at rest", np.asarray(rest.shape.position), np.asarray(rest.shape.rotation), tension)
    postures = [still, *(_posture(name, run, places, step) for name, step in named)]
    return Figure(
        "shape",
        plot_views(strung_of(robot, rest), postures),
        "The body from three sides at one scale, with its channels coloured by the tension of the tendon in "
        "them (grey: at rest).",
    )


def apart(a: Equilibrium, b: Equilibrium) -> float:
    """Largest distance between two shapes, relative to the length."""
    assert a.shape is not None and b.shape is not None
    distance = jnp.max(jnp.linalg.norm(a.shape.position - b.shape.position, axis=-1))
    return float(distance / a.s[-1])
