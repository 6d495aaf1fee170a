"""Frozen fits: the recordings that ship with the examples and the package, fitted as `gtr fit` does."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import gtr_jax as gtr

from .case import EXAMPLES, REFERENCE, Answers, Case, flattened

RIG = EXAMPLES / "rig/robot.toml"
# How the optimiser came there, and what was asked.
LEFT_OUT = ("iterations", "evaluations", "settings")

# Slopes jump where samples change from locked to slipping, so that rounding errors may lead the optimiser to
# another side: compiled without XLA's optimisation, six of the seven fits move by less than 1e-6, but that of
# monday and tuesday by 1e-4 in its values (a hundredth of their standard deviations), by 0.8 % in these, by
# 0.006 in the shares of variances, and by 1.4e-6 in what is simulated.
LOOSER = {
    "simulated.*": 1e-5,
    "T_base.*": 1e-5,
    "*.value": 3e-4,
    "*.?????95": 5e-4,
    "*.values": 3e-4,
    "*": 0.03,
}
FLOORS = {"*.made_of.*": 1.0, "correlation.*": 1.0, "*.mean_N": 0.05}


def fitted(robot: Path, recordings: Sequence[Path], **options: Any) -> Answers:
    """Estimates, intervals and residuals of a fit."""
    import calibrate

    found = calibrate.fit(
        gtr.load_config(robot), [gtr.read_recording(path) for path in recordings], profiled=True, **options
    )
    kept = flattened(found.to_json(), LEFT_OUT)
    kept["names"] = np.asarray([e.name for e in [*found.estimates, *found.carried]])
    for r in found.recordings:
        kept[f"simulated.{r.name}"] = np.asarray(r.T_tip)
        kept[f"T_base.{r.name}"] = np.asarray(r.T_base)
    return kept


def cases() -> list[Case]:
    """All fits."""
    from gtr_jax.examples import CONCEALED, CONCEALED_ROBOT

    monday, tuesday, oiled = (EXAMPLES / f"rig/{day}.csv" for day in ("monday", "tuesday", "oiled"))
    catheter = REFERENCE / "coulomb-catheter"
    runs = {
        "monday": lambda: fitted(RIG, [monday]),
        "monday and tuesday": lambda: fitted(RIG, [monday, tuesday]),
        "monday and oiled": lambda: fitted(RIG, [monday, oiled], per_recording=("mu",)),
        "monday, robust": lambda: fitted(RIG, [monday], robust=True),
        "monday, noise given": lambda: fitted(RIG, [monday], noise_N=0.05, noise_base_N=0.1, free=("mu",)),
        "concealed": lambda: fitted(CONCEALED_ROBOT, [CONCEALED], free=("mu", "E"), channels=()),
        "catheter": lambda: fitted(catheter / "robot.toml", [catheter / "recording.csv"]),
    }
    return [Case("fit", f"fit: {name}", run, 1e-6, FLOORS, LOOSER) for name, run in runs.items()]
