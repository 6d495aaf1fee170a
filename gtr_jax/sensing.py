"""From true tensions to what load cells show, and back: the terms of the cells in their order."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from .history import Simulation
from .robot import Robot
from .terms import REGISTRY


class Reading(NamedTuple):
    """What the cells show along a load history [N], (K, *tendons) each."""

    T_base: Float[Array, "K *tendons"]
    T_tip: Float[Array, "K *tendons"]


def reading(robot: Robot, run: Simulation) -> Reading:
    """What the robot's load cells show of a simulation; the true tensions where no term says otherwise."""
    T_base, T_tip = run.T_base, run.T_tip
    for term in REGISTRY.values():
        values = robot.terms[term.id]
        T_base = T_base if term.base is None else term.base(values, T_base)
        T_tip = T_tip if term.tip is None else term.tip(values, T_tip)
    return Reading(T_base, T_tip)


def true_base(robot: Robot, shown: Float[ArrayLike, "K *tendons"]) -> Float[Array, "K *tendons"]:
    """The base tension [N] behind what its cell shows, (K, *tendons): the inverse of `reading`."""
    shown = jnp.asarray(shown, dtype=float)
    for term in reversed(REGISTRY.values()):
        shown = shown if term.true_base is None else term.true_base(robot.terms[term.id], shown)
    return shown
