"""A robot as DXF, by ezdxf: layers by purpose, units in the header, dimensions, splines to a tolerance."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from ezdxf import filemanagement
from ezdxf.document import Drawing as Document
from ezdxf.math import BSpline

from gtr_jax.config.config import RobotConfig
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.shapes import Rectangle, Tube

from . import lines
from .lines import AXIS, BODY, BORES, CHANNEL, DIMENSIONS, LIMIT, NOTCHES, TOLERANCE, WALLS, layer_of
from .spline import DEGREE, Spline, fitted
from .unit import METRES
from .unloaded import Unloaded, unloaded

VERSION = "R2010"
STRAIGHT = 1e-9  # m, to which a spline must be straight to be written as a line
TEXT = 0.016  # height of dimensions, of the body's length
INSUNITS = {"mm": 4, "cm": 5, "m": 6, "in": 1}  # as $INSUNITS has them
DECIMALS = {"mm": 3, "cm": 4, "m": 6, "in": 5}  # of dimensions: a micrometre, or finer
ROWS = 2.5  # text heights between two rows of dimensions

Place = Sequence[float] | np.ndarray


class Sheet:
    """A DXF document in a unit, into which lines in metres are drawn.

    Args:
        unit: of its lengths, a key of `METRES`.
        size: length of what is drawn [m], by which dimensions are sized.
    """

    def __init__(self, unit: str, size: float) -> None:
        self.document: Document = filemanagement.new(VERSION, setup=True)
        self.document.units = INSUNITS[unit]
        self.document.header["$MEASUREMENT"] = 0 if unit == "in" else 1
        self.model = self.document.modelspace()
        self.scale = 1.0 / METRES[unit]
        self.text = TEXT * size
        style = self.document.dimstyles.duplicate_entry("EZDXF", "GTR")
        high = self.text * self.scale
        for name, value in {
            "dimtxt": high, "dimasz": high, "dimexe": 0.5 * high, "dimexo": 0.5 * high, "dimgap": 0.4 * high,
            "dimdec": DECIMALS[unit], "dimzin": 8, "dimlfac": 1.0, "dimblk": "", "dimtad": 1,
            "dimtsz": 0.0, "dimclrd": 256, "dimclre": 256, "dimclrt": 256,
        }.items():  # fmt: skip
            style.set_dxf_attrib(name, value)

    def layer(self, name: str, colour: int) -> str:
        """The name of a layer, which is made unless it is there."""
        if name not in self.document.layers:
            self.document.layers.add(name, color=colour)
        return name

    def place(self, point: Iterable[float]) -> tuple[float, ...]:
        """A place [m] in the unit of the sheet."""
        return tuple(float(v) * self.scale for v in point)

    def line(self, start: Iterable[float], end: Iterable[float], layer: str, colour: int) -> None:
        """A straight line between two places [m]."""
        attributes = {"layer": self.layer(layer, colour)}
        self.model.add_line(self.place(start), self.place(end), dxfattribs=attributes)

    def spline(self, spline: Spline, layer: str, colour: int) -> None:
        """A spline; a line where it is straight."""
        if spline.straight(STRAIGHT):
            self.line(spline.points[0], spline.points[-1], layer, colour)
            return
        points = [self.place(point) for point in spline.points]
        drawn = self.model.add_spline(dxfattribs={"layer": self.layer(layer, colour), "degree": DEGREE})
        drawn.apply_construction_tool(
            BSpline(points, order=DEGREE + 1, knots=list(spline.knots * self.scale))
        )

    def circle(self, middle: np.ndarray, along: np.ndarray, radius: float, layer: str, colour: int) -> None:
        """A circle about a direction."""
        from ezdxf.math import OCS

        centre = OCS(tuple(along)).from_wcs(self.place(middle))
        attributes = {"layer": self.layer(layer, colour), "extrusion": tuple(map(float, along))}
        self.model.add_circle(centre, radius * self.scale, dxfattribs=attributes)

    def dimension(self, one: Place, other: Place, away: float, text: str = "<>") -> None:
        """The distance of two places in the plane [m], written `away` [m] to the left of the way between."""
        if np.allclose(one[:2], other[:2], atol=1e-12):
            return
        along, up = other[0] - one[0], other[1] - one[1]
        if along < -1e-9 or (abs(along) <= 1e-9 and up < 0):  # so that the text is read from below or right
            one, other, away = other, one, -away
        self.model.add_aligned_dim(
            p1=self.place(one)[:2],
            p2=self.place(other)[:2],
            distance=away * self.scale,
            text=text,
            dimstyle="GTR",
            dxfattribs={"layer": self.layer(DIMENSIONS, lines.COLOURS[DIMENSIONS])},
        ).render()

    def written(self) -> str:
        """The document as text."""
        out = io.StringIO()
        self.document.write(out)
        return out.getvalue()


def dxf(
    config: RobotConfig,
    *,
    unit: str = "mm",
    tolerance: float = TOLERANCE,
    channel_diameter: float = 0.0,
    wall_clearance: float | None = None,
) -> str:
    """A robot's unloaded body with its channels at 1:1, as DXF: of a robot in the plane the plane of bending,
    of one in space the lines in space. The base is at the origin, its tangent along x.

    Args:
        config: the robot.
        unit: of all lengths in the file, "mm", "cm", "m" or "in"; the header says it.
        tolerance: how far splines may lie from the lines that they stand for [m].
        channel_diameter: [m]; with it the channels' walls are drawn too, in the plane.
        wall_clearance: [m]; with it the line is drawn that channels must not cross, so far within the outer
            surface, in the plane.

    Raises:
        InputError: the channel of a tendon leaves the body.
    """
    robot = build_robot(config)
    body = unloaded(robot)
    sheet = Sheet(unit, body.length)
    if config.in_space:
        _body_in_space(sheet, body, tolerance)
    else:
        _body_in_plane(sheet, body, config, tolerance)
        for _, edge in lines.edges(body, tolerance, wall_clearance) if wall_clearance is not None else ():
            sheet.spline(edge, LIMIT, lines.COLOURS[LIMIT])
    _channels(sheet, body, tolerance, 0.0 if config.in_space else channel_diameter)
    _dimensions(sheet, body, config)
    return sheet.written()


def _channels(sheet: Sheet, body: Unloaded, tolerance: float, diameter: float) -> None:
    colours = itertools.cycle(lines.CHANNEL_COLOURS)
    for (tendon, splines), colour in zip(lines.channels(body, tolerance), colours, strict=False):
        for spline in splines:
            sheet.spline(spline, layer_of(tendon, body.robot.tendons, CHANNEL), colour)
            if diameter > 0:
                for wall in lines.walls(spline, diameter, tolerance, body.kinks(tendon)):
                    sheet.spline(wall, layer_of(tendon, body.robot.tendons, WALLS), lines.COLOURS[WALLS])


def _body_in_plane(sheet: Sheet, body: Unloaded, config: RobotConfig, tolerance: float) -> None:
    """The outline, the section that carries the load, the bores, the notches and the midline."""
    last, outline = {}, lines.outline_layer(body)
    for side, edge in lines.edges(body, tolerance):
        sheet.spline(edge, outline, lines.COLOURS[outline])
        if side in last:  # where the outer radius jumps
            sheet.line(last[side].points[-1], edge.points[0], outline, lines.COLOURS[outline])
        last[side] = edge
    for s in (0.0, body.length):
        sheet.line(*_across(body, s, _radius(body, s)), outline, lines.COLOURS[outline])
    for half, layer in _halves_of_section(body.robot.backbone.shape):
        for side in (1.0, -1.0):
            sheet.spline(lines.along_axis(body, (side * half, 0.0), tolerance), layer, lines.COLOURS[layer])
        for s in (0.0, body.length):
            sheet.line(*_across(body, s, half), layer, lines.COLOURS[layer])
    sheet.spline(_midline(body, tolerance), AXIS, lines.COLOURS[AXIS])
    for bore in config.backbone.bores:
        half = 0.5 * bore.diameter
        for side in (1.0, -1.0):
            line = body.beside(lambda s, y=side * half: np.tile([y, 0.0], (len(s), 1)))
            wall = fitted(line, bore.from_, bore.to, tolerance=tolerance, kinks=body.kinks_of_body())
            sheet.spline(wall, BORES, lines.COLOURS[BORES])
        for s in (bore.from_, bore.to):
            sheet.line(*_across(body, s, half), BORES, lines.COLOURS[BORES])
    for row in config.backbone.notches:
        side = 1.0 if row.side == "left" else -1.0
        for start, end in row.ends:
            corners = [_beside(body, s, side * (_radius(body, s) - d)) for s, d in (
                (start, 0.0), (start, row.depth), (end, row.depth), (end, 0.0)
            )]  # fmt: skip
            for one, other in itertools.pairwise(corners):
                sheet.line(one, other, NOTCHES, lines.COLOURS[NOTCHES])


def _halves_of_section(shape: Tube | Rectangle | None) -> list[tuple[float, str]]:
    """Half the height in the plane of what carries the load, and of the hole in it [m], each with its
    layer.
    """
    if shape is None:
        return []
    hole = float(shape.inner_diameter) if isinstance(shape, Tube) else 0.0
    return [(float(shape.reach()), BODY), *([(0.5 * hole, BORES)] if hole > 0 else [])]


def _body_in_space(sheet: Sheet, body: Unloaded, tolerance: float) -> None:
    """The midline, the rim of the body where its outer radius jumps and at its ends, and the section that
    carries the load.
    """
    outline = lines.outline_layer(body)
    sheet.spline(_midline(body, tolerance), AXIS, lines.COLOURS[AXIS])
    for start, end in lines.stretches(body):
        radius = lines.radius_between(body, start, end)
        (first, last), frames = body.at(np.array([start, end]))
        for middle, frame, size in zip((first, last), frames, radius(np.array([start, end])), strict=True):
            sheet.circle(middle, frame[:, 0], float(size), outline, lines.COLOURS[outline])
    for _, edge in lines.edges(body, tolerance):
        sheet.spline(edge, outline, lines.COLOURS[outline])
    shape = body.robot.backbone.shape
    if isinstance(shape, Rectangle):
        _strip_in_space(sheet, body, shape, tolerance)
        return
    for half, layer in _halves_of_section(shape):
        for s in (0.0, body.length):
            (middle,), (frame,) = body.at(np.array([s]))
            sheet.circle(middle, frame[:, 0], half, layer, lines.COLOURS[layer])
        for side in (1.0, -1.0):
            sheet.spline(lines.along_axis(body, (side * half, 0.0), tolerance), layer, lines.COLOURS[layer])


def _strip_in_space(sheet: Sheet, body: Unloaded, shape: Rectangle, tolerance: float) -> None:
    """The four edges of a strip, and its outline at both ends."""
    up, across = 0.5 * float(shape.height), 0.5 * float(shape.width)
    corners = [(up, across), (-up, across), (-up, -across), (up, -across)]
    for place in corners:
        sheet.spline(lines.along_axis(body, place, tolerance), BODY, lines.COLOURS[BODY])
    for s in (0.0, body.length):
        (middle,), (frame,) = body.at(np.array([s]))
        ends = [middle + frame[:, 1:] @ np.array(place) for place in corners]
        for one, other in zip(ends, [*ends[1:], ends[0]], strict=True):
            sheet.line(one, other, BODY, lines.COLOURS[BODY])


def _midline(body: Unloaded, tolerance: float) -> Spline:
    return fitted(lambda s: body.at(s)[0], 0.0, body.length, tolerance=tolerance, kinks=body.kinks_of_body())


def _radius(body: Unloaded, s: float) -> float:
    """The outer radius, at a jump that of what comes before [m]."""
    start, end = next(ends for ends in lines.stretches(body) if s <= ends[1])
    return float(lines.radius_between(body, start, end)(np.array([s]))[0])


def _beside(body: Unloaded, s: float, y: float) -> np.ndarray:
    """The place in the section at s, y to the left of the midline [m]."""
    (middle,), (frame,) = body.at(np.array([s]))
    return middle + y * frame[:, 1]


def _across(body: Unloaded, s: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    return _beside(body, s, -half), _beside(body, s, half)


def _dimensions(sheet: Sheet, body: Unloaded, config: RobotConfig) -> None:
    """Length and diameters of the body; in the plane also the section that carries the load, bores, notches
    and the channels at both ends.
    """
    row, length = ROWS * sheet.text, body.length
    low = -max(_radius(body, s) for s in (0.0, length))
    if body.straight:
        sheet.dimension([0.0, low], [length, low], -2.5 * row)
    for s, away in ((0.0, 3 * row), (length, -3 * row)):
        sheet.dimension(*_across(body, s, _radius(body, s)), away, "⌀<>")
    if config.in_space:
        return
    for s, towards in ((0.0, 1.0), (length, -1.0)):
        for tendon in body.robot.tendons:
            place = body.channel(tendon)(np.array([s]))[0]
            if s <= lines.end_of(tendon, length):
                sheet.dimension(_beside(body, s, 0.0), place, towards * row * np.sign(_left(body, s, place)))
    _dimensions_of_section(sheet, body)
    for bore in config.backbone.bores:
        sheet.dimension(*_across(body, 0.7 * bore.from_ + 0.3 * bore.to, 0.5 * bore.diameter), 0.0, "⌀<>")
        if body.straight:
            sheet.dimension([bore.from_, low], [bore.to, low], -row)
    for cut in config.backbone.notches if body.straight else ():
        _dimensions_of_notches(sheet, body, cut, row)


def _left(body: Unloaded, s: float, place: np.ndarray) -> float:
    """How far a place is to the left of the midline [m]."""
    (middle,), (frame,) = body.at(np.array([s]))
    return float((place - middle) @ frame[:, 1])


def _dimensions_of_section(sheet: Sheet, body: Unloaded) -> None:
    """How thick the section is that carries the load, and of a strip how wide across the plane."""
    shape = body.robot.backbone.shape
    for share, (half, _) in zip((0.5, 0.3), _halves_of_section(shape), strict=False):
        wide = f"<>×{sheet.scale * float(shape.width):.6g}" if isinstance(shape, Rectangle) else "⌀<>"
        sheet.dimension(*_across(body, share * body.length, half), 0.0, wide)


def _dimensions_of_notches(sheet: Sheet, body: Unloaded, cut: Any, row: float) -> None:
    """Where a row of notches begins, their height, spacing and depth."""
    side = 1.0 if cut.side == "left" else -1.0
    out = side * _radius(body, cut.from_)
    start, end = cut.ends[0]
    times = f"{cut.count}x " if cut.count > 1 else ""
    sheet.dimension([0.0, out], [start, out], side * 2 * row)
    sheet.dimension([start, out], [end, out], side * row, f"{times}<>")
    if cut.count > 1:
        sheet.dimension([end, out], [cut.ends[1][0], out], side * row)
    sheet.dimension([start, out], [start, out - side * cut.depth], side * row, f"{times}<>")
