"""The equilibrium of rod and tendon as one residual, local in the nodes.

Unknowns at each node: curvature, angle, wrap of each tendon, external moment; the tension follows from the
wrap. Each residual ties a node to its predecessors only, with one exception: the external moment is known at
the tip but integrated from the base. So the Jacobian is causal with one bordered column (the external moment
at the base), and a linear solve is one forward recursion with two right-hand sides (`linear_solver.py`).

Tendons act on one another only through the curvature they share. Quantities of a tendon have a leading tendon
axis where the robot has several tendons, and none where it has one: `*tendons` in shapes.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import channel
from ..mesh import increments, shifted
from ..sections import Sections, State, at_tendons, largest, moment_slope, over_tendons
from . import friction


class Problem(eqx.Module):
    """One equilibrium: the robot at its nodes, the load, and the tension each tendon had before.

    Attributes:
        sections: the robot at the nodes.
        mu: friction coefficient [-], (*tendons,).
        T_base: tension at the base [N], (*tendons,).
        memory: tension at the nodes after the previous load step [N], (*tendons, N). If given, the wrap of
            the state is the total turning, and the tension follows `friction.tension`.
        mobilisation: of friction between each node and the one before it, in [-1, 1], (*tendons, N), instead
            of `memory`. If given, the wrap of the state is the turning weighted by the mobilisation
            (`friction.mobilised_tension`).
        tip_moment: external moment at the tip [N m].
        loaded: False (static) where no external force acts, so that the external moment is the tip moment
            everywhere.
    """

    sections: Sections
    mu: Float[Array, "*tendons"]
    T_base: Float[Array, "*tendons"]
    memory: Float[Array, "*tendons N"] | None
    mobilisation: Float[Array, "*tendons N"] | None
    tip_moment: Float[Array, ""]
    loaded: bool = eqx.field(static=True)


def tension_of(y: State, p: Problem) -> Float[Array, "*tendons N"]:
    """Tension along the tendons [N], (*tendons, N)."""
    return tension_at(p.T_base[..., None], y.wrap, p.memory, p.mu[..., None])


def tension_at(T_base, wrap, memory, mu):
    """Tension from the wrap of the state, by whichever law the problem follows."""
    if memory is None:
        return friction.mobilised_tension(T_base, wrap, mu)
    return friction.tension(T_base, wrap, memory, mu)


def mobilised(increment, mobilisation):
    """Increment of the state's wrap from that of the turning."""
    return increment if mobilisation is None else increment * mobilisation


def residual(y: State, p: Problem) -> State:
    """Residual of the equilibrium; zero at the solution. Rows: moment balance, angle, wrap, external moment.

    The moment balance is the local identity EI (kappa - kappa_0) = sum T R (1 - R kappa)/nu + M_ext, divided
    by EI. Row 0 of the external moment is the boundary condition at the tip, M_ext(L) = tip moment.
    """
    s = p.sections
    turn = y.phi - shifted(y.phi)
    midline = (turn, y.kappa, shifted(y.kappa), s.mesh.interval)
    turns, kappa, kappa_before, between = at_tendons(midline, s.R)
    pulled = over_tendons(tension_of(y, p) * channel.moment_arm(kappa, s.R), 1)
    bending = s.compliance * (pulled + y.moment)
    wrap = channel.wrap_increment(turns, kappa, kappa_before, s.R, s.R.before(), between)
    if p.loaded:
        step = increments(s.mesh.weights, moment_slope(y.phi, *s.force))
        moment = y.moment - shifted(y.moment) - step
        moment = moment.at[0].set(y.moment[-1] - p.tip_moment)
    else:
        moment = y.moment - p.tip_moment
    return State(
        kappa=y.kappa - s.rest - bending,
        phi=turn - increments(s.mesh.weights, y.kappa),
        wrap=y.wrap - shifted(y.wrap) - mobilised(wrap, p.mobilisation),
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
        r.wrap.ravel(),
        r.moment * p.sections.compliance * length,
    )
    return largest(jnp.concatenate(terms))
