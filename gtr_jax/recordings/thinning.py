"""Recordings of very many samples thinned: fewer where nothing bends, all of them around the corners.

Samples are taken at equal steps of a density that is the sum of an even one and of one in proportion to the
bend of the channels: the second difference of their means over as many samples as one is kept of. So turning
points, and the ends of holds and ramps, keep their samples. No sample is chosen for its own reading, which
would choose the extremes of the noise.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from .recording import Recording
from .signals.differences import from_differences

MOST = 20_000
"""Samples that a recording is thinned to before it is fitted or diagnosed."""
_EVEN = 0.5  # share of the samples that are kept at even steps
_NOISES = 4.0  # standard errors of a bend that noise may cause
_ROUNDS = 30


def thinned(recording: Recording, most: int = MOST) -> Recording:
    """A recording with at most so many samples, and its corners kept; itself if it has no more.

    Args:
        recording: of K samples.
        most: samples to keep, at least 2.

    Returns:
        The recording, with the number of samples it had in `thinned_from`.
    """
    K = len(recording)
    if most >= K:
        return recording
    channels = [recording.T_base] if recording.T_tip is None else [recording.T_base, recording.T_tip]
    if recording.displacement is not None and np.isnan(recording.T_base).any():
        channels.append(recording.displacement)  # by which tendons are driven
    rows = np.concatenate([c.reshape(K, -1) for c in channels], axis=1).T
    rows = rows[np.all(np.isfinite(rows), axis=1)]
    kept = _samples(rows, most)
    arrays = {
        field.name: values[kept]
        for field in dataclasses.fields(recording)
        if isinstance(values := getattr(recording, field.name), np.ndarray)
    }
    markers = {name: values[kept] for name, values in recording.markers.items()}
    for values in (*arrays.values(), *markers.values()):
        values.setflags(write=False)
    return dataclasses.replace(recording, **arrays, markers=markers, thinned_from=K)


def thinned_says(recording: Recording) -> str:
    """How a recording was thinned, in one sentence; "" if it was not."""
    if not recording.thinned_from:
        return ""
    return f"{recording.thinned_from} samples thinned to {len(recording)}, all kept around the corners"


def _samples(channels: np.ndarray, most: int) -> np.ndarray:
    """Indices of the samples to keep, both ends among them; channels are (C, K)."""
    K = channels.shape[1]
    bend = np.zeros(K)
    for x in channels:
        bend += _bend(x, max(K // most, 2))
    density = np.full(K, _EVEN * most / K)
    total, scale = float(bend.sum()), 0.0
    if total > 0:
        scale = (1 - _EVEN) * most / total
        for _ in range(_ROUNDS):  # until it fills the budget: no sample is kept twice
            filled = float(np.minimum(density + scale * bend, 1.0).sum())
            if filled >= 0.99 * most:
                break
            scale *= 1 + (most - filled) / most
    density = np.minimum(density + scale * bend, 1.0)
    density += (most - density.sum()) / K if density.sum() < most else 0.0
    density *= most / density.sum()
    reached = np.cumsum(density)
    kept = np.searchsorted(reached, (np.arange(most) + 0.5) * reached[-1] / most)
    return np.unique(np.concatenate([[0], kept[1:-1], [K - 1]]))


def _bend(x: np.ndarray, width: int) -> np.ndarray:
    """Bend of a channel beyond what its noise causes, relative to its range, (K,)."""
    K, span = len(x), float(np.ptp(x))
    if span == 0 or 3 * width >= K:
        return np.zeros(K)
    sums = np.concatenate([[0.0], np.cumsum(x - x[0])])
    means = (sums[width:] - sums[:-width]) / width  # of samples k to k + width - 1
    bend = np.abs(means[2 * width :] - 2 * means[width:-width] + means[: -2 * width])
    noise = from_differences(x)
    out = np.zeros(K)
    middle = width + width // 2
    out[middle : middle + len(bend)] = np.maximum(bend - _NOISES * noise * np.sqrt(6 / width), 0.0) / span
    return out
