"""The backbone: lengths, stiffness, weight and natural curvature of the rod the tendon bends."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class Backbone(eqx.Module):
    """Round rod with a linear taper and concentric bores.

    Attributes:
        length: L [m].
        outer_radius: radius at the base and at the tip [m], shape (2,); linear between.
        bore_start, bore_end, bore_diameter: concentric bores [m], shape (bores,).
        youngs_modulus: E [Pa].
        density: mass density [kg/m^3].
        natural_curvature_s, natural_curvature: knots of the stress-free curvature [m], [1/m], shape (knots,);
            linear between knots, constant outside them. One knot is a constant curvature.
        rigid: True for a sheath of fixed shape: the curvature is the natural one whatever the load.
    """

    length: Float[Array, ""]
    outer_radius: Float[Array, "2"]
    bore_start: Float[Array, " bores"]
    bore_end: Float[Array, " bores"]
    bore_diameter: Float[Array, " bores"]
    youngs_modulus: Float[Array, ""]
    density: Float[Array, ""]
    natural_curvature_s: Float[Array, " knots"]
    natural_curvature: Float[Array, " knots"]
    rigid: bool = eqx.field(static=True, default=False)

    def radius(self, s: Float[Array, " N"]) -> Float[Array, " N"]:
        """Outer radius [m] at s."""
        return self.outer_radius[0] + (self.outer_radius[1] - self.outer_radius[0]) * s / self.length

    def area(self, s: Float[Array, " N"], bored: Bool[Array, "bores N"]) -> Float[Array, " N"]:
        """Cross-section area [m^2] at s; `bored` tells which bores the node lies in."""
        radii = jnp.where(bored, 0.5 * self.bore_diameter[:, None], 0.0)
        return jnp.pi * (self.radius(s) ** 2 - jnp.sum(radii**2, axis=0))

    def bending_stiffness(self, s: Float[Array, " N"], bored: Bool[Array, "bores N"]) -> Float[Array, " N"]:
        """EI [N m^2] at s; `bored` tells which bores the node lies in."""
        radii = jnp.where(bored, 0.5 * self.bore_diameter[:, None], 0.0)
        return self.youngs_modulus * jnp.pi / 4 * (self.radius(s) ** 4 - jnp.sum(radii**4, axis=0))

    def compliance(self, s: Float[Array, " N"], bored: Bool[Array, "bores N"]) -> Float[Array, " N"]:
        """1/EI [1/(N m^2)]; 0 for a rigid sheath."""
        if self.rigid:
            return jnp.zeros_like(s)
        return 1.0 / self.bending_stiffness(s, bored)

    def curvature_at_rest(self, s: Float[Array, " N"]) -> Float[Array, " N"]:
        """Natural curvature kappa_0 [1/m] at s."""
        if self.natural_curvature.shape[0] == 1:
            return jnp.broadcast_to(self.natural_curvature[0], s.shape)
        return jnp.interp(s, self.natural_curvature_s, self.natural_curvature)
