"""The equilibrium of rod and tendon as one residual, local in the nodes.

Unknowns at each node: curvature, angle, tension, external moment. Each residual ties a node to its predecessors only, but
for one: the external moment is known at the tip and carried from the base. So the Jacobian is causal with one bordered column
(the external moment at the base), and a linear solve is one forward recursion with two right-hand sides (`linear_solver.py`).
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
        force_x, force_y: external force distal to the node [N], (N,): tip force plus the weight of the distal part.
    """

    mesh: Mesh
    R: Offset
    compliance: Float[Array, " N"]
    rest: Float[Array, " N"]
    force_x: Float[Array, " N"]
    force_y: Float[Array, " N"]


class State(eqx.Module):
    """Unknowns of the equilibrium, each of shape (N,), SI: curvature, midline angle, tendon tension, external moment."""

    kappa: Float[Array, " N"]
    phi: Float[Array, " N"]
    tension: Float[Array, " N"]
    moment: Float[Array, " N"]


class Problem(eqx.Module):
    """One equilibrium: the robot at its nodes, the load, and the tension the tendon had before.

    Attributes:
        sections: the robot at the nodes.
        mu: friction coefficient [-].
        T_base: tension at the base [N].
        memory: tension at the nodes after the previous load step [N], (N,).
        tip_moment: external moment at the tip [N m].
        loaded: False (static) where no external force acts, so that the external moment is the tip moment everywhere.
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


def residual(y: State, p: Problem) -> State:
    """Residual of the equilibrium; zero at the solution. Rows: moment balance, angle, friction law, external moment.

    The moment balance is the local identity EI (kappa - kappa_0) = T R (1 - R kappa)/nu + M_ext, divided by EI. Row 0 of the
    external moment is the boundary condition at the tip, M_ext(L) = tip moment.
    """
    s = p.sections
    bending = s.compliance * (y.tension * channel.moment_arm(y.kappa, s.R) + y.moment)
    turn = y.phi - shifted(y.phi)
    wrap = channel.wrap_increment(turn, y.kappa, shifted(y.kappa), s.R, offset_before(s.R), s.mesh.interval)
    tension = friction.transmit(shifted(y.tension, 1, p.T_base), wrap, p.memory, p.mu)
    if p.loaded:
        step = increments(s.mesh.weights, moment_slope(y.phi, s.force_x, s.force_y))
        moment = y.moment - shifted(y.moment) - step
        moment = moment.at[0].set(y.moment[-1] - p.tip_moment)
    else:
        moment = y.moment - p.tip_moment
    return State(
        kappa=y.kappa - s.rest - bending,
        phi=turn - increments(s.mesh.weights, y.kappa),
        tension=y.tension - tension,
        moment=moment,
    )


def residual_norm(r: State, p: Problem) -> Float[Array, ""]:
    """Largest residual, made dimensionless: radians for kappa L and phi, share of the largest tension, moment as kappa L.

    NaN stays NaN.
    """
    length = p.sections.mesh.s[-1]
    force = jnp.maximum(jnp.maximum(p.T_base, jnp.max(p.memory)), 1e-6)
    terms = (
        r.kappa * length,
        r.phi,
        r.tension / force,
        r.moment * p.sections.compliance * length,
    )
    return jnp.max(jnp.stack([jnp.max(jnp.abs(t)) for t in terms]))
