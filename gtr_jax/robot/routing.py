"""The routings: the tendon channel's offset R(s) from the midline, along the left normal, with two
derivatives.

Each class is one published or user-given family. Lengths in metres; equation numbers are those of Liu &
Alambeigi, RA-L 2022.
"""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from gtr_jax.mechanics.offset import Offset


class Routing(eqx.Module):
    """A tendon channel. Subclasses give `offset`, and `kinks` where R'' jumps."""

    @abc.abstractmethod
    def offset(
        self, s: Float[Array, " N"], passed: Bool[Array, "kinks N"], length: Float[Array, ""]
    ) -> Offset:
        """R, R', R'' at the nodes.

        Args:
            s: arc length [m], (N,).
            passed: which of `kinks` lie before the node, (kinks, N); tells the two nodes at a kink apart.
            length: L [m].
        """

    def kinks(self) -> Float[Array, " kinks"]:
        """Arc lengths [m] where R'' jumps: the mesh ends a panel there."""
        return jnp.zeros(0)

    def half_waves(self, start: float, end: float, length: float) -> float:
        """About how many half waves of R lie in [start, end] (host side, for the mesh)."""
        return 0.0


class Parallel(Routing):
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


class ConvergingSine(Routing):
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


class CrossingSine(Routing):
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


class StraightSineStraight(Routing):
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


class Table(Routing):
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
        c = self.basis @ self.knots_R
        piece = jnp.clip(jnp.searchsorted(self.knots_s, s, side="right") - 1, 0, self.knots_s.shape[0] - 2)
        x = s - self.knots_s[piece]
        c3, c2, c1, c0 = (c[j][piece] for j in range(4))
        return Offset(c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2 * c2 + 3 * x * c3), 2 * c2 + 6 * x * c3)

    def half_waves(self, start, end, length):
        knots = np.asarray(self.knots_s)
        return 0.5 * float(np.sum((knots > start) & (knots < end)))


def table_routing(knots_s: np.ndarray, knots_R: np.ndarray) -> Table:
    """Spline routing through knots.

    Args:
        knots_s: increasing positions [m], shape (K,), K >= 2.
        knots_R: offsets [m], shape (K,). Two knots give a line, three a parabola.
    """
    from scipy.interpolate import CubicSpline

    basis = CubicSpline(np.asarray(knots_s, float), np.eye(len(knots_s))).c
    padded = np.zeros((4, *basis.shape[1:]))
    padded[4 - len(basis) :] = basis
    return Table(jnp.asarray(knots_s, float), jnp.asarray(knots_R, float), jnp.asarray(padded))
