"""Frozen sweeps: small versions of the example's, and one of points drawn for a robot with a physics term."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from .case import BASE, EXAMPLES, TERMS, Answers, Case

SMALL: dict[str, Any] = {
    "schema": 1,
    "robot": "tdcm-1.toml",
    "outputs": ["T_tip", "tip_pose", "T_base_switch"],
    "vary": {
        "tendon.friction_coefficient": {"from": 0.1, "to": 0.5, "count": 6},
        "backbone.youngs_modulus": {"from": "0.5 MPa", "to": "2 MPa", "count": 5, "scale": "log"},
    },
    "history": {"pull": "45 N"},
}
LOOP = {**SMALL, "outputs": ["T_tip", "tip_pose"]}
LOOP |= {"history": {"pull": "45 N", "release": "5 N", "steps": 10, "keep": "all"}}
DRAWN: dict[str, Any] = {
    "schema": 1,
    "robot": "tdcm-1.toml",
    "outputs": ["T_tip", "tip_pose"],
    "sample": "sobol",
    "count": 16,
    "vary": {
        "mu": {"from": 0.2, "to": 0.4},
        "presliding.length": {"from": "0.1 mm", "to": "1 mm", "scale": "log"},
    },
    "history": {"pull": "45 N", "release": "5 N", "steps": 10, "keep": "turns"},
}


def swept(file: dict[str, Any]) -> Answers:
    """All that the store holds in numbers, coordinates included."""
    from gtr_jax.sweep import parse_sweep, sweep

    with tempfile.TemporaryDirectory() as folder:
        data = sweep(parse_sweep(file, folder=EXAMPLES), Path(folder) / "sweep.zarr", threads=1).load()
        data.close()
    found = {str(name): np.asarray(values) for name, values in data.variables.items()}
    return {name: values for name, values in found.items() if values.dtype.kind in "fiubU"}


def cases() -> list[Case]:
    """All sweeps."""
    return [
        Case("sweep", "pulls", lambda: swept(SMALL), BASE),
        Case("sweep", "loops", lambda: swept(LOOP), BASE),
        Case("sweep", "presliding drawn", lambda: swept(DRAWN), TERMS),
    ]
