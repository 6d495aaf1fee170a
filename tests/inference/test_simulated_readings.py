"""The door through which fits, diagnoses and plans ask for simulated readings."""

from pathlib import Path

import numpy as np

import gtr_jax as gtr
from calibrate.diagnosis.likelihood.likelihood import change_by
from calibrate.fitting.fit import part_of
from calibrate.inference.coordinates import coordinates, places
from calibrate.inference.number import number_at
from calibrate.inference.predictor import Predictor
from calibrate.inference.simulated_readings import SimulatedReadings, simulate_all
from calibrate.inference.simulated_rig import SimulatedRig
from gtr_jax.robot.parameters import parameters_of


class Line:
    """A recording whose readings are a straight line; it breaks down for slopes beyond `most`."""

    channels = ("T_tip",)

    def __init__(self, most):
        self.most = most

    def many(self, many):
        k = np.arange(4.0)
        return [
            None if slope > self.most else SimulatedReadings(slope * k[None], 0, k > 0, k) for slope in many
        ]


def test_all_recordings_are_simulated_at_each_point_or_none_is():
    found = simulate_all([Line(5.0), Line(2.0)], [1.0, 3.0, 2.0])
    assert [each is None for each in found] == [False, True, False]
    for each, slope in ((found[0], 1.0), (found[2], 2.0)):
        assert each is not None and [one.values[0, -1] for one in each] == [3 * slope, 3 * slope]
    assert simulate_all([], [1.0, 2.0]) == [(), ()]


def test_fits_and_diagnoses_are_shown_the_same_and_weigh_it_alike(make_robot):
    robot = make_robot()
    T = np.concatenate([np.linspace(0.0, 20.0, 9), np.linspace(20.0, 2.0, 8)[1:]])
    rec = gtr.Recording(path=Path("r.csv"), sha256="", time=np.arange(len(T)) + 0.0, T_base=T, T_tip=0.8 * T)
    part, _ = part_of("r", robot, None, rec, ("T_tip",), noise_N=0.02, noise_base_N=0.05)
    mu = number_at(parameters_of(robot)["mu"], 0.2)
    at = coordinates(places(robot, ["mu"]), [mu])
    predict = Predictor(robot, at, part.drive, part.time, channels=part.channels)
    rig = SimulatedRig(part, robot)
    one, other = predict(at.at([0.3])), rig({"mu": 0.3})
    assert one is not None and other is not None and one.converged and other.converged
    np.testing.assert_allclose(one.values, other.values[rig.where], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(one.slips, other.slips)
    residual, sd = 0.1 * np.sin(np.arange(len(T)))[None], np.asarray([0.02])
    slope = change_by(rig, {"mu": 0.3}, 0)
    shows = ((one.slips, one.slopes), (other.slips, [slope]))
    rows = [part.weighing(*shown, sd)(residual) for shown in shows]
    np.testing.assert_allclose(*rows, rtol=1e-3, atol=1e-3)
    # Of a tension that is exact there is no noise to pass on.
    exactly = part.weighing(one.slips, [None], sd)(residual)
    np.testing.assert_allclose(exactly, [*(residual[0] / 0.02), *np.zeros(len(T))], atol=1e-12)
