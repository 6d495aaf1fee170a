"""Lone spikes of a base tension."""

from __future__ import annotations

import numpy as np

from gtr_jax.recordings.signals.noise import from_differences

# A lone spike is this many standard deviations off every value that its neighbours predict, and this many
# times as far off as these predictions differ.
SPIKE, SPIKE_APART = 10.0, 3.0


def without_spikes(T: np.ndarray) -> tuple[np.ndarray, int]:
    """A base tension without lone spikes, and how many there were.

    A spike is a sample far from the line through the two samples before it, from the line through the two
    after it, and from the mean of its neighbours. At a turn of the tension one of the lines meets the sample.
    Spikes are replaced by the mean of their neighbours.
    """
    sd = from_differences(T)
    if not sd or len(T) < 5:
        return T, 0
    k = np.arange(2, len(T) - 2)
    forward, backward = 2 * T[k - 1] - T[k - 2], 2 * T[k + 1] - T[k + 2]
    between = 0.5 * (T[k - 1] + T[k + 1])
    off = np.stack([T[k] - forward, T[k] - backward, T[k] - between])
    apart = np.max(np.abs(np.stack([forward, backward]) - between), axis=0)
    far = np.min(np.abs(off), axis=0)
    lone = k[(far > SPIKE * sd) & (far > SPIKE_APART * apart) & (np.abs(np.sum(np.sign(off), axis=0)) == 3)]
    clean = np.array(T)
    clean[lone] = 0.5 * (T[lone - 1] + T[lone + 1])
    return clean, len(lone)
