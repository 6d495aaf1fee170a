"""Several recordings and robots in one fit, other channels than tension, outliers, cells, and what is told of
them.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import calibrate
import gtr_jax as gtr
from benchmarks.coverage import RUNS
from calibrate.fitting.identifiability import axes
from calibrate.inference.estimate import uncertainty
from calibrate.inference.free import free_of
from calibrate.inference.posterior import potential_of
from gtr_jax.config.config import parse_config
from gtr_jax.recordings import base_tension as readings

PULLED = np.concatenate([np.linspace(0, 40, 41), np.linspace(40, 5, 36)[1:], np.linspace(5, 25, 11)[1:]])
POSE = ("tip_x", "tip_y", "tip_angle", "displacement")
NOISE = {"T_tip": 0.05, "tip_x": 2e-4, "tip_y": 2e-4, "tip_angle": np.radians(0.3), "displacement": 5e-5}


def recorded(config, seed, *, pose=False, name="rec", history=PULLED, **changes):
    """What the robot, with some values changed, would record, with noise on all but the base tension."""
    robot = gtr.build_robot(config).with_values(**changes)
    run = gtr.simulate(robot, gtr.true_base(robot, np.asarray(history)))
    rng = np.random.default_rng(seed)
    clean = {"T_tip": gtr.reading(robot, run).T_tip}
    if pose:
        clean |= dict(zip(POSE, [*run.tip_pose.T, run.displacement], strict=True))
    noisy = {key: np.asarray(v) + rng.normal(0, NOISE[key], len(history)) for key, v in clean.items()}
    shown = {key: noisy.get(key) for key in ("T_tip", *POSE)}
    return gtr.Recording(
        history,
        Path(f"{name}.csv"),
        "",
        T_tip=shown["T_tip"],
        tip_x=shown["tip_x"],
        tip_y=shown["tip_y"],
        tip_angle=shown["tip_angle"],
        displacement=shown["displacement"],
    )


@pytest.fixture(scope="module")
def tdcm():
    return gtr.load_config(RUNS / "coulomb/robot.toml")


@pytest.fixture(scope="module")
def pair(tdcm):
    return [recorded(tdcm, seed, name=name) for seed, name in ((1, "first"), (2, "second"))]


def fitted(config, recording, **options):
    fit = calibrate.fit(config, recording, noise_base_N=0.0, **options)
    assert fit.converged
    return fit


def error(fit, name):
    sd = fit[name].sd
    assert sd is not None
    return sd


def holds(fit, name, truth, most=np.inf):
    assert error(fit, name) < most
    assert fit[name].value == pytest.approx(truth, abs=4 * error(fit, name))


def test_two_recordings_know_more_than_one(tdcm, pair):
    both, one = fitted(tdcm, pair), fitted(tdcm, pair[0])
    holds(both, "mu", 0.3)
    assert error(both, "mu") < 0.85 * error(one, "mu")
    assert [r.name for r in both.recordings] == ["first", "second"]
    assert len(both.residual) == 2 * len(PULLED) and both.chi2_per_n == pytest.approx(1.0, abs=0.3)
    assert "both recordings" in both.verdict and not both.warnings
    assert set(both.by_recording["mu"]) == {"first", "second"}
    for r in both.recordings:
        np.testing.assert_allclose(r.T_tip, gtr.simulate(r.robot, PULLED).T_tip, atol=1e-9)
    with pytest.raises(ValueError, match=r"take one of fit\.recordings"):
        _ = both.config


def test_a_parameter_per_recording(tdcm, pair):
    slippery = recorded(tdcm, 3, name="oiled", mu=0.2)
    fit = fitted(tdcm, [*pair, slippery], per_recording=("mu",), free=("mu", "E"))
    assert [e.name for e in fit.estimates] == ["mu@first", "mu@second", "mu@oiled", "E"]
    for name, truth in (("mu@first", 0.3), ("mu@oiled", 0.2)):
        holds(fit, name, truth)
    configs = [r.config for r in fit.recordings]
    assert all(c is not None for c in configs)
    found = [c.tendon.friction_coefficient for c in configs if c is not None]
    assert found == [fit[f"mu@{r.name}"].value for r in fit.recordings]
    assert len({c.backbone.youngs_modulus for c in configs if c is not None}) == 1


def test_recordings_that_disagree_are_named(tdcm, pair):
    slippery = recorded(tdcm, 3, name="oiled", mu=0.25)
    fit = fitted(tdcm, [pair[0], slippery])
    assert "the recordings disagree: mu: " in fit.verdict and "from oiled" in fit.verdict
    assert any("--per-recording mu" in text for text in fit.warnings)
    each = fit.by_recording["mu"]
    assert each["oiled"].value < each["first"].value


def test_two_robots_of_one_material(tdcm, pair):
    wave = gtr.load_config(RUNS / "coulomb-cone-wave/robot.toml")
    with pytest.raises(
        gtr.InputError, match=r"E is shared, but is 1.5e\+06 Pa in .*coulomb.robot.toml and 600000 Pa in"
    ):
        calibrate.fit([tdcm, wave], [pair[0], pair[1]])
    other = recorded(wave, 4, name="wave", history=np.concatenate([PULLED, [1.0]]))
    fit = fitted([tdcm, wave], [pair[0], other], per_robot=("E",), free=("mu", "E"))
    assert [e.name for e in fit.estimates] == ["mu", "E@tdcm-1", "E@cone-wave"]
    holds(fit, "mu", 0.3)
    holds(fit, "E@cone-wave", 6e5)


def test_pose_and_displacement_tell_what_tensions_cannot(tdcm):
    free = ("mu", "E", "r1", "r2")
    tensions = fitted(tdcm, recorded(tdcm, 5), free=free)
    assert tensions["r1"].sd is None
    assert any("The simulation hardly changes if r1 is raised" in text for text in tensions.warnings)
    rec = recorded(tdcm, 5, pose=True)
    fit = fitted(tdcm, rec, free=free)
    for name, truth in (("mu", 0.3), ("E", 1.5e6), ("r1", -0.009), ("r2", 0.009)):
        holds(fit, name, truth, 0.02 * abs(truth))
    for name, channel in fit.recordings[0].channels.items():
        assert channel.rms == pytest.approx(NOISE[name], rel=0.3)
    moved = dataclasses.replace(rec, displacement=np.asarray(rec.displacement) + 5e-3)
    same = fitted(tdcm, moved, free=free)
    assert same["mu"].value == pytest.approx(fit["mu"].value, rel=1e-4), "its zero is unknown"
    alone = fitted(tdcm, rec, channels=("tip_angle",))
    assert list(alone.recordings[0].channels) == ["T_tip", "tip_angle"]


def test_a_pose_the_model_does_not_describe_is_said(tdcm):
    rec = recorded(tdcm, 5, pose=True)
    bent = dataclasses.replace(rec, tip_angle=1.2 * np.asarray(rec.tip_angle))
    fit = fitted(tdcm, bent, free=("mu",), channels=("tip_angle",))
    assert "the tip's angle is off by" in fit.verdict


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        ("tip-gain.gain", 1.03),
        ("tip-offset.force", 0.3),
        ("base-gain.gain", 0.97),
        ("base-offset.force", -0.3),
    ],
)
def test_cells_that_are_off(tdcm, name, truth):
    rec = recorded(tdcm, 6, pose=True, **{name: truth})
    fit = fitted(tdcm, rec, free=("mu", "E", name))
    holds(fit, name, truth, 0.03)
    holds(fit, "mu", 0.3)
    assert fit.config is not None and fit.config.terms[0].kind == name.split(".")[0]


def test_commanded_tension_has_an_error_model(make_config):
    """Torque constant, current at rest and pulleys of a motor whose command stands for a cell at the base."""
    terms = [
        {"kind": "base-gain", "gain": 1.05},
        {"kind": "base-offset", "force": 0.2},
        {"kind": "local-friction", "base": 0.05},
    ]
    known = {"base-gain.gain": 0.1, "base-offset.force": 0.3, "local-friction.base": 0.05}
    config = make_config(terms=terms, uncertainty={f"terms.{name}": sd for name, sd in known.items()})
    truth = {"mu": 0.27, "base-gain.gain": 1.09, "base-offset.force": -0.15, "local-friction.base": 0.12}
    fit = fitted(config, recorded(config, 8, pose=True, **cast(Any, truth)), free=("mu", "E"))
    assert {e.name for e in fit.carried} == set(known)
    for name, value in truth.items():
        holds(fit, name, value)
    holds(fit, "E", config.backbone.youngs_modulus)
    assert error(fit, "base-gain.gain") < 0.01 and error(fit, "local-friction.base") < 0.02


def test_knots_of_a_table_and_bores_may_be_free(make_config):
    table = {"kind": "table", "knots": [[0.0, 0.01], [0.1, 0.006], [0.25, 0.01]]}
    config = make_config(table)
    rec = recorded(config, 7, pose=True, knot_1=0.008)
    fit = fitted(config, rec, free=("mu", "knot_1"))
    holds(fit, "knot_1", 0.008)
    assert fit.config is not None and fit.config.numbers()["routing.knots.1.1"] == fit["knot_1"].value


def test_the_depth_of_a_bore(tdcm):
    # It bends the body by less than E is uncertain by: E has to be known.
    tdcm = tdcm.without_deviations(tdcm.uncertainty)
    rec = recorded(tdcm, 8, pose=True, bore_0_to=0.03)
    fit = fitted(tdcm, rec, free=("mu", "bore_0_to"))
    holds(fit, "bore_0_to", 0.03)


def test_outliers_count_less_in_a_robust_fit(tdcm):
    tdcm = tdcm.without_deviations(tdcm.uncertainty)  # else E takes up some of what is far off
    rng = np.random.default_rng(0)
    off, rec = rng.choice(len(PULLED), 5, replace=False), recorded(tdcm, 9)
    T_tip = np.array(rec.T_tip)
    T_tip[off] += 4.0
    bad = dataclasses.replace(rec, T_tip=T_tip)
    plain, robust = fitted(tdcm, bad, free=("mu",)), fitted(tdcm, bad, free=("mu",), robust=True)
    assert any("a robust fit (--robust)" in text for text in plain.warnings)
    assert abs(robust["mu"].value - 0.3) < 0.5 * abs(plain["mu"].value - 0.3)
    holds(robust, "mu", 0.3)
    assert 5 <= robust.recordings[0].outliers <= 9 and "outliers" in robust.verdict
    assert robust.noise_N == pytest.approx(0.05, rel=0.5)
    sound, calm = fitted(tdcm, rec), fitted(tdcm, rec, robust=True)
    assert calm["mu"].value == pytest.approx(sound["mu"].value, abs=error(sound, "mu"))


def test_lone_spikes_of_the_base_are_left_out():
    T = PULLED + np.random.default_rng(1).normal(0, 0.02, len(PULLED))
    spiked = np.array(T)
    spiked[[12, 55]] += [6.0, -5.0]
    clean, count = readings.without_spikes(spiked)
    assert count == 2
    np.testing.assert_allclose(clean, T, atol=0.1)
    assert readings.without_spikes(PULLED)[1] == 0, "turning points are not spikes"
    assert readings.without_spikes(np.repeat(np.arange(10.0), 3))[1] == 0, "nor are steps"


def test_what_is_unknown_blurs_the_rest():
    """Three parameters of which two are known only in combination: the third keeps its marginal error."""
    J = np.asarray([[1.0, 1.0, 0.3], [0.0, 1e-3, 0.3], [0.0, 0.0, 1.0]])
    found = uncertainty(J, 0.1, np.zeros(3), np.full(3, 1.0))
    full = np.linalg.inv(J.T @ J / 0.01)
    assert found.known.tolist() == [False, False, True]
    assert found.covariance[2, 2] == pytest.approx(full[2, 2])


def test_axes_are_those_of_the_information():
    information = np.diag([1e4, 4.0, 0.0])
    least, middle, most = axes(information)
    assert (least.sd, middle.sd, most.sd) == (np.inf, 0.5, 0.01)
    assert middle.words(["mu", "E", "r1"], ["%"] * 3) == "E up by 1 %"


def test_a_prior_with_its_unit(tdcm):
    data = tdcm.model_dump(mode="json", by_alias=True, exclude_none=True)
    known = parse_config(data | {"uncertainty": {"routing.r1": "0.1 mm"}})
    fit = fitted(known, recorded(tdcm, 5), free=("mu", "E", "r1"))
    assert fit.settings["priors_sd_SI"] == {"r1": pytest.approx(1e-4)}
    assert error(fit, "r1") <= 1.01e-4


@pytest.mark.slow
def test_the_sampler_sees_the_sum_of_squares_that_is_minimised(tdcm, monkeypatch):
    """With a noisy base tension, a displacement of unknown zero, a prior and interpolation between steps."""
    history = np.repeat(PULLED, 30)
    rec = recorded(tdcm, 11, pose=True, history=history)
    rng = np.random.default_rng(3)
    noisy = dataclasses.replace(rec, T_base=history + rng.normal(0, 0.05, len(history)))
    seen = []
    module = sys.modules["calibrate.fitting.fit"]
    monkeypatch.setattr(module, "sample", lambda setup, answer: seen.append((setup, answer)))
    fit = calibrate.fit(tdcm, noisy, free=("mu", "E"), sampled=True)
    assert "does not determine" not in fit.verdict
    setup, answer = seen[0]
    assert answer.problem.predictors[0].steps < len(history) and not answer.problem.weighs[0].exact
    potential = potential_of(setup, answer)
    for shift in ([0.0, 0.0], [0.003, -0.01]):
        u = answer.descent.u + np.asarray(shift)
        predictions = answer.problem.predict(u)
        value, slope = jax.value_and_grad(potential)(jnp.asarray(u))
        assert float(value) == pytest.approx(0.5 * answer.problem.cost(u, predictions), rel=1e-8)
        rows, jacobian = answer.problem.rows(u, predictions)
        np.testing.assert_allclose(slope, jacobian.T @ rows, rtol=1e-6, atol=1e-3)
    assert np.isinf(float(potential(jnp.asarray([9.0, 0.0])))), "beyond the range searched"


def test_a_fit_is_tables_and_datasets(tdcm, pair):
    fit = fitted(tdcm, pair[0])
    table = fit.to_pandas()
    assert table.index.tolist() == [e.name for e in (*fit.estimates, *fit.carried)]
    found = table.to_dict("index")
    assert found["mu"]["value"] == fit["mu"].value and found["E"]["unit"] == "Pa"
    assert int(np.sum(table["carried"].to_numpy())) == len(fit.carried)
    one = fit.recordings[0]
    rows, data = one.to_pandas(pair[0]), one.to_xarray(pair[0])
    names = ["T_base_N", "T_tip_N", "T_base_fitted_N", "T_tip_fitted_N", "residual_N", "phase"]
    assert list(rows.columns) == names
    np.testing.assert_allclose(data.T_tip_fitted - data.T_tip, one.residual, atol=1e-12)
    assert data.residual.units == "N" and data.phase.dims == ("sample",)
    with pytest.raises(ValueError, match=r"rec\.csv has 9 samples, and first, which was fitted, 86"):
        one.to_pandas(dataclasses.replace(pair[0], path=Path("rec.csv"), T_base=PULLED[:9]))


@pytest.mark.slow
def test_the_posterior_agrees_with_the_errors(tdcm, pair):
    fit = fitted(tdcm, pair[0], sampled=True, profiled=True)
    posterior = fit.posterior
    assert posterior is not None and posterior.converged and np.all(posterior.effective > 200)
    for i, e in enumerate(fit.estimates):
        sd = error(fit, e.name)
        assert posterior.sd[i] == pytest.approx(sd, rel=0.2)
        assert posterior.lower95[i] == pytest.approx(e.lower95, abs=0.5 * sd)
        assert posterior.upper95[i] == pytest.approx(e.upper95, abs=0.5 * sd)
    assert fit.to_json()["posterior"]["parameters"]["mu"]["effective_draws"] > 200
    chains = posterior.to_arviz()
    np.testing.assert_array_equal(chains.posterior["mu"], posterior.draws[..., 0])
    # The density is highest at the draws near the best, in every chain.
    lp = chains.sample_stats["lp"].values
    off = np.abs(posterior.draws[..., 0] - fit["mu"].value)
    assert lp.shape == off.shape and np.corrcoef(lp.ravel(), off.ravel())[0, 1] < -0.3
    assert np.all(chains.sample_stats["acceptance_rate"] > 0) and chains.posterior["E"].units == "Pa"


def test_an_interrupted_profile_loses_no_fit(tdcm, monkeypatch):
    module, count = sys.modules["calibrate.fitting.profiles"], iter(range(100))

    def interrupted(answer, i, sd):
        if next(count):
            raise KeyboardInterrupt
        return whole(answer, i, sd)

    whole = module._profile
    monkeypatch.setattr(module, "_profile", interrupted)
    fit = fitted(tdcm, recorded(tdcm, 5), free=("mu", "E"), profiled=True)
    assert list(fit.profiles) == ["mu"] and error(fit, "E") > 0
    assert any("Interrupted at the profile of E" in text for text in fit.warnings)


def test_a_dead_channel_is_left_out(tdcm):
    rec = dataclasses.replace(recorded(tdcm, 5), tip_angle=np.full(len(PULLED), 0.2))
    fit = fitted(tdcm, rec, free=("mu",))
    holds(fit, "mu", 0.3)
    assert any("tip_angle never changes" in text for text in fit.warnings)


def test_channels_in_another_unit_are_refused(tdcm):
    rec = recorded(tdcm, 5, pose=True)
    for name, size, words in (("tip_angle", 57.3, "deg"), ("displacement", 1e3, "mm"), ("tip_x", 1e3, "mm")):
        wrong = dataclasses.replace(rec, **{name: size * np.asarray(getattr(rec, name))})
        with pytest.raises(gtr.InputError, match=f"{name} reaches .* call the column {name}_{words}"):
            calibrate.fit(tdcm, wrong, free=("mu",))


def test_channels_are_taken_where_they_are(tdcm, pair):
    posed = recorded(tdcm, 5, pose=True, name="posed")
    fit = fitted(tdcm, [pair[0], posed], channels="tip_angle")
    assert [list(r.channels) for r in fit.recordings] == [["T_tip"], ["T_tip", "tip_angle"]]
    with pytest.raises(gtr.InputError, match="channel 'tip_x': no recording has it"):
        calibrate.fit(tdcm, pair, channels=("tip_x",))


def test_names_by_key_and_in_one_string(tdcm, pair):
    fit = fitted(tdcm, pair, free="mu, E", per_recording="tendon.friction_coefficient")
    assert [e.name for e in fit.estimates] == ["mu@first", "mu@second", "E"]
    with pytest.raises(gtr.InputError, match="'mu' is named twice"):
        calibrate.fit(tdcm, pair, free=("mu", "mu"))
    with pytest.raises(gtr.InputError, match="'mu' is named in two"):
        calibrate.fit(tdcm, pair, per_recording=("mu",), per_robot=("mu",))


def test_times_that_are_no_numbers_are_refused(tdcm):
    rec = dataclasses.replace(recorded(tdcm, 5), time=np.full(len(PULLED), np.nan))
    with pytest.raises(gtr.InputError, match="time is not finite"):
        calibrate.fit(tdcm, rec)


def test_a_fitted_robot_does_not_bring_its_prior_along(tdcm, pair):
    fit = fitted(tdcm, pair[0])
    assert "backbone.youngs_modulus" in tdcm.uncertainty
    assert fit.config is not None
    assert fit.config.deviation("backbone.youngs_modulus") == pytest.approx(error(fit, "E"), rel=0.01)


def test_what_came_from_where_is_in_the_json(tdcm, pair):
    data = fitted(tdcm, pair, free=("mu", "base-offset.force"), per_recording=("mu",)).to_json()
    assert [(r["name"], r["robot"], r["path"]) for r in data["recordings"]] == [
        ("first", "tdcm-1", "first.csv"),
        ("second", "tdcm-1", "second.csv"),
    ]
    assert data["settings"]["recordings_of"]["mu@second"] == ["second"]
    assert any("base-offset.force up by 1 % of 1 N" in axis["says"] for axis in data["axes"])


@pytest.mark.parametrize(
    ("name", "given", "starts"),
    [
        ("saturation.knee", 0.0, 2.55),
        ("saturation.knee", 0.4, 0.4),
        ("adhesion.drag", 0.0, 2.0),
        ("zero-drift.tip", 0.0, 0.0),
    ],
)
def test_numbers_of_terms_start_where_they_can_move(tdcm, name, given, starts):
    robot = gtr.build_robot(tdcm).with_values(**{name: given})
    (found,) = free_of([robot], [tdcm], [0], ["recording"], ["robot"], [name])
    assert found.initial == pytest.approx(starts)


def test_a_value_stops_at_its_bound(tdcm):
    """A tip that is held up asks for less than no payload: it gets none, and that is said."""
    data = tdcm.model_dump(mode="json", by_alias=True, exclude_none=True)
    hung = parse_config(data | {"loads": {"gravity_angle": "-90 deg"}})
    fit = fitted(hung, recorded(hung, 12, pose=True, payload=0.05), free=("mu", "payload"))
    holds(fit, "payload", 0.05, 0.01)
    held = fitted(hung, recorded(hung, 12, pose=True, tip_force_y=0.5), free=("mu", "payload"))
    assert held["payload"].value == 0.0 and held["payload"].sd is None
    assert "lies at its bound" in held["payload"].note
