"""Inputs that are made for the cases: robot files of the reference runs in space, and blind recordings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

# Opened pages of the blind benchmark, and how many recordings each had.
OPENED, DRAWN = (26_11_27_71, 26_11_27_91), 120
DRAWS = 20


def make(name: str, folder: Path, root: Path) -> None:
    """Make `folder/name`, unless it is there: `reference3d/NAME.toml` or `blind/SEED-NUMBER`."""
    target = folder / name
    if target.exists():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    if name.startswith("blind/"):
        _blind(target)
    else:
        run = json.loads((root / "tests/data" / name).with_suffix(".json").read_text(encoding="utf-8"))
        target.write_text(tomli_w.dumps(_robot(target.stem, run)), encoding="utf-8")


def _blind(target: Path) -> None:
    """A recording of an opened page, drawn as `benchmarks.blind.exam` draws it."""
    from benchmarks.blind import cases

    seed, number = map(int, target.name.split("-"))
    kind, hidden = cases.kinds(np.random.default_rng([seed]), DRAWN)[number]
    for draw in range(DRAWS):
        rng = np.random.default_rng([seed, number, draw])
        rng.bytes(16)  # the name that the benchmark gives it
        case = cases.make(kind, hidden, rng)
        if case is not None:
            cases.write(case, target, target / "key.json")
            return
    raise RuntimeError(f"the machine fails at every draw of case {number} of seed {seed}")


def _robot(name: str, run: dict[str, Any]) -> dict[str, Any]:
    """The robot file of a run in tests/data/reference3d."""
    twist, about_y, about_z = run["natural_strain_1_m"]
    body = {
        "length": run["length_m"],
        "outer_radius": run["radius_m"],
        "youngs_modulus": run["youngs_modulus_Pa"],
        "poissons_ratio": run["poissons_ratio"],
        "density": run["density_kg_m3"],
        "natural_twist": twist,
        "natural_curvature_y": about_y,
        "natural_curvature": about_z,
    }
    if name == "helix-rod":  # a rod that carries its tendon on disks
        EI = body.pop("youngs_modulus") * np.pi / 4 * run["radius_m"][0] ** 4
        body |= {"outer_radius": 0.008, "bending_stiffness": float(EI)}
    loads = {"tip_force": run["tip_force_N"], "gravity": run["gravity_m_s2"]}
    robot = {"schema": 1, "name": name, "space": True, "backbone": body}
    robot["loads"] = {key: vector for key, vector in loads.items() if any(vector)}
    mu = run["friction_coefficient"]
    routings = [_routing(tendon) for tendon in run["tendons"]]
    if len(routings) == 1:
        return robot | {"routing": routings[0], "tendon": {"friction_coefficient": mu}}
    named = zip("abc", routings, strict=False)
    return robot | {
        "tendons": [{"name": n, "friction_coefficient": mu, "routing": routing} for n, routing in named]
    }


def _routing(tendon: dict[str, Any]) -> dict[str, Any]:
    if tendon["kind"] != "helix":
        reach = tendon["amplitude_m"]
        waves = {"R_max": reach, "r_min": reach, "n_sine": 2 * tendon["periods"]}
        return {"kind": "crossing-sine", "plane_angle": tendon["plane_angle_rad"]} | waves
    start = tendon["start_angle_rad"]
    if tendon["turns"] == 0:
        return {"kind": "straight", "radius": tendon["radius_base_m"], "angle": start}
    radii = {"radius": tendon["radius_base_m"], "tip_radius": tendon["radius_tip_m"]}
    return {"kind": "helix", "turns": tendon["turns"], "start_angle": start} | radii
