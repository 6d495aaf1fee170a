"""Channels of a robot file that a DXF drawing has: its line becomes the knots of a table or a curve."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from gtr_jax.errors import InputError

from .config_checks import check_backbone
from .dxf_line import DrawnLine, read_line
from .midline import Midline, midline_at_rest
from .sections import BackboneConfig

ENDING = ".dxf"
TOLERANCE = 1e-6  # m, to which the spline through the knots follows a drawn curve
SNAPPED = 1e-3  # of the length, by which a line may end before the body does
FLAT = 1e-5  # m, by which the line of a table may leave its plane
MOST_KNOTS = 400
NEWTON = 30  # steps to the foot of a place on the midline
SHORT_OF = ("file", "layer", "unit")  # keys that give way to the knots


def with_drawn_channels(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The contents of a robot file with the knots of every channel that names a DXF drawing put in place.

    Args:
        data: the contents, unchecked.
        folder: of the robot file.

    Raises:
        InputError: naming drawing, layer and place, or what is wrong with the backbone.
    """
    tendons = data.get("tendons")
    tables = [data, *(t for t in tendons if isinstance(t, Mapping))] if isinstance(tendons, list) else [data]
    if not any(_drawn(table.get("routing")) for table in tables):
        return data
    try:
        backbone = BackboneConfig.model_validate(data.get("backbone"), context={"folder": folder})
    except ValidationError:
        return data  # which is then refused for its backbone
    check_backbone(backbone)  # before the line is measured from its midline
    midline = midline_at_rest(backbone)

    def read(table: Mapping[str, Any]) -> dict[str, Any]:
        routing = table.get("routing")
        if routing is None or not _drawn(routing):
            return dict(table)
        return {**table, "routing": _with_knots(routing, folder, midline)}

    found = read(data)
    if isinstance(tendons, list):
        found["tendons"] = [read(table) if isinstance(table, Mapping) else table for table in tendons]
    return found


def _drawn(routing: Any) -> bool:
    """Whether a channel names a DXF drawing."""
    file = routing.get("file") if isinstance(routing, Mapping) else None
    known = isinstance(routing, Mapping) and routing.get("kind") in ("table", "curve")
    return known and isinstance(file, str) and file.lower().endswith(ENDING) and "knots" not in routing


def _with_knots(routing: Mapping[str, Any], folder: Path, midline: Midline) -> dict[str, Any]:
    path, layer, unit = folder / routing["file"], routing.get("layer"), routing.get("unit")
    for key, value in (("layer", layer), ("unit", unit)):
        if value is not None and not isinstance(value, str):
            raise InputError(f"routing.{key}: expected a name in quotes, found {value!r}")
    line = read_line(path, layer=layer, unit=unit)
    knots = knots_of(line, midline, str(path), flat=routing["kind"] == "table")
    kept = {key: value for key, value in routing.items() if key not in SHORT_OF}
    return {**kept, "knots": tuple(map(tuple, knots.tolist()))}


def knots_of(line: DrawnLine, midline: Midline, place: str, *, flat: bool) -> np.ndarray:
    """Knots (s, y, z), or (s, R) of a flat line, (K, 3) or (K, 2) [m], of which the spline is the line: the
    corners of a polyline, or so many places of a curve that the spline is `TOLERANCE` from it.

    Args:
        line: in the body at rest, whose base is at the origin, its tangent along x.
        midline: of that body.
        place: file, for errors.
        flat: whether the line is in the plane of x and y.

    Raises:
        InputError: the line turns back, leaves the plane, or does not reach from the base to the tip.
    """
    from scipy.interpolate import CubicSpline

    s, across = _beside(line.points, midline)
    if s[-1] < s[0]:
        s, across = s[::-1], across[::-1]
    back = np.flatnonzero(np.diff(s) <= 0)
    if back.size:
        raise InputError(
            f"{place}: the line turns back at s = {1e3 * s[back[0]]:.4g} mm; a channel leads on from base to "
            "tip"
        )
    length = float(midline.s[-1])
    if s[0] > SNAPPED * length or s[-1] < (1 - SNAPPED) * length:
        raise InputError(
            f"{place}: the line runs from s = {1e3 * s[0]:.4g} mm to {1e3 * s[-1]:.4g} mm, the body from 0 "
            f"mm to {1e3 * length:.4g} mm; draw it with the base at the origin and the body along +x"
        )
    if flat:
        off = float(np.max(np.abs(across[:, 1])))
        if off > FLAT:
            raise InputError(
                f'{place}: the line leaves the plane of x and y by {1e3 * off:.4g} mm; write kind = "curve"'
            )
        across = across[:, :1]
    whole = CubicSpline(s, across)
    inner = s[(s > 1e-9 * length) & (s < (1 - 1e-9) * length)]
    every = np.array([0.0, *inner, length])
    if line.measured:
        return np.column_stack([every, whole(every)])
    return _fewest(every, whole(every), place)


def _fewest(s: np.ndarray, values: np.ndarray, place: str) -> np.ndarray:
    """Some of many places, so that the spline through these is `TOLERANCE` from all."""
    from scipy.interpolate import CubicSpline

    last = len(s) - 1
    chosen = sorted({0, last // 4, last // 2, 3 * last // 4, last})
    while True:
        gap = np.linalg.norm(CubicSpline(s[chosen], values[chosen])(s) - values, axis=1)
        far = [
            (a + b) // 2
            for a, b in itertools.pairwise(chosen)
            if b - a > 1 and gap[a : b + 1].max() > TOLERANCE
        ]
        if not far:
            return np.column_stack([s[chosen], values[chosen]])
        chosen = sorted({*chosen, *far})
        if len(chosen) > MOST_KNOTS:
            at = 1e3 * s[int(np.argmax(gap))]
            raise InputError(
                f"{place}: no spline of {MOST_KNOTS} knots follows the line at s = {at:.4g} mm; round its "
                "corners"
            )


def _beside(points: np.ndarray, midline: Midline) -> tuple[np.ndarray, np.ndarray]:
    """Arc length of the section that each place is in [m], (N,), and where in it, (y, z) [m], (N, 2)."""
    if midline.straight:
        return points[:, 0], points[:, 1:]
    gaps = np.linalg.norm(points[:, None] - midline.middle[None, ::8], axis=2)
    s = midline.s[::8][np.argmin(gaps, axis=1)]
    for _ in range(NEWTON):
        middle, frames = midline.at(s)
        ahead, left, up = np.einsum("ni,nij->jn", points - middle, frames)
        _, bent_up, bent = midline.strain(s).T
        s = s + ahead / np.maximum(1.0 - bent * left + bent_up * up, 0.1)
    middle, frames = midline.at(s)
    return s, np.einsum("ni,nij->nj", points - middle, frames)[:, 1:]
