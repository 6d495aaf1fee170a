"""One pull of one tendon as a single residual of all nodes, which root finders of any kind can solve.

Unknowns at each node: curvature, angle, wrap, external moment; the tension follows from the wrap. Each
residual ties a node to its predecessors only, with one exception: the external moment is known at the tip but
integrated from the base.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from gtr_jax.mechanics import channel
from gtr_jax.mechanics.mesh import increments, shifted
from gtr_jax.mechanics.sections import Sections, State, largest, moment_slope
from gtr_jax.robot.robot import Robot, sections


class Pull(eqx.Module):
    """One load step of a tendon in the plane.

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

    @classmethod
    def of(cls, robot: Robot, T_base: Float[Array, ""]) -> Pull:
        """One pull of a robot from a slack tendon."""
        s = sections(robot)
        mu = robot.per_tendon(lambda tendon: tendon.friction_coefficient)
        return cls(s, mu, T_base, jnp.zeros_like(s.rest), robot.loads.tip_moment, robot.loaded)


def tension(T_base, wrap, memory, mu):
    """Tension [N] along the tendon: the previous tension, clipped to what friction can hold against the base,
    T_base exp(-mu wrap) to T_base exp(mu wrap).
    """
    grip = jnp.exp(mu * wrap)
    pulled, released = T_base / grip, T_base * grip
    return jnp.where(memory <= pulled, pulled, jnp.where(memory >= released, released, memory))


def tension_of(y: State, p: Pull) -> Float[Array, " N"]:
    """Tension at the nodes [N], (N,)."""
    return tension(p.T_base, y.wrap, p.memory, p.mu)


def residual(y: State, p: Pull) -> State:
    """Residual of the equilibrium; zero at the solution. Rows: moment balance, angle, wrap, external moment.

    The moment balance is the local identity EI (kappa - kappa_0) = T R (1 - R kappa)/nu + M_ext, divided by
    EI. Row 0 of the external moment is the boundary condition at the tip, M_ext(L) = tip moment.
    """
    s = p.sections
    turn = y.phi - shifted(y.phi)
    bending = s.compliance * (tension_of(y, p) * channel.moment_arm(y.kappa, s.R) + y.moment)
    wrap = channel.wrap_increment(turn, y.kappa, shifted(y.kappa), s.R, s.R.before(), s.mesh.interval)
    if p.loaded:
        step = increments(s.mesh.weights, moment_slope(y.phi, *s.force))
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


def residual_norm(r: State, p: Pull) -> Float[Array, ""]:
    """Largest residual, made dimensionless: radians for kappa L, phi and wrap; the moment as kappa L.

    NaN if anything is not finite.
    """
    length = p.sections.mesh.s[-1]
    terms = (r.kappa * length, r.phi, r.wrap, r.moment * p.sections.compliance * length)
    return largest(jnp.concatenate(terms))
