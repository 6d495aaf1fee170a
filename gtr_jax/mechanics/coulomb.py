"""Coulomb's law for several tendons that share a body in the plane, as it is approximated.

Friction opposes the slip u: ln T falls by mu z |psi'| per length, where the mobilisation z follows the slip
of a load step until friction is exhausted,

    z = clip(z_before + u/(PRESLIDING L), -1, 1),

and a tendon gives by STRETCH (T - T_before)/T_unit along its channel, and by as much over L at its anchor.
Coulomb's law on a tendon that does not stretch is the limit PRESLIDING, STRETCH -> 0, which is not unique:
two tendons locked at one place may share the moment in any proportion, and a channel that never changes
length (straight through the axis, a rigid sheath) would never slip.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

from .mesh import increments
from .sections import Sections

# Slip over length at which friction is exhausted. For a pair that is pulled and released, a tenth of it and
# of STRETCH changes tip tensions by up to 3e-3 of the base tension (docs/mechanics.md).
PRESLIDING = 2e-6
STRETCH = 1e-4  # strain of a tendon at T_unit, about that of a steel wire
SMALLEST_ARM = 1e-3  # of the length: least moment arm from which T_unit is computed
EXACT = 1e-8 * PRESLIDING  # what is left of the slip over the length at which a search ends
# Of every ROUND Newton steps the first WHOLE are full and the others SHORT of that, which breaks cycles.
ROUND, WHOLE, SHORT = 30, 18, 0.4
LEFT = 1.0 + 1e-9  # |xi| just beyond the limit of friction, where a step from stick to slip is cut


def unit_tension(s: Sections) -> Float[Array, ""]:
    """The tension that, without friction, bends the robot by about one radian [N]; 1 N for a rigid sheath."""
    compliance = jnp.sum(increments(s.mesh.weights, s.compliance))
    arm = jnp.max(jnp.abs(s.R.value))
    turn = compliance * jnp.where(arm > SMALLEST_ARM * s.mesh.s[-1], arm, SMALLEST_ARM * s.mesh.s[-1])
    return jnp.where(turn > 0, 1.0 / jnp.where(turn > 0, turn, 1.0), 1.0)


def mobilisation(xi: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """z in [-1, 1] of the unknown xi, which is z where the tendon is held and goes on with the slip over the
    length where it slips.
    """
    return jnp.where(xi > 1.0, 1.0, jnp.where(xi < -1.0, -1.0, xi))


def slip_of_law(xi: Float[Array, "*any"], before: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """Slip towards the base in a load step over the length, from xi and the mobilisation before it."""
    z = mobilisation(xi)
    return PRESLIDING * (z - before) + (xi - z)


def kept_near(new: Float[Array, "*any"], old: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """xi after a Newton step, cut where an interval changes between stick and slip, against overshoot."""
    leaving = jnp.where(new > 1.0, LEFT, jnp.where(new < -1.0, -LEFT, new))
    slipping = jnp.where(old > 0, jnp.maximum(new, 0.0), jnp.minimum(new, 0.0))
    return jnp.where(jnp.abs(old) <= 1.0, leaving, slipping)
