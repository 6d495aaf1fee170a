"""What happens to a rig from outside, found from its readings before any effect is tried: the tip tension
moves faster than what the base does can move it; and gaps, after which nobody knows what friction holds.

A tendon with friction passes on changes of its base tension with a slope that the model knows roughly (more
than one where it is let go), and holds them back in between. If the tip tension rises within half a second
by more than the rises of the base tension allow, or falls by more than its falls, its end was moved or the
sheath was shaken; what follows remembers it until the tendon slips through again. Left in, two events of 0.1
to 0.3 s in a recording of 70 s, wrong for 6 s afterwards, made the friction coefficient wrong by 16 % and
every effect unlikely (docs/diagnosis-history.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from calibrate.inference.setup import Observation
from calibrate.inference.simulated_readings import SimulatedReadings
from gtr_jax.recordings.signals import differences
from gtr_jax.recordings.signals.differences import MAD_TO_SD

from .episodes import GAPS
from .leave_out import Stretch, joined

# Windows in which changes are compared [s]; how far the base tension is looked at beyond them, for cells that
# are read at different times [s].
WINDOWS, ASIDE = (0.06, 0.12, 0.25, 0.5), 0.03
# Readings of which a median is taken: glitches of up to three readings do not count.
MEDIAN = 7
# Standard deviations of its noise, and share of the largest tip tension, that a change has to exceed what the
# base allows by; standard deviations of the base cell by which its tension may have moved unseen.
LEAST, SEEN, UNSEEN = 8.0, 0.015, 2.0
# What the tip may do by more than the slope of the base model says, and the least slope that is reckoned
# with.
MARGIN, FLATTEST = 1.2, 1.2
# Where there are more than a few, the slope is raised by a step until no more are left: most are a law that
# the model lacks; all of them if so many steps do not suffice. Most of a recording that is left out.
FEW, STEP, STEPS, MOST = 6, 1.25, 12, 0.35
# Changes less than this apart are one [s].
APART = 0.5
# Quantile of the slopes of the model that counts as its largest.
LARGEST = 0.995
# A tendon is slack below this share of the largest base tension; a gap counts if the base tension, as fast as
# within so long before and after it [s], may have moved by this share of its largest meanwhile.
SLACK, NEARBY, COUNTS = 0.02, 1.0, 0.01
# Shortest gap, and time over which rates are taken [s].
SHORTEST = 0.1
# Times the usual misfit within which a simulation has met the recording again, and within which a change
# begins or ends on the simulation.
MEETS, NEAR = 1.0, 2.0


def disturbances(
    part: Observation, thinned: Observation, seen: SimulatedReadings, slope: np.ndarray, delay: float = 0.0
) -> list[Stretch]:
    """Stretches of a recording in which the tip tension moves as the base tension cannot move it, each up to
    where the tendon has forgotten it. A change that begins away from the simulation and ends on it is not
    counted: the tip caught up, as it does when static friction breaks.

    Args:
        part: the recording, with time, of one tendon that tension drives.
        thinned: those samples of it that are simulated.
        seen: the simulation.
        slope: simulated change of the tip tension per change of the base tension, (K,), of those.
        delay: by which the cells are apart [s].
    """
    if part.time is None or _step(part.time) <= 0 or part.samples < 2 * MEDIAN:
        return []
    sliding = np.abs(slope[seen.slips]) if seen.slips.any() else np.zeros(1)
    steepest, found = max(FLATTEST, MARGIN * float(np.quantile(sliding, LARGEST))), list[_Sudden]()
    for _ in range(STEPS):
        found = _sudden(part, steepest, delay)
        if len(found) <= FEW:
            break
        steepest *= STEP
    else:
        return []
    off, usual = _misfit(thinned, seen)
    met, stretches = _met(thinned, seen), list[Stretch]()
    for change in found:
        ends = np.searchsorted(thinned.places, part.places[[change.first, change.last]]) - (1, 0)
        before, behind = np.abs(off[np.clip(ends, 0, thinned.samples - 1)]) > NEAR * usual
        known = not part.counted[change.start : change.end + 1].all()
        if not known and (behind or not before):
            stretches.append(_moved(part, change, _forgotten(part, met, change.last)))
    return stretches


def behind_gaps(part: Observation, thinned: Observation, seen: SimulatedReadings) -> list[Stretch]:
    """Stretches after gaps of a recording, each up to where the tendon has forgotten what it did in the gap;
    arguments as of `disturbances`. None where the base tension hardly moves or the tendon is slack.
    """
    if part.time is None or _step(part.time) <= 0:
        return []
    time, T_base, found = part.time, part.T_base.T_base, list[Stretch]()
    met = _met(thinned, seen)
    steps, largest = np.diff(time), float(np.max(T_base))
    # Rates over a while, because noise moves neighbouring readings.
    rates = np.abs(np.interp(time + SHORTEST, time, T_base) - T_base) / SHORTEST
    usual = max(_step(time), float(np.median(steps[steps > 0])))
    alone, long = np.diff(part.places) == 1, steps > max(GAPS * usual, SHORTEST)
    for k in np.flatnonzero(alone & long).tolist():
        low, before, after, high = np.searchsorted(
            time, (time[k] - NEARBY, time[k] - SHORTEST, time[k + 1], time[k + 1] + NEARBY)
        )
        fastest = float(np.max(np.concatenate([rates[low:before], rates[after:high]]), initial=0.0))
        if max(T_base[k], T_base[k + 1]) < SLACK * largest or fastest * steps[k] < COUNTS * largest:
            continue
        if part.counted[k + 1]:
            last = _forgotten(part, met, k + 1)
            why = f"after a gap of {steps[k]:.2g} s in the recording, in which the load is not known"
            found.append(Stretch(int(part.places[k + 1]), last, why))
    return found


def within(stretches: Sequence[Stretch], samples: int) -> list[Stretch]:
    """Stretches as long as together they are not too much of a recording of so many samples, the shortest
    first; those that overlap as one.
    """
    kept, room = list[Stretch](), MOST * samples
    for s in sorted(joined(stretches), key=lambda s: s.last - s.first):
        room -= s.last - s.first + 1
        if room >= 0:
            kept.append(s)
    return sorted(kept)


def _step(time: np.ndarray) -> float:
    """Mean step in time [s]: many clocks are coarser than the sampling."""
    return float(time[-1] - time[0]) / max(len(time) - 1, 1)


def _misfit(thinned: Observation, seen: SimulatedReadings) -> tuple[np.ndarray, float]:
    """Simulated minus recorded tip tension [N], (K,), and its usual size."""
    off = seen.values[0] - thinned.recorded[0]
    return off, MAD_TO_SD * float(np.median(np.abs(off[thinned.counted])))


class _Sudden(NamedTuple):
    """A change of the tip tension: its first and last sample by all windows, and by the shortest that shows
    it.
    """

    first: int
    last: int
    start: int
    end: int


def _sudden(part: Observation, steepest: float, delay: float) -> list[_Sudden]:
    """Changes of the tip tension beyond what changes of the base tension with a slope explain."""
    time, T_base, K = np.asarray(part.time), part.T_base.T_base, part.samples
    tip = median_filter(part.recorded[0], MEDIAN, mode="nearest")
    noise = differences.from_differences(part.recorded[0])
    least = max(LEAST * noise, SEEN * float(np.max(tip))) + steepest * UNSEEN * part.T_base.sd
    usual = _step(time)
    aside, steps = int(np.ceil((ASIDE + abs(delay)) / usual)), np.diff(T_base, prepend=T_base[0])
    # The tip follows the base's rises with its own, and its falls.
    risen, fallen = np.cumsum(np.maximum(steps, 0.0)), np.cumsum(np.maximum(-steps, 0.0))
    out, shortest = np.zeros(K, bool), np.full(K, K)
    for n in sorted({max(2, round(window / usual)) for window in WINDOWS}):
        if n >= K:
            continue
        a, b = np.arange(K - n), np.arange(n, K)
        before, behind = np.maximum(a - aside, 0), np.minimum(b + aside, K - 1)
        change = tip[b] - tip[a]
        allowed = np.where(change > 0, risen[behind] - risen[before], fallen[behind] - fallen[before])
        beyond = np.abs(change) - steepest * allowed > least
        # Over a gap anything may have happened at the base.
        for k in np.flatnonzero(beyond & (time[b] - time[a] < 1.5 * n * usual)):
            out[a[k] : b[k] + 1] = True
            shortest[a[k] : b[k] + 1] = np.minimum(shortest[a[k] : b[k] + 1], n)
    at = np.flatnonzero(out)
    groups = np.split(at, 1 + np.flatnonzero(np.diff(time[at]) > APART)) if at.size else []
    found = []
    for g in groups:
        core = g[shortest[g] == shortest[g].min()]
        found.append(_Sudden(int(g[0]), int(g[-1]), int(core[0]), int(core[-1])))
    return found


def _met(thinned: Observation, seen: SimulatedReadings) -> np.ndarray:
    """Places at which the simulation slips at the tip and meets the recording from the side on which friction
    holds it, increasing.
    """
    off, usual = _misfit(thinned, seen)
    pulling, releasing = seen.slips & (seen.direction > 0), seen.slips & (seen.direction < 0)
    return thinned.places[(pulling & (off >= -MEETS * usual)) | (releasing & (off <= MEETS * usual))]


def _forgotten(part: Observation, met: np.ndarray, last: int) -> int:
    """Place of the first of those in `met` after sample `last`; the end of the recording without one."""
    end = int(part.places[last])
    again = met[met > end]
    return max(int(again[0]) if again.size else int(part.places[-1]), end)


def _moved(part: Observation, change: _Sudden, until: int) -> Stretch:
    """A change and what follows it, up to a place."""
    time, T_base, T_tip = np.asarray(part.time), part.T_base.T_base, part.recorded[0]
    first, last = change.start, change.end
    why = (
        f"{time[first]:.4g} to {time[last]:.4g} s: T_tip goes from {T_tip[first]:.3g} to {T_tip[last]:.3g} N "
        f"while T_base goes from {T_base[first]:.3g} to {T_base[last]:.3g} N, which cannot move it so far: "
        "was the tip end moved, or the sheath shaken?"
    )
    return Stretch(int(part.places[change.first]), until, why, outside=True)
