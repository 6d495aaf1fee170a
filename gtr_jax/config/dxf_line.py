"""A line out of a DXF drawing, by ezdxf: polylines, splines, arcs and lines of one layer, end to end."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gtr_jax.errors import InputError, listed, reason
from gtr_jax.recordings.formats.text import read_bytes
from gtr_jax.units import to_si

JOINED = 1e-4  # of the extent of a line, within which two pieces of it join
DOUBLE = 1e-9  # of the extent of a line, within which two places of it are one
SAMPLES = 400  # of a curve
DEEPEST = 8  # blocks in blocks
MOST_ENTITIES = 20_000  # of a drawing: eight blocks in blocks of ten would be 10^8


class DrawnLine(NamedTuple):
    """A line of a drawing, one end first.

    Attributes:
        points: places along it [m], (N, 3).
        measured: whether they are the corners of polylines and the ends of lines, else samples of curves.
    """

    points: np.ndarray
    measured: bool


def read_line(path: Path, *, layer: str | None = None, unit: str | None = None) -> DrawnLine:
    """The line on a layer of a DXF drawing.

    Args:
        path: the drawing.
        layer: on which the line is; None: the only one that has lines.
        unit: of lengths, where the header says none ("mm").

    Raises:
        InputError: no DXF, no unit or two, no such layer, no line on it, several that do not join, or a
            coordinate that is not a finite number.
    """
    document = _document(path)
    scale = _metres(path, document, unit)
    entities = list(itertools.islice(_entities(document.modelspace()), MOST_ENTITIES + 1))
    if len(entities) > MOST_ENTITIES:
        raise InputError(
            f"{path}: draws more than {MOST_ENTITIES:,} things, its blocks in blocks counted; keep the "
            "channel alone"
        )
    pieces = [(own, *found) for own, entity in entities if (found := _sampled(entity))]
    layers = list(dict.fromkeys(own for own, *_ in pieces))
    if not layers:
        raise InputError(f"{path}: has no polyline, spline, arc or line in its model space; draw the channel")
    if layer is None:
        if len(layers) > 1:
            likely = next((name for name in layers if "channel" in name.casefold()), layers[0])
            raise InputError(
                f'{path}: has lines on the layers {listed(layers)}; say which, as layer = "{likely}"'
            )
        layer = layers[0]
    own = [piece[1:] for piece in pieces if piece[0].casefold() == layer.casefold()]
    if not own:
        raise InputError(f"{path}: no line on a layer '{layer}'; layers with lines: {listed(layers)}")
    place = f"{path}: layer {layer}"
    if not all(np.all(np.isfinite(points)) for points, _ in own):
        raise InputError(f"{place}: a coordinate of its lines is not a finite number; draw the line again")
    measured = all(straight for _, straight in own)
    points = _chained(
        place, [scale * (points if measured or not straight else _dense(points)) for points, straight in own]
    )
    return DrawnLine(points, measured)


def _document(path: Path) -> Any:
    from ezdxf import filemanagement

    read_bytes(path)  # which says what is wrong with a file that cannot be read
    try:
        return filemanagement.readfile(path)
    except Exception as fault:  # a damaged drawing breaks ezdxf in many ways
        raise InputError(
            f"{path}: not a complete DXF drawing ({reason(fault)}); save it again as DXF"
        ) from None


def _metres(path: Path, document: Any, unit: str | None) -> float:
    """Length of a unit of the drawing [m]."""
    from ezdxf import units
    from ezdxf.enums import InsertUnits

    header = units.decode(document.units) if document.units else None
    if header is None and unit is None:
        raise InputError(
            f'{path}: its header has no unit ($INSUNITS); say it beside the file, as unit = "mm"'
        )
    if header is not None and unit is not None:
        raise InputError(f"{path}: its header says the unit, {header}; remove unit = '{unit}'")
    if unit is not None:
        return to_si(f"1 {unit}", "m", f"{path}: unit")
    return float(units.conversion_factor(document.units, InsertUnits.Meters))


def _entities(container: Any, layer: str | None = None, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """The entities of a drawing with their layers, those of blocks too."""
    for entity in container:
        own = entity.dxf.layer if layer is None or entity.dxf.layer != "0" else layer
        if entity.dxftype() != "INSERT":
            yield own, entity
        elif depth < DEEPEST:
            yield own, entity  # counts, though nothing may be in it
            yield from _entities(entity.virtual_entities(), own, depth + 1)


def _sampled(entity: Any) -> tuple[np.ndarray, bool] | None:
    """Places along an entity in the unit of the drawing, (N, 3), and whether it is straight between them;
    None of one that is not a line.
    """
    kind = entity.dxftype()
    if kind == "LINE":
        return _array([entity.dxf.start, entity.dxf.end]), True
    if kind == "ARC":
        return _array(entity.vertices(entity.angles(SAMPLES))), False
    if kind == "ELLIPSE":
        return _array(entity.vertices(entity.params(SAMPLES))), False
    if kind == "SPLINE":
        return _of_spline(entity), False
    if kind == "LWPOLYLINE" or (kind == "POLYLINE" and (entity.is_2d_polyline or entity.is_3d_polyline)):
        if getattr(entity, "has_arc", False):
            parts = [_sampled(part) for part in entity.virtual_entities()]
            sampled = [_dense(points) if straight else points for points, straight in filter(None, parts)]
            return np.concatenate(_in_turn(sampled)), False
        points = entity.vertices_in_wcs() if kind == "LWPOLYLINE" else entity.points_in_wcs()
        closed = entity.is_closed
        points = list(points)
        return _array([*points, points[0]] if closed else points), True
    return None


def _dense(points: np.ndarray) -> np.ndarray:
    """Samples of straight lines between places."""
    share = np.arange(SAMPLES)[:, None] / SAMPLES
    lines = [one + share * (other - one) for one, other in itertools.pairwise(points)]
    return np.concatenate([*lines, points[-1:]])


def _array(points: Any) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in map(_vector, points)])


def _vector(point: Any) -> Any:
    from ezdxf.math import Vec3

    return Vec3(point)


def _of_spline(entity: Any) -> np.ndarray:
    """Samples of a spline, some in every piece between two of its knots."""
    curve = entity.construction_tool()
    knots = np.unique(np.asarray(curve.knots(), float))
    each = max(8, SAMPLES // len(knots))
    places = knots[:-1, None] + np.arange(each) / each * np.diff(knots)[:, None]
    return _array(curve.points([*places.ravel(), knots[-1]]))


def _in_turn(parts: list[np.ndarray]) -> list[np.ndarray]:
    """Pieces of a polyline, each from where the one before it ends."""
    found = parts[:1]
    if len(parts) > 1:
        first, then = parts[0], parts[1]
        ends = [[np.linalg.norm(a - b) for b in (then[0], then[-1])] for a in (first[0], first[-1])]
        found = [first if min(ends[1]) <= min(ends[0]) else first[::-1]]
    for part in parts[1:]:
        end = found[-1][-1]
        found.append(part if np.linalg.norm(part[0] - end) <= np.linalg.norm(part[-1] - end) else part[::-1])
    return found


def _chained(place: str, pieces: list[np.ndarray]) -> np.ndarray:
    """Pieces joined end to end into one line, without double places."""
    everything = np.concatenate(pieces)
    extent = float(np.linalg.norm(np.ptp(everything, axis=0)))
    near = JOINED * extent
    line, *left = _each_once(pieces, DOUBLE * extent)
    while left:
        best: tuple[float, int, bool, bool] | None = None
        for i, piece in enumerate(left):
            for at_end in (True, False):
                for turned in (False, True):
                    joint = line[-1] if at_end else line[0]
                    facing = piece[-1] if turned == at_end else piece[0]
                    gap = float(np.linalg.norm(facing - joint))
                    if best is None or gap < best[0]:
                        best = (gap, i, at_end, turned)
        assert best is not None
        gap, i, at_end, turned = best
        if gap > near:
            x, y, z = 1e3 * (line[-1] if at_end else line[0])
            raise InputError(
                f"{place}: its lines do not join: from the end at ({x:.4g}, {y:.4g}, {z:.4g}) mm the nearest "
                f"other is {1e3 * gap:.4g} mm away; keep one channel on the layer, without gaps"
            )
        piece = left.pop(i)[::-1] if turned else left.pop(i)
        line = np.concatenate([line, piece] if at_end else [piece, line])
    if len(line) > 2 and np.linalg.norm(line[-1] - line[0]) <= near:
        raise InputError(f"{place}: the line is closed; a channel has two ends")
    apart = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return line[np.append(True, apart > DOUBLE * extent)]


def _each_once(pieces: list[np.ndarray], near: float) -> list[np.ndarray]:
    """Pieces without those that are drawn over one before them, forwards or backwards, to a distance."""
    middles = np.array([piece.mean(axis=0) for piece in pieces])
    found: list[int] = []
    for i, piece in enumerate(pieces):
        close = np.flatnonzero(np.max(np.abs(middles[found] - middles[i]), axis=1) <= near) if found else ()
        others = [pieces[found[k]] for k in close]
        if not any(_same(piece, other, near) or _same(piece, other[::-1], near) for other in others):
            found.append(i)
    return [pieces[i] for i in found]


def _same(one: np.ndarray, other: np.ndarray, near: float) -> bool:
    return one.shape == other.shape and bool(np.max(np.abs(one - other)) <= near)
