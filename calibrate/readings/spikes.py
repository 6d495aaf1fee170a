"""Lone spikes of a base tension."""

from __future__ import annotations

import numpy as np

from .noise import from_differences

# A lone spike is so many standard deviations off all that its neighbours say, and so many times as far as
# they differ among each other.
SPIKE, SPIKE_APART = 10.0, 3.0


def without_spikes(T: np.ndarray) -> tuple[np.ndarray, int]:
    """A base tension without lone spikes, and how many there were.

    A spike is a sample far from where the two before it point to, from where the two after it point to, and
    from between its neighbours; where a tension turns, one side points at the turn. Spikes are put between
    their neighbours.
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
