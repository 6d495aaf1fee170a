"""What the tendon does to its channel: line pressure and friction along it, from one equilibrium."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .equilibrium import Equilibrium


class ChannelForces(eqx.Module):
    """Forces between tendon and channel, on the M = N-1 intervals between the nodes, base to tip.

    Attributes:
        s: arc length of the interval's middle [m], (M,).
        normal: f_n = T kappa_c, per length of tendon [N/m], (M,), with kappa_c = |dpsi/ds| / nu.
        friction: f_f = -dT/ds_c, per length of tendon [N/m], (M,). It is mu f_n where the tendon slips
            towards the base, -mu f_n where it slips towards the tip, and anything between where it is locked.
        length: length of tendon in the interval [m], (M,); 0 between the two nodes of a panel boundary.
        kink_normal: force at a kink of the channel [N], (M,); 0 but on intervals of no length, which have no
            density.
    """

    s: Float[Array, " M"]
    normal: Float[Array, " M"]
    friction: Float[Array, " M"]
    length: Float[Array, " M"]
    kink_normal: Float[Array, " M"]


@eqx.filter_jit
def channel_forces(eq: Equilibrium) -> ChannelForces:
    """Normal force and friction of the tendon on its channel, of second order in the mesh.

    Args:
        eq: one equilibrium.

    Returns:
        The forces; those of an equilibrium that did not converge are as wrong as it is.
    """
    length = jnp.diff(eq.s) * 0.5 * (eq.metric[1:] + eq.metric[:-1])
    per_length = jnp.where(length > 0, 1.0 / jnp.where(length > 0, length, 1.0), 0.0)
    turned = 0.5 * (eq.tension[1:] + eq.tension[:-1]) * jnp.diff(eq.wrap)
    return ChannelForces(
        s=0.5 * (eq.s[1:] + eq.s[:-1]),
        normal=turned * per_length,
        friction=-jnp.diff(eq.tension) * per_length,
        length=length,
        kink_normal=jnp.where(length > 0, 0.0, turned),
    )
