"""What the commands take, as a user waits for them: each in a process of its own, time and memory."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import gtr_jax as gtr
from gtr_jax.config.config import config_text, parse_config
from gtr_jax.interpreters import surroundings

from . import measure, systems
from .speed import SAMPLES, Metric

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
COMMAND = "import sys; from gtr_jax.app.cli import main; sys.exit(main())"
MU, RATIO, NOISE_N, NOISE_BASE_N = 0.25, 0.9, 0.05, 0.02


def recording(folder: Path) -> tuple[Path, Path]:
    """A robot file and 1,000 samples of five loops with the tip's pose; friction differs on release."""
    system, rng = systems.TDCM_1, np.random.default_rng(1)
    turns = system.T_base * np.asarray([0.02, 1.0, 0.1, 0.8, 0.3, 0.9, 0.02, 1.0, 0.5, 0.7, 0.02])
    T_base = np.interp(np.linspace(0, 10, SAMPLES), np.arange(11), turns)
    config = parse_config(system.file | {"uncertainty": {"youngs_modulus": 0.1}})
    terms = [{"kind": "friction-asymmetry", "ratio": RATIO}]
    run = gtr.simulate(
        gtr.build_robot(parse_config(system.file | {"terms": terms})).with_values(mu=MU), T_base
    )
    pose = np.asarray(run.tip_pose) + rng.normal(size=(SAMPLES, 3)) * (2e-4, 2e-4, 2e-3)
    columns = {
        "time_s": 0.1 * np.arange(SAMPLES),
        "T_base_N": T_base + NOISE_BASE_N * rng.normal(size=SAMPLES),
        "T_tip_N": np.asarray(run.T_tip) + NOISE_N * rng.normal(size=SAMPLES),
        "tip_x_m": pose[:, 0],
        "tip_y_m": pose[:, 1],
        "tip_angle_rad": pose[:, 2],
    }
    robot, read = folder / "robot.toml", folder / "recording.csv"
    robot.write_text(config_text(config), encoding="utf-8")
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(read, table, delimiter=",", header=",".join(columns), comments="", fmt="%.7g")
    return robot, read


class Waited(NamedTuple):
    """What a command took: seconds with nothing compiled, seconds again, its largest memory [GiB]."""

    cold: float
    warm: float
    memory: float


def run_command(
    arguments: Sequence[str | Path], cache: Path, installed: Path | None = None
) -> tuple[float, float]:
    """Seconds and largest memory [GiB] of `gtr` with these arguments, programs compiled before in `cache`;
    of the checkout, or as `installed` in an environment, for a user who has nothing else.
    """
    environment = surroundings() | {"GTR_JAX_CACHE": str(cache)}
    python = sys.executable
    if installed is not None:
        # matplotlib keeps the list of the machine's fonts, which the first import makes.
        environment |= {"HOME": str(cache), "XDG_CACHE_HOME": str(cache), "MPLCONFIGDIR": str(cache / "mpl")}
        environment.pop("PYTHONPATH")
        python = str(installed / "bin/python")
    began = time.perf_counter()
    process = subprocess.Popen(
        [python, "-P", "-c", COMMAND, *map(str, arguments)],
        cwd=None if installed is None else cache.parent,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise RuntimeError(f"gtr {arguments[0]} ends with {os.waitstatus_to_exitcode(status)}")
    return time.perf_counter() - began, usage.ru_maxrss / 2**20


def waited(arguments: Sequence[str | Path], folder: Path) -> Waited:
    """A command that writes a run folder, with nothing compiled and again."""
    cold, first = run_command([*arguments, "-o", folder / "cold"], folder / "cache")
    warm, second = run_command([*arguments, "-o", folder / "warm"], folder / "cache")
    return Waited(cold, warm, max(first, second))


@contextlib.contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as temporary:
        yield Path(temporary)


def _metrics(name: str, took: Waited, note: str, warm: float, cold: float, memory: float) -> Iterator[Metric]:
    """The three numbers with their targets."""
    ratio = took.warm / measure.reference_seconds(0.2)
    yield Metric(name, took.warm, "s", target=warm, cold=took.cold, gated=ratio, note=note)
    yield Metric(f"{name}.cold", took.cold, "s", target=cold)
    yield Metric(f"{name}.memory", took.memory, "GiB", target=memory)


def _of_samples(command: str, note: str, warm: float, cold: float) -> Iterator[Metric]:
    """A command that reads the recording."""
    with _folder() as folder:
        took = waited([command, *recording(folder)], folder)
    yield from _metrics(f"{command}.{SAMPLES} samples", took, note, warm, cold, 4.0)


def fit(quick: bool) -> Iterator[Metric]:
    """`gtr fit` of 1,000 samples."""
    if not quick:
        yield from _of_samples("fit", "mu and E, with pose; interpreter included", 10.0, 30.0)


def diagnose(quick: bool) -> Iterator[Metric]:
    """`gtr diagnose` of 1,000 samples."""
    if not quick:
        yield from _of_samples("diagnose", "with pose; interpreter included", 60.0, 180.0)


def design(quick: bool) -> Iterator[Metric]:
    """`gtr design` of the example."""
    if quick:
        return
    with _folder() as folder:
        took = waited(["design", EXAMPLES / "tdcm-1.toml", EXAMPLES / "tdcm-1-target.toml"], folder)
    ratio = took.warm / measure.reference_seconds(0.2)
    yield Metric("design.example", took.warm, "s", cold=took.cold, gated=ratio, note="interpreter included")
    yield Metric("design.example.memory", took.memory, "GiB")


def first(quick: bool) -> Iterator[Metric]:
    """What a new user waits for: the package just installed into an empty environment, nothing compiled, and
    the first command there that draws a recording of the user's own. No command profits from another.
    """
    if quick:
        return
    with _folder() as folder:
        robot, read = recording(folder)
        venv.create(folder / "empty", with_pip=True)
        subprocess.run(
            [folder / "empty/bin/python", "-P", "-m", "pip", "install", "--quiet", ROOT],
            check=True,
            cwd=folder,
        )
        for command, files in (("inspect", [read]), ("fit", [robot, read])):
            out = folder / command
            took, memory = run_command(
                [command, *files, "-o", out], folder / f"cache-{command}", folder / "empty"
            )
            note = "own recording of 1,000 samples, just installed, nothing compiled"
            yield Metric(f"first picture.{command}", took, "s", target=60.0, note=note)
            yield Metric(f"first picture.{command}.memory", memory, "GiB")
