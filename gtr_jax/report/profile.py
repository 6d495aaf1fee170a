"""The state along the tendons at one load, as columns: `profile.csv` of `gtr simulate`."""

from __future__ import annotations

from collections.abc import Mapping

import jax
import numpy as np

from ..simulation.forces import channel_forces
from ..simulation.solution import Equilibrium


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
        "x_m": body(state.x),
        "y_m": body(state.y),
        "angle_rad": body(state.angle),
        "curvature_per_m": body(state.curvature),
        "offset_m": between("R"),
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
