"""Friction grows with the speed of the slip."""

from .term import Quantity, Term
from .tried import Tried, Variant

# Speed at which all exponents give the same [m/s], and below which the law is linear, as a share of it.
SPEED, SLOW = 0.01, 0.02


def by_speed(p, speed):
    """Odd in the speed, and smooth where it passes zero."""
    share = (speed / SPEED) ** 2 + SLOW**2
    return p["coefficient"] * speed * share ** (0.5 * (p["exponent"] - 1.0))


TERM = Term(
    id="viscous-friction",
    place=110,
    says="Friction grows with the speed at which the tendon slips.",
    law="μ + coefficient·v·(v/10 mm/s)^(exponent − 1), linear below 0.2 mm/s",
    seen="The loop widens with the rate, while pulling and while releasing; it narrows during holds.",
    told_apart="Repeat the loop at a third of the rate, and at three times it.",
    source="viscous friction by a power of the speed: Olsson et al. 1998",
    quantities=(
        Quantity("coefficient", "s/m", 0.0, 20.0, "Friction coefficient per speed.", (1.0, 100.0), 0.0),
        Quantity(
            "exponent",
            "dimensionless",
            1.0,
            1.0,
            "Power of the speed: below 1 a film that thins with the rate of shear.",
            (0.4, 1.6),
            0.2,
            2.5,
            size=False,
        ),
    ),
    timed=True,
    creeps=True,
    by_speed=by_speed,
    tried=Tried(
        variants=(
            Variant(free=("coefficient",)),
            Variant("power", ("coefficient", "exponent")),
        )
    ),
)
