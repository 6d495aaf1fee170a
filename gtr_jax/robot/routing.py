"""The routings in one plane: the tendon channel's offset R(s) from the midline, along the left normal, with
two derivatives. Those that leave it are in `spatial_routing`.

Each class is one published or user-given family. Lengths in metres; equation numbers are those of Liu &
Alambeigi, RA-L 2022.
"""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gtr_jax.mechanics.offset import Offset, SpatialOffset


class Routing(eqx.Module):
    """A tendon channel. Subclasses give `section_offset`, and `kinks` where its second derivative jumps."""

    @abc.abstractmethod
    def section_offset(
        self, s: Float[Array, " N"], passed: Bool[Array, "kinks N"], length: Float[Array, ""]
    ) -> SpatialOffset:
        """Offset in the section (y along the left normal, z across the plane), r, r', r'' at the nodes.

        Args:
            s: arc length [m], (N,).
            passed: which of `kinks` lie before the node, (kinks, N); tells the two nodes at a kink apart.
            length: L [m].
        """

    def offset(
        self, s: Float[Array, " N"], passed: Bool[Array, "kinks N"], length: Float[Array, ""]
    ) -> Offset:
        """R, R', R'' at the nodes, of a channel in one plane; arguments as of `section_offset`."""
        raise TypeError(f"{type(self).__name__}: the channel leaves the plane; use section_offset")

    def kinks(self) -> Float[Array, " kinks"]:
        """Arc lengths [m] where r'' jumps: the mesh ends a panel there."""
        return jnp.zeros(0)

    def half_waves(self, start: float, end: float, length: float) -> float:
        """About how many half waves of r lie in [start, end] (host side, for the mesh)."""
        return 0.0


class PlanarRouting(Routing):
    """A tendon channel in one plane through the axis. Subclasses give `offset`, R along its normal.

    Attributes:
        plane_angle: by which that plane is turned about the axis from the plane of the robot [rad]; None: not
            at all.
    """

    plane_angle: Float[Array, ""] | None = eqx.field(kw_only=True, default=None)

    @abc.abstractmethod
    def offset(
        self, s: Float[Array, " N"], passed: Bool[Array, "kinks N"], length: Float[Array, ""]
    ) -> Offset:
        """R, R', R'' at the nodes; arguments as of `section_offset`."""

    def section_offset(
        self, s: Float[Array, " N"], passed: Bool[Array, "kinks N"], length: Float[Array, ""]
    ) -> SpatialOffset:
        """(R cos a, R sin a) and its derivatives, a being the plane's angle."""
        angle = jnp.zeros(()) if self.plane_angle is None else self.plane_angle
        across = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        return SpatialOffset(*(along[:, None] * across[None, :] for along in self.offset(s, passed, length)))


class Parallel(PlanarRouting):
    """Constant offset R = offset_."""

    offset_: Float[Array, ""]

    def offset(self, s, passed, length):
        zero = jnp.zeros_like(s)
        return Offset(zero + self.offset_, zero, zero)


def _times_envelope(s, length, R_max, r_min, wave, slope, second) -> Offset:
    """(R_max + (r_min - R_max) s/L) times a wave given with its derivatives."""
    taper = (r_min - R_max) / length
    envelope = R_max + taper * s
    return Offset(envelope * wave, envelope * slope + taper * wave, envelope * second + 2 * taper * slope)


class ConvergingSine(PlanarRouting):
    """Eq. (19): R = (R_max + (r_min - R_max) s/L) (1 + sigma sin(n_sine pi s/L))."""

    R_max: Float[Array, ""]
    r_min: Float[Array, ""]
    n_sine: Float[Array, ""]
    sigma: Float[Array, ""]

    def offset(self, s, passed, length):
        k = self.n_sine * jnp.pi / length
        sine, cosine = self.sigma * jnp.sin(k * s), self.sigma * jnp.cos(k * s)
        return _times_envelope(s, length, self.R_max, self.r_min, 1.0 + sine, k * cosine, -k * k * sine)

    def half_waves(self, start, end, length):
        return float(self.n_sine) * (end - start) / length


class CrossingSine(PlanarRouting):
    """Eq. (20): R = (R_max + (r_min - R_max) s/L) sin(n_sine pi s/L)."""

    R_max: Float[Array, ""]
    r_min: Float[Array, ""]
    n_sine: Float[Array, ""]

    def offset(self, s, passed, length):
        k = self.n_sine * jnp.pi / length
        sine, cosine = jnp.sin(k * s), jnp.cos(k * s)
        return _times_envelope(s, length, self.R_max, self.r_min, sine, k * cosine, -k * k * sine)

    def half_waves(self, start, end, length):
        return float(self.n_sine) * (end - start) / length


class StraightSineStraight(PlanarRouting):
    """Eq. (21), with the half cosine that joins r1 and r2 without a step (with the phase as printed, R steps
    when r1 < 0).

    R = r1 on [0, w1), (r1+r2)/2 - (r2-r1)/2 cos(pi (s-w1)/(w2-w1)) on [w1, w2), r2 on [w2, L].
    """

    r1: Float[Array, ""]
    r2: Float[Array, ""]
    w1: Float[Array, ""]
    w2: Float[Array, ""]

    def offset(self, s, passed, length):
        k = jnp.pi / (self.w2 - self.w1)
        half = 0.5 * (self.r2 - self.r1)
        cosine, sine = half * jnp.cos(k * (s - self.w1)), half * jnp.sin(k * (s - self.w1))
        inside = passed[0] & ~passed[1]
        ends = jnp.where(passed[1], self.r2, self.r1)
        return Offset(
            jnp.where(inside, 0.5 * (self.r1 + self.r2) - cosine, ends),
            jnp.where(inside, k * sine, 0.0),
            jnp.where(inside, k * k * cosine, 0.0),
        )

    def kinks(self):
        return jnp.stack([self.w1, self.w2])

    def half_waves(self, start, end, length):
        middle = 0.5 * (start + end)
        inside = float(self.w1) <= middle < float(self.w2)
        return (end - start) / float(self.w2 - self.w1) if inside else 0.0


class Table(PlanarRouting):
    """Cubic spline (C2, not-a-knot) through (s, R) knots; for measured or optimised channels.

    Attributes:
        knots_s: knot positions [m], shape (K,), increasing from 0 to L; fixed.
        knots_R: offsets at the knots [m], shape (K,); what may be fitted or optimised.
        basis: spline coefficients per unit knot value, (4, pieces, K): the spline is linear in `knots_R`.
    """

    knots_s: Float[Array, " K"]
    knots_R: Float[Array, " K"]
    basis: Float[Array, "4 pieces K"]

    def offset(self, s, passed, length):
        return Offset(*spline(self.basis, self.knots_s, self.knots_R, s))

    def half_waves(self, start, end, length):
        return waves_of_knots(self.knots_s, start, end)


def table_routing(knots_s: np.ndarray, knots_R: np.ndarray) -> Table:
    """Spline routing through knots.

    Args:
        knots_s: increasing positions [m], shape (K,), K >= 2.
        knots_R: offsets [m], shape (K,). Two knots give a line, three a parabola.
    """
    return Table(jnp.asarray(knots_s, float), jnp.asarray(knots_R, float), spline_basis(knots_s))


def spline_basis(knots_s: np.ndarray) -> Float[Array, "4 pieces K"]:
    """Coefficients of the C2 spline (not-a-knot) through knots at `knots_s` [m], (K,), per unit knot
    value.
    """
    from scipy.interpolate import CubicSpline

    basis = CubicSpline(np.asarray(knots_s, float), np.eye(len(knots_s))).c
    padded = np.zeros((4, *basis.shape[1:]))
    padded[4 - len(basis) :] = basis
    return jnp.asarray(padded)


def spline(
    basis: Float[Array, "4 pieces K"],
    knots_s: Float[Array, " K"],
    values: Float[Array, " K"],
    s: Float[Array, " N"],
) -> tuple[Float[Array, " N"], Float[Array, " N"], Float[Array, " N"]]:
    """The spline of `spline_basis` through knot values, and its first two derivatives, at s [m], (N,)."""
    c = basis @ values
    piece = jnp.clip(jnp.searchsorted(knots_s, s, side="right") - 1, 0, knots_s.shape[0] - 2)
    x = s - knots_s[piece]
    c3, c2, c1, c0 = (c[j][piece] for j in range(4))
    return c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2 * c2 + 3 * x * c3), 2 * c2 + 6 * x * c3


def waves_of_knots(knots_s: Float[Array, " K"], start: float, end: float) -> float:
    """About how many half waves a spline through knots has in [start, end] [m]."""
    knots = np.asarray(knots_s)
    return 0.5 * float(np.sum((knots > start) & (knots < end)))
