"""The lines of a drawing: the layers they are on, and the splines of which they consist."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import jax.numpy as jnp
import numpy as np

from gtr_jax.robot.parts import Tendon

from .spline import Line, Spline, fitted
from .unloaded import Unloaded, end_of, in_blocks, stops_of

TOLERANCE = 1e-6  # m
AXIS, BODY, ENVELOPE, BORES, NOTCHES = "AXIS", "BODY", "ENVELOPE", "BORES", "NOTCHES"
CHANNEL, WALLS, LIMIT, DIMENSIONS = "CHANNEL", "CHANNEL_WALLS", "WALL_LIMIT", "DIMENSIONS"
COLOURS = {AXIS: 8, BODY: 7, ENVELOPE: 8, BORES: 9, NOTCHES: 6, WALLS: 5, LIMIT: 3, DIMENSIONS: 152}
CHANNEL_COLOURS = (1, 5, 3, 30, 4, 6)  # of AutoCAD's index, tendon after tendon


def layer_of(tendon: Tendon, tendons: Sequence[Tendon], layer: str = CHANNEL) -> str:
    """A layer of one of some tendons: of an only one without its name. CAD does not tell capitals from small
    letters, so that names which differ in these only are numbered.
    """
    if not tendon.name:
        return layer
    names = [other.name for other in tendons]
    taken, found = {name.upper() for name in names}, tendon.name.upper()
    alike = [name for name in names if name.upper() == found]
    for _ in range(alike.index(tendon.name)):
        found = next(f for i in itertools.count(2) if (f := f"{tendon.name.upper()}_{i}") not in taken)
        taken.add(found)
    return f"{layer}_{found}"


def stretches(body: Unloaded) -> list[tuple[float, float]]:
    """Arc lengths [m] between which the outer radius does not jump, base to tip."""
    pieces = [piece for piece in body.robot.backbone.pieces if piece.outer_radius is not None]
    ends = [float(end) for piece in pieces for end in (piece.start, piece.end)]
    return list(itertools.pairwise(sorted({0.0, *ends, body.length})))


def radius_between(body: Unloaded, start: float, end: float) -> Callable[[np.ndarray], np.ndarray]:
    """Outer radius [m] over arc length, of the piece between two of them, its ends included."""
    near = 1e-9 * body.length if len(stretches(body)) > 1 else 0.0  # on this side of a jump

    def radius(s: np.ndarray) -> np.ndarray:
        inside = np.clip(s, start + near, end - near)
        return in_blocks(lambda s: body.robot.backbone.radius(jnp.asarray(s)), inside)

    return radius


def channels(body: Unloaded, tolerance: float) -> Iterator[tuple[Tendon, list[Spline]]]:
    """The centre line of every channel, from the base to its tendon's anchor; of a guided tendon one for each
    of the straight lines between its disks.
    """
    for tendon in body.robot.tendons:
        line, stops = body.channel(tendon), stops_of(tendon, body.length)
        if stops is None:
            end, kinks = end_of(tendon, body.length), body.kinks(tendon)
            yield tendon, [fitted(line, 0.0, end, tolerance=tolerance, kinks=kinks)]
            continue
        yield tendon, [_chord(ends, line(np.array(ends)), tolerance) for ends in itertools.pairwise(stops)]


def _chord(ends: tuple[float, float], places: np.ndarray, tolerance: float) -> Spline:
    def line(s: np.ndarray) -> np.ndarray:
        share = (s - ends[0]) / (ends[1] - ends[0])
        return places[0] + share[:, None] * (places[1] - places[0])

    return fitted(line, *ends, tolerance=tolerance)


def walls(spline: Spline, diameter: float, tolerance: float, kinks: list[float]) -> list[Spline]:
    """The two walls of a channel in the plane, half its diameter [m] to the left and right of its centre
    line.
    """

    def beside(side: float) -> Line:
        def line(s: np.ndarray) -> np.ndarray:
            along = spline.at(s, 1)
            along /= np.linalg.norm(along, axis=1, keepdims=True)
            left = np.stack([-along[:, 1], along[:, 0], np.zeros(len(s))], axis=1)
            return spline.at(s) + side * 0.5 * diameter * left

        return line

    inner = [*kinks, *np.unique(spline.knots)[1:-1]]
    return [fitted(beside(side), *spline.ends, tolerance=tolerance, kinks=inner) for side in (1.0, -1.0)]


def outline_layer(body: Unloaded) -> str:
    """The layer of what `outer_radius` says: the body, or what lies around the section that carries the
    load.
    """
    return BODY if body.robot.backbone.shape is None else ENVELOPE


def edges(body: Unloaded, tolerance: float, within: float = 0.0) -> Iterator[tuple[float, Spline]]:
    """The edges of the body in the plane of x and y, as (side, spline), base to tip, left then right; each as
    many splines as the outer radius has pieces.

    Args:
        body: the body.
        tolerance: [m].
        within: distance from the outer surface, inwards [m].
    """
    for side in (1.0, -1.0):
        for start, end in stretches(body):
            radius = radius_between(body, start, end)

            def place(s: np.ndarray, side: float = side, radius: Callable = radius) -> np.ndarray:
                return side * (radius(s) - within)[:, None] * np.array([1.0, 0.0])

            line = body.beside(place)
            yield side, fitted(line, start, end, tolerance=tolerance, kinks=body.kinks_of_body())


def along_axis(body: Unloaded, place: tuple[float, float], tolerance: float) -> Spline:
    """The line from base to tip at one place (y, z) in every section [m]."""
    line = body.beside(lambda s: np.tile(np.asarray(place, float), (len(s), 1)))
    return fitted(line, 0.0, body.length, tolerance=tolerance, kinks=body.kinks_of_body())
