"""A body that moves, for the page: its shape at some of the steps of a history, in the plane or in space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from gtr_jax.plots.views import Posture, Strung

from ..robot.robot import Robot
from ..simulation.history import Simulation, equilibrium_at
from ..simulation.markers import markers_on, shape_in_plane
from .scene import PLACES, SCALE, in_space, whole_numbers
from .spatial import strung_of

STEPS = 200  # most that a body is shown at, and besides
FIXED = 3  # the first, the last and another


class Moved(NamedTuple):
    """A body at some steps of a history: the body, its postures, and which steps, counted from 0."""

    body: Strung
    postures: list[Posture]
    steps: np.ndarray


def moved(robot: Robot, run: Simulation, *, first: int, steps: int | None = None, most: int = STEPS) -> Moved:
    """A body at up to `most` steps of a simulation, in the plane with z = 0.

    Args:
        robot: as simulated.
        run: its simulation.
        first: a step that is always among them, beside the first and the last.
        steps: how many of the simulation's steps belong to the history; all unless given.
        most: steps to show.
    """
    K = len(run.time) if steps is None else steps
    tension = np.asarray(run.tension)[:K].reshape(K, len(robot.tendons), -1)
    bent = np.asarray(run.angle)[:K, :, None] if run.shape is None else np.asarray(run.shape.position)[:K]
    kept = kept_steps(bent, tension, first, most)
    # Always as many, so that one program is compiled for all histories.
    at = np.concatenate([kept, np.full(most + FIXED - len(kept), kept[-1])])
    if run.shape is None:
        shape = _shape_in_plane(robot, run.curvature[at], run.angle[at])
    else:
        shape = jax.tree_util.tree_map(lambda values: values[at], run.shape)
    position, frames = np.asarray(shape.position), np.asarray(shape.rotation)
    markers = np.asarray(_markers_on(robot, run.s, shape))[..., :3]
    body = strung_of(robot, run)
    if any(tendon.guides is not None for tendon in robot.tendons) and not robot.space:
        # The chords between guides, which the routing does not have.
        R = np.asarray(equilibrium_at(robot, run, 0).R).reshape(len(robot.tendons), -1)
        body = body._replace(offsets=np.stack([R, np.zeros_like(R)], axis=-1))
    postures = [Posture("", position[i], frames[i], tension[k], markers[i]) for i, k in enumerate(kept)]
    return Moved(body, postures, kept)


_shape_in_plane, _markers_on = eqx.filter_jit(shape_in_plane), eqx.filter_jit(markers_on)


def body_of(
    robot: Robot, run: Simulation, *, samples: np.ndarray | None = None, **which: Any
) -> dict[str, Any]:
    """What `plane.js`, or `turning.js`, needs to draw the body at some steps; `samples` has which.

    Args:
        robot: as simulated.
        run: its simulation.
        samples: of the history, counted from 0, that its steps are; each its own unless given.
        which: steps to show: `first`, `steps` and `most`, as of `moved`.
    """
    motion = moved(robot, run, **which)
    kept = motion.steps if samples is None else samples[motion.steps]
    shown = {"space": robot.space, "samples": kept.tolist()}
    return shown | (in_space if robot.space else _in_plane)(motion.body, motion.postures)


def _in_plane(body: Strung, postures: Sequence[Posture]) -> dict[str, Any]:
    """What `plane.js` reads of a body in each of some postures."""
    s, own = np.unique(body.s, return_index=True)
    at = np.linspace(s[0], s[-1], PLACES)
    most = max(float(np.max(posture.tension)) for posture in postures)
    unit = (most or 1.0) / 1000

    def step(posture: Posture) -> dict[str, Any]:
        along = posture.frames[own, :2, 0]
        middle = CubicHermiteSpline(s, posture.position[own, :2], along)(at)
        angle = np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
        return {
            "place": whole_numbers(1e3 * middle, SCALE),
            "angle": whole_numbers(np.interp(at, s, angle), 1e-4),
            "tension": [whole_numbers(np.interp(at, s, each[own]), unit) for each in posture.tension],
            "markers": whole_numbers(1e3 * posture.markers[:, :2], SCALE),
        }

    return {
        "scale": SCALE,
        "most": float(f"{most:.3g}"),
        "radius": np.round(1e3 * np.interp(at, body.s, body.radius), 3).tolist(),
        "offsets": [np.round(1e3 * np.interp(at, s, each[own, 0]), 3).tolist() for each in body.offsets],
        "ends": [int(np.sum(at <= end * (1 + 1e-9))) for end in body.ends],
        "steps": [step(posture) for posture in postures],
    }


def kept_steps(bent: np.ndarray, tension: np.ndarray, first: int, most: int) -> np.ndarray:
    """Which steps of a history to show a body at: evenly along the way that its shape and the tensions go, so
    that none of them looks much different from the next, and nothing is spent where it rests.

    Args:
        bent: angles or places along the midline, (K, N, any).
        tension: along the tendons [N], (K, tendons, N).
        first: a step that is always kept, as are the first and the last.
        most: steps to keep.
    """
    K = len(bent)
    if most >= K:
        return np.arange(K)
    way = np.zeros(K)
    for values in (bent, tension):
        moved = np.max(np.abs(np.diff(values, axis=0)).reshape(K - 1, -1), axis=1)
        size = float(np.max(np.ptp(values, axis=0)))
        way[1:] += moved / size if size > 0 else 0.0
    gone = np.cumsum(way)
    wanted = np.linspace(0.0, gone[-1], most - 1)
    return np.unique([0, first, K - 1, *np.minimum(np.searchsorted(gone, wanted), K - 1)])
