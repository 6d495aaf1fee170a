"""A load cell, or its amplifier, follows with a lag, or with two in series."""

import jax
import jax.numpy as jnp

from .term import Quantity, Term
from .tried import Tried, Variant


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


def shown_by(time, second, T, clock):
    """What a cell shows of a tension: a lag behind another, the second a share of the first. What the first
    gives counts as linear between the samples, as the tension does: of a sine of 3 N sampled once in each
    time constant the reading is off by 0.05 N, sampled five times by 0.01 N.
    """
    return filtered(second * time, filtered(time, T, clock), clock)


def behind(time, second, shown, clock):
    """The tension behind what `shown_by` gives."""
    return unfiltered(time, unfiltered(second * time, shown, clock), clock)


TERM = Term(
    id="low-pass",
    place=670,
    says="A load cell, or its amplifier, follows the tension with a lag.",
    law="time·ẋ + x = T, second·time·ẏ + y = x, shown = y, for each cell its own time",
    seen="The loop widens with the rate, and a step is followed by an exponential, or by an S of two.",
    told_apart="Repeat at another rate; tap the cell and look at its response.",
    quantities=(
        Quantity("tip", "s", 0.0, 0.05, "Time constant of the cell at the tip.", (5e-3, 2.0), 0.0),
        Quantity("base", "s", 0.0, 0.05, "Time constant of the cell at the base.", (5e-3, 2.0), 0.0),
        Quantity(
            "second",
            "dimensionless",
            0.0,
            0.0,
            "Second lag in series, as a share of the first, for both cells; 0 for one lag.",
            (0.2, 1.0),
            0.0,
            1.0,
            size=False,
        ),
    ),
    timed=True,
    tip=lambda p, T, at: shown_by(p["tip"], p["second"], T, at.time),
    base=lambda p, T, at: shown_by(p["base"], p["second"], T, at.time),
    true_base=lambda p, shown, at: behind(p["base"], p["second"], shown, at.time),
    tried=Tried(
        variants=(
            Variant("tip", ("tip",)),
            Variant("base", ("base",)),
            Variant("tip-second", ("tip", "second")),
            Variant("base-second", ("base", "second")),
        ),
        shared=("second",),
    ),
)
