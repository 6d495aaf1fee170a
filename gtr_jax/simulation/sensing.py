"""From true tensions to what load cells show, and back: the terms of the cells in their order."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ..robot.robot import Robot
from ..terms import called, known_on
from ..terms.term import Clock


class Reading(NamedTuple):
    """What the cells show along a load history [N], (K, *tendons) each."""

    T_base: Float[Array, "K *tendons"]
    T_tip: Float[Array, "K *tendons"]


def cells_show(
    robot: Robot,
    T_base: Float[Array, "K *tendons"],
    T_tip: Float[Array, "K *tendons"],
    time: Float[Array, " K"],
) -> Reading:
    """What the cells show under true tensions [N] at some times [s]."""
    at = Clock(time, T_base)
    for term in robot.catalogue.values():
        values = robot.terms[term.id]
        T_base = T_base if term.base is None else called(term.base, values, T_base, at)
        T_tip = T_tip if term.tip is None else called(term.tip, values, T_tip, at)
    return Reading(T_base, T_tip)


def cells_differ(robot: Robot) -> bool | None:
    """Whether a term of the load cells acts, so that readings differ from the true tensions; None if that is
    being traced.
    """
    acting = [known_on(term, robot.terms[term.id]) for term in robot.catalogue.values() if term.of_cells]
    return True if True in acting else None if None in acting else False


def shown(
    robot: Robot,
    T_base: Float[Array, "K *tendons"],
    T_tip: Float[Array, "K *tendons"],
    time: Float[Array, " K"],
) -> Reading:
    """As `cells_show`, compiled, and without computing anything where no term of the cells acts."""
    if cells_differ(robot) is False:
        return Reading(T_base, T_tip)
    return _shown(robot.for_any_terms(), T_base, T_tip, time)


_shown = eqx.filter_jit(cells_show)


def true_base(
    robot: Robot, shown: Float[ArrayLike, "K *tendons"], time: Float[ArrayLike, " K"] | None = None
) -> Float[Array, "K *tendons"]:
    """The base tension [N] behind what its cell shows, (K, *tendons): the inverse of `reading`.

    Saturation and quantisation cannot be inverted: they are left as shown.

    Args:
        robot: the robot.
        shown: what the cell shows [N], (K, *tendons).
        time: of the samples [s], (K,); needed where a term depends on it.

    Raises:
        ValueError: no time for a term that needs it.
    """
    tension: Array = jnp.asarray(shown, dtype=float)
    for term in robot.catalogue.values():
        if time is None and term.timed and term.true_base and known_on(term, robot.terms[term.id]):
            raise ValueError(f"time: {term.id} depends on it; give the time of each sample")
    clock = jnp.arange(tension.shape[0], dtype=float) if time is None else jnp.asarray(time, dtype=float)
    for term in reversed([*robot.catalogue.values()]):
        if term.true_base is not None:
            at = Clock(clock - clock[0], tension)
            tension = called(term.true_base, robot.terms[term.id], tension, at)
    return tension
