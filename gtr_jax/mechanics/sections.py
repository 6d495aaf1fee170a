"""The robot at its nodes, its state there, and what tendons and midline share.

Tendons act on one another only through the curvature they share. Quantities of a tendon have a leading tendon
axis where the robot has several tendons, and none where it has one: `*tendons` in shapes.
"""

from __future__ import annotations

from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float

from .mesh import Mesh, shifted
from .offset import Offset

Tree = TypeVar("Tree")


class Sections(eqx.Module):
    """What the mechanics needs to know of the robot, at the nodes.

    Attributes:
        mesh: nodes and quadrature weights.
        R: channel offset and derivatives, each (*tendons, N).
        compliance: 1/EI [1/(N m^2)], (N,); 0 where rigid.
        rest: natural curvature [1/m], (N,).
        force_x, force_y: external force distal to the node [N], (N,): tip force plus the weight of the distal
            part.
    """

    mesh: Mesh
    R: Offset
    compliance: Float[Array, " N"]
    rest: Float[Array, " N"]
    force_x: Float[Array, " N"]
    force_y: Float[Array, " N"]


class State(eqx.Module):
    """Unknowns at the nodes, (N,), or at one: curvature, midline angle, wrap of each tendon, external
    moment.
    """

    kappa: Float[Array, "*nodes"]
    phi: Float[Array, "*nodes"]
    wrap: Float[Array, "*tendons_nodes"]
    moment: Float[Array, "*nodes"]


def offset_before(R: Offset) -> Offset:
    """Channel offset at each node's predecessor; at the base its own."""
    return Offset(*(shifted(r, 1, r[..., :1]) for r in R))


def at_tendons(tree: Tree, R: Offset) -> Tree:
    """Quantities of the midline, broadcast to the shape of the channel offsets."""
    return jtu.tree_map(lambda v: jnp.broadcast_to(v, R.value.shape), tree)


def over_tendons(values: Float[Array, "*any"], axes: int) -> Float[Array, "*midline"]:
    """Sum over the tendons of an array that has `axes` axes besides the tendon axis."""
    return values if values.ndim == axes else jnp.sum(values, axis=0)


def moment_slope(phi, force_x, force_y):
    """M_ext' = -(t x n_ext) [N], for the rod direction phi and the distal external force."""
    return force_x * jnp.sin(phi) - force_y * jnp.cos(phi)


def node_first(tree):
    """Arrays (*tendons, N) as the rows of a scan along the nodes, (N, *tendons)."""
    return jtu.tree_map(lambda v: jnp.moveaxis(v, -1, 0), tree)


def either_of(holds: Bool[Array, ""], this: Tree, that: Tree) -> Tree:
    """`this` where something holds, else `that`, leaf by leaf."""
    return jtu.tree_map(lambda a, b: jnp.where(holds, a, b), this, that)


def largest(values: Float[Array, " N"]) -> Float[Array, ""]:
    """Largest magnitude; NaN if any is not finite (XLA's batched maximum on the CPU would drop it)."""
    return jnp.where(jnp.all(jnp.isfinite(values)), jnp.max(jnp.abs(values)), jnp.nan)
