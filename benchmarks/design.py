"""`python -m benchmarks.design`: targets made by hidden routings, found again; and scipy's bounded optimisers
with finite differences on the same problems in the same run.

Each family draws random designs within the bounds, keeps those that keep all limits, and takes the pose of
the tip as target. What `design` finds is judged on a mesh four times finer and by the literal integrals.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import Bounds, least_squares, minimize

import design
from design.binding import rows_of_limits
from design.distinct import distinct_options, is_new
from design.gauss_newton import BACK_OFF, judge_all, search_all
from design.literal import solve_literal
from design.objective import evaluate
from design.option import look_at
from design.problem import DesignProblem, problem_of
from design.search import ARRIVED, FEW_STEPS, SearchResult, find, without_goal
from design.space import on_common_mesh
from design.starts import put_in_order, starts
from gtr_jax.config.config import RobotConfig, load_config, parse_config
from gtr_jax.errors import InputError

from . import measure

LENGTH_SHARE, ANGLE = 1e-3, 1e-3  # 0.1 % of the length, 1 mrad
PENALTY = 1e4
CONE = {
    "schema": 1,
    "name": "cone",
    "backbone": {"length": "400 mm", "outer_radius": ["30 mm", "15 mm"], "youngs_modulus": "1.0 MPa"},
    "routing": {"kind": "converging-sine", "R_max": "12 mm", "r_min": "7 mm", "n_sine": 4, "sigma": 0.2},
    "tendon": {"friction_coefficient": 0.3},
}
LIMITS = {"wall_clearance": "1.5 mm", "min_channel_radius": "12 mm", "max_tension_loss": 0.8}


@dataclasses.dataclass(frozen=True)
class Family:
    """A kind of routing to hide: robot, target file without its pose, T_base and branch of the pose."""

    name: str
    robot: RobotConfig
    target: dict[str, Any]
    load: dict[str, Any]


def families() -> list[Family]:
    """Straight–sine–straight between bores, both sines, a spline; pulled, and released."""
    tdcm = load_config("examples/tdcm-1.toml")
    cone = parse_config(CONE)
    pulled, released = {"T_base": "45 N"}, {"T_base": "15 N", "branch": "releasing"}
    soft = {"T_base": "40 N"}
    top = {"T_base_max": "45 N"}
    base = {"schema": 1, "limits": LIMITS}
    spline = {"kind": "spline", "knots": 6}
    return [
        Family("straight-sine-straight", tdcm, base, pulled),
        Family("straight-sine-straight, releasing", tdcm, {**base, **top}, released),
        Family("converging-sine", cone, {**base, "search": {"n_sine": [4]}}, soft),
        Family("crossing-sine", cone, {**base, "search": {"kind": "crossing-sine", "n_sine": [3]}}, soft),
        Family("spline, 6 knots", cone, {**base, "search": spline}, soft),
    ]


def _problem(family: Family, pose: np.ndarray | None) -> DesignProblem:
    tip = [0.1, 0.1] if pose is None else pose[:2].tolist()
    angle = 0.5 if pose is None else float(pose[2])
    wanted = {"tip": tip, "angle": angle, "angle_tolerance": ANGLE, **family.load}
    return problem_of(family.robot, design.parse_target({**family.target, "pose": [wanted]}))


def hidden(family: Family, count: int, seed: int) -> tuple[DesignProblem, np.ndarray, np.ndarray]:
    """A problem of the family, and the coordinates and poses of feasible designs to find again."""
    problem = _problem(family, None)
    rng = np.random.default_rng(seed)
    zs, poses = [], []
    while sum(len(z) for z in zs) < count:
        z = rng.uniform(size=(1024, len(problem.space.all)))
        put_in_order(z, problem.space)
        judged = judge_all(problem.objective, jnp.asarray(z))
        good = np.asarray(judged.converged) & (np.min(np.asarray(judged.margins), axis=1) >= 0.0)
        zs.append(z[good])
        poses.append(np.asarray(judged.pose)[good, problem.objective.wanted.pose_state[0]])
    return problem, np.concatenate(zs)[:count], np.concatenate(poses)[:count]


def with_pose(problem: DesignProblem, pose: np.ndarray) -> DesignProblem:
    """The same problem with another pose as its target."""
    own = problem.target.pose[0].model_copy(update={"tip": tuple(pose[:2].tolist()), "angle": float(pose[2])})
    target = problem.target.model_copy(update={"pose": (own,)})
    target._source = problem.target.source
    objective = eqx.tree_at(lambda t: t.wanted.pose, problem.objective, jnp.asarray(pose)[None])
    return dataclasses.replace(problem, target=target, objective=objective)


def verified(problem: DesignProblem, found: SearchResult) -> dict[str, Any]:
    """The design that is chosen, judged apart from the search."""
    space = problem.space
    try:
        chosen = distinct_options(problem, found)[0]
        option = look_at(problem, np.array([chosen.values[v.name] for v in space.all]), resolution=4.0)
    except InputError:
        return {"reached": False, "kept": False, "tip": np.nan, "angle": np.nan, "literal": np.nan}
    error = option.errors[0]
    length = space.config.backbone.length
    robot = on_common_mesh(space, option.config, 1.0)
    number, released = problem.objective.states[problem.objective.wanted.pose_state[0]]
    s = np.linspace(0.0, length, 9)
    literal = solve_literal(
        robot,
        float(option.tensions[number]),
        released_from=float(np.max(option.tensions)) if released else None,
        start=(s, np.zeros(9)),
    )
    off = np.hypot(*(literal.pose[:2] - np.asarray(error.wanted)[:2]))
    return {
        "reached": error.distance <= LENGTH_SHARE * length and abs(error.turn) <= ANGLE,
        "kept": option.kept,
        "tip": error.distance / length,
        "angle": abs(error.turn),
        "literal": off / length if literal.settled else np.nan,
        "literal_angle": abs(literal.pose[2] - error.wanted[2]),
    }


def peers(problem: DesignProblem, z0: np.ndarray) -> dict[str, tuple[float, float]]:
    """Seconds until the first start arrives within the limits (NaN if none does) and for all starts, of
    scipy's optimisers with differences for derivatives. Each evaluation is the same compiled program, for one
    design; the starts are the same.
    """
    objective = problem.objective

    def rows(z):
        e = _judge(objective, jnp.asarray(np.clip(z, 0.0, 1.0)))
        return np.asarray(e.residuals), np.asarray(e.margins) - BACK_OFF

    def stacked(z):
        r, c = rows(z)
        return np.nan_to_num(np.concatenate([r, np.sqrt(PENALTY) * np.minimum(0.0, c)]), nan=1e6)

    def cost(z):
        return 0.5 * float(np.sum(stacked(z) ** 2))

    def arrived(z) -> bool:
        r, c = rows(z)
        return bool(np.all(np.abs(r) <= 1.0) and np.min(c) + BACK_OFF >= 0.0)

    starts_of_rows = _blocks(problem)

    def least(z):
        c = rows(z)[1]
        return np.nan_to_num(np.array([c[a:b].min() for a, b in starts_of_rows]), nan=-1.0)

    box = Bounds(0.0, 1.0)
    rows(z0[0])  # compiles

    def trf(z):
        return least_squares(stacked, z, bounds=(0.0, 1.0), max_nfev=100, xtol=1e-10, ftol=1e-10).x

    def lbfgsb(z):
        scale = 1.0 / max(cost(z), 1.0)
        return minimize(
            lambda x: scale * cost(x), z, method="L-BFGS-B", bounds=box, options={"maxiter": 200}
        ).x

    def slsqp(z):
        def value(x):
            return 0.5 * float(np.sum(rows(x)[0] ** 2))

        scale = 1.0 / max(value(z), 1.0)
        limits = {"type": "ineq", "fun": least}
        return minimize(
            lambda x: scale * value(x), z, method="SLSQP", bounds=box, constraints=limits,
            options={"maxiter": 100, "ftol": 1e-12},
        ).x  # fmt: skip

    out = {}
    for name, run in {"least_squares (trf)": trf, "L-BFGS-B": lbfgsb, "SLSQP": slsqp}.items():
        began, first = time.perf_counter(), np.nan
        for z in np.clip(z0, 1e-6, 1 - 1e-6):
            if arrived(run(z)) and not first == first:
                first = time.perf_counter() - began
        out[name] = (first, time.perf_counter() - began)
    return out


def first_arrival(problem: DesignProblem, z0: np.ndarray) -> float:
    """Seconds until the first start arrives, one after another as for the peers; NaN if none does."""
    objective, free = without_goal(problem.objective), jnp.ones((1, z0.shape[1]))
    began = time.perf_counter()
    for z in z0:
        found = search_all(objective, jnp.asarray(z)[None], free, FEW_STEPS)
        if float(found.cost[0]) < ARRIVED and float(jnp.min(found.rows)) >= 0.0:
            return time.perf_counter() - began
    return float("nan")


@eqx.filter_jit
def _judge(objective, z):
    return evaluate(objective, z)


def _blocks(problem: DesignProblem) -> list[tuple[int, int]]:
    sizes = list(rows_of_limits(problem).values())
    ends = np.cumsum(sizes)
    return list(zip(ends - sizes, ends, strict=True))


def study(family: Family, count: int, peer_count: int, seed: int) -> dict[str, Any]:
    """All numbers of one family."""
    began = time.perf_counter()
    problem, _, poses = hidden(family, count, seed)
    tasks = [with_pose(problem, pose) for pose in poses]
    find(tasks[0])  # compiles
    cold = time.perf_counter() - began
    began = time.perf_counter()
    alone = [_timed(find, p) for p in tasks[: min(count, 20)]]
    one = float(np.median([t for t, _ in alone]))
    began = time.perf_counter()
    with ThreadPoolExecutor(measure.cores()) as pool:
        found = list(pool.map(find, tasks))
    seconds = (time.perf_counter() - began) / count
    judged = [verified(p, f) for p, f in zip(tasks, found, strict=True)]
    out: dict[str, Any] = {
        "family": family.name,
        "targets": count,
        "parameters": len(problem.space.all),
        "cold_s": cold,
        "seconds_per_target": seconds,
        "median_s_one_at_a_time": one,
        "reached": int(sum(j["reached"] for j in judged)),
        "kept": int(sum(j["kept"] for j in judged)),
        "both": int(sum(j["reached"] and j["kept"] for j in judged)),
        "median_optima": float(np.median([_distinct(f) for f in found])),
        "worst_tip_share": float(np.nanmax([j["tip"] for j in judged])),
        "worst_angle": float(np.nanmax([j["angle"] for j in judged])),
        "worst_literal_share": float(np.nanmax([j["literal"] for j in judged])),
        "literal_unsettled": int(sum(not np.isfinite(j["literal"]) for j in judged)),
        "literal_within": int(
            sum(
                j["literal"] <= LENGTH_SHARE and j["literal_angle"] <= ANGLE
                for j in judged
                if "literal_angle" in j
            )
        ),
    }
    rivals: dict[str, list[tuple[float, float]]] = {}
    firsts = []
    for p in tasks[:peer_count]:
        z0, _ = starts(without_goal(p.objective), p.space, p.target.search.starts, p.target.search.seed)
        first_arrival(p, z0)  # compiles
        firsts.append(first_arrival(p, z0))
        for name, got in peers(p, z0).items():
            rivals.setdefault(name, []).append(got)
    out["first_s"] = float(np.nanmean(firsts)) if firsts else None
    out["peers"] = {
        name: {
            "first_s": float(np.nanmean([first for first, _ in got])),
            "all_s": float(np.mean([everything for _, everything in got])),
            "reached": int(sum(first == first for first, _ in got)),
            "of": len(got),
        }
        for name, got in rivals.items()
    }
    return out


def _distinct(found: SearchResult) -> int:
    good = found.z[found.kept & (found.cost < ARRIVED)]
    kept: list[np.ndarray] = []
    for z in good:
        if is_new(z, kept):
            kept.append(z)
    return len(kept)


def _timed(fn, *args):
    began = time.perf_counter()
    value = fn(*args)
    return time.perf_counter() - began, value


def table(results: list[dict[str, Any]], machine: dict[str, Any]) -> str:
    """The results as a table for the docs."""
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, load {os.getloadavg()[0]:.1f}, "
        f"jax {machine['versions']['jax']}, {machine['date']}",
        "",
        "| routing | numbers | targets | reached, limits kept | worst tip error | by the literal integrals "
        "| optima | s per target, all starts | compiling, s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for r in results:
        lines.append(
            f"| {r['family']} | {r['parameters']} | {r['targets']} | {r['both']} | "
            f"{100 * r['worst_tip_share']:.2g} % of L, {1e3 * r['worst_angle']:.2g} mrad | "
            f"{r['literal_within']} | {r['median_optima']:.0f} | {r['seconds_per_target']:.3g} | "
            f"{r['cold_s']:.0f} |"
        )
    lines += [
        "",
        "| routing | scipy, differences | reached | first arrival, s | ours, s | ratio | all starts, s "
        "| ratio |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for r in results:
        for name, p in r["peers"].items():
            first, everything = p["first_s"] / r["first_s"], p["all_s"] / r["median_s_one_at_a_time"]
            lines.append(
                f"| {r['family']} | {name} | {p['reached']} of {p['of']} | {p['first_s']:.3g} | "
                f"{r['first_s']:.3g} | {first:.0f} | {p['all_s']:.3g} | {everything:.0f} |"
            )
    total, both = (sum(r[k] for r in results) for k in ("targets", "both"))
    lines += ["", f"In all {both} of {total} targets reached with all limits kept."]
    return "\n".join(lines) + "\n"


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.design", description=__doc__)
    parser.add_argument("--targets", type=int, default=40, help="of each family")
    parser.add_argument("--peers", type=int, default=8, help="targets that scipy gets, of each family")
    parser.add_argument("--only", type=int, action="append", help="number of a family; repeatable")
    parser.add_argument("--seed", type=int, default=20)
    parser.add_argument("--write", action="store_true", help="write benchmarks/results/design.json and .md")
    args = parser.parse_args(argv)
    results = []
    for i, family in enumerate(families()):
        if args.only and i not in args.only:
            continue
        results.append(study(family, args.targets, args.peers, args.seed + i))
        print(json.dumps(results[-1]), flush=True)
    said = table(results, measure.machine())
    print(said)
    if args.write:
        (measure.RESULTS / "design.json").write_text(
            json.dumps({"machine": measure.machine(), "results": results}, indent=1) + "\n"
        )
        (measure.RESULTS / "design.md").write_text(said)
    return 0


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    sys.exit(main())
