"""Regularities in what a fit leaves of T_tip that no noise has, of causes that the catalogue does not hold.

Noise is taken from the differences of neighbouring readings, and so are swings from sample to sample and
waves over a tension. These tests take it from what is left beside the pattern instead: each pattern is a few
rows that are fitted beside the model's own numbers, the base tension, the uncertain dimensions and a smooth
misfit of each branch, and what they explain is held against the rest (an F test).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from ..coordinates import CHANNELS
from ..noise import MAD_TO_SD, resolution
from .bench import Bench, Fitted

SAMPLE = "sample"
# Chance below which a pattern is no noise, and the share of the residual that it has to explain: in long
# recordings the least that noise is not what it is taken for is significant.
CHANCE, SHARE = 1e-4, 0.3
# Residuals count up to so many standard deviations.
MOST = 3.0
# Rms of the white residual below which nothing is asked: of what a model leaves that is less than the noise,
# most is smooth.
LEAST = 0.5
# Powers of the base tension, on each branch, that are no pattern: a smooth misfit while pulling and releasing
# would be taken for one.
SMOOTH = 3
# Changes of the tip that a reading may follow; waves over the range of a tension, from and to, by so many.
LAGS, FEWEST_WAVES, MOST_WAVES, STEP = 8, 2.0, 60.0, 0.25
# Rows that the fit's own numbers explain but for this share say nothing.
OWN = 0.05
# Samples for each number of a pattern.
EACH = 3


class Pattern(NamedTuple):
    """A regularity: recording; along what, "sample", "T_tip" or "T_base"; how probable it is by chance;
    the share of the residual that it explains; and the period of waves [N], else NaN.
    """

    recording: str
    along: str
    chance: float
    share: float
    period_N: float = float("nan")

    @property
    def says(self) -> str:
        """In words."""
        if self.along == SAMPLE:
            return "what is left of T_tip follows the changes of the last samples, as a cell does that rings"
        return f"what is left of T_tip swings with {self.along}, with a period of {self.period_N:.2g} N"


def pattern_in(bench: Bench, fitted: Fitted) -> Pattern | None:
    """The least probable regularity of what a fit leaves of T_tip; None where there is none."""
    best: Pattern | None = None
    for k, rig in enumerate(bench.rigs):
        test = _Test(bench, fitted, k)
        if test.rms < LEAST:
            continue
        tip, T_base = fitted.seen[k].values[CHANNELS.index("T_tip")], rig.part.T_base.T_base
        found = [test.along(SAMPLE, [_lagged(tip)])]
        step = resolution(rig.part.T_tip)
        for name, along in (("T_tip", tip), ("T_base", T_base)):
            periods, waves = _waves(along, step)
            found.append(test.along(name, waves, periods))
        for one in found:
            counts = one.chance < CHANCE / len(bench.rigs) and one.share > SHARE
            if counts and (best is None or one.chance < best.chance):
                best = one
    return best


class _Test:
    """What the model's own numbers leave of a recording's T_tip, for patterns to explain."""

    def __init__(self, bench: Bench, fitted: Fitted, k: int):
        self.bench, self.k, n = bench, k, len(fitted.x)
        sizes = [(len(rig.part.channels), rig.part.samples) for rig in bench.rigs]
        start = sum((C + 1) * K for C, K in sizes[:k])
        C, self.K = sizes[k]
        tip = np.arange(start, start + self.K)
        self.own = np.concatenate([tip, tip + C * self.K])  # T_tip and the base tension
        own = np.concatenate([fitted.jacobian, np.eye(n)])
        smooth = self._white(_smooth(bench.rigs[k].part.T_base.T_base), n)
        self.q = np.linalg.svd(np.concatenate([own, smooth], axis=1), full_matrices=False)[0]
        left = np.concatenate([fitted.rows, fitted.x])
        self.rms = float(np.sqrt(np.mean(left[tip] ** 2)))
        middle = np.median(left[tip])
        rough = MAD_TO_SD * float(np.median(np.abs(left[tip] - middle)))
        left[tip] = np.clip(left[tip] - middle, -MOST * rough, MOST * rough)
        self.left = self._without(left)
        self.total = float(np.sum(self.left[self.own] ** 2))
        self.own_numbers, self.free = n, self.q.shape[1]

    def _white(self, patterns: np.ndarray, numbers: int) -> np.ndarray:
        """Changes of T_tip [N], (m, K), as white rows, those of the model's numbers below, (n, m)."""
        changes = [np.zeros((*rig.part.recorded.shape, len(patterns))) for rig in self.bench.rigs]
        changes[self.k][0] = patterns.T
        white = self.bench.white(changes)
        if self.bench.follow is not None:
            white = self.bench.follow.freed(white)
        return np.concatenate([white, np.zeros((numbers, len(patterns)))])

    def _without(self, rows: np.ndarray) -> np.ndarray:
        return rows - self.q @ (self.q.T @ rows)

    def along(self, name: str, patterns: Sequence[np.ndarray], periods: Sequence[float] = ()) -> Pattern:
        """The best of several patterns, (m, K) each, of T_tip [N], its chance that of all of them."""
        part = self.bench.rigs[self.k].part
        best = Pattern(part.name, name, 1.0, 0.0)
        if not patterns or self.total == 0:
            return best
        white = self._white(np.concatenate(patterns), self.own_numbers)
        before = np.linalg.norm(white, axis=0)
        rows = self._without(white)
        good = np.linalg.norm(rows, axis=0) > OWN * np.maximum(before, 1e-300)
        first = 0
        for i, pattern in enumerate(patterns):
            mine = slice(first, first + len(pattern))
            first += len(pattern)
            of = rows[:, mine][:, good[mine]]
            if not of.shape[1]:
                continue
            u, sizes, _ = np.linalg.svd(of / np.linalg.norm(of, axis=0), full_matrices=False)
            u = u[:, sizes > OWN]
            m, rest = u.shape[1], self.K - u.shape[1] - self.free
            if rest < EACH * m:
                continue
            explained = float(np.sum((u.T @ self.left) ** 2))
            unexplained = max(self.total - explained, 1e-9 * self.total)
            chance = float(stats.f.sf(explained / m / (unexplained / rest), m, rest))
            chance = min(1.0, chance * len(patterns))
            if chance < best.chance:
                period = periods[i] if len(periods) else float("nan")
                best = Pattern(part.name, name, chance, min(explained / self.total, 1.0), period)
        return best


def _smooth(T_base: np.ndarray) -> np.ndarray:
    """Powers of the base tension, all samples alike and with the sign of its last change, (m, K)."""
    way = np.sign(np.diff(T_base, prepend=T_base[0]))
    moved = np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), 0))
    u = 2 * (T_base - T_base.min()) / max(float(np.ptp(T_base)), 1e-300) - 1
    powers = np.stack([u**k for k in range(SMOOTH + 1)])
    return np.concatenate([powers, way[moved] * powers])


def _lagged(tip: np.ndarray) -> np.ndarray:
    """Changes of the tip's tension now and some samples before, (LAGS, K)."""
    change = np.diff(tip, prepend=tip[0])
    return np.stack([np.concatenate([np.zeros(lag), change[: len(change) - lag]]) for lag in range(LAGS)])


def _waves(along: np.ndarray, step: float) -> tuple[list[float], list[np.ndarray]]:
    """Periods [N] of waves over a tension that its samples, and readings of such steps, can show, and the
    cosine and sine of each.
    """
    span, K = float(np.ptp(along)), len(along)
    if span <= 0:
        return [], []
    u = (along - along.min()) / span
    levels = 0.5 * len(np.unique(np.round(u, 3)))
    most = min(K / EACH, levels, span / (4 * step) if step > 0 else np.inf, MOST_WAVES)
    number = np.arange(FEWEST_WAVES, most, STEP)
    angles = 2 * np.pi * number[:, None] * u
    return (span / number).tolist(), list(np.stack([np.cos(angles), np.sin(angles)], axis=1))
