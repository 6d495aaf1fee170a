"""Levenberg-Marquardt on problems whose minimum is known in closed form."""

import dataclasses

import numpy as np
import pytest

from calibrate.inference.least_squares import BY_DIFFERENCES, WITH_DERIVATIVES, LinearModel, Rules, minimise

BROYDEN = Rules(BY_DIFFERENCES, tries=6, longest=1.5, settled=1e-12, updated=True)
PLAIN = Rules(WITH_DERIVATIVES)


@dataclasses.dataclass(frozen=True)
class Point:
    """Residuals at a point."""

    rows: np.ndarray
    penalty: float = 0.0


def rosenbrock(x):
    """Residuals whose squares are Rosenbrock's valley: the minimum is 0, at (1, 1)."""
    return np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])


def slopes_of_rosenbrock(x):
    """Their derivatives."""
    return np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


def descend(residuals, slopes, start, rules, *, most=200, evaluations=None, **options):
    """The end of a descent; the points evaluated are put in `evaluations`."""

    def at(x):
        if evaluations is not None:
            evaluations.append(x)
        return Point(residuals(x))

    start = np.asarray(start, float)
    return minimise(at, lambda x, _: slopes(x), start, at(start), rules=rules, most=most, **options)


@pytest.mark.parametrize("rules", [PLAIN, BROYDEN], ids=["with derivatives", "kept up to date"])
def test_the_end_of_a_bent_valley_is_found(rules):
    end = descend(rosenbrock, slopes_of_rosenbrock, [-1.2, 1.0], rules)
    np.testing.assert_allclose(end.x, [1.0, 1.0], atol=1e-5)
    assert end.cost < 1e-9


@pytest.mark.parametrize("rules", [PLAIN, BROYDEN], ids=["with derivatives", "kept up to date"])
def test_a_linear_problem_with_priors_has_the_solution_of_ridge_regression(rules):
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(12, 3)), rng.normal(size=12)
    end = descend(lambda x: A @ x - b, lambda x: A, np.zeros(3), rules, weight=2.5)
    np.testing.assert_allclose(end.x, np.linalg.solve(A.T @ A + 2.5 * np.eye(3), A.T @ b), atol=1e-6)


@pytest.mark.parametrize("rules", [PLAIN, BROYDEN], ids=["with derivatives", "kept up to date"])
def test_bounds_hold_and_the_rest_is_least_within_them(rules):
    # With x_0 held at its bound the least of (x_0 + x_1 - 3)^2 + (x_0 - x_1 + 1)^2 + x_1^2 is at a third of
    # (3 - x_0) + (x_0 + 1) = 4 by calculus: the free minimum is at x_0 = 1, beyond the bound.
    A, b = np.array([[1.0, 1.0], [1.0, -1.0], [0.0, 1.0]]), np.array([3.0, -1.0, 0.0])
    bounds = np.array([-2.0, -2.0]), np.array([0.5, 5.0])
    seen = []
    end = descend(lambda x: A @ x - b, lambda x: A, [-1.0, 4.0], rules, bounds=bounds, evaluations=seen)
    np.testing.assert_allclose(end.x, [0.5, 4 / 3], atol=1e-6)
    assert np.all(np.stack(seen) >= bounds[0]) and np.all(np.stack(seen) <= bounds[1])
    model = LinearModel(end.x, A @ end.x - b, A, 0.0, *bounds)
    assert model.free.tolist() == [False, True]


def test_where_an_evaluation_fails_shorter_steps_are_tried():
    """Beyond x = 2 there is nothing; the minimum, at 1.9, lies next to it."""

    def at(x):
        return None if x[0] > 2.0 else Point(np.array([np.exp(x[0]) - np.exp(1.9)]))

    start = np.array([-3.0])
    first = at(start)
    assert first is not None
    found = minimise(at, lambda x, _: np.exp(x)[:, None], start, first, rules=BROYDEN, most=100)
    assert found.x[0] == pytest.approx(1.9, abs=1e-4)


def test_broyden_spares_derivatives():
    taken = []

    def slopes(x):
        taken.append(x)
        return slopes_of_rosenbrock(x)

    steps = []
    descend(rosenbrock, slopes, [0.5, 0.5], BROYDEN, evaluations=steps)
    assert len(taken) < len(steps) / 2


def test_the_caller_may_end_a_descent_and_sees_every_step():
    seen = []

    def ended(step):
        seen.append(step)
        return len(seen) == 3

    end = descend(rosenbrock, slopes_of_rosenbrock, [-1.2, 1.0], PLAIN, ended=ended)
    assert len(seen) == 3
    last = [step.x for step in seen if step.taken][-1]
    np.testing.assert_array_equal(end.x, last)
    assert any(not step.taken for step in seen) or end.cost < 24.2


def test_a_coordinate_of_no_effect_stays():
    end = descend(lambda x: np.array([x[0] - 2.0]), lambda x: np.array([[1.0, 0.0]]), [0.0, 0.7], PLAIN)
    np.testing.assert_allclose(end.x, [2.0, 0.7], atol=1e-6)


def test_a_step_that_only_rounding_refuses_is_taken():
    """At the minimum the cost cannot fall further: the step is small, and must not be tried for ever."""
    damping = WITH_DERIVATIVES
    assert damping.takes(-1e-13, 1e-14, 1.0) and not damping.takes(-1e-11, 1e-14, 1.0)
    assert not BY_DIFFERENCES.takes(-1e-13, 1e-14, 1.0)
