"""`calibrate.fit`: the truth found where there is one, honest errors, no answer where there is none."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from calibrate.fitting.start import thin
from calibrate.inference.coordinates import coordinates, places
from calibrate.inference.number import number_at
from calibrate.inference.predictor import Predictor
from gtr_jax.recordings.signals import noise
from gtr_jax.robot.parameters import parameter
from tests.conftest import PARALLEL, SINE

DATA = Path(__file__).parents[1] / "data"
GIRAFFE = Path(__file__).parents[3] / "shared/data/giraffe"
FRICTION = "tendon.friction_coefficient"
LOOP = np.concatenate([np.linspace(0, 20, 20), np.linspace(20, 2, 20)])
UP, DOWN = np.linspace(0, 20, 20), np.linspace(20, 0, 60)


def recording(T_base, T_tip, **columns):
    T_base, T_tip = np.asarray(T_base, float), np.asarray(T_tip, float)
    return gtr.Recording(T_base=T_base, T_tip=T_tip, path=Path("rec.csv"), sha256="", **columns)


def thinned(rec):
    kept = thin(rec.T_base)
    return recording(rec.T_base[kept], rec.T_tip[kept])


def simulated(robot, T_base, sd=0.02, seed=0):
    noise = np.random.default_rng(seed).normal(0.0, sd, len(T_base))
    return recording(T_base, np.asarray(gtr.simulate(robot, T_base).T_tip) + noise)


def deviation(fit, name, truth):
    """How many standard deviations an estimate lies from the truth."""
    sd = fit[name].sd
    assert sd is not None, fit.verdict
    return (fit[name].value - truth) / sd


def check_sound(case, factor):
    folder = DATA / "sound" / case
    config, truth = gtr.load_config(folder / "robot.toml"), json.loads((folder / "truth.json").read_text())
    config = config.with_values({FRICTION: factor * config.tendon.friction_coefficient})
    fit = calibrate.fit(config, gtr.read_recording(folder / "recording.csv"))
    assert fit.converged, fit.verdict
    assert abs(deviation(fit, "mu", truth["mu"])) < 3
    assert abs(deviation(fit, "E", truth["E"])) < 3
    assert fit["mu"].value == pytest.approx(truth["mu"], rel=0.02)
    assert fit.noise_N == pytest.approx(truth["noise_tip"], rel=0.3)
    assert fit.chi2_per_n is not None and fit.chi2_per_n < (1.15 if len(fit.residual) > 100 else 2.0)
    assert "to its noise" in fit.verdict
    assert not any("alone" in text for text in fit.warnings)
    return fit


@pytest.mark.parametrize("factor", [1 / 3, 3])
def test_sound_staircase(factor):
    fit = check_sound("case-011", factor)
    assert fit["mu"].initial == pytest.approx(0.3 * factor)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["case-003", "case-014", "case-021"])
@pytest.mark.parametrize("factor", [1 / 3, 3])
def test_sound_recordings(case, factor):
    check_sound(case, factor)


def check_reference(folder, select):
    config = gtr.load_config(folder / "robot.toml").with_values({FRICTION: 0.9})
    fit = calibrate.fit(config, select(gtr.read_recording(folder / "recording.csv")))
    assert fit.converged, fit.verdict
    assert fit["mu"].value == pytest.approx(0.3, rel=0.005)


def test_noise_free_reference():
    check_reference(DATA / "reference/coulomb", thinned)


@pytest.mark.slow
@pytest.mark.parametrize("folder", sorted((DATA / "reference").glob("coulomb*")), ids=lambda f: f.name)
def test_noise_free_references(folder):
    check_reference(folder, lambda rec: rec)


def test_result_is_complete_and_plain(make_config, tmp_path):
    config = make_config(PARALLEL, uncertainty={"youngs_modulus": 0.1})
    rec = simulated(gtr.build_robot(config).with_values(mu=0.25), LOOP)
    lines = []
    fit = calibrate.fit(config, rec, progress=lines.append)
    plain = json.loads(json.dumps(fit.to_json(), allow_nan=False))
    assert plain["parameters"]["mu"]["sd"] == fit["mu"].sd
    assert plain["fit"]["rms_N"] == pytest.approx(np.sqrt(np.mean(fit.residual**2)))
    assert fit.residual == pytest.approx(
        np.asarray(gtr.simulate(fit.robot, LOOP).T_tip) - rec.T_tip, abs=1e-9
    )
    assert fit.config is not None
    gtr.dump_config(fit.config, tmp_path / "fitted.toml")
    again = gtr.load_config(tmp_path / "fitted.toml")
    assert again.tendon.friction_coefficient == pytest.approx(fit["mu"].value, rel=1e-9)
    assert sum(row["count"] for row in fit.by_phase.values()) == len(rec)
    low, high = fit["mu"].lower95, fit["mu"].upper95
    assert low is not None and high is not None and low < 0.25 < high
    assert fit.correlation.shape == (2, 2)
    assert lines


def test_drift_from_a_prior_is_said(make_config):
    """The recording says E is half of what the robot file is sure of."""
    config = make_config(SINE, uncertainty={"youngs_modulus": 0.05})
    rec = simulated(gtr.build_robot(config).with_values(E=0.53e6), LOOP, sd=0.005)
    fit = calibrate.fit(config, rec, free=("E",))
    assert "standard deviations of its prior" in fit["E"].note
    assert any(text.startswith("E: lies") for text in fit.warnings)


def test_without_prior_only_the_ratio_is_known(make_config):
    """A parallel tendon loses tension by mu/E alone: without a prior there is no answer."""
    rec = simulated(gtr.build_robot(make_config(PARALLEL)), LOOP)
    unknown = calibrate.fit(make_config(PARALLEL), rec)
    assert not unknown.converged
    assert "mu and E only in combination" in unknown.verdict
    assert "angle of the tip" in unknown.verdict and "would tell them apart" in unknown.verdict
    assert all(e.sd is None and e.lower95 is None and e.value == e.initial for e in unknown.estimates)
    known = calibrate.fit(make_config(PARALLEL, uncertainty={"youngs_modulus": 0.1}), rec)
    assert known.converged
    assert known["mu"].sd == pytest.approx(0.1 * known["mu"].value, rel=0.05)
    assert any("trade off" in text for text in known.warnings)
    told = "the recording tells nothing about E: value and interval are those that the robot file states"
    assert known["E"].note == told and f"T{told[1:]}." in known.warnings
    assert known.correlation[0, 1] > 0.98


@pytest.mark.parametrize(
    ("T_base", "T_tip"),
    [(np.zeros(40), np.zeros(40)), (np.full(40, -0.02), np.zeros(40)), (LOOP * 0, 0.01 * np.sin(LOOP))],
)
def test_nothing_to_fit(make_config, T_base, T_tip):
    fit = calibrate.fit(make_config(PARALLEL), recording(T_base, T_tip), free=("mu",))
    assert not fit.converged
    assert "says nothing about mu" in fit.verdict
    assert fit["mu"].sd is None
    json.dumps(fit.to_json(), allow_nan=False)


def test_noise_alone_is_not_fitted(make_config):
    rng = np.random.default_rng(1)
    rec = recording(rng.normal(0, 0.02, 40), rng.normal(0, 0.05, 40))
    fit = calibrate.fit(make_config(PARALLEL), rec, free=("mu",))
    assert not fit.converged
    assert fit["mu"].sd is None
    assert "does not determine mu" in fit.verdict


@pytest.mark.parametrize("free", [("mu",), ("mu", "E")])
def test_no_friction_is_an_answer(make_config, free):
    config = make_config(PARALLEL, uncertainty={"youngs_modulus": 0.1})
    rec = simulated(gtr.build_robot(config).with_values(mu=0.0), LOOP)
    fit = calibrate.fit(config, rec, free=free)
    assert fit.converged
    assert fit["mu"].sd is None
    assert "no friction is seen" in fit.verdict


def test_start_without_friction(make_config):
    robot = gtr.build_robot(make_config(PARALLEL))
    fit = calibrate.fit(robot.with_values(mu=0.0), simulated(robot, LOOP), free=("mu",))
    assert fit.config is None
    assert abs(deviation(fit, "mu", 0.3)) < 3


def test_errors_cover_the_truth(make_config):
    robot = gtr.build_robot(make_config(PARALLEL))
    fits = [
        calibrate.fit(robot, simulated(robot, LOOP, seed=s), free=("mu",), noise_N=0.02) for s in range(20)
    ]
    z = np.asarray([deviation(f, "mu", 0.3) for f in fits])
    assert abs(np.mean(z)) < 0.6
    assert 0.5 < np.std(z) < 1.3
    assert 0.5 < np.mean([f.chi2_per_n or 0.0 for f in fits]) < 1.2


def test_not_converged_is_said(make_config):
    config = make_config(PARALLEL).with_values({FRICTION: 0.15})
    robot = gtr.build_robot(make_config(PARALLEL))
    fit = calibrate.fit(config, simulated(robot, LOOP), free=("mu",), max_steps=1)
    assert not fit.converged
    assert "did not finish" in fit.verdict
    assert fit["mu"].sd is None


def sheath(make_config, mu=0.06):
    backbone = {"rigid": True, "youngs_modulus": 0.0, "natural_curvature": 10.0, "density": 0.0}
    return make_config({"kind": "parallel", "offset": 0.0}, backbone, {"friction_coefficient": mu})


def test_rigid_sheath_drops_stiffness(make_config):
    config = sheath(make_config)
    rec = simulated(gtr.build_robot(config), np.concatenate([UP, DOWN]))
    fit = calibrate.fit(config, rec)
    assert [e.name for e in fit.estimates] == ["mu"]
    assert any("rigid" in text for text in fit.warnings)
    with pytest.raises(gtr.InputError, match="rigid"):
        calibrate.fit(config, rec, free=("mu", "E"))


def test_pulling_and_releasing_that_disagree(make_config):
    """A sheath with mu 0.3 on pulling and 0.2 on releasing: one mu does not describe it, and that is said."""
    pulled, released = UP * np.exp(-0.3 * 2.5), np.minimum(20 * np.exp(-0.3 * 2.5), DOWN * np.exp(0.2 * 2.5))
    T_tip = np.concatenate([pulled, released]) + np.random.default_rng(2).normal(0, 0.01, 80)
    rec = recording(np.concatenate([UP, DOWN]), T_tip)
    fit = calibrate.fit(sheath(make_config), rec, noise_N=0.01)
    assert fit.mu_by_phase["pulling"].value == pytest.approx(0.3, rel=0.02)
    assert fit.mu_by_phase["releasing"].value == pytest.approx(0.2, rel=0.02)
    assert "pulling alone would give mu = 0.3" in fit.verdict
    assert "does not describe the recording" in fit.verdict
    assert f"{fit.rms_N:.3g} N rms" in fit.verdict


@pytest.mark.skipif(not GIRAFFE.exists(), reason="the recording is not part of the project")
def test_real_recording():
    columns = "T_base=data_0[gf],T_tip=data_2[gf],time=Time[s]"
    rec = gtr.read_recording(GIRAFFE / "loadcell_measurements.csv", columns)
    fit = calibrate.fit(gtr.load_config(GIRAFFE / "robot.toml"), rec, free=("mu",))
    assert fit.converged
    assert 0.04 < fit["mu"].value < 0.08
    assert "does not describe the recording" in fit.verdict
    assert "releasing alone" in fit.verdict
    assert len(fit.T_tip) == 2254


def test_derivatives_of_the_prediction(make_config):
    robot = gtr.build_robot(make_config(PARALLEL))
    chosen = [parameter(robot, "mu"), parameter(robot, "offset")]
    numbers = [number_at(p, float(robot.value(p.name))) for p in chosen]
    at = coordinates(places(robot, [p.name for p in chosen]), numbers)
    predict = Predictor(robot, at, LOOP)
    u, h = np.asarray([0.02, -0.01]), 1e-5
    exact = predict(u)
    assert exact is not None
    for i, step in enumerate(h * np.eye(2)):
        up, down = predict(u + step), predict(u - step)
        assert up is not None and down is not None
        assert exact.jacobian[..., i] == pytest.approx((up.values - down.values) / (2 * h), abs=1e-6)
    assert at.at(np.asarray(at.values(u))) == pytest.approx(u)


def test_what_is_not_asked_for_and_longer_programs_change_nothing(make_config):
    robot = gtr.build_robot(make_config(PARALLEL))
    at = coordinates(places(robot, ["mu"]), [number_at(parameter(robot, "mu"), float(robot.value("mu")))])
    every = Predictor(robot, at, LOOP)(np.zeros(1))
    tip = Predictor(robot, at, LOOP, channels=("T_tip",))(np.zeros(1))
    longer = Predictor(robot, at, LOOP, channels=("T_tip", "tip_angle"), length=2 * len(LOOP))(np.zeros(1))
    assert every is not None and tip is not None and longer is not None
    for found, rows in ((tip, [0]), (longer, [0, 3])):
        np.testing.assert_allclose(found.values, every.values[rows], rtol=1e-12)
        np.testing.assert_allclose(found.jacobian, every.jacobian[rows], rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(found.phases, every.phases)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"free": ()}, "no parameter is free"),
        ({"free": ("mu", FRICTION)}, "twice"),
        ({"free": ("mue",)}, "did you mean 'mu'"),
        ({"free": ("density",)}, "start value is 0"),
        ({"noise_N": 0.0}, "noise_N"),
    ],
)
def test_refused(make_config, options, words):
    robot = gtr.build_robot(make_config(PARALLEL, {"density": 0.0}))
    with pytest.raises(gtr.InputError, match=words):
        calibrate.fit(robot, recording(LOOP, LOOP), **options)


def test_recordings_refused(make_config):
    config, rec = make_config(PARALLEL), recording(LOOP, LOOP)
    with pytest.raises(gtr.InputError, match="no tip tension, and nothing else to compare; add T_tip_N"):
        calibrate.fit(config, dataclasses.replace(rec, T_tip=None))
    with pytest.raises(gtr.InputError, match="too few"):
        calibrate.fit(config, recording([1, 2, 3], [1, 2, 3]))
    with pytest.raises(gtr.InputError, match="finite"):
        calibrate.fit(config, recording([1, 2, 3, 4], [1, np.nan, 3, 4]))


def test_noise_estimates():
    rng = np.random.default_rng(3)
    t = np.linspace(0, 1, 400)
    x = 10 * np.abs(t - 0.5) + rng.normal(0, 0.05, 400)
    assert noise.from_differences(x) == pytest.approx(0.05, rel=0.15)
    assert noise.from_differences(np.round(t, 1)) == pytest.approx(0.1 / np.sqrt(12), rel=1e-6)
    locked = (t > 0.2) & (t < 0.8)
    held = noise.from_locked(np.where(locked, 3.0 + 0.5 * t, 5 * t) + rng.normal(0, 0.05, 400), locked)
    assert held is not None
    assert held[0] == pytest.approx(0.05, rel=0.15)
    trial = np.repeat([1, 2, 3], 40)
    base = np.tile(LOOP, 3)
    repeats = noise.from_repeats(base, 0.5 * base + rng.normal(0, 0.05, 120), trial)
    assert repeats is not None
    assert repeats[0] == pytest.approx(0.05, rel=0.25)
    assert noise.from_repeats(base + trial, base, trial) is None


def test_correlation_time():
    rng = np.random.default_rng(4)
    white, x = rng.normal(size=4000), np.zeros(4000)
    for k in range(1, 4000):
        x[k] = 0.8 * x[k - 1] + white[k]
    assert noise.correlation_time(white) == pytest.approx(1.0, abs=0.2)
    assert noise.correlation_time(x) == pytest.approx(9.0, rel=0.3)
    assert noise.correlation_time(np.tile([1.0, -1.0], 50)) == 1.0
    assert noise.correlation_time(np.ones(10)) == 1.0


def test_thinning_keeps_the_extremes():
    T_base = np.abs(np.sin(np.linspace(0, 20, 1000))) * 10
    kept = thin(T_base, blocks=30)
    assert len(kept) <= 62
    assert {0, 999} <= set(kept)
    assert T_base[kept].max() == T_base.max()
    assert np.all(np.diff(kept) > 0)
    assert np.array_equal(thin(T_base[:50]), np.arange(50))
