"""Stretches of a recording: runs of samples at which something holds."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np


@dataclasses.dataclass(frozen=True)
class Stretch:
    """Samples from `first` to `last`, both included, counted from 0, and their times [s]; None without a
    clock.
    """

    first: int
    last: int
    start_s: float | None = None
    end_s: float | None = None

    def __len__(self) -> int:
        return self.last - self.first + 1

    @property
    def rows(self) -> slice:
        """The samples, to index arrays with."""
        return slice(self.first, self.last + 1)


def runs(holds: np.ndarray, shortest: int = 1) -> list[tuple[int, int]]:
    """First and last sample of each run of at least `shortest` samples at which `holds`, (K,) bool, is
    true.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(np.int8), [0]])))
    firsts, lasts = edges[::2], edges[1::2] - 1
    long = lasts - firsts + 1 >= shortest
    return list(zip(firsts[long].tolist(), lasts[long].tolist(), strict=True))


def stretches(ends: Iterable[tuple[int, int]], time: np.ndarray | None) -> tuple[Stretch, ...]:
    """Stretches from their first and last samples.

    Args:
        ends: first and last sample of each.
        time: of the samples [s], (K,), or None.
    """
    if time is None:
        return tuple(Stretch(a, b) for a, b in ends)
    return tuple(Stretch(a, b, float(time[a]), float(time[b])) for a, b in ends)
