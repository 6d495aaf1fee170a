"""The routings: the tendon channel's offset R(s) from the midline, along the left normal, with two derivatives.

Each class is one published or user-given family. Lengths in metres; equation numbers are those of Liu & Alambeigi, RA-L 2022.
"""

from __future__ import annotations

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Offset(NamedTuple):
    """Channel offset R [m], slope R' [-] and second derivative R'' [1/m], each of shape (N,)."""

    value: Float[Array, " N"]
    slope: Float[Array, " N"]
    second: Float[Array, " N"]


class Routing(eqx.Module):
    """A tendon channel: `offset(s, side, length)` gives R, R', R''; `kinks` where R'' jumps."""

    @abc.abstractmethod
    def value(self, s: Float[Array, ""], side: Float[Array, ""], length: Float[Array, ""]) -> Float[Array, ""]:
        """R [m] at the scalar arc length s, on the side of a kink where `side` lies; smooth within a panel."""

    def offset(self, s: Float[Array, " N"], side: Float[Array, " N"], length: Float[Array, ""]) -> Offset:
        """R, R', R'' at the nodes; derivatives by forward differentiation of `value`."""

        def at(s_, side_):
            slope = jax.jacfwd(self.value)
            return Offset(self.value(s_, side_, length), slope(s_, side_, length), jax.jacfwd(slope)(s_, side_, length))

        return jax.vmap(at)(s, side)

    def kinks(self) -> Float[Array, " kinks"]:
        """Arc lengths [m] where R'' jumps: the mesh ends a panel there."""
        return jnp.zeros(0)

    def half_waves(self, start: float, end: float, length: float) -> float:
        """About how many half waves of R lie in [start, end] (host side, for the mesh)."""
        return 0.0


class Parallel(Routing):
    """Constant offset: R = offset_."""

    offset_: Float[Array, ""]

    def value(self, s, side, length):
        return self.offset_ + 0.0 * s


class ConvergingSine(Routing):
    """Eq. (19): R = (R_max + (r_min - R_max) s/L) (1 + sigma sin(n_sine pi s/L))."""

    R_max: Float[Array, ""]
    r_min: Float[Array, ""]
    n_sine: Float[Array, ""]
    sigma: Float[Array, ""]

    def value(self, s, side, length):
        envelope = self.R_max + (self.r_min - self.R_max) * s / length
        return envelope * (1.0 + self.sigma * jnp.sin(self.n_sine * jnp.pi * s / length))

    def half_waves(self, start, end, length):
        return float(self.n_sine) * (end - start) / length


class CrossingSine(Routing):
    """Eq. (20): R = (R_max + (r_min - R_max) s/L) sin(n_sine pi s/L)."""

    R_max: Float[Array, ""]
    r_min: Float[Array, ""]
    n_sine: Float[Array, ""]

    def value(self, s, side, length):
        envelope = self.R_max + (self.r_min - self.R_max) * s / length
        return envelope * jnp.sin(self.n_sine * jnp.pi * s / length)

    def half_waves(self, start, end, length):
        return float(self.n_sine) * (end - start) / length


class StraightSineStraight(Routing):
    """Eq. (21), with the half cosine that joins r1 and r2 without a step (the printed phase steps when r1 < 0).

    R = r1 on [0, w1), (r1+r2)/2 - (r2-r1)/2 cos(pi (s-w1)/(w2-w1)) on [w1, w2), r2 on [w2, L].
    """

    r1: Float[Array, ""]
    r2: Float[Array, ""]
    w1: Float[Array, ""]
    w2: Float[Array, ""]

    def value(self, s, side, length):
        phase = jnp.pi * (s - self.w1) / (self.w2 - self.w1)
        wave = 0.5 * (self.r1 + self.r2) - 0.5 * (self.r2 - self.r1) * jnp.cos(phase)
        return jnp.where(side < self.w1, self.r1, jnp.where(side < self.w2, wave, self.r2))

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
        basis: spline coefficients per unit knot value, shape (4, K-1, K): the spline is linear in `knots_R`.
    """

    knots_s: Float[Array, " K"]
    knots_R: Float[Array, " K"]
    basis: Float[Array, "4 K-1 K"]

    def offset(self, s, side, length):
        c = self.basis @ self.knots_R
        piece = jnp.clip(jnp.searchsorted(self.knots_s, s, side="right") - 1, 0, self.knots_s.shape[0] - 2)
        x = s - self.knots_s[piece]
        c3, c2, c1, c0 = (c[j][piece] for j in range(4))
        return Offset(c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2 * c2 + 3 * x * c3), 2 * c2 + 6 * x * c3)

    def value(self, s, side, length):
        return self.offset(s[None], side[None], length).value[0]

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
    return Table(jnp.asarray(knots_s, float), jnp.asarray(knots_R, float), jnp.asarray(basis))
