"""TARGET.toml, and what `gtr design` writes and refuses."""

import csv
import importlib.util
import json
import re
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import run_gtr
from ezdxf import filemanagement, units

import design
import gtr_jax as gtr
from design.drawing import draw, route_csv, svg
from design.option import TargetError
from design.problem import problem_of
from design.report.design import _robustness
from design.result import _sentences
from design.robustness import Robustness, Spread
from gtr_jax.errors import InputError
from tests.conftest import CROSS, PARALLEL, SINE, TABLE

ROBOT = "examples/tdcm-1.toml"
POSE = {"T_base": "20 N", "tip": ["200 mm", "50 mm"]}
BENT = {"T_base": "20 N", "angle": "30 deg"}


def refused(data, config):
    with pytest.raises(InputError) as fault:
        problem_of(config, design.parse_target({"schema": 1, **data}, source="t.toml"))
    says = str(fault.value)
    assert says.startswith("t.toml: ") or "t.toml" in says
    assert "\n" not in says
    return says


SLACK = [
    ({"pose": [BENT | {"angle": 30}]}, ["pose[0].angle", "4.77 turns", '"30 deg"']),
    ({"pose": [POSE | {"tip_tolerance": 1e-9}]}, ["pose[0].tip_tolerance", "no less than 0.0025 mm"]),
    ({"pose": [BENT | {"angle_tolerance": 1e-8}]}, ["angle_tolerance", "no less than 1e-05 rad"]),
    ({"pose": [BENT | {"tip_tolerance": 1e-3}]}, ["pose[0].tip_tolerance", "no effect without tip"]),
    ({"pose": [POSE | {"angle_tolerance": 1e-2}]}, ["angle_tolerance", "no effect without angle"]),
    ({"pose": [POSE], "T_base_max": "40 N"}, ["T_base_max", "nothing is released"]),
    (
        {"pose": [POSE], "shape": [{"T_base": "20 N", "points": [["250 mm", "210 mm", "50 mm"]]}]},
        ["shape[0].points[0]", "10 mm from pose[0].tip", "0 mm of arm"],
    ),
    (
        {"shape": [{"T_base": "20 N", "points": [["100 mm", "90 mm", d]]} for d in (0.02, -0.02)]},
        ["shape[1].points[0]", "40 mm from shape[0].points[0]"],
    ),
    ({"pose": [POSE], "search": {"seed": -1}}, ["search.seed", "negative"]),
    ({"pose": [POSE], "search": {"kind": "crossing-sine", "n_sine": [1000]}}, ["search.n_sine", "100"]),
    (
        {"pose": [POSE], "search": {"routing": ["r1"], "free": ["T_base"], "bounds": {"T_base": [0, 9]}}},
        ["T_base", "not a range"],
    ),
    ({"goal": {"kind": "bend", "T_base": 9.0, "direction": 1.0}}, ["goal.direction", "no effect"]),
    ({"goal": {"kind": "bend", "T_base": 9.0}, "search": {"routing": ["T_base"]}}, ["cannot be free"]),
    ({"pose": [POSE], "limits": {"max_tip_slope": 5}}, ["limits.max_tip_slope", '"5 deg"']),
    (
        {"pose": [POSE], "robust": {"friction_coefficient": 10}},
        ["robust.friction_coefficient", "0.1 is 10 %"],
    ),
    (
        {"pose": [POSE], "robust": {"fit": "f.json", "youngs_modulus": 0.1}},
        ["robust.youngs_modulus", "f.json says it"],
    ),
    ({"pose": [POSE], "robust": {"deviations": 3}}, ["robust.deviations", "nothing is uncertain"]),
    (
        {
            "pose": [POSE],
            "search": {"method": "l-bfgs-b"},
            "robust": {"optimise": "worst", "youngs_modulus": 0.1},
        },
        ["search.method", "least squares"],
    ),
]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        *SLACK,
        ({"pose": [{**POSE, "tipp": 1}]}, ["pose[0]", "'tipp'", "did you mean 'tip'"]),
        ({"pose": [{**POSE, "tip": ["200 N", "50 mm"]}]}, ["pose[0].tip", "'N' is not a unit of a length"]),
        ({"pose": [{**POSE, "T_base": "20 mm"}]}, ["pose[0].T_base", "is not a unit of a force"]),
        ({"pose": [{**POSE, "tip": ["200 mm"]}]}, ["pose[0].tip"]),
        ({"pose": [{"T_base": "20 N"}]}, ["pose[0]", "asks for nothing"]),
        ({"pose": [{**POSE, "tip": ["200 mm", "200 mm"]}]}, ["pose[0].tip", "out of reach", "250 mm"]),
        ({"pose": [POSE, {**POSE, "tip": ["190 mm", "50 mm"]}]}, ["pose[1].tip", "one place only"]),
        ({"pose": [{**POSE, "branch": "pushing"}]}, ["pose[0].branch", "'pulling' or 'releasing'"]),
        ({"pose": [{**POSE, "branch": "releasing"}]}, ["T_base_max", "say from where it is released"]),
        ({"pose": [{**POSE, "T_base": "-1 N"}]}, ["T_base", "pulls nothing"]),
        ({}, ["nothing is asked for"]),
        ({"pose": [POSE], "limits": {"max_T_base": "10 N"}}, ["limits.max_T_base", "change one of the two"]),
        ({"pose": [POSE], "limits": {"min_T_tip": "30 N"}}, ["limits.min_T_tip", "cannot reach the tip"]),
        ({"pose": [POSE], "limits": {"wall_clearance": "14 mm"}}, ["wall_clearance", "no channel fits"]),
        ({"pose": [POSE], "limits": {"max_tension_loss": 1.5}}, ["max_tension_loss", "share between"]),
        ({"pose": [POSE], "limits": {"wall_clearence": 0}}, ["did you mean 'wall_clearance'"]),
        ({"pose": [POSE], "search": {"routing": ["r3"]}}, ["'r3' is not a number", "did you mean 'r"]),
        ({"pose": [POSE], "search": {"kind": "splines"}}, ["search.kind", "did you mean 'spline'"]),
        ({"pose": [POSE], "search": {"free": ["E"]}}, ["search.bounds.E", "missing"]),
        ({"pose": [POSE], "search": {"free": ["T_base"]}}, ["search.bounds.T_base", "missing"]),
        ({"pose": [POSE], "search": {"bounds": {"r1": ["5 mm", "-5 mm"]}}}, ["bounds.r1", "not below"]),
        ({"pose": [POSE], "search": {"bounds": {"r1": ["5 N", "9 mm"]}}}, ["bounds.r1", "unit of a length"]),
        ({"pose": [POSE], "search": {"bounds": {"r9": [0, 1]}}}, ["bounds.r9", "did you mean 'r"]),
        ({"pose": [POSE], "search": {"n_sine": [2, 3]}}, ["search.n_sine", "no half waves"]),
        ({"pose": [POSE], "search": {"knots": 6}}, ["search.knots", "spline"]),
        ({"shape": [{"T_base": "20 N", "points": [["50 mm", "80 mm", 0]]}]}, ["points[0]", "50 mm of arm"]),
        ({"shape": [{"T_base": "20 N", "points": [["300 mm", "80 mm", "0 mm"]]}]}, ["outside the arm"]),
        ({"goal": {"kind": "reach"}}, ["goal", "missing key 'T_base'"]),
        ({"goal": {"kind": "tension"}}, ["search.free", "T_base"]),
        ({"pose": [POSE], "robust": {"optimise": "expected"}}, ["robust.optimise", "nothing is uncertain"]),
        ({"pose": [POSE], "robust": {"fit": "nowhere.json"}}, ["robust.fit", "cannot be read"]),
    ],
)  # fmt: skip
def test_bad_targets_get_one_line_with_key_and_remedy(data, words, make_config):
    says = refused(data, make_config(routing=SINE))
    for word in words:
        assert word in says


def test_weights_count_against_the_least_of_them(make_config):
    """So that a target of little weight is not taken for met while it is outside its tolerance."""
    poses = [BENT | {"weight": 0.01}, {**BENT, "T_base": "10 N", "angle": "15 deg", "weight": 0.04}]
    objective = problem_of(
        make_config(routing=SINE), design.parse_target({"schema": 1, "pose": poses})
    ).objective
    np.testing.assert_allclose(objective.wanted.pose_scale[:, 2] * 1e-3, [1.0, 2.0])


def test_a_fit_says_how_well_friction_and_modulus_are_known(tmp_path, make_config):
    """In relative deviations and with its correlation; refused if it did not converge."""
    config = make_config(routing=SINE)
    mu, E = config.tendon.friction_coefficient, config.backbone.youngs_modulus
    fit = {
        "converged": True,
        "parameters": {"mu": {"value": mu, "sd": 0.1 * mu}, "E": {"value": E, "sd": 0.05 * E}},
        "correlation": {"names": ["mu", "E"], "matrix": [[1.0, 0.5], [0.5, 1.0]]},
    }
    target = {"schema": 1, "pose": [POSE], "robust": {"fit": "fit.json"}}

    def known(fit):
        (tmp_path / "fit.json").write_text(json.dumps(fit))
        return problem_of(config, design.parse_target(target, source="t.toml", folder=tmp_path)).uncertainty

    found = known(fit)
    np.testing.assert_allclose(found.sd, [0.1, 0.05])
    assert found.correlation == 0.5
    points, shares = found.gaussian()
    covariance = np.einsum("d,di,dj->ij", shares, points, points)
    np.testing.assert_allclose(covariance, [[0.01, 0.0025], [0.0025, 0.0025]], atol=1e-12)
    with pytest.raises(InputError, match="did not converge"):
        known(fit | {"converged": False})


def test_what_is_within_a_tolerance_of_possible_is_not_refused(make_config):
    """A straight arm measured to a tenth of a millimetre; one whose length may change; a T_base named among
    the numbers of the channel."""
    config = make_config(routing=SINE)
    straight = {"T_base": "20 N", "points": [["62.5 mm", "62.5 mm", "0.1 mm"], ["125 mm", "125 mm", 0.0]]}
    longer = {"routing": ["r1", "length"], "bounds": {"length": ["200 mm", "300 mm"]}}
    tension = {"routing": ["r1", "T_base"], "bounds": {"T_base": ["5 N", "50 N"]}}
    for data in (
        {"shape": [straight]},
        {"pose": [{"T_base": "20 N", "tip": ["260 mm", "50 mm"]}], "search": longer},
        {"pose": [POSE], "search": tension, "limits": {"max_T_base": "15 N"}},
    ):
        assert problem_of(config, design.parse_target({"schema": 1, **data})).space.all


def test_robots_that_cannot_be_designed(make_config):
    from gtr_jax.config.config import load_config, parse_config

    with pytest.raises(InputError, match="give the tension of each"):
        problem_of(
            load_config("examples/antagonists.toml"), design.parse_target({"schema": 1, "pose": [POSE]})
        )
    data = make_config(routing=PARALLEL).model_dump(mode="json", by_alias=True, exclude_none=True)
    data["backbone"]["rigid"] = True
    with pytest.raises(InputError, match="rigid"):
        problem_of(parse_config(data), design.parse_target({"schema": 1, "pose": [POSE]}))


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("parallel", ["offset"]),
        ("straight-sine-straight", ["r1", "r2", "w1", "w2"]),
        ("converging-sine", ["R_max", "r_min", "sigma", "n_sine"]),
        ("crossing-sine", ["R_max", "r_min", "n_sine"]),
        ("spline", [f"knot_{k}" for k in range(6)]),
    ],
)
def test_every_family_can_be_searched(kind, names, make_config):
    search = {"kind": kind} | ({"n_sine": [2, 3]} if "n_sine" in names else {})
    target = design.parse_target({"schema": 1, "pose": [POSE], "search": search})
    space = problem_of(make_config(routing=SINE), target).space
    assert [v.name for v in space.all] == names
    inside = space.design(0.5 * (space.lower + space.upper))
    assert inside.routing.kind == ("table" if kind == "spline" else kind)


def test_spline_starts_as_the_channel_it_replaces(make_config):
    config = make_config(routing=CROSS)
    target = design.parse_target({"schema": 1, "pose": [POSE], "search": {"kind": "spline", "knots": 30}})
    space = problem_of(config, target).space
    s = np.linspace(0.0, 0.25, 101)
    from design.space import channel_of

    np.testing.assert_allclose(channel_of(space.robot, s), channel_of(gtr.build_robot(config), s), atol=5e-5)


def test_route_reads_back_and_drawings_are_at_scale(tmp_path, make_config):
    config = make_config(routing=SINE, backbone={"bores": [{"from": 0.0, "to": 0.02, "diameter": 0.01}]})
    drawn = draw(config, channel_diameter=1e-3)
    (tmp_path / "route.csv").write_text(route_csv(drawn))
    data = config.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["routing"] = {"kind": "table", "file": "route.csv"}
    from gtr_jax.config.config import parse_config

    robot = gtr.build_robot(parse_config(data, folder=tmp_path))
    one, other = (gtr.equilibrium(r, 20.0).tip_pose for r in (robot, gtr.build_robot(config)))
    np.testing.assert_allclose(one, other, atol=3e-4)  # a spline through corners of R''

    root = ET.fromstring(svg(drawn, "a < b"))
    width, height = (float(root.attrib[k].removesuffix("mm")) for k in ("width", "height"))
    assert [width, height] == pytest.approx(list(map(float, root.attrib["viewBox"].split()))[2:])
    assert [width, height] == pytest.approx([260.0, 50.0])


def test_channel_walls_lie_half_a_diameter_from_the_centre_line(make_config):
    drawn = draw(make_config(routing=TABLE), channel_diameter=2e-3)
    for edge in drawn.edges:
        np.testing.assert_allclose(np.linalg.norm(edge - drawn.channel, axis=1), 1.0, rtol=1e-6)


def test_a_drawing_follows_the_natural_curvature(make_config):
    drawn = draw(make_config(routing=PARALLEL, backbone={"natural_curvature": 4.0}))
    centre = np.array([0.0, 250.0])
    np.testing.assert_allclose(np.linalg.norm(drawn.channel - centre, axis=1), 250.0 - 8.0, rtol=1e-6)


TARGET = """
schema = 1
name = "bend"
[[pose]]
T_base = "20 N"
angle = "{angle}"
[search]
routing = ["offset"]
starts = 3
[limits]
wall_clearance = "1 mm"
"""
SMALL = """
schema = 1
name = "small"
[backbone]
length = "250 mm"
outer_radius = "12 mm"
youngs_modulus = "1.06 MPa"
[routing]
kind = "parallel"
offset = "5 mm"
[tendon]
friction_coefficient = 0.3
[uncertainty]
friction_coefficient = 0.1
"""


@pytest.fixture
def files(tmp_path):
    (tmp_path / "robot.toml").write_text(SMALL)
    (tmp_path / "target.toml").write_text(TARGET.format(angle="60 deg"))
    (tmp_path / "far.toml").write_text(TARGET.format(angle="170 deg"))
    return tmp_path


def test_command_writes_a_whole_run_folder(files, capsys):
    out, stepped = files / "out", importlib.util.find_spec("OCP") is not None
    more = ["--unit", "in", *(["--step"] if stepped else [])]
    done = run_gtr(capsys, "design", files / "robot.toml", files / "target.toml", "-o", out, *more)
    assert done.status == 0, done.err
    assert done.out.startswith("reached: bend: with the friction coefficient known to ")
    assert "by the numbers of the file alone reached to " in done.out
    drawing = filemanagement.readfile(out / "channel.dxf")
    assert drawing.units == units.IN
    assert {"BODY", "CHANNEL", "WALL_LIMIT", "DIMENSIONS"} <= {e.dxf.layer for e in drawing.modelspace()}
    assert not stepped or "PRODUCT('CHANNEL'" in (out / "designed.step").read_text()
    names = {p.name for p in out.iterdir()}
    assert names >= {
        "designed.toml", "design.json", "route.csv", "channel.svg", "channel.dxf", "report.html",
        "robot.toml", "target.toml", "run.json", "target.png", "tip.png", "channel.png",
    }  # fmt: skip
    answer = json.loads((out / "design.json").read_text())
    assert answer["verdict"] == "reached"
    assert answer["settings"]["inputs"].keys() == {"robot", "target"}
    # The designed robot, simulated by itself, is where the target wants it: phi = ln(1 + mu R T L/EI)/mu.
    robot = gtr.load_robot(out / "designed.toml")
    assert float(gtr.equilibrium(robot, 20.0).tip_pose[2]) == pytest.approx(np.radians(60.0), abs=1e-3)
    EI = 1.06e6 * np.pi * 0.012**4 / 4
    offset = EI * np.expm1(0.3 * np.radians(60.0)) / (0.3 * 20.0 * 0.25)
    assert float(robot.value("offset")) == pytest.approx(offset, rel=1e-3)
    with (out / "route.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(r["R_mm"]) for r in rows] == pytest.approx([1e3 * float(robot.value("offset"))] * len(rows))
    page = (out / "report.html").read_text()
    for heading in ("Targets", "Limits", "Designs found", "Manufacturing tolerances", "Verification"):
        assert f"<h2>{heading}</h2>" in page
    assert not re.search(r"(src|href)=.http", page)
    assert design.load_target(out / "target.toml") == design.load_target(files / "target.toml")


def test_a_run_folder_holds_the_fit_that_its_target_names(files, capsys):
    """So that it can be designed from again."""
    (files / "rig").mkdir()
    fit = {"converged": True, "parameters": {"mu": {"value": 0.3, "sd": 0.03}}}
    (files / "rig" / "run.json").write_text(json.dumps(fit))
    text = TARGET.format(angle="60 deg") + '[robust]\nfit = "rig/run.json"\n'
    (files / "target.toml").write_text(text)
    out = files / "out"
    done = run_gtr(capsys, "design", files / "robot.toml", files / "target.toml", "-o", out)
    assert done.status == 0, done.err
    again = design.load_target(out / "target.toml")
    found = problem_of(gtr.load_config(out / "robot.toml"), again).uncertainty
    assert found.sd[0] == pytest.approx(0.1)
    assert json.loads((out / "run.json").read_text())["inputs"].keys() == {"robot", "target", "fit"}


def test_command_says_what_it_could_not_reach_and_exits_with_1(files, capsys):
    out = files / "out"
    done = run_gtr(capsys, "design", files / "robot.toml", files / "far.toml", "-o", out)
    assert done.status == 1
    assert done.out.startswith("not-reached: ") and "wall_clearance" in done.out
    answer = json.loads((out / "design.json").read_text())
    assert answer["targets"][0]["within"] is False
    assert answer["binding"][0]["name"] in ("wall_clearance", "offset")


FREED = """
schema = 1
name = "bend"
[[pose]]
T_base = "20 N"
angle = "60 deg"
[[pose]]
T_base = "10 N"
angle = "30 deg"
[search]
routing = ["offset"]
free = ["T_base", "E"]
starts = 3
[search.bounds]
T_base = ["5 N", "40 N"]
E = ["1 MPa", "1.2 MPa"]
[limits]
wall_clearance = "1 mm"
"""


@pytest.mark.slow
def test_command_says_what_was_chosen_besides_the_channel(files, capsys):
    """Base tensions, each with its target, and any other number, in the first sentence, as designed."""
    (files / "target.toml").write_text(FREED)
    out = files / "out"
    done = run_gtr(capsys, "design", files / "robot.toml", files / "target.toml", "-o", out)
    assert done.status == 0, done.err
    tensions = r"with T_base\.1 ([\d.]+) N \(pose\[1\]\), T_base\.2 ([\d.]+) N \(pose\[0\]\)"
    said = re.search(rf"^reached: .* {tensions}, E ([\d.]+) MPa;", done.out)
    assert said is not None, done.out
    answer = json.loads((out / "design.json").read_text())
    found = {p["name"]: p["value"] for p in answer["parameters"]}
    numbers = [found["T_base.1"], found["T_base.2"], 1e-6 * found["E"]]
    assert [float(v) for v in said.groups()] == pytest.approx(numbers, rel=1e-3)
    for T, angle in ((found["T_base.1"], 30.0), (found["T_base.2"], 60.0)):
        pose = gtr.equilibrium(gtr.load_robot(out / "designed.toml"), T).tip_pose
        assert float(pose[2]) == pytest.approx(np.radians(angle), abs=1e-3)
    listed = answer["alternatives"]
    assert all(option["reached"] and option["limits_kept"] for option in listed)
    counted = re.search(r"(\d+) other designs? found", done.out)
    assert len(listed) == 1 + (int(counted[1]) if counted else 0)


@pytest.mark.parametrize(
    ("target", "words"),
    [("nowhere.toml", ["nowhere.toml"]), ("robot.toml", ["robot.toml", "backbone"])],
)
def test_command_refuses_what_is_no_target(target, words, files, capsys):
    done = run_gtr(capsys, "design", files / "robot.toml", files / target, "-o", files / "out")
    assert done.status == 2
    assert done.err.count("\n") == 1
    assert all(word in done.err for word in words)
    assert not (files / "out").exists()


def test_example_targets_are_read():
    for path in Path("examples").glob("*-target.toml"):
        config = gtr.load_config(str(path).replace("-target", ""))
        assert problem_of(config, design.load_target(path)).space.all


def test_the_target_file_of_the_docs_is_one(make_config):
    text = Path("docs/files.md").read_text(encoding="utf-8").partition("## TARGET.toml")[2]
    data = tomllib.loads(re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)[0])
    problem = problem_of(gtr.load_config("examples/tdcm-1.toml"), design.parse_target(data))
    assert [v.name for v in problem.space.all] == ["r1", "r2", "w1", "w2", "E"]
    assert problem.objective.states == ((0, True), (1, False))


@pytest.mark.parametrize(
    ("sd", "headline", "note"),
    [
        (None, "bend: reached to less than 0.00057 deg.", ""),
        (
            (0.0, 0.2),
            "bend: with the modulus known to 20 %, pose[0] is off by 14 deg rms, 29 deg at worst; by the "
            "numbers of the file alone reached to less than 0.00057 deg.",
            "With the modulus known to 20 % (robot.toml [uncertainty]); worst within 2 standard deviations. "
            "Nothing is said of the friction coefficient, taken as exact.",
        ),
        (
            (0.1, 0.2),
            "bend: with the friction coefficient known to 10 % and the modulus known to 20 %, pose[0] ",
            "With the friction coefficient known to 10 % and the modulus known to 20 % (robot.toml "
            "[uncertainty]); worst within 2 standard deviations.",
        ),
    ],
)
def test_the_answer_counts_what_is_uncertain(sd, headline, note):
    """A target that is hit only if an uncertain modulus is as stated is not said to be reached."""
    nan = float("nan")
    error = TargetError("pose[0]", 5.0, "pulling", (nan, nan, 0.3), (0.05, 0.1, 0.3), nan, 1e-9, 1e-4, 1e-3)
    spread = Spread("pose[0]", 5.0, "pulling", 0.02, 0.05, np.deg2rad(14), np.deg2rad(29), np.zeros((8, 2)))
    known = None if sd is None else Robustness(sd, 0.0, "robot.toml [uncertainty]", 2.0, (spread,), True)
    space = SimpleNamespace(free_tensions=[], variables=[], config=SimpleNamespace(tendons=()))
    answer: Any = SimpleNamespace(
        verdict="reached",
        robustness=known,
        best=SimpleNamespace(errors=(error,), margins=(), loss=nan, values={}),
        options=(None,),
        comparison=None,
        problem=SimpleNamespace(
            target=SimpleNamespace(name="bend", goal=None),
            objective=SimpleNamespace(spread="nominal"),
            space=space,
        ),
    )
    assert " ".join(_sentences(answer)).startswith(headline)
    if known is not None:
        answer.problem.space.config = SimpleNamespace(tendon_names=())
        assert _robustness(answer, known).note == note
