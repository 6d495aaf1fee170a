"""The zero of a load cell drifts."""

from .term import Quantity, Term, along

TERM = Term(
    id="zero-drift",
    says="The zero of a load cell drifts with time.",
    law="shown = T + rate·t, for each cell its own",
    seen="The whole loop moves up or down with time; in ln(T_tip/T_base) most at low tension.",
    told_apart="Slacken the tendon now and then and read the cells.",
    quantities=(
        Quantity("tip", "N/s", 0.0, 2e-3, "Drift of the cell at the tip.", (-2e-2, 2e-2)),
        Quantity("base", "N/s", 0.0, 2e-3, "Drift of the cell at the base.", (-2e-2, 2e-2)),
    ),
    timed=True,
    tip=lambda p, T, at: T + p["tip"] * along(at.time, T),
    base=lambda p, T, at: T + p["base"] * along(at.time, T),
    true_base=lambda p, shown, at: shown - p["base"] * along(at.time, shown),
)
