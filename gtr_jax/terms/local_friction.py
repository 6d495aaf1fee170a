"""Friction that the model spreads over the channel is concentrated in one place."""

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import NINE_OF_TEN, At, Prior, Rig, Start, Tried, Variant

# Friction of the stretches that are tried over that elsewhere, and their ends as shares of the length.
FACTORS = (2.5, 0.45)
STRETCHES = ((0.02, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.98), (0.25, 0.6), (0.5, 0.9))


def friction(p, at):
    """Factor on the friction coefficient of an interval, from the share of the interval in the stretch."""
    first = jnp.where(at.start > p["start"], at.start, p["start"])
    last = jnp.where(at.end < p["end"], at.end, p["end"])
    length = at.end - at.start
    share = jnp.where(last > first, last - first, 0.0) / jnp.where(length > 0, length, 1.0)
    within = (at.start >= p["start"]) & (at.end <= p["end"])
    return 1 + (p["factor"] - 1) * jnp.where(length > 0, share, jnp.where(within, 1.0, 0.0))


def fault(values, length):
    """Why the numbers bound no stretch of the body; empty if they do."""
    if values["factor"] == 1:
        return ""
    if not 0 <= values["start"] < values["end"]:
        return "start and end must bound a stretch, start below end"
    return "" if values["start"] < length else f"start must lie on the body, below {1e3 * length:g} mm"


def prior(rig: Rig) -> dict[str, Prior]:
    """The stretch lies anywhere along the body."""
    length, sd = rig.length, 0.6 * (0.5 * rig.length / NINE_OF_TEN)
    return {
        "start": Prior(centre=0.35 * length, sd=sd, upper=0.97 * length),
        "end": Prior(centre=0.65 * length, sd=sd, lower=0.03 * length, upper=length),
    }


def starts(at: At, rig: Rig) -> list[Start]:
    """Stretches along the body, rougher and smoother than the rest."""
    return [
        {"factor": factor, "start": start * rig.length, "end": end * rig.length}
        for factor in FACTORS
        for start, end in STRETCHES
    ]


TERM = Term(
    id="local-friction",
    place=210,
    says="Friction is higher in one place: a pulley or entry at the base, the anchor, or a rough stretch.",
    law="T multiplied by exp(∓base) ahead of the channel, by exp(∓tip) at the anchor; "
    "μ·factor from start to end",
    seen="Hidden in the tensions, which it changes as more friction would; the shape bends as if pulled less "
    "(base) or more (tip) than the tensions say.",
    told_apart="Record the tip's pose, or the tendon's displacement.",
    quantities=(
        Quantity("base", "dimensionless", 0.0, 0.1, "μ times angle ahead of the channel.", (0.02, 0.4), 0.0),
        Quantity("tip", "dimensionless", 0.0, 0.1, "μ times angle at the anchor.", (0.02, 0.4), 0.0),
        Quantity(
            "factor",
            "dimensionless",
            1.0,
            2.0,
            "Friction coefficient from start to end over that elsewhere.",
            (0.3, 4.0),
            0.0,
            log=True,
        ),
        Quantity("start", "m", 0.0, 0.06, "Where the stretch begins.", (0.0, 0.3), 0.0, size=False),
        Quantity("end", "m", 0.0, 0.1, "Where it ends.", (0.0, 0.3), 0.0, size=False),
    ),
    friction=friction,
    fault=fault,
    base_grip=lambda p: p["base"],
    tip_grip=lambda p: p["tip"],
    tried=Tried(
        variants=(
            Variant("base", ("base",)),
            Variant("tip", ("tip",)),
            Variant("stretch", ("factor", "start", "end"), prior, starts),
        )
    ),
)
