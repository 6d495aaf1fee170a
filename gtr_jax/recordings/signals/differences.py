"""White noise of a signal, from differences of its neighbouring samples."""

from __future__ import annotations

import numpy as np

# Standard deviation of a normal distribution over its median absolute deviation.
MAD_TO_SD = 1.4826


def third_differences(x: np.ndarray) -> np.ndarray:
    """Third differences of a signal, (..., K), scaled so that white noise keeps its variance, (..., K-3).

    They cancel what is smooth, up to quadratic.
    """
    return (x[..., 3:] - 3 * x[..., 2:-1] + 3 * x[..., 1:-2] - x[..., :-3]) / np.sqrt(20.0)


def from_differences(x: np.ndarray) -> float:
    """Standard deviation of the white noise of a signal, (K,), from third differences, by their median, which
    a few reversals do not change; 0 for fewer than four samples.

    Noise that is correlated between neighbours is underestimated, and a coarsely sampled loop is mistaken for
    noise.
    """
    return MAD_TO_SD * float(np.median(np.abs(third_differences(x)))) if len(x) > 3 else 0.0
