"""A robot as STEP, by Open CASCADE: the channels as B-splines in space, the body as a solid where it is made
from straight stock.
"""

from __future__ import annotations

import importlib
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gtr_jax.config.config import RobotConfig
from gtr_jax.errors import InputError
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.shapes import Rectangle, Tube

from . import lines
from .lines import AXIS, BODY, TOLERANCE, layer_of
from .spline import DEGREE, Spline, fitted
from .unloaded import Unloaded, unloaded

NEEDED = "STEP needs Open CASCADE, which is not installed; pip install 'gtr-jax[cad]', or write DXF"
UNITS = {"mm": "MM", "cm": "CM", "m": "M", "in": "INCH"}  # as Open CASCADE has them
MILLIMETRES = 1e3  # in which its shapes are


def check_installed() -> None:
    """InputError unless Open CASCADE can be imported."""
    try:
        importlib.import_module("OCP.STEPCAFControl")
    except ImportError:
        raise InputError(NEEDED) from None


def occ(module: str) -> Any:
    """A module of Open CASCADE, whose names type checkers do not know."""
    return importlib.import_module(f"OCP.{module}")


def step(config: RobotConfig, *, unit: str = "mm", tolerance: float = TOLERANCE) -> str:
    """A robot's unloaded body with its channels as a STEP file (AP242): each channel a B-spline curve in
    space, the midline another, and the body as a solid unless it is bent at rest. The base is at the origin,
    its tangent along x, its left normal along y.

    Args:
        config: the robot.
        unit: of all lengths in the file, "mm", "cm", "m" or "in".
        tolerance: how far the curves may lie from the channels [m].

    Raises:
        InputError: Open CASCADE is not installed, or the channel of a tendon leaves the body.
    """
    check_installed()
    body = unloaded(build_robot(config))
    parts = [(AXIS, [_edge(_midline(body, tolerance))])]
    for tendon, splines in lines.channels(body, tolerance):
        parts.append((layer_of(tendon, body.robot.tendons), [_edge(spline) for spline in splines]))
    named = [(name, _joined(edges)) for name, edges in parts]
    if body.straight:
        named.append((BODY, _solid(body, config)))
    return _written(named, config.name, unit)


def _midline(body: Unloaded, tolerance: float) -> Spline:
    return fitted(lambda s: body.at(s)[0], 0.0, body.length, tolerance=tolerance, kinks=body.kinks_of_body())


def _point(place: Sequence[float] | np.ndarray) -> Any:
    return occ("gp").gp_Pnt(*(MILLIMETRES * float(v) for v in place))


def _edge(spline: Spline) -> Any:
    """A spline as an edge."""
    poles = occ("collections").Array1_gp_Pnt(1, len(spline.points))
    for i, place in enumerate(spline.points):
        poles.SetValue(i + 1, _point(place))
    values, counts = np.unique(spline.knots, return_counts=True)
    knots, multiplicities = (
        occ("collections").Array1_double(1, len(values)),
        occ("collections").Array1_int(1, len(values)),
    )
    for i, (value, count) in enumerate(zip(values, counts, strict=True)):
        knots.SetValue(i + 1, MILLIMETRES * float(value))
        multiplicities.SetValue(i + 1, int(count))
    return (
        occ("BRepBuilderAPI")
        .BRepBuilderAPI_MakeEdge(occ("Geom").Geom_BSplineCurve(poles, knots, multiplicities, DEGREE))
        .Edge()
    )


def _joined(edges: Sequence[Any]) -> Any:
    """Edges that follow one another as a wire."""
    maker = occ("BRepBuilderAPI").BRepBuilderAPI_MakeWire()
    for edge in edges:
        maker.Add(edge)
    return maker.Wire()


def _solid(body: Unloaded, config: RobotConfig) -> Any:
    """The straight body: the section that carries the load, or what its outer radius describes about the
    axis, less bores and notches.
    """
    shape, length = body.robot.backbone.shape, body.length
    if isinstance(shape, Rectangle):
        up, across = 0.5 * float(shape.height), 0.5 * float(shape.width)
        ends = _point([0.0, -up, -across]), _point([length, up, across])
        return occ("BRepPrimAPI").BRepPrimAPI_MakeBox(*ends).Shape()
    if isinstance(shape, Tube):
        inner, outer = 0.5 * float(shape.inner_diameter), 0.5 * float(shape.outer_diameter)
        return _turned([(0.0, inner), (0.0, outer), (length, outer), (length, inner)])
    profile = [(0.0, 0.0)]
    for start, end in lines.stretches(body):
        radius = lines.radius_between(body, start, end)(np.array([start, end]))
        profile += [(start, float(radius[0])), (end, float(radius[1]))]
    solid = _turned([*profile, (body.length, 0.0)])
    along = occ("gp").gp_Dir(1.0, 0.0, 0.0)
    for bore in config.backbone.bores:
        tool = occ("BRepPrimAPI").BRepPrimAPI_MakeCylinder(
            occ("gp").gp_Ax2(_point([bore.from_, 0.0, 0.0]), along),
            MILLIMETRES * 0.5 * bore.diameter,
            MILLIMETRES * (bore.to - bore.from_),
        )
        solid = occ("BRepAlgoAPI").BRepAlgoAPI_Cut(solid, tool.Shape()).Shape()
    wide = 2.0 * max(config.backbone.outer_radius)
    for row in config.backbone.notches:
        for start, end in row.ends:
            floor = float(lines.radius_between(body, 0.0, body.length)(np.array([start]))[0]) - row.depth
            low, high = (floor, wide) if row.side == "left" else (-wide, -floor)
            box = occ("BRepPrimAPI").BRepPrimAPI_MakeBox(
                _point([start, low, -wide]), _point([end, high, wide])
            )
            solid = occ("BRepAlgoAPI").BRepAlgoAPI_Cut(solid, box.Shape()).Shape()
    return solid


def _turned(profile: Sequence[tuple[float, float]]) -> Any:
    """The solid that an outline (x, radius) [m], closed from its end to its beginning, describes about the
    axis.
    """
    polygon = occ("BRepBuilderAPI").BRepBuilderAPI_MakePolygon()
    last = None
    for corner in profile:
        if corner != last:  # a piece that begins as the one before it ends
            polygon.Add(_point([*corner, 0.0]))
        last = corner
    polygon.Close()
    axis = occ("gp").gp_Ax1(_point([0.0, 0.0, 0.0]), occ("gp").gp_Dir(1.0, 0.0, 0.0))
    return (
        occ("BRepPrimAPI")
        .BRepPrimAPI_MakeRevol(occ("BRepBuilderAPI").BRepBuilderAPI_MakeFace(polygon.Wire()).Face(), axis)
        .Shape()
    )


def _written(named: Sequence[tuple[str, Any]], title: str, unit: str) -> str:
    """Shapes with their names as the text of a STEP file."""

    for printer in occ("Message").Message.DefaultMessenger_s().Printers():
        printer.SetTraceLevel(occ("Message").Message_Gravity.Message_Fail)
    document = occ("TDocStd").TDocStd_Document(occ("TCollection").TCollection_ExtendedString("XmlOcaf"))
    shapes = occ("XCAFDoc").XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    for name, shape in named:
        label = shapes.AddShape(shape, False)
        occ("TDataStd").TDataStd_Name.Set_s(label, occ("TCollection").TCollection_ExtendedString(name))
    writer = occ("STEPCAFControl").STEPCAFControl_Writer()
    occ("Interface").Interface_Static.SetCVal_s("write.step.unit", UNITS[unit])
    occ("Interface").Interface_Static.SetCVal_s("write.step.schema", "AP242DIS")
    occ("Interface").Interface_Static.SetCVal_s("write.step.product.name", title)
    writer.Transfer(document, occ("STEPControl").STEPControl_AsIs)
    with tempfile.TemporaryDirectory(prefix="gtr-") as folder:
        path = Path(folder) / "robot.step"
        if writer.Write(os.fspath(path)) != occ("IFSelect").IFSelect_ReturnStatus.IFSelect_RetDone:
            raise RuntimeError(f"Open CASCADE did not write {path.name}")
        return path.read_text(encoding="utf-8")
