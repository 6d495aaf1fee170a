"""`python -m benchmarks.terms [--reference DIR]`: the physics terms against an independent simulator, and
what they cost.

The runs in DIR (one folder per term; those of the tests unless given) come from a chain of rigid links with a
polyline tendon, marched in time. Each is simulated with its own parameters set, at the default mesh and at
twice its intervals. The second table has the time of a history of 1,000 steps without terms, with all of them
in the program but none acting, and with each acting, as ratios to the first.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import gtr_jax as gtr
from gtr_jax.examples import SIMULATED
from gtr_jax.report.term_pages import history
from gtr_jax.terms import REGISTRY

FIXTURES = Path(__file__).parents[1] / "tests/data/reference"
RESULTS = Path(__file__).parent / "results/terms.md"
REPEATS = 3

# Parameters of the independent simulator (its README), as numbers of terms.
KEYS = {
    "x0": "presliding.length",
    "mu_visc": "viscous-friction.coefficient",
    "stat_ratio": "stribeck-friction.ratio",
    "v_str": "stribeck-friction.speed",
    "p_exp": "pressure-dependent-friction.exponent",
    "N_ref": "pressure-dependent-friction.reference",
    "adhesion": "adhesion.drag",
    "asym": "friction-asymmetry.ratio",
    "pulley": "local-friction.base",
    "tip_lump": "local-friction.tip",
    "clearance": "clearance.share",
    "T_clear": "clearance.tension",
    "stiffening": "stiffening.coefficient",
    "ve_ratio": "viscoelastic-body.ratio",
    "ve_tau": "viscoelastic-body.time",
    "wall_k": "contact.stiffness",
    "wall_y": "contact.distance",
}
LISTS = {
    "patch": ("local-friction.start", "local-friction.end", "local-friction.factor"),
    "tip_force": ("tip-load.x", "tip-load.y"),
}


def values_of(parameters: dict[str, Any]) -> dict[str, float]:
    """Numbers of terms from the parameters of a reference run."""
    values = {KEYS[key]: float(v) for key, v in parameters.items() if key in KEYS}
    for key, names in LISTS.items():
        values |= dict(zip(names, parameters.get(key, ()), strict=False))
    if "x0" in parameters:
        values["presliding.elements"] = float(parameters["presliding_law"] == "maxwell-slip")
    return values


class Compared(NamedTuple):
    """How far a simulated run is from a reference run: tip tension [N] and tip angle [rad], per sample, (K,);
    what is allowed of each; whether every step converged; iterations per step, (K,).
    """

    tension: np.ndarray
    angle: np.ndarray
    allowed: float
    allowed_angle: float
    converged: bool
    iterations: np.ndarray


def compared(folder: Path, resolution: float = 1.0) -> Compared:
    """Simulate one reference run and compare."""
    told = json.loads((folder / "physics.json").read_text())
    run = gtr.read_recording(folder / "recording.csv")
    robot = gtr.load_robot(folder / "robot.toml", resolution=resolution)
    robot = robot.with_values(**values_of(told["parameters"]))
    found = gtr.simulate(robot, run.T_base, time=run.time)
    assert run.T_tip is not None and run.tip_angle is not None
    return Compared(
        np.abs(np.asarray(found.T_tip) - run.T_tip),
        np.abs(np.asarray(found.tip_pose[:, 2]) - run.tip_angle),
        max(3 * told["change_from_half_mesh_N"], 0.002 * float(np.max(run.T_base))),
        max(3 * told["change_from_half_mesh_angle_rad"], 0.004),
        bool(found.converged.all()),
        np.asarray(found.iterations),
    )


def reference_rows(folder: Path) -> list[str]:
    """The table of one run, a line per mesh."""
    rows = []
    for resolution in (1.0, 2.0):
        c = compared(folder, resolution)
        rms = float(np.sqrt(np.mean(c.tension**2)))
        rows.append(
            f"| {folder.name} | {resolution:g} | {1e3 * c.tension.max():.1f} | {1e3 * rms:.1f} "
            f"| {1e3 * c.allowed:.0f} | {1e3 * c.angle.max():.2f} | {1e3 * c.allowed_angle:.1f} "
            f"| {c.iterations.mean():.1f}, {c.iterations.max()} | {'yes' if c.converged else 'NO'} |"
        )
    return rows


def _seconds(call) -> tuple[float, float]:
    """First and best later time of a call."""
    times = []
    for _ in range(1 + REPEATS):
        began = time.perf_counter()
        jax.block_until_ready(call().T_tip)
        times.append(time.perf_counter() - began)
    return times[0], min(times[1:])


def cost_rows() -> list[str]:
    """The table of times."""
    clock, T_base = history()
    at = np.linspace(0.0, clock[-1], 1000)
    T_base, robot = np.interp(at, clock, T_base), gtr.load_robot(SIMULATED)
    cold, plain = _seconds(lambda: gtr.simulate(robot, T_base, time=at, with_terms=False))
    traced = jax.jit(lambda robot: gtr.simulate(robot, T_base, time=at))
    rows = [f"| without the terms | {cold:.1f} | {1e3 * plain:.1f} | 1 |"]
    cold, seconds = _seconds(lambda: traced(robot))
    rows.append(
        f"| the robot's numbers traced, no term acting | {cold:.1f} | {1e3 * seconds:.1f} "
        f"| {seconds / plain:.2f} |"
    )
    cold, seconds = _seconds(lambda: gtr.simulate(robot, T_base, time=at, with_terms=True))
    rows.append(f"| with all terms, none acting | {cold:.1f} | {1e3 * seconds:.1f} | {seconds / plain:.1f} |")
    for term in REGISTRY.values():
        if not term.of_cells:
            on = robot.with_values(**{f"{term.id}.{q.name}": float(q.typical) for q in term.quantities})
            cold, seconds = _seconds(lambda on=on: gtr.simulate(on, T_base, time=at))
            rows.append(f"| {term.id} | {cold:.1f} | {1e3 * seconds:.1f} | {seconds / plain:.1f} |")
    return rows


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.terms", description=__doc__)
    parser.add_argument("--reference", type=Path, default=FIXTURES, metavar="DIR", help="the reference runs")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS, metavar="FILE")
    args = parser.parse_args(argv)
    columns = (
        *("run", "mesh", "worst T_tip [mN]", "rms [mN]", "allowed [mN]", "worst angle [mrad]"),
        *("allowed [mrad]", "marches, most", "converged"),
    )
    lines = [f"| {' | '.join(columns)} |", "|" + "---|" * len(columns)]
    for folder in sorted(args.reference.iterdir()):
        if (folder / "physics.json").exists():
            lines += reference_rows(folder)
            print(*lines[-2:], sep="\n", flush=True)
    lines += ["", "| 1,000 steps | cold [s] | warm [ms] | ratio |", "|---|---|---|---|", *cost_rows()]
    print(*lines[-24:], sep="\n")
    args.output.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
