"""Friction grows with the speed of the slip."""

from .term import Quantity, Term

TERM = Term(
    id="viscous-friction",
    says="Friction grows with the speed at which the tendon slips.",
    law="μ + coefficient·v",
    seen="The loop widens with the rate, while pulling and while releasing; it narrows during holds.",
    told_apart="Repeat the loop at a third of the rate, and at three times it.",
    quantities=(
        Quantity("coefficient", "s/m", 0.0, 20.0, "Friction coefficient per speed.", (1.0, 100.0), 0.0),
    ),
    timed=True,
    creeps=True,
    by_speed=lambda p, speed: p["coefficient"] * speed,
)
