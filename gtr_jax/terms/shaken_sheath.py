"""The sheath is shaken for a while, which lowers friction."""

from .term import Quantity, Term, rise
from .tried import At, Moments, Start, Tried, Variant

# Share of friction that shaking is tried with, how fast it comes and goes, and the shortest tried [s].
SHARE, EDGE, SHORTEST = 0.6, 0.05, 0.1


def shaking(p, time):
    """Share of the whole shaking at a time [s]: it comes and goes smoothly, within `edge`."""
    end = p["time"] + p["duration"]
    return rise((time - p["time"]) / p["edge"]) * rise((end - time) / p["edge"])


def starts(at: At, moments: Moments) -> list[Start]:
    """Shaking during each misfit that lies where friction should hold the tip."""
    return [
        {"share": SHARE, "time": start - EDGE, "duration": max(lasts, SHORTEST) + 2 * EDGE}
        for start, lasts in moments.held
    ]


TERM = Term(
    id="shaken-sheath",
    place=180,
    says="The sheath is shaken or knocked for a while, and friction is lower meanwhile.",
    law="μ (1 − share·S((t − time)/edge)·S((time + duration − t)/edge)), S(x) = 3x² − 2x³ from 0 to 1; "
    "what friction no longer holds relaxes",
    seen="An event in time: the tensions of base and tip relax towards each other while the tendon is "
    "otherwise locked; in a loop a step of the held tip tension.",
    told_apart="Shake the rig on purpose, in a hold, and look at a video or an accelerometer.",
    source="dither lowers Coulomb friction: Armstrong-Hélouvry, Dupont & Canudas de Wit, Automatica 30, 1994",
    quantities=(
        Quantity(
            "share", "dimensionless", 0.0, 0.5, "Share of friction that is lost.", (0.05, 1.0), 0.0, 1.0
        ),
        Quantity("time", "s", 0.0, 30.0, "When it begins.", (0.0, 600.0), size=False),
        Quantity("duration", "s", 1.0, 2.0, "How long it lasts.", (0.05, 20.0), 0.0, log=True, size=False),
        Quantity(
            "edge",
            "s",
            0.1,
            0.2,
            "Time in which it comes, and in which it goes.",
            (0.01, 2.0),
            0.0,
            log=True,
            size=False,
        ),
    ),
    timed=True,
    event=True,
    loosens=True,
    friction=lambda p, at: 1 - p["share"] * shaking(p, at.time),
    tried=Tried(
        variants=(Variant("", ("share", "time", "duration"), None, starts, lambda moments: {"edge": EDGE}),)
    ),
)
