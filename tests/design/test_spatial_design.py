"""Designs in space and of several tendons: poses, limits and obstacles against closed forms, derivatives
against differences, hidden routings and tensions found again, and what `gtr design` writes and refuses.
"""

import csv
import json
import xml.etree.ElementTree as ET

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run_gtr
from scipy.spatial.transform import Rotation

import design
import gtr_jax as gtr
from design import limits, pose
from design.literal_in_space import solve_in_space
from design.model import States
from design.objective import errors_of, evaluate, robot_of, solve_states
from design.obstacles import Obstacles, gaps
from design.optimise import optimise
from design.problem import problem_of
from design.unrolled import channel_csv, svg_unrolled, unroll
from gtr_jax.config.config import load_config, parse_config
from gtr_jax.errors import InputError
from gtr_jax.robot.build import build_robot

HELIX, THREE, PAIR = (f"examples/{name}.toml" for name in ("helix", "three-tendons", "antagonists"))
POSE = {"T_base": "12 N", "tip": ["230 mm", "-60 mm", "10 mm"], "direction": [0.9, -0.3, 0.1]}
TURNS = {"bounds": {"turns": [-1.5, 1.5]}}
WALLS = {"wall_clearance": "1.5 mm", "bore_clearance": "0.5 mm", "channel_diameter": "1 mm"}


def target(**sections):
    return design.parse_target({"schema": 1, **sections}, source="t.toml")


def test_differences_of_poses_are_distances_and_angles():
    """Of rotations by the angle between them, of directions by that between the first columns."""
    one, by = Rotation.from_rotvec([0.3, -0.2, 0.9]), Rotation.from_rotvec([0.0, 0.7, 0.0])
    places = np.array([[0.1, 0.2, 0.3], [0.13, 0.2, 0.34]])
    both = np.stack([one.as_matrix(), (one * by).as_matrix()])
    first, second = np.asarray(pose.in_space(jnp.asarray(places), jnp.asarray(both)))
    gap = second - first
    assert pose.distance(gap) == pytest.approx(0.05)
    assert pose.turn(gap) == pytest.approx(0.7)
    assert pose.turn(gap, direction=True) == pytest.approx(0.7)  # about y, across the midline
    twisted = (one * Rotation.from_rotvec([0.4, 0.0, 0.0])).as_matrix()
    spun = np.asarray(pose.in_space(jnp.asarray(places[0]), jnp.asarray(twisted))) - first
    assert pose.turn(spun) == pytest.approx(0.4)
    assert pose.turn(spun, direction=True) == pytest.approx(0.0, abs=1e-12)
    assert np.allclose(pose.rotation_matrix(second), both[1])


def test_a_helix_s_limits_are_those_of_its_closed_form():
    """Curvature d f^2/(1 + d^2 f^2), slant atan(d f), distance d from the axis, of a straight body."""
    config = load_config(HELIX)
    robot = build_robot(config)
    d, f = 0.008, np.pi / 0.25
    at = limits.stations_of(robot, robot.tendon, 65)
    assert np.allclose(at.away, d)
    assert np.allclose(at.slant, np.arctan(d * f))
    assert np.allclose(limits.channel_curvature(robot, at), d * f**2 / (1 + (d * f) ** 2), rtol=1e-9)


def test_channels_apart_are_measured_between_their_lines():
    """Three straight channels at 120 degrees are sqrt(3) r apart; two helices half a turn apart are nearer
    than in their section, by the closed minimum over the way along and about the axis.
    """
    robot = build_robot(load_config(THREE))
    first, second, _ = limits.all_stations(robot, 65)
    assert np.allclose(limits.channel_gap(first, second), np.sqrt(3) * 0.007)
    data = load_config(THREE).model_dump(mode="json", by_alias=True, exclude_none=True)
    for i, tendon in enumerate(data["tendons"]):
        tendon["routing"] = {"kind": "helix", "radius": 0.007, "turns": 3, "start_angle": np.pi * i / 1.5}
    robot = build_robot(parse_config(data))
    first, second, _ = limits.all_stations(robot, 1025)
    s = np.linspace(-0.1, 0.1, 200001)
    turned = 2 * np.pi / 3 + 2 * np.pi * 3 * s / 0.25
    nearest = np.sqrt(s**2 + (2 * 0.007 * np.sin(turned / 2)) ** 2).min()
    assert float(limits.channel_gap(first, second)[512]) == pytest.approx(nearest, rel=1e-4)


def straight_states(robot, length=0.25, count=13):
    s = jnp.linspace(0.0, length, count)
    nil, one = jnp.zeros((1, count)), jnp.ones(1)
    return States(s, s[None], nil, nil, one, one, jnp.asarray(True))


def test_a_straight_body_s_distance_from_obstacles(make_config):
    """A ball beside the arm, one beyond its tip, and a rod beside it that it runs into."""
    channel = {"kind": "parallel", "offset": 0.005}
    robot = build_robot(make_config(routing=channel, backbone={"outer_radius": [0.01, 0.01]}))
    start = jnp.asarray([[0.1, 0.05], [0.3, 0.0], [0.15, 0.012]])
    end = jnp.asarray([[0.1, 0.05], [0.3, 0.0], [0.2, 0.012]])
    rods = Obstacles(start, end, jnp.asarray([0.02, 0.01, 0.005]))
    found = np.asarray(gaps(robot, straight_states(robot), rods)).min(axis=(1, 2))
    assert found == pytest.approx([0.02, 0.03, -0.003], abs=1e-6)


@pytest.mark.parametrize("released", [None, 12.0], ids=["pulling", "releasing"])
@pytest.mark.parametrize(
    "loaded", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["free", "loaded"]
)
def test_the_integrals_of_the_forces_agree_in_space(released, loaded):
    """They share no code with the simulator; its mesh is four times finer."""
    config = load_config(HELIX)
    if loaded:
        data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
        data["backbone"]["density"] = 1070.0
        data["loads"] = {"gravity": [0.0, -6.0, 7.0], "tip_force": [0.01, -0.02, 0.03], "payload": 0.005}
        data["base"] = {"position": [0.1, 0.0, 0.2], "rotation": [0.2, 0.1, -0.4]}
        config = parse_config(data)
    robot = build_robot(config, resolution=4)
    T = 12.0 if released is None else 10.2
    eq = gtr.equilibrium(robot, T, memory=None if released is None else gtr.equilibrium(robot, released))
    found = solve_in_space(robot, T, released_from=released)
    assert found.settled
    np.testing.assert_allclose(found.place, np.asarray(eq.tip_position), atol=2e-6)
    np.testing.assert_allclose(found.rotation, np.asarray(eq.tip_rotation), atol=2e-5)
    assert found.T_tip == pytest.approx(float(eq.T_tip), rel=1e-5)


def refused(config, **sections):
    with pytest.raises(InputError) as fault:
        problem_of(load_config(config), target(**sections))
    says = str(fault.value)
    assert says.startswith("t.toml: ") and "\n" not in says
    return says


PULL = {"T_base": {"a": "3 N"}, "tip": ["230 mm", "-60 mm", "10 mm"]}


@pytest.mark.parametrize(
    ("config", "sections", "words"),
    [
        (HELIX, {"pose": [{**POSE, "tip": [0.2, 0.1]}]}, ["pose[0].tip", "routing.kind", "x, y and z"]),
        (HELIX, {"pose": [{"T_base": 12.0, "angle": 0.3}]}, ["pose[0].angle", "direction = ["]),
        (HELIX, {"pose": [{**POSE, "direction": [0, 0, 0]}]}, ["pose[0].direction", "no length"]),
        (HELIX, {"pose": [{**POSE, "rotation": [0, 0, 1]}]}, ["pose[0].direction", "remove one of the two"]),
        (HELIX, {"pose": [POSE]}, ["search.bounds.turns", "missing"]),
        (HELIX, {"pose": [{**POSE, "T_base": {"a": 1.0}}]}, ["pose[0].T_base", "one tendon"]),
        (HELIX, {"pose": [{**POSE, "tip": [0.2, 0.2, 0.2]}]}, ["pose[0].tip", "out of reach"]),
        (HELIX, {"pose": [POSE], "search": {"kind": "spline"}}, ["search.kind", '"curve"']),
        (HELIX, {"pose": [POSE], "search": {"free": ["T_base.a"]}}, ["search.free", "write T_base"]),
        (
            HELIX,
            {"pose": [POSE], "search": TURNS, "limits": {"obstacle_clearance": "1 mm"}},
            ["limits.obstacle_clearance", "[[obstacle]]"],
        ),
        (
            HELIX,
            {"pose": [POSE], "search": TURNS, "limits": {"channel_clearance": "1 mm"}},
            ["limits.channel_clearance", "several tendons"],
        ),
        (
            HELIX,
            {"pose": [POSE], "obstacle": [{"at": [0.1, 0.1], "radius": 0.01}]},
            ["obstacle[0].at", "x, y and z"],
        ),
        (THREE, {"pose": [{**PULL, "T_base": 3.0}]}, ["pose[0].T_base", "each", "a ="]),
        (THREE, {"pose": [{**PULL, "T_base": {"d": 1.0}}]}, ["pose[0].T_base.d", "no tendon"]),
        (THREE, {"pose": [{**PULL, "T_base": {"a": 0.0}}]}, ["pose[0].T_base", "pulls nothing"]),
        (THREE, {"pose": [{**PULL, "branch": "releasing"}]}, ["pose[0].branch", "order"]),
        (THREE, {"pose": [PULL], "search": {"kind": "curve"}}, ["search.kind", "one tendon"]),
        (THREE, {"pose": [PULL], "search": {"free": ["T_base.d"]}}, ["search.free", "no tendon"]),
        (
            PAIR,
            {"pose": [{"T_base": {"left": "9 N"}, "tip": [0.1, 0.1, 0.0]}]},
            ["pose[0].tip", "give x and y"],
        ),
        (
            PAIR,
            {"pose": [{"T_base": {"left": "9 N"}, "direction": [1, 0, 0]}]},
            ["pose[0].direction", "angle ="],
        ),
        (PAIR, {"pose": [{"T_base": {"left": "0.5 N"}, "angle": 0.3}]}, ["T_base.left", "preload"]),
    ],
)
def test_targets_that_do_not_fit_the_robot_get_one_line(config, sections, words):
    says = refused(config, **sections)
    for word in words:
        assert word in says


def test_the_numbers_of_a_curve_are_its_knots():
    """Evenly spaced, starting on the channel that they replace, bounded by the body."""
    problem = problem_of(
        load_config(HELIX), target(pose=[POSE], search={"kind": "curve", "knots": 4}, limits=WALLS)
    )
    names = [v.name for v in problem.space.all]
    assert sorted(names) == sorted(f"knot_{axis}_{k}" for axis in "yz" for k in range(4))
    assert all((v.lower, v.upper) == (-0.012, 0.012) for v in problem.space.all)
    angle = np.radians(30.0)
    starts = {v.name: v.start for v in problem.space.all}
    assert (starts["knot_y_0"], starts["knot_z_0"]) == pytest.approx(
        (0.008 * np.cos(angle), 0.008 * np.sin(angle))
    )
    assert starts["knot_z_3"] == pytest.approx(0.008 * np.sin(angle + np.pi))


def test_tensions_of_several_tendons_are_free_one_by_one():
    """Those that are named, at every load; others keep theirs."""
    loads = [{**PULL, "T_base": {"a": "3 N", "b": "1 N"}}, {**PULL, "T_base": {"a": "1 N", "c": "2 N"}}]
    search = {"routing": ["angle.b"], "free": ["T_base.a"], "bounds": {"T_base.a": ["0 N", "5 N"]}}
    space = problem_of(load_config(THREE), target(pose=loads, search=search)).space
    assert [v.name for v in space.all] == ["angle.b", "T_base.1.a", "T_base.2.a"]
    assert space.tensions == ((1.0, 0.0, 2.0), (3.0, 1.0, 0.0))
    values = np.array([0.5, 4.0, 4.5])
    assert space.tensions_at(values).tolist() == [[4.0, 0.0, 2.0], [4.5, 1.0, 0.0]]
    assert space.design(values).numbers()["tendons.b.routing.angle"] == 0.5


@pytest.mark.slow
def test_two_tendons_in_a_plane_find_their_tensions_again():
    """The pull and the hold that lead to a tip's place, from that place."""
    config = load_config(PAIR)
    eq = gtr.equilibrium(build_robot(config), [9.0, 2.5])
    x, y, angle = map(float, eq.tip_pose)
    wanted = target(
        pose=[{"T_base": {"left": "5 N", "right": "1 N"}, "tip": [x, y], "angle": angle}],
        search={"routing": [], "free": ["T_base"], "bounds": {"T_base": ["1 N", "15 N"]}, "starts": 4},
    )
    answer = optimise(config, wanted)
    assert answer.verdict == "reached"
    assert answer.best.values["T_base.left"] == pytest.approx(9.0, rel=2e-3)
    assert answer.best.values["T_base.right"] == pytest.approx(2.5, rel=2e-2)
    says = answer.to_json()
    assert says["targets"][0]["T_base_N"].keys() == {"left", "right"}
    assert says["states"][0]["displacement_m"]["left"] > 0 > says["states"][0]["displacement_m"]["right"]
    assert says["verification"]["literal_integrals"]["tip_moves_m"] is None


def differences(values, z, i, h=1e-5):
    near, far = ((values(z.at[i].add(k * h)) - values(z.at[i].add(-k * h))) / (2 * k * h) for k in (1, 2))
    return np.asarray(4 * near - far) / 3


CASES = {
    "helix": (
        HELIX,
        {
            "pose": [{**POSE, "rotation": [0.1, 0.2, -0.5]} | {"direction": None}],
            "obstacle": [{"at": [0.15, 0.03, 0.04], "radius": 0.01}],
            "search": {**TURNS, "free": ["T_base", "E"]}
            | {"bounds": {"turns": [0.1, 1.5], "T_base": [5.0, 15.0], "E": [1e6, 2e6]}},
            "limits": {**WALLS, "min_channel_radius": 0.012, "max_tension_loss": 0.6},
        },
    ),
    "three tendons": (
        THREE,
        {
            "pose": [{**PULL, "T_base": {"a": 3.0, "b": 1.0, "c": 0.5}, "direction": [0.9, 0.1, 0.2]}],
            "search": {
                "routing": ["radius.a", "angle.b"],
                "free": ["T_base"],
                "bounds": {"T_base": [0.2, 5.0], "radius.a": [0.005, 0.009], "angle.b": [1.5, 2.5]},
            },
            "limits": {"channel_diameter": 0.001, "channel_clearance": 0.001},
        },
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", ["helix", "three tendons"])
def test_derivatives_of_residuals_and_margins_in_space(case):
    """Every coordinate, tensions and modulus included, against central differences."""
    config, sections = CASES[case]
    sections = json.loads(json.dumps(sections))
    sections["pose"] = [{k: v for k, v in p.items() if v is not None} for p in sections["pose"]]
    problem = problem_of(load_config(config), target(**sections))
    objective = problem.objective
    assert {limits.OBSTACLE if case == "helix" else limits.APART} <= set(objective.given)
    z = jnp.asarray(np.random.default_rng(5).uniform(0.4, 0.6, objective.lower.shape[0]))

    @jax.jit
    def values(z):
        e = evaluate(objective, z)
        return jnp.concatenate([e.residuals, e.margins, e.T_tip.ravel()])

    found = np.asarray(jax.jit(jax.jacfwd(values))(z))
    for i in range(len(z)):
        difference = differences(values, z, i)
        scale = np.max(np.abs(difference))
        np.testing.assert_allclose(found[:, i], difference, rtol=2e-5, atol=2e-6 * scale)


@pytest.mark.slow
def test_a_plane_robot_s_residuals_are_the_same_in_space(make_config):
    """The same robot computed in space, its pose asked for as a rotation about z."""
    config = make_config(routing={"kind": "parallel", "offset": 0.008})
    flat = problem_of(config, target(pose=[{"T_base": 20.0, "tip": [0.2, 0.1], "angle": 0.5}]))
    spatial = parse_config(
        {**config.model_dump(mode="json", by_alias=True, exclude_none=True), "space": True}
    )
    asked = {"T_base": 20.0, "tip": [0.2, 0.1, 0.0], "rotation": [0.0, 0.0, 0.5]}
    deep = problem_of(spatial, target(pose=[asked], search={"routing": ["offset"]}))
    z = jnp.asarray([0.7])

    def errors(problem):
        robot = robot_of(problem.objective, z)
        states = jax.jit(lambda robot: solve_states(problem.objective, robot, problem.objective.tensions))(
            robot
        )
        return np.asarray(errors_of(problem.objective.wanted, states)), np.asarray(states.pose)[0]

    (plane, at), (space, there) = errors(flat), errors(deep)
    assert space[:2] == pytest.approx(plane[:2], rel=1e-6)
    turned = pose.turn(there - np.asarray(deep.objective.wanted.pose[0]))
    assert turned == pytest.approx(abs(at[2] - 0.5), rel=1e-6)


def test_a_channel_is_drawn_unrolled_and_as_a_curve(tmp_path):
    """The table reads back as a routing; the angle of a helix is a line over s; drawings are in mm."""
    config = load_config(HELIX)
    (channel,) = unroll(config)
    assert channel.angle == pytest.approx(np.radians(30.0) + np.pi * channel.s / 250.0)
    (tmp_path / "channel.csv").write_text(channel_csv(channel))
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["routing"] = {"kind": "curve", "file": "channel.csv"}
    again = build_robot(parse_config(data, folder=tmp_path))
    (same,) = unroll(parse_config(data, folder=tmp_path))
    assert same.away == pytest.approx(channel.away, abs=1e-4)
    assert again.space
    drawing = ET.fromstring(svg_unrolled(config, [channel], "helix <1>"))
    assert drawing.attrib["width"] == "260.000mm"
    path = next(p for p in drawing.iter() if p.attrib.get("class") == "CHANNEL").attrib["d"]
    x, y = map(float, path.rpartition("L")[2].split(","))
    assert (x, y) == pytest.approx((250.0, -12 * np.radians(210.0)), abs=1e-3)


@pytest.mark.slow
def test_command_finds_the_helix_of_the_example_again(tmp_path, capsys):
    """The target was made by a helix of 7.2 mm and 0.75 turns from 1.9 rad, rounded to 0.1 mm."""
    out = tmp_path / "out"
    done = run_gtr(capsys, "design", HELIX, "examples/helix-target.toml", "-o", out)
    assert done.status == 0, done.err
    names = {p.name for p in out.iterdir()}
    assert names >= {
        "designed.toml", "design.json", "channel.csv", "channels.dxf", "unrolled.svg", "report.html",
        "target.png", "tip.png", "channel.png", "tension.png",
    }  # fmt: skip
    found = gtr.load_robot(out / "designed.toml")
    values = [float(found.value(name)) for name in ("radius", "turns", "start_angle")]
    assert values == pytest.approx([0.0072, 0.75, 1.9], rel=2e-3)
    says = json.loads((out / "design.json").read_text())
    assert says["verdict"] == "reached" and all(limit["kept"] for limit in says["limits"])
    assert {limit["name"] for limit in says["limits"]} >= {"obstacle_clearance", "wall_clearance"}
    eq = gtr.equilibrium(found, 12.0)
    wanted = says["targets"][0]["wanted"]
    away = np.asarray(eq.tip_position) - [wanted[f"{axis}_m"] for axis in "xyz"]
    assert np.linalg.norm(away) < 0.25e-3
    off = np.asarray(eq.tip_rotation)[:, 0] - np.asarray(wanted["direction"])
    assert np.linalg.norm(off) < 1e-3
    with (out / "channel.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["radius_mm"]) == pytest.approx(1e3 * values[0])
    page = (out / "report.html").read_text()
    assert "<h2>Tendons</h2>" in page and not rows[0].keys() - set(rows[-1])
    assert design.load_target(out / "target.toml") == design.load_target("examples/helix-target.toml")


@pytest.mark.slow
def test_benchmark_finds_hidden_routings_in_space():
    from benchmarks import design_in_space as study

    result = study.study(study.families()[3], 2, 7)
    assert result["both"] == 2
    assert "2 of 2 targets" in study.table([result], study.measure.machine())
