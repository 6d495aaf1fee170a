"""The trials of the notched wrists, which have no licence and do not ship, and how far models are off."""

from __future__ import annotations

import csv
import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import make_smoothing_spline

import gtr_jax as gtr

from .pages import elsewhere

WRISTS = ("wrist90", "wrist150")
COUNT = 5
NATURAL = tuple(f"notches_natural_angle_{i}" for i in range(COUNT))


@dataclasses.dataclass(frozen=True)
class Trial:
    """Base tensions [N], (K,), and angles of the notches [rad], (K, 5)."""

    T_base: np.ndarray
    angles: np.ndarray


# Angles of the notches [rad], (K, 5), that something says of a trial, with or without its own rest.
Says = Callable[[Trial, bool], np.ndarray]


def trials(wrist: str) -> list[Trial]:
    """The trials of a wrist, in order."""
    with elsewhere("wrists", f"{wrist}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    found = []
    for name in dict.fromkeys(row["trial"] for row in rows):
        own = [row for row in rows if row["trial"] == name]
        angles = [[float(row[f"theta{i + 1}_deg"]) for i in range(COUNT)] for row in own]
        found.append(Trial(np.array([float(row["T_base_N"]) for row in own]), np.deg2rad(angles)))
    return found


def recording(wrist: str, trial: Trial, folder: Path) -> gtr.Recording:
    """A trial as a recording."""
    path = folder / f"{wrist}.csv"
    header = ",".join(["T_base_N", *(f"n{i + 1}_angle_rad" for i in range(COUNT))])
    np.savetxt(path, np.column_stack([trial.T_base, trial.angles]), delimiter=",", header=header, comments="")
    return gtr.read_recording(path, measured=True, markers=[f"n{i + 1}" for i in range(COUNT)])


def predicted(robot: gtr.Robot, trial: Trial, own_rest: bool) -> np.ndarray:
    """Angles of the notches [rad], (K, 5); with `own_rest` from the angles that the trial begins with."""
    if own_rest:
        robot = robot.with_values(**dict(zip(NATURAL, trial.angles[0], strict=True)))
    run = gtr.simulate(robot, np.maximum(trial.T_base, 0.0))
    if not np.all(run.converged):
        raise SystemExit("a step did not converge")
    return np.asarray(gtr.marker_angles(robot, run))


def interpolated(first: Trial, trial: Trial, own_rest: bool) -> np.ndarray:
    """What another trial says of the angles of the notches [rad], (K, 5), without any model, NaN beyond its
    tensions; with `own_rest` from the angles that the trial begins with.
    """
    order = np.argsort(first.T_base)
    T, angles = first.T_base[order], first.angles[order]
    found = np.stack([np.interp(trial.T_base, T, each, right=np.nan) for each in angles.T], axis=1)
    return found + trial.angles[0] - angles[0] if own_rest else found


def errors(says: Says, several: Sequence[Trial], own_rest: bool = False) -> np.ndarray:
    """What is said less what was measured, of all angles of some trials [degrees]; where a trial's first
    row is its rest, of the others.

    Args:
        says: what is compared.
        several: the trials.
        own_rest: whether each trial's own rest is known.
    """
    each = [(says(trial, own_rest) - trial.angles)[1 if own_rest else 0 :].ravel() for trial in several]
    return np.rad2deg(np.concatenate(each))


def off(says: Says, several: Sequence[Trial], own_rest: bool = False) -> float:
    """Root mean square error of an angle [degrees]; arguments as of `errors`."""
    return float(np.sqrt(np.nanmean(errors(says, several, own_rest) ** 2)))


def _curves(T: np.ndarray, angles: np.ndarray) -> list[Callable[[np.ndarray], np.ndarray]]:
    """One smooth curve over the tension for each notch: a smoothing spline, as smooth as generalised
    cross-validation has it.
    """
    at, place, count = np.unique(T, return_inverse=True, return_counts=True)
    return [
        make_smoothing_spline(at, np.bincount(place, own) / count, count.astype(float)) for own in angles.T
    ]


def _pooled(several: Sequence[Trial]) -> tuple[np.ndarray, np.ndarray]:
    """Tensions [N] and angles [degrees] of trials."""
    T = np.concatenate([trial.T_base for trial in several])
    return T, np.rad2deg(np.concatenate([trial.angles for trial in several]))


def scatter(several: Sequence[Trial]) -> float:
    """Root mean square distance [degrees] of trials from smooth curves that are fitted to them: too low for
    the scatter of the angles, which few samples to a curve bend it to follow.
    """
    T, angles = _pooled(several)
    left = [curve(T) - own for curve, own in zip(_curves(T, angles), angles.T, strict=True)]
    return float(np.sqrt(np.mean(np.square(left))))


def left_out(several: Sequence[Trial]) -> float:
    """Root mean square error [degrees] of smooth curves through trials at samples that are left out, those of
    one tension at a time, the least and the largest excepted: too high for the scatter of the angles, since
    it also has the error of the curve.
    """
    T, angles = _pooled(several)
    left = []
    for at in np.unique(T)[1:-1]:
        out = T == at
        for curve, own in zip(_curves(T[~out], angles[~out]), angles[out].T, strict=True):
            left.append(curve(T[out]) - own)
    return float(np.sqrt(np.mean(np.square(np.concatenate(left)))))
