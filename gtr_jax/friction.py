"""Coulomb friction of the tendon on its channel, for any load history."""

from __future__ import annotations

import jax.numpy as jnp


def transmit(tension_before, wrap, memory, mu):
    """Tension [N] at a node from the tension at the node before it: the capstan limits, else the tension it had.

    T_i = clip(memory_i, T_(i-1) exp(-mu dtheta), T_(i-1) exp(+mu dtheta)). Where `memory` lies below the band the tendon slips
    towards the base (pulling, lambda = +1 in eq. 6), above it towards the tip (releasing, lambda = -1), inside it is locked.
    For a sequence pull-transition-release this is Algorithm 1 of Liu & Alambeigi; re-pulls and inner loops follow without more.

    Args:
        tension_before: T at the predecessor [N]; the base tension at the first node.
        wrap: turning between the two nodes [rad], non-negative.
        memory: tension at the node after the load step before this one [N].
        mu: friction coefficient [-].
    """
    grip = jnp.exp(mu * wrap)
    pulled, released = tension_before / grip, tension_before * grip
    # Not min/max: where the band has no width, the branch taken must still follow the direction of slip.
    return jnp.where(memory <= pulled, pulled, jnp.where(memory >= released, released, memory))
