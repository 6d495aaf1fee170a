"""What a diagnosis takes, as a user waits for it: the command in a process of its own, time and memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gtr_jax as gtr
from gtr_jax.config import config_text, parse_config

from . import measure, systems
from .speed import SAMPLES, Metric

COMMAND = "import sys; from gtr_jax.cli import main; sys.exit(main())"
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


def diagnose(quick: bool) -> Iterator[Metric]:
    """`gtr diagnose` of 1,000 samples: with nothing compiled, and again; its largest memory."""
    if quick:
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        robot, read = recording(folder)
        took, largest = [], 0.0
        for run in ("cold", "warm"):
            began = time.perf_counter()
            process = subprocess.Popen(
                [sys.executable, "-c", COMMAND, "diagnose", robot, read, "-o", folder / run],
                env=os.environ | {"GTR_JAX_CACHE": str(folder / "cache")},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            _, status, usage = os.wait4(process.pid, 0)
            if status != 0:
                raise RuntimeError(f"gtr diagnose ends with {os.waitstatus_to_exitcode(status)}")
            took.append(time.perf_counter() - began)
            largest = max(largest, usage.ru_maxrss / 2**20)
    cold, warm = took
    name, ratio = f"diagnose.{SAMPLES} samples", warm / measure.reference_seconds(0.2)
    yield Metric(name, warm, "s", target=60.0, cold=cold, gated=ratio, note="with pose; interpreter included")
    yield Metric(f"{name}.cold", cold, "s", target=180.0)
    yield Metric(f"{name}.memory", largest, "GiB", target=4.0)
