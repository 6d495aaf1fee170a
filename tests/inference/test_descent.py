"""The descent of a fit, and where it starts, on problems that take no simulation."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibrate.fitting import start
from calibrate.fitting.summary import _failure
from calibrate.inference.descent import Descent, descend
from calibrate.inference.objective import Objective
from gtr_jax.robot.parameters import Parameter
from gtr_jax.terms import REGISTRY

TIMES = np.linspace(0.05, 3.0, 40)
SD = 0.01


@dataclasses.dataclass(frozen=True)
class Simulated:
    """What friction μ that builds up over length/compliance gives, at coordinates ln(μ, length, compliance);
    to rounding it depends on their ratio alone.
    """

    u: np.ndarray

    converged, failed = True, 0

    @property
    def values(self):
        return np.exp(self.u[0]) * (1 - np.exp(-TIMES * self.ratio)) + 1e-7 * np.exp(self.u[1]) * TIMES**2

    @property
    def ratio(self):
        return np.exp(self.u[2] - self.u[1])

    @property
    def jacobian(self):
        mu, off = np.exp(self.u[0]), np.exp(-TIMES * self.ratio)
        along = mu * TIMES * self.ratio * off
        own = 1e-7 * np.exp(self.u[1]) * TIMES**2
        return np.stack([mu * (1 - off), -along + own, along], axis=-1)


@dataclasses.dataclass(frozen=True)
class Problem(Objective):
    """The same as a least squares problem about a truth; held numbers have no effect."""

    recorded: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))
    held: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(3, bool))

    def predict(self, u) -> Any:
        return (Simulated(np.where(self.held, 0.0, u)),)

    def residuals(self, predictions):
        return (predictions[0].values - self.recorded) / SD

    def jacobian(self, predictions):
        return np.where(self.held, 0.0, predictions[0].jacobian / SD)


def problem(truth, held=(False, False, False)):
    noise = SD * np.random.default_rng(0).standard_normal(len(TIMES))
    recorded = Simulated(np.log(truth)).values + noise
    zero = np.zeros(3)
    return Problem((), (), (), zero, zero, np.full(3, np.log(30.0)), recorded=recorded, held=np.array(held))


@pytest.mark.parametrize("mu", (0.2, 0.3, 0.6))
@pytest.mark.parametrize("ratio", (0.6, 1.0, 4.0))
def test_a_combination_without_effect_is_left_alone(mu, ratio):
    of = problem((0.3, 1.0, 1.3))
    begin = np.log([mu, 1.0, ratio])
    found = descend(of, begin)
    assert found.converged and not found.at_edge.any()
    assert of.cost(found.u, found.predictions) < 1.5 * len(TIMES)
    assert np.exp(found.u[0]) == pytest.approx(0.3, rel=0.05)
    assert np.exp(found.u[2] - found.u[1]) == pytest.approx(1.3, rel=0.2)
    assert found.u[1] + found.u[2] == pytest.approx(begin[1] + begin[2], abs=0.1)  # they moved apart alone


def test_what_the_start_does_not_see_is_found_afterwards():
    @dataclasses.dataclass(frozen=True)
    class Hidden(Problem):
        """The first two act together until the third has come down from where it starts."""

        def predict(self, u) -> Any:
            return (SimpleNamespace(u=u, converged=True, failed=0),)

        def residuals(self, predictions):
            x, y, z = predictions[0].u
            low = max(1.0 - z, 0.0) ** 2
            return np.array([x - y - 0.5, z, low * (x + y - 0.3)])

        def jacobian(self, predictions):
            x, y, z = predictions[0].u
            low, by_z = max(1.0 - z, 0.0) ** 2, -2 * max(1.0 - z, 0.0)
            return np.array([[1.0, -1.0, 0.0], [0.0, 0.0, 1.0], [low, low, by_z * (x + y - 0.3)]])

    zero = np.zeros(3)
    of = Hidden((), (), (), zero, zero, np.full(3, 3.0))
    found = descend(of, np.array([0.0, 0.0, 1.2]))
    np.testing.assert_allclose(found.u, [0.4, -0.1, 0.0], atol=1e-3)
    assert found.converged and found.iterations > 3


def setup_of(*names, priors=None) -> Any:
    """What the search for a start asks of a setup with these free numbers."""
    free = []
    for name in names:
        term = REGISTRY.get(name.partition(".")[0])
        entry = Parameter(name, name, "", 0.0, log=term is None, term=term)
        free.append(SimpleNamespace(entry=entry, name=name, initial=1e-3))
    return SimpleNamespace(
        free=free,
        asked=free,
        names=list(names),
        priors=priors or [None] * len(names),
        initial=np.full(len(names), 1e-3),
        friction=lambda: [i for i, name in enumerate(names) if name.partition(".")[0] == "mu"],
        progress=lambda _: None,
        parts=(),
    )


def test_starts_cover_what_is_usual():
    names = ("mu.a", "mu.b", "presliding.length", "tendon-stretch.compliance", "E")
    tried = np.array(start.across(setup_of(*names)))
    assert tried.shape == (start.POINTS * 3, 5)
    np.testing.assert_array_equal(tried[:, 0], tried[:, 1])  # tendons alike
    assert np.all(tried[:, 4] == 1e-3)  # no term's
    for column, name in ((2, "presliding"), (3, "tendon-stretch")):
        low, high = REGISTRY[name].quantities[0].usual
        share = np.sort(np.log(tried[:, column] / low) / np.log(high / low))
        assert np.all((share >= 0) & (share <= 1)) and np.max(np.diff(share)) < 0.2
    # Together they reach every ratio, and fill each half of the square evenly.
    a, b = (np.log(tried[:, k]) > np.median(np.log(tried[:, k])) for k in (2, 3))
    assert abs(np.mean(a == b) - 0.5) < 0.1
    assert start.across(setup_of("mu", "E")) == []
    assert start.across(setup_of("mu", "presliding.length", priors=[None, 1e-4])) == []


def test_models_with_fewer_free_numbers():
    def held(*names):
        return [row.tolist() for row in start.nested(setup_of(*names))]

    assert held("mu") == [] and held("mu.a", "mu.b") == []
    assert held("mu", "E") == [[True, False], [False, True]]
    three = held("mu", "presliding.length", "tendon-stretch.compliance")
    assert three == [[True, False, False], [False, True, False], [False, False, True], [False, True, True]]


def test_an_end_that_fewer_free_numbers_beat_is_none(monkeypatch):
    truth = (0.3, 1.0, 1.0)
    whole, fewer = problem(truth), problem(truth, (False, True, True))
    setup = setup_of("mu", "presliding.length", "tendon-stretch.compliance")
    monkeypatch.setattr(Objective, "of", lambda setup, at: fewer)
    setup.parts = (SimpleNamespace(residual=lambda found: (found.values - whole.recorded)[None], tips=1),)
    near = start.Held(fewer.held, (), np.log([0.2, 1.0, 1.0]), 0.0)
    begun = start.Start((), np.zeros(3), 3, 1, 0, near)
    stuck = np.log([1.0, 1.0, 0.2])
    at_stuck = whole.cost(stuck, whole.predict(stuck))
    best = descend(whole, np.log(truth))
    assert start.beaten(setup, whole, whole.cost(best.u, best.predictions), begun)[0] is None
    assert start.beaten(setup, whole, at_stuck, begun._replace(nested=None)) == (None, 0)
    found, count = start.beaten(setup, whole, at_stuck, begun)
    assert found is not None and found.held.tolist() == [False, True, True] and count > 1
    judged: Any = SimpleNamespace(residual=np.full((1, 40), 0.871), noises=(0.02,))
    at_end: Any = whole.predict(stuck)
    ended = Descent(stuck, at_end, True, "converged", 3, 3, np.zeros(3, bool))
    answer: Any = SimpleNamespace(predictions=at_end, descent=ended, judged=(judged,))
    assert _failure(setup, answer, None) == ""
    assert _failure(setup, answer, found._replace(rms=0.62)) == (
        "the search ended at a poor optimum: with presliding.length and tendon-stretch.compliance as in the "
        "robot file, a fit of the others alone leaves less (0.62 N rms instead of 0.871 N); fit --free mu "
        "first, write what it finds into the robot file, and give presliding.length and "
        "tendon-stretch.compliance start values there"
    )
