"""A load cell is hysteretic."""

import jax
import jax.numpy as jnp

from .term import Quantity, Term


def _clipped(z):
    return jnp.where(z >= 1.0, 1.0, jnp.where(z <= -1.0, -1.0, z))


def lagging(force, width, T):
    """Reading of a cell that holds back up to `force` after each reversal; it starts relaxed."""

    def step(carry, now):
        z, before = carry
        z = _clipped(z + (now - before) / width)
        return (z, now), now - force * z

    return jax.lax.scan(step, (jnp.zeros_like(T[0]), T[0]), T)[1]


def leading(force, width, shown):
    """The tension behind what `lagging` shows; for a force below the width."""

    def step(carry, y):
        z, before = carry
        change = (y - (before - force * z)) / (1 - force / width)
        z = _clipped(z + change / width)
        now = y + force * z
        return (z, now), now

    return jax.lax.scan(step, (jnp.zeros_like(shown[0]), shown[0]), shown)[1]


def fault(values, length):
    """Why no cell can have these numbers; empty if one can."""
    return "" if max(values["tip"], values["base"]) < values["width"] else "width must exceed the forces"


TERM = Term(
    id="cell-hysteresis",
    says="A load cell lags behind the tension by a force after each reversal, at any rate.",
    law="shown = T − force·z, z = clip(z + dT/width, ±1), for each cell its own force",
    seen="Reversals are rounded and the loop is wider by the same force at every tension.",
    told_apart="Load the cell alone, up and down; swap the cells.",
    source="one Maxwell-slip (Prandtl) element",
    quantities=(
        Quantity("tip", "N", 0.0, 0.2, "Force that the cell at the tip holds back.", (0.02, 1.0), 0.0),
        Quantity("base", "N", 0.0, 0.2, "Force that the cell at the base holds back.", (0.02, 1.0), 0.0),
        Quantity(
            "width",
            "N",
            2.0,
            2.0,
            "Change of tension over which it builds up; more than the forces.",
            (0.3, 10.0),
            0.0,
            log=True,
            size=False,
        ),
    ),
    fault=fault,
    tip=lambda p, T, at: lagging(p["tip"], p["width"], T),
    base=lambda p, T, at: lagging(p["base"], p["width"], T),
    true_base=lambda p, shown, at: leading(p["base"], p["width"], shown),
)
