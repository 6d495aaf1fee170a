"""Tendon that runs free between the cell or motor at the base and the sheath stretches."""

from .term import Quantity, Term

TERM = Term(
    id="free-length",
    place=410,
    says="Tendon that runs free between the motor, its load cell and the sheath stretches, or the mount of "
    "the motor gives way.",
    law="drawn out at the base: compliance·T_base more; compliance = free length/EA + that of the mount",
    seen="In the displacement only, which follows the base tension even while the tendon is locked; "
    "tensions and pose stay as they are.",
    told_apart="Clamp the tendon where it enters the sheath, and pull. Stretch along the channel "
    "(tendon-stretch) lags by friction.",
    quantities=(
        Quantity(
            "compliance", "m/N", 0.0, 2e-5, "Free length over EA, with the mount's give.", (1e-6, 3e-4), 0.0
        ),
    ),
    ahead=lambda p, tension: p["compliance"] * tension,
)
