"""Labelled recordings from noise-free ones: `python -m benchmarks.noisy REFERENCE OUT`, then
`python -m benchmarks.labelled OUT`.

REFERENCE holds a folder for each effect: robot.toml with the true numbers, physics.json, and recording.csv of
tensions, pose and displacement. Of each OUT gets two: with the pose, and of tensions alone; both cells with
noise that goes on from sample to sample and grains of 0.01 N, and E in the robot file 8 % too large.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np

from .blind.cases import coloured

# Standard deviation of each channel, in its unit, and correlation of neighbours.
NOISE = {
    "T_base_N": (0.012, 0.3),
    "T_tip_N": (0.05, 0.5),
    "tip_x_m": (3e-4, 0.0),
    "tip_y_m": (3e-4, 0.0),
    "tip_angle_rad": (5e-3, 0.0),
    "displacement_m": (1e-4, 0.0),
}
GRAIN, E_OFF = 0.01, 1.08
TENSIONS = ("time_s", "T_base_N", "T_tip_N", "trial")
# Folders named otherwise than the term that they hold.
TERMS = ("local-friction", "presliding")


def effect(name: str) -> list[str]:
    """Terms that a folder holds, by its name."""
    if name.startswith("coulomb"):
        return []
    return [next((term for term in TERMS if name.startswith(term)), name)]


def write(folder: Path, out: Path) -> None:
    """Two labelled cases from a noise-free one."""
    with (folder / "recording.csv").open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        run = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
    rng = np.random.default_rng(sum(map(ord, folder.name)))
    for name in ("T_tip_N", "T_base_N", *(n for n in NOISE if not n.startswith("T_"))):
        sd, rho = NOISE[name]
        run[name] = run[name] + sd * coloured(rng, rho, len(run[name]), heavy=False)
        if name.startswith("T_"):
            run[name] = np.round(run[name] / GRAIN) * GRAIN
    robot = (folder / "robot.toml").read_text(encoding="utf-8")
    stated = re.compile(r'youngs_modulus = "([\d.]+) MPa"')
    robot = stated.sub(lambda found: f'youngs_modulus = "{E_OFF * float(found[1]):.5g} MPa"', robot, count=1)
    mu = json.loads((folder / "physics.json").read_text(encoding="utf-8"))["parameters"]["mu"]
    for kind, columns in (("pose", names), ("tensions", TENSIONS)):
        case = out / f"{folder.name}-{kind}"
        case.mkdir(parents=True, exist_ok=True)
        (case / "robot.toml").write_text(robot, encoding="utf-8")
        rows = np.column_stack([run[name] for name in columns])
        header = ",".join(columns)
        np.savetxt(case / "recording.csv", rows, "%.8g", ",", header=header, comments="")
        truth = {"effects": effect(folder.name), "mu": mu}
        (case / "truth.json").write_text(json.dumps(truth), encoding="utf-8")


def main() -> None:
    """Write the cases."""
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    reference, out = map(Path, sys.argv[1:])
    folders = sorted(path.parent for path in reference.glob("*/recording.csv"))
    if not folders:
        sys.exit(f"{reference}: no folder with recording.csv in it")
    for folder in folders:
        write(folder, out)


if __name__ == "__main__":
    main()
