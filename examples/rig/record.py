"""Makes the three recordings of the tutorial: simulated, with noise on every instrument, rounded as they are.

`python examples/rig/record.py FOLDER` writes monday.csv, tuesday.csv and oiled.csv.
"""

import sys
from pathlib import Path

import numpy as np

import gtr_jax as gtr

TRUTH = {"mu": 0.27, "E": 1.38e6, "r1": -9.3e-3, "r2": 8.8e-3}
OILED = TRUTH | {"mu": 0.22}
# Standard deviation and smallest step of each instrument, SI.
CELL, CELL_STEP = {"T_base": 0.1, "T_tip": 0.05}, 0.01
CAMERA, ENCODER = np.radians(0.4), 1e-4

legs = [(0, 45, 120), (45, 45, 20), (45, 18, 80), (18, 36, 60), (36, 1, 100), (1, 40, 100), (40, 0, 100)]
T_base = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in legs])
time = np.arange(len(T_base)) / 10.0


def record(truth: dict, seed: int, *, posed: bool = False) -> dict:
    """Columns of one recording."""
    robot = gtr.load_robot(Path(__file__).parent / "robot.toml").with_values(**truth)
    run = gtr.simulate(robot, T_base)
    rng = np.random.default_rng(seed)

    def shown(true, sd, step):
        return np.round((np.asarray(true) + rng.normal(0, sd, len(T_base))) / step) * step

    columns = {
        "time": time,
        "T_base": shown(T_base, CELL["T_base"], CELL_STEP),
        "T_tip": shown(run.T_tip, CELL["T_tip"], CELL_STEP),
    }
    if posed:
        columns["tip_angle"] = shown(run.tip_pose[:, 2], CAMERA, 1e-3)
        columns["displacement"] = shown(run.displacement + 4e-3, ENCODER, 1e-5)
    return {key: np.round(values, 6) for key, values in columns.items()}


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    gtr.write_recording(folder / "monday.csv", record(TRUTH, 1))
    gtr.write_recording(folder / "tuesday.csv", record(TRUTH, 2, posed=True))
    gtr.write_recording(folder / "oiled.csv", record(OILED, 3))
