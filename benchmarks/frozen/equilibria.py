"""Frozen single equilibria: with and without loads, of one tendon and two, after another load and not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import gtr_jax as gtr

from .case import BASE, EXAMPLES, TERMS, Answers, Case, at_nodes, typical
from .simulations import LOADS

PULLED = (45.0, 20.0, 30.0, 2.0)
OF_TERMS = (
    *("presliding", "viscous-friction", "stribeck-friction", "pressure-dependent-friction", "adhesion"),
    *("friction-asymmetry", "local-friction", "clearance", "stiffening", "viscoelastic-body"),
    *("body-hysteresis", "tendon-stretch", "tip-load", "gravity-error", "contact"),
)
PAIR = ((10.0, 2.0), (4.0, 2.0), (4.0, 9.0))


def of_equilibrium(found: gtr.Equilibrium) -> Answers:
    """What is kept of an equilibrium."""
    kept = {
        "T_tip": found.T_tip,
        "tip_x": found.x[-1],
        "tip_y": found.y[-1],
        "tip_angle": found.angle[-1],
        "tension": at_nodes(found.tension)[..., 1:-1],
        "curvature": at_nodes(found.curvature),
        "slip": found.slip[..., 0],
        "wrap": found.wrap[..., -1],
        "tendon_length": found.tendon_length,
        "tendon_angle": at_nodes(found.tendon_angle),
        "external_moment": at_nodes(found.external_moment),
        "converged": found.converged,
    }
    return {name: np.asarray(values) for name, values in kept.items()}


def in_turn(file: str, loads: Sequence, **values: float) -> Answers:
    """Equilibria one after another, each remembering the one before; first of all one of half the first load
    without memory.
    """
    robot = gtr.load_robot(EXAMPLES / file).with_values(**values)
    first = gtr.equilibrium(robot, 0.5 * np.asarray(loads[0]))
    kept = {f"half.{name}": v for name, v in of_equilibrium(first).items()}
    before = None
    for k, load in enumerate(loads):
        before = gtr.equilibrium(robot, np.asarray(load), memory=before)
        kept |= {f"{k}.{name}": v for name, v in of_equilibrium(before).items()}
    return kept


def after_tension(file: str, **values: float) -> Answers:
    """An equilibrium that remembers a tension along the tendon, given as numbers."""
    robot = gtr.load_robot(EXAMPLES / file).with_values(**values)
    before = gtr.equilibrium(robot, 40.0)
    return of_equilibrium(gtr.equilibrium(robot, 25.0, memory=before.tension))


def cases() -> list[Case]:
    """All equilibria."""
    found = [
        ("tdcm-1", BASE, lambda: in_turn("tdcm-1.toml", PULLED)),
        ("tdcm-2", BASE, lambda: in_turn("tdcm-2.toml", PULLED[1:])),
        ("path-1", BASE, lambda: in_turn("paper/path-1.toml", PULLED)),
        ("tdcm-1 after a tension", BASE, lambda: after_tension("tdcm-1.toml")),
        (
            "tdcm-1, tip force, after a tension",
            BASE,
            lambda: after_tension("tdcm-1.toml", **LOADS["tip force"]),
        ),
        ("antagonists", BASE, lambda: in_turn("antagonists.toml", PAIR)),
        ("antagonists, loaded", BASE, lambda: in_turn("antagonists.toml", PAIR, **LOADS["tip force"])),
        (
            "antagonists, presliding",
            TERMS,
            lambda: in_turn("antagonists.toml", PAIR, **typical("presliding")),
        ),
    ]
    for name, loads in LOADS.items():
        found.append((f"tdcm-1, {name}", BASE, lambda v=loads: in_turn("tdcm-1.toml", PULLED, **v)))
    for kind in OF_TERMS:
        found.append((kind, TERMS, lambda k=kind: in_turn("tdcm-1.toml", PULLED, **typical(k))))
    floors = {"*": 1e-9}
    return [Case("equilibrium", f"at rest: {name}", run, allowed, floors) for name, allowed, run in found]
