"""What stands behind a ±: all that the robot file calls uncertain is in it, and it says what it is of."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from benchmarks import intervals
from calibrate.diagnosis.likelihood.likelihood import DISCRETE, noise_in
from calibrate.inference.estimate import shares_of_variance
from calibrate.inference.setup import Observation
from calibrate.inference.simulated_rig import SimulatedRig
from calibrate.inference.weighing import Weighing
from gtr_jax.config.config import parse_config
from gtr_jax.recordings.base_tension import exact
from gtr_jax.recordings.signals.noise import Noise
from tests.conftest import SINE

RIG = Path(__file__).parents[2] / "examples/rig"
HISTORY = np.concatenate([np.linspace(0, 40, 31), np.linspace(40, 4, 31)[1:], np.linspace(4, 30, 16)[1:]])
TRUTH = {"mu": 0.27, "E": 1.0e6, "r1": -0.0103, "r2": 0.0098}
UNCERTAIN = {"youngs_modulus": 0.1, "routing.r1": "0.5 mm", "routing.r2": "0.5 mm"}


@pytest.fixture(scope="module")
def recording():
    """Tensions of a robot whose modulus and radii are off what its file says."""
    return made(np.random.default_rng(3))


def made(rng):
    config = parse_config(file_of({}))
    run = gtr.simulate(gtr.build_robot(config).with_values(**TRUTH), HISTORY)
    T_tip = np.asarray(run.T_tip) + rng.normal(0, 0.03, len(HISTORY))
    return gtr.Recording(HISTORY, Path("rec.csv"), "", T_tip=T_tip)


def file_of(uncertainty):
    backbone = {"length": 0.25, "outer_radius": [0.02, 0.013], "youngs_modulus": 1.06e6, "density": 1070.0}
    tendon, routing = {"friction_coefficient": 0.3}, SINE
    data = {"schema": 1, "name": "test", "backbone": backbone, "routing": routing, "tendon": tendon}
    return data | {"uncertainty": dict(uncertainty)}


@pytest.fixture(scope="module")
def fits(recording):
    """The same recording fitted with mu free, and with all that is uncertain free."""
    config = parse_config(file_of(UNCERTAIN))
    asked = ("mu",), ("mu", "E", "r1", "r2")
    return [calibrate.fit(config, recording, free=free, noise_base_N=0.0) for free in asked]


def test_what_is_uncertain_is_in_the_interval_whether_it_is_asked_for_or_not(fits):
    one, all_ = fits
    assert one["mu"].value == pytest.approx(all_["mu"].value, rel=1e-3)
    assert one["mu"].sd == pytest.approx(all_["mu"].sd, rel=0.02)
    assert [e.name for e in one.estimates] == ["mu"] and {e.name for e in one.carried} == {"E", "r1", "r2"}
    assert all_.carried == [] and one.correlation.shape == (1, 1)
    for name, truth in TRUTH.items():
        low, high = one[name].lower95, one[name].upper95
        assert low is not None and high is not None and low < truth < high, name


def test_without_uncertainty_the_interval_is_the_noise_alone_and_far_from_the_truth(recording, fits):
    fit = calibrate.fit(parse_config(file_of({})), recording, free=("mu",), noise_base_N=0.0)
    assert fit.carried == [] and set(fit["mu"].made_of) == {"noise of the tip cell"}
    assert fit["mu"].sd < 0.2 * fits[0]["mu"].sd


def test_an_interval_says_what_it_is_made_of(fits):
    for fit in fits:
        for e in (*fit.estimates, *fit.carried):
            assert sum(e.made_of.values()) == pytest.approx(1.0, abs=0.03), e.name
    mu = fits[0]["mu"].made_of
    assert mu["r1"] + mu["r2"] > 0.5
    assert "most of the ± is the uncertainty of" in fits[0].verdict
    assert fits[0].to_json()["parameters"]["mu"]["made_of"] == dict(mu)


def test_the_fitted_file_keeps_what_is_left_uncertain(fits):
    fit = fits[0]
    config = fit.config
    for name, key in (("E", "backbone.youngs_modulus"), ("r1", "routing.r1"), ("r2", "routing.r2")):
        assert config.numbers()[key] == pytest.approx(fit[name].value)
        assert config.deviation(key) == pytest.approx(fit[name].sd, rel=0.01)


def test_each_robots_file_keeps_what_is_left_uncertain_of_its_own():
    said = UNCERTAIN, {"youngs_modulus": 0.01, "routing.r1": "0.1 mm", "routing.r2": "0.1 mm"}
    configs = [parse_config(file_of(u) | {"name": n}) for n, u in zip("ab", said, strict=True)]
    recordings = [made(np.random.default_rng(seed)) for seed in (5, 6)]
    fit = calibrate.fit(configs, recordings, free=("mu",), noise_base_N=0.0)
    for name, fitted in zip("ab", fit.recordings, strict=True):
        assert fitted.config is not None
        for number, key in (("E", "backbone.youngs_modulus"), ("r1", "routing.r1")):
            left = fitted.config.deviation(key)
            assert left == pytest.approx(sd_of(fit[f"{number}@{name}"]), rel=0.01)


def test_a_stretch_that_is_free_is_not_taken_out_beside():
    rig = gtr.build_robot(parse_config(file_of({})))
    channels, recorded = ("T_tip", "displacement"), np.ones((2, len(HISTORY)))
    part = Observation("r", "r", rig, None, exact(HISTORY), channels, recorded, None, None, None)
    assert part.stretch(0.6 * HISTORY).max() > 0
    assert not dataclasses.replace(part, stretches=True).stretch(0.6 * HISTORY).any()
    known = dataclasses.replace(part, robot=rig.with_values(**{"tendon-stretch.compliance": 1e-5}))
    assert not known.stretch(0.6 * HISTORY).any()


def test_phases_alone_are_no_surer_than_the_whole(fits):
    one = fits[0]
    for phase in ("pulling", "releasing"):
        assert one.mu_by_phase[phase].sd > 0.9 * one["mu"].sd
    # What they have in common is not a disagreement.
    assert not any("alone" in text for text in one.warnings)


def test_deviations_of_a_file_are_set_and_taken_out():
    config = parse_config(file_of(UNCERTAIN))
    keys = (key for key in ("backbone.youngs_modulus", "routing.r1"))  # any iterable
    assert set(config.without_deviations(keys).uncertainty) == {"routing.r2"}
    told = config.with_deviations({"routing.r1": 2e-4, "tendon.preload": 0.5})
    assert told.deviation("routing.r1") == pytest.approx(2e-4, rel=0.005)
    assert told.deviation("tendon.preload") == pytest.approx(0.5)
    assert told.deviation("routing.r2") == pytest.approx(5e-4)


def test_shares_of_variance_by_hand():
    # One reading of a + b with noise 2, and b known beforehand to 3: a's variance is 4 + 9.
    rows = {"noise": np.array([[0.5, 0.5]])}
    names, shares = shares_of_variance(rows, {"b": np.array([0.0, 1 / 3])})
    assert names == ["noise", "b"]
    np.testing.assert_allclose(shares[:, 0], [4 / 13, 9 / 13])
    np.testing.assert_allclose(shares[:, 1], [0.0, 1.0], atol=1e-12)


def test_an_unknown_stretch_of_the_tendon_is_taken_out_as_its_prior_lets_it():
    rng = np.random.default_rng(1)
    K, sd = 30, 0.02
    stretch = np.linspace(0.0, 0.1, K) ** 2 * 20
    plain = Weighing.plain(exact(np.linspace(0, 10, K)), ("T_tip", "displacement"), np.array([0.05, sd]))
    weigh = dataclasses.replace(plain, stretch=stretch)
    rows = rng.normal(size=(2, K))
    channels, _ = weigh.split(rows)
    # The least over a constant and a multiple of the stretch, which counts as a reading of zero.
    columns = np.concatenate([np.stack([np.ones(K), stretch], axis=1) / sd, [[0.0, 1.0]]])
    wanted = np.append(rows[1] / sd, 0.0)
    left = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
    assert np.sum(channels[1] ** 2) == pytest.approx(np.sum(left**2))
    np.testing.assert_allclose(weigh.left(rows)[1] / sd, left[:-1], atol=1e-9)
    np.testing.assert_allclose(weigh.left(rows)[0], rows[0])
    np.testing.assert_allclose(channels[0], rows[0] / 0.05)


def test_a_tendon_that_stretches_a_little_does_not_move_the_channel():
    history = HISTORY
    config = parse_config(file_of(UNCERTAIN | {"youngs_modulus": 0.02}))
    stretching = gtr.build_robot(config).with_values(**{**TRUTH, "tendon-stretch.compliance": 1e-5})
    run = gtr.simulate(stretching, history)
    rng = np.random.default_rng(0)
    recording = gtr.Recording(
        history,
        Path("rec.csv"),
        "",
        T_tip=np.asarray(run.T_tip) + rng.normal(0, 0.03, len(history)),
        tip_angle=np.asarray(run.tip_pose[:, 2]) + rng.normal(0, 2e-3, len(history)),
        displacement=np.asarray(run.displacement) + rng.normal(0, 2e-5, len(history)),
    )
    fit = calibrate.fit(config, recording, free=("mu", "E", "r1", "r2"), noise_base_N=0.0)
    for name in ("mu", "r1", "r2"):
        assert abs(fit[name].value - TRUTH[name]) < 2.5 * sd_of(fit[name]), name
    # What is stretched is 0.1 mm, and the radii would make it up by a hundredth.
    assert sd_of(fit["r2"]) < 0.01 * abs(TRUTH["r2"])


def test_noise_is_told_apart_from_what_the_mesh_leaves():
    T = np.linspace(0, 40, 200)
    part = SimpleNamespace(
        smallest=np.array([1e-9]),
        recorded=np.sqrt(T)[None],
        noise_N=None,
        counted=np.ones(200, bool),
        tips=1,
        pulled=[T],
    )
    (noise,) = noise_in(cast(SimulatedRig, SimpleNamespace(part=part)), np.zeros((1, 200)))
    assert noise.mesh == pytest.approx(DISCRETE * 40)
    assert noise.sd == pytest.approx(np.hypot(noise.cell, noise.mesh)) and noise.cell < noise.sd
    assert Noise(0.5, 0.0, 0.3).cell == pytest.approx(0.4)


def test_the_table_of_intervals_counts():
    found = {"mu": (0.3, 0.01, 0.28, 0.32), "r1": (1.0, 0.1, 0.8, 1.2), "adhesion.drag": (2.0, 0.5, 1.0, 3.0)}
    answer = {"truth": {"mu": 0.29, "r1": 1.3, "adhesion.drag": 2.5, "E": 1.0}, "found": found}
    kinds = {kind: (n, held) for kind, n, held, _ in intervals.rows([answer, answer])}
    assert kinds == {"mu": (2, 2), "dimensions": (2, 0), "size of the effect named": (2, 2)}


def sd_of(estimate):
    assert estimate.sd is not None
    return estimate.sd


@pytest.mark.slow
def test_diagnosis_and_fit_print_the_same_errors():
    config = gtr.load_config(RIG / "robot.toml")
    recording = gtr.read_recording(RIG / "monday.csv")
    found = calibrate.diagnose(config, recording)
    fit = calibrate.fit(config, recording, free="mu,E,r1,r2")
    truth = {"mu": 0.27, "E": 1.38e6, "r1": -9.3e-3, "r2": 8.8e-3}
    for change in found.parameters:
        own, sd = fit[change.name], sd_of(fit[change.name])
        assert change.sd == pytest.approx(sd, rel=0.15)
        assert change.after == pytest.approx(own.value, abs=0.2 * sd)
        assert (change.lower95 or np.inf) < truth[change.name] < (change.upper95 or -np.inf)
        assert sum(change.made_of.values()) == pytest.approx(1.0)
    for _, value, sd, own in found.strata:
        assert sd > 0.9 * sd_of(fit["mu"]) and own < sd and abs(value - truth["mu"]) < 3 * sd
    # The robot it writes knows no more than that.
    assert found.config is not None
    assert found.config.deviation("routing.r1") == pytest.approx(fit["r1"].sd, rel=0.15)
    assert json.dumps(found.to_json())


@pytest.mark.slow
def test_intervals_of_noisy_recordings_hold_the_truth():
    # Twenty robots whose modulus and radii are drawn from what the file says.
    held, errors = 0, []
    for seed in range(20):
        rng = np.random.default_rng([7, seed])
        own = {"E": 1.06e6 * np.exp(0.1 * rng.normal()), "r1": SINE["r1"] + 5e-4 * rng.normal()}
        own["r2"] = SINE["r2"] + 5e-4 * rng.normal()
        config = parse_config(file_of(UNCERTAIN))
        run = gtr.simulate(gtr.build_robot(config).with_values(mu=0.27, **own), HISTORY)
        tip = np.asarray(run.T_tip) + rng.normal(0, 0.03, len(HISTORY))
        shown = gtr.Recording(HISTORY, Path("rec.csv"), "", T_tip=tip)
        mu = calibrate.fit(config, shown, free=("mu",), noise_base_N=0.0)["mu"]
        held += (mu.lower95 or 1.0) < 0.27 < (mu.upper95 or 0.0)
        errors.append((mu.value - 0.27) / sd_of(mu))
    assert held >= 17 and 0.6 < np.std(errors) < 1.5


def test_a_case_of_the_benchmark_knows_its_truth():
    key = {"mu": 0.2, "E": 1e6, "dimensions": {"r1": 0.01}, "numbers": {"entry.base": 0.1}}
    assert intervals._truth(key, "entry") == {"mu": 0.2, "E": 1e6, "r1": 0.01, "local-friction.base": 0.1}
