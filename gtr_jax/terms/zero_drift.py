"""The zero of a load cell drifts."""

import numpy as np

from .term import Quantity, Term, along
from .tried import Instrument, Prior, Read, Tried, Variant

# Drift that instruments always add in a whole recording, as a share of the largest tension: its standard
# deviation, and of these how many at most, because a larger one imitates friction, and an effect that is
# missing is not found any more. A tendon is slack below the last share of the cell's largest reading.
DRIFT, FARTHEST, SLACK = 0.002, 3.0, 0.02


def drift_while_slack(time: np.ndarray, T: np.ndarray) -> float | None:
    """Drift of a cell's zero [N/s], from what it shows while the tendon is slack; None where it is slack too
    seldom to tell.

    Args:
        time: [s], (K,).
        T: what the cell shows [N], (K,).
    """
    slack = T < SLACK * float(np.max(T))
    visit = np.cumsum(np.diff(slack.astype(int), prepend=0) == 1)
    rests = [(time[k], T[k]) for v in range(1, visit[-1] + 1) if np.sum(k := slack & (visit == v)) >= 5]
    if len(rests) < 3:
        return None
    t, zero = np.asarray([(np.median(when), np.median(shown)) for when, shown in rests]).T
    return float(np.polyfit(t, zero, 1)[0]) if np.ptp(t) > 0.5 * np.ptp(time) else None


def drift(read: Read, T: np.ndarray | None) -> Prior | None:
    """That instruments always add: about what a cell shows while the tendon is slack. None where several
    tendons have cells, whose zeros would drift alike.
    """
    if T is None or not read.alone:
        return None
    seen = drift_while_slack(read.time, T)
    centre = 0.0 if seen is None else seen
    sd = DRIFT * (float(np.max(read.T_base)) / float(np.ptp(read.time)))
    return Prior(centre=centre, sd=sd, lower=centre - FARTHEST * sd, upper=centre + FARTHEST * sd, size=False)


TERM = Term(
    id="zero-drift",
    place=660,
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
    tried=Tried(
        variants=(Variant("tip", ("tip",)), Variant("base", ("base",))),
        always=(
            Instrument("tip", lambda read: drift(read, read.T_tip)),
            Instrument("base", lambda read: drift(read, read.T_base)),
        ),
    ),
)
