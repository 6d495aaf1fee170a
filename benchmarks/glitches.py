"""Which spoilt readings the rule of `gtr_jax.recordings.cleaning.glitches` finds, and what it masks wrongly:
`python -m benchmarks.glitches` writes results/glitches.md; `... SEED COUNT` prints the same of others.

Recordings are driven, disturbed and read as in the blind benchmark (`blind/hand.py`, `events.py`,
`instruments.py`), but their tip tension comes from a chain of stiff links with Coulomb friction, which takes
milliseconds. So there may be hundreds of them, and none is a case of that benchmark. The rule was developed
on seeds 501 and 502.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gtr_jax.recordings.cleaning.glitches import find_glitches

from .blind import events
from .blind.hand import drive, log_uniform
from .blind.instruments import CELLS, Read, read

SEED, COUNT = 7001, 300
# Links of the chain; shares of the recordings with events, and with bursts of stick-slip.
LINKS, EVENTFUL, BURSTING = 4, 0.6, 0.2
RESULT = Path(__file__).with_name("results") / "glitches.md"


class Drawn(NamedTuple):
    """A recording: what was read of the cells [N], what they ideally show, and the largest tension [N]."""

    read: Read
    true: dict[str, np.ndarray]
    largest: float
    rate: float
    happened: list[events.Event]


def tips(
    rng: np.random.Generator, time: np.ndarray, T_base: np.ndarray, happened: list[events.Event], most: float
) -> np.ndarray:
    """Tip tension [N], (K,), of a base tension [N], (K,), up to `most`: links that each hold until
    T_(i+1) leaves T_i exp(-a) to T_i exp(a), where a is the link's share of the friction.

    Moving the tip's end by a share of the thread that the arm takes up changes T_tip by that share of `most`.
    """
    whole = rng.uniform(0.2, 1.1)
    static = 1 + (rng.uniform(0.05, 0.4) if rng.random() < BURSTING else 0.0)
    friction = np.full(len(time), whole / LINKS)
    feed = np.zeros(len(time))
    for event in happened:
        friction *= [event.friction(t) for t in time.tolist()]
        feed += [event.feed(t) for t in time.tolist()]
    T = [float(T_base[0]) * math.exp(-whole * (i + 1) / LINKS) for i in range(LINKS)]
    found = np.empty(len(time))
    moved = np.diff(feed, prepend=0.0) * most
    for k, (base, a, given) in enumerate(
        zip(T_base.tolist(), friction.tolist(), moved.tolist(), strict=True)
    ):
        low, high = math.exp(-a), math.exp(a)
        if given:
            T[-1] = min(max(T[-1] - given, base * low**LINKS), base * high**LINKS)
            for i in range(LINKS - 2, -1, -1):
                T[i] = min(max(T[i], T[i + 1] * low), T[i + 1] * high)
        before = base
        for i in range(LINKS):
            # What holds lets go at more than it slips at.
            if not before * low**static <= T[i] <= before * high**static:
                T[i] = min(max(T[i], before * low), before * high)
            before = T[i]
        found[k] = before
    return found


def draw(rng: np.random.Generator) -> Drawn:
    """Draw a recording."""
    largest = log_uniform(rng, 8, 45)
    driven = drive(rng, largest)
    time = driven.sampled
    happened = events.draw(rng, driven, 1.0) if rng.random() < EVENTFUL else []
    T_base = np.interp(time, driven.time, driven.T_base)
    T_base = T_base * np.prod([e.pull(time) for e in happened], axis=0)
    true = {"T_base": T_base, "T_tip": tips(rng, time, T_base, happened, largest)}
    return Drawn(read(rng, time, true, largest), true, largest, len(time) / float(time[-1]), happened)


def recordings(seed: int, count: int) -> Iterator[Drawn]:
    """So many recordings."""
    for child in np.random.SeedSequence(seed).spawn(count):
        yield draw(np.random.default_rng(child))


def sound(rng: np.random.Generator, drawn: Drawn) -> dict[str, np.ndarray]:
    """The same recording as read by instruments that spoil nothing: with noise and grain of the same size."""
    found = {}
    for cell, values in drawn.true.items():
        noisy = values + drawn.read.told["noise_N"][cell] * rng.normal(size=len(values))
        grain = drawn.read.told["grain_N"][cell]
        found[cell] = (grain * np.round(noisy / grain))[drawn.read.kept]
    return found


def kinds(spoilt: dict[str, dict[str, list[int]]]) -> dict[tuple[str, int], str]:
    """Of every spoilt reading, by cell and sample, its kind: what it is, how many samples long, where."""
    found = {}
    for cell, other in (CELLS, CELLS[::-1]):
        for kind, rows in spoilt[cell].items():
            at = np.unique(rows).astype(int)
            for own in np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if at.size else ():
                n = "1", "2", "3", "4 to 8"
                cells = "both cells" if own[0] in spoilt[other][kind] else "one cell"
                label = f"{kind}, {n[min(len(own), 4) - 1]} samples, {cells}".replace(
                    " 1 samples", " 1 sample"
                )
                found |= dict.fromkeys(((cell, k) for k in own.tolist()), label)
    return found


def measured(seed: int, count: int) -> str:
    """The table, as Markdown."""
    there, hit, wrong, extra = Counter[str](), Counter[str](), 0, 0
    readings, samples = 0, 0
    rng = np.random.default_rng(seed)
    for drawn in recordings(seed, count):
        spoilt = kinds(drawn.read.spoilt)
        left_out = masked(drawn.read.cells, drawn.read.time)
        there.update(spoilt.values())
        hit.update(spoilt[own] for own in left_out & spoilt.keys())
        wrong += len(left_out - spoilt.keys())
        samples += len(drawn.read.time)
        readings += 2 * len(drawn.read.time)
        extra += len(masked(sound(rng, drawn), drawn.read.time))
    found = sum(hit.values())
    rows = [
        f"| {kind} | {hit[kind]} | {there[kind]} | {_share(hit[kind], there[kind])} |"
        for kind in sorted(there)
    ]
    return "\n".join(
        [
            f"Of {count} recordings of 20 to 100 Hz ({samples:,} samples; seed {seed}), {there.total():,} "
            f"of {readings:,} readings were spoilt. Recall {_share(found, there.total())}; precision "
            f"{_share(found, found + wrong)}: {wrong} sound readings were masked. Of the same recordings "
            f"with nothing spoilt, {extra} readings were masked.",
            "",
            "| spoilt | found | of | recall |",
            "|---|---|---|---|",
            *rows,
            "",
        ]
    )


def masked(cells: dict[str, np.ndarray], time: np.ndarray) -> set[tuple[str, int]]:
    """Readings that the rule masks, by cell and sample."""
    found = find_glitches(cells, time)
    return {(g.channel, k) for g in found for k in range(g.first, g.last + 1)}


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "–"


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print(measured(int(sys.argv[1]), int(sys.argv[2])))
    else:
        RESULT.write_text(measured(SEED, COUNT), encoding="utf-8")
