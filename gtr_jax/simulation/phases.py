"""The phases of Liu & Alambeigi's Algorithm 1, read off any history."""

from __future__ import annotations

import numpy as np

from .arrays import SimulationArrays

PULLING, TRANSITION, RELEASING, REST = "pulling", "transition", "releasing", "rest"


def label_phases(run: SimulationArrays) -> np.ndarray:
    """Phase of every step: "pulling" and "releasing" where the whole tendon slips, "transition" where part of
    it is locked.

    A step that changes nothing keeps the phase before it; before anything has slipped it is "rest". Where the
    tendon is locked is `run.slip_front`: it slips on [0, slip_front] and is locked beyond.

    Returns:
        Array of str, (K, *tendons).
    """
    whole = np.asarray(run.slip_front) >= float(run.s[-1]) * (1 - 1e-12)
    direction = np.asarray(run.slip_direction)
    if direction.ndim == 1:
        return phases_of_slip(whole, direction)
    return np.stack([phases_of_slip(*own) for own in zip(whole.T, direction.T, strict=True)], axis=1)


def phases_of_slip(whole: np.ndarray, direction: np.ndarray, first: str = REST) -> np.ndarray:
    """Phase of every step, from where and in which direction the tendon slips.

    Args:
        whole: whether slip reaches the tip, (K,).
        direction: of the slip at the base, 1 towards it, -1 towards the tip, 0 where nothing changes, (K,).
        first: phase before anything has slipped.

    Returns:
        Array of str, (K,).
    """
    now = np.where(whole & (direction > 0), PULLING, np.where(whole & (direction < 0), RELEASING, TRANSITION))
    labels, last = [], first
    for label, moves in zip(now, direction != 0, strict=True):
        last = str(label) if moves else last
        labels.append(last)
    return np.asarray(labels)
