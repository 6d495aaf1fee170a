"""Work against precision of the solver candidates and meshes; writes `results/solver_study.json` and a plot.

Everything here runs on one core, so that the times of different solvers compare.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import gtr_jax as gtr
from gtr_jax.mechanics import mesh
from gtr_jax.robot import build

from . import measure, systems
from .candidates import CANDIDATES, equilibrium
from .node_equation import node_equation
from .systems import System, draws

RESOLUTIONS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
EXACT = 16.0
LANES = 1024
CHUNK = 32
DENSE_AT_MOST = 110
# Names of mesh rules, each (intervals along, per half wave, fewest per panel, grading at a panel's start).
RULES = {
    "48, 20, 6, graded": (48, 20, 6, (0.06, 0.2, 0.5)),
    "48, 20, 6, even": (48, 20, 6, ()),
    "32, 20, 6, graded": (32, 20, 6, (0.06, 0.2, 0.5)),
    "64, 20, 6, graded": (64, 20, 6, (0.06, 0.2, 0.5)),
    "48, 16, 6, graded": (48, 16, 6, (0.06, 0.2, 0.5)),
    "48, 28, 6, graded": (48, 28, 6, (0.06, 0.2, 0.5)),
    "48, 20, 10, graded": (48, 20, 10, (0.06, 0.2, 0.5)),
    "48, 20, 6, steeper": (48, 20, 6, (0.02, 0.08, 0.3)),
    "48, 20, 8, longer": (48, 20, 8, (0.04, 0.12, 0.3, 0.6)),
}


def tip(robot: gtr.Robot, T_base, solver=None) -> tuple:
    """What is compared: tip tension, tip pose, and whether it converged."""
    eq = equilibrium(robot, T_base, solver or gtr.SolverOptions())
    return eq.T_tip, eq.tip_pose, eq.converged


def nodes(robot: gtr.Robot) -> int:
    return sum(robot.intervals) + len(robot.intervals)


def errors(found, exact) -> dict[str, float]:
    """Differences of (T_tip, tip_pose): tension as a share, position in m, angle in rad."""
    pose, pose_exact = np.asarray(found[1]), np.asarray(exact[1])
    return {
        "T_tip_relative": float(abs(found[0] - exact[0]) / abs(exact[0])),
        "tip_position_m": float(np.hypot(*(pose - pose_exact)[:2])),
        "tip_angle_rad": float(abs(pose[2] - pose_exact[2])),
    }


def lane(robot: gtr.Robot, solver=None):
    """One lane of a batch, as a function of `draws`."""
    return lambda x: tip(robot.with_values(mu=x["mu"], E=x["E"]), x["T_base"], solver)


def order(points: list[dict], key: str = "T_tip_relative") -> float | None:
    """Observed order of convergence: slope of log error against log nodes, above rounding."""
    used = [(p["nodes"], p[key]) for p in points if p["resolution"] >= 0.5 and p[key] > 1e-11]
    if len(used) < 2:
        return None
    n, e = np.log(np.asarray(used)).T
    return round(float(-np.polyfit(n, e, 1)[0]), 2)


def work_precision(system: System, quick: bool) -> dict[str, Any]:
    """Error against mesh, and for each candidate the time of one equilibrium and of a lane in a batch."""
    exact = jax.jit(tip)(system.robot(EXACT), system.T_base)
    batch = draws(system, 128 if quick else LANES)
    points = []
    for resolution in (0.5, 1.0) if quick else RESOLUTIONS:
        robot = system.robot(resolution)
        point: dict[str, Any] = {"resolution": resolution, "nodes": nodes(robot), "solvers": {}}
        for name, solver in CANDIDATES.items():
            dense = name == "dense Newton"
            if (dense and nodes(robot) > DENSE_AT_MOST) or (name != "march" and not 0.5 <= resolution <= 2.0):
                continue
            if quick and (dense or (resolution != 1.0 and name != "march")):
                continue

            def solve(robot, T_base, solver=solver):
                eq = equilibrium(robot, T_base, solver)
                return eq.T_tip, eq.tip_pose, eq.iterations

            time = measure.timed(solve, robot, system.T_base, budget=0.15)
            found = time.value
            entry = {"single_s": time.warm, "compile_s": time.cold, "iterations": int(found[2])}
            if name == "march":
                point |= errors(found, exact)
            if not dense and (name == "march" or resolution == 1.0):
                entry |= batched(robot, solver, batch)
            point["solvers"][name] = entry
        points.append(point)
    return {
        "T_base_N": system.T_base,
        "T_tip_N": float(exact[0]),
        "order_T_tip": order(points),
        "meshes": points,
    }


def batched(robot: gtr.Robot, solver, batch) -> dict[str, float]:
    """Seconds per lane as one vmap, and as lax.map over chunks."""
    one, count = lane(robot, solver), batch["mu"].shape[0]
    arrangements = {
        "lane_vmap_s": jax.jit(jax.vmap(one)),
        "lane_map_s": jax.jit(lambda b: jax.lax.map(one, b, batch_size=CHUNK)),
    }
    return {
        name: measure.shortest(fn, batch, budget=0.1, least=2) / count for name, fn in arrangements.items()
    }


def convergence(system: System, quick: bool) -> dict[str, Any]:
    """Share of random problems solved from a cold start, and how far the solutions lie from the march's."""
    robot, out, march = system.robot(0.5), {}, None
    batch = draws(system, 64 if quick else 512, seed=1)
    batch["T_base"] = batch["T_base"] * 2.0
    for name, solver in CANDIDATES.items():
        if name == "dense Newton" and (quick or nodes(robot) > 60):
            continue
        one = lane(robot, solver)
        T_tip, pose, ok = jax.jit(lambda b, one=one: jax.lax.map(one, b, batch_size=CHUNK))(batch)
        march = np.asarray(T_tip) if march is None else march
        ok = np.asarray(ok)
        apart = np.abs(np.asarray(T_tip) - march) / np.asarray(batch["T_base"])
        out[name] = {
            "share": float(ok.mean()),
            "furthest_from_march": float(apart[ok].max()) if ok.any() else None,
            "largest_tip_angle_rad": float(np.abs(np.asarray(pose)[ok, 2]).max()) if ok.any() else None,
        }
    return out


@contextlib.contextmanager
def mesh_rule(along: int, per_half_wave: int, fewest: int, grading: tuple[float, ...]) -> Iterator[None]:
    """Build robots with other mesh constants."""
    before = build.INTERVALS_ALONG, build.INTERVALS_PER_HALF_WAVE, build.FEWEST, mesh.GRADING
    try:
        build.INTERVALS_ALONG, build.INTERVALS_PER_HALF_WAVE, build.FEWEST = along, per_half_wave, fewest
        mesh.GRADING = grading
        mesh.panel_table.cache_clear()
        jax.clear_caches()
        yield
    finally:
        build.INTERVALS_ALONG, build.INTERVALS_PER_HALF_WAVE, build.FEWEST, mesh.GRADING = before
        mesh.panel_table.cache_clear()
        jax.clear_caches()


def mesh_rules(quick: bool) -> dict[str, Any]:
    """Nodes and errors of one pull under other mesh constants."""
    studied = systems.STUDIED[1:2] if quick else systems.STUDIED
    exact = {system.name: jax.jit(tip)(system.robot(EXACT), system.T_base) for system in studied}
    out = {}
    for name in list(RULES)[: 2 if quick else None]:
        out[name] = {}
        with mesh_rule(*RULES[name]):
            for system in studied:
                robot = system.robot()
                out[name][system.name] = {"nodes": nodes(robot)} | errors(
                    jax.jit(tip)(robot, system.T_base), exact[system.name]
                )
    return out


def loop(T_max: float, steps: int = 100) -> jnp.ndarray:
    """Pull, release to a fifth, re-pull, release to nothing."""
    turns = np.array([0.0, 1.0, 0.2, 1.0, 0.0]) * T_max
    return jnp.asarray(np.interp(np.linspace(0, 4, steps), np.arange(5), turns))


def loops(quick: bool) -> dict[str, Any]:
    """Largest errors over a hysteresis loop, where the stick front passes through the mesh."""
    out = {}
    for system in systems.LOOPED[: 1 if quick else None]:
        history = loop(system.T_base)
        exact = gtr.simulate(system.robot(EXACT / 2), history)
        meshes = []
        for resolution in (0.5, 1.0) if quick else (0.5, 1.0, 2.0, 4.0):
            robot = system.robot(resolution)
            run = gtr.simulate(robot, history)
            meshes.append(
                {
                    "resolution": resolution,
                    "nodes": nodes(robot),
                    "T_tip_N": float(jnp.max(jnp.abs(run.T_tip - exact.T_tip))),
                    "tip_angle_rad": float(jnp.max(jnp.abs(run.tip_pose - exact.tip_pose)[:, 2])),
                    "converged": bool(jnp.all(run.converged)),
                }
            )
        out[system.name] = {
            "T_base_N": system.T_base,
            "order_T_tip": order(meshes, "T_tip_N"),
            "meshes": meshes,
        }
    return out


def run(quick: bool = False, log=print) -> dict[str, Any]:
    """The whole study."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    study: dict[str, Any] = {
        "machine": measure.machine() | {"quick": quick},
        "systems": {},
        "convergence": {},
    }
    for system in systems.STUDIED[1:2] if quick else systems.STUDIED:
        log(f"solver study: {system.name}")
        study["systems"][system.name] = work_precision(system, quick)
        study["convergence"][system.name] = convergence(system, quick)
    log("solver study: node equation, mesh rules, loops")
    study["node_equation"] = node_equation(quick)
    study["mesh_rules"] = mesh_rules(quick)
    study["loops"] = loops(quick)
    return study


def main(quick: bool = False) -> None:
    """Run, write the JSON and the plots."""
    from .solver_plot import plot

    study = run(quick)
    measure.RESULTS.mkdir(exist_ok=True)
    name = "solver_study_quick" if quick else "solver_study"
    (measure.RESULTS / f"{name}.json").write_text(json.dumps(study, indent=1) + "\n")
    plot(study, measure.RESULTS / f"{name}.png")
    if not quick:
        docs = measure.RESULTS.parents[1] / "docs" / "img"
        docs.mkdir(parents=True, exist_ok=True)
        (docs / "solver_study.png").write_bytes((measure.RESULTS / f"{name}.png").read_bytes())
