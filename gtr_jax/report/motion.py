"""A body that moves, for the page: its shape at some of the steps of a history, in the plane or in space."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from gtr_jax.plots.views import Posture

from ..robot.robot import Robot
from ..simulation.history import Simulation, equilibrium_at
from ..simulation.markers import marker_places, shape_in_plane
from .scene import PLACES, SCALE, in_space, whole_numbers
from .spatial import strung_of

STEPS = 200  # most that a body is shown at


def body_of(
    robot: Robot,
    run: Simulation,
    *,
    first: int,
    steps: int | None = None,
    samples: np.ndarray | None = None,
    most: int = STEPS,
) -> dict[str, Any]:
    """What `plane.js`, or `turning.js`, needs to draw the body at up to `most` steps; `samples` has which.

    Args:
        robot: as simulated.
        run: its simulation.
        first: a step that is always among them, beside the first and the last.
        steps: how many of the simulation's steps belong to the history; all unless given.
        samples: of the history, counted from 0, that its steps are; each its own unless given.
        most: steps to show.
    """
    K = len(run.time) if steps is None else steps
    shape = shape_in_plane(robot, run.curvature, run.angle) if run.shape is None else run.shape
    position, frames = (np.asarray(values)[:K] for values in (shape.position, shape.rotation))
    tension = np.asarray(run.tension)[:K].reshape(K, len(robot.tendons), -1)
    markers = np.asarray(marker_places(robot, run))[:K]
    kept = kept_steps(position, tension, first, most)
    shown = {"space": robot.space, "samples": (kept if samples is None else samples[kept]).tolist()}
    strung = strung_of(robot, run)
    if robot.space:
        postures = [Posture("", position[k], frames[k], tension[k], markers[k]) for k in kept]
        return {**shown, **in_space(strung, postures)}
    s, own = np.unique(strung.s, return_index=True)
    at = np.linspace(s[0], s[-1], PLACES)
    # Of guided tendons these are those of the chords, which the routing does not have.
    R = np.asarray(equilibrium_at(robot, run, 0).R).reshape(len(robot.tendons), -1)
    offsets = [1e3 * np.interp(at, s, each[own]) for each in R]
    top = float(np.max(tension))
    unit = (top or 1.0) / 1000

    def drawn(k: int) -> dict[str, Any]:
        middle = CubicHermiteSpline(s, position[k, own, :2], frames[k, own, :2, 0])(at)
        angle = np.unwrap(np.arctan2(frames[k, own, 1, 0], frames[k, own, 0, 0]))
        return {
            "place": whole_numbers(1e3 * middle, SCALE),
            "angle": whole_numbers(np.interp(at, s, angle), 1e-4),
            "tension": [whole_numbers(np.interp(at, s, each[own]), unit) for each in tension[k]],
            "markers": whole_numbers(1e3 * markers[k, :, :2], SCALE),
        }

    return {
        **shown,
        "scale": SCALE,
        "most": float(f"{top:.3g}"),
        "radius": np.round(1e3 * np.interp(at, strung.s, strung.radius), 3).tolist(),
        "offsets": [np.round(each, 3).tolist() for each in offsets],
        "ends": [int(np.sum(at <= end * (1 + 1e-9))) for end in strung.ends],
        "steps": [drawn(int(k)) for k in kept],
    }


def kept_steps(position: np.ndarray, tension: np.ndarray, first: int, most: int) -> np.ndarray:
    """Which steps of a history to show a body at: evenly along the way that its shape and the tensions go, so
    that none of them looks much different from the next, and nothing is spent where it rests.

    Args:
        position: of the midline [m], (K, N, 3).
        tension: along the tendons [N], (K, tendons, N).
        first: a step that is always kept, as are the first and the last.
        most: steps to keep.
    """
    K = len(position)
    if most >= K:
        return np.arange(K)
    way = np.zeros(K)
    for values in (position, tension):
        moved = np.max(np.abs(np.diff(values, axis=0)).reshape(K - 1, -1), axis=1)
        size = float(np.max(np.ptp(values, axis=0)))
        way[1:] += moved / size if size > 0 else 0.0
    gone = np.cumsum(way)
    wanted = np.linspace(0.0, gone[-1], most - 1)
    return np.unique([0, first, K - 1, *np.minimum(np.searchsorted(gone, wanted), K - 1)])
