"""`python -m benchmarks.outside_example`: make the recording of `gtr demo` whose cause is in no catalogue.

The machine of the blind benchmark pulls an arm whose friction rises by up to 70 % where the tension is near
20 N, as if a lubricant were pressed out and came back; instruments add noise.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

import gtr_jax.examples as examples

from .blind.cases import BUILDS, built, protocol, robot_file
from .blind.effects import Scene
from .blind.machine import run

SEED = 20261125
MU, SIZE, AT, WIDTH = 0.24, 0.7, 20.0, 5.0
# Noise of the cells [N], of the tip's position [m] and angle [rad], and of the displacement [m].
CELL, BASE, POSITION, ANGLE, DRAWN = 0.04, 0.01, 2e-4, 2e-3, 2e-5


def made(rng: np.random.Generator) -> tuple[str, list[dict[str, str]]]:
    """Robot file and rows of the recording."""
    build = next(b for b in BUILDS if b.name == "one-bend")
    arm, _ = built(build, rng, MU)
    time, T_base, trial = protocol("rich", build.largest, rng)
    scene = Scene(arm, time, T_base, trial)
    scene.law(friction=lambda g: 1 + SIZE * np.exp(-(((g.tension - AT) / WIDTH) ** 2)))
    shown = run(scene.arm, time, T_base)
    columns = {
        "T_base_N": T_base + BASE * rng.normal(size=len(time)),
        "T_tip_N": shown.T_tip + CELL * rng.normal(size=len(time)),
        "tip_x_m": shown.pose[:, 0] + POSITION * rng.normal(size=len(time)),
        "tip_y_m": shown.pose[:, 1] + POSITION * rng.normal(size=len(time)),
        "tip_angle_rad": shown.pose[:, 2] + ANGLE * rng.normal(size=len(time)),
        "displacement_m": shown.drawn + DRAWN * rng.normal(size=len(time)),
    }
    digits = {"T_base_N": 2, "T_tip_N": 2, "tip_angle_rad": 5}
    rows = [
        {"time_s": f"{time[k]:.6g}"}
        | {name: f"{values[k]:.{digits.get(name, 6)}f}" for name, values in columns.items()}
        | {"trial": str(int(trial[k]))}
        for k in range(len(time))
    ]
    return robot_file(build, False).replace(build.name, "outside"), rows


def main() -> None:
    """Write both files beside the other examples."""
    robot, rows = made(np.random.default_rng(SEED))
    Path(examples.OUTSIDE_ROBOT).write_text(robot, encoding="utf-8")
    with Path(examples.OUTSIDE).open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
