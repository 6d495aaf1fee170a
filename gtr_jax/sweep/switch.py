"""T_base_switch for many robots at once.

The root that `gtr_jax.release_switch` finds by bisection, here by secants in the logarithms of the tensions,
one of which is almost linear in the other: six equilibria instead of three hundred.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from gtr_jax.robot.robot import Robot

from ..simulation.equilibrium import equilibrium
from ..simulation.release import ALL_RELEASED

SECANTS = 12  # most secant steps
TOLERANCE = 1e-11  # of the tip tension, relative


def switch_tension(robot: Robot, T_max: Float[Array, ""], solver) -> tuple[Float[Array, ""], Bool[Array, ""]]:
    """Base tension [N] whose fully releasing state has the tip tension of the pull, and whether it was found.

    Args:
        robot: of one tendon, without physics terms that act.
        T_max: base tension of the pull [N].
        solver: see `gtr_jax.equilibrium`.
    """
    pulled = equilibrium(robot, T_max, with_terms=False, solver=solver)
    high = jnp.full_like(pulled.tension, ALL_RELEASED) * T_max
    wanted = jnp.log(pulled.T_tip)

    def excess(x):
        eq = equilibrium(robot, jnp.exp(x), memory=high, with_terms=False, solver=solver)
        return jnp.log(eq.T_tip) - wanted, eq.converged

    def secant(carry):
        x, y, before, there, _, count = carry
        slope = (y - there) / jnp.where(x == before, 1.0, x - before)
        onward = x - y / jnp.where((count > 0) & (slope > 0.1), slope, 1.0)
        now, met = excess(onward)
        return onward, now, x, y, met, count + 1

    def goes_on(carry):
        return (jnp.abs(carry[1]) > TOLERANCE) & (carry[-1] < SECANTS)

    # First guess: with the wrap of the pull, T_base/T_tip = T_tip/T_max.
    x = 2.0 * wanted - jnp.log(T_max)
    y, met = excess(x)
    x, y, _, _, met, _ = jax.lax.while_loop(goes_on, secant, (x, y, x, y, met, jnp.asarray(0)))
    return jnp.exp(x), pulled.converged & met & (jnp.abs(y) <= TOLERANCE)
