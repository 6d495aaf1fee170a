"""Checks that a recording must pass before it is diagnosed."""

from __future__ import annotations

import numpy as np

from calibrate.inference.instruments import leading, words_for
from calibrate.inference.setup import Observation

# Samples that a diagnosis needs.
FEWEST = 20
# Samples that one without tip tension needs at least, whatever the number of its channels.
FEWEST_WITHOUT_TIP = 6
# Ratio of tip to base tension above which columns or units are wrong; share of samples at the largest reading
# above which a cell is stuck; ratio of the largest tip to the largest base tension below which the units are
# wrong.
SWAPPED, STUCK, LOST = 1.15, 0.6, 1 / 200
# Shares of the tension that friction may hold back, and the least correlation of the tip with the tension
# that then gets through.
HELD_BACK, LEAST = (0.0, 0.3, 0.5, 0.7, 0.85), 0.3


def _held_back(T: np.ndarray, share: float) -> np.ndarray:
    """The tension that gets through friction: constant while between (1 - share) T and T / (1 - share)."""
    held, found = (1 - share) * max(float(T[0]), 0.0), []
    for now in np.maximum(T, 0.0).tolist():
        held = min(max(held, (1 - share) * now), now / (1 - share))
        found.append(held)
    return np.asarray(found)


def fewest_of(part: Observation) -> int:
    """Samples of a recording that a diagnosis needs."""
    return FEWEST if part.tips else max(FEWEST_WITHOUT_TIP, -(-FEWEST // part.explained))


def faults(part: Observation) -> list[str]:
    """Why a recording cannot be diagnosed; empty if it can. Of several tendons those that move count."""
    where, found = part.path, []
    fewest = fewest_of(part)
    if part.samples < fewest:
        found.append(f"{where}: {part.samples} samples are too few to diagnose; record {fewest} or more")
    moved = [i for i, drive in enumerate(part.drives) if np.ptp(drive.T_base) > 0]
    if not moved:
        what = "base tension" if part.pulled else "displacement at the base"
        remedy = "is its cell connected?" if part.pulled else "was it driven?"
        return [*found, f"{where}: the {what} never changes; {remedy}"]
    cells = moved if part.tips else []
    still = [i for i in cells if np.ptp(part.recorded[i]) <= 0]
    if still:
        whose = words_for(part, still[0])
        return [*found, f"{where}: the tip tension{whose} never changes; is its cell connected?"]
    if part.time is not None and np.any(np.diff(part.time) < 0):
        late = [f"{where}: time_s goes back; put the rows in the order of time"]
    else:
        late = []
    for i in cells:
        found += _of_tendon(part, i, late if i == moved[0] else [])
    return found if cells else [*found, *late]


def _of_tendon(part: Observation, i: int, late: list[str]) -> list[str]:
    """What is wrong with the tensions of one tendon; `late` comes before what concerns its tip alone."""
    T, tip, whose = part.drives[i].T_base, part.recorded[i], words_for(part, i)
    where, found = part.path, []
    if part.robot.tendons[i].drive == "tension":
        taut = T > 0.3 * T.max()
        ratio = float(np.median(tip[taut] / T[taut]))
        rising = taut & (np.gradient(T) > 0)
        pulled = float(np.median(tip[rising] / T[rising])) if rising.sum() > 3 else ratio
        # Beside others, one that gives way may be dragged, and be tightest at its tip.
        if ratio > SWAPPED and pulled > SWAPPED and (not part.others or i == leading(part)):
            found.append(
                f"{where}: the tip{whose} reads {ratio:.3g} times the base even while pulling, which "
                "friction cannot do; swap the columns, or check units and gains"
            )
        if abs(tip).max() < LOST * abs(T).max():
            found.append(
                f"{where}: the tip{whose} reads at most {abs(tip).max():.3g} N, the base {abs(T).max():.3g} "
                "N; check the units of both columns"
            )
        if pulled < 0:
            found.append(f"{where}: the tip tension{whose} has the other sign; change it")
    found += late
    follows = max(float(np.corrcoef(_held_back(T, share), tip)[0, 1]) for share in HELD_BACK)
    if follows < LEAST and not part.others:
        found.append(
            f"{where}: the tip does not follow the base, whatever friction is assumed (correlation "
            f"{follows:.2f}); do both columns come from one run?"
        )
    held = np.isclose(tip, tip.max(), atol=1e-12).mean()
    if held > STUCK:
        found.append(
            f"{where}: the tip cell{whose} shows its largest value in {100 * held:.0f} % of samples; it is "
            "stuck, or overloaded"
        )
    return found
