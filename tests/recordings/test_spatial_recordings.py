"""Recordings of robots in space: the tip's pose, markers, and tendons driven by displacement."""

import numpy as np
import pytest

import gtr_jax as gtr
from gtr_jax.recordings.thinning import thinned

POSE = "T_base_N,T_tip_N,tip_x_m,tip_y_mm,tip_z_mm,tip_qx,tip_qy,tip_qz,tip_qw,m1_x_mm,m1_y_mm,m1_z_mm\n"
ROWS = "0,0,0.25,0,0,0,0,0,1,130,0,25\n1,0.8,0.24,10,20,0.1,0.2,0.3,0.92736,129,1,26\n"


@pytest.fixture
def read(tmp_path):
    def read(text, **how):
        path = tmp_path / "rec.csv"
        path.write_text(text)
        return gtr.read_recording(path, **{"space": True, "need_tip": False, **how})

    return read


def test_the_pose_of_the_tip_and_markers(read, tmp_path):
    recording = read(POSE + ROWS, markers=("m1",))
    np.testing.assert_allclose(recording.tip_z, [0, 0.02])
    np.testing.assert_allclose(np.linalg.norm(recording.tip_quaternion, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(recording.tip_quaternion[1, :3], [0.1, 0.2, 0.3], rtol=1e-5)
    np.testing.assert_allclose(recording.markers["m1_z"], [0.025, 0.026])
    gtr.write_recording(tmp_path / "again.csv", recording)
    header = (tmp_path / "again.csv").read_text().splitlines()[0]
    assert header == (
        "T_base_N,T_tip_N,tip_x_m,tip_y_m,tip_z_m,tip_qx,tip_qy,tip_qz,tip_qw,m1_x_m,m1_y_m,m1_z_m"
    )
    again = gtr.read_recording(tmp_path / "again.csv", markers=("m1",), space=True)
    np.testing.assert_array_equal(again.tip_quaternion, recording.tip_quaternion)
    np.testing.assert_array_equal(again.markers["m1_x"], recording.markers["m1_x"])


def test_a_robot_in_the_plane_reads_what_it_did(read):
    recording = read(POSE + ROWS, space=False)
    assert recording.tip_z is None and recording.tip_quaternion is None and not recording.markers


def test_markers_are_mapped(read):
    text = "T_base_N,first x\n0,0\n1,2\n"
    recording = read(text, columns="m1_x=first x[mm]", markers=("m1",))
    np.testing.assert_allclose(recording.markers["m1_x"], [0, 0.002])
    with pytest.raises(gtr.InputError, match="unknown quantity 'm2_x'; did you mean 'm1_x'"):
        read(text, columns="m2_x=first x[mm]", markers=("m1",))


def test_what_is_no_rotation_is_refused(read):
    with pytest.raises(
        gtr.InputError, match=r"rec\.csv: row 3, columns tip_qx.*length 1\.\d+ is not a rotation"
    ):
        read(POSE + ROWS.replace("0.92736", "1.4"))
    with pytest.raises(gtr.InputError, match=r"no column tip_qw"):
        read("T_base_N,tip_qx,tip_qy,tip_qz\n0,0,0,0\n1,0,0,0\n")


def test_displacements_may_drive(read, tmp_path):
    recording = read("displacement_mm\n0\n4\n")
    np.testing.assert_allclose(recording.displacement, [0, 0.004])
    assert np.isnan(recording.T_base).all() and len(recording) == 2
    gtr.write_recording(tmp_path / "again.csv", recording)
    assert (tmp_path / "again.csv").read_text().splitlines()[0] == "displacement_m"
    several = read("displacement_mm.a,T_base_N.b\n0,0\n4,3\n", tendons=("a", "b"))
    np.testing.assert_allclose(several.displacement[:, 0], [0, 0.004])
    np.testing.assert_allclose(several.T_base[:, 1], [0, 3])
    assert np.isnan(several.T_base[:, 0]).all() and np.isnan(several.displacement[:, 1]).all()
    with pytest.raises(gtr.InputError, match=r"no column T_base_N\.b"):
        read("displacement_mm.a\n0\n1\n", tendons=("a", "b"))


def test_displacements_do_not_drive_in_the_plane_unless_asked(read):
    with pytest.raises(gtr.InputError, match="no column T_base_N"):
        read("displacement_mm\n0\n4\n", space=False)


def test_markers_are_thinned_with_the_rest(read):
    k = np.arange(400)
    lines = "".join(f"{np.sin(i / 40) + 1:.6f},{i}\n" for i in k)
    recording = thinned(read("T_base_N,m1_x_m\n" + lines, markers=("m1",)), 100)
    np.testing.assert_array_equal(recording.markers["m1_x"], np.asarray(recording.rows) - 2)
