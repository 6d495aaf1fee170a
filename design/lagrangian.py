"""Goals, and whatever is not a sum of squares: bounded L-BFGS-B on an augmented Lagrangian, many starts at
once.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .gauss_newton import BACK_OFF, KEPT, Found
from .lbfgsb import minimise
from .objective import Objective, evaluate

# Penalty of the augmented Lagrangian: at first, at most, and the factor by which it is raised.
FIRST_PENALTY, LARGEST_PENALTY, RAISE = 1e2, 1e7, 10.0
TOLERANCE = 1e-6  # largest entry of the projected gradient at which a minimisation stops
STEPS, ROUNDS = 40, 6  # iterations of a minimisation; rounds of the augmented Lagrangian
KNOWN_PENALTY = 1e3  # to start with where multipliers are known


def _objective(objective: Objective, z):
    e = evaluate(objective, z)
    value = e.goal if objective.wanted.goal else 0.5 * jnp.sum(e.residuals**2)
    return jnp.where(e.converged, value, jnp.nan), e.margins


def _augmented(z, objective: Objective, multipliers, penalty, scale):
    value, rows = _objective(objective, z)
    short = jnp.maximum(0.0, multipliers / penalty - (rows - BACK_OFF))
    return scale * value + 0.5 * penalty * jnp.sum(short**2)


@eqx.filter_jit
def _round(objective: Objective, z, free, multipliers, penalty, scale):
    """One round of every lane: minimise at the present multipliers."""

    def one(z, free, multipliers, penalty, scale):
        lower, upper = jnp.where(free > 0, 0.0, z), jnp.where(free > 0, 1.0, z)
        found = minimise(
            _augmented,
            z,
            objective,
            multipliers,
            penalty,
            scale,
            lower=lower,
            upper=upper,
            tol=TOLERANCE,
            steps=STEPS,
        )
        value, rows = _objective(objective, found.z)
        return found, value, rows

    # One lane after another, as in `gauss_newton`.
    return jax.lax.map(lambda lane: one(*lane), (z, free, multipliers, penalty, scale))


@eqx.filter_jit
def _gradients(objective: Objective, z, free, multipliers, penalty, scale):
    slope = jax.vmap(jax.grad(_augmented), in_axes=(0, None, 0, 0, 0))
    return free * slope(z, objective, multipliers, penalty, scale)


@eqx.filter_jit
def _objectives(objective: Objective, z):
    return jax.vmap(lambda z: _objective(objective, z))(z)


def minimise_all(
    objective: Objective,
    z: Float[Array, "L c"],
    free: Float[Array, "L c"],
    multipliers: Float[Array, "L K"] | None = None,
) -> Found:
    """Minimise the goal, or half the sum of squares, within bounds and limits from L starts.

    The rounds of the augmented Lagrangian are taken on the host: one compiled program serves them all.

    Args:
        objective: the problem.
        z: starts, (L, c).
        free: 1 for coordinates that may change, (L, c).
        multipliers: of the limits at the start, for the unscaled objective; 0 unless given.
    """
    lanes = z.shape[0]
    value, rows = _objectives(objective, z)
    scale = 1.0 / jnp.maximum(1.0, jnp.abs(jnp.where(jnp.isfinite(value), value, 1.0)))
    known = multipliers is not None
    multipliers = scale[:, None] * multipliers if multipliers is not None else jnp.zeros(rows.shape)
    penalty = jnp.full(lanes, KNOWN_PENALTY if known else FIRST_PENALTY)
    missed, steps = jnp.full(lanes, jnp.inf), jnp.zeros(lanes, dtype=int)
    settled = jnp.zeros(lanes, dtype=bool)
    last = jnp.full(z.shape, jnp.inf)
    for _ in range(ROUNDS):
        found, value, rows = _round(objective, z, free, multipliers, penalty, scale)
        done = settled[:, None]
        moved = jnp.max(jnp.abs(found.z - last), axis=1)
        last = jnp.where(done, last, found.z)
        z = jnp.where(done, z, found.z)
        steps = steps + jnp.where(settled, 0, found.steps)
        worst = jnp.max(jnp.maximum(0.0, BACK_OFF - rows), axis=1, initial=0.0)
        settled = settled | ((worst < KEPT) & (found.settled | (moved < 1e-6)))
        if bool(jnp.all(settled)):
            break
        later = settled[:, None]
        dual = jnp.maximum(0.0, multipliers - penalty[:, None] * (rows - BACK_OFF))
        multipliers = jnp.where(later, multipliers, dual)
        raised = ~settled & (worst > 0.25 * missed)
        penalty = jnp.where(raised, jnp.minimum(RAISE * penalty, LARGEST_PENALTY), penalty)
        missed = worst
    value, rows = _objectives(objective, z)
    gradient = _gradients(objective, z, free, multipliers, penalty, scale)
    force = jnp.maximum(0.0, multipliers - penalty[:, None] * (rows - BACK_OFF)) / scale[:, None]
    return Found(z, value, rows, force, gradient, settled, steps)
