"""Cross-sections by name: what of the body carries the load, where that is not all within its outer radius,
as of a strip or a tube with spacer disks.

Stiffnesses are over Young's modulus: torsion J/(2 (1 + nu)), and the second moments of area about y and z.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

TERMS = 6  # of the series of Saint-Venant's torsion; the first left out is below 1e-6 of J


def strains(shape: Tube | Rectangle, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest shear and largest strain of a section that is twisted and bent by some strain [1/m], (..., 3):
    twist, and bendings about y and z.
    """
    twist, up, side = np.moveaxis(np.abs(strain), -1, 0)
    if isinstance(shape, Tube):
        reach = float(shape.reach())
        return twist * reach, np.hypot(up, side) * reach
    height, width = float(shape.height), float(shape.width)
    return twist * min(height, width), 0.5 * (side * height + up * width)


class Tube(eqx.Module):
    """A round tube, or a rod where the inner diameter is 0.

    Attributes:
        outer_diameter, inner_diameter: [m].
    """

    outer_diameter: Float[Array, ""]
    inner_diameter: Float[Array, ""]

    def area(self) -> Float[Array, ""]:
        """[m^2]."""
        return jnp.pi / 4 * (self.outer_diameter**2 - self.inner_diameter**2)

    def stiffnesses(self, poissons_ratio: Float[Array, ""]) -> list[Float[Array, ""]]:
        """GJ, EI_y and EI_z over E [m^4]."""
        second = jnp.pi / 64 * (self.outer_diameter**4 - self.inner_diameter**4)
        return [second / (1 + poissons_ratio), second, second]

    def reach(self) -> Float[Array, ""]:
        """Distance of the outermost fibre from the neutral line, bent in the plane [m]."""
        return 0.5 * self.outer_diameter

    def extent(self) -> Float[Array, ""]:
        """Distance of the farthest point from the axis [m]."""
        return 0.5 * self.outer_diameter


class Rectangle(eqx.Module):
    """A strip.

    Attributes:
        height: along y, in the plane of robots in the plane [m].
        width: along z [m].
    """

    height: Float[Array, ""]
    width: Float[Array, ""]

    def area(self) -> Float[Array, ""]:
        """[m^2]."""
        return self.height * self.width

    def stiffnesses(self, poissons_ratio: Float[Array, ""]) -> list[Float[Array, ""]]:
        """GJ, EI_y and EI_z over E [m^4]; J by Saint-Venant's series (Timoshenko and Goodier 1970, 109)."""
        up, across = self.height, self.width
        longer, thinner = jnp.where(up > across, up, across), jnp.where(up > across, across, up)
        odd = 2.0 * jnp.arange(TERMS, dtype=float) + 1.0
        ends = jnp.sum(jnp.tanh(odd * jnp.pi / 2 * longer / thinner) / odd**5)
        torsion = longer * thinner**3 / 3 * (1 - 192 / jnp.pi**5 * thinner / longer * ends)
        return [torsion / (2 * (1 + poissons_ratio)), up * across**3 / 12, across * up**3 / 12]

    def reach(self) -> Float[Array, ""]:
        """Distance of the outermost fibre from the neutral line, bent in the plane [m]."""
        return 0.5 * self.height

    def extent(self) -> Float[Array, ""]:
        """Distance of the farthest points, its corners, from the axis [m]."""
        return 0.5 * jnp.sqrt(self.height**2 + self.width**2)
