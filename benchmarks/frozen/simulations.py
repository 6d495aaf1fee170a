"""Frozen load histories: the examples, the reference runs, and each physics term alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

import gtr_jax as gtr
from benchmarks.terms import values_of
from gtr_jax.examples import SIMULATED

from .case import BASE, EXAMPLES, REFERENCE, TERMS, Answers, Case, history, of_run, typical

# Largest base tension of each example [N].
ROBOTS = {
    "tdcm-1.toml": 45.0,
    "tdcm-2.toml": 30.0,
    "rig/robot.toml": 45.0,
    "paper/path-1.toml": 20.0,
    "paper/path-5.toml": 20.0,
}
LOADS = {
    "tip force": {"tip_force_x": 0.05, "tip_force_y": -0.08},
    "tip moment": {"tip_moment": 0.01},
    "payload": {"tip_force_y": 0.02, "payload": 0.01, "gravity_angle": -1.0, "density": 1070.0},
}
# More of a term than its typical values say.
VARIANTS = {
    "presliding, elements": {"presliding.length": 6e-4, "presliding.elements": 1.0},
    "presliding, short": {"presliding.length": 5e-5},
    "contact, near": {"contact.stiffness": 400.0, "contact.distance": 0.005},
    "contact, inclined": {"contact.stiffness": 400.0, "contact.distance": 0.02, "contact.angle": 1.2},
    "gravity-error, heavy": {"gravity-error.x": 2.0, "gravity-error.y": 2.0, "density": 1070.0},
    "asymmetry below one": {"friction-asymmetry.ratio": 0.93},
    "pressure exponent above one": {"pressure-dependent-friction.exponent": 1.1},
    "saturation, low": {"saturation.tip": 12.0, "saturation.base": 30.0},
}
SETS = {
    "presliding and tip load": ("presliding", "tip-load"),
    "viscous and presliding": ("viscous-friction", "presliding"),
    "creep and local friction": ("viscoelastic-body", "local-friction"),
    "stretch and adhesion": ("tendon-stretch", "adhesion"),
    "cells together": ("cell-hysteresis", "tip-gain", "base-offset", "low-pass", "quantisation"),
}
# In a rigid sheath.
RIGID = {
    "path-1, local-friction": ("local-friction",),
    "path-1, stretch and presliding": ("tendon-stretch", "presliding"),
}
PAIR_TERMS = ("presliding", "tip-load", "viscous-friction", "tendon-stretch", "local-friction")


def _case(name: str, allowed: float, run: Callable[[], Answers]) -> Case:
    return Case("simulate", name, run, allowed, steps_allowed=0.0 if allowed == BASE else 0.03)


def example(file: str | Path, largest: float, **values: float) -> Answers:
    """A robot with one tendon through the history."""
    robot = gtr.load_robot(EXAMPLES / file).with_values(**values)
    time, T_base = history(largest)
    return of_run(gtr.simulate(robot, T_base, time=time))


def pair(**values: float) -> Answers:
    """The antagonists: one pulled and released while the other is held, then the other way round."""
    robot = gtr.load_robot(EXAMPLES / "antagonists.toml").with_values(**values)
    time, pulled = history(14.0)
    at, held = np.arange(len(pulled)), np.ones(len(pulled))
    right = np.where(at < 38, held, 1.0 + 0.5 * pulled)
    T_base = np.stack([np.maximum(pulled, 1.0), right], axis=1)
    return of_run(gtr.simulate(robot, T_base, time=time))


def reference(folder: Path) -> Answers:
    """A reference run with its own parameters."""
    told = json.loads((folder / "physics.json").read_text(encoding="utf-8"))
    recording = gtr.read_recording(folder / "recording.csv")
    robot = gtr.load_robot(folder / "robot.toml").with_values(**values_of(told["parameters"]))
    return of_run(gtr.simulate(robot, recording.T_base, time=recording.time))


def cases() -> list[Case]:
    """All load histories."""
    from gtr_jax.terms import REGISTRY

    found = [_case(file, BASE, lambda f=file, T=T: example(f, T)) for file, T in ROBOTS.items()]
    for name, loads in LOADS.items():
        found.append(_case(f"tdcm-1, {name}", BASE, lambda v=loads: example("tdcm-1.toml", 45.0, **v)))
    found.append(_case("antagonists", BASE, pair))
    found.append(_case("antagonists, loaded", BASE, lambda: pair(**LOADS["tip force"])))
    for kind in PAIR_TERMS:
        found.append(_case(f"antagonists, {kind}", TERMS, lambda k=kind: pair(**typical(k))))
    for kind, term in REGISTRY.items():
        allowed = BASE if term.of_cells else TERMS
        found.append(_case(kind, allowed, lambda k=kind: example(SIMULATED, 45.0, **typical(k))))
    for name, values in VARIANTS.items():
        allowed = BASE if name.startswith("saturation") else TERMS
        found.append(_case(name, allowed, lambda v=values: example(SIMULATED, 45.0, **v)))
    for name, kinds in SETS.items():
        allowed = BASE if name.startswith("cells") else TERMS
        found.append(_case(name, allowed, lambda k=kinds: example(SIMULATED, 45.0, **typical(*k))))
    for name, kinds in RIGID.items():
        found.append(_case(name, TERMS, lambda k=kinds: example("paper/path-1.toml", 20.0, **typical(*k))))
    for folder in sorted(path.parent for path in REFERENCE.glob("*/physics.json")):
        allowed = BASE if folder.name.startswith("coulomb") else TERMS
        found.append(_case(f"reference {folder.name}", allowed, lambda f=folder: reference(f)))
    return found
