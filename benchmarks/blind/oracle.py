"""What any diagnosis could find in a case: the misfit that refitting the base model leaves, noise aside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import gtr_jax as gtr
from calibrate.base_tension import exact
from calibrate.diagnosis.bench import Bench, Noise
from calibrate.diagnosis.diagnose import deviations_of, dimensions_of
from calibrate.diagnosis.hypotheses import base_numbers
from calibrate.diagnosis.rig import Rig
from calibrate.task import Part
from calibrate.weighing import Weighing


def left(folder: Path, key: dict[str, Any]) -> dict[str, float]:
    """Of a case's noise-free readings and its key:

    Returns:
        "information", the root of the sum of squares, in variances of the noise, that the base model leaves
        once mu, E and the uncertain dimensions are refitted; the rms of T_tip with the true mu and E,
        "raw_rms_N", and refitted, "refit_rms_N"; "concealment", the share that refitting hides.
    """
    config = gtr.load_config(folder / "robot.toml")
    recording = gtr.read_recording(folder / "recording.csv")
    robot = gtr.build_robot(config)
    channels = tuple(key["clean"])
    base = exact(np.asarray(key["T_base"]))
    clean = np.stack([np.asarray(key["clean"][name]) for name in channels])
    part = Part("clean", "clean", robot, config, base, channels, clean, recording.time, recording.trial, None)
    dimensions = dimensions_of(config, robot)
    rig = Rig(part, robot, [d.name for d in dimensions])
    bench = Bench([rig], base_numbers(robot, deviations_of(config)), dimensions)
    sd = np.asarray([key["sd"][name] for name in channels])
    bench.noise, bench.weighs = [[Noise(float(s), 0.0) for s in sd]], [Weighing.plain(base, channels, sd)]
    x = np.asarray([n.at(key[n.name]) for n in bench.base])
    bench.answer_of_dimensions({n.name: key[n.name] for n in bench.base})
    found = bench.refit((), x, most=30)
    true = rig({n.name: key[n.name] for n in bench.base})
    if found is None or true is None:
        raise RuntimeError(f"{folder}: the base model cannot be simulated with the true mu and E")
    off = [s.values[rig.part.where][0] - clean[0] for s in (true, found.seen[0])]
    raw, refit = (float(np.sqrt(np.mean(o**2))) for o in off)
    return {
        "information": float(np.sqrt(found.cost)),
        "raw_rms_N": raw,
        "refit_rms_N": refit,
        "concealment": float(np.clip(1 - refit / max(raw, 1e-12), 0, 1)),
        "noise_N": float(np.hypot(sd[0], key["sd_base"])),
    }
