"""The backbone: lengths, stiffness, weight and natural strain of the rod the tendon bends."""

from __future__ import annotations

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .notches import Cut, Notches, cut
from .shapes import Rectangle, Tube

POISSONS_RATIO = 0.5  # of the elastomers that soft arms are cast from, which keep their volume


def along_body(
    s: Float[Array, " N"], knots_s: Float[Array, " knots"] | None, values: Float[Array, " knots"] | None
) -> Float[Array, " N"]:
    """A quantity given by knots, at s: linear between them, constant outside; one knot is a constant, None is
    zero.
    """
    if knots_s is None or values is None:
        return jnp.zeros_like(s)
    if values.shape[0] == 1:
        return jnp.broadcast_to(values[0], s.shape)
    return jnp.interp(s, knots_s, values)


class Stiffness(eqx.Module):
    """Stiffness given in itself instead of by modulus and radius; linear between knots, constant outside.

    Attributes:
        bending_s, bending: knots [m] and EI_z there [N m^2], (knots,).
        bending_y: EI_y there [N m^2], (knots,); None: as EI_z.
        torsion_s, torsion: knots [m] and GJ there [N m^2], (twists,); None: that of a round section.
    """

    bending_s: Float[Array, " knots"]
    bending: Float[Array, " knots"]
    bending_y: Float[Array, " knots"] | None = None
    torsion_s: Float[Array, " twists"] | None = None
    torsion: Float[Array, " twists"] | None = None

    def at(self, s: Float[Array, " N"], poissons_ratio: Float[Array, ""]) -> list[Float[Array, " N"]]:
        """GJ, EI_y, EI_z [N m^2] at s; GJ of a round section is EI/(1 + nu)."""
        EI_z = along_body(s, self.bending_s, self.bending)
        EI_y = EI_z if self.bending_y is None else along_body(s, self.bending_s, self.bending_y)
        if self.torsion is None or self.torsion_s is None:
            return [EI_z / (1 + poissons_ratio), EI_y, EI_z]
        return [along_body(s, self.torsion_s, self.torsion), EI_y, EI_z]


class Piece(eqx.Module):
    """A piece of the body that differs from the rest of it; what is None is as there.

    Attributes:
        start, end: arc lengths [m].
        outer_radius: at its start and its end [m], (2,), linear between.
        youngs_modulus: E [Pa].
        stiffness: given instead of modulus and radius.
    """

    start: Float[Array, ""]
    end: Float[Array, ""]
    outer_radius: Float[Array, "2"] | None = None
    youngs_modulus: Float[Array, ""] | None = None
    stiffness: Stiffness | None = None


class Backbone(eqx.Module):
    """Round rod with a linear taper and concentric bores; its pieces may differ.

    Attributes:
        length: L [m].
        outer_radius: radius at the base and at the tip [m], shape (2,); linear between.
        bore_start, bore_end, bore_diameter: concentric bores [m], shape (bores,).
        youngs_modulus: E [Pa].
        density: mass density [kg/m^3].
        natural_curvature_s, natural_curvature: knots of the stress-free curvature in the plane of the robot,
            about z [m], [1/m], shape (knots,); linear between knots, constant outside them. One knot is a
            constant curvature.
        rigid: True for a sheath of fixed shape: the curvature is the natural one whatever the load.
        poissons_ratio: nu of the round section, G = E/(2 (1 + nu)); no effect in the plane.
        natural_curvature_y_s, natural_curvature_y: likewise about y, out of the plane; None: zero.
        natural_twist_s, natural_twist: likewise, twist about the axis; None: zero.
        stiffness: of the whole body, given instead of modulus and radius.
        stiffness_factor: on every stiffness that a modulus, `stiffness` or `pieces` give; None: 1.
        pieces: of the body that differ; they do not overlap.
        notches: rows of notches, which do not overlap.
        extensible: whether forces along the body stretch it (static).
        axial_stiffness: EA [N], given instead of modulus and section; None: of those.
        shape: of the section that carries the load, the same all along; None: all within the outer radius.
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
    poissons_ratio: Float[Array, ""] = eqx.field(default_factory=lambda: jnp.asarray(POISSONS_RATIO))
    natural_curvature_y_s: Float[Array, " up"] | None = None
    natural_curvature_y: Float[Array, " up"] | None = None
    natural_twist_s: Float[Array, " twists"] | None = None
    natural_twist: Float[Array, " twists"] | None = None
    stiffness: Stiffness | None = None
    stiffness_factor: Float[Array, ""] | None = None
    pieces: tuple[Piece, ...] = ()
    notches: tuple[Notches, ...] = ()
    extensible: bool = eqx.field(static=True, default=False)
    axial_stiffness: Float[Array, ""] | None = None
    shape: Tube | Rectangle | None = None

    @property
    def notch_start(self) -> Float[Array, " notches"]:
        """Arc lengths [m] where the notches begin."""
        return jnp.concatenate([row.ends[0] for row in self.notches] or [jnp.zeros(0)])

    @property
    def notch_end(self) -> Float[Array, " notches"]:
        """Arc lengths [m] where the notches end."""
        return jnp.concatenate([row.ends[1] for row in self.notches] or [jnp.zeros(0)])

    def cut(self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]) -> Cut | None:
        """What the notches make of the body; None without any. `within` is as of `stiffnesses`."""
        if not self.notches:
            return None
        inner = jnp.max(self._bore_radii(within), axis=0, initial=0.0)
        notched = within[self.bore_start.shape[0] + len(self.pieces) :]
        return cut(self.notches, notched, self.radius(s, within), inner)

    def reach(self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]) -> Float[Array, " N"]:
        """Distance of the outermost fibre from the neutral line [m] at s; `within` as of `stiffnesses`."""
        if self.shape is not None:
            return jnp.broadcast_to(self.shape.reach(), s.shape)
        radius, cut = self.radius(s, within), self.cut(s, within)
        return radius if cut is None else jnp.where(cut.within, cut.section.reach, radius)

    @property
    def piece_start(self) -> Sequence[Float[Array, ""]]:
        """Arc lengths [m] where the pieces start."""
        return [piece.start for piece in self.pieces]

    @property
    def piece_end(self) -> Sequence[Float[Array, ""]]:
        """Arc lengths [m] where the pieces end."""
        return [piece.end for piece in self.pieces]

    @property
    def stretches(self) -> tuple[Float[Array, " stretches"], Float[Array, " stretches"]]:
        """Arc lengths [m] where the bores, then the pieces, then the notches, start and end."""
        starts = [*self.bore_start, *self.piece_start, *self.notch_start]
        ends = [*self.bore_end, *self.piece_end, *self.notch_end]
        return jnp.stack(starts) if starts else jnp.zeros(0), jnp.stack(ends) if ends else jnp.zeros(0)

    def kinks(self) -> Sequence[Float[Array, " kinks"]]:
        """Arc lengths [m] where natural strain or stiffness has a knot inside the body."""
        knots = [self.natural_curvature_s, self.natural_curvature_y_s, self.natural_twist_s]
        if self.stiffness is not None:
            knots.append(self.stiffness.bending_s)
            knots.append(self.stiffness.torsion_s)
        return [s[1:-1] for s in knots if s is not None and s.shape[0] > 2]

    def radius(
        self, s: Float[Array, " N"], within: Bool[Array, "stretches N"] | None = None
    ) -> Float[Array, " N"]:
        """Outer radius [m] at s; `within` is as of `stiffnesses`, by arc length unless given."""
        out = self.outer_radius[0] + (self.outer_radius[1] - self.outer_radius[0]) * s / self.length
        for i, piece in enumerate(self.pieces):
            if piece.outer_radius is not None:
                here = (piece.start <= s) & (s < piece.end) if within is None else self._in_piece(i, within)
                first, last = piece.outer_radius
                part = (s - piece.start) / (piece.end - piece.start)
                out = jnp.where(here, first + (last - first) * part, out)
        return out

    def _in_piece(self, index: int, within: Bool[Array, "stretches N"]) -> Bool[Array, " N"]:
        return within[self.bore_start.shape[0] + index]

    def _bore_radii(self, within: Bool[Array, "stretches N"]) -> Float[Array, "bores N"]:
        bored = within[: self.bore_start.shape[0]]
        return jnp.where(bored, 0.5 * self.bore_diameter[:, None], 0.0)

    def area(self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]) -> Float[Array, " N"]:
        """Cross-section area [m^2] at s; `within` is as of `stiffnesses`."""
        if self.shape is not None:
            return jnp.broadcast_to(self.shape.area(), s.shape)
        radii = self._bore_radii(within)
        whole = jnp.pi * (self.radius(s, within) ** 2 - jnp.sum(radii**2, axis=0))
        cut = self.cut(s, within)
        return whole if cut is None else jnp.where(cut.within, cut.section.area, whole)

    def stiffnesses(
        self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]
    ) -> list[Float[Array, " N"]]:
        """GJ, EI_y, EI_z [N m^2] at s; a round section has GJ = EI/(1 + nu).

        Args:
            s: arc length [m], (N,).
            within: which bores, then which pieces and which notches, each node lies in, (bores + pieces +
                notches, N).
        """
        if self.stiffness is not None:
            found = self.stiffness.at(s, self.poissons_ratio)
        else:
            found = self._by_section(s, within, self.youngs_modulus)
        for i, piece in enumerate(self.pieces):
            if piece.stiffness is not None:
                own = piece.stiffness.at(s, self.poissons_ratio)
            elif piece.youngs_modulus is not None or piece.outer_radius is not None:
                modulus = self.youngs_modulus if piece.youngs_modulus is None else piece.youngs_modulus
                own = self._by_section(s, within, modulus)
            else:
                continue
            here = self._in_piece(i, within)
            found = [jnp.where(here, new, old) for new, old in zip(own, found, strict=True)]
        if self.stiffness_factor is not None:
            found = [self.stiffness_factor * value for value in found]
        cut = self.cut(s, within)
        if cut is None:
            return found
        # A body with notches stays in its plane: only its bending there is used.
        left = self._modulus(s, within) * cut.section.second
        return [jnp.where(cut.within, left, old) for old in found]

    def closed_stiffness(
        self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]
    ) -> Float[Array, " N"]:
        """How many times as stiff as open a closed notch is, less one: as stiff as the tube; `within` as of
        `stiffnesses`.
        """
        cut = self.cut(s, within)
        assert cut is not None
        tube = self._round(s, within, jnp.ones(()))[2]
        return jnp.where(cut.within, tube / cut.section.second - 1.0, 0.0)

    def second_moments(
        self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]
    ) -> list[Float[Array, " N"]]:
        """Second moments of area about y and about z [m^4] of the section without notches; `within` as of
        `stiffnesses`.
        """
        return self._by_section(s, within, jnp.ones(()))[1:]

    def _by_section(
        self, s: Float[Array, " N"], within: Bool[Array, "stretches N"], modulus: Float[Array, ""]
    ) -> list[Float[Array, " N"]]:
        """GJ, EI_y, EI_z [N m^2] at s, of a modulus and the section."""
        if self.shape is None:
            return self._round(s, within, modulus)
        return [jnp.broadcast_to(modulus * v, s.shape) for v in self.shape.stiffnesses(self.poissons_ratio)]

    def _round(
        self, s: Float[Array, " N"], within: Bool[Array, "stretches N"], modulus: Float[Array, ""]
    ) -> list[Float[Array, " N"]]:
        radii = self._bore_radii(within)
        EI = modulus * jnp.pi / 4 * (self.radius(s, within) ** 4 - jnp.sum(radii**4, axis=0))
        return [EI / (1 + self.poissons_ratio), EI, EI]

    def compliance(self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]) -> Float[Array, " N"]:
        """1/EI_z [1/(N m^2)], of bending in the plane of the robot; 0 for a rigid sheath."""
        if self.rigid:
            return jnp.zeros_like(s)
        return 1.0 / self.stiffnesses(s, within)[2]

    def compliances(
        self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]
    ) -> Float[Array, "N strains"]:
        """1/GJ, 1/EI_y, 1/EI_z [1/(N m^2)] at s, and of a body that stretches 1/EA [1/N]; 0 for a rigid
        sheath.
        """
        if self.rigid:
            return jnp.zeros((s.shape[0], 3))
        along = [self._axial(s, within)] if self.extensible else []
        return 1.0 / jnp.stack([*self.stiffnesses(s, within), *along], axis=-1)

    def _axial(self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]) -> Float[Array, " N"]:
        """EA [N] at s."""
        if self.axial_stiffness is not None:
            return jnp.broadcast_to(self.axial_stiffness, s.shape)
        return self._modulus(s, within) * self.area(s, within)

    def _modulus(self, s: Float[Array, " N"], within: Bool[Array, "stretches N"]) -> Float[Array, " N"]:
        """E [Pa] at s, with the factor on it."""
        modulus = jnp.broadcast_to(self.youngs_modulus, s.shape)
        for i, piece in enumerate(self.pieces):
            if piece.youngs_modulus is not None:
                modulus = jnp.where(self._in_piece(i, within), piece.youngs_modulus, modulus)
        return modulus if self.stiffness_factor is None else self.stiffness_factor * modulus

    def curvature_at_rest(self, s: Float[Array, " N"]) -> Float[Array, " N"]:
        """Natural curvature kappa_0 [1/m] at s, in the plane of the robot."""
        return along_body(s, self.natural_curvature_s, self.natural_curvature)

    def strain_at_rest(self, s: Float[Array, " N"]) -> Float[Array, "N strains"]:
        """The strain of the unloaded body at s: natural twist and curvatures about y and z [1/m], and the
        stretch of one that stretches, 0.
        """
        twist = along_body(s, self.natural_twist_s, self.natural_twist)
        up = along_body(s, self.natural_curvature_y_s, self.natural_curvature_y)
        along = [jnp.zeros_like(s)] if self.extensible else []
        return jnp.stack([twist, up, self.curvature_at_rest(s), *along], axis=-1)
