"""Slow noise of a cell, measured where nothing moves.

An amplifier's noise has a part that lasts for tenths of seconds to seconds (1/f). Straight runs of a base
tension follow it where they are longer, and do not show it in their residual; it passes on to the simulated
tip tension, in which it looks like a misfit of the model. While a rig rests, slack, readings show it alone.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from gtr_jax.recordings.signals.stretches import runs

from .base_tension import BaseTension

# A rig rests below this share of the largest tension, while the base tension changes by less than so many
# standard deviations of its noise in a second; shortest rest [s] and its ends, which are left out [s];
# fewest samples of a rest.
SLACK, STEADY, SHORTEST, ENDS, FEWEST = 0.02, 1.5, 1.0, 0.15, 24
# Length of the blocks that are averaged [s]; most and fewest blocks of a piece of a rest; the fewest of all.
BLOCK, BLOCKS, FEWEST_BLOCKS, ENOUGH = 0.08, 60, 6, 60
# Times that slow noise may last [s], and its variances that are tried, relative to that of the quick noise:
# of more than its own size nothing is believed.
LASTS, RATIOS = (0.15, 0.3, 0.6, 1.2, 2.4, 4.8), (0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.5, 0.7, 1.0)
# Logarithm of the likelihood that it must gain.
GAINS = 3.0


class Slow(NamedTuple):
    """Slow noise: standard deviation, in the unit of the readings, and how long it lasts [s]."""

    sd: float
    lasts: float


NONE = Slow(0.0, 1.0)


def slow_noise(readings: np.ndarray, time: np.ndarray, still: np.ndarray) -> Slow:
    """Slow noise of a cell, by restricted maximum likelihood about a straight line of each rest: white noise
    beside an Ornstein-Uhlenbeck process.

    Args:
        readings: of the cell, (K,).
        time: of the samples [s], (K,).
        still: where nothing moves, (K,) bool.

    Returns:
        What is found; `NONE` where the readings do not show it.
    """
    rests = [rest for a, b in _stretches(still, time) for rest in _averaged(readings[a:b], time[a:b])]
    if sum(len(rest.values) for rest in rests) < ENOUGH:
        return NONE
    quiet, _ = _likelihood(rests, 0.0, 1.0)
    best, found = quiet + GAINS, NONE
    for lasts in LASTS:
        for ratio in RATIOS:
            likelihood, white = _likelihood(rests, ratio, lasts)
            if likelihood > best:
                best, found = likelihood, Slow(float(np.sqrt(ratio * white)), lasts)
    return found


def with_slow_noise(base: BaseTension, readings: np.ndarray, time: np.ndarray | None) -> BaseTension:
    """A base tension that knows the slow noise of its cell, where the recording rests long enough to show it.

    Args:
        base: the estimate.
        readings: as recorded [N], (K,).
        time: of the samples [s], (K,), or None.
    """
    if time is None or base.sd == 0 or np.any(np.diff(time) < 0) or np.ptp(time) <= 0:
        return base
    found = slow_noise(readings, time, at_rest(base, time))
    if found.sd == 0:
        return base
    return dataclasses.replace(base, slow=found.sd, lasts=found.lasts * (len(time) - 1) / float(np.ptp(time)))


def at_rest(base: BaseTension, time: np.ndarray) -> np.ndarray:
    """Where a rig rests, (K,) bool: slack, and the base tension hardly changes."""
    slopes = np.abs(np.diff(base.T_base)) / np.maximum(np.diff(time), 1e-9)
    steady = np.concatenate([slopes[:1], slopes]) < STEADY * base.sd
    return steady & (base.T_base < SLACK * float(np.max(base.T_base)))


class _Rest(NamedTuple):
    """Averages of blocks of a rest: values, times [s], and readings in each."""

    values: np.ndarray
    time: np.ndarray
    counts: np.ndarray


def _stretches(still: np.ndarray, time: np.ndarray) -> list[tuple[int, int]]:
    """First sample of each rest, and the one after its last, without its ends."""
    found = []
    for a, b in runs(still, FEWEST):
        start, end = np.searchsorted(time[a : b + 1], (time[a] + ENDS, time[b] - ENDS)).tolist()
        if end - start >= FEWEST and time[a + end - 1] - time[a + start] >= SHORTEST:
            found.append((a + start, a + end))
    return found


def _averaged(readings: np.ndarray, time: np.ndarray) -> list[_Rest]:
    """A rest, in pieces of few enough blocks, each shorter than the noise that is looked for."""
    blocks = max(len(readings) // max(round(BLOCK * (len(time) - 1) / float(np.ptp(time))), 1), 1)
    parts = np.array_split(np.arange(len(readings)), blocks)
    values, when, counts = (
        np.asarray([of(p) for p in parts])
        for of in (lambda p: readings[p].mean(), lambda p: time[p].mean(), lambda p: float(len(p)))
    )
    pieces = np.array_split(np.arange(blocks), -(-blocks // BLOCKS))
    return [_Rest(values[p], when[p], counts[p]) for p in pieces if len(p) >= FEWEST_BLOCKS]


def _likelihood(rests: list[_Rest], ratio: float, lasts: float) -> tuple[float, float]:
    """Logarithm of the restricted likelihood, up to a constant, and the variance of the quick noise of one
    reading, for a slow noise of this variance relative to it.
    """
    squares, determinants, degrees = 0.0, 0.0, 0
    for values, time, counts in rests:
        apart = np.abs(time[:, None] - time[None])
        covariance = np.diag(1 / counts) + ratio * np.exp(-apart / lasts)
        line = np.stack([np.ones(len(time)), time - time.mean()], axis=1)
        try:
            factor = cho_factor(covariance, lower=True)
        except LinAlgError:
            return -np.inf, 1.0
        solved = cho_solve(factor, np.column_stack([values, line]))
        inner = line.T @ solved[:, 1:]
        pulled = line.T @ solved[:, 0]
        squares += float(values @ solved[:, 0] - pulled @ np.linalg.solve(inner, pulled))
        determinants += 2 * float(np.sum(np.log(np.diag(factor[0])))) + float(np.linalg.slogdet(inner)[1])
        degrees += len(values) - 2
    white = max(squares / degrees, 1e-300)
    return -0.5 * (degrees * np.log(white) + determinants), white
