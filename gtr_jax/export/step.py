"""A robot as STEP, by Open CASCADE: the channels as B-splines in space, the body as a solid where it is made
from straight stock.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gtr_jax.errors import InputError
from gtr_jax.files.config import RobotConfig
from gtr_jax.robot.build import build_robot

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
        import OCP.STEPCAFControl  # noqa: F401
    except ImportError:
        raise InputError(NEEDED) from None


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
        parts.append((layer_of(tendon), [_edge(spline) for spline in splines]))
    named = [(name, _joined(edges)) for name, edges in parts]
    if body.straight:
        named.append((BODY, _solid(body, config)))
    return _written(named, config.name, unit)


def _midline(body: Unloaded, tolerance: float) -> Spline:
    return fitted(
        lambda s: body.at(s)[0], 0.0, body.length, tolerance=tolerance, kinks=body.kinks_of_body()
    )


def _point(place: Sequence[float] | np.ndarray) -> Any:
    from OCP.gp import gp_Pnt

    return gp_Pnt(*(MILLIMETRES * float(v) for v in place))


def _edge(spline: Spline) -> Any:
    """A spline as an edge."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
    from OCP.Geom import Geom_BSplineCurve
    from OCP.collections import Array1_double, Array1_gp_Pnt, Array1_int

    poles = Array1_gp_Pnt(1, len(spline.points))
    for i, place in enumerate(spline.points):
        poles.SetValue(i + 1, _point(place))
    values, counts = np.unique(spline.knots, return_counts=True)
    knots, multiplicities = (
        Array1_double(1, len(values)),
        Array1_int(1, len(values)),
    )
    for i, (value, count) in enumerate(zip(values, counts, strict=True)):
        knots.SetValue(i + 1, MILLIMETRES * float(value))
        multiplicities.SetValue(i + 1, int(count))
    return BRepBuilderAPI_MakeEdge(Geom_BSplineCurve(poles, knots, multiplicities, DEGREE)).Edge()


def _joined(edges: Sequence[Any]) -> Any:
    """Edges that follow one another as a wire."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeWire

    maker = BRepBuilderAPI_MakeWire()
    for edge in edges:
        maker.Add(edge)
    return maker.Wire()


def _solid(body: Unloaded, config: RobotConfig) -> Any:
    """The straight body turned about its axis, less bores and notches."""
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.gp import gp_Ax2, gp_Dir
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder

    profile = [(0.0, 0.0)]
    for start, end in lines.stretches(body):
        radius = lines.radius_between(body, start, end)(np.array([start, end]))
        profile += [(start, float(radius[0])), (end, float(radius[1]))]
    solid = _turned([*profile, (body.length, 0.0)])
    along = gp_Dir(1.0, 0.0, 0.0)
    for bore in config.backbone.bores:
        tool = BRepPrimAPI_MakeCylinder(
            gp_Ax2(_point([bore.from_, 0.0, 0.0]), along),
            MILLIMETRES * 0.5 * bore.diameter,
            MILLIMETRES * (bore.to - bore.from_),
        )
        solid = BRepAlgoAPI_Cut(solid, tool.Shape()).Shape()
    wide = 2.0 * max(config.backbone.outer_radius)
    for row in config.backbone.notches:
        for start, end in row.ends:
            floor = float(lines.radius_between(body, 0.0, body.length)(np.array([start]))[0]) - row.depth
            low, high = (floor, wide) if row.side == "left" else (-wide, -floor)
            box = BRepPrimAPI_MakeBox(_point([start, low, -wide]), _point([end, high, wide]))
            solid = BRepAlgoAPI_Cut(solid, box.Shape()).Shape()
    return solid


def _turned(profile: Sequence[tuple[float, float]]) -> Any:
    """The solid that an outline (x, radius) [m], which begins and ends on the axis, describes about it."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakePolygon
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
    from OCP.gp import gp_Ax1, gp_Dir

    polygon = BRepBuilderAPI_MakePolygon()
    last = None
    for corner in profile:
        if corner != last:  # a piece that begins as the one before it ends
            polygon.Add(_point([*corner, 0.0]))
        last = corner
    polygon.Close()
    axis = gp_Ax1(_point([0.0, 0.0, 0.0]), gp_Dir(1.0, 0.0, 0.0))
    return BRepPrimAPI_MakeRevol(BRepBuilderAPI_MakeFace(polygon.Wire()).Face(), axis).Shape()


def _written(named: Sequence[tuple[str, Any]], title: str, unit: str) -> str:
    """Shapes with their names as the text of a STEP file."""
    from OCP.IFSelect import IFSelect_RetDone
    from OCP.Interface import Interface_Static
    from OCP.Message import Message, Message_Gravity
    from OCP.STEPCAFControl import STEPCAFControl_Writer
    from OCP.STEPControl import STEPControl_AsIs
    from OCP.TCollection import TCollection_ExtendedString
    from OCP.TDataStd import TDataStd_Name
    from OCP.TDocStd import TDocStd_Document
    from OCP.XCAFDoc import XCAFDoc_DocumentTool

    for printer in Message.DefaultMessenger_s().Printers():
        printer.SetTraceLevel(Message_Gravity.Message_Fail)
    document = TDocStd_Document(TCollection_ExtendedString("XmlOcaf"))
    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    for name, shape in named:
        label = shapes.AddShape(shape, False)
        TDataStd_Name.Set_s(label, TCollection_ExtendedString(name))
    writer = STEPCAFControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", UNITS[unit])
    Interface_Static.SetCVal_s("write.step.schema", "AP242DIS")
    Interface_Static.SetCVal_s("write.step.product.name", title)
    writer.Transfer(document, STEPControl_AsIs)
    with tempfile.TemporaryDirectory(prefix="gtr-") as folder:
        path = Path(folder) / "robot.step"
        if writer.Write(os.fspath(path)) != IFSelect_RetDone:
            raise RuntimeError(f"Open CASCADE did not write {path.name}")
        return path.read_text(encoding="utf-8")
