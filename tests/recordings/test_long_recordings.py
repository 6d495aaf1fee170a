"""Recordings longer than the simulator need follow: simulated at nodes, compared at every sample."""

import dataclasses

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from benchmarks.coverage import Case, noisy, recorded
from calibrate.inference.coordinates import coordinates, places
from calibrate.inference.number import number_at
from calibrate.inference.predictor import Predictor
from gtr_jax.recordings.base_tension import estimate_base, exact
from gtr_jax.robot.parameters import parameter


@pytest.fixture(scope="module")
def long():
    """25,000 samples of the independent simulator's loops, with our own tip tension, and noise."""
    case = Case("coulomb", 0.1, 0.05, denser=60)
    config, run = recorded(case)
    run = dataclasses.replace(run, T_tip=np.asarray(gtr.simulate(gtr.build_robot(config), run.T_base).T_tip))
    return config, run, noisy(case, run, 1)


def test_nodes_carry_the_history(long):
    config, run, _ = long
    robot = gtr.build_robot(config)
    base = estimate_base(run.T_base, run.time, sd=0.01)
    nodes = base.nodes(0.2)
    assert set(base.knots) <= set(nodes.tolist()) and len(nodes) < len(run.T_base) / 10
    at = coordinates(places(robot, ["mu"]), [number_at(parameter(robot, "mu"), float(robot.value("mu")))])
    whole = Predictor(robot, at, base.T_base)(np.zeros(1))
    coarse = Predictor(robot, at, base.T_base, nodes=nodes)(np.zeros(1))
    assert whole is not None and coarse is not None
    off = coarse.values[0] - whole.values[0]
    assert np.sqrt(np.mean(off**2)) < 2e-3, "N, a fraction of any cell's noise"
    assert np.max(np.abs(off)) < 0.1, "between the nodes around a switch"
    runs = np.searchsorted(base.knots[1:-1], np.arange(len(base.T_base)), side="right")
    moving = np.abs(np.diff(base.T_base[base.knots]))[runs] > 0.1  # in a hold, rounding decides the phase
    assert np.mean(moving) > 0.8
    assert np.mean((coarse.phases == whole.phases)[moving]) > 0.99
    assert np.mean((coarse.slips == whole.slips)[moving]) > 0.99
    slopes = np.sum(coarse.jacobian[0] * whole.jacobian[0]) / np.sum(whole.jacobian[0] ** 2)
    assert slopes == pytest.approx(1.0, abs=2e-3), "it jumps at a switch, between two nodes"


def test_all_samples_as_nodes_change_nothing(make_robot):
    robot = make_robot()
    at = coordinates(places(robot, ["mu"]), [number_at(parameter(robot, "mu"), float(robot.value("mu")))])
    T_base = np.concatenate([np.linspace(0, 30, 16), np.linspace(30, 5, 16)])
    plain, noded = (Predictor(robot, at, T_base, nodes=nodes)(np.zeros(1)) for nodes in (None, np.arange(32)))
    assert plain is not None and noded is not None
    np.testing.assert_array_equal(plain.values[0], noded.values[0])
    assert exact(T_base).nodes(1.0).tolist() == list(range(32))


def test_a_long_recording_is_fitted(long):
    config, _, recording = long
    fit = calibrate.fit(config, recording)
    assert fit.converged and fit.settings["samples_simulated"] < 3000 < len(fit.residual)
    mu = fit["mu"]
    assert mu.sd is not None and abs(mu.value - 0.3) < 4 * mu.sd and mu.sd < 1e-3
    assert fit.chi2_per_n == pytest.approx(1.0, abs=0.05)
    assert len(fit.T_base) == len(fit.T_tip) == len(recording.T_base)
