"""The files of real robots that ship predict what they were not fitted to."""

import numpy as np
import pytest

import gtr_jax as gtr
from examples.robots.tentacle import FOLDER, distances, holds, rms
from examples.robots.wrists import COUNT, HERE, WRISTS


@pytest.mark.slow
def test_the_tentacle_predicts_the_holds_that_it_was_not_fitted_to():
    config = gtr.load_config(FOLDER / "fitted.toml")
    found = distances(gtr.build_robot(config), "test")
    plain = distances(gtr.load_robot(FOLDER / "tentacle.toml"), "test")
    assert found.shape == (7, 4)
    assert rms(found) < 10.0 < rms(plain)


def test_recordings_of_the_tentacle_are_parted_and_have_their_notice():
    (trained, pulls, _), (judged, both, _) = holds("train"), holds("test")
    assert (len(trained), len(judged)) == (8, 7)
    assert not set(trained) & set(judged)
    assert np.all(np.sum(pulls > 0, axis=1) == 1)
    assert np.sum(np.all(both > 0, axis=1)) == 4
    assert "MIT License" in (FOLDER / "NOTICE").read_text(encoding="utf-8")


@pytest.mark.parametrize("wrist", WRISTS)
def test_wrists_close_one_notch_after_the_other(wrist):
    config = gtr.load_config(HERE / "wrists" / f"{wrist}.toml")
    assert len(config.backbone.notches[0].ends) == COUNT
    run = gtr.simulate(gtr.build_robot(config), np.linspace(0.0, 6.0, 13))
    assert np.all(run.converged)
    found = np.asarray(gtr.marker_angles(gtr.build_robot(config), run))
    assert np.all(np.diff(found[4]) < 0)
    closed = config.backbone.notches[0].height / (0.81e-3 + 0.6865e-3)
    assert found[-1] == pytest.approx(closed, rel=0.05)
