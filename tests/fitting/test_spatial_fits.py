"""Fits of robots in space, and of robots with several tendons."""

import dataclasses
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run_gtr
from scipy.spatial.transform import Rotation

import calibrate
import gtr_jax as gtr
from calibrate.inference.channels import ROTATION, channels_in, orientation_of, turned_back, turned_by
from calibrate.inference.several import SeveralWeighing
from calibrate.inference.simulated_readings import Prediction
from calibrate.inference.weighing import Weighing
from gtr_jax.recordings.base_tension.base_tension import runs
from gtr_jax.recordings.signals import noise
from gtr_jax.recordings.thinning import thinned

ROOT = Path(__file__).parents[2]
EXAMPLE, RECORDED = ROOT / "examples/helix.toml", ROOT / "examples/helix-recording.csv"
# With which `python -m benchmarks.spatial_fits --example` made the recording.
TRUTH = {"mu": 0.24, "E": 1.31e6}
RUNS = Path(__file__).parents[1] / "data" / "reference3d"


def check(estimate, true, most):
    """The truth lies within four standard errors, which are themselves small."""
    assert estimate.sd is not None
    assert abs(estimate.value - true) < 4 * estimate.sd < most


@pytest.mark.slow
def test_a_helical_tendon_is_fitted_and_what_is_fitted_simulates(capsys, tmp_path):
    done = run_gtr(capsys, "fit", EXAMPLE, RECORDED, "--free", "mu,E", "-o", tmp_path / "out")
    assert done.status == 0, done.err
    found = json.loads((tmp_path / "out/fit.json").read_text())
    for name, true in TRUTH.items():
        sd = found["parameters"][name]["sd"]
        assert abs(found["parameters"][name]["value"] - true) < 4 * sd < 0.04 * true
    # Neighbours of so few samples differ by the pull too, so that the noise of the tensions seems larger.
    assert 0.3 < found["fit"]["chi2_per_n"] < 1.5
    assert found["recordings"][0]["rms_N"] == pytest.approx(0.01, rel=0.3)
    channels = found["recordings"][0]["channels"]
    assert {"tip_x", "tip_y", "tip_z", *ROTATION, "displacement"} < set(channels)
    # The noise of the instruments, which nothing of the model adds to.
    assert channels["tip_z"]["rms"] == pytest.approx(1e-4, rel=0.4)
    assert channels["tip_rotation_y"]["rms"] == pytest.approx(2e-3, rel=0.4)
    header = (tmp_path / "out/fit.csv").read_text().splitlines()[0]
    assert "tip_z_fitted_m" in header and "tip_qw_fitted" in header
    robot = gtr.load_robot(tmp_path / "out/fitted.toml")
    assert float(robot.value("mu")) == pytest.approx(found["parameters"]["mu"]["value"], rel=1e-6)
    # Simulated from the recorded tensions, the fitted robot is where the recording says it was.
    recording = gtr.read_recording(RECORDED, space=True)
    run = gtr.simulate(robot, np.maximum.accumulate(recording.T_base[:25]))
    place = np.stack([np.asarray(getattr(recording, f"tip_{axis}")) for axis in "xyz"], axis=1)[:25]
    assert np.max(np.linalg.norm(run.tip_position - place, axis=1)) < 1e-3


@pytest.mark.slow
def test_a_displacement_drives_where_no_base_tension_is_recorded():
    config = gtr.load_config(EXAMPLE).with_values({"backbone.youngs_modulus": TRUTH["E"]})
    recording = gtr.read_recording(RECORDED, space=True)
    recording = thinned(recording, 32)
    given = dataclasses.replace(recording, T_base=np.full_like(recording.T_base, np.nan))
    fit = calibrate.fit(config, given, free="mu", channels="tip_x,tip_y,tip_z")
    assert fit.converged
    (only,) = fit.recordings
    assert "displacement" not in only.channels and only.config is not None
    assert only.config.tendon.drive == "displacement" and only.robot.tendon.drive == "displacement"
    assert any("displacement drives the tendon" in w for w in fit.warnings)
    assert any("displacement" in source for source in fit["mu"].made_of)
    check(fit["mu"], TRUTH["mu"], 0.1)


def two_helices(make_config, **tendon):
    """The robot of the reference run two-tendons, its friction and modulus a little off."""
    case = json.loads((RUNS / "two-tendons.json").read_text())
    tendons = [
        {
            "name": name,
            "friction_coefficient": 0.2,
            "routing": {
                "kind": "helix",
                "radius": one["radius_base_m"],
                "turns": one["turns"],
                "start_angle": one["start_angle_rad"],
            },
            **tendon,
        }
        for name, one in zip("ab", case["tendons"], strict=True)
    ]
    body = {"outer_radius": 0.012, "youngs_modulus": 1.1e6, "poissons_ratio": 0.5, "density": 0.0}
    return make_config(backbone=body, tendons=tendons, space=True), case


def noisy(recording, seed, force=0.01, place=1e-4):
    rng = np.random.default_rng(seed)
    off = {"T_base": force, "T_tip": force, "displacement": place / 10}
    off |= {f"tip_{axis}": place for axis in "xyz"}
    return dataclasses.replace(
        recording,
        **{
            name: getattr(recording, name) + sd * rng.normal(size=getattr(recording, name).shape)
            for name, sd in off.items()
        },
    )


@pytest.mark.slow
def test_each_of_two_tendons_in_space_gets_its_friction(make_config):
    config, case = two_helices(make_config)
    recording = gtr.read_recording(RUNS / "two-tendons.csv", space=True, tendons=("a", "b"))
    fit = calibrate.fit(config, noisy(recording, 3), free="mu.a,mu.b,E", noise_N=0.01, noise_base_N=0.01)
    assert fit.converged
    (only,) = fit.recordings
    assert only.T_tip.shape == only.T_base.shape == only.phases.shape == (len(recording), 2)
    assert {"T_tip.a", "T_tip.b", "displacement.a", "displacement.b"} < set(only.channels)
    for name in ("mu.a", "mu.b"):
        check(fit[name], case["friction_coefficient"], 0.2)
    check(fit["E"], case["youngs_modulus_Pa"], 0.05e6)


@pytest.mark.slow
def test_two_tendons_in_the_plane_are_fitted(make_config, tmp_path):
    tendons = [
        {
            "name": name,
            "friction_coefficient": mu,
            "preload": 0.5,
            "routing": {"kind": "parallel", "offset": offset},
        }
        for name, mu, offset in (("left", 0.25, 0.01), ("right", 0.35, -0.01))
    ]
    config = make_config(tendons=tendons)
    pull = np.concatenate([np.linspace(0.5, 9, 10), np.linspace(9, 3, 8)[1:]])
    T_base = np.stack([pull, np.linspace(0.5, 2.5, len(pull))], axis=1)
    run = gtr.simulate(gtr.build_robot(config), T_base)
    rng = np.random.default_rng(1)
    shape = T_base.shape
    columns = {
        "T_base": T_base,
        "T_tip": np.asarray(run.T_tip) + 1e-3 * rng.normal(size=shape),
        "tip_angle": np.asarray(run.tip_pose)[:, 2] + 1e-4 * rng.normal(size=len(pull)),
    }
    gtr.write_recording(tmp_path / "two.csv", columns, tendons=("left", "right"))
    recording = gtr.read_recording(tmp_path / "two.csv", tendons=("left", "right"))
    wrong = {f"tendons.{name}.friction_coefficient": 0.3 for name in ("left", "right")}
    fit = calibrate.fit(config.with_values(wrong), recording, free="mu.left,mu.right,E", noise_base_N=0.0)
    assert fit.converged and fit.mu_by_phase == {}
    for name, true in (("mu.left", 0.25), ("mu.right", 0.35), ("E", 1.06e6)):
        check(fit[name], true, 0.2 * true)
    assert {key.partition(",")[0] for key in fit.by_phase} == {"left", "right"}


def weighing_of_two(K=9, sds=(0.1, 0.2), seed=0):
    """Two drives with knots, three channels, and a residual, all at random."""
    rng = np.random.default_rng(seed)
    drives = [
        runs(np.arange(K, dtype=float), rng.normal(size=K), np.asarray(knots), None, sd)
        for knots, sd in zip(([0, 4, K - 1], [0, 2, 6, K - 1]), sds, strict=True)
    ]
    prediction = Prediction(
        values=np.zeros((3, K)),
        failed=0,
        slips=rng.random((K, 2)) < 0.6,
        direction=np.zeros((K, 2)),
        T_tip=np.zeros((2, K)),
        jacobian=np.zeros((3, K, 1)),
        slopes=tuple(rng.normal(size=(2, 3, K))),
    )
    sd = np.array([0.05, 0.07, 0.3])
    weigh = SeveralWeighing.of_all(
        drives,
        prediction.slips,
        prediction.slopes,
        ("T_tip.a", "T_tip.b", "tip_x"),
        sd,
        np.zeros((3, K)),
    )
    return drives, prediction, sd, weigh, rng.normal(size=(3, K))


def test_noise_of_several_drives_is_weighed_as_a_dense_covariance_does():
    drives, prediction, sd, weigh, r = weighing_of_two()
    C, K = r.shape
    # The covariance of the residual: its own noise, and that of each drive by way of its knots.
    whole = np.diag(np.repeat(sd**2, K))
    for i, drive in enumerate(drives):
        B = np.zeros((K, drive.size))
        for row, (near, share) in enumerate(zip(drive.near, drive.weights, strict=True)):
            np.add.at(B[row], near, share)
        of_knots = np.linalg.inv(B.T @ (B / drive.believed[:, None] ** 2))
        slipped = np.maximum.accumulate(np.where(prediction.slips, np.arange(K)[:, None], 0), axis=0)
        lasts = [slipped[:, 0], slipped[:, 1], np.arange(K)]
        G = np.concatenate([prediction.slopes[i][c, :, None] * B[lasts[c]] for c in range(C)])
        whole = whole + G @ of_knots @ G.T
    rows = weigh(r)
    assert rows.shape == (C * K + 2 * K,)
    np.testing.assert_allclose(rows @ rows, r.ravel() @ np.linalg.solve(whole, r.ravel()), rtol=1e-9)


def test_one_of_several_drives_alone_is_weighed_as_the_only_one():
    drives, prediction, sd, weigh, r = weighing_of_two()
    alone = dataclasses.replace(weigh, sds=(weigh.sds[0], 0.0))
    only = dataclasses.replace(
        Weighing.plain(drives[0], ("T_tip", "tip_x", "tip_y"), sd),
        slope=prediction.slopes[0],
        last=weigh.last[..., 0],
        sd_base=drives[0].believed,
    )
    several, single = alone(r), only(r)
    K = r.shape[1]
    np.testing.assert_allclose(several[: 4 * K], single, rtol=1e-9, atol=1e-12)
    assert not several[4 * K :].any()


class TestOrientation:
    def recorded(self, rng, K=6):
        each = Rotation.from_rotvec(np.cumsum(0.4 * rng.normal(size=(K, 3)), axis=0))
        columns = dict(zip(("tip_qx", "tip_qy", "tip_qz", "tip_qw"), each.as_quat().T, strict=True))
        blank = np.zeros(K)
        return each, gtr.Recording(T_base=blank, path=Path("rec.csv"), sha256="", T_tip=blank, **columns)

    def test_a_residual_is_the_rotation_between_the_two(self):
        rng = np.random.default_rng(2)
        each, recording = self.recorded(rng)
        found, quaternion = orientation_of(recording), recording.tip_quaternion
        assert found is not None and quaternion is not None
        off = rng.normal(size=(6, 3))
        off[0] = 0.0  # where the length of a rotation vector has no derivative
        simulated = (each * Rotation.from_rotvec(off)).as_matrix()
        channels = np.asarray(turned_by(jnp.asarray(simulated), found))
        np.testing.assert_allclose(channels - found.turned, off, atol=1e-12)
        again = turned_back(quaternion, off)
        np.testing.assert_allclose(Rotation.from_quat(again).as_matrix(), simulated, atol=1e-12)

    def test_noise_shows_in_neighbouring_samples(self):
        rng = np.random.default_rng(3)
        smooth = Rotation.from_rotvec(np.linspace([0, 0, 0], [1.0, 2.0, 0.5], 200))
        noisy = (smooth * Rotation.from_rotvec(2e-3 * rng.normal(size=(200, 3)))).as_quat()
        columns = dict(zip(("tip_qx", "tip_qy", "tip_qz", "tip_qw"), noisy.T, strict=True))
        blank = np.zeros(200)
        found = orientation_of(
            gtr.Recording(T_base=blank, path=Path("rec.csv"), sha256="", T_tip=blank, **columns)
        )
        assert found is not None
        seen = np.asarray([noise.from_differences(row) for row in found.turned.T], float)
        np.testing.assert_allclose(seen, 2e-3, rtol=0.3)


def test_what_can_be_compared_depends_on_the_drive(make_config):
    config, _ = two_helices(make_config)
    robot = gtr.build_robot(config)
    K = 5
    both = np.ones((K, 2))
    recording = gtr.Recording(
        T_base=both, path=Path("rec.csv"), sha256="", T_tip=both, displacement=both, tendons=("a", "b")
    )
    first, second = robot.tendons
    mixed = dataclasses.replace(robot, tendons=(first, dataclasses.replace(second, drive="displacement")))
    assert list(channels_in(recording, mixed)) == ["T_tip.a", "T_tip.b", "displacement.a", "T_base.b"]


def test_what_does_not_fit_is_refused_in_a_line(make_config):
    config, _ = two_helices(make_config)
    recording = gtr.read_recording(RUNS / "two-tendons.csv", space=True, tendons=("a", "b"))
    with pytest.raises(gtr.InputError, match=r"T_base has the shape .*2 tendons"):
        calibrate.fit(config, dataclasses.replace(recording, T_base=recording.T_base[:, 0]))
    with pytest.raises(
        gtr.InputError,
        match=r"must be one of .*tip_z, tip_rotation, .*displacement.*; got "
        r"'tip_angle'",
    ):
        calibrate.fit(config, recording, channels="tip_angle")
    with pytest.raises(gtr.InputError, match=r"channel 'displacement\.b': no recording has it"):
        calibrate.fit(config, dataclasses.replace(recording, displacement=None), channels="displacement.b")
    drawn, _ = two_helices(make_config, drive="displacement")
    with pytest.raises(gtr.InputError, match=r"no column displacement_m\.a"):
        calibrate.fit(drawn, dataclasses.replace(recording, displacement=None))
    with pytest.raises(gtr.InputError, match=r"posterior"):
        calibrate.fit(config, recording, free="mu.a", sampled=True)
