"""What disturbs many readings of an experiment at once: errors of the base tension, the zero of a
displacement, and the stretch of the tendon in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from calibrate.inference.channels import of_tendons, quantity_of
from calibrate.inference.setup import Observation

from .candidates import Candidate

# Change of slope, as a share of the steepest, that makes a corner of a load history.
BEND = 1e-6
# Change of T_tip with the base tension below which friction holds the tip.
HELD = 1e-3
# Standard deviation of the zero of a displacement, as a multiple of its range: not known.
UNKNOWN_ZERO = 100.0
White = Callable[[np.ndarray], np.ndarray]


def corners(time: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Samples at which a load history bends, its ends among them, increasing.

    Args:
        time, drive: of the samples, (K,).
    """
    slope = np.diff(drive) / np.diff(time)
    bends = np.flatnonzero(np.abs(np.diff(slope)) > BEND * np.max(np.abs(slope))) + 1
    return np.asarray([0, *bends.tolist(), len(drive) - 1])


def disturbances(
    candidate: Candidate, part: Observation, channels: Sequence[str], rows: np.ndarray, noise: float
) -> np.ndarray:
    """Changes of the readings, one standard deviation of each disturbance, SI, (C, K, q).

    What drives the tendon is known at the corners of its history as well as its own readings say, which are
    straight between; an error there moves every reading along its slope, and T_tip, where friction holds it,
    as it did when it slipped last.

    Args:
        candidate: the experiment.
        part: it, as a recording.
        channels: that are read, C of them.
        rows: their readings, SI, (C, K).
        noise: standard deviation of a reading of what drives, SI.
    """
    K = len(candidate.time)
    which = int(np.argmax(np.ptp(candidate.drive, axis=0)))
    drive = candidate.drive[:, which]
    found = []
    if noise > 0:
        bends = corners(candidate.time, drive)
        hats = np.stack([np.interp(np.arange(K), bends, unit) for unit in np.eye(len(bends))], axis=1)
        shapes = hats @ np.linalg.cholesky(noise**2 * np.linalg.inv(hats.T @ hats))
        found.append(
            np.stack([_followed(name, row, drive, shapes) for name, row in zip(channels, rows, strict=True)])
        )
    drawn = [c for c, name in enumerate(channels) if quantity_of(name) == "displacement"]
    if drawn:
        zero = np.zeros((*rows.shape, len(drawn)))
        for k, c in enumerate(drawn):
            zero[c, :, k] = UNKNOWN_ZERO * max(float(np.ptp(rows[c])), 1e-6)
        tips = [channels.index(name) for name in of_tendons("T_tip", part.robot) if name in channels]
        found.append(zero)
        if len(tips) == len(part.drives):
            stretch = np.zeros((*rows.shape, 1))
            own = part.stretch(rows[tips])
            for c in drawn:
                stretch[c, :, 0] = own[part.channels.index(channels[c])]
            found.append(stretch)
    return np.concatenate(found, axis=2) if found else np.zeros((*rows.shape, 0))


def _followed(name: str, row: np.ndarray, drive: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """How the readings of a channel, (K,), follow changes of what drives, (K, q)."""
    moved = np.diff(drive)
    slope = np.divide(np.diff(row), moved, out=np.zeros(len(moved)), where=moved != 0)
    slope = np.concatenate([slope[:1], slope])
    moves = np.concatenate([[True], moved != 0])
    found = np.zeros(shapes.shape)
    own = slope[0]
    for k in range(len(row)):
        own = slope[k] if moves[k] else own
        held = quantity_of(name) == "T_tip" and abs(own) < HELD
        found[k] = found[k - 1] if held and k else own * shapes[k]
    return found


def whitening(columns: np.ndarray) -> White:
    """The function that makes readings independent of each other which share disturbances of one standard
    deviation each, (n, q), beside noise of one each: (1 + D D')^(-1/2).
    """
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    less = 1 / np.sqrt(1 + s**2) - 1

    def white(values: np.ndarray) -> np.ndarray:
        return values + (U * less) @ (U.T @ values)

    return white
