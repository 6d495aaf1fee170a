"""One load cell: range, resolution, noise, zeros, and where it is stuck."""

from __future__ import annotations

import dataclasses

from .noise import CellNoise
from .stuck import Stuck
from .zero import Zero


@dataclasses.dataclass(frozen=True)
class Cell:
    """What a cell's readings say of it.

    Attributes:
        name: "T_base" or "T_tip".
        lowest_N, highest_N: of its readings.
        resolution_N: step of its readings; None if none is to be seen.
        noise: of the cell.
        saturated: runs at the end of its range.
        dead: other runs of equal readings that tension and noise do not explain.
        zero_before, zero_after: unloaded, before the first pull and after the last release; None where it
            is never unloaded.
    """

    name: str
    lowest_N: float
    highest_N: float
    resolution_N: float | None
    noise: CellNoise
    saturated: tuple[Stuck, ...] = ()
    dead: tuple[Stuck, ...] = ()
    zero_before: Zero | None = None
    zero_after: Zero | None = None

    @property
    def drift_N(self) -> float | None:
        """By how much the zero moved from before to after; None if either is not known."""
        if self.zero_before is None or self.zero_after is None:
            return None
        return self.zero_after.value_N - self.zero_before.value_N

    @property
    def drift_sd_N(self) -> float | None:
        """The standard error of the drift."""
        if self.zero_before is None or self.zero_after is None:
            return None
        return (self.zero_before.sd_N**2 + self.zero_after.sd_N**2) ** 0.5
