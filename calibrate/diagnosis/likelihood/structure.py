"""What counts as structure that a fit leaves beyond the noise: its size, in standard deviations of the noise,
and its significance, as `locate.misfit` finds them.
"""

from __future__ import annotations

# Structure left by the base model counts above this significance and this size in standard deviations of the
# noise.
LEFT_Z, LEFT_SIZE = 6.0, 0.35
# Size above which structure counts even if neighbouring samples are not correlated. One repeat in four with
# three times the noise has a size of 1.4; one of 206 sound recordings reached 1.47.
VAST = 2.5
# Structure left by the best effect counts above this significance, size and share of the size that the base
# model leaves; the second share holds where the size exceeds `MUCH`.
STAYS_Z, STAYS_SIZE, STAYS_SHARE, MUCH = 2.2, 0.3, (0.55, 0.42), 1.35
# In a long recording, where every effect pays on unseen cycles, half of what is left in squares may stay.
HALF_STAYS = 0.71


def structured(left: tuple[float, float], z: float = LEFT_Z, size: float = LEFT_SIZE) -> bool:
    """Whether the structure left is more than noise, by size and significance or by size alone."""
    return (left[1] > z and left[0] > size) or left[0] > VAST


def may_stay(left: tuple[float, float]) -> float:
    """Share of the size of what the base model leaves from which on a model's effects are not what is
    missing.

    Args:
        left: what the model leaves.
    """
    return STAYS_SHARE[left[0] > MUCH]
