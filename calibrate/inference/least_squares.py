"""Nonlinear least squares by the method of Levenberg and Marquardt, within bounds, stepped from the host.

Minimised is |r(x)|^2 + w |x|^2 over a box, w being the weight of standard normal priors on the coordinates.
Each step minimises the linear model of the residuals under a damping, which rises where a step fails and
falls where one succeeds. The rest depends on what a derivative costs, so it is a setting: a fit has its
derivatives with every simulation; a diagnosis pays a simulation for each, and updates them by Broyden's
formula.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np


class Evaluated(Protocol):
    """The result of an evaluation at a point."""

    @property
    def rows(self) -> np.ndarray:
        """Residuals, (n,)."""
        ...

    @property
    def penalty(self) -> float:
        """What is added to the sum of squares."""
        ...


P = TypeVar("P", bound=Evaluated)
# An updated Jacobian is recomputed if a step achieves less than this share of the promised drop.
TRUSTED = 0.25


@dataclasses.dataclass(frozen=True)
class Damping:
    """How strongly steps are damped, and how the damping follows their success.

    Attributes:
        value: of the damping now, dimensionless.
        by_curvature: whether it multiplies the curvature along each coordinate (Marquardt), or is the same
            along all of them (Levenberg).
        taken: share of the promised drop that a step must exceed to be taken.
        good: share of it from which the damping is eased.
        eased, raised: factors that divide the damping after a good step, and multiply it after a refused
            step.
        least, most: limits of the damping.
        rounding: share of the cost by which rounding may make a step seem worse than it is, so that one that
            promises less is taken.
    """

    value: float
    by_curvature: bool
    taken: float
    good: float
    eased: float
    raised: float
    least: float = 0.0
    most: float = np.inf
    rounding: float = 0.0

    def takes(self, gained: float, promised: float, cost: float) -> bool:
        """Whether a step is taken, by the drop of the cost and the one that its linear model promised."""
        if self.taken == 0:
            return gained > 0
        return gained >= self.taken * promised - self.rounding * cost

    def after(self, gained: float, promised: float, *, taken: bool) -> Damping:
        """The damping for the step after one that gained so much, and was taken or not."""
        value = self.value
        if not taken:
            value = value * self.raised
        elif promised > 0 and gained > self.good * promised:
            value = value / self.eased
        return dataclasses.replace(self, value=min(max(value, self.least), self.most))


# For residuals that come with their derivatives: the constants of Gould, Orban, Sartenaer and Toint,
# "Sensitivity of trust-region algorithms to their parameters" (2005), as in optimistix.
WITH_DERIVATIVES = Damping(
    1.0, by_curvature=False, taken=0.01, good=0.99, eased=3.5, raised=4.0, rounding=1e-12
)
# For derivatives by differences over steps that cross the kinks of friction: any drop is taken.
BY_DIFFERENCES = Damping(
    1e-3, by_curvature=True, taken=0.0, good=0.0, eased=10.0, raised=10.0, least=1e-6, most=1e6
)


@dataclasses.dataclass(frozen=True)
class Rules:
    """How a descent goes on and ends.

    Attributes:
        damping: at the start, and how it changes.
        tries: steps tried with the same derivatives before these are recomputed.
        longest: largest change of a coordinate in one step.
        settled: promised drop below which no step is tried; minus infinity: the caller ends the descent.
        updated: whether the Jacobian is kept up to date by Broyden's formula while that serves.
    """

    damping: Damping
    tries: int = 1
    longest: float = np.inf
    settled: float = -np.inf
    updated: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class LinearModel:
    """The sum of squares near a point: |rows + jacobian m|^2 + weight |x + m|^2 at x + m.

    Attributes:
        x: the point, (p,).
        rows, jacobian: residuals there, (n,), and their derivatives, (n, p).
        weight: of the priors.
        low, high: bounds, (p,).
    """

    x: np.ndarray
    rows: np.ndarray
    jacobian: np.ndarray
    weight: float
    low: np.ndarray
    high: np.ndarray

    @functools.cached_property
    def gradient(self) -> np.ndarray:
        """Half the gradient at the point, (p,)."""
        return self.jacobian.T @ self.rows + self.weight * self.x

    @functools.cached_property
    def hessian(self) -> np.ndarray:
        """Half the second derivatives, (p, p)."""
        return self.jacobian.T @ self.jacobian + self.weight * np.eye(len(self.x))

    @functools.cached_property
    def free(self) -> np.ndarray:
        """Which coordinates may move: all but those that the gradient holds at their bound, (p,) bool."""
        held_low = (self.x <= self.low) & (self.gradient > 0)
        held_high = (self.x >= self.high) & (self.gradient < 0)
        return ~(held_low | held_high)

    def next(self, damping: Damping, longest: float) -> np.ndarray:
        """Where the damped step leads, (p,), shortened to `longest` and cut off at the bounds."""
        free = self.free
        A, step = self.hessian[np.ix_(free, free)], np.zeros(len(self.x))
        damped = A + damping.value * np.diag(np.diag(A) if damping.by_curvature else np.ones(len(A)))
        try:
            step[free] = -np.linalg.solve(damped, self.gradient[free])
        except np.linalg.LinAlgError:  # a coordinate without effect, no longer damped
            step[free] = -np.linalg.lstsq(damped, self.gradient[free], rcond=None)[0]
        shorter = min(1.0, longest / max(float(np.max(np.abs(step))), 1e-300))
        return np.clip(self.x + shorter * step, self.low, self.high)

    def promised(self, moved: np.ndarray) -> float:
        """By how much the sum of squares falls after a step, if the model holds."""
        return float(-2 * self.gradient @ moved - moved @ self.hessian @ moved)


class Step(NamedTuple, Generic[P]):
    """A step that was tried.

    Attributes:
        x: where it leads, (p,).
        point: what was found there; None where the evaluation failed.
        moved: the step, (p,).
        change: of the residuals, (n,), zero where the evaluation failed.
        taken: whether it was taken.
    """

    x: np.ndarray
    point: P | None
    moved: np.ndarray
    change: np.ndarray
    taken: bool


class Minimum(NamedTuple, Generic[P]):
    """Where a descent ended.

    Attributes:
        x: coordinates, (p,).
        point: what was found there.
        jacobian: derivatives there, (n, p), maybe updated by Broyden's formula; None where given up.
        fresh: whether they were computed in the last iteration, apart from an update by its step.
        cost: sum of squares with priors and penalty.
    """

    x: np.ndarray
    point: P
    jacobian: np.ndarray | None
    fresh: bool
    cost: float


def minimise(
    at: Callable[[np.ndarray], P | None],
    slopes: Callable[[np.ndarray, P], np.ndarray],
    start: np.ndarray,
    first: P,
    *,
    rules: Rules,
    most: int,
    bounds: tuple[np.ndarray, np.ndarray] | None = None,
    weight: float = 0.0,
    jacobian: np.ndarray | None = None,
    ended: Callable[[Step[P]], bool] = lambda _: False,
) -> Minimum[P]:
    """Descend from a start.

    Args:
        at: what is found at coordinates, (p,); None where the evaluation fails.
        slopes: derivatives of the residuals at a point, (n, p).
        start: coordinates, within the bounds.
        first: what is found there.
        rules: how steps are damped, tried and ended.
        most: iterations, each with `rules.tries` steps at most.
        bounds: lower and upper, (p,) each; none unless given.
        weight: of the standard normal priors.
        jacobian: derivatives at the start, if known, maybe roughly.
        ended: called after each step that was tried; True ends the descent.

    Returns:
        The last point taken, which has the lowest cost.
    """
    low, high = bounds or (np.full(len(start), -np.inf), np.full(len(start), np.inf))

    def cost(point: P, x: np.ndarray) -> float:
        return float(np.sum(point.rows**2) + weight * np.sum(x**2) + point.penalty)

    x, here, damping, fresh = np.array(start), first, rules.damping, False
    least = cost(here, x)
    for _ in range(most):
        if jacobian is None:
            jacobian, fresh = slopes(x, here), True
        model = LinearModel(x, here.rows, jacobian, weight, low, high)
        if not model.free.any():
            break
        gained, promised = 0.0, 0.0
        for _ in range(rules.tries):
            trial = model.next(damping, rules.longest)
            moved = trial - x
            promised = model.promised(moved)
            if promised < rules.settled:
                break
            there = at(trial)
            new = np.inf if there is None else cost(there, trial)
            drop = least - new
            taken = there is not None and damping.takes(drop, promised, least)
            damping = damping.after(drop, promised, taken=taken)
            change = np.zeros_like(here.rows) if there is None else there.rows - here.rows
            if there is not None and taken:
                broyden = np.outer(change - model.jacobian @ moved, moved) / max(float(moved @ moved), 1e-300)
                jacobian = model.jacobian + broyden if rules.updated else None
                x, here, gained, least = trial, there, drop, new
            if ended(Step(trial, there, moved, change, taken)):
                return Minimum(x, here, jacobian, fresh, least)
            if taken or not fresh:
                break
        if rules.updated and (gained < TRUSTED * promised or gained < rules.settled):
            if fresh and gained < rules.settled:
                break
            jacobian = None
        fresh = False
    return Minimum(x, here, jacobian, fresh, least)
