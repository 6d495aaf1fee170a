"""Profile likelihoods: how much worse the best fit becomes as one parameter is held away from its estimate.

Where the sum of squares is a parabola, its interval is that of the standard error; where it is not, because
a stretch of the recording changes from locked to slipping or because two parameters trade off along a curve,
the profile shows it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calibrate.inference.answer import Answer
from calibrate.inference.descent import descend
from calibrate.inference.estimate import Profile
from calibrate.inference.parallel import in_parallel
from calibrate.inference.setup import Setup

# 95 % quantile of chi-square with one degree of freedom.
LEVEL_95 = 3.841458820694124
# First and farthest offset tried [standard errors]; points on each side; how near to the level a rise must
# be.
FIRST, FARTHEST, POINTS, CLOSE = 1.0, 4.0, 6, 0.05
# Steps of the optimiser at each point, which starts from the point before it.
MAX_STEPS = 12


class Profiles(NamedTuple):
    """Profiles of the parameters that the recordings determine.

    Attributes:
        of: by name.
        evaluations: times that all recordings were simulated.
        warnings: what a reader must know.
    """

    of: dict[str, Profile]
    evaluations: int
    warnings: list[str]


def profiles(setup: Setup, answer: Answer) -> Profiles:
    """Profiles of the parameters that the recording determines, also if only one is free."""
    known, found, evaluations, warnings = answer.known(setup), {}, 0, []
    for i, name in enumerate(f.name for f in setup.asked):
        if known.known[i]:
            setup.progress(f"profile of {name}")
            try:
                found[name], count = _profile(answer, i, float(np.sqrt(known.covariance[i, i])))
            except KeyboardInterrupt:
                warnings.append(f"Interrupted at the profile of {name}: the fit is complete without it.")
                break
            evaluations += count
    return Profiles(of=found, evaluations=evaluations, warnings=warnings)


def _profile(answer: Answer, i: int, sd: float) -> tuple[Profile, int]:
    """The profile of coordinate i, whose standard error is sd, and how many simulations of all recordings it
    took.
    """
    sides = in_parallel(lambda side: _one_side(answer, i, sd, side), (-1.0, 1.0))
    points = {0.0: 0.0} | sides[0].points | sides[1].points
    offsets, at, best = np.asarray(sorted(points)), answer.at[0], answer.descent.u

    def value(offset: float) -> float:
        u = best.copy()
        u[i] += offset * sd
        return float(at.values(u)[i])

    lower, upper = (None if side.crossing is None else value(side.crossing) for side in sides)
    found = Profile(
        values=np.asarray([value(o) for o in offsets]),
        rise=np.asarray([points[o] for o in offsets]),
        parabola=offsets**2,
        lower95=lower,
        upper95=upper,
    )
    return found, sum(side.evaluations for side in sides)


class _Side(NamedTuple):
    """A profile on one side of the estimate.

    Attributes:
        points: rise of the sum of squares by the offset, in standard errors.
        crossing: offset at which it passes `LEVEL_95`; None where it does not.
        evaluations: times that all recordings were simulated.
    """

    points: dict[float, float]
    crossing: float | None
    evaluations: int


def _one_side(answer: Answer, i: int, sd: float, side: float) -> _Side:
    """The profile of coordinate i, whose standard error is sd, below (side -1) or above its estimate (1)."""
    best, problem, free = answer.descent.u, answer.problem, _others(answer, i)
    lowest = problem.cost(best, answer.predictions)
    start, offset, evaluations = best, side * FIRST, 0
    points: dict[float, float] = {}
    inside, outside = (0.0, 0.0), None
    for _ in range(POINTS):
        u = start.copy()
        u[i] = best[i] + offset * sd
        if free.any():
            held = descend(problem, u, active=free, max_steps=MAX_STEPS)
            u, at, evaluations = held.u, held.predictions, evaluations + held.evaluations
        else:
            at, evaluations = problem.predict(u), evaluations + 1
        rise = problem.cost(u, at) - lowest
        if not np.isfinite(rise):
            break
        points[offset] = rise
        start = u
        if rise > LEVEL_95:
            outside = (offset, rise)
        else:
            inside = (offset, rise)
        if abs(rise - LEVEL_95) < CLOSE:
            break
        if outside is None and abs(offset) >= FARTHEST:
            break
        offset = _next(inside, outside, side)
    crossing = None
    if outside is not None:
        crossing = _crossing(inside, outside)
    elif LEVEL_95 - inside[1] < CLOSE:
        crossing = inside[0]
    return _Side(points=points, crossing=crossing, evaluations=evaluations)


def _others(answer: Answer, i: int) -> np.ndarray:
    """Which coordinates adapt while coordinate i is held, (p,): all but i and those at the end of their
    range.
    """
    free = ~answer.descent.at_edge
    free[i] = False
    return free


def _crossing(inside: tuple[float, float], outside: tuple[float, float]) -> float:
    """Offset at which the square root of the rise, nearly straight, crosses the level."""
    (a, low), (b, high) = inside, outside
    low, high, level = np.sqrt(max(low, 0.0)), np.sqrt(high), np.sqrt(LEVEL_95)
    return float(a + (b - a) * (level - low) / (high - low))


def _next(inside: tuple[float, float], outside: tuple[float, float] | None, side: float) -> float:
    """Where to look next: outwards until the level is passed, then where a straight root would cross it."""
    if outside is not None:
        return _crossing(inside, outside)
    root = np.sqrt(max(inside[1], 1e-3)) / max(abs(inside[0]), 1e-3)
    guess = 1.05 * np.sqrt(LEVEL_95) / root
    return side * float(np.clip(guess, abs(inside[0]) + 0.3, FARTHEST))
