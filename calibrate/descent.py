"""Least squares by optimistix' Levenberg-Marquardt, stepped from the host.

The residual and its Jacobian are computed once per step by the compiled simulator; the solver is given them
as the linear model that it would have derived by itself. So the solver's own program is tiny, the simulator
is compiled once for all uses, and a long fit can report its progress.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeGuard

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .coordinates import Prediction, Predictors
from .weighing import Weighing

if TYPE_CHECKING:
    from .task import Part

# The variables are chosen so that their Hessian is WHITE^2 at the start: the solver's first damping, 1,
# hardly shortens the step.
WHITE = 10.0
# Directions that the data see this much less than others stay damped.
DIMMEST = 1e-10
# Steps of ATOL WHITE = 0.02 standard errors end the descent. Much less is not met reliably: where samples
# change from locked to slipping, slopes jump.
ATOL, RTOL = 2e-3, 1e-5
NEAR_THE_EDGE = 0.85
FAR = 100.0
# A descent that near the end of the range gains less than this share in so many steps has found that there is
# no end.
PATIENCE, GAIN = 6, 0.01
# One that gains less than this in as many steps, in variances, walks along a valley without slope.
NO_GAIN = 0.01


@dataclasses.dataclass(frozen=True)
class Objective:
    """What is minimised: sum of squares of weighed residuals, and of prior rows ((u - centre) precision)^2.

    Attributes:
        predict: simulates the recordings.
        parts: the recordings.
        weighs: how the residuals of each are weighed.
        centre: prior means of the coordinates, (p,).
        precision: 1/sd of the priors, (p,); 0 without prior.
        reach: largest |u|, (p,).
    """

    predict: Predictors
    parts: tuple[Part, ...]
    weighs: tuple[Weighing, ...]
    centre: np.ndarray
    precision: np.ndarray
    reach: np.ndarray

    def residuals(self, predictions: tuple[Prediction, ...]) -> np.ndarray:
        """Weighed residuals of all recordings, (D,)."""
        return np.concatenate(
            [
                weigh(part.residual(prediction))
                for part, weigh, prediction in zip(self.parts, self.weighs, predictions, strict=True)
            ]
        )

    def jacobian(self, predictions: tuple[Prediction, ...]) -> np.ndarray:
        """Their derivatives by the coordinates, (D, p)."""
        return np.concatenate(
            [
                weigh(prediction.jacobian[part.where])
                for part, weigh, prediction in zip(self.parts, self.weighs, predictions, strict=True)
            ]
        )

    def rows(self, u: np.ndarray, predictions: tuple[Prediction, ...]) -> tuple[np.ndarray, np.ndarray]:
        """Residuals of data and priors, (D+p,), and their Jacobian, (D+p, p), at u."""
        prior = (u - self.centre) * self.precision
        data, slopes = self.residuals(predictions), self.jacobian(predictions)
        return np.concatenate([data, prior]), np.concatenate([slopes, np.diag(self.precision)])

    def cost(self, u: np.ndarray, predictions: tuple[Prediction, ...] | None) -> float:
        """Sum of squares; infinite where a simulation failed."""
        if not all_converged(predictions):
            return np.inf
        prior = (u - self.centre) * self.precision
        return float(np.sum(self.residuals(predictions) ** 2) + np.sum(prior**2))


def all_converged(predictions: tuple[Prediction, ...] | None) -> TypeGuard[tuple[Prediction, ...]]:
    """Whether every load step of every recording met its tolerance."""
    return predictions is not None and all(p.converged for p in predictions)


@dataclasses.dataclass(frozen=True)
class Descent:
    """Where a descent ended.

    Attributes:
        u: coordinates, (p,).
        predictions: the simulations there; None if none succeeded.
        converged: whether both steps and cost had become small.
        result: in words.
        iterations: steps taken, accepted or not.
        at_edge: which coordinates ended at their reach, (p,).
    """

    u: np.ndarray
    predictions: tuple[Prediction, ...] | None
    converged: bool
    result: str
    iterations: int
    at_edge: np.ndarray


def _linear_model(y, args):
    y0, value, jacobian = args
    return value + jacobian @ (y - y0), None


def _whitening(jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Matrices from y to u and back, with a Hessian in y of WHITE^2 along all that the data see."""
    size = np.linalg.norm(jacobian, axis=0)
    unit = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 1.0)
    values, vectors = np.linalg.eigh((jacobian * unit).T @ (jacobian * unit))
    seen = np.sqrt(np.maximum(values, DIMMEST * max(float(values[-1]), DIMMEST)))
    return unit[:, None] * vectors * (WHITE / seen), (vectors * (seen / WHITE)).T / unit


def _compressed(value: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As many rows as columns and one more, with the same sums of squares and products: the solver needs no
    other, and its program then depends on the number of parameters alone.
    """
    triangle = np.linalg.qr(np.concatenate([jacobian, value[:, None]], axis=1), mode="r")
    triangle = np.pad(triangle, ((0, jacobian.shape[1] + 1 - len(triangle)), (0, 0)))
    return triangle[:, -1], triangle[:, :-1]


_SOLVER = optx.LevenbergMarquardt(rtol=RTOL, atol=ATOL)
_step = eqx.filter_jit(_SOLVER.step)
_terminate = eqx.filter_jit(_SOLVER.terminate)


@functools.cache
def _before_first_step(rows: int, variables: int):
    """State of the solver before its first step, whose place is still to be put in.

    Kept, because a state carries the traced form of its Jacobian: a new one would compile the step anew.
    """
    y = jnp.zeros(variables)
    model = (y, jnp.zeros(rows), jnp.zeros((rows, variables)))
    shape = jax.ShapeDtypeStruct((rows,), y.dtype)
    return _SOLVER.init(_linear_model, y, model, {}, shape, None, frozenset())


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
        max_steps: simulations after which it gives up.
        progress: called with a line per step.

    Returns:
        The best point met. It never raises on failure: look at `converged`.
    """
    moving = np.flatnonzero(np.ones(len(start), bool) if active is None else active)
    reach = objective.reach[moving]
    first = objective.predict(start) if known is None else known
    if not all_converged(first):
        return Descent(
            start, first, False, "the simulation fails at the start", 0, np.zeros(len(start), bool)
        )
    into_u, into_y = _whitening(objective.rows(start, first)[1][:, moving])
    failed = np.full(len(moving) + 1, 1e3 * (1 + np.sqrt(objective.cost(start, first))))

    def position(y: np.ndarray) -> np.ndarray:
        u = np.array(start)
        u[moving] = reach * np.tanh(into_u @ y / reach)
        return u

    def evaluate(y: np.ndarray) -> tuple[tuple[Prediction, ...] | None, np.ndarray, np.ndarray]:
        u = position(y)
        found = first if np.allclose(u, start, rtol=0, atol=1e-13) else objective.predict(u)
        if not all_converged(found):
            return None, failed, np.zeros((len(failed), len(moving)))
        value, jacobian = objective.rows(u, found)
        far = np.clip(into_u @ y / reach, -FAR, FAR)
        return found, *_compressed(value, (jacobian[:, moving] / np.cosh(far) ** 2) @ into_u)

    begin = np.clip(start[moving] / reach, -NEAR_THE_EDGE, NEAR_THE_EDGE)
    y = jnp.asarray(into_y @ (np.arctanh(begin) * reach))
    state = eqx.tree_at(lambda s: s.y_eval, _before_first_step(len(failed), len(moving)), y)
    at_edge = np.zeros(len(start), bool)
    best, best_cost = (np.array(start), first), objective.cost(start, first)
    done, result, steps, costs = False, optx.RESULTS.successful, 0, [best_cost]
    while not done and steps < max_steps:
        steps += 1
        trial = np.asarray(state.y_eval)
        predictions, value, jacobian = evaluate(trial)
        cost = float(np.sum(value**2))
        if predictions is not None and cost <= best_cost:
            best, best_cost = (position(trial), predictions), cost
        model = (state.y_eval, jnp.asarray(value), jnp.asarray(jacobian))
        y, state, _ = _step(_linear_model, y, model, {}, state, frozenset())
        finished, result = _terminate(_linear_model, y, None, {}, state, frozenset())
        done = bool(finished)
        if progress is not None:
            progress(f"fitting: step {steps}, sum of squares {best_cost:.6g}")
        costs.append(best_cost)
        at_edge[moving] = np.abs(best[0][moving]) > NEAR_THE_EDGE * reach
        if at_edge.any() and steps > PATIENCE and costs[-PATIENCE - 1] - costs[-1] < GAIN * costs[-1]:
            return Descent(*best, True, "ended at the end of the range searched", steps, at_edge)
        if steps > PATIENCE and costs[-PATIENCE - 1] - costs[-1] < NO_GAIN:
            return Descent(*best, True, "converged: no further gain", steps, at_edge)
    converged = done and bool(result == optx.RESULTS.successful)
    words = (
        f"no convergence within {max_steps} steps"
        if not done
        else "converged"
        if converged
        else str(optx.RESULTS[result])
    )
    return Descent(*best, converged, words, steps, at_edge)
