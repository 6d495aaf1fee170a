"""Lines in the plane or in space as cubic B-splines, to a tolerance."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

DEGREE = 3
FIRST_PIECES = 4  # between two kinks, before any is halved
SAMPLES = 12  # of the line in each piece, to which the spline is fitted
LOOKED_AT = 24  # places in each piece where it is compared with the line
ROUNDS = 20  # of halving
MOST_PIECES = 2000
HELD = 1e4  # weight of the two ends, which other lines join

Line = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True, eq=False)
class Spline:
    """A cubic B-spline over arc length of the midline, clamped at both ends.

    Attributes:
        knots: with their multiplicity [m], (points + 4,).
        points: control points [m], (points, axes).
        deviation: largest distance from the line that it stands for, at the same arc length [m].
    """

    knots: np.ndarray
    points: np.ndarray
    deviation: float

    @property
    def ends(self) -> tuple[float, float]:
        """Arc lengths where it begins and ends [m]."""
        return float(self.knots[0]), float(self.knots[-1])

    def at(self, s: np.ndarray, order: int = 0) -> np.ndarray:
        """Its places [m], or their derivatives of an order by arc length, (N, axes), at s [m], (N,)."""
        return BSpline(self.knots, self.points, DEGREE)(np.clip(s, *self.ends), order)

    def straight(self, tolerance: float) -> bool:
        """Whether its control points lie on the line between its ends, to a tolerance [m]."""
        start, chord = self.points[0], self.points[-1] - self.points[0]
        square = max(float(np.sum(chord**2)), 1e-300)
        from_start = self.points - start
        foot = (from_start @ chord / square)[:, None] * chord
        return bool(np.all(np.linalg.norm(from_start - foot, axis=1) <= tolerance))


def fitted(line: Line, start: float, end: float, *, tolerance: float, kinks: Iterable[float] = ()) -> Spline:
    """The cubic spline that follows a line to within a tolerance, with as few pieces as halving finds.

    It is fitted by least squares to samples of every piece; pieces in which it is farther from the line than
    the tolerance are halved until none is. The distance is taken at the same arc length, which is never
    less than the distance between the two curves.

    Args:
        line: places [m], (N, axes), at arc lengths [m], (N,); continuous.
        start, end: arc lengths of its ends [m].
        tolerance: [m].
        kinks: arc lengths [m] where its second derivative may jump; so may the spline's.

    Raises:
        ValueError: the tolerance is below what double numbers resolve of the line.
    """
    near = 1e-9 * (end - start)
    inner = sorted({float(k) for k in kinks if start + near < k < end - near})
    bounds = [start, *inner, end]
    parts = [np.linspace(a, b, FIRST_PIECES + 1) for a, b in itertools.pairwise(bounds)]
    breaks = np.unique(np.concatenate(parts))
    for _ in range(ROUNDS):
        spline, off = _fit(line, breaks, inner)
        far = np.flatnonzero(off > tolerance)
        if not far.size:
            return spline
        middles = 0.5 * (breaks[far] + breaks[far + 1])
        breaks = np.sort(np.concatenate([breaks, middles]))
        if len(breaks) > MOST_PIECES:
            break
    raise ValueError(
        f"no spline follows the line to {tolerance:g} m; the nearest is {spline.deviation:.2g} m off"
    )


def _fit(line: Line, breaks: np.ndarray, kinks: list[float]) -> tuple[Spline, np.ndarray]:
    """The spline with given breaks, and its largest distance from the line in each piece [m], (pieces,)."""
    share = np.linspace(0.0, 1.0, SAMPLES, endpoint=False)
    s = np.append((breaks[:-1, None] + share * np.diff(breaks)[:, None]).ravel(), breaks[-1])
    doubled = [k for k in breaks[1:-1] for _ in range(2 if np.any(np.isclose(k, kinks, rtol=1e-12)) else 1)]
    knots = np.concatenate([[breaks[0]] * (DEGREE + 1), doubled, [breaks[-1]] * (DEGREE + 1)])
    weights = np.ones(len(s))
    weights[[0, -1]] = HELD
    found = make_lsq_spline(s, line(s), knots, DEGREE, w=weights)
    between = (np.arange(LOOKED_AT) + 0.5) / LOOKED_AT
    looked = breaks[:-1, None] + between * np.diff(breaks)[:, None]
    gap = np.linalg.norm(found(looked.ravel()) - line(looked.ravel()), axis=1).reshape(looked.shape)
    off = gap.max(axis=1)
    return Spline(knots, np.asarray(found.c), float(off.max())), off
