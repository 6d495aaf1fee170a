"""Glitches and dropouts of a recorded channel: samples that the amplifier made, not the tendon.

A tension goes where it goes through the samples between. What leaves and is back after one to WIDEST
samples, farther than anything around it moves, did not happen. Samples a..b of a channel x are a *glitch* if
all of these hold. *Sound* are the samples that are in no glitch. Where x may be between two sound samples is
the span of their two values, of the line through the last two sound samples before, and of the line through
the first two after, drawn over evenly spaced samples and over the stamps; D is how far outside all of a..b
are at least. So a step, a ramp, a turning point however sharp, and a swing, even of a few samples, are none.

1. D is above the noise and the resolution: above NOISES standard deviations of the noise (from third
   differences, by the median), and LOCALLY of that of the LOCAL sound samples before and after it; above
   BENDS times the median of those second differences that are not 0, and SHARE of the channel's range
   (between its 1st and 99th percentile).
2. It returns: x after it is, to half of the distance of a..b from the line through the neighbours, x before
   it, or where the line before leads; or x before it is where the line after comes from.
3. Nothing around it is as odd: D is above JERKS times that of each of the AROUND sound samples before and
   after it, and above SLOPES times the largest step among the BESIDE before and after it.
4. If another channel leaves at the same samples, both may have moved truly. Friction tells of the two cells
   of a tendon: a tip that goes up with the base slips forward, so that T_tip/T_base is then in the lower half
   of what the recording has seen of it, and comes down again only from the upper half; and the reverse. If
   both move the same way and so, or if the other channel is not a cell of the same tendon, D has to be above
   TOGETHER times the largest step of the whole channel, too.
5. It is isolated: of the NEARBY samples before and after it, glitches are no more than CROWDED and WIDEST
   samples. So a channel that bursts all the time has none.
6. No gap of the time stamps, GAP times the median interval, lies between its neighbours.

Samples beside a glitch for which 1. to 4. hold together with it, seen from the sound samples around all of
them, belong to it, however much smaller they are: up to MOST samples. Of excursions that share samples the
one that stands out most is judged, and where that is not a glitch the others.

Beside a glitch of the other cell of the tendon, at the same samples, FELLOW of the limits in 1. is enough.

A glitch down to exactly 0, or to a lowest value that the channel reaches more than once, is a *dropout*. In a
channel with noise, dropouts to 0 may last up to LONGEST samples, if these are no more than RARE of all: then
D is that of their ends, each seen from its own side, and 4. does not apply: a supply that fails takes all
cells along. Samples without a number (NaN) are dropouts too. At both ends of a channel, where a neighbour is
missing, nothing is a glitch.

Where all cells that have noise, two or more, read exactly 0 at the same SUPPLY to LONGEST samples, with
others before and after, those are dropouts whatever lies around them, if noise about 0 does not do that: if
so many zeros in a row are expected fewer than CHANCE times in the recording. One reading of a slack cell is 0
as often as white noise makes it in steps of its resolution, or, where that is more and FAMILIAR zeros tell,
as often as one 0 follows another elsewhere. A cell whose steps are coarser than its noise rests at 0 and
tells nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from gtr_jax.recordings.signals.differences import from_differences

from .excursions import GAP, LONGEST, MOST, WIDEST, Channel, apart, beyond, channel, chord, excursions, runs
from .outliers import outliers

NEARBY, CROWDED = 50, 0.15
FELLOW = 0.7
SUPPLY, CHANCE, FAMILIAR = 3, 1e-4, 20
LOADED = 0.1  # share of the largest base tension above which the ratio of the cells counts
_ROUNDS = 10  # of leaving out what turned out to be no glitch


class Glitch(NamedTuple):
    """Samples that did not happen.

    Attributes:
        channel: its name.
        first, last: the samples' indices, both included.
        size: the deviation that is largest, with its sign, in the channel's unit; NaN of missing numbers.
        kind: "glitch" or "dropout".
    """

    channel: str
    first: int
    last: int
    size: float
    kind: str


class _Cone(NamedTuple):
    """Both cells of a tendon, (K,) each, and T_tip/T_base where the tendon is loaded: as low as it gets, in
    the middle, and as high; `slack` is the base tension below which the ratio tells nothing.
    """

    base: np.ndarray
    tip: np.ndarray
    low: float
    middle: float
    high: float
    slack: float


def find_glitches(channels: Mapping[str, np.ndarray], time: np.ndarray | None) -> list[Glitch]:
    """Glitches and dropouts by the rule above, in the order of the samples.

    Args:
        channels: readings by name, (K,) each, in any unit; NaN where a number is missing. T_base and T_tip,
            or T_base.left and T_tip.left, are the cells of a tendon.
        time: of the samples [s], (K,), or None.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # readings of 1e308; nothing infinite is a glitch
        return _found(channels, time)


def _found(channels: Mapping[str, np.ndarray], time: np.ndarray | None) -> list[Glitch]:
    arrays = {name: np.asarray(values, dtype=float) for name, values in channels.items()}
    stamps = None if time is None else np.asarray(time, dtype=float)
    read = {name: channel(values, stamps) for name, values in arrays.items()}
    spans = {}
    for name in read:
        spans[name] = _wider(name, *_of_channel(name, read, arrays, stamps), read, arrays, stamps)
    found = [glitch for name, values in arrays.items() for glitch in _missing(name, values)]
    for name, own in read.items():
        found += _told(name, own, *spans[name])
        fellow = _fellow(name)
        if fellow in spans:
            found += _told(name, own, *_beside(own, *spans[name], read[fellow], *spans[fellow]))
    found += _of_the_supply(arrays, read, found)
    return sorted(found, key=lambda glitch: (glitch.first, glitch.channel))


def _of_channel(
    name: str,
    read: Mapping[str, Channel],
    arrays: Mapping[str, np.ndarray],
    stamps: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """First and last samples of a channel's glitches. Of excursions that share samples one is judged; where
    it is none, the others are.
    """
    own = read[name]
    every = _without_gaps(*excursions(own), own, stamps)
    for _ in range(_ROUNDS):
        first, last = apart(own.x, *every)
        zero = (own.x[first] == 0.0) & (own.x[last] == 0.0) & own.noisy
        shared = _shared(name, first, last, read, arrays) & ~zero
        kept = _isolated(own, first, last, shared)
        good = set(zip(*kept, strict=True))
        none = set(zip(first, last, strict=True)) - good
        inside = np.zeros(len(own.x) + 1, dtype=int)
        for a, b in none:
            inside[a + 1 : b + 2] = 1
        inside = np.cumsum(inside)
        # Those that only lie beside what is none stay out: they would take it for sound.
        again = inside[every[1] + 1] > inside[every[0]]
        spans = zip(*every, again.tolist(), strict=True)
        left = [(a, b) for a, b, shares in spans if (a, b) in good or (shares and (a, b) not in none)]
        if len(left) == len(good):
            break
        every = np.asarray([a for a, _ in left]), np.asarray([b for _, b in left])
    return kept


def _wider(
    name: str,
    first: np.ndarray,
    last: np.ndarray,
    read: Mapping[str, Channel],
    arrays: Mapping[str, np.ndarray],
    stamps: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Glitches with the samples beside them that are out of what the sound ones allow as well, though by
    less, up to MOST samples; those that meet are one.
    """
    own = read[name]
    n = len(own.x)
    for more in range(MOST - 1, 0, -1):
        for before in range(more + 1):
            a, b = first - before, last + more - before
            fits = np.flatnonzero((a > 0) & (b < n - 1) & (b - a < MOST))
            fits = fits[_leaves(own, a[fits], b[fits])]
            if not fits.size:
                continue
            wider = _without_gaps(a[fits], b[fits], own, stamps)
            shared = _shared(name, *wider, read, arrays)
            starts, ends = (np.concatenate(both) for both in zip(wider, (first, last), strict=True))
            shared = np.concatenate([shared, np.zeros(len(first), dtype=bool)])
            holds = outliers(own, starts, ends, np.ones(len(starts), dtype=bool), shared)[: len(wider[0])]
            found = dict(zip(wider[0][holds].tolist(), wider[1][holds].tolist(), strict=True))
            for i in fits.tolist():
                if found.get(int(a[i])) == b[i]:
                    first[i], last[i] = a[i], b[i]
    return _merged(first, last)


def _leaves(own: Channel, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Whether all samples of runs are off both of their neighbours by more than the noise, (m,) bool."""
    off = np.full(len(first), np.inf)
    for offset in range(MOST):
        x = own.x[np.minimum(first + offset, last)]
        np.minimum(off, beyond(x, [own.x[first - 1], own.x[last + 1]]), out=off)
    return off > own.limit


def _merged(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Runs of samples, in order, those that share samples or meet as one."""
    starts, ends = [], []
    for a, b in sorted(zip(first.tolist(), last.tolist(), strict=True)):
        if ends and a <= ends[-1] + 1:
            ends[-1] = max(ends[-1], b)
        else:
            starts.append(a)
            ends.append(b)
    return np.asarray(starts, dtype=int), np.asarray(ends, dtype=int)


def _fellow(name: str) -> str:
    """The other cell of the same tendon."""
    kind, dot, tendon = name.partition(".")
    return {"T_base": "T_tip", "T_tip": "T_base"}.get(kind, "") + dot + tendon


def _missing(name: str, values: np.ndarray) -> list[Glitch]:
    first, last = runs(~np.isfinite(values))
    return [Glitch(name, int(a), int(b), float("nan"), "dropout") for a, b in zip(first, last, strict=True)]


def _of_the_supply(
    arrays: Mapping[str, np.ndarray], read: Mapping[str, Channel], known: list[Glitch]
) -> list[Glitch]:
    """Dropouts of all cells at once, where they are not known already."""
    kinds = ("T_base", "T_tip")
    cells = [name for name in arrays if name.partition(".")[0] in kinds and read[name].noisy]
    if len(cells) < 2:
        return []
    first, last = runs(np.all([arrays[name] == 0.0 for name in cells], axis=0))
    long = (last - first + 1 >= SUPPLY) & (last - first < LONGEST)
    first, last = first[long].tolist(), last[long].tolist()
    if not first:
        return []
    elsewhere = np.ones(len(arrays[cells[0]]), dtype=bool)
    for a, b in zip(first, last, strict=True):
        elsewhere[a : b + 1] = False
    often = float(np.prod([_zeros(arrays[name], read[name], elsewhere) for name in cells]))
    found = []
    for a, b in zip(first, last, strict=True):
        if len(elsewhere) * often ** (b - a + 1) >= CHANCE:
            continue
        places = {name: np.searchsorted(read[name].at, (a, b)) for name in cells}
        sizes = {name: _off_line(read[name], int(p), int(q)) for name, (p, q) in places.items()}
        if not any(abs(size) > read[name].limit for name, size in sizes.items()):
            continue
        taken = {g.channel for g in known if g.first <= b and a <= g.last}
        found += [Glitch(name, a, b, sizes[name], "dropout") for name in cells if name not in taken]
    return found


def _zeros(x: np.ndarray, own: Channel, elsewhere: np.ndarray) -> float:
    """How often a reading of a slack cell is exactly 0, at most."""
    step = float(np.min(np.diff(np.unique(own.x)), initial=np.inf))
    share = min(1.0, step / (np.sqrt(2 * np.pi) * from_differences(own.x)))
    zeros = (x[:-1] == 0.0) & elsewhere[:-1] & elsewhere[1:]
    if zeros.sum() >= FAMILIAR:
        share = max(share, float(np.mean(x[1:][zeros] == 0.0)))
    return share


def _off_line(own: Channel, a: int, b: int) -> float:
    """The largest deviation of samples a to b from the line through their neighbours, with its sign; 0 at an
    end of the channel.
    """
    if a == 0 or b == len(own.x) - 1:
        return 0.0
    off = own.x[a : b + 1] - chord(own.x, a, b, np.arange(a, b + 1))
    return float(off[np.argmax(np.abs(off))])


def _isolated(
    own: Channel, first: np.ndarray, last: np.ndarray, shared: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """First and last samples of the excursions that are glitches."""
    kept = np.ones(len(first), dtype=bool)
    for _ in range(_ROUNDS if len(first) else 0):
        sound = outliers(own, first, last, kept, shared)
        sound &= ~_crowded(first, last, kept & sound, len(own.x))
        if np.array_equal(sound & kept, kept):
            break
        kept &= sound
    return first[kept], last[kept]


def _told(name: str, own: Channel, first: np.ndarray, last: np.ndarray) -> list[Glitch]:
    """Glitches as they are told."""
    x, at = own.x, own.at
    lowest = x.min(initial=np.inf)
    again = np.count_nonzero(x == lowest) > 1
    found = []
    for a, b in zip(first, last, strict=True):
        down = np.all(x[a : b + 1] == 0.0) or (again and np.all(x[a : b + 1] == lowest))
        kind = "dropout" if down and abs(x[a - 1]) > abs(x[a]) else "glitch"
        found.append(Glitch(name, int(at[a]), int(at[b]), _off_line(own, a, b), kind))
    return found


def _without_gaps(
    first: np.ndarray, last: np.ndarray, own: Channel, time: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Those of which no gap of the time stamps cuts off a neighbour."""
    if time is None or not first.size:
        return first, last
    intervals = np.diff(time)
    usual = np.nanmedian(intervals) if np.any(np.isfinite(intervals)) else np.nan
    before, after = own.at[first - 1], own.at[last + 1]
    whole = ~(time[after] - time[before] > (GAP - 1 + (after - before)) * usual)
    return first[whole], last[whole]


def _shared(
    name: str,
    first: np.ndarray,
    last: np.ndarray,
    read: Mapping[str, Channel],
    arrays: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Whether another channel may truly have moved with each excursion, (m,) bool."""
    own, fellow = read[name], _fellow(name)
    x, at = own.x, own.at
    found = np.zeros(len(first), dtype=bool)
    if not first.size:
        return found
    cone = _cone(arrays[name], arrays[fellow], base=name.startswith("T_base")) if fellow in read else None
    for other in arrays.keys() - {name}:
        y = arrays[other][at]
        half = 0.5 * np.abs(y[first - 1] - y[last + 1])
        leaves = np.zeros(len(first), dtype=bool)
        truly = np.ones(len(first), dtype=bool)
        for offset in range(MOST):
            k = np.minimum(first + offset, last)
            off = y[k] - chord(y, first, last, k)
            leaves |= np.abs(off) - half > read[other].limit
            truly &= off * (x[k] - chord(x, first, last, k)) > 0
        if other == fellow and cone is not None:
            leaves &= truly & _rubbing(cone, at, first, last, own.limit + read[other].limit)
        found |= leaves
    return found


def _cone(own: np.ndarray, other: np.ndarray, *, base: bool) -> _Cone:
    """What a recording has seen of the ratio of two cells; `base` is whether the first is the base's."""
    T_base, T_tip = (own, other) if base else (other, own)
    whole = np.isfinite(T_base) & np.isfinite(T_tip)
    slack = LOADED * float(np.max(T_base[whole], initial=0.0))
    loaded = whole & (T_base > slack)
    ratios = T_tip[loaded] / T_base[loaded]
    low, middle, high = np.percentile(ratios, [1.0, 50.0, 99.0]) if ratios.size else (-np.inf, 0.0, np.inf)
    return _Cone(T_base, T_tip, float(low), float(middle), float(high), slack)


def _rubbing(cone: _Cone, at: np.ndarray, first: np.ndarray, last: np.ndarray, near: float) -> np.ndarray:
    """Whether the cells' ratio is where friction has it in a true move up and back, or down and back, to
    within `near` [N], (m,) bool.
    """
    base, tip = cone.base[at], cone.tip[at]
    up = base[first] > base[first - 1]
    found = np.ones(len(first), dtype=bool)
    for offset in range(MOST):
        k = np.minimum(first + offset, last)
        low = np.where(up, cone.low, cone.middle) * base[k]
        high = np.where(up, cone.middle, cone.high) * base[k]
        found &= (tip[k] >= low - near) & (tip[k] <= high + near)
    around = 0.5 * (base[first - 1] + base[last + 1])
    over = 0.5 * (tip[first - 1] + tip[last + 1]) - cone.middle * around
    return found & ((around < cone.slack) | np.where(up, over >= -near, over <= near))


def _beside(
    own: Channel,
    first: np.ndarray,
    last: np.ndarray,
    fellow: Channel,
    starts: np.ndarray,
    ends: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """First and last samples of what is a glitch because the other cell has one there, from `starts` to
    `ends` of its samples.
    """
    a, b = (np.searchsorted(own.at, fellow.at[k]) for k in (starts, ends))
    taken = np.zeros(len(own.x) + 2, dtype=bool)
    for p, q in zip(first, last, strict=True):
        taken[p : q + 3] = True
    covered = np.concatenate([[0], np.cumsum(taken)])
    fits = (a > 0) & (b < len(own.x) - 1) & (b - a == fellow.at[ends] - fellow.at[starts])
    fits &= covered[np.minimum(b + 2, len(taken))] == covered[np.minimum(a + 1, len(taken))]
    a, b = a[fits], b[fits]
    if not a.size:
        return a, b
    a, b = np.concatenate([a, first]), np.concatenate([b, last])
    whole = np.ones(len(a), dtype=bool)
    held = outliers(own, a, b, whole, ~whole, FELLOW)
    held[len(a) - len(first) :] = False
    return a[held], b[held]


def _crowded(first: np.ndarray, last: np.ndarray, kept: np.ndarray, n: int) -> np.ndarray:
    """Whether more than CROWDED of the samples around each excursion lie in those that are kept."""
    ends = np.concatenate([[0], np.cumsum((last - first + 1) * kept)])
    low, high = np.maximum(first - NEARBY, 0), np.minimum(last + NEARBY, n - 1)
    inside = ends[np.searchsorted(first, high, side="right")] - ends[np.searchsorted(last, low, side="left")]
    return inside > CROWDED * (high - low + 1) + WIDEST
