"""Robots in space: closed forms, symmetries, derivatives, and runs of an independent simulator."""

import csv
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import gtr_jax as gtr

RUNS = Path(__file__).parents[1] / "data" / "reference3d"
SOFT = {"outer_radius": [0.012, 0.012], "youngs_modulus": 1.2e6, "poissons_ratio": 0.5, "density": 0.0}
HELIX = {"kind": "helix", "radius": 0.008, "turns": 1.25, "start_angle": 0.5}
SINE = {"kind": "crossing-sine", "R_max": 0.01, "r_min": 0.006, "n_sine": 3}


def vector_cross(a, b):
    return np.cross(np.asarray(a, float), np.asarray(b, float))


@pytest.fixture
def spatial(make_robot):
    """A robot computed in space."""

    def make(resolution=1.0, **sections):
        return make_robot(resolution, **{"backbone": SOFT, "routing": HELIX, "space": True} | sections)

    return make


def tip_of(eq):
    return np.asarray(eq.tip_position), np.asarray(eq.tip_rotation)


class TestClosedForms:
    d, L, E, nu, r, T = 0.006, 0.4, 54e9, 0.3, 0.7e-3, 6.0
    f = 2 * np.pi / L

    def rod(self, spatial, resolution=1.0):
        EI = self.E * np.pi / 4 * self.r**4
        body = {
            "length": self.L,
            "outer_radius": 0.008,
            "poissons_ratio": self.nu,
            "bending_stiffness": EI,
            "youngs_modulus": None,
        }
        routing = {"kind": "helix", "radius": self.d, "turns": 1.0}
        return spatial(resolution, backbone=body, routing=routing, tendon={"friction_coefficient": 0.0})

    def exact(self):
        """Strain at the base from one root, tip from one matrix exponential; no code of the march."""
        EI = self.E * np.pi / 4 * self.r**4
        K = np.diag([EI / (1 + self.nu), EI, EI])
        r0, dr0 = np.array([0.0, self.d, 0.0]), np.array([0.0, 0.0, self.f * self.d])

        def left(u):
            w = np.array([1.0, 0, 0]) + vector_cross(u, r0) + dr0
            return K @ u + vector_cross(r0, self.T * w / np.linalg.norm(w))

        u = root(left, [0.0, 0.0, 3.0], tol=1e-14).x
        turn = np.zeros((4, 4))
        ux, uy, uz = u + np.array([self.f, 0, 0])
        turn[:3, :3] = [[0, -uz, uy], [uz, 0, -ux], [-uy, ux, 0]]
        turn[0, 3] = 1.0
        return u, expm(turn * self.L)[:3, 3]

    def test_a_helical_tendon_makes_a_helix(self, spatial):
        eq = gtr.equilibrium(self.rod(spatial), self.T)
        u, tip = self.exact()
        np.testing.assert_allclose(u, [-0.42855, 0.0, 3.51990], atol=1e-5)
        np.testing.assert_allclose(tip, [0.3798054, 9.2e-7, 0.0876620], atol=1e-7)
        turns = Rotation.from_rotvec(np.outer(self.f * np.asarray(eq.s), [1.0, 0, 0]))
        assert eq.shape is not None
        np.testing.assert_allclose(eq.shape.strain, turns.apply(u), atol=1e-8)
        np.testing.assert_allclose(eq.tip_position, tip, atol=2e-6)

    def test_the_shape_converges_with_order_four(self, spatial):
        _, tip = self.exact()
        errors = [
            np.linalg.norm(gtr.equilibrium(self.rod(spatial, k), self.T).tip_position - tip) for k in (1, 2)
        ]
        assert np.log2(errors[0] / errors[1]) > 3.5

    def test_a_rigid_helix_loses_what_its_wrap_costs(self, spatial):
        mu, length = 0.3, 0.25
        d, f = 0.008, 2 * np.pi * 1.25 / length
        robot = spatial(backbone=SOFT | {"rigid": True}, tendon={"friction_coefficient": mu})
        ratio = np.exp(-mu * d * f**2 * length / np.sqrt(1 + d**2 * f**2))
        np.testing.assert_allclose(gtr.equilibrium(robot, 5.0).T_tip, 5.0 * ratio, rtol=1e-6)

    def test_friction_in_a_soft_helix_converges_with_order_of_two_at_least(self, spatial):
        tips = [float(gtr.equilibrium(spatial(k), 10.0).T_tip) for k in (1, 2, 4)]
        assert np.log2((tips[0] - tips[1]) / (tips[1] - tips[2])) > 3.0


@pytest.mark.parametrize("angle", [0.0, 0.9, -2.2])
@pytest.mark.parametrize("load", [None, {"tip_force": [0.05, -0.1, 0.0], "tip_moment": [0.0, 0.0, 0.01]}])
def test_a_turned_planar_robot_is_the_planar_robot_turned(make_robot, spatial, angle, load):
    turn = Rotation.from_rotvec([angle, 0.0, 0.0])
    tendon, history = {"friction_coefficient": 0.3}, np.array([0.0, 6.0, 12.0, 9.0, 3.0, 8.0])
    body = SOFT | {"natural_curvature": 0.0}
    loads, flat_loads = {}, {}
    if load:
        loads = {key: list(turn.apply(vector)) for key, vector in load.items()}
        flat_loads = {"tip_force": load["tip_force"][:2], "tip_moment": load["tip_moment"][2]}
    flat = gtr.simulate(make_robot(routing=SINE, backbone=body, tendon=tendon, loads=flat_loads), history)
    routing = SINE | {"plane_angle": angle}
    run = gtr.simulate(spatial(routing=routing, backbone=body, tendon=tendon, loads=loads), history)
    assert np.all(run.converged) and np.all(flat.converged)
    # Where the tendon's turning changes sign inside an interval, the two differ within the error of the mesh.
    np.testing.assert_allclose(run.T_tip, flat.T_tip, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(run.displacement, flat.displacement, atol=1e-8)
    tip = np.array(flat.tip_position)
    np.testing.assert_allclose(run.tip_position, turn.apply(tip), atol=1e-7)
    along = turn.as_matrix() @ np.asarray(flat.tip_rotation) @ turn.as_matrix().T
    np.testing.assert_allclose(run.tip_rotation, along, atol=2e-6)


def test_three_equal_tendons_do_not_bend(spatial):
    tendons = [
        {
            "name": name,
            "friction_coefficient": 0.3,
            "routing": {"kind": "straight", "radius": 0.008, "angle": k * 2 * np.pi / 3},
        }
        for k, name in enumerate("abc")
    ]
    robot = spatial(tendons=tendons, routing=None, tendon=None)
    run = gtr.simulate(robot, np.array([[1.0, 1.0, 1.0], [4.0, 4.0, 4.0], [2.0, 2.0, 2.0]]))
    np.testing.assert_allclose(run.tip_position, [[0.25, 0.0, 0.0]] * 3, atol=1e-12)
    np.testing.assert_allclose(run.T_tip, run.T_base, rtol=1e-12)


def test_an_elastica_bends_towards_its_force_whatever_the_direction(make_robot, spatial):
    flat = gtr.equilibrium(make_robot(backbone=SOFT, loads={"tip_force": [0.0, 0.2]}), 0.0)
    reach, rise = np.asarray(flat.tip_pose)[:2]
    for angle in (0.0, 0.7, 2.5):
        across = np.array([np.cos(angle), np.sin(angle)])
        eq = gtr.equilibrium(spatial(loads={"tip_force": [0.0, *(0.2 * across)]}), 0.0)
        np.testing.assert_allclose(eq.tip_position, [reach, *(rise * across)], atol=1e-8)


def test_a_mirror_image_mirrors(spatial):
    history = np.array([4.0, 9.0, 5.0])
    loads = {"tip_force": [0.02, 0.05, -0.08]}
    run = gtr.simulate(spatial(loads=loads), history)
    mirrored = HELIX | {"turns": -1.25, "start_angle": -0.5}
    image = gtr.simulate(spatial(routing=mirrored, loads={"tip_force": [0.02, 0.05, 0.08]}), history)
    np.testing.assert_allclose(image.T_tip, run.T_tip, rtol=1e-9)
    over = np.asarray(image.tip_position) * [1.0, 1.0, -1.0]
    np.testing.assert_allclose(over, run.tip_position, atol=1e-9)


def test_the_base_turns_what_is_shown_and_the_loads_against_the_body(spatial):
    """A robot on a turned base under a force is the robot on a straight one under the force turned back."""
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    force, place = np.array([0.03, -0.06, 0.05]), np.array([0.1, -0.2, 0.3])
    base = {"position": list(place), "rotation": [0.3, -0.5, 0.8]}
    shown = gtr.equilibrium(spatial(loads={"tip_force": list(force)}, base=base), 6.0)
    own = gtr.equilibrium(spatial(loads={"tip_force": list(turn.inv().apply(force))}), 6.0)
    np.testing.assert_allclose(shown.T_tip, own.T_tip, rtol=1e-10)
    np.testing.assert_allclose(shown.tip_position, place + turn.apply(np.array(own.tip_position)), atol=1e-10)


class TestDerivatives:
    names = ("mu", "E", "radius", "start_angle")
    steps = (1e-5, 5.0, 1e-7, 1e-5)

    @pytest.mark.parametrize(
        "loads",
        [
            pytest.param({}, id="free"),
            pytest.param({"tip_force": [0.02, 0.05, -0.08]}, id="loaded"),
        ],
    )
    @pytest.mark.slow
    def test_gradients_equal_differences(self, spatial, loads):
        robot = spatial(loads=loads)
        history = jnp.asarray([4.0, 9.0, 6.0])

        def last(values):
            run = gtr.simulate(robot.with_values(**dict(zip(self.names, values, strict=True))), history)
            return jnp.concatenate([run.T_tip[-1:], run.tip_position[-1]])

        at = jnp.stack([robot.value(name) for name in self.names])
        slopes = np.asarray(jax.jacfwd(last)(at))
        np.testing.assert_allclose(jax.jacrev(last)(at), slopes, rtol=1e-8, atol=1e-14)
        for k, step in enumerate(self.steps):
            up, down = (last(at.at[k].add(way * step)) for way in (1, -1))
            rate = (up - down) / (2 * step)
            scale = np.maximum(np.abs(rate), 1e-3 * np.max(np.abs(rate)))
            rounding = 8 * np.spacing(np.abs(up)) / (2 * step)  # what differences of rounded values can tell
            np.testing.assert_array_less(np.abs(slopes[:, k] - rate), 1e-5 * scale + rounding)

    def test_a_batch_equals_a_loop(self, spatial):
        robot = spatial(loads={"tip_force": [0.02, 0.05, -0.08]})
        tensions = jnp.asarray([0.0, 3.0, 9.0])
        batch = jax.vmap(lambda T: gtr.equilibrium(robot, T).tip_position)(tensions)
        for T, tip in zip(tensions, batch, strict=True):
            np.testing.assert_allclose(tip, gtr.equilibrium(robot, T).tip_position, atol=1e-10)


def test_a_step_that_is_too_hard_says_so(spatial):
    robot = spatial(loads={"tip_force": [0.02, 0.05, -0.08]})
    eq = gtr.equilibrium(robot, 5.0, solver=gtr.SolverOptions(atol=1e-30))
    assert not eq.converged and np.isfinite(eq.residual_norm)


def test_no_energy_is_created_over_a_closed_loop(spatial):
    """The work done on the tendon over a loop that closes is what friction takes."""
    T = np.concatenate([np.linspace(2, 10, 17), np.linspace(10, 2, 17)[1:]])
    T = np.concatenate([T, T[1:]])
    run = gtr.simulate(spatial(), T)
    drawn = np.asarray(run.displacement)
    closed = slice(32, None)
    np.testing.assert_allclose(drawn[32], drawn[-1], atol=1e-9)
    work = np.trapezoid(T[closed], drawn[closed])
    assert work > 1e-4


def case_of(name):
    case = json.loads((RUNS / f"{name}.json").read_text())
    with (RUNS / f"{name}.csv").open() as file:
        rows = list(csv.DictReader(file))
    columns = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
    return case, columns


def reference_routing(tendon, length):
    if tendon["kind"] == "helix" and tendon["turns"] == 0:
        return {"kind": "straight", "radius": tendon["radius_base_m"], "angle": tendon["start_angle_rad"]}
    if tendon["kind"] == "helix":
        radii = {"radius": tendon["radius_base_m"], "tip_radius": tendon["radius_tip_m"]}
        return {"kind": "helix", "turns": tendon["turns"], "start_angle": tendon["start_angle_rad"]} | radii
    reach = tendon["amplitude_m"]
    waves = {"kind": "crossing-sine", "R_max": reach, "r_min": reach, "n_sine": 2 * tendon["periods"]}
    return waves | {"plane_angle": tendon["plane_angle_rad"]}


@pytest.mark.parametrize("name", sorted(path.stem for path in RUNS.glob("*.json")))
def test_every_row_of_an_independent_simulator(make_robot, name):
    case, columns = case_of(name)
    length, natural = case["length_m"], case["natural_strain_1_m"]
    body = {
        "length": length,
        "outer_radius": case["radius_m"],
        "youngs_modulus": case["youngs_modulus_Pa"],
        "poissons_ratio": case["poissons_ratio"],
        "density": case["density_kg_m3"],
        "natural_twist": natural[0],
        "natural_curvature_y": natural[1],
        "natural_curvature": natural[2],
    }
    if name == "helix-rod":  # a rod that carries its tendon on disks
        stiffness = case["youngs_modulus_Pa"] * np.pi / 4 * case["radius_m"][0] ** 4
        body |= {"outer_radius": 0.008, "bending_stiffness": stiffness, "youngs_modulus": None}
    loads = {"tip_force": case["tip_force_N"], "gravity": case["gravity_m_s2"]}
    loads = {key: vector for key, vector in loads.items() if any(vector)}
    mu, tendons = case["friction_coefficient"], case["tendons"]
    if len(tendons) == 1:
        strung = {
            "routing": reference_routing(tendons[0], length),
            "tendon": {"friction_coefficient": mu},
        }
        ends = [""]
    else:
        each = [
            {"name": n, "friction_coefficient": mu, "routing": reference_routing(tendon, length)}
            for n, tendon in zip("abc", tendons, strict=False)
        ]
        strung, ends = {"tendons": each, "routing": None, "tendon": None}, [f".{t['name']}" for t in each]
    robot = make_robot(backbone=body, loads=loads, space=True, **strung)
    T_base, T_tip = (
        np.stack([columns[f"{q}{end}"] for end in ends], axis=1) for q in ("T_base_N", "T_tip_N")
    )
    run = gtr.simulate(robot, T_base[:, 0] if len(ends) == 1 else T_base)
    assert np.all(run.converged)
    change = case["change_from_half_mesh"]
    found = np.asarray(run.T_tip).reshape(T_tip.shape)
    np.testing.assert_allclose(found, T_tip, rtol=0, atol=max(2 * change["T_tip_N"], 5e-3))
    tip = np.stack([columns[f"tip_{axis}_m"] for axis in "xyz"], axis=1)
    missed = np.linalg.norm(np.asarray(run.tip_position) - tip, axis=1)
    assert np.max(missed) <= max(2 * change["tip_m"], 50e-6)
    quaternion = np.stack([columns[f"tip_q{axis}"] for axis in "xyzw"], axis=1)
    turned = Rotation.from_quat(quaternion).inv() * Rotation.from_matrix(np.array(run.tip_rotation))
    assert np.max(turned.magnitude()) < 2e-3


def test_the_tip_is_a_position_and_a_rotation_in_the_plane_and_in_space(make_robot):
    for space in (False, True):
        robot = make_robot(space=space)
        eq, run = gtr.equilibrium(robot, 5.0), gtr.simulate(robot, [0.0, 5.0])
        assert isinstance(eq.tip, gtr.Pose) and isinstance(run.tip, gtr.Pose)
        assert eq.tip.position.shape == (3,) and eq.tip.rotation.shape == (3, 3)
        assert run.tip.position.shape == (2, 3) and run.tip.rotation.shape == (2, 3, 3)
        x, y, angle = map(float, eq.tip_pose)
        assert eq.tip.position == pytest.approx([x, y, 0.0])
        assert eq.tip.rotation[:, 0] == pytest.approx([np.cos(angle), np.sin(angle), 0.0])
        assert run.tip.position[1] == pytest.approx(eq.tip.position)
