"""Sweeps of robots in space: what the store holds is what physics demands, and what cannot be is refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from gtr_jax.errors import InputError
from gtr_jax.robot.validity import is_robot
from gtr_jax.sweep import load_sweep, open_sweep, sweep, task_of
from gtr_jax.sweep.store import Store

EXAMPLES = Path(__file__).parents[2] / "examples"
HELIX, THREE, PAIR = (
    (EXAMPLES / f"{name}.toml").read_text() for name in ("helix", "three-tendons", "antagonists")
)
GRID = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip", "tip_pose", "displacement", "shape", "markers"]
[vary]
mu = [0.0, 0.3]
radius = ["6 mm", "8 mm", "12.5 mm"]
base_rotation_z = ["0 deg", "90 deg"]
[history]
pull = "10 N"
"""
PULLED = """
schema = 1
robot = "robot.toml"
outputs = ["T_tip", "tip_pose", "displacement"]
[vary]
mu.a = [0.1, 0.3]
[history]
pull = "4 mm"
tendon = "a"
"""


def written(folder, text, robot):
    (folder / "robot.toml").write_text(robot)
    (folder / "sweep.toml").write_text(text)
    return folder / "sweep.toml"


def task_for(folder, text, robot):
    return task_of(load_sweep(written(folder, text, robot)))


class Helix:
    """The example without friction: strain u(s) = R_x(f s) u(0), a helix, from one root of K u = -r x T t."""

    def __init__(self, d, T=10.0):
        L, f, start = 0.25, np.pi / 0.25, np.radians(30)
        EI = 1.2e6 * np.pi / 4 * (0.012**4 - 0.003**4)
        self.r = d * np.array([0, np.cos(start), np.sin(start)])
        self.f, self.L, self.T = f, L, T
        K = np.diag([EI / 1.5, EI, EI])
        self.u = root(
            lambda u: K @ u + np.cross(self.r, T * self.along(u) / self.nu(u)), np.zeros(3), tol=1e-12
        ).x

    def along(self, u):
        turn = np.array([self.f, 0, 0])
        return np.array([1.0, 0, 0]) + np.cross(u + turn, self.r)

    def nu(self, u):
        return np.linalg.norm(self.along(u))

    @property
    def displacement(self):
        return self.L * (self.nu(np.zeros(3)) - self.nu(self.u))

    def frame(self, s):
        """Place and directors at s: the frame that turns with the channel runs along a screw."""
        a, b, c = self.u + np.array([self.f, 0, 0])
        screw = np.array([[0, -c, b, 1], [c, 0, -a, 0], [-b, a, 0, 0], [0, 0, 0, 0]])
        whole = expm(screw * s)
        return whole[:3, 3], whole[:3, :3] @ Rotation.from_rotvec([-self.f * s, 0, 0]).as_matrix()


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    folder = tmp_path_factory.mktemp("space")
    return sweep(written(folder, GRID, HELIX), folder / "o.zarr").load()


@pytest.mark.parametrize(("i", "d"), [(0, 0.006), (1, 0.008)])
def test_helices_without_friction_are_helices(grid, i, d):
    exact = Helix(d)
    at = grid.isel(mu=0, radius=i, base_rotation_z=0)
    place, turned = exact.frame(exact.L)
    np.testing.assert_allclose(at.T_tip, 10.0, rtol=1e-12)
    np.testing.assert_allclose([at.tip_x, at.tip_y, at.tip_z], place, atol=1e-6 * exact.L)
    quaternion = Rotation.from_matrix(turned).as_quat(canonical=True)
    np.testing.assert_allclose([at[f"tip_q{axis}"] for axis in "xyzw"], quaternion, atol=1e-6)
    np.testing.assert_allclose(at.displacement, exact.displacement, rtol=1e-6)
    place, turned = exact.frame(0.125)
    marker = place + turned @ [0, 0, 0.012]
    np.testing.assert_allclose([at.m1_x, at.m1_y, at.m1_z], marker, atol=1e-6 * exact.L)
    node = grid.sizes["node"] // 2
    place, turned = exact.frame(float(at.s[node]))
    np.testing.assert_allclose([at[axis][node] for axis in "xyz"], place, atol=1e-6 * exact.L)
    quaternion = Rotation.from_matrix(turned).as_quat(canonical=True)
    np.testing.assert_allclose([at[f"q{axis}"][node] for axis in "xyzw"], quaternion, atol=1e-6)


def test_a_base_that_is_turned_turns_the_tip_and_nothing_else(grid):
    still, turned = (grid.isel(mu=1, radius=slice(2), base_rotation_z=k) for k in (0, 1))
    np.testing.assert_allclose(turned.T_tip, still.T_tip, rtol=1e-12)
    np.testing.assert_allclose(turned.displacement, still.displacement, rtol=1e-9)
    np.testing.assert_allclose(turned.tip_x, -still.tip_y, atol=1e-12)
    np.testing.assert_allclose(turned.tip_y, still.tip_x, atol=1e-12)
    assert np.all(grid.T_tip.isel(mu=1, radius=slice(2)) < 9.5)


def test_a_channel_outside_the_body_is_no_robot(grid):
    np.testing.assert_array_equal(grid.result.isel(mu=0, base_rotation_z=0), [0, 0, 3])
    assert np.all(np.isnan(grid.tip_z.isel(radius=2)))


def test_arrays_in_space_have_units_and_coordinates(grid):
    assert grid.T_tip.dims == ("mu", "radius", "base_rotation_z")
    units = {"tip_z": "m", "tip_qw": "1", "m1_z": "m", "radius": "m", "base_rotation_z": "rad", "T_base": "N"}
    assert {name: grid[name].attrs["units"] for name in units} == units
    assert "tip_angle" not in grid


@pytest.mark.parametrize(
    ("robot", "values", "holds"),
    [
        (HELIX, {"radius": 0.0119}, True),
        (HELIX, {"radius": 0.0121}, False),
        (HELIX, {"base_rotation_x": 5.0, "base_rotation_y": 5.0}, False),
        (HELIX, {"nu": -1.0}, False),
        ("guided", {"to": 0.22}, True),
        ("guided", {"to": 0.19}, False),
        ("guided", {"to": 0.26}, False),
        ("guided", {"guide_0": 0.21}, False),
        ("pieces", {"section_0_to": 0.15}, True),
        ("pieces", {"section_0_to": 0.21}, False),
        ("pieces", {"section_1_to": 0.26}, False),
        (THREE, {"angle.b": 0.1}, True),
        (THREE, {"angle.b": 0.0}, False),
    ],
)
def test_what_is_a_robot_in_space(tmp_path, robot, values, holds):
    known = {
        "guided": HELIX.replace("= 0.3\n", '= 0.3\nto = "220 mm"\nguides = ["100 mm", "200 mm"]\n'),
        "pieces": HELIX.replace("[routing]", PIECES + "[routing]"),
    }
    text = GRID.replace("mu = ", "nu = " if robot == THREE else "mu = ").replace(', "markers"', "")
    text = text.replace('radius = ["6 mm", "8 mm", "12.5 mm"]\n', "")
    text = PULLED if robot == THREE else text
    task = task_for(tmp_path, text, known.get(robot, robot))
    assert bool(is_robot(task.robot.with_values(**values))) is holds


PIECES = """
[[backbone.sections]]
from = "100 mm"
to = "150 mm"
youngs_modulus = "2 MPa"
[[backbone.sections]]
from = "200 mm"
to = "220 mm"
youngs_modulus = "2 MPa"
"""

BAD = {
    "switch of several": (PULLED, THREE, ('"T_tip"', '"T_base_switch"'), "T_base_switch is for one tendon"),
    "no markers": (PULLED, THREE, ('"T_tip"', '"markers"'), "markers: the robot has none"),
    "tension": (
        PULLED,
        THREE,
        ('"4 mm"', '"4 N"'),
        'driven by displacement; write for example pull = "10 mm"',
    ),
    "bare": (PULLED, THREE, ('"4 mm"', "4"), "driven by displacement"),
    "displacement": (GRID, HELIX, ('"10 N"', '"10 mm"'), "history.pull: 'mm' is not a unit of a force"),
    "release above": (
        PULLED,
        THREE,
        ('"4 mm"', '"4 mm"\nrelease = "5 mm"'),
        "between 0 m and the pull of 0.004 m",
    ),
    "no pull": (PULLED, THREE, ('pull = "4 mm"\n', ""), 'add for example pull = "10 mm"'),
    "which tendon": (PULLED, THREE, ('tendon = "a"\n', ""), "which of a, b, c to pull?"),
    "held": (PULLED, THREE, ("mu.a", '"viscoelastic-body.ratio"'), "vary.viscoelastic-body.ratio: bends"),
    "moved": (PULLED, THREE, ("mu.a", '"tip-moved.tension"'), "vary.tip-moved.tension: moves an end"),
    "unit of a varied pull": (
        PULLED,
        THREE,
        ('mu.a = [0.1, 0.3]\n[history]\npull = "4 mm"\n', 'pull = ["4 N", "5 N"]\n[history]\n'),
        "'N' is not a unit of a length",
    ),
}


@pytest.mark.parametrize("case", list(BAD))
def test_what_a_sweep_in_space_cannot_have(tmp_path, case):
    text, robot, (old, new), says = BAD[case]
    assert old in text
    with pytest.raises(InputError) as fault:
        task_for(tmp_path, text.replace(old, new), robot)
    assert says in str(fault.value)


COLUMNS = "time_s,T_base_N.left,displacement_mm.right\n0,0,0\n1,5,1\n2,8,3\n3,6,2\n4,9,2\n"


def test_a_file_drives_each_tendon_by_what_it_has_of_it(tmp_path):
    text = PULLED.replace("mu.a", "mu.left").replace('pull = "4 mm"\ntendon = "a"', 'file = "h.csv"')
    (tmp_path / "h.csv").write_text(COLUMNS)
    task = task_for(tmp_path, text, PAIR)
    assert task.robot.space and task.drawn and task.history.drawn == (False, True)
    assert task.history.given is not None and task.history.displacement is not None
    np.testing.assert_array_equal(task.history.given[:, 0], [0, 5, 8, 6, 9])
    np.testing.assert_allclose(task.history.displacement[:, 1], [0, 1e-3, 3e-3, 2e-3, 2e-3])
    assert task.history.kept == (2, 4) and task.history.shown == 0
    assert {"T_tip.left", "displacement.right", "T_base.right"} <= {v.name for v in task.outputs}
    assert "T_base.left" not in {v.name for v in task.stored}
    (tmp_path / "h.csv").write_text(COLUMNS.replace("3,6,2", "3,6,1"))
    assert task_for(tmp_path, text, PAIR).fingerprint != task.fingerprint


def test_a_store_says_what_drives_the_tendons(tmp_path):
    robot = THREE.replace('name = "c"\ndrive = "displacement"', 'name = "c"\npreload = "2 N"', 1)
    store = Store(tmp_path / "o.zarr", task_for(tmp_path, PULLED, robot))
    store.create()
    data = open_sweep(store.path)
    assert {"T_base.c", "drawn_out.a", "drawn_out.b"} <= set(data.coords)
    assert float(data["T_base.c"]) == 2.0 and float(data["drawn_out.a"]) == 4e-3
    assert float(data["drawn_out.b"]) == 0.0 and data["drawn_out.a"].attrs["units"] == "m"
    assert {"T_base.a", "T_base.b"} <= set(data.data_vars) and "drawn_out.c" not in data
    data.close()


def test_the_example_is_a_sweep():
    task = task_of(load_sweep(EXAMPLES / "helix-sweep.toml"))
    assert task.plan.points == 10_000 and task.robot.space


@pytest.mark.slow
def test_tendons_drawn_out_find_their_tensions(tmp_path):
    """One of three like tendons about a round body: the two others are each other's mirror images."""
    text = PULLED.replace("mu.a = [0.1, 0.3]", 'pull = ["2 mm", "4 mm"]').replace('pull = "4 mm"\n', "")
    data = sweep(written(tmp_path, text, THREE), tmp_path / "o.zarr").load()
    assert np.all(data.result == 0) and data["T_base.a"].dims == ("pull",)
    np.testing.assert_allclose(data["displacement.a"], data.pull, rtol=1e-8)
    np.testing.assert_allclose(data["displacement.b"], 0.0, atol=1e-11)
    np.testing.assert_allclose(data["T_base.b"], data["T_base.c"], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(data["T_tip.b"], data["T_tip.c"], rtol=1e-6, atol=1e-9)
    assert np.all(data["T_tip.a"] < data["T_base.a"])
    assert data["T_base.a"][1] > data["T_base.a"][0] > 0
    np.testing.assert_allclose(
        data.tip_z, 0.0, atol=1e-9
    )  # b and c stand on both sides of the plane of x and y
    assert np.all(data.tip_y > 0)
