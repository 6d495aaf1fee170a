"""Recordings as a rig makes them, with the truth of each: a sheath of fixed shape, two cells, one clock."""

from pathlib import Path

import numpy as np

from gtr_jax.recordings.recording import Recording

MU_THETA = 0.5


def pulled(T_base: np.ndarray, *, pull: float = MU_THETA, release: float = MU_THETA) -> np.ndarray:
    """Tip tension of a tendon in a sheath of fixed shape: locked between both limits of friction."""
    low, high = np.exp(-pull), np.exp(release)
    tip, found = float(T_base[0]), []
    for base in T_base.tolist():
        tip = min(max(tip, base * low), base * high)
        found.append(tip)
    return np.asarray(found)


def ramps(
    *legs: tuple[float, float], rate: float = 2000.0, start: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """A base tension that goes to each value in so many seconds: fine time [s] and tension [N]."""
    ends = np.cumsum([0.0, *(seconds for _, seconds in legs)])
    time = np.arange(0.0, ends[-1], 1 / rate)
    return time, np.interp(time, ends, [start, *(value for value, _ in legs)])


REST = (0.0, 4.0)
CYCLE = ((15.0, 5.0), (0.0, 5.0), (0.0, 2.0))


def recorded(
    fine: np.ndarray,
    T_base: np.ndarray,
    *,
    rate: float = 80.0,
    jitter: float = 0.0,
    noise: float = 0.01,
    step: float = 0.0,
    zeros: tuple[float, float] = (0.0, 0.0),
    late: float = 0.0,
    seed: int = 0,
    **friction: float,
) -> dict[str, np.ndarray]:
    """Columns of a recording.

    Args:
        fine, T_base: what is driven, from `ramps`.
        rate, jitter: of the samples [Hz], and their spread as a share of the step.
        noise, step, zeros: of both cells [N].
        late: delay of the tip's cell [s].
        friction: as of `pulled`.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(fine[0] + 0.2, fine[-1], 1 / rate)
    time = np.sort(time + rng.normal(0.0, jitter / rate, len(time)))
    tip = pulled(T_base, **friction)

    def shown(values: np.ndarray, zero: float) -> np.ndarray:
        values = values + zero + rng.normal(0.0, noise, len(values)) if noise else values + zero
        return np.round(values / step) * step if step else values

    return {
        "time": time,
        "T_base": shown(np.interp(time, fine, T_base), zeros[0]),
        "T_tip": shown(np.interp(time - late, fine, tip), zeros[1]),
    }


def recording(columns: dict[str, np.ndarray], **more) -> Recording:
    """The recording that these columns are."""
    return Recording(path=Path("rig.csv"), sha256="", **columns, **more)
