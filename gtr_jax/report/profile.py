"""The state along the tendons at one load, as columns: `profile.csv` of `gtr simulate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np

from ..simulation.forces import channel_forces
from ..simulation.shape import Shape
from ..simulation.solution import Equilibrium

Between = Callable[[Any], np.ndarray]  # values at the nodes to values between them


def profile(state: Equilibrium) -> Mapping[str, np.ndarray]:
    """What the tendons do along the robot, between the nodes, base to tip.

    Args:
        state: one equilibrium.

    Returns:
        Columns by header, with units: (rows,) what belongs to the body, (rows, *tendons) what belongs to a
        tendon. Where the channel has a kink a row of its own gives the force there, which has no density.
    """
    several = state.tension.ndim == 2
    parts = [state.of_tendon(i) for i in range(len(state.tension))] if several else [state]
    forces = [jax.tree_util.tree_map(np.asarray, channel_forces(part)) for part in parts]
    rows = np.any([(f.length > 0) | (f.kink_normal > 0) for f in forces], axis=0)

    def body(values) -> np.ndarray:
        values = np.asarray(values)
        return (0.5 * (values[1:] + values[:-1]))[rows]

    def along(values: list) -> np.ndarray:
        return np.stack(values, axis=-1)[rows] if several else values[0][rows]

    def between(name: str) -> np.ndarray:
        nodes = [np.asarray(getattr(part, name)) for part in parts]
        return along([0.5 * (v[1:] + v[:-1]) for v in nodes])

    def of_forces(name: str) -> np.ndarray:
        return along([getattr(f, name) for f in forces])

    return {
        "s_m": body(state.s),
        **(_in_plane(state, body, between) if state.shape is None else _in_space(state.shape, body, between)),
        "tension_N": between("tension"),
        "wrap_rad": between("wrap"),
        "tension_loss_factor": of_forces("tension_loss_factor"),
        "normal_projection_per_m": of_forces("normal_projection"),
        "friction_projection_per_m": of_forces("friction_projection"),
        "normal_force_N_per_m": of_forces("normal"),
        "friction_N_per_m": of_forces("friction"),
        "kink_force_N": of_forces("kink_normal"),
        "kink_friction_N": of_forces("kink_friction"),
    }


def _in_plane(
    state: Equilibrium, body: Between, between: Callable[[str], np.ndarray]
) -> dict[str, np.ndarray]:
    return {
        "x_m": body(state.x),
        "y_m": body(state.y),
        "angle_rad": body(state.angle),
        "curvature_per_m": body(state.curvature),
        "offset_m": between("R"),
    }


def _in_space(shape: Shape, body: Between, between: Callable[[str], np.ndarray]) -> dict[str, np.ndarray]:
    axes, offset = "xyz", between("R")
    strains = ("twist_per_m", "curvature_y_per_m", "curvature_z_per_m")
    stretch = {} if shape.stretch is None else {"axial_strain": body(shape.stretch)}
    return {
        **{f"{axis}_m": body(shape.position[:, i]) for i, axis in enumerate(axes)},
        **{f"tangent_{axis}": body(shape.rotation[:, i, 0]) for i, axis in enumerate(axes)},
        **{name: body(shape.strain[:, i]) for i, name in enumerate(strains)},
        **stretch,
        "offset_y_m": offset[:, 0],
        "offset_z_m": offset[:, 1],
    }
