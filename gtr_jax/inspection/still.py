"""Where a signal stands still."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from gtr_jax.recordings.signals.stretches import runs

# A signal stands still where it keeps within a band for a time. The band is so many standard deviations of
# the noise, which samples without a trend seldom leave, and at least this share of the range.
BAND, SHARE = 8.0, 0.005
# The time is at least so many seconds, so many samples, and this share of the time from one turn to the next:
# a slow ramp then leaves the band.
SECONDS, SAMPLES, OF_RAMP = 0.5, 15, 0.04


def band_of(x: np.ndarray, sd: float) -> float:
    """Width of the band within which a signal, (K,), with noise `sd` stands still; in its unit."""
    return max(BAND * sd, SHARE * float(np.ptp(x)))


def window(step: float | None, ramp: int) -> int:
    """Samples for which a signal must keep within its band.

    Args:
        step: median time from sample to sample [s]; None without a clock.
        ramp: samples of the longest way from one turning point to the next.
    """
    seconds = 0 if step is None else int(np.ceil(SECONDS / step))
    return max(SAMPLES, seconds, int(OF_RAMP * ramp))


def still(x: np.ndarray, band: float, samples: int) -> list[tuple[int, int]]:
    """First and last sample of each stretch in which a signal keeps within a band for at least so many
    samples.

    Args:
        x: the signal, (K,).
        band: largest minus smallest value, in its unit.
        samples: of the shortest stretch.
    """
    if len(x) < samples:
        return []
    size = samples | 1
    width = maximum_filter1d(x, size, mode="nearest") - minimum_filter1d(x, size, mode="nearest")
    whole = width <= band
    half = size // 2
    whole[:half] = whole[len(x) - half :] = False  # windows that reach over an end
    return runs(maximum_filter1d(whole, size, mode="constant"), samples)
