"""What recorded readings alone show: their noise, and the true base tension behind a noisy one.

The true base tension is modelled as straight runs, or smooth curves, with as few knots as the noise allows. A
tendon with friction remembers extremes, so noise in the base tension does not average out: taken as exact,
every noisy peak ratchets the simulated tip tension up, and friction with it. The true base tension is
therefore an unknown of the fit. Actuators ramp, hold and swing: between corners it is straight in time, or a
cubic spline where it keeps bending in one direction. A knot is set wherever the recording contradicts that
beyond its noise, first of all at every turning point; nothing is smoothed across a corner. The tip follows
true changes but not noise, so it must not follow the residual. If it does, a search for steps is tried; where
nothing helps, the readings are taken as exact.
"""

from gtr_jax.recordings.signals.turning import turning_points

from .acceptance import estimate_base, is_noisy, sharpened
from .base_tension import BaseTension, exact
from .knots import BEND, straighten
from .slow import with_slow_noise
from .spikes import without_spikes

__all__ = [
    "BEND",
    "BaseTension",
    "estimate_base",
    "exact",
    "is_noisy",
    "sharpened",
    "straighten",
    "turning_points",
    "with_slow_noise",
    "without_spikes",
]
