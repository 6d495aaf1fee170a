"""The independent simulator's noise-free runs (rigid links, time marching): every sample within its own
discretisation error.
"""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import gtr_jax as gtr

CASES = sorted((Path(__file__).parents[1] / "data" / "reference").glob("coulomb*"))


@pytest.mark.parametrize("folder", CASES, ids=lambda p: p.name)
def test_coulomb_reference(folder):
    recording = gtr.read_recording(folder / "recording.csv")
    error = json.loads((folder / "physics.json").read_text())
    run = gtr.simulate(gtr.load_robot(folder / "robot.toml"), recording.T_base)
    assert bool(jnp.all(run.converged))
    tension = np.abs(np.asarray(run.T_tip) - recording.T_tip).max()
    angle = np.abs(np.asarray(run.tip_pose[:, 2]) - recording.tip_angle).max()
    drawn = np.abs(np.asarray(run.displacement) - recording.displacement).max()
    assert tension <= max(2 * error["change_from_half_mesh_N"], 0.02)
    assert angle <= max(2 * error["change_from_half_mesh_angle_rad"], 0.002)
    assert drawn <= 5e-5
