"""Channels of a robot file that a DXF drawing has: its line becomes the knots of a table or a curve."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import ValidationError

from gtr_jax.errors import InputError, InputWarning
from gtr_jax.units import parse_quantity

from .checks import check_backbone, mm
from .dxf_line import DrawnLine, read_line
from .midline import Midline, midline_at_rest
from .references import referenced
from .sections import BackboneConfig

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

ENDING = ".dxf"
TOLERANCE = 1e-6  # m, to which the spline through the knots follows a drawn curve
SNAPPED = 1e-3  # of the length, by which a line may end before the body does
FLAT = 1e-5  # m, by which the line of a table may leave its plane
LEVELLED = 0.05  # of the length, over which a channel levels off beyond the end of its line
EACH = 100  # places in it
CORNERS = 1e-4  # m, from which on it is said how far the channel leaves a polyline
BETWEEN = 15  # places between two of its corners that are looked at
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

    def read(table: Mapping[str, Any], tendon: Any) -> dict[str, Any]:
        routing = table.get("routing")
        if routing is None or not _drawn(routing):
            return dict(table)
        return {**table, "routing": _with_knots(routing, folder, midline, _end_of(tendon, backbone.length))}

    found = read(data, data.get("tendon"))
    if isinstance(tendons, list):
        found["tendons"] = [read(table, table) if isinstance(table, Mapping) else table for table in tendons]
    return found


def _end_of(tendon: Any, length: float) -> float:
    """Arc length at which a tendon is anchored [m]: the length unless its table gives another that can be."""
    to = tendon.get("to") if isinstance(tendon, Mapping) else None
    if to is None:
        return length
    try:
        end = parse_quantity(to, "m")
    except InputError:
        return length  # what is wrong with it is said where its table is read
    return end if 0 < end <= length else length


def _drawn(routing: Any) -> bool:
    """Whether a channel names a DXF drawing."""
    file = routing.get("file") if isinstance(routing, Mapping) else None
    known = isinstance(routing, Mapping) and routing.get("kind") in ("table", "curve")
    return known and isinstance(file, str) and file.lower().endswith(ENDING) and "knots" not in routing


def _with_knots(routing: Mapping[str, Any], folder: Path, midline: Midline, end: float) -> dict[str, Any]:
    layer, unit = routing.get("layer"), routing.get("unit")
    path = referenced(routing["file"], folder, "routing.file")
    for key, value in (("layer", layer), ("unit", unit)):
        if value is not None and not isinstance(value, str):
            raise InputError(f"routing.{key}: expected a name in quotes, found {value!r}")
    line = read_line(path, layer=layer, unit=unit)
    knots = knots_of(line, midline, str(path), flat=routing["kind"] == "table", end=end)
    kept = {key: value for key, value in routing.items() if key not in SHORT_OF}
    return {**kept, "knots": tuple(map(tuple, knots.tolist()))}


def knots_of(
    line: DrawnLine, midline: Midline, place: str, *, flat: bool, end: float | None = None
) -> np.ndarray:
    """Knots (s, y, z), or (s, R) of a flat line, (K, 3) or (K, 2) [m], of which the spline is the line: the
    corners of a polyline, or so many places of a curve that the spline is `TOLERANCE` from it. Beyond a line
    that ends with its tendon the channel, which holds nothing there, goes on at the offset that it has.

    Args:
        line: in the body at rest, whose base is at the origin, its tangent along x.
        midline: of that body.
        place: file, for errors.
        flat: whether the line is in the plane of x and y.
        end: arc length at which the tendon is anchored [m]; None: the tip.

    Warns:
        InputWarning: the spline leaves the straight pieces of a polyline by more than `CORNERS`.

    Raises:
        InputError: the line turns back, leaves the plane, or does not reach from the base to the end of the
            tendon.
    """
    from scipy.interpolate import CubicSpline

    s, across = _beside(line.points, midline)
    if s[-1] < s[0]:
        s, across = s[::-1], across[::-1]
    back = np.flatnonzero(np.diff(s) <= 0)
    if back.size:
        raise InputError(
            f"{place}: the line turns back at s = {_mm(float(s[back[0]]))}; a channel runs from base to tip"
        )
    length = float(midline.s[-1])
    whole_body = end is None or end == length
    end = length if end is None else end
    if s[0] > SNAPPED * length or s[-1] < end - SNAPPED * length:
        raise InputError(
            f"{place}: the line runs from s = {_mm(s[0])} to {_mm(s[-1])}, the "
            f"{'body' if whole_body else 'tendon'} from 0 mm to {_mm(end)}; draw it with the base at the "
            "origin and the body along +x"
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
    beyond = _beyond(s[-1], length, 1 if line.measured else EACH)
    every = np.array([0.0, *inner, *(beyond if len(beyond) else (length,))])
    values = whole(every)
    if len(beyond):
        values[-len(beyond) :] = _levelled(whole, s[-1], beyond, length)
    if line.measured:
        _warn_of_corners(line.points, across.shape[1], midline, CubicSpline(every, values), end, place)
        return np.column_stack([every, values])
    return _fewest(every, values, place)


def _warn_of_corners(
    points: np.ndarray, axes: int, midline: Midline, channel: CubicSpline, end: float, place: str
) -> None:
    """Warn where the channel (y, z) or (R,) over arc length leaves the straight lines between the corners of
    a polyline, (N, 3) [m], by more than `CORNERS`, up to the end of the tendon [m].
    """
    share = (np.arange(BETWEEN) + 1)[:, None] / (BETWEEN + 1)
    lines = [one + share * (other - one) for one, other in itertools.pairwise(points)]
    s, across = _beside(np.concatenate(lines), midline)
    gap = np.where(s <= end, np.linalg.norm(channel(s) - across[:, :axes], axis=1), 0.0)
    i = int(np.argmax(gap))
    if gap[i] > CORNERS:
        warnings.warn(
            f"{place}: the channel is the smooth curve through the corners of the line, which leaves the "
            f"straight pieces between them by up to {1e3 * gap[i]:.3g} mm, at s = {1e3 * s[i]:.4g} mm; where "
            "the line is meant as it is drawn, round its corners with arcs or draw a spline",
            InputWarning,
            stacklevel=2,
        )


def _mm(length: float) -> str:
    """A length [m] in millimetres, to a micrometre, for a message."""
    return mm(round(length, 6) + 0.0)


def _beyond(last: float, length: float, each: int) -> np.ndarray:
    """Arc lengths from beyond the end of a line to the tip [m], `each` of them in a stretch over which the
    channel levels off; none if the line ends where the body does, to `SNAPPED`.
    """
    if last >= (1 - SNAPPED) * length:
        return np.zeros(0)
    count = max(1, round(each * (length - last) / (LEVELLED * length)))
    return last + (length - last) * np.arange(1, count + 1) / count


def _levelled(whole: CubicSpline, last: float, s: np.ndarray, length: float) -> np.ndarray:
    """Places, (N, axes) [m], at arc lengths (N,) beyond the one at which a line ends [m]: it goes on to
    second order as it ends, and returns to the offset of its end within a few times `LEVELLED`.
    """
    width = LEVELLED * length
    u = (s - last)[:, None]
    end, slope, bend = (np.asarray(whole(last, order)) for order in range(3))
    return end + (slope * u + (0.5 * bend + slope / width) * u**2) * np.exp(-u / width)


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
