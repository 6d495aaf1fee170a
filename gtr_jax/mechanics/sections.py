"""The robot at its nodes, its state there, and what tendons and midline share.

Tendons act on one another only through the strain they share. Quantities of a tendon have a leading tendon
axis where the robot has several tendons, and none where it has one: `*tendons` in shapes. The strain of a
robot in space has a last axis of three: `*strain` in shapes.
"""

from __future__ import annotations

from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float

from .guides import Guides
from .mesh import Mesh
from .offset import Offset

Tree = TypeVar("Tree")


class Closing(eqx.Module):
    """Where the body may bend only so far because it is notched.

    Attributes:
        side: towards which a notch closes, 1.0 or -1.0, (N,); 0.0 where there is none.
        limit: curvature towards that side at which it is closed [1/m], (N,).
        stiffness: of the closed notch over that of the open one, less one, (N,).
    """

    side: Float[Array, " N"]
    limit: Float[Array, " N"]
    stiffness: Float[Array, " N"]

    def moment(self, kappa: Float[Array, "*nodes"]) -> Float[Array, "*nodes"]:
        """Moment of closed notches over the EI of open ones [1/m]."""
        beyond = self.side * kappa - self.limit
        return self.side * self.stiffness * jnp.where(beyond > 0, beyond, 0.0)

    def settled(self, kappa: Float[Array, " N"]) -> Float[Array, " N"]:
        """Curvature under a moment [1/m], from what it were if no notch closed."""
        beyond = self.side * kappa - self.limit
        held = self.side * (self.limit + beyond / (1.0 + self.stiffness))
        return jnp.where(beyond > 0, held, kappa)

    def stopped(self, before: Float[Array, ""], after: Float[Array, ""]) -> Float[Array, ""]:
        """Where a step of a search for the curvature ends: just beyond the limit if it would pass that. Far
        beyond it the body would fold over, and the tendon bend it back.
        """
        passes = (self.side * before < self.limit) & (self.side * after > self.limit)
        return jnp.where(passes, self.side * self.limit * (1.0 + 1e-9), after)


class Sections(eqx.Module):
    """What the mechanics needs to know of the robot, at the nodes.

    Attributes:
        mesh: nodes and quadrature weights.
        R: channel offset and derivatives, an `Offset`, each (*tendons, N); in space a `SpatialOffset`, each
            (*tendons, N, 2).
        compliance: 1/EI [1/(N m^2)], (N,); in space of twist and of the two bendings, (N, 3); 0 where rigid.
        rest: natural curvature [1/m], (N,); in space natural strain, (N, 3).
        force: external force distal to the node [N], its two or three components (N,) each: tip force plus
            the weight of the distal part.
        beyond: which nodes lie past the anchor of a tendon, (*tendons, N), where its offset is zero, so that
            it does nothing; None if all end at the tip.
        guides: those of the tendons; None if all run in channels.
        reach: distance of the outermost fibre from the neutral line [m], (N,).
        shift: how far the axis lies to the left of the neutral line [m], (N,); offsets R are from the neutral
            line. None where the two are one.
        closing: of notches; None without any.
    """

    mesh: Mesh
    R: Any
    compliance: Float[Array, "N *strain"]
    rest: Float[Array, "N *strain"]
    force: tuple[Float[Array, " N"], ...]
    beyond: Bool[Array, "*tendons N"] | None = None
    guides: Guides | None = None
    reach: Float[Array, " N"] | None = None
    shift: Float[Array, " N"] | None = None
    closing: Closing | None = None

    def to_anchor(self, values: Float[Array, "*tendons N"]) -> Float[Array, "*tendons N"]:
        """Values along the tendons, past an anchor those at the anchor."""
        if self.beyond is None:
            return values
        after = jnp.concatenate([self.beyond[..., 1:], jnp.ones_like(self.beyond[..., :1])], axis=-1)
        last = ~self.beyond & after
        there = jnp.sum(jnp.where(last, values, 0.0), axis=-1, keepdims=True)
        return jnp.where(self.beyond, there, values)

    def ended(self, values: Float[Array, "*tendons N"]) -> Float[Array, "*tendons N"]:
        """Values along the tendons, past an anchor zero."""
        return values if self.beyond is None else jnp.where(self.beyond, 0.0, values)


class State(eqx.Module):
    """Unknowns at the nodes, (N,), or at one: curvature, midline angle, wrap of each tendon, external
    moment. In space: strain (N, 3), rotation of the section (N, 3, 3), wrap, external moment (N, 3) in the
    axes of the base.
    """

    kappa: Float[Array, "*nodes_strain"]
    phi: Float[Array, "*nodes_frame"]
    wrap: Float[Array, "*tendons_nodes"]
    moment: Float[Array, "*nodes_moment"]


def at_tendons(tree: Tree, R: Offset) -> Tree:
    """Quantities of the midline, broadcast to the shape of the channel offsets."""
    return jtu.tree_map(lambda v: jnp.broadcast_to(v, R.value.shape), tree)


def over_tendons(values: Float[Array, "*any"], axes: int) -> Float[Array, "*midline"]:
    """Sum over the tendons of an array that has `axes` axes besides the tendon axis."""
    return values if values.ndim == axes else jnp.sum(values, axis=0)


def moment_slope(phi, force_x, force_y):
    """M_ext' = -(t x n_ext) [N] in the plane, for the rod direction phi and the distal external force."""
    return force_x * jnp.sin(phi) - force_y * jnp.cos(phi)


def node_first(tree):
    """Arrays (*tendons, N) as the rows of a scan along the nodes, (N, *tendons)."""
    return jtu.tree_map(lambda v: jnp.moveaxis(v, -1, 0), tree)


def either_of(holds: Bool[Array, ""] | bool, this: Tree, that: Tree) -> Tree:
    """`this` where something holds, else `that`, leaf by leaf."""
    return jtu.tree_map(lambda a, b: jnp.where(holds, a, b), this, that)


def largest(values: Float[Array, "..."]) -> Float[Array, ""]:
    """Largest magnitude; NaN if any is not finite (XLA's batched maximum on the CPU would drop it)."""
    return jnp.where(jnp.all(jnp.isfinite(values)), jnp.max(jnp.abs(values)), jnp.nan)
