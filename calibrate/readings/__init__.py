"""What recorded readings say by themselves: how noisy they are, and the true base tension behind a noisy one.

The true base tension is straight runs, or smooth curves, with as few knots as the noise allows. A tendon with
friction remembers extremes, so noise in the base tension does not average out: taken as exact, every noisy
peak ratchets the simulated tip tension up, and friction with it. The true base tension is therefore an
unknown of the fit. Actuators ramp, hold and swing: between corners it is straight in time, or a cubic spline
where it bends on and on in one sense. A knot is set wherever the recording contradicts that beyond its noise,
first of all at every turning point; nothing is smoothed across a corner. What is left must not be followed by
the tip, which follows true changes and no noise: else steps are looked for, and where nothing helps the
readings are taken as they are.
"""

from .acceptance import estimate_base, is_noisy, sharpened
from .base_tension import BaseTension, exact
from .knots import BEND, straighten, turning_points
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
    "without_spikes",
]
