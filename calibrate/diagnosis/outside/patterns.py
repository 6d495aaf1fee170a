"""Regularities in the residual of T_tip, or of what else is explained, that noise does not have, from causes
outside the catalogue.

The noise is estimated from differences of neighbouring readings, which contain swings from sample to sample
and waves over a tension as well. These tests estimate it from what is left beside the pattern instead: each
pattern is a few rows that are fitted beside the model's own numbers, the base tension, the uncertain
dimensions and a smooth misfit of each branch, and what they explain is compared with the rest (an F test).
Readings that stand still for a while need no such test: many in a row are far off.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc, ndtr, ndtri

from calibrate.diagnosis.hypotheses.model import Fitted
from calibrate.diagnosis.likelihood.likelihood import Likelihood, noise_in
from calibrate.inference.channels import quantity_of, words_of
from calibrate.inference.instruments import tendon_of_channel, words_for
from calibrate.inference.setup import Observation
from gtr_jax.recordings.signals.differences import MAD_TO_SD
from gtr_jax.recordings.signals.noise import correlation_time, resolution

SAMPLE, TIME, NAN = "sample", "time", float("nan")
# Probability by chance below which a pattern is not noise, and least share of the residual that it has to
# explain: in long recordings, the smallest error in the model of the noise is significant.
CHANCE, SHARE = 1e-4, 0.3
# Residuals are clipped at this many standard deviations.
MOST = 3.0
# Rms of the whitened residual below which no pattern is sought: a residual smaller than the noise is mostly
# smooth.
LEAST = 0.5
# Highest power of the base tension, on each branch, that is not a pattern: otherwise a smooth misfit while
# pulling and releasing would be taken for one.
SMOOTH = 3
# Latest changes of the tip tension that a reading may follow; fewest and most waves over the range of a
# tension, and the step between.
LAGS, FEWEST_WAVES, MOST_WAVES, STEP = 8, 2.0, 60.0, 0.25
# Widths of bumps, as shares of the range of a tension; least number of samples at the top of one.
WIDTHS, TOP = (0.015, 0.03, 0.06), 4
# Readings that stand still: at least this many in a row beyond the noise, all within this many standard
# deviations of noise, and moving, with the reading before, by less than this share of the model's change; and
# number of stretches that are named. Of four readings in a row on one side of the base model, the nearest was
# at most 2.3 standard deviations off in 86 sound recordings of the blind benchmark, bad repeats among them,
# and 5.5 to 94 where readings stand still (noise of the base fit).
CONSECUTIVE, STILL_SD, LESS, TOLD = 4, 6.0, 0.5, 4
# Readings beside them that are this near to them, in standard deviations of the noise, stand still with them,
# up to where the model is one off: friction holds a tip at its peak, and there they are right.
AS_STILL = 3.0
# Rows of which the fit's own numbers explain all but this share are left out.
OWN = 0.05
# Samples needed for each number of a pattern.
EACH = 3


class Stand(NamedTuple):
    """Readings that stand still far from the model: how many, base tension of the first and the last
    [N] or, where displacement drives the tendon, None, their time [s] or None, and their places in the
    recording.
    """

    readings: int
    T_base_N: tuple[float, float] | None
    time_s: tuple[float, float] | None
    first: int
    last: int

    @property
    def says(self) -> str:
        """In words."""
        when = [] if self.time_s is None else ["{:.10g} to {:.10g} s".format(*self.time_s)]
        at = [] if self.T_base_N is None else ["{:.3g} to {:.3g} N at the base".format(*self.T_base_N)]
        many = f"{self.readings} consecutive readings"
        return f"{many} ({', '.join([*when, *at])})" if when or at else many


class Pattern(NamedTuple):
    """A regularity in the residual of a channel that is explained.

    Attributes:
        recording: its name.
        along: "sample", "time", "T_tip" or "T_base".
        chance: its probability by chance; where readings stand still, that of a single reading as far from
            the model as the nearest of them.
        share: share of the residual that it explains, or that those readings hold.
        period_N: period of waves [N], else NaN.
        at_N, width_N: place and width of a bump [N], else NaN.
        stands: where readings stand still.
        of: the channel in words, "T_tip" of the only tendon.
    """

    recording: str
    along: str
    chance: float
    share: float
    period_N: float = NAN
    at_N: float = NAN
    width_N: float = NAN
    stands: tuple[Stand, ...] = ()
    of: str = "T_tip"

    @property
    def says(self) -> str:
        """In words."""
        if self.along == SAMPLE:
            return (
                f"what is left of {self.of} follows the changes of the last samples, as the reading of a "
                "ringing cell does"
            )
        if self.along == TIME:
            at = ", ".join(stand.says for stand in self.stands[:TOLD])
            more = len(self.stands) - TOLD
            others = "" if more < 1 else f" and {more} more stretch{'es' if more > 1 else ''}"
            return f"what is left of {self.of} is large where its readings stand still, {at}{others}"
        if np.isfinite(self.at_N):
            return (
                f"what is left of {self.of} bulges where {self.along} is near {self.at_N:.3g} N, "
                f"{self.width_N:.2g} N wide"
            )
        period = f"with a period of {self.period_N:.2g} N"
        return f"what is left of {self.of} swings with {self.along}, {period}"


def pattern_in(likelihood: Likelihood, fitted: Fitted) -> Pattern | None:
    """The regularity in the residual of what is explained that is least probable by chance, or None. Readings
    that stand still are reported where they hold more of the residual than it explains: their chance is that
    of the nearest of them alone.
    """
    found: list[Pattern] = []
    for k, (rig, residual) in enumerate(zip(likelihood.rigs, likelihood.residuals(fitted.seen), strict=True)):
        for c in range(rig.part.explained):
            found += _standing(likelihood, k, c, residual * rig.part.counted)
            found += _regular(likelihood, fitted, k, c)
    least = min(found, key=lambda pattern: pattern.chance, default=None)
    still = max((p for p in found if p.stands), key=lambda pattern: pattern.share, default=None)
    if least is None or still is None:
        return least
    elsewhere = still.recording != least.recording
    return still if elsewhere or still.share > least.share else least


def _of(part: Observation, c: int) -> str:
    """A channel in words, a tip tension as T_tip."""
    name = part.channels[c]
    if quantity_of(name) == "T_tip":
        return f"T_tip{words_for(part, tendon_of_channel(part, name))}"
    return words_of(name)


def _regular(likelihood: Likelihood, fitted: Fitted, k: int, c: int) -> list[Pattern]:
    """Regularities in the residual of channel c of recording k."""
    found, rig = [], likelihood.rigs[k]
    part = rig.part
    beside = _Beside(likelihood, fitted, k, c)
    if beside.rms < LEAST:
        return []
    tendon = tendon_of_channel(part, part.channels[c])
    tip, read, drive = fitted.seen[k].values[rig.where[c]], part.recorded[c], part.drives[tendon].T_base
    way = _way(drive)
    groups = [[PatternCandidate(SAMPLE, _lagged(tip))]]
    tensions = [("T_tip", tip)] if c < part.tips else []
    if part.robot.tendons[tendon].drive == "tension":
        tensions.append(("T_base", drive))
    whose = words_for(part, tendon)
    for name, along in tensions:
        groups.append(_waves(name + whose, along, resolution(read)))
        groups.append(_bumps(name + whose, along, way))
    for group in groups:
        tested = beside.explained([one.changes for one in group])
        for one, (chance, share) in zip(group, tested, strict=True):
            chance = min(1.0, chance * len(group))
            if np.isfinite(one.at_N):
                share = _share(one.changes, read - tip)
            if chance < CHANCE / len(likelihood.rigs) / part.explained and share > SHARE:
                found.append(
                    Pattern(
                        recording=part.name,
                        along=one.along,
                        chance=chance,
                        share=share,
                        period_N=one.period_N,
                        at_N=one.at_N,
                        width_N=one.width_N,
                        of=_of(part, c),
                    )
                )
    return found


class PatternCandidate(NamedTuple):
    """A pattern to look for: along what; changes of the channel, SI, (m, K); and the rest as in `Pattern`."""

    along: str
    changes: np.ndarray
    period_N: float = NAN
    at_N: float = NAN
    width_N: float = NAN


class _Beside:
    """The residual of one channel that neither the model's own numbers nor a smooth misfit explain.
    The numbers are as free as this recording alone leaves them; other recordings do not count.

    Attributes:
        rms: of its white residual.
        tau: samples per independent one.
    """

    def __init__(self, likelihood: Likelihood, fitted: Fitted, k: int, c: int):
        self.likelihood, self.k, self.c, self.numbers = likelihood, k, c, len(fitted.x)
        part = likelihood.rigs[k].part
        tendon = tendon_of_channel(part, part.channels[c])
        sizes = [(len(rig.part.channels), len(rig.part.drives), rig.part.samples) for rig in likelihood.rigs]
        start = sum((C + n) * K for C, n, K in sizes[:k])
        C, n, self.K = sizes[k]
        self.own, tip = slice(start, start + (C + n) * self.K), c * self.K + np.arange(self.K)
        own = np.concatenate([fitted.jacobian[self.own], np.eye(self.numbers)])
        smooth = self._white(_smooth(part.drives[tendon].T_base))
        self.known = np.linalg.svd(np.concatenate([own, smooth], axis=1), full_matrices=False)[0]
        left = np.concatenate([fitted.rows[self.own], fitted.x])
        self.rms = float(np.sqrt(np.mean(left[tip] ** 2)))
        middle = np.median(left[tip])
        rough = MAD_TO_SD * float(np.median(np.abs(left[tip] - middle)))
        left[tip] = np.clip(left[tip] - middle, -MOST * rough, MOST * rough)
        self.left = self._without_known(left)
        both = np.concatenate([tip, (C + tendon) * self.K + np.arange(self.K)])  # it and the base tension
        self.total = float(np.sum(self.left[both] ** 2))
        # In a long recording slow noise, and what a hold has in common with the peak before it, pass for a
        # bump: samples count by how independent they are.
        self.tau = 1.0 if likelihood.heavy is None else correlation_time(self.left[tip])

    def _white(self, changes: np.ndarray) -> np.ndarray:
        """Changes of the channel, SI, (m, K), as whitened rows, with those of the numbers below, (n, m)."""
        residual = np.zeros((*self.likelihood.rigs[self.k].part.recorded.shape, len(changes)))
        residual[self.c] = changes.T
        white = self.likelihood.white_of(self.k, residual)
        if self.likelihood.follow is not None:
            follow = self.likelihood.follow
            white = follow._replace(left=follow.left[self.own]).freed(white, white)
        return np.concatenate([white, np.zeros((self.numbers, len(changes)))])

    def _without_known(self, rows: np.ndarray) -> np.ndarray:
        return rows - self.known @ (self.known.T @ rows)

    def explained(self, patterns: Sequence[np.ndarray]) -> list[tuple[float, float]]:
        """For each pattern, changes of the channel, SI, (m, K): the probability that noise fits it as well,
        and the share of the residual that it explains.
        """
        if not patterns or self.total == 0:
            return [(1.0, 0.0)] * len(patterns)
        white = self._white(np.concatenate(patterns))
        rows = self._without_known(white)
        own = OWN * np.maximum(np.linalg.norm(white, axis=0), 1e-300)
        new = np.linalg.norm(rows, axis=0) > own
        ends = np.cumsum([len(p) for p in patterns])[:-1]
        return [
            self._test(columns[:, good])
            for columns, good in zip(np.split(rows, ends, axis=1), np.split(new, ends), strict=True)
        ]

    def _test(self, columns: np.ndarray) -> tuple[float, float]:
        """An F test of what columns explain, (n, m)."""
        if not columns.shape[1]:
            return 1.0, 0.0
        u, sizes, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
        u = u[:, sizes > OWN]
        m, rest = u.shape[1], self.K - u.shape[1] - self.known.shape[1]
        if rest < EACH * m:
            return 1.0, 0.0
        explained = float(np.sum((u.T @ self.left) ** 2))
        unexplained = max(self.total - explained, 1e-9 * self.total)
        ratio = explained / m / (unexplained / rest)
        chance = float(fdtrc(m, rest / self.tau, ratio / self.tau))
        return chance, min(explained / self.total, 1.0)


def _standing(likelihood: Likelihood, k: int, c: int, residual: np.ndarray) -> list[Pattern]:
    """Stretches in which the readings of a channel stand still, far from a model that moves: one
    pattern of them all, or none.

    Args:
        likelihood: the recordings.
        k, c: which of them, and which of its channels.
        residual: of it, simulated minus recorded, (C, K).
    """
    part = likelihood.rigs[k].part
    tendon = tendon_of_channel(part, part.channels[c])
    read, T_base, K = part.recorded[c], part.drives[tendon].T_base, part.samples
    tip = read + residual[c]
    by_draw = part.robot.tendons[tendon].drive == "displacement"
    # Readings that stand still inflate the noise if it is estimated from another fit.
    sd = min(likelihood.noise[k][c].sd, noise_in(likelihood.rigs[k], residual)[c].sd)
    left = residual[c] / np.hypot(sd, likelihood.weighs[k].passed[c])
    beyond = float(-ndtri(0.5 * CHANCE / len(likelihood.rigs) / K))
    off, still = np.abs(left) > beyond, STILL_SD * sd + resolution(read)
    # Lone spikes do not count.
    counted = ~off | np.append(off[1:], False) | np.append(False, off[:-1])
    far, stands, done = np.zeros(K, bool), [], 0
    for start, end in _flat(read, still):
        inside = start + np.flatnonzero(off[start:end])
        if len(inside) < CONSECUTIVE or inside[0] < done:
            continue
        first, after = int(inside[0]), int(inside[-1]) + 1
        run = slice(max(first - 1, 0), after)
        # A stretch at the start may come from before the recording.
        if np.ptp(read[run]) < LESS * np.ptp(tip[run]) and np.ptp(read[:after]) >= still:
            far[inside] = True
            done = after
            alike = np.abs(read - np.median(read[first:after])) < AS_STILL * sd + resolution(read)
            ends = list(_as_still(alike & (np.abs(left) > 1.0), first, after - 1))
            when = None if part.time is None else tuple(part.time[ends].tolist())
            driven = None if by_draw else tuple(T_base[ends].tolist())
            places = part.places[ends].tolist()
            stands.append(Stand(ends[1] - ends[0] + 1, driven, when, *places))
    share = float(np.sum(left[far] ** 2) / np.sum(left[counted] ** 2)) if stands else 0.0
    if share < SHARE:
        return []
    least = float(np.min(np.abs(left[far])))
    chance = float(min(1.0, 2 * K * len(likelihood.rigs) * ndtr(-least)))
    return [Pattern(part.name, TIME, chance, share, stands=tuple(stands), of=_of(part, c))]


def _flat(values: np.ndarray, noise: float) -> list[tuple[int, int]]:
    """Stretches, from a first value up to one after the last, that stay within the noise and could not be
    longer; they may overlap.
    """
    found, end = [], 0
    for start in range(len(values)):
        longer = end
        while longer < len(values) and np.ptp(values[start : longer + 1]) < noise:
            longer += 1
        if longer > end:
            found.append((start, longer))
            end = longer
        end = max(end, start + 1)
    return found


def _as_still(alike: np.ndarray, first: int, last: int) -> tuple[int, int]:
    """First and last of the readings that stand as still as some do: with those before and after them that
    are like them.
    """
    while first > 0 and alike[first - 1]:
        first -= 1
    while last < len(alike) - 1 and alike[last + 1]:
        last += 1
    return first, last


def _share(changes: np.ndarray, left: np.ndarray) -> float:
    """Share of the residual, SI, (K,), that changes (m, K) explain. The whitened residual is not used,
    because a bump in it is small where samples are dense.
    """
    left = left - np.median(left)
    follow = changes.T @ np.linalg.lstsq(changes.T, left, rcond=None)[0]
    return 1.0 - float(np.sum((left - follow) ** 2) / max(float(left @ left), 1e-300))


def _smooth(T_base: np.ndarray) -> np.ndarray:
    """Powers of the base tension, and the same times the sign of its last change, (m, K)."""
    u = 2 * (T_base - T_base.min()) / max(float(np.ptp(T_base)), 1e-300) - 1
    powers = np.stack([u**k for k in range(SMOOTH + 1)])
    return np.concatenate([powers, _way(T_base) * powers])


def _way(T_base: np.ndarray) -> np.ndarray:
    """Sign of the last change of the base tension at each sample, (K,)."""
    way = np.sign(np.diff(T_base, prepend=T_base[0]))
    return way[np.maximum.accumulate(np.where(way != 0, np.arange(len(way)), 0))]


def _lagged(tip: np.ndarray) -> np.ndarray:
    """Changes of what is simulated now and some samples before, (LAGS, K)."""
    change = np.diff(tip, prepend=tip[0])
    return np.stack([np.concatenate([np.zeros(lag), change[: len(change) - lag]]) for lag in range(LAGS)])


def _waves(name: str, along: np.ndarray, step: float) -> list[PatternCandidate]:
    """Waves over a tension that its samples, and readings with this resolution `step` [N], can show."""
    span, K = float(np.ptp(along)), len(along)
    if span <= 0:
        return []
    u = (along - along.min()) / span
    levels = 0.5 * len(np.unique(np.round(u, 3)))
    most = min(K / EACH, levels, span / (4 * step) if step > 0 else np.inf, MOST_WAVES)
    number = np.arange(FEWEST_WAVES, most, STEP)
    angles = 2 * np.pi * number[:, None] * u
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return [PatternCandidate(name, wave, float(span / n)) for n, wave in zip(number, waves, strict=True)]


def _bumps(name: str, along: np.ndarray, way: np.ndarray) -> list[PatternCandidate]:
    """Bumps over a tension, while pulling and releasing, where there are enough samples to show them."""
    low, span = float(along.min()), float(np.ptp(along))
    if span <= 0:
        return []
    u, found = (along - low) / span, []
    for width in WIDTHS:
        for at in np.arange(0.0, 1.0 + width, width):
            bump = np.exp(-0.5 * ((u - at) / width) ** 2)
            if np.sum(bump > 0.5) >= TOP:
                changes = np.stack([bump, way * bump])
                found.append(
                    PatternCandidate(name, changes, at_N=low + float(at) * span, width_N=2.35 * width * span)
                )
    return found
