"""The descent of a fit to the minimum of its least squares problem.

The residual and its Jacobian are computed once per step by the compiled simulator. The variables of the
descent are scaled so that the data constrain all directions equally, and so that no coordinate leaves the
range searched.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from .least_squares import WITH_DERIVATIVES, Rules, Step, minimise
from .objective import Objective, all_converged
from .simulated_readings import Prediction

# The variables are chosen so that their Hessian is WHITE^2 at the start: the first damping, 1, hardly
# shortens the step.
WHITE = 10.0
# Eigenvalues of the Hessian below this share of the largest belong to no effect: a change of several numbers
# that the data cannot see is not made, and a number without any effect is damped as if it had this share.
DIMMEST = 1e-10
# Steps of ATOL WHITE = 0.02 standard errors end the descent. Much less is not met reliably: where samples
# change from locked to slipping, slopes jump.
ATOL, RTOL = 2e-3, 1e-5
# Share of its reach from which a coordinate counts as at the end of the range searched.
NEAR_THE_EDGE = 0.85
# Limit of the argument of cosh, which would overflow.
FAR = 100.0
# A descent that lowers the cost by less than this share in PATIENCE steps near the end of the range ends
# there.
PATIENCE, GAIN = 6, 0.01
# A descent that lowers the cost by less than this in as many steps, in variances, follows a flat valley.
NO_GAIN = 0.01
FAILS = "the simulation fails at the start"


@dataclasses.dataclass(frozen=True)
class Descent:
    """Where a descent ended.

    Attributes:
        u: coordinates, (p,).
        predictions: the simulations there; None if none succeeded.
        converged: whether both steps and cost had become small.
        result: in words.
        iterations: steps taken, accepted or not.
        evaluations: times that all recordings were simulated.
        at_edge: which coordinates ended at their reach, (p,).
    """

    u: np.ndarray
    predictions: tuple[Prediction, ...] | None
    converged: bool
    result: str
    iterations: int
    evaluations: int
    at_edge: np.ndarray


def _whitening(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Matrices from y to u, (p, r), and back, such that the Hessian in y is WHITE^2 along all directions that
    the data constrain; and how many directions are left out, p - r, because a change of several numbers
    along them, of which each has an effect, has none: steps along them would be arbitrarily long.
    """
    size = np.linalg.norm(jacobian, axis=0)
    unit = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 1.0)
    values, vectors = np.linalg.eigh((jacobian * unit).T @ (jacobian * unit))
    dim = DIMMEST * max(float(values[-1]), DIMMEST)
    heard = np.sum(np.where(size > 0, vectors.T, 0.0) ** 2, axis=1) > 0.5
    kept = (values > dim) | ~heard
    seen = np.sqrt(np.maximum(values[kept], dim))
    vectors = vectors[:, kept]
    into_u, into_y = unit[:, None] * vectors * (WHITE / seen), (vectors * (seen / WHITE)).T / unit
    return into_u, into_y, int(np.sum(~kept))


def _compressed(value: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals and Jacobian compressed to one row more than there are columns, with the same sums of squares
    and products: the solver needs nothing else.
    """
    triangle = np.linalg.qr(np.concatenate([jacobian, value[:, None]], axis=1), mode="r")
    triangle = np.pad(triangle, ((0, jacobian.shape[1] + 1 - len(triangle)), (0, 0)))
    return triangle[:, -1], triangle[:, :-1]


@dataclasses.dataclass(frozen=True, eq=False)
class _Found:
    """A point of a descent: the simulations there, and residuals and derivatives compressed."""

    predictions: tuple[Prediction, ...]
    rows: np.ndarray
    jacobian: np.ndarray
    penalty: float = 0.0

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(np.sum(self.rows**2))


class _Watch:
    """Follows a descent step by step: the best point met, and why it ends.

    Args:
        start: where it begins, (p,).
        first: simulations there.
        cost: its sum of squares.
        near: maps coordinates to whether each lies near the end of the range searched, (p,) bool.
        position: maps the variables of the descent to coordinates.
        most: steps after which it gives up.
        progress: called with a line per step, or None.
    """

    def __init__(
        self,
        start: np.ndarray,
        first: tuple[Prediction, ...],
        cost: float,
        *,
        near: Callable[[np.ndarray], np.ndarray],
        position: Callable[[np.ndarray], np.ndarray],
        most: int,
        progress: Callable[[str], None] | None,
    ):
        self.u, self.predictions, self.costs = start, first, [cost]
        self.near, self.position, self.most, self.progress = near, position, most, progress
        self.steps, self.converged, self.result = 0, False, f"no convergence within {most} steps"

    def __call__(self, step: Step[_Found]) -> bool:
        """Record a step that was tried; True ends the descent."""
        self.steps += 1
        found, best = step.point, self.costs[-1]
        if found is not None and found.cost <= best:
            self.u, self.predictions, best = self.position(step.x), found.predictions, found.cost
        self.costs.append(best)
        if self.progress is not None:
            self.progress(f"fitting: step {self.steps}, sum of squares {best:.6g}")
        patient = self.steps > PATIENCE
        gained = self.costs[-PATIENCE - 1] - best if patient else np.inf
        if patient and self.near(self.u).any() and gained < GAIN * best:
            return self._end("ended at the end of the range searched")
        if patient and gained < NO_GAIN:
            return self._end("converged: no further gain")
        if (
            found is not None
            and step.taken
            and _settled(step.moved, step.x)
            and _settled(step.change, found.rows)
        ):
            return self._end("converged")
        return self.steps >= self.most

    def _end(self, result: str) -> bool:
        self.converged, self.result = True, result
        return True


def _settled(change: np.ndarray, size: np.ndarray) -> bool:
    """Whether each entry of a change is below ATOL plus RTOL of what changes."""
    return bool(np.max(np.abs(change) / (ATOL + RTOL * np.abs(size))) < 1)


def descend(
    objective: Objective,
    start: np.ndarray,
    *,
    active: np.ndarray | None = None,
    known: tuple[Prediction, ...] | None = None,
    max_steps: int = 60,
    progress: Callable[[str], None] | None = None,
) -> Descent:
    """Minimise from a start.

    Args:
        objective: what is minimised.
        start: coordinates, (p,).
        active: which coordinates may move, (p,) bool; all unless given.
        known: the simulations at the start, if they have been done.
        max_steps: steps after which it gives up.
        progress: called with a line per step.

    Returns:
        The best point met. It never raises on failure: look at `converged`.
    """
    moving = np.flatnonzero(np.ones(len(start), bool) if active is None else active)
    reach = objective.reach[moving]
    first = objective.predict(start) if known is None else known
    evaluations = int(known is None)
    if not all_converged(first):
        return Descent(
            u=start,
            predictions=first,
            converged=False,
            result=FAILS,
            iterations=0,
            evaluations=evaluations,
            at_edge=np.zeros(len(start), bool),
        )
    into_u, into_y, unseen = _whitening(objective.rows(start, first)[1][:, moving])
    begin = np.arctanh(np.clip(start[moving] / reach, -NEAR_THE_EDGE, NEAR_THE_EDGE)) * reach
    y = into_y @ begin
    fixed = begin - into_u @ y if unseen else np.zeros(len(moving))

    def position(y: np.ndarray) -> np.ndarray:
        u = np.array(start)
        u[moving] = reach * np.tanh((fixed + into_u @ y) / reach)
        return u

    def near(u: np.ndarray) -> np.ndarray:
        edge = np.zeros(len(start), bool)
        edge[moving] = np.abs(u[moving]) > NEAR_THE_EDGE * reach
        return edge

    def compressed(y: np.ndarray, found: tuple[Prediction, ...]) -> _Found:
        value, jacobian = objective.rows(position(y), found)
        far = np.clip((fixed + into_u @ y) / reach, -FAR, FAR)
        return _Found(found, *_compressed(value, (jacobian[:, moving] / np.cosh(far) ** 2) @ into_u))

    def evaluate(y: np.ndarray) -> _Found | None:
        nonlocal evaluations
        u = position(y)
        same = np.allclose(u, start, rtol=0, atol=1e-13)
        evaluations += not same
        found = first if same else objective.predict(u)
        return compressed(y, found) if all_converged(found) else None

    watch = _Watch(
        start,
        first,
        objective.cost(start, first),
        near=near,
        position=position,
        most=max_steps,
        progress=progress,
    )
    found = evaluate(y)
    if found is None:  # the start lies beyond the range, and at its end the simulation fails
        watch.result = FAILS
    elif not watch(Step(x=y, point=found, moved=np.zeros_like(y), change=found.rows, taken=True)):
        minimise(
            evaluate,
            lambda _, point: point.jacobian,
            y,
            found,
            rules=Rules(WITH_DERIVATIVES),
            most=max_steps,
            ended=watch,
        )
    left = max_steps - watch.steps
    if unseen and left > 0 and all_converged(watch.predictions):
        # Where it ended, the data may see what they did not see at the start.
        *_, now = _whitening(objective.rows(watch.u, watch.predictions)[1][:, moving])
        if now < unseen:
            more = descend(
                objective,
                watch.u,
                active=active,
                known=watch.predictions,
                max_steps=left,
                progress=progress,
            )
            return dataclasses.replace(
                more,
                iterations=watch.steps + more.iterations,
                evaluations=evaluations + more.evaluations,
            )
    return Descent(
        u=watch.u,
        predictions=watch.predictions,
        converged=watch.converged,
        result=watch.result,
        iterations=watch.steps,
        evaluations=evaluations,
        at_edge=near(watch.u),
    )
