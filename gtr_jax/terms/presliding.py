"""Friction builds up over a slip: Dahl's law, or elements that slip one after another."""

import jax.numpy as jnp
import numpy as np

from .term import STILL, Quantity, Term
from .tried import Prior, Rig, Tried, Variant

# Shortest length that is tried [m]: a little below what is usual. One shorter than the slip between samples
# is Coulomb friction, and hard to solve, because shooting from the base becomes ill-conditioned: at 5e-5 m
# slip at the tip changes 2e5 times as much as at the base, at 1.5e-5 m 2e12 times.
SHORTEST = 4e-5
# Compliance assumed for a tendon in a rigid sheath whose file states none [1/N].
COMPLIANCE = 5e-5

# Break-away slips of the elements, in units of the length; equal shares of friction.
BREAK_AWAY = (0.35, 0.8, 1.5, 2.8)
FULL = 1 - 1e-9  # mobilisation from which an element slips; the margin is for rounding


def mobilise(p, slip, was):
    """Mobilisation after a slip, exact for a slip of any size, and the memory: Dahl's z, then elements."""
    length = jnp.where(p["length"] > 0, p["length"], 1.0)
    sense = jnp.where(slip >= -STILL, 1.0, -1.0)
    dahl = sense - (sense - was[0]) * jnp.exp(-sense * slip / length)
    moved = [z + slip / (length * x) for z, x in zip(was[1:], BREAK_AWAY, strict=True)]
    moved = [jnp.where(z >= FULL, 1.0, jnp.where(z <= -FULL, -1.0, z)) for z in moved]
    z = (1 - p["elements"]) * dahl + p["elements"] * sum(moved) / len(moved)
    return z, jnp.stack([dahl, *moved])


def stretched(rig: Rig) -> dict[str, float]:
    """In a rigid sheath a tendon slips as much as it stretches."""
    stretches = bool(np.any(np.asarray(rig.values["tendon-stretch"]["compliance"]) > 0))
    return {"tendon-stretch.compliance": COMPLIANCE} if rig.rigid and not stretches else {}


TERM = Term(
    id="presliding",
    place=100,
    says="Friction builds up over the first stretch of slip after each reversal, not at once.",
    law="friction μ z; Dahl: dz/du = (1 − z sgn u̇)/length; or elements clip(z_j + du/x_j, ±1), "
    "x_j = length·(0.35, 0.8, 1.5, 2.8), and z their mean",
    seen="Every reversal is rounded and the plateau of the transition slopes, at any rate alike.",
    told_apart="Small inner loops: narrow ellipses here, flat lines under Coulomb friction. "
    "Repeat at another rate (viscous effects), with cells swapped (cell-hysteresis).",
    source="Dahl 1968; Maxwell-slip elements: Iwan 1966",
    quantities=(
        Quantity("length", "m", 0.0, 6e-4, "Slip over which friction builds up.", (5e-5, 3e-3), 0.0),
        Quantity(
            "elements",
            "dimensionless",
            0.0,
            0.0,
            "Share of friction carried by elements that slip one after another; the rest is Dahl's.",
            (0.0, 1.0),
            0.0,
            1.0,
            size=False,
        ),
    ),
    mobilise=mobilise,
    elements=1 + len(BREAK_AWAY),
    tried=Tried(variants=(Variant(prior=lambda rig: {"length": Prior(lower=SHORTEST)}, fixed=stretched),)),
)
