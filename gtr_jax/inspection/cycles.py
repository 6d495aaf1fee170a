"""Cycles of the load: pulls, peaks, inner loops, repeats, and the rates at which they run."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from gtr_jax.recordings.signals.stretches import Stretch, stretches
from gtr_jax.recordings.signals.turning import turning_points

# A pull rises by this share of the range of the base tension; one that starts above this share was not
# released fully before: an inner loop.
PULL, RELEASED = 0.10, 0.05
# Two cycles repeat one another if both their ends agree within this share of the range.
ALIKE = 0.05
RATES = (5, 50, 95)


@dataclasses.dataclass(frozen=True)
class Cycle:
    """A pull and the release after it.

    Attributes:
        where: from the valley before to the valley after.
        peak: sample of the peak.
        from_N, peak_N, to_N: base tension at the valley before, the peak and the valley after.
        tip_N: tip tension at the peak.
        pull_N_per_s, release_N_per_s: mean rates; None without a clock.
        inner: whether it starts before the tension was released.
    """

    where: Stretch
    peak: int
    from_N: float
    peak_N: float
    to_N: float
    tip_N: float
    pull_N_per_s: float | None
    release_N_per_s: float | None
    inner: bool


@dataclasses.dataclass(frozen=True)
class Cycles:
    """The load history.

    Attributes:
        cycles: in their order.
        inner: number of cycles that start before the tension was released.
        repeats: numbers, from 1, of the cycles of the largest group that repeat one another.
        rates_N_per_s: percentiles of the size of the rate of the base tension while it moves, by percentage;
            empty without a clock.
        decades: how many powers of ten lie between the 5th and the 95th of them; None without a clock.
    """

    cycles: tuple[Cycle, ...]
    inner: int
    repeats: tuple[int, ...]
    rates_N_per_s: dict[str, float]
    decades: float | None


def cycles(
    T_base: np.ndarray, T_tip: np.ndarray, time: np.ndarray | None, *, turns: np.ndarray, moves: np.ndarray
) -> Cycles:
    """The cycles of a load history.

    Args:
        T_base, T_tip: [N], (K,).
        time: [s], (K,), or None.
        turns: turning points of the base tension, and both ends.
        moves: rates of the base tension [N/s] while it moves, (n,).
    """
    reach = float(np.ptp(T_base))
    low = float(np.min(T_base))
    kept = _large(T_base, turns, PULL * reach)
    found = []
    for a, b in itertools.pairwise(kept):
        if T_base[b] <= T_base[a]:
            continue
        end = next((c for c in kept if c > b), b)
        (where,) = stretches([(a, end)], time)
        pull, release = (_rate(T_base, time, i, j) for i, j in ((a, b), (b, end)))
        found.append(
            Cycle(
                where=where,
                peak=b,
                from_N=float(T_base[a]),
                peak_N=float(T_base[b]),
                to_N=float(T_base[end]),
                tip_N=float(T_tip[b]),
                pull_N_per_s=pull,
                release_N_per_s=release,
                inner=float(T_base[a]) - low > RELEASED * reach,
            )
        )
    rates, decades = {}, None
    sizes = np.abs(moves[moves != 0])
    if sizes.size:
        levels = np.percentile(sizes, RATES).tolist()
        rates = {f"{p}%": v for p, v in zip(RATES, levels, strict=True)}
        decades = float(np.log10(levels[-1] / levels[0])) if levels[0] > 0 else None
    return Cycles(tuple(found), sum(c.inner for c in found), _repeats(found, ALIKE * reach), rates, decades)


def _large(T: np.ndarray, turns: np.ndarray, least: float) -> list[int]:
    """Turning points between which a tension changes by at least so much, and both ends."""
    return turns[turning_points(T[turns], least)].tolist()


def _rate(T: np.ndarray, time: np.ndarray | None, a: int, b: int) -> float | None:
    if time is None or time[b] <= time[a]:
        return None
    return float((T[b] - T[a]) / (time[b] - time[a]))


def _repeats(found: Sequence[Cycle], near: float) -> tuple[int, ...]:
    """The largest group of cycles whose ends agree, by number from 1; empty if none repeats another."""
    groups: list[list[int]] = []
    for i, cycle in enumerate(found):
        for group in groups:
            first = found[group[0]]
            if abs(first.peak_N - cycle.peak_N) <= near and abs(first.from_N - cycle.from_N) <= near:
                group.append(i)
                break
        else:
            groups.append([i])
    largest = max(groups, key=len, default=[])
    return tuple(i + 1 for i in largest) if len(largest) > 1 else ()


def rates(T_base: np.ndarray, time: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Rates [N/s] of a tension between samples, (n,), that follow one another; without those of no time.

    Args:
        T_base, time: [N] and [s], (K,).
        nodes: samples, increasing, (n + 1,).
    """
    spans = np.diff(time[nodes])
    changes = np.diff(T_base[nodes])
    return changes[spans > 0] / spans[spans > 0]
