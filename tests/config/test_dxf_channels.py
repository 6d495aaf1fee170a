"""Channels of a robot file that are read from a DXF drawing."""

import itertools
import re

import numpy as np
import pytest
from command_line import run_gtr
from ezdxf import filemanagement, units

from gtr_jax.config.config import config_text, load_config, parse_config
from gtr_jax.errors import InputError, InputWarning
from gtr_jax.export.dxf import dxf
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.clearance import place_in_section
from tests.conftest import PARALLEL, SINE

SMOOTHED = pytest.mark.filterwarnings("ignore::gtr_jax.errors.InputWarning")
S = np.linspace(0.0, 0.25, 1999)


def drawing(path, draw, *, unit=units.MM):
    document = filemanagement.new("R2010")
    document.units = unit
    draw(document.modelspace())
    document.saveas(path)
    return path


def robot_of(make_config, folder, routing, **sections):
    data = make_config(**sections).model_dump(mode="json", by_alias=True, exclude_none=True)
    return parse_config({**data, "routing": routing}, source="robot.toml", folder=folder)


def channel_of(config):
    return place_in_section(build_robot(config).tendon, S, 0.25)


def knots_in(robot):
    """The knots of its channel, of whichever kind."""
    return getattr(robot.routing, "knots")  # noqa: B009


@pytest.mark.parametrize("bent", [0.0, 4.0])
def test_a_drawing_of_gtr_reads_back_as_the_channel(bent, make_config, tmp_path):
    """Also into a body that is bent at rest, in which the line lies otherwise."""
    given = make_config(routing=SINE, backbone={"natural_curvature": bent})
    (tmp_path / "channel.dxf").write_text(dxf(given, unit="in"))
    routing = {"kind": "table", "file": "channel.dxf", "layer": "channel"}
    config = robot_of(make_config, tmp_path, routing, backbone={"natural_curvature": bent})
    np.testing.assert_allclose(channel_of(config), channel_of(given), atol=2.5e-6)
    assert len(knots_in(config)) < 80
    assert "layer" not in config_text(config) and "unit" not in config_text(config)


def test_a_channel_in_space_reads_back_as_a_curve(tmp_path):
    given = load_config("examples/helix.toml")
    (tmp_path / "helix.dxf").write_text(dxf(given))
    data = given.model_dump(mode="json", by_alias=True, exclude_none=True)
    data["routing"] = {"kind": "curve", "file": "helix.dxf", "layer": "CHANNEL"}
    config = parse_config(data, folder=tmp_path)
    np.testing.assert_allclose(channel_of(config), channel_of(given), atol=2e-6)
    flat = {**data, "routing": {**data["routing"], "kind": "table"}}
    with pytest.raises(InputError, match=r'helix\.dxf: the line leaves the plane.*kind = "curve"'):
        parse_config(flat, folder=tmp_path)


def pieces(model):
    """A channel of a line, two arcs that continue it, and a line, in no order and not all forwards: it rises
    by 4 mm on arcs of the radius 50 mm.
    """
    angle = np.degrees(np.arccos(1 - 2 / 50))
    width = 2 * 50 * np.sin(np.radians(angle))
    model.add_arc((100 + width, -46), 50, 90, 90 + angle)  # the second, from right to left
    model.add_line((100, 0), (0, 0))
    model.add_line((100 + width, 4), (250, 4))
    model.add_arc((100, 50), 50, 270, 270 + angle)


def bulged(model):
    """The same as one polyline."""
    angle = np.arccos(1 - 2 / 50)
    width, bulge = 2 * 50 * np.sin(angle), np.tan(angle / 4)
    points = [(0, 0, 0), (100, 0, bulge), (100 + width / 2, 2, -bulge), (100 + width, 4, 0), (250, 4, 0)]
    model.add_lwpolyline(points, format="xyb")


@pytest.mark.parametrize("draw", [pieces, bulged])
def test_lines_and_arcs_are_joined_end_to_end(draw, make_config, tmp_path):
    drawing(tmp_path / "route.dxf", draw)
    config = robot_of(make_config, tmp_path, {"kind": "table", "file": "route.dxf"})
    width = 1e-3 * 2 * 50 * np.sin(np.arccos(1 - 2 / 50))
    x = np.clip(S - 0.1, 0.0, width)
    first = 0.05 - np.sqrt(0.05**2 - np.minimum(x, width / 2) ** 2)
    second = np.sqrt(0.05**2 - np.maximum(width - x, 0.0) ** 2) - 0.046
    wanted = np.where(x < width / 2, first, second)
    np.testing.assert_allclose(channel_of(config)[:, 0], wanted, atol=5e-6)


@SMOOTHED
def test_corners_of_a_polyline_are_measured_points(make_config, tmp_path):
    """As the rows of a table are; in inches here, and in a block that is put in place."""
    s, R = np.linspace(0.0, 0.25, 6), np.array([0.0, 4.0, 6.0, 3.0, -2.0, 1.0]) * 1e-3

    def draw(model):
        block = model.doc.blocks.new("ROUTE")
        block.add_lwpolyline(np.column_stack([s, R])[::-1] / 0.0254 - [1.0, 0.0])
        model.add_blockref("ROUTE", (1.0, 0.0), dxfattribs={"layer": "TENDON"})

    drawing(tmp_path / "route.DXF", draw, unit=units.IN)
    routing = {"kind": "table", "file": "route.DXF", "layer": "tendon"}
    config = robot_of(make_config, tmp_path, routing)
    np.testing.assert_allclose(knots_in(config), np.column_stack([s, R]), atol=1e-12)
    (tmp_path / "robot.toml").write_text(config_text(config))  # which needs the drawing no more
    assert load_config(tmp_path / "robot.toml") == config


def test_a_polyline_that_the_channel_leaves_is_said(make_config, tmp_path, capsys):
    """The parabola through (0, 5), (125, 5) and (250, -5) mm is 1.25 mm from the chords; an arc in the corner
    makes the line what is drawn.
    """
    drawing(tmp_path / "route.dxf", polyline((0, 5), (125, 5), (250, -5)))
    routing = {"kind": "table", "file": "route.dxf"}
    says = (
        r"route\.dxf: the channel is the smooth curve .* by up to 1\.25 mm, at s = (62\.5|187\.5) mm; .*arcs"
    )
    with pytest.warns(InputWarning, match=says):
        robot_of(make_config, tmp_path, routing)
    (tmp_path / "robot.toml").write_text(
        "schema = 1\nbackbone = { length = 0.25, outer_radius = 0.02, youngs_modulus = 1e6 }\n"
        'routing = { kind = "table", file = "route.dxf" }\ntendon = { friction_coefficient = 0.1 }\n'
    )
    done = run_gtr(capsys, "export", tmp_path / "robot.toml", "-o", tmp_path / "robot.dxf")
    assert done.status == 0 and re.fullmatch(rf"warning: .*{says}.*\n", done.err), done
    drawing(tmp_path / "route.dxf", polyline((0, 5), (80, 5), (170, 5.05), (250, 5)))
    robot_of(make_config, tmp_path, routing)  # nearly straight: nothing is said
    drawing(tmp_path / "route.dxf", pieces)
    robot_of(make_config, tmp_path, routing)


@SMOOTHED
def test_a_line_that_is_drawn_twice_is_one(make_config, tmp_path):
    """Whichever way; CAD shows one line where several lie on one another."""

    def draw(model):
        model.add_line((0, 5), (100, 5))
        model.add_line((100, 5), (250, 8))
        model.add_line((100, 5), (0, 5))
        model.add_lwpolyline([(100, 5), (250, 8)])

    drawing(tmp_path / "route.dxf", draw)
    config = robot_of(make_config, tmp_path, {"kind": "table", "file": "route.dxf"})
    np.testing.assert_allclose(knots_in(config), 1e-3 * np.array([(0, 5), (100, 5), (250, 8)]), atol=1e-12)
    drawing(tmp_path / "arcs.dxf", lambda model: [pieces(model), pieces(model)])
    robot_of(make_config, tmp_path, {"kind": "table", "file": "arcs.dxf"})


def test_each_tendon_has_its_layer(make_config, tmp_path):
    given = [
        {"name": name, "friction_coefficient": 0.1, "routing": {"kind": "parallel", "offset": offset}}
        for name, offset in (("up", 8e-3), ("down", -8e-3))
    ]
    whole = make_config(tendons=given)
    (tmp_path / "both.dxf").write_text(dxf(whole))
    data = whole.model_dump(mode="json", by_alias=True, exclude_none=True)
    for tendon in data["tendons"]:
        layer = f"CHANNEL_{tendon['name'].upper()}"
        tendon["routing"] = {"kind": "table", "file": "both.dxf", "layer": layer}
    knots = [knots_in(tendon) for tendon in parse_config(data, folder=tmp_path).tendons]
    assert [{round(1e3 * R, 6) for _, R in own} for own in knots] == [{8.0}, {-8.0}]


def polyline(*points):
    return lambda model: model.add_lwpolyline(points)


def two_layers(model):
    for layer in ("BODY", "CHANNELS"):
        model.add_line((0, 5), (250, 5), dxfattribs={"layer": layer})


def apart(model):
    model.add_line((0, 5), (100, 5))
    model.add_line((101, 5), (250, 5))


def closed(model):
    model.add_lwpolyline([(0, 0), (250, 0), (250, 5)], close=True)


def not_a_number(model):
    model.add_lwpolyline([(0, 0), (125, float("nan")), (250, 5)])


def corner(model):
    model.add_line((0, 0), (125, 0))
    model.add_spline([(125, 0, 0), (125.001, 5, 0), (180, 5, 0), (250, 5, 0)])


@pytest.mark.parametrize(
    ("draw", "more", "says"),
    [
        (two_layers, {}, r'layers BODY, CHANNELS; say which, as layer = "CHANNELS"'),
        (two_layers, {"layer": "AXIS"}, r"no line on a layer 'AXIS'; layers with lines: BODY, CHANNELS"),
        (two_layers, {"layer": 3}, r"layer: expected a name in quotes"),
        (apart, {}, r"layer 0: its lines do not join: .*\(100, 5, 0\) mm .* 1 mm away"),
        (closed, {}, r"layer 0: the line is closed"),
        (not_a_number, {}, r"layer 0: a coordinate of its lines is not a finite number"),
        (polyline((0, 0), (150, 5), (140, 6), (250, 0)), {}, r"turns back at s = 150 mm"),
        (polyline((0, 0), (200, 5)), {}, r"from s = 0 mm to 200 mm, the body from 0 mm to 250 mm; draw it"),
        (polyline((0, 0), (250, 5)), {"unit": "mm"}, r"its header says the unit, mm; remove unit"),
        (lambda model: model.add_text("empty"), {}, r"has no polyline, spline, arc or line"),
    ],
)
def test_what_is_no_channel_is_refused_in_a_line(draw, more, says, make_config, tmp_path):
    path = drawing(tmp_path / "route.dxf", draw)
    with pytest.raises(InputError, match=says) as fault:
        robot_of(make_config, tmp_path, {"kind": "table", "file": "route.dxf", **more})
    assert "\n" not in str(fault.value) and str(fault.value).startswith("robot.toml: ")
    assert str(path) in str(fault.value) or "layer: expected" in str(fault.value)


def test_a_drawing_without_a_unit_needs_one(make_config, tmp_path):
    drawing(tmp_path / "route.dxf", polyline((0, 0), (10, 0.2), (25, 0.5)), unit=0)
    with pytest.raises(InputError, match=r'no unit \(\$INSUNITS\).*unit = "mm"'):
        robot_of(make_config, tmp_path, {"kind": "table", "file": "route.dxf"})
    with pytest.raises(InputError, match=r"route\.dxf: unit: .*'parrot'"):
        robot_of(make_config, tmp_path, {"kind": "table", "file": "route.dxf", "unit": "parrot"})
    config = robot_of(make_config, tmp_path, {"kind": "table", "file": "route.dxf", "unit": "cm"})
    np.testing.assert_allclose(knots_in(config), [[0, 0], [0.1, 0.002], [0.25, 0.005]], atol=1e-12)


def test_files_that_are_no_drawings_and_keys_without_one(make_config, tmp_path):
    (tmp_path / "bad.dxf").write_text("0\nSECTION\n2\nENT")
    (tmp_path / "route.csv").write_text("s_mm,R_mm\n0,5\n250,5\n")
    knots = [[0.0, 0.005], [0.25, 0.005]]
    for routing, says in (
        ({"file": "bad.dxf"}, r"bad\.dxf: not a complete DXF drawing"),
        ({"file": "absent.dxf"}, r"absent\.dxf: no such file"),
        ({"file": "route.csv", "layer": "A"}, r"layer: has no effect without the DXF drawing"),
        ({"knots": knots, "unit": "mm"}, r"unit: has no effect"),
        ({"knots": knots, "file": "route.dxf"}, r"has both 'knots' and 'file'"),
    ):
        with pytest.raises(InputError, match=says):
            robot_of(make_config, tmp_path, {"kind": "table", **routing})
    data = make_config(routing=PARALLEL).model_dump(mode="json", by_alias=True, exclude_none=True)
    broken = {**data["backbone"], "length": "long"}
    with pytest.raises(InputError, match=r"backbone\.length"):
        parse_config({**data, "backbone": broken, "routing": {"kind": "table", "file": "bad.dxf"}})


@pytest.mark.parametrize("name", ["helix", "sine", "measured"])
def test_a_channel_ends_where_its_tendon_does(name, make_config, tmp_path):
    """A drawing of one that is anchored before the tip has no line beyond; the table goes on inside the
    body.
    """
    wound = {"kind": "helix", "radius": 8e-3, "turns": 0.5, "start_angle": 0.3}
    channel = {"helix": wound, "sine": SINE, "measured": PARALLEL}[name]
    backbone = {"outer_radius": 0.02}
    given = make_config(routing=channel, backbone=backbone, tendon={"to": 0.09})
    if name == "measured":
        points = [(0, 8), (30, 8), (60, 8), (90.2, 8)]
        drawing(tmp_path / "route.dxf", polyline(*points))
    else:
        (tmp_path / "route.dxf").write_text(dxf(given))
    data = given.model_dump(mode="json", by_alias=True, exclude_none=True)
    layer = {} if name == "measured" else {"layer": "CHANNEL"}
    data["routing"] = {"kind": "curve" if name == "helix" else "table", "file": "route.dxf", **layer}
    data["tendon"]["to"] = "90 mm"
    config = parse_config(data, folder=tmp_path)
    found = place_in_section(build_robot(config).tendon, S, 0.25)
    there = S <= 0.09
    np.testing.assert_allclose(found[there], channel_of(given)[there], atol=3e-6)
    assert np.max(np.hypot(*found.T)) < 0.0125 and knots_in(config)[-1][0] == 0.25
    assert len(knots_in(config)) < 100
    data["tendon"]["to"] = 0.1
    with pytest.raises(
        InputError, match=r"from s = 0 mm to 90(\.2)? mm, the tendon from 0 mm to 100 mm; draw"
    ):
        parse_config(data, folder=tmp_path)
    several = [
        {"name": name, **data["tendon"], "to": to, "routing": data["routing"]}
        for name, to in (("one", 0.09), ("two", 0.08))
    ]
    data = {key: value for key, value in data.items() if key not in ("tendon", "routing")}
    assert len(parse_config({**data, "tendons": several}, folder=tmp_path).tendons) == 2


@pytest.mark.parametrize(
    ("knots", "says"),
    [
        ([], r"natural_curvature: needs at least two knots"),
        ([[0.0, 1.0], [0.25, 2.0], [0.1, 3.0]], r"natural_curvature\[2\]: .*s must increase"),
        ([[0.0, 1.0], [0.1, 1.0]], r"natural_curvature: knots span 0 mm to 100 mm"),
    ],
)
def test_a_wrong_body_is_refused_before_the_drawing_is_read(knots, says, make_config, tmp_path):
    drawing(tmp_path / "route.dxf", polyline((0, 5), (250, 5)))
    data = make_config().model_dump(mode="json", by_alias=True, exclude_none=True)
    data["routing"] = {"kind": "table", "file": "route.dxf"}
    data["backbone"]["natural_curvature"] = knots
    with pytest.raises(InputError, match=rf"robot\.toml: backbone\.{says}"):
        parse_config(data, source="robot.toml", folder=tmp_path)


@SMOOTHED
def test_pieces_join_in_any_order(tmp_path, make_config):
    ends = [(0, 0), (60, 2), (120, 3), (250, 1)]
    for order in itertools.permutations(range(3)):

        def draw(model, order=order):
            for i in order:
                pair = (ends[i], ends[i + 1]) if i != order[0] else (ends[i + 1], ends[i])
                model.add_line(*pair)

        drawing(tmp_path / "route.dxf", draw)
        config = robot_of(make_config, tmp_path, {"kind": "table", "file": "route.dxf"})
        np.testing.assert_allclose(knots_in(config), 1e-3 * np.array(ends), atol=1e-12)


def test_blocks_in_blocks_that_become_very_many_lines(make_config, tmp_path):
    """Eight blocks, each with twelve of the next: a file of a few kilobytes, 12^8 lines."""
    document = filemanagement.new("R2010")
    document.units = units.MM
    for level in range(8):
        block = document.blocks.new(f"B{level}")
        for i in range(12):
            if level:
                block.add_blockref(f"B{level - 1}", (i, 0))
            else:
                block.add_line((i, 0), (i + 1, 0))
    document.modelspace().add_blockref("B7", (0, 0))
    document.saveas(tmp_path / "blocks.dxf")
    with pytest.raises(InputError, match=r"blocks.dxf: draws more than 20,000 things, its blocks in blocks"):
        robot_of(make_config, tmp_path, {"kind": "table", "file": "blocks.dxf"})
