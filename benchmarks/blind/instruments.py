"""What the instruments of a rig add to its readings: noise, drift, grain, a delay between the cells,
glitches, dropouts, gaps, and stamps that are a little off.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .hand import log_uniform

CELLS = ("T_base", "T_tip")
# Share of the largest tension below which a cell that drops out shows nothing of it.
SEEN = 0.03


@dataclasses.dataclass(frozen=True)
class Read:
    """What was written down.

    Attributes:
        kept: rows that no gap swallowed, (K,), of those that were read.
        time: stamps [s], (K,).
        cells: readings of both cells [N], (K,) each.
        spoilt: rows of `time` by cell: "glitch" and "dropout".
        told: for the key: delay, drift, noise, grain, gaps.
    """

    kept: np.ndarray
    time: np.ndarray
    cells: dict[str, np.ndarray]
    spoilt: dict[str, dict[str, list[int]]]
    told: dict[str, Any]


def read(rng: np.random.Generator, time: np.ndarray, true: dict[str, np.ndarray], largest: float) -> Read:
    """Read the two cells at instants [s], (K,), at which they ideally show `true` [N], (K,) each."""
    K = len(time)
    delay = float(rng.choice([-1, 1])) * log_uniform(rng, 1e-3, 0.03)
    late = {"T_base": true["T_base"], "T_tip": np.interp(time - delay, time, true["T_tip"])}
    way = (time - time[0]) / np.ptp(time)
    cells, noise, drift, grains = {}, {}, {}, {}
    for cell in CELLS:
        white = largest * log_uniform(rng, 5e-4, 3e-3)
        slow = white * rng.uniform(0.2, 0.8) * _slow(rng, time, rng.uniform(0.3, 4))
        drift[cell] = largest * float(rng.choice([-1, 1])) * log_uniform(rng, 5e-4, 5e-3)
        curve = rng.uniform(-0.5, 0.5)
        total = white * rng.normal(size=K) + slow
        grains[cell] = largest * log_uniform(rng, 1e-4, 1.5e-3)
        noise[cell] = float(np.hypot(np.std(total), grains[cell] / np.sqrt(12)))
        cells[cell] = late[cell] + total + drift[cell] * way * (1 + curve * (1 - way))
    kept, gaps = _gaps(rng, time)
    K = len(kept)
    cells = {cell: values[kept] for cell, values in cells.items()}
    spoilt: dict[str, dict[str, list[int]]] = {cell: {"glitch": [], "dropout": []} for cell in CELLS}
    taken = np.zeros(K, bool)
    for kind, count, most in (("glitch", 4 + rng.poisson(K / 1500), 3), ("dropout", rng.poisson(1.5), 8)):
        for _ in range(count):
            n = int(rng.integers(1, most + 1))
            at = int(rng.integers(5, K - 5 - n))
            # One apart from another, so that each is one.
            if taken[at - 5 : at + n + 5].any():
                continue
            taken[at : at + n] = True
            for cell in [list(CELLS), ["T_base"], ["T_tip"]][int(rng.integers(3))]:
                rows = np.arange(at, at + n)
                if kind == "glitch":
                    jump = float(rng.choice([-1, 1], p=[0.3, 0.7])) * log_uniform(rng, 0.02, 3) * largest
                    cells[cell][rows] += jump * rng.uniform(0.6, 1.0, n)
                elif np.all(cells[cell][rows] > SEEN * largest):
                    cells[cell][rows] = 0.0
                else:
                    continue
                spoilt[cell][kind] += rows.tolist()
    cells = {cell: grains[cell] * np.round(values / grains[cell]) for cell, values in cells.items()}
    stamps = time[kept] - time[0] + rng.uniform(1e-4, 1e-3) * rng.normal(size=K)
    told = {"delay_s": delay, "noise_N": noise, "drift_N": drift, "grain_N": grains, "gaps_s": gaps}
    return Read(kept, np.maximum.accumulate(np.maximum(stamps, 0.0)), cells, spoilt, told)


def _slow(rng: np.random.Generator, time: np.ndarray, seconds: float) -> np.ndarray:
    """Noise of unit variance that is correlated over so many seconds."""
    keep = np.exp(-np.diff(time, prepend=time[0]) / seconds)
    fresh, found = rng.normal(size=len(time)) * np.sqrt(1 - keep**2), np.empty(len(time))
    now = rng.normal()
    for k, (k0, f) in enumerate(zip(keep.tolist(), fresh.tolist(), strict=True)):
        now = k0 * now + f
        found[k] = now
    return found


def _gaps(rng: np.random.Generator, time: np.ndarray) -> tuple[np.ndarray, list[list[float]]]:
    """Rows that are left when none to three stretches of up to 3 s are not written, and the stretches [s]."""
    kept, gaps = np.ones(len(time), bool), []
    for _ in range(int(rng.integers(0, 4))):
        start = float(rng.uniform(0.1, 0.9) * time[-1])
        end = start + log_uniform(rng, 0.15, min(3.0, 0.03 * time[-1] + 0.15))
        kept &= (time < start) | (time > end)
        gaps.append([start - time[0], end - time[0]])
    return np.flatnonzero(kept), sorted(gaps)
