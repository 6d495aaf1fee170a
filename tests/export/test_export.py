"""A robot for CAD: splines to a tolerance, drawings as DXF, curves and solids as STEP."""

import io

import numpy as np
import pytest
from command_line import run_gtr
from ezdxf import filemanagement, units
from ezdxf.enums import InsertUnits

from gtr_jax.config.config import load_config
from gtr_jax.errors import InputError
from gtr_jax.export import lines
from gtr_jax.export import step as step_file
from gtr_jax.export.dxf import dxf
from gtr_jax.export.spline import fitted
from gtr_jax.export.step import occ, step
from gtr_jax.export.unit import METRES
from gtr_jax.export.unloaded import unloaded
from tests.conftest import PARALLEL, ROUTINGS, SINE

HELIX = "examples/helix.toml"
BORE = {"bores": [{"from": 0.0, "to": 0.02, "diameter": 0.01}]}


def read(text):
    return filemanagement.read(io.StringIO(text))


def on(document, layer, kind="*"):
    return list(document.modelspace().query(f'{kind}[layer=="{layer}"]'))


def places_of(spline, count=2003):
    """Places along a SPLINE of a drawing, in its unit."""
    curve = spline.construction_tool()
    knots = curve.knots()
    return np.array([list(p) for p in curve.points(np.linspace(knots[0], knots[-1], count))])


@pytest.mark.parametrize("name", ROUTINGS)
def test_a_channel_is_a_spline_of_few_points_within_a_micrometre(name, make_robot):
    body = unloaded(make_robot(routing=ROUTINGS[name]))
    ((tendon, (spline,)),) = lines.channels(body, 1e-6)
    s = np.linspace(0.0, body.length, 9973)
    gap = np.linalg.norm(spline.at(s) - body.channel(tendon)(s), axis=1)
    assert gap.max() < 1e-6 and spline.deviation < 1e-6
    assert len(spline.points) < 80


def test_a_tighter_tolerance_is_kept_and_takes_more_points():
    def line(s):
        return np.stack([s, 0.01 * np.sin(40 * s)], axis=1)

    coarse, fine = (fitted(line, 0.0, 0.25, tolerance=tolerance) for tolerance in (1e-5, 1e-9))
    s = np.linspace(0.0, 0.25, 5003)
    assert np.linalg.norm(fine.at(s) - line(s), axis=1).max() < 1e-9
    assert len(fine.points) > 2 * len(coarse.points)
    with pytest.raises(ValueError, match="no spline follows"):
        fitted(lambda s: np.stack([s, np.floor(8 * s)], axis=1), 0.0, 1.0, tolerance=1e-6)


def test_a_body_that_is_bent_at_rest_is_an_arc(make_robot):
    """Of the radius 1/kappa, the channel of that radius less its offset."""
    body = unloaded(make_robot(routing=PARALLEL, backbone={"natural_curvature": 4.0}))
    assert not body.straight
    s = np.linspace(0.0, 0.25, 701)
    middle, _ = body.at(s)
    arc = np.stack([np.sin(4.0 * s), 1.0 - np.cos(4.0 * s), 0.0 * s], axis=1) / 4.0
    np.testing.assert_allclose(middle, arc, atol=1e-9)
    channel = body.channel(body.robot.tendon)(s)
    np.testing.assert_allclose(np.linalg.norm(channel - [0.0, 0.25, 0.0], axis=1), 0.242, atol=1e-9)


def test_a_drawing_has_units_layers_and_dimensions(make_config):
    config = make_config(routing=SINE, backbone=BORE)
    document = read(dxf(config, channel_diameter=1e-3, wall_clearance=1.5e-3))
    assert document.header["$INSUNITS"] == units.MM and document.header["$MEASUREMENT"] == 1
    assert not document.audit().errors
    drawn = {entity.dxf.layer for entity in document.modelspace()}
    assert drawn == {"AXIS", "BODY", "BORES", "CHANNEL", "CHANNEL_WALLS", "WALL_LIMIT", "DIMENSIONS"}
    measured = sorted(round(d.get_measurement(), 6) for d in on(document, "DIMENSIONS", "DIMENSION"))
    # The channel's offset at base and tip, length and diameter of the bore, both diameters, the length.
    assert measured == [10.0, 10.0, 10.0, 20.0, 26.0, 40.0, 250.0]
    (limit, _) = on(document, "WALL_LIMIT")
    assert [*limit.dxf.start, *limit.dxf.end] == pytest.approx([0, 18.5, 0, 250, 11.5, 0])


def test_the_channel_of_a_drawing_is_that_of_the_robot(make_config):
    config = make_config(routing=SINE)
    (spline,) = on(read(dxf(config, tolerance=1e-6)), "CHANNEL")
    assert spline.dxftype() == "SPLINE" and len(spline.control_points) < 60
    x, y, _ = places_of(spline).T
    s = np.clip((x - 30.0) / 70.0, 0.0, 1.0)
    np.testing.assert_allclose(y, -10.0 * np.cos(np.pi * s), atol=1e-3)


def test_walls_lie_half_a_diameter_from_the_channel(make_config):
    document = read(dxf(make_config(routing=SINE), channel_diameter=2e-3))
    centre = places_of(on(document, "CHANNEL")[0], 20011)
    for wall in on(document, "CHANNEL_WALLS"):
        gaps = [np.linalg.norm(centre - place, axis=1).min() for place in places_of(wall, 300)]
        np.testing.assert_allclose(gaps, 1.0, atol=3e-3)


@pytest.mark.parametrize("unit", METRES)
def test_a_drawing_is_in_the_unit_chosen(unit, make_config):
    document = read(dxf(make_config(routing=PARALLEL), unit=unit))
    factor = units.conversion_factor(InsertUnits(document.units), InsertUnits.Meters)
    (channel,) = on(document, "CHANNEL")
    places = factor * np.array([channel.dxf.start, channel.dxf.end])
    np.testing.assert_allclose(places, [[0.0, 0.008, 0.0], [0.25, 0.008, 0.0]], atol=1e-12)


@pytest.mark.parametrize(("unit", "shown"), [("mm", "25.4"), ("cm", "2.54"), ("m", "0.0254"), ("in", "1")])
def test_dimensions_are_written_to_a_micrometre(unit, shown, make_config):
    def texts(radius):
        body = {"outer_radius": radius}
        document = read(dxf(make_config(routing=PARALLEL, backbone=body), unit=unit))
        blocks = [d.get_geometry_block() for d in on(document, "DIMENSIONS", "DIMENSION")]
        return {text.text for block in blocks for text in block.query("MTEXT")}

    assert f"⌀{shown}" in texts(0.0127)
    (fine,) = {float(text[1:]) for text in texts(0.0127123) if text.startswith("⌀")}
    assert METRES[unit] * fine == pytest.approx(0.0254246, abs=5.1e-7)


def test_names_that_differ_in_case_only_have_layers_of_their_own(make_config):
    """CAD does not tell them apart."""
    offsets = {"a": 8e-3, "A_2": 4e-3, "A": -4e-3, "b": -8e-3}
    tendons = [
        {"name": name, "friction_coefficient": 0.1, "routing": {"kind": "parallel", "offset": offset}}
        for name, offset in offsets.items()
    ]
    document = read(dxf(make_config(tendons=tendons)))
    for layer, offset in (("A", 8.0), ("A_2", 4.0), ("A_3", -4.0), ("B", -8.0)):
        (line,) = on(document, f"CHANNEL_{layer}", "LINE")
        assert line.dxf.start.y == pytest.approx(offset)


def test_several_tendons_have_a_layer_each_and_guided_ones_are_chords(make_config):
    guided = {"guides": [0.05, 0.15], "to": 0.2}
    tendons = [
        {"name": "a", "friction_coefficient": 0.1, "routing": PARALLEL},
        {
            "name": "b",
            "friction_coefficient": 0.1,
            "routing": {"kind": "parallel", "offset": -8e-3},
            **guided,
        },
    ]
    document = read(dxf(make_config(tendons=tendons)))
    assert len(on(document, "CHANNEL_A", "LINE")) == 1
    ends = [line.dxf.end.x for line in on(document, "CHANNEL_B", "LINE")]
    assert ends == pytest.approx([50.0, 150.0, 200.0])


def test_a_robot_in_space_is_drawn_in_space():
    config = load_config(HELIX)
    document = read(dxf(config))
    (spline,) = on(document, "CHANNEL")
    x, y, z = places_of(spline).T
    angle = np.radians(30.0) + np.pi * x / 250.0
    np.testing.assert_allclose([y, z], 8.0 * np.array([np.cos(angle), np.sin(angle)]), atol=1e-3)
    assert {circle.dxf.radius for circle in on(document, "BODY", "CIRCLE")} == {12.0}


def shapes_of(text, path):
    """Edges of the wires outside of solids with their curves, and the volume of all solids [mm^3]."""

    path.write_text(text)
    reader = occ("STEPControl").STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    shape = reader.OneShape()
    found = occ("TopExp").TopExp_Explorer(
        shape, occ("TopAbs").TopAbs_EDGE, occ("TopAbs").TopAbs_FACE
    )  # edges that are not of a face
    curves = []
    while found.More():
        curves.append(occ("BRepAdaptor").BRepAdaptor_Curve(occ("TopoDS").TopoDS.Edge(found.Current())))
        found.Next()
    properties = occ("GProp").GProp_GProps()
    occ("BRepGProp").BRepGProp.VolumeProperties_s(shape, properties)
    return curves, properties.Mass()


def places_on(curve, count=1501):
    ends = curve.FirstParameter(), curve.LastParameter()
    points = [curve.Value(t) for t in np.linspace(*ends, count)]
    return np.array([[p.X(), p.Y(), p.Z()] for p in points])


@pytest.mark.parametrize("unit", ["mm", "in"])
def test_step_reads_back_as_the_channel_to_the_tolerance(unit, tmp_path):
    pytest.importorskip("OCP.STEPCAFControl")
    config = load_config(HELIX)
    text = step(config, unit=unit, tolerance=1e-6)
    assert ("'INCH'" in text) == (unit == "in") and "PRODUCT('CHANNEL'" in text
    curves, volume = shapes_of(text, tmp_path / "robot.step")  # in mm, whatever the file's unit
    assert len(curves) == 2
    _, (x, y, z) = (places_on(curve).T for curve in curves)
    angle = np.radians(30.0) + np.pi * x / 250.0
    np.testing.assert_allclose([y, z], 8.0 * np.array([np.cos(angle), np.sin(angle)]), atol=1e-3)
    assert (x[0], x[-1]) == pytest.approx((0.0, 250.0), abs=1e-6)
    assert volume == pytest.approx(np.pi * (12.0**2 - 3.0**2) * 250.0, rel=1e-6)


def test_notches_are_cut_out_of_drawing_and_solid(tmp_path):
    config = load_config("examples/robots/wrists/wrist150.toml")
    document = read(dxf(config))
    assert len(on(document, "NOTCHES", "LINE")) == 3 * sum(row.count for row in config.backbone.notches)
    assert "5x <>" in {d.dxf.text for d in on(document, "DIMENSIONS", "DIMENSION")}
    pytest.importorskip("OCP.STEPCAFControl")
    _, volume = shapes_of(step(config), tmp_path / "tube.step")
    (row,) = config.backbone.notches
    outer, inner = 1e3 * config.backbone.outer_radius[0], 0.5e3 * config.backbone.bores[0].diameter
    floor = 1e3 * row.depth - outer  # beyond the axis; what is left are segments of two circles
    left, hole = (r**2 * np.arccos(floor / r) - floor * np.sqrt(r**2 - floor**2) for r in (outer, inner))
    length, cut = 1e3 * config.backbone.length, 1e3 * row.count * row.height
    tube = np.pi * (outer**2 - inner**2) * (length - cut)
    assert volume == pytest.approx(tube + (left - hole) * cut, rel=1e-6)


STRIP = {"kind": "rectangle", "height": 0.4e-3, "width": 10e-3}
PIPE = {"kind": "tube", "outer_diameter": 2e-3, "inner_diameter": 1e-3}


@pytest.mark.parametrize("section", [STRIP, PIPE], ids=["strip", "tube"])
def test_the_section_that_carries_the_load_is_drawn(section, make_config):
    """The outline of `outer_radius`, which disks fill, is on a layer of its own."""
    body = {"length": 0.2, "outer_radius": 8e-3, "section": section}
    config = make_config(backbone=body, routing={"kind": "parallel", "offset": 5e-3})
    document = read(dxf(config))
    assert not document.audit().errors
    heights = {
        layer: sorted({round(line.dxf.start.y, 6) for line in on(document, layer, "LINE")})
        for layer in ("BODY", "ENVELOPE", "BORES")
    }
    half = 0.2 if section is STRIP else 1.0
    assert heights == {
        "BODY": [-half, half],
        "ENVELOPE": [-8.0, 8.0],
        "BORES": [] if section is STRIP else [-0.5, 0.5],
    }
    measured = {(d.dxf.text, round(d.get_measurement(), 6)) for d in on(document, "DIMENSIONS", "DIMENSION")}
    assert measured >= ({("<>×10", 0.4)} if section is STRIP else {("⌀<>", 2.0), ("⌀<>", 1.0)})
    space = read(dxf(config.model_copy(update={"space": True})))
    radii = {circle.dxf.radius for circle in on(space, "BODY", "CIRCLE")}
    assert radii == (set() if section is STRIP else {1.0})
    corners = {(round(line.dxf.start.y, 6), round(line.dxf.start.z, 6)) for line in on(space, "BODY", "LINE")}
    assert corners == (
        {(y, z) for y in (0.2, -0.2) for z in (5.0, -5.0)} if section is STRIP else {(1.0, 0.0), (-1.0, 0.0)}
    )


@pytest.mark.parametrize(
    ("section", "area"), [(STRIP, 4.0), (PIPE, 0.75 * np.pi), ({**PIPE, "inner_diameter": 0.0}, np.pi)]
)
def test_the_solid_is_the_section_that_carries_the_load(section, area, make_config, tmp_path):
    pytest.importorskip("OCP.STEPCAFControl")
    body = {"length": 0.2, "outer_radius": 8e-3, "section": section}
    config = make_config(backbone=body, routing={"kind": "parallel", "offset": 5e-3})
    _, volume = shapes_of(step(config), tmp_path / "robot.step")
    assert volume == pytest.approx(area * 200.0, rel=1e-6)


def test_step_without_its_library_is_refused_in_a_line(monkeypatch, capsys, tmp_path):
    import sys

    monkeypatch.setitem(sys.modules, "OCP.STEPCAFControl", None)
    with pytest.raises(InputError, match=r"pip install 'gtr-jax\[cad\]'"):
        step_file.check_installed()
    done = run_gtr(capsys, "export", HELIX, "-o", tmp_path / "x.step")
    assert done.status == 2 and "gtr-jax[cad]" in done.err and not (tmp_path / "x.step").exists()


def test_the_command_writes_once_and_says_what_has_no_effect(capsys, tmp_path):
    path = tmp_path / "robot.dxf"
    assert run_gtr(capsys, "export", HELIX, "-o", path, "--unit", "in", "--tolerance", "10um").status == 0
    assert filemanagement.readfile(path).units == units.IN
    again = run_gtr(capsys, "export", HELIX, "-o", path)
    assert again.status == 2 and "--force" in again.err
    assert run_gtr(capsys, "export", HELIX, "-o", path, "--force").status == 0
    for words, says in (
        (["-o", tmp_path / "x.dxf", "--links", "4"], "has no effect on dxf"),
        (["-o", tmp_path / "x.xml", "--unit", "in"], "has no effect on mjcf"),
        (["-o", tmp_path / "x.foo"], "--to dxf"),
        (["-o", tmp_path / "x.dxf", "--to", "step"], "change one of the two"),
        (["-o", tmp_path / "x.dxf", "--tolerance", "1e-12"], "--tolerance"),
        (["-o", tmp_path / "x.xml", "--links", "1"], "--links"),
        (["-o", tmp_path / "x.xml", "--friction-at", "0"], "--friction-at"),
    ):
        done = run_gtr(capsys, "export", HELIX, *words)
        assert done.status == 2 and says in done.err and done.err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["robot.dxf"]
