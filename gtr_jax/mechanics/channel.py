"""Geometry of the tendon in its channel: tangent, metric factor, moment arm and wrap.

The channel runs at p_c = p + R n, so p_c' = (1 - R kappa) t + R' n. With a = 1 - R kappa: metric factor nu =
hypot(a, R'), tangent angle psi = phi + atan2(R', a), moment arm of the tension about the midline b = R a /
nu.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from .mesh import Interval
from .offset import Offset

SMALLEST_TURN = 1e-14  # rad; the sign of a smaller turn is that of rounding


def metric_factor(kappa: Float[Array, "*nodes"], R: Offset) -> Float[Array, "*nodes"]:
    """nu = |p_c'| = ds_c/ds (eq. 3)."""
    return jnp.hypot(1.0 - R.value * kappa, R.slope)


def tangent_lead(kappa: Float[Array, "*nodes"], R: Offset) -> Float[Array, "*nodes"]:
    """psi - phi: angle from the midline tangent to the tendon tangent [rad]."""
    return jnp.arctan2(R.slope, 1.0 - R.value * kappa)


def moment_arm(kappa: Float[Array, "*nodes"], R: Offset) -> Float[Array, "*nodes"]:
    """Signed arm [m] of the tension at the cut about the midline: R (1 - R kappa) / nu.

    The local moment identity: the anchor moment (15) and the distributed moment (16, with ds_c) sum to T
    times this arm.
    """
    a = 1.0 - R.value * kappa
    return R.value * a / jnp.sqrt(a * a + R.slope**2)


def turning_rate(kappa, kappa_slope, R: Offset):
    """psi' [rad/m]: kappa + (R'' a - R' a') / nu^2 with a' = -R' kappa - R kappa'."""
    a = 1.0 - R.value * kappa
    return kappa + (R.second * a + R.slope**2 * kappa + R.value * R.slope * kappa_slope) / (
        a * a + R.slope**2
    )


def _lead_change(a, slope, a_before, slope_before):
    """Change of psi - phi between two nodes [rad], less than pi, from 1 - R kappa and R' at both."""
    return jnp.arctan2(slope * a_before - slope_before * a, a * a_before + slope * slope_before)


def wrap_increment(angle_change, kappa, kappa_before, R: Offset, R_before: Offset, between: Interval):
    """Total turning of the tendon [rad] between a node and the one before it.

    |psi_i - psi_(i-1)| is exact while psi is monotone between the nodes. Where psi' changes sign inside, the
    parabola through the end slopes adds the turn there and back; the sum is continuously differentiable
    through that event. Across a panel boundary it is the kink angle of the channel. Where nothing turns (a
    panel of no length between two kinks that coincide, a bore's end where the channel runs straight) the sign
    is the one the turn takes as the kinks move apart, so that derivatives are right there too.

    Args:
        angle_change: phi_i - phi_(i-1) [rad].
        kappa, kappa_before: curvature at the node and at its predecessor [1/m].
        R, R_before: channel offset there.
        between: the interval.
    """
    turn = angle_change + _lead_change(
        1.0 - R.value * kappa, R.slope, 1.0 - R_before.value * kappa_before, R_before.slope
    )
    length = between.length
    slope = (kappa - kappa_before) / jnp.where(length > 0, length, 1.0)
    here, before = turning_rate(kappa, slope, R), turning_rate(kappa_before, slope, R_before)
    low = jnp.minimum(jnp.abs(here), jnp.abs(before))
    total = jnp.abs(here) + jnp.abs(before)
    there_and_back = length * low**2 / jnp.where(total > 0, total, 1.0)
    opening = R_before.second * (1.0 / (1.0 - R.value * kappa) - 1.0 / (1.0 - R_before.value * kappa_before))
    at_rest = jnp.where(between.starts, opening, here)
    sense = jnp.sign(jnp.where(jnp.abs(turn) > SMALLEST_TURN, turn, at_rest))
    return between.joined * (turn * sense + jnp.where(here * before < 0, there_and_back, 0.0))
