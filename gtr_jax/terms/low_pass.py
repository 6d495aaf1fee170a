"""A load cell, or its amplifier, follows with a lag."""

import jax
import jax.numpy as jnp

from .term import Quantity, Term


def filtered(time, T, clock):
    """First-order lag, exact for a tension that is linear between the samples; it starts settled."""
    dt = jnp.diff(clock)

    def step(carry, x):
        before, y = carry
        now, dt = x
        steps = dt / jnp.where(time > 0, time, 1.0)
        fading = jnp.exp(-steps)
        # The response to a ramp, less its lag of one time constant, plus the remainder of the initial value.
        slow = steps > 1e-3
        share = jnp.where(slow, (1 - fading) / jnp.where(slow, steps, 1.0), 1 - steps / 2 + steps**2 / 6)
        y = now - (now - before) * share + (y - before) * fading
        # For a vanishing time constant the expansion to first order, which has a derivative there.
        plain = now - time * (now - before) / jnp.where(dt > 0, dt, jnp.inf)
        y = jnp.where((time > 0) & (dt > 0), y, plain)
        return (now, y), y

    return jnp.concatenate([T[:1], jax.lax.scan(step, (T[0], T[0]), (T[1:], dt))[1]])


def unfiltered(time, shown, clock):
    """The tension behind what `filtered` shows."""
    dt = jnp.diff(clock)

    def step(carry, x):
        before, y_before = carry
        y, dt = x
        steps = dt / jnp.where(time > 0, time, 1.0)
        fading = jnp.exp(-steps)
        slow = steps > 1e-3
        share = jnp.where(slow, (1 - fading) / jnp.where(slow, steps, 1.0), 1 - steps / 2 + steps**2 / 6)
        known = before * share + (y_before - before) * fading
        kept = 1 - share
        now = (y - known) / jnp.where(kept > 0, kept, 1.0)
        plain = y + time * (y - before) / jnp.where(dt > 0, dt, jnp.inf)
        now = jnp.where((time > 0) & (dt > 0) & (kept > 0), now, plain)
        return (now, y), now

    return jnp.concatenate([shown[:1], jax.lax.scan(step, (shown[0], shown[0]), (shown[1:], dt))[1]])


TERM = Term(
    id="low-pass",
    says="A load cell, or its amplifier, follows the tension with a lag.",
    law="time·ẏ + y = T, for each cell its own time",
    seen="The loop widens with the rate, and a step is followed by an exponential.",
    told_apart="Repeat at another rate; tap the cell and look at its response.",
    quantities=(
        Quantity("tip", "s", 0.0, 0.05, "Time constant of the cell at the tip.", (5e-3, 2.0), 0.0),
        Quantity("base", "s", 0.0, 0.05, "Time constant of the cell at the base.", (5e-3, 2.0), 0.0),
    ),
    timed=True,
    tip=lambda p, T, at: filtered(p["tip"], T, at.time),
    base=lambda p, T, at: filtered(p["base"], T, at.time),
    true_base=lambda p, shown, at: unfiltered(p["base"], shown, at.time),
)
