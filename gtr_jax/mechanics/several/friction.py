"""Coulomb friction of the tendon on its channel, for any load history."""

from __future__ import annotations

import jax.numpy as jnp


def tension(T_base, wrap, memory, mu):
    """Tension [N] along the only tendon of a robot: the previous tension, clipped to what friction can hold
    against the base.

    T_k(s) = clip(T_(k-1)(s), T_base exp(-mu theta), T_base exp(+mu theta)). Where the memory lies below the
    band the tendon slips towards the base (pulling, lambda = +1 in eq. 6), above it towards the tip
    (releasing, lambda = -1), inside it is locked and keeps its tension. For a sequence
    pull-transition-release this is Algorithm 1 of Liu & Alambeigi; re-pulls and inner loops need nothing
    more.

    Args:
        T_base: tension at the base [N].
        wrap: theta, total turning of the tendon since the base [rad], non-negative.
        memory: tension at the same places after the previous load step [N].
        mu: friction coefficient [-].
    """
    grip = jnp.exp(mu * wrap)
    pulled, released = T_base / grip, T_base * grip
    # Not clip: where the band has no width, derivatives must still follow the direction of slip.
    return jnp.where(memory <= pulled, pulled, jnp.where(memory >= released, released, memory))


def mobilised_tension(T_base, angle, mu):
    """Tension [N] along a tendon whose friction is known: T = T_base exp(-mu angle).

    Args:
        T_base: tension at the base [N].
        angle: integral of the mobilisation over the wrap since the base [rad]; the mobilisation is +1 where
            the tendon slips towards the base, -1 towards the tip, between where it is locked.
        mu: friction coefficient [-].
    """
    return T_base * jnp.exp(-mu * angle)
