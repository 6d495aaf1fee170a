"""What must hold of a recording before any physics is asked of it."""

from __future__ import annotations

import numpy as np

from ..task import Part

FEWEST = 20
# A tip that reads this many times the base throughout, or a stretch of equal extremes this long, is no data.
SWAPPED, STUCK = 1.15, 0.25


def faults(part: Part) -> list[str]:
    """Why a recording cannot be diagnosed; empty if it can."""
    T, tip, where = part.T_base.T_base, part.T_tip, part.path
    found = []
    if part.samples < FEWEST:
        found.append(f"{where}: {part.samples} samples are too few to diagnose; record {FEWEST} or more")
    if np.ptp(T) <= 0 or np.ptp(tip) <= 0:
        which = "base" if np.ptp(T) <= 0 else "tip"
        found.append(f"{where}: the {which} tension never changes; is its cell connected?")
        return found
    taut = T > 0.3 * T.max()
    ratio = float(np.median(tip[taut] / T[taut]))
    rising = taut & (np.gradient(T) > 0)
    pulled = float(np.median(tip[rising] / T[rising])) if rising.sum() > 3 else ratio
    if ratio > SWAPPED and pulled > SWAPPED:
        found.append(
            f"{where}: the tip reads {ratio:.3g} times the base even while pulling, which friction cannot "
            "do; swap the columns, or check units and gains"
        )
    if pulled < 0:
        found.append(f"{where}: the tip tension has the other sign; change it")
    if part.time is not None and np.any(np.diff(part.time) < 0):
        found.append(f"{where}: time_s goes back; put the rows in the order of time")
    follows = float(np.corrcoef(T, tip)[0, 1])
    if follows < 0.2:
        found.append(
            f"{where}: the tip hardly follows the base (correlation {follows:.2f}); are the columns those of "
            "one run?"
        )
    held = np.isclose(tip, tip.max(), atol=1e-12).mean()
    if held > STUCK:
        found.append(
            f"{where}: the tip cell shows its largest value in {100 * held:.0f} % of samples; it is stuck, "
            "or overloaded"
        )
    return found
