"""The tip runs into something."""

import math

import jax.numpy as jnp
import numpy as np

from .term import Quantity, Term
from .tried import At, Prior, Rig, Start, Tried, Variant

NEAREST = 1e-3  # m, least distance that the tip counts as going


def stop(p, place):
    """Force of the stop [N], against its direction; negative where the tip is away from it."""
    return p["stiffness"] * (place - p["distance"])


def stop_normal(p):
    """Direction in which the tip of a robot in space runs into the stop, in the axes of the base."""
    flat = jnp.cos(p["elevation"])
    return flat * jnp.cos(p["angle"]), flat * jnp.sin(p["angle"]), jnp.sin(p["elevation"])


def _farthest(travel: np.ndarray) -> tuple[dict[str, float], float]:
    """Direction in which the tip goes farthest across the base tangent, as the angles of a stop in its way
    [rad], by name, and how far it goes [m]; `travel` as of `Rig`.
    """
    if travel.ndim == 1:
        low, high = (float(v) for v in travel)
        return {"angle": (1.0 if high >= -low else -1.0) * np.pi / 2}, max(high, -low, NEAREST)
    across = travel[:, 1:]
    y, z = across[np.argmax(np.linalg.norm(across, axis=1))]
    side = 1.0 if y >= 0 else -1.0
    reach = max(float(np.hypot(y, z)), NEAREST)
    return {"angle": side * np.pi / 2, "elevation": float(np.arctan2(z, abs(y)))}, reach


def way(rig: Rig) -> dict[str, float]:
    """The stop is in the tip's way: in which direction it is run into follows from that of the bend."""
    return _farthest(rig.travel)[0]


def prior(rig: Rig) -> dict[str, Prior]:
    """The stop is of any stiffness, about half way."""
    _, reach = _farthest(rig.travel)
    return {
        "stiffness": Prior(centre=200.0, sd=1.5, log=True, lower=1.0, size=False),
        "distance": Prior(centre=0.5 * reach, sd=0.4 * reach),
    }


def starts(at: At, rig: Rig) -> list[Start]:
    """Soft and stiff stops along the way."""
    _, reach = _farthest(rig.travel)
    return [
        {"stiffness": stiffness, "distance": share * reach}
        for share in (0.3, 0.6, 0.85)
        for stiffness in (100.0, 600.0)
    ]


TERM = Term(
    id="contact",
    place=520,
    says="The tip runs into a stop at one place of its path.",
    law="force stiffness·depth against angle, once the tip is beyond distance in that direction; in space "
    "the stop is a plane, its normal (cos angle cos elevation, sin angle cos elevation, sin elevation)",
    seen="A kink at one tension: beyond it the tip hardly moves, and less tension is lost.",
    told_apart="Look; or record the pose.",
    quantities=(
        Quantity("stiffness", "N/m", 0.0, 200.0, "Force per depth.", (10.0, 1e4), 0.0),
        Quantity(
            "distance",
            "m",
            0.0,
            0.02,
            "Place of the stop along angle, from the base.",
            (-0.2, 0.2),
            size=False,
        ),
        Quantity(
            "angle",
            "rad",
            math.pi / 2,
            math.pi / 2,
            "Direction, from the base tangent, in which the tip runs into it.",
            (-math.pi, math.pi),
            size=False,
        ),
    ),
    across=(
        Quantity(
            "elevation",
            "rad",
            0.0,
            0.5,
            "Angle of that direction out of the plane of x and y, towards z.",
            (-math.pi / 2, math.pi / 2),
            size=False,
        ),
    ),
    stop=stop,
    stop_angle=lambda p: p["angle"],
    stop_normal=stop_normal,
    tried=Tried(variants=(Variant("", ("stiffness", "distance"), prior, starts, way),)),
)
