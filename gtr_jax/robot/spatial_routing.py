"""The routings that leave the plane: the tendon channel's offset (y, z) in the section, with two derivatives.

The section is that of the straight body: y along the left normal, z across the plane of the robot. Lengths in
metres, angles in radians.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gtr_jax.mechanics.offset import SpatialOffset

from .routing import Routing, spline, spline_basis, waves_of_knots


class Helix(Routing):
    """r = rho (cos phi, sin phi), phi = start_angle + 2 pi turns s/L, rho linear from `radius` at the base to
    `tip_radius` at the tip (None: the same all along).
    """

    radius: Float[Array, ""]
    turns: Float[Array, ""]
    start_angle: Float[Array, ""]
    tip_radius: Float[Array, ""] | None = None

    def section_offset(self, s, passed, length):
        tip = self.radius if self.tip_radius is None else self.tip_radius
        taper, rate = (tip - self.radius) / length, 2 * jnp.pi * self.turns / length
        rho, phi = (self.radius + taper * s)[:, None], self.start_angle + rate * s
        out = jnp.stack([jnp.cos(phi), jnp.sin(phi)], axis=-1)
        around = jnp.stack([-out[:, 1], out[:, 0]], axis=-1)
        return SpatialOffset(
            rho * out, taper * out + rate * rho * around, 2 * taper * rate * around - rate * rate * rho * out
        )

    def half_waves(self, start, end, length):
        return 2.0 * abs(float(self.turns)) * (end - start) / length


class Straight(Routing):
    """A channel parallel to the axis: r = radius (cos angle, sin angle)."""

    radius: Float[Array, ""]
    angle: Float[Array, ""]

    def section_offset(self, s, passed, length):
        place = self.radius * jnp.stack([jnp.cos(self.angle), jnp.sin(self.angle)])
        still = jnp.zeros((s.shape[0], 2))
        return SpatialOffset(still + place[None, :], still, still)


class Curve(Routing):
    """Cubic splines (C2, not-a-knot) through (s, y, z) knots.

    Attributes:
        knots_s: knot positions [m], shape (K,), increasing from 0 to L; fixed.
        knots_y, knots_z: offsets at the knots [m], shape (K,).
        basis: spline coefficients per unit knot value, (4, pieces, K).
    """

    knots_s: Float[Array, " K"]
    knots_y: Float[Array, " K"]
    knots_z: Float[Array, " K"]
    basis: Float[Array, "4 pieces K"]

    def section_offset(self, s, passed, length):
        y, z = (spline(self.basis, self.knots_s, v, s) for v in (self.knots_y, self.knots_z))
        return SpatialOffset(*(jnp.stack(pair, axis=-1) for pair in zip(y, z, strict=True)))

    def half_waves(self, start, end, length):
        return waves_of_knots(self.knots_s, start, end)


def curve_routing(knots_s: np.ndarray, knots_y: np.ndarray, knots_z: np.ndarray) -> Curve:
    """Spline channel through knots at increasing s, each (K,) [m], K >= 2."""
    s, y, z = (jnp.asarray(v, float) for v in (knots_s, knots_y, knots_z))
    return Curve(s, y, z, spline_basis(knots_s))
