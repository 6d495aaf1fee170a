"""Load histories as a hand or a motor makes them: rests, pulls to different peaks and at rates over two
decades, holds, re-pulls, and sudden releases after which the load swings.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

# Samples, their rate [Hz], and how much longer the slowest ramp of a recording is than the fastest.
SAMPLES, RATE, DECADES = (2_000, 20_000), (20.0, 100.0), 100.0
# Grid on which a history is drawn before it is sampled [s].
FINE = 2.5e-3


@dataclasses.dataclass(frozen=True)
class Drive:
    """A load history on a fine grid.

    Attributes:
        time: [s], (F,).
        T_base: tension that is pulled with [N], (F,).
        sampled: instants at which it is read [s], (K,).
        by: "hand" or "motor".
    """

    time: np.ndarray
    T_base: np.ndarray
    sampled: np.ndarray
    by: str


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Between two numbers, every decade alike."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def wander(rng: np.random.Generator, count: int, width: float) -> np.ndarray:
    """Smooth noise of unit variance on the fine grid, of a correlation time [s]."""
    knots = int(count * FINE / width) + 4
    found = CubicSpline(np.arange(knots), rng.normal(size=knots))(np.arange(count) * FINE / width)
    return found / max(float(np.std(found)), 1e-12)


def instants(rng: np.random.Generator, count: int, dt: float) -> np.ndarray:
    """When a computer that means to read every dt does read [s]: nearly so, loosely, or some ticks early."""
    kind = rng.choice(["steady", "loose", "early ticks"])
    steps = dt * (1 + (0.08 if kind == "loose" else 0.015) * rng.standard_t(4, count))
    if kind == "early ticks":
        steps = np.where(rng.random(count) < rng.uniform(0.05, 0.2), 0.67 * steps, steps)
    time = np.cumsum(np.clip(steps, 0.3 * dt, 3 * dt))
    return time - time[0]


def drive(rng: np.random.Generator, largest: float) -> Drive:
    """Draw a history up to the largest tension [N]."""
    dt, count = 1 / log_uniform(rng, *RATE), round(log_uniform(rng, *SAMPLES))
    sampled = instants(rng, count, dt)
    by = str(rng.choice(["hand", "motor"]))
    pieces = _plan(rng, float(sampled[-1]))
    grid = np.arange(0.0, sampled[-1] + 1.0, FINE)
    T, at = np.zeros(len(grid)), 0
    for piece in pieces:
        n = min(max(round(piece.seconds / FINE), 1), len(grid) - at)
        T[at : at + n] = piece.drawn(rng, n, by)
        at += n
    T[at:] = T[at - 1]
    moves = np.abs(np.gradient(T, FINE))
    if by == "hand":
        # A tremor, and slower unevenness, that grow with the load.
        T = T * (1 + rng.uniform(0.001, 0.006) * wander(rng, len(T), 0.03))
        T = T * (1 + rng.uniform(0.004, 0.015) * wander(rng, len(T), 0.25))
    else:
        cogs = np.sin(2 * np.pi * T / rng.uniform(0.01, 0.03))
        T = T + rng.uniform(0, 0.002) * cogs * np.minimum(moves / 0.05, 1.0)
    T = gaussian_filter1d(largest * T / T.max(), rng.uniform(0.01, 0.04) / FINE, mode="nearest")
    slack = largest * rng.uniform(0.0005, 0.003)
    return Drive(grid, np.maximum(T, slack), sampled, by)


@dataclasses.dataclass
class _Piece:
    """A ramp, a hold or a swing, from a share of the largest tension to another."""

    start: float
    end: float
    seconds: float
    swings: float = 0.0  # [Hz]
    fixed: bool = False  # whether its duration is its own

    def drawn(self, rng: np.random.Generator, n: int, by: str) -> np.ndarray:
        way = (np.arange(n) + 1) / n
        if self.swings:
            time = FINE * np.arange(n)
            decay = np.exp(-4 * time / self.seconds)
            swing = decay * np.cos(2 * np.pi * self.swings * time)
            return np.maximum(self.end + (self.start - self.end) * swing, 0.0)
        if self.start == self.end:
            # What is held gives a little.
            return self.start * (1 - rng.uniform(0, 0.02) * (1 - np.exp(-4 * way)))
        if by == "hand" and n > 50:
            pace = np.exp(0.5 * wander(rng, n, 0.08 * n * FINE))
            way = np.cumsum(pace) / np.sum(pace)
        else:
            edge = 0.08
            way = np.clip((way - 0.5) / (1 - edge) + 0.5, 0, 1)
        return self.start + (self.end - self.start) * way


def _plan(rng: np.random.Generator, seconds: float) -> list[_Piece]:
    """Pieces that fill so many seconds."""
    pulls = int(np.clip(round(seconds / rng.uniform(8, 25)), 3, 14))
    peaks = rng.permutation(np.append(rng.uniform(0.3, 0.95, pulls - 1), 1.0))
    pieces, now = [_Piece(0, 0, rng.uniform(1, 3))], 0.0

    def to(goal: float) -> None:
        nonlocal now
        pieces.append(_Piece(now, goal, abs(goal - now)))
        now = goal

    def hold(most: float) -> None:
        pieces.append(_Piece(now, now, rng.uniform(0.3, most)))

    for peak in peaks.tolist():
        if rng.random() < 0.25:
            for share in np.linspace(now, peak, int(rng.integers(3, 6)))[1:-1].tolist():
                to(share)
                hold(2)
        to(peak)
        if rng.random() < 0.6:
            hold(5)
        for _ in range(int(rng.integers(0, 3))):
            to(peak * rng.uniform(0.3, 0.75))
            to(peak * rng.uniform(0.76, 0.98))
        if rng.random() < 0.45:
            low = peak * rng.uniform(0.25, 0.55)
            lasts = rng.uniform(1.5, 5)
            pieces.append(_Piece(now, low, lasts, swings=rng.uniform(0.7, 3), fixed=True))
            now = low
        to(0.0 if rng.random() < 0.6 else peak * rng.uniform(0.03, 0.25))
        if now == 0 or rng.random() < 0.3:
            hold(4)
    to(0.0)
    hold(4)
    ramps = [p for p in pieces if p.start != p.end and not p.fixed]
    slowness = DECADES ** rng.permutation(np.linspace(0, 1, len(ramps)))
    for piece, slow in zip(ramps, slowness.tolist(), strict=True):
        piece.seconds *= slow
    fixed = [p for p in pieces if p.fixed]
    swinging, rest = sum(p.seconds for p in fixed), [p for p in pieces if not p.fixed]
    if swinging > 0.4 * seconds:
        for piece in fixed:
            piece.seconds *= 0.4 * seconds / swinging
        swinging = 0.4 * seconds
    # Holds and ramps share what is left, the holds a third of it.
    for some, share in ((ramps, 2 / 3), ([p for p in rest if p.start == p.end], 1 / 3)):
        total = sum(p.seconds for p in some)
        for piece in some:
            piece.seconds *= share * (seconds - swinging) / total
    return pieces
