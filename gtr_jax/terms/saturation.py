"""A load cell reads no higher than a limit."""

import jax.numpy as jnp

from .term import Quantity, Term
from .tried import At, Prior, Rig, Start, Tried, Variant


def cut(limit, knee, T):
    """T up to half a knee below the limit, the limit from half a knee above it on, and between them a
    parabola that joins both without a corner; a limit of 0 cuts nothing.
    """
    over = T - limit + 0.5 * knee
    bends = (knee > 0) & (over > 0) & (over < knee)
    shown = jnp.where(limit < T, limit, T)
    shown = jnp.where(bends, T - 0.5 * over**2 / jnp.where(knee > 0, knee, 1.0), shown)
    return jnp.where(limit > 0, shown, T)


def fault(values, length):
    """Why no cell can have these numbers; empty if one can."""
    limits = [values[end] for end in ("tip", "base") if values[end] > 0]
    wide = any(values["knee"] > 2 * limit for limit in limits)
    return "knee must be at most twice the lower limit" if wide else ""


def prior(rig: Rig) -> dict[str, Prior]:
    """A limit is about as high as the largest reading; a knee is at most as wide as its limit is high, and
    mostly a tenth of it.
    """
    limit = Prior(centre=rig.largest_tip, sd=0.15, log=True, lower=1e-3, size=False)
    knee = Prior(centre=0.1 * rig.largest_tip, sd=1.0, log=True, upper=rig.largest_tip)
    return {"tip": limit, "base": limit, "knee": knee}


def starts(at: At, rig: Rig) -> list[Start]:
    """Limits below the largest reading."""
    limit, *shapes = at
    shape = {name: at[name](0.0) for name in shapes}
    return [{limit: share * rig.largest_tip} | shape for share in (0.97, 0.9, 0.75)]


TERM = Term(
    id="saturation",
    place=690,
    says="A load cell or its amplifier shows nothing above a limit.",
    law="shown = min(T, limit), for each cell its own limit; within knee/2 of it "
    "shown = T − (T − limit + knee/2)²/(2 knee)",
    seen="A flat top, at one and the same tension in every cycle.",
    told_apart="Look for equal samples at the top; use a larger range.",
    source="soft knee: Giannoulis, Massberg & Reiss 2012",
    quantities=(
        Quantity("tip", "N", 0.0, 20.0, "Limit of the cell at the tip; 0: none.", (1.0, 200.0), 0.0),
        Quantity("base", "N", 0.0, 50.0, "Limit of the cell at the base; 0: none.", (1.0, 200.0), 0.0),
        Quantity(
            "knee",
            "N",
            0.0,
            0.0,
            "Range about the limit in which the reading bends over, for both cells; 0: a sharp limit.",
            (0.1, 5.0),
            0.0,
            size=False,
        ),
    ),
    fault=fault,
    tip=lambda p, T, at: cut(p["tip"], p["knee"], T),
    base=lambda p, T, at: cut(p["base"], p["knee"], T),
    tried=Tried(
        variants=(
            Variant("tip", ("tip",), prior, starts),
            Variant("base", ("base",), prior, starts),
            Variant("tip-knee", ("tip", "knee"), prior, starts),
            Variant("base-knee", ("base", "knee"), prior, starts),
        ),
        shared=("knee",),
    ),
)
