"""The equilibrium of rod and tendon as one residual, local in the nodes.

Unknowns at each node: curvature, angle, wrap of the tendon, external moment; the tension follows from the
    wrap. Each residual ties a node to its predecessors only, but
for one: the external moment is known at the tip and carried from the base. So the Jacobian is causal with one
    bordered column (the external moment at the base), and a linear solve is one forward recursion with two
    right-hand sides (`linear_solver.py`).
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import channel, friction
from .mesh import Mesh, increments, shifted
from .routing import Offset


class Sections(eqx.Module):
    """What the mechanics needs to know of the robot, at the nodes.

    Attributes:
        mesh: nodes and quadrature weights.
        R: channel offset and derivatives, each (N,).
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
    """Unknowns at the nodes, (N,), or at one: curvature, midline angle, wrap of the tendon, external
    moment.
    """

    kappa: Float[Array, "*nodes"]
    phi: Float[Array, "*nodes"]
    wrap: Float[Array, "*nodes"]
    moment: Float[Array, "*nodes"]


class Problem(eqx.Module):
    """One equilibrium: the robot at its nodes, the load, and the tension the tendon had before.

    Attributes:
        sections: the robot at the nodes.
        mu: friction coefficient [-].
        T_base: tension at the base [N].
        memory: tension at the nodes after the previous load step [N], (N,).
        tip_moment: external moment at the tip [N m].
        loaded: False (static) where no external force acts, so that the external moment is the tip moment
            everywhere.
    """

    sections: Sections
    mu: Float[Array, ""]
    T_base: Float[Array, ""]
    memory: Float[Array, " N"]
    tip_moment: Float[Array, ""]
    loaded: bool = eqx.field(static=True)


def offset_before(R: Offset) -> Offset:
    """Channel offset at each node's predecessor; the base stands for itself."""
    return Offset(*(shifted(r, 1, r[0]) for r in R))


def moment_slope(phi, force_x, force_y):
    """M_ext' = -(t x n_ext) [N], for the rod direction phi and the distal external force."""
    return force_x * jnp.sin(phi) - force_y * jnp.cos(phi)


def tension_of(y: State, p: Problem) -> Float[Array, " N"]:
    """Tension along the tendon [N], (N,)."""
    return friction.tension(p.T_base, y.wrap, p.memory, p.mu)


def residual(y: State, p: Problem) -> State:
    """Residual of the equilibrium; zero at the solution. Rows: moment balance, angle, wrap, external moment.

    The moment balance is the local identity EI (kappa - kappa_0) = T R (1 - R kappa)/nu + M_ext, divided by
    EI. Row 0 of the external moment is the boundary condition at the tip, M_ext(L) = tip moment.
    """
    s = p.sections
    bending = s.compliance * (tension_of(y, p) * channel.moment_arm(y.kappa, s.R) + y.moment)
    turn = y.phi - shifted(y.phi)
    wrap = channel.wrap_increment(turn, y.kappa, shifted(y.kappa), s.R, offset_before(s.R), s.mesh.interval)
    if p.loaded:
        step = increments(s.mesh.weights, moment_slope(y.phi, s.force_x, s.force_y))
        moment = y.moment - shifted(y.moment) - step
        moment = moment.at[0].set(y.moment[-1] - p.tip_moment)
    else:
        moment = y.moment - p.tip_moment
    return State(
        kappa=y.kappa - s.rest - bending,
        phi=turn - increments(s.mesh.weights, y.kappa),
        wrap=y.wrap - shifted(y.wrap) - wrap,
        moment=moment,
    )


def residual_norm(r: State, p: Problem) -> Float[Array, ""]:
    """Largest residual, made dimensionless: radians for kappa L, phi and wrap; the moment as kappa L.

    NaN if anything is not finite.
    """
    length = p.sections.mesh.s[-1]
    terms = (
        r.kappa * length,
        r.phi,
        r.wrap,
        r.moment * p.sections.compliance * length,
    )
    return largest(jnp.concatenate(terms))


def largest(values: Float[Array, " N"]) -> Float[Array, ""]:
    """Largest magnitude; NaN if any is not finite (XLA's batched maximum on the CPU would drop it)."""
    return jnp.where(jnp.all(jnp.isfinite(values)), jnp.max(jnp.abs(values)), jnp.nan)
