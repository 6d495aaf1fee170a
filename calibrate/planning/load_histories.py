"""Load histories that a rig could follow next, and checks of its cells by themselves."""

from __future__ import annotations

import numpy as np

# Number of equal loops; a long rest, and the time for which unloaded cells are read, both in durations of a
# loop.
LOOPS, REST, ALONE = 8, 20.0, 60.0
# Share of the largest base tension at which the tendon rests.
RESTING = 0.02
# Seconds of a loop that is neither slow nor fast where no recording tells, and loops that a recording whose
# times tell is taken to hold.
PACE, LOOPS_RECORDED = 20.0, 6
# Samples of a hold, as a share of those of a leg that moves.
SHARE_OF_HOLD = 0.3


def pace_of(duration: float | None) -> float:
    """Seconds of a loop that is neither slow nor fast, on a rig of which a recording took so long [s]; None
    where no recording has times.
    """
    return PACE if duration is None else max(duration / LOOPS_RECORDED, 1.0)


def menu(largest: float, samples: int, duration: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Load histories that a rig could follow: time [s] and base tension [N], by description.

    Args:
        largest: base tension not to exceed [N].
        samples: of each.
        duration: of a loop that is neither slow nor fast [s].
    """
    a, d, low, top = largest, duration, RESTING, 1.0

    def through(corners, times):
        return _through(np.asarray(corners) * a, d * np.asarray(times), samples)

    return {
        "one slow loop to the largest tension": through([low, top, low], [0, 2, 4]),
        "the same loop at four rates, each four times the one before": through(
            [low, *([top, low] * 4)], np.cumsum([0, 2, 2, 1 / 2, 1 / 2, 1 / 8, 1 / 8, 1 / 32, 1 / 32])
        ),
        "inner loops of falling size, at one rate": through(
            [low, top, 0.3, 0.8, 0.4, 0.7, 0.5, 0.62, 0.56, low],
            np.cumsum([0, 1, 0.7, 0.5, 0.4, 0.3, 0.2, 0.12, 0.06, 0.56]),
        ),
        "loops at low tension": through(
            [low, 0.15, low, 0.3, low, 0.5, low], np.cumsum([0, 0.15, 0.15, 0.3, 0.3, 0.5, 0.5])
        ),
        "steps with long holds, up and down": through(
            [low, *np.repeat([0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25], 2), low],
            np.cumsum([0, *([0.1, 1.5] * 7), 0.1]),
        ),
        "many equal loops": through([low, *([top, low] * LOOPS)], 0.5 * np.arange(2 * LOOPS + 1)),
        f"two equal loops with a rest of {REST * d:.0f} s between": through(
            [low, top, low, low, top, low], np.cumsum([0, 0.5, 0.5, REST, 0.5, 0.5])
        ),
    }


def more_histories(largest: float, samples: int, duration: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """More load histories, for a plan that has time to try them; arguments and result as of `menu`."""
    a, d, low = largest, duration, RESTING

    def through(corners, times):
        return _through(np.asarray(corners) * a, d * np.asarray(times), samples)

    return {
        "pulls of growing height, each from rest": through(
            [low, 0.25, low, 0.5, low, 0.75, low, 1.0, low],
            np.cumsum([0, *np.repeat([0.25, 0.5, 0.75, 1.0], 2)]),
        ),
        "one fast loop, at eight times the usual rate": through([low, 1.0, low], [0, 1 / 8, 1 / 4]),
        "one loop with a long hold at the top and half-way down": through(
            [low, 1.0, 1.0, 0.5, 0.5, low], np.cumsum([0, 1, 6, 0.5, 6, 0.5])
        ),
    }


def _through(corners: np.ndarray, times: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """A course that is straight between corners, with a sample at each of them. Legs have samples in
    proportion to the root of their time, so that short ones are seen as well; a hold, whose readings share
    the error of what was driven before, has few however long it is.
    """
    each, holds = np.sqrt(np.diff(times)), np.diff(corners) == 0
    each[holds] = np.minimum(each[holds], SHARE_OF_HOLD * np.mean(each[~holds]))
    ends = np.round((samples - 1) * np.concatenate([[0.0], np.cumsum(each / each.sum())])).astype(int)
    t = np.interp(np.arange(samples), ends, times)
    return t, np.interp(t, times, corners)


def checks(largest: float, duration: float) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Checks of the cells by themselves: time [s], and true tension at the base cell and at the tip cell [N],
    (K,) each, by description.

    Args:
        largest, duration: as of `menu`.
    """
    up_and_down = largest * np.asarray([0, 0.25, 0.5, 0.75, 1, 0.75, 0.5, 0.25, 0])
    none = np.zeros(len(up_and_down))
    base, tip = np.concatenate([up_and_down, none]), np.concatenate([none, up_and_down])
    alone = np.linspace(0.0, ALONE * duration, len(base))
    seconds = f"{alone[-1]:.0f} s"
    return {
        "hang known weights on each cell in turn, up and down": (10.0 * np.arange(len(base)), base, tip),
        f"read the cells with nothing on them, for {seconds}": (alone, 0.0 * alone, 0.0 * alone),
    }
