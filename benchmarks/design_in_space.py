"""`python -m benchmarks.design_in_space`: targets in space made by hidden routings, found again.

Each family draws random designs within the bounds, keeps those that keep all limits, and takes the place of
the tip and the direction of the midline there as target. What `design` finds is judged on a mesh four times
finer: reached is 0.1 % of the length and 2 mrad.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import design
from design.distinct import distinct_options
from design.gauss_newton import judge_all
from design.pose import DIRECTION
from design.problem import DesignProblem, problem_of
from design.search import find
from design.starts import put_in_order
from gtr_jax.config.config import RobotConfig, load_config, parse_config
from gtr_jax.errors import InputError

from . import measure

LENGTH_SHARE, ANGLE = 1e-3, 2e-3  # 0.1 % of the length, 2 mrad
WALLS = {"wall_clearance": "1.5 mm", "channel_diameter": "1 mm", "min_channel_radius": "12 mm"}
LIMITS = {**WALLS, "bore_clearance": "0.5 mm", "max_tension_loss": 0.8}


@dataclasses.dataclass(frozen=True)
class Family:
    """A kind of design to hide: robot, target file without its pose, and base tension of the pose."""

    name: str
    robot: RobotConfig
    target: dict[str, Any]
    T_base: Any


def families() -> list[Family]:
    """A helix, a curve, a wave in a turned plane, and three tendons of free tensions."""
    helix = load_config("examples/helix.toml")
    data = helix.model_dump(mode="json", by_alias=True, exclude_none=True)
    tapered = parse_config({**data, "routing": {**data["routing"], "tip_radius": "7 mm"}})
    wave = {"kind": "straight-sine-straight", "r1": "-8 mm", "r2": "8 mm", "w1": "60 mm", "w2": "180 mm"}
    turned = parse_config({**data, "routing": {**wave, "plane_angle": "20 deg"}})
    three = load_config("examples/three-tendons.toml")
    winding = {"bounds": {"turns": [-1.5, 1.5]}}
    plane = {"routing": ["r1", "r2", "w1", "w2", "plane_angle"]}
    pulls = {"routing": ["angle.a", "angle.b"], "free": ["T_base"], "bounds": {"T_base": ["0 N", "6 N"]}}
    base = {"schema": 1, "limits": LIMITS}
    several = {"schema": 1, "limits": WALLS | {"channel_clearance": "1 mm"}}
    return [
        Family("helix, tapered", tapered, {**base, "search": winding}, "12 N"),
        Family("curve, 4 knots", helix, {**base, "search": {"kind": "curve", "knots": 4}}, "12 N"),
        Family("straight-sine-straight in a turned plane", turned, {**base, "search": plane}, "15 N"),
        Family(
            "three tendons, their tensions and two angles",
            three,
            {**several, "search": pulls},
            {"a": "3 N", "b": "1 N", "c": "2 N"},
        ),
    ]


def _problem(family: Family) -> DesignProblem:
    pose = {"tip": ["200 mm", "10 mm", "10 mm"], "direction": [1, 0, 0], "angle_tolerance": ANGLE}
    return problem_of(
        family.robot, design.parse_target({**family.target, "pose": [{"T_base": family.T_base, **pose}]})
    )


def hidden(family: Family, count: int, seed: int) -> tuple[DesignProblem, np.ndarray]:
    """A problem of the family, and the poses of feasible designs to find again, (count, pose)."""
    problem = _problem(family)
    rng = np.random.default_rng(seed)
    poses: list[np.ndarray] = []
    while sum(map(len, poses)) < count:
        z = rng.uniform(size=(256, len(problem.space.all)))
        put_in_order(z, problem.space)
        judged = judge_all(problem.objective, jnp.asarray(z))
        good = np.asarray(judged.converged) & (np.min(np.asarray(judged.margins), axis=1) >= 0.0)
        poses.append(np.asarray(judged.pose)[good, problem.objective.wanted.pose_state[0]])
    return problem, np.concatenate(poses)[:count]


def with_pose(problem: DesignProblem, pose: np.ndarray) -> DesignProblem:
    """The same problem with another pose as its target."""
    wanted = {"tip": tuple(pose[:3].tolist()), "direction": tuple(pose[DIRECTION].tolist())}
    own = problem.target.pose[0].model_copy(update=wanted)
    target = problem.target.model_copy(update={"pose": (own,)})
    target._source = problem.target.source
    objective = eqx.tree_at(lambda t: t.wanted.pose, problem.objective, jnp.asarray(pose)[None])
    return dataclasses.replace(problem, target=target, objective=objective)


def one(problem: DesignProblem) -> dict[str, Any]:
    """The design that is chosen for one target, judged on a mesh four times finer."""
    began, spent = time.perf_counter(), time.process_time()
    try:
        chosen = distinct_options(problem, find(problem))[0]
    except InputError:
        return {"reached": False, "kept": False, "tip": np.nan, "angle": np.nan, "s": np.nan, "cpu_s": np.nan}
    error, length = chosen.errors[0], problem.space.config.backbone.length
    return {
        "reached": chosen.converged and error.distance <= LENGTH_SHARE * length and error.turn <= ANGLE,
        "kept": chosen.kept,
        "tip": error.distance / length,
        "angle": error.turn,
        "s": time.perf_counter() - began,
        "cpu_s": time.process_time() - spent,
    }


def study(family: Family, count: int, seed: int) -> dict[str, Any]:
    """All numbers of one family."""
    spent = time.process_time()
    problem, poses = hidden(family, count, seed)
    one(with_pose(problem, poses[0]))  # compiles
    cold = time.process_time() - spent
    found = [one(with_pose(problem, pose)) for pose in poses]
    good = [f for f in found if f["reached"] and f["kept"]]
    return {
        "family": family.name,
        "targets": count,
        "numbers": len(problem.space.all),
        "reached": sum(f["reached"] for f in found),
        "kept": sum(f["kept"] for f in found),
        "both": len(good),
        "worst_tip_share": max((f["tip"] for f in good), default=np.nan),
        "worst_angle": max((f["angle"] for f in good), default=np.nan),
        "cpu_s": float(np.nanmedian([f["cpu_s"] for f in found])),
        "cold_cpu_s": cold,
        "missed": [f for f in found if not (f["reached"] and f["kept"])],
    }


def table(results: list[dict[str, Any]], machine: dict[str, Any]) -> str:
    """The results as a table for the docs."""
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, load {os.getloadavg()[0]:.1f}, "
        f"jax {machine['versions']['jax']}, {machine['date']}",
        "",
        "| routing | numbers | targets | reached | limits kept | both | worst of these "
        "| CPU s per target | CPU s before, compiling |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in results:
        lines.append(
            f"| {r['family']} | {r['numbers']} | {r['targets']} | {r['reached']} | {r['kept']} | "
            f"{r['both']} | "
            f"{100 * r['worst_tip_share']:.2g} % of L, {1e3 * r['worst_angle']:.2g} mrad | "
            f"{r['cpu_s']:.3g} | {r['cold_cpu_s']:.0f} |"
        )
    total, both = (sum(r[k] for r in results) for k in ("targets", "both"))
    lines += ["", f"In all {both} of {total} targets reached with all limits kept."]
    return "\n".join(lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.design_in_space", description=__doc__)
    parser.add_argument("--targets", type=int, default=25, help="of each family")
    parser.add_argument("--only", type=int, action="append", help="number of a family; repeatable")
    parser.add_argument("--seed", type=int, default=40)
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/design_in_space.md")
    args = parser.parse_args(argv)
    results = []
    for i, family in enumerate(families()):
        if args.only and i not in args.only:
            continue
        results.append(study(family, args.targets, args.seed + i))
        print(json.dumps(results[-1]), flush=True)
        if args.write:  # what is done is kept, should the next family be cut short
            (measure.RESULTS / "design_in_space.md").write_text(table(results, measure.machine()))
    print(table(results, measure.machine()))
    return 0


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    sys.exit(main())
