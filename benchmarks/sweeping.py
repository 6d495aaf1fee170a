"""Sweeps: lanes per second by arrangement, accuracy, scaling, the million points, and workers.

`python -m benchmarks.sweeping --write` measures lane counts and accuracy, and writes results/lanes.md, on
which the constants of `gtr_jax.sweep` rest.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import tomli_w

import gtr_jax as gtr
from gtr_jax.config.toml_file import read_toml
from gtr_jax.sweep import parse_sweep, task_of
from gtr_jax.sweep import task as sweep_task
from gtr_jax.sweep.lanes import Lanes
from gtr_jax.sweep.plan import plan_of
from gtr_jax.sweep.task import Task

from . import measure, systems
from .commands import run_command
from .speed import Metric
from .systems import System

VARY = {"mu": {"from": 0.05, "to": 0.8}, "E": {"from": 0.7e6, "to": 2.1e6}}
POSE = ["T_tip", "tip_pose"]
EXAMPLES = Path(__file__).parents[1] / "examples"
PRESLIDING = [{"kind": "presliding", "length": "0.6 mm"}]
WITH_TERMS = System("TD-CM I, presliding", systems.TDCM_1.file | {"terms": PRESLIDING}, 45.0)
RESOLUTIONS = (1.0, 0.5, 0.35, 0.25)
COUNTS = (10**2, 10**3, 10**4, 10**5, 10**6)


def file_of(folder: Path, system: System, count: int, history: dict, **more) -> Path:
    """A sweep file of points drawn in mu and E."""
    (folder / "robot.toml").write_text(tomli_w.dumps(system.file), encoding="utf-8")
    data = {"schema": 1, "robot": "robot.toml", "outputs": POSE, "sample": "random", "count": count, **more}
    data |= {"vary": VARY, "history": {"pull": system.T_base, **history}}
    path = folder / "sweep.toml"
    path.write_text(tomli_w.dumps(data), encoding="utf-8")
    return path


def task_for(system: System, count: int, **more) -> Task:
    """The same, ready to solve."""
    history = more.pop("history", {})
    with tempfile.TemporaryDirectory() as temporary:
        path = file_of(Path(temporary), system, count, history, **more)
        return task_of(parse_sweep(read_toml(path), folder=path.parent))


def points_of(task: Task, count: int) -> np.ndarray:
    """Values of what is varied, (count, axes)."""
    shares = np.random.default_rng(0).random((count, len(task.axes)))
    return np.stack([axis.at(shares[:, i]) for i, axis in enumerate(task.axes)], axis=1)


def seconds(task: Task, count: int, threads: int) -> float:
    """To solve `count` points once compiled, parted into blocks over threads; the shortest of three."""
    per_thread = -(-count // threads)
    block = min(per_thread, 2**16)
    task = dataclasses.replace(task, plan=plan_of(task.file, task.axes, threads * block, block))
    lanes, points = Lanes(task), points_of(task, block)
    blocks = [points] * max(round(count / block), 1)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lanes.solve, blocks[:threads]))
        best = np.inf
        for _ in range(3):
            began = time.perf_counter()
            list(pool.map(lanes.solve, blocks))
            best = min(best, time.perf_counter() - began)
    return best * count / (len(blocks) * block)


def tip_error(system: System, resolution: float, count: int = 200) -> float:
    """Largest distance of the tip from where a mesh eight times finer has it, relative to the length, over
    points drawn as in a sweep.
    """
    found = []
    for factor in (resolution, 8.0):
        task = task_for(system, count, resolution=factor)
        task = dataclasses.replace(task, plan=plan_of(task.file, task.axes, count, count))
        solved = Lanes(task).solve(points_of(task, count))
        found.append(np.stack([solved["tip_x"], solved["tip_y"]]))
    length = float(task_for(system, count).robot.backbone.length)
    return float(np.nanmax(np.hypot(*(found[0] - found[1]))) / length)


def exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Slope of log time over log size."""
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def batch_sizes(quick: bool) -> Iterator[Metric]:
    """Lanes from 10^2 to 10^6 on all cores, and the exponent of their cost."""
    task, took = task_for(systems.TDCM_1, 1), []
    counts = COUNTS[:3] if quick else COUNTS
    for count in counts:
        took.append(seconds(task, count, measure.cores()))
        yield Metric(f"lanes.{count:.0e}".replace("e+0", "e"), took[-1] / count * 1e6, "µs")
    large = [i for i, count in enumerate(counts) if count >= 10**3]
    slope = exponent([counts[i] for i in large], [took[i] for i in large])
    yield Metric("lanes.exponent", slope, "", target=1.05, note="cost against lanes, from 1e3 on")


def rates(quick: bool) -> Iterator[Metric]:
    """Frictional equilibria per second on all cores, at a tip error of at most 1e-4."""
    for system, target in ((systems.TDCM_1, 1e5), (systems.TDCM_1_LOADED, None), (systems.CONE_WAVE, None)):
        for resolution in (1.0,) if quick else (1.0, 0.5):
            task = task_for(system, 1, resolution=resolution)
            count = 20_000 if quick else 100_000
            took = seconds(task, count, measure.cores())
            error = tip_error(system, resolution)
            yield Metric(
                f"rate.{system.name}, mesh {resolution:g}",
                count / took,
                "1/s",
                direction="higher",
                target=target,
                gated=count / took * measure.reference_seconds(0.2),
                note=f"tip within {error:.1e} of the length, {task.nodes} nodes",
            )
        if quick:
            return


def in_space(quick: bool) -> Iterator[Metric]:
    """Frictional equilibria of the helix of the examples on all cores: unloaded and under a force."""
    helix = System("helix", read_toml(EXAMPLES / "helix.toml"), 10.0)
    pushed = {"tip_force": [0.0, 0.0, 0.02]}
    loaded = helix._replace(name="helix, loaded", file=helix.file | {"loads": pushed})
    for system, target in ((helix, 15.0), (loaded, None)):
        task = task_for(system, 1)
        count = 2_000 if quick else 10_000
        took = seconds(task, count, measure.cores())
        yield Metric(
            f"space.{system.name}", took / count * 1e6, "µs", target=target, note=f"{task.nodes} nodes"
        )
        if quick:
            return


def scaling(quick: bool) -> Iterator[Metric]:
    """Cost against nodes and load steps: fitted exponents."""
    if quick:
        return
    sizes, took = [], []
    for resolution in (1.0, 2.0, 4.0, 8.0):
        task = task_for(systems.TDCM_1, 1, resolution=resolution)
        sizes.append(task.nodes)
        took.append(seconds(task, 20_000, 1))
    yield Metric("scaling.nodes", exponent(sizes, took), "", note=f"{sizes[0]} to {sizes[-1]} nodes, batched")
    robot, T = systems.TDCM_1.robot(), systems.TDCM_1.T_base
    steps, took = (256, 1024, 4096, 16384), []
    for count in steps:
        history = T * np.abs(np.sin(np.linspace(0, 6, count)))
        took.append(measure.timed(gtr.simulate, robot, history, jit=False).warm)
    yield Metric("scaling.steps", exponent(steps, took), "", note=f"{steps[0]} to {steps[-1]} load steps")


def million(quick: bool) -> Iterator[Metric]:
    """A sweep of 10^6 points by the command: everything, the writing and the interpreter included."""
    if quick:
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        path = file_of(folder, systems.TDCM_1, 10**6, {})
        for run in ("cold", "warm"):
            out = folder / run
            took, memory = run_command(["sweep", path, "-o", out, "--no-plot"], folder / "cache")
            said = json.loads((out / "sweep.json").read_text())
            rate = said["computed"]["points"] / said["computed"]["seconds"]
            yield Metric(
                f"sweep.1e6 points.{run}",
                took,
                "s",
                target=60.0,
                note=f"{rate:,.0f} per second while computing and writing; {said['converged']:,} converged",
            )
        yield Metric("sweep.1e6 points.memory", memory, "GiB", target=2.0)


def workers(quick: bool) -> Iterator[Metric]:
    """The same job of minutes by one worker process and by two."""
    if quick:
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder, took = Path(temporary), {}
        path = file_of(folder, systems.TDCM_1_LOADED, 2_000_000, {})
        for count in (1, 2):
            out = folder / f"by {count}"
            run_command(["sweep", path, "-o", out, "--no-plot", "--workers", str(count)], folder / "cache")
            took[count] = json.loads((out / "sweep.json").read_text())["computed"]["seconds"]
        yield Metric(
            "sweep.two workers",
            took[1] / took[2],
            "x one",
            direction="higher",
            target=1.5,
            note=f"{took[1]:.0f} s by one, {took[2]:.0f} s by two; from the first task to the last",
        )


GROUPS = {
    "lanes": batch_sizes,
    "rate": rates,
    "space": in_space,
    "scaling": scaling,
    "sweep": million,
    "workers": workers,
}


def study(quick: bool) -> Iterator[str]:
    """Microseconds a point by lanes solved side by side, and tip errors by mesh, as lines of markdown."""
    made = measure.machine()
    yield (
        f"{made['processor']}, {made['cores']} cores, {made['date']}, jax {made['versions']['jax']}; "
        "microseconds a point on all cores, one thread each, warm."
    )
    yield ""
    counts = (1, 16) if quick else (1, 4, 16, 64, 250)
    back = {"release": 0.0}
    rows = (
        ("one equilibrium", systems.TDCM_1, {}, 20_000),
        ("one equilibrium, loaded", systems.TDCM_1_LOADED, {}, 4_000),
        ("81 steps", systems.TDCM_1, {**back, "steps": 40}, 250),
        ("81 steps, loaded", systems.TDCM_1_LOADED, {**back, "steps": 40}, 128),
        ("11 steps, presliding", WITH_TERMS, {**back, "steps": 5}, 32),
    )
    yield "| points | " + " | ".join(f"{n} lanes" for n in counts) + " |"
    yield "|---" * (len(counts) + 1) + "|"
    for words, system, history, count in rows:
        cells = [_cell(system, history, count // (10 if quick else 1), lanes) for lanes in counts]
        yield f"| {words} | " + " | ".join(cells) + " |"
    yield ""
    yield "| tip error relative to the length | " + " | ".join(f"mesh {r:g}" for r in RESOLUTIONS) + " |"
    yield "|---" * (len(RESOLUTIONS) + 1) + "|"
    for system in (systems.TDCM_1, systems.TDCM_1_LOADED, systems.CONE_WAVE):
        errors = " | ".join(f"{tip_error(system, r):.1e}" for r in RESOLUTIONS)
        yield f"| {system.name} | {errors} |"


def _cell(system: System, history: dict, count: int, lanes: int) -> str:
    """Microseconds a point with so many lanes; a dash where there are fewer points than lanes."""
    if lanes * measure.cores() > max(count, 1):
        return "–"
    kept = sweep_task.lanes_of
    try:
        sweep_task.lanes_of = lambda *_: lanes
        return f"{seconds(task_for(system, 1, history=history), count, measure.cores()) / count * 1e6:.3g}"
    finally:
        sweep_task.lanes_of = kept


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sweeping", description=__doc__)
    parser.add_argument("--write", action="store_true", help="write results/lanes.md")
    parser.add_argument("--quick", action="store_true", help="few lane counts")
    args = parser.parse_args(argv)
    measure.told(study(args.quick), "lanes.md" if args.write else None)
    return 0


if __name__ == "__main__":
    sys.exit(main())
