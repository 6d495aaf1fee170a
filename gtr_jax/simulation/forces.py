"""What the tendon does to its channel: the distributed forces of eqs. (12)-(14), from one equilibrium.

The paper writes both as f = P F_tl T_base (eq. 14): the base tension, the share F_tl of it that friction
leaves, and a factor P that projects tension onto the channel's normal or tangent. Here they are evaluated
between the nodes, so that every newton lost along the tendon is accounted for, in any history: where friction
is not exhausted, the tangential factor is the one that holds the tendon.
"""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .solution import Equilibrium


class ChannelForces(eqx.Module):
    """Forces between tendon and channel, on the M = N-1 intervals between the nodes, base to tip.

    On the body they act, per length of tendon, as the vector  turn * normal * n - friction * t  with t =
    (cos angle, sin angle) and n to its left: the tendon presses to the side it turns to and, slipping towards
    the base, drags the channel along. `normal = normal_projection * tension_loss_factor * T_base` and
    `friction = friction_projection * tension_loss_factor * T_base` (eq. 14).

    Attributes:
        s: arc length of the interval's middle [m], (M,).
        angle: psi of the tendon's tangent from the x axis [rad], (M,).
        turn: sense in which the tendon turns, +1 left, -1 right, 0 straight, (M,).
        tension_loss_factor: F_tl = T/T_base, the share of the base tension that arrives, (M,); above 1 where
            the tendon is tighter than at the base, 0 if the tendon is slack. exp(-mu wrap) while pulling.
        normal_projection: P_n = kappa_c = |dpsi/ds_c|, the curvature of the tendon [1/m], (M,).
        friction_projection: P_f [1/m], (M,): mu kappa_c where the tendon slips towards the base, -mu kappa_c
            where it slips towards the tip, anything between where it is locked; 0 if the tendon is slack.
        normal: f_n = T kappa_c, per length of tendon [N/m], (M,).
        friction: f_f = -dT/ds_c, per length of tendon [N/m], (M,), with the sign of `friction_projection`.
        length: length of tendon in the interval [m], (M,); 0 between the two nodes of a panel boundary.
        kink_normal, kink_friction: normal force and friction at a kink of the channel [N], (M,); 0 except on
            intervals of zero length, where forces per length are not defined.
    """

    s: Float[Array, " M"]
    angle: Float[Array, " M"]
    turn: Float[Array, " M"]
    tension_loss_factor: Float[Array, " M"]
    normal_projection: Float[Array, " M"]
    friction_projection: Float[Array, " M"]
    normal: Float[Array, " M"]
    friction: Float[Array, " M"]
    length: Float[Array, " M"]
    kink_normal: Float[Array, " M"]
    kink_friction: Float[Array, " M"]


def _ratio(above, below):
    """above/below, and 0, with derivative 0, where `below` is not positive."""
    there = below > 0
    return jnp.where(there, above / jnp.where(there, below, 1.0), 0.0)


@eqx.filter_jit
def channel_forces(eq: Equilibrium) -> ChannelForces:
    """Normal force and friction of a tendon on its channel, of second order in the mesh.

    Args:
        eq: one equilibrium; of several tendons one, `eq.of_tendon(i)`.

    Returns:
        The forces; those of an equilibrium that did not converge are as wrong as it is.

    Raises:
        ValueError: an equilibrium of several tendons, or of several lanes.
    """
    if eq.tension.ndim != 1:
        raise ValueError("channel_forces: one tendon of one equilibrium; take eq.of_tendon(i), or jax.vmap")
    length = jnp.diff(eq.s) * 0.5 * (eq.metric[1:] + eq.metric[:-1])
    tension = 0.5 * (eq.tension[1:] + eq.tension[:-1])
    friction = _ratio(-jnp.diff(eq.tension), length)
    curvature = _ratio(jnp.diff(eq.wrap), length)
    return ChannelForces(
        s=0.5 * (eq.s[1:] + eq.s[:-1]),
        angle=0.5 * (eq.tendon_angle[1:] + eq.tendon_angle[:-1]),
        turn=jnp.sign(jnp.diff(eq.tendon_angle)),
        tension_loss_factor=_ratio(tension, jnp.broadcast_to(eq.tension[0], tension.shape)),
        normal_projection=curvature,
        friction_projection=_ratio(friction, tension),
        normal=curvature * tension,
        friction=friction,
        length=length,
        kink_normal=jnp.where(length > 0, 0.0, tension * jnp.diff(eq.wrap)),
        kink_friction=jnp.where(length > 0, 0.0, -jnp.diff(eq.tension)),
    )
