"""The body at one step as the page draws it: outline, channels, and what the tendons do along them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax.plots.shape import Curve, along_curve, curve_of
from gtr_jax.plots.straight import notches_of
from gtr_jax.plots.views import AXES, SIDES, Posture, Strung, drawn
from gtr_jax.report.spatial import strung_of
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.forces import ChannelForces, channel_forces
from gtr_jax.simulation.history import Simulation, equilibrium_at
from gtr_jax.simulation.markers import markers_on, shape_in_plane
from gtr_jax.simulation.solution import Equilibrium

from .model import Curves

SECTIONS, CORNERS = 48, 14  # of a body in space: sections drawn, corners of each
EVERY = 4  # points of a picture's curve of which one is drawn, so that a shape follows its slider
MIDLINES = 12  # drawn of steps that are brushed
SLACK = 1e-9  # N, N/m: nothing pulls, nothing presses
# Height of the force drawn at the channel under the largest tension, relative to the length of the body.
COMB = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """A body from one side, in mm.

    Attributes:
        axes: what is across and up, two of "xyz".
        outline: polygons whose union is the body, (corners, 2) each.
        middle: the midline, (M, 2).
        channels: of each tendon, (P, 2).
        tension: of each tendon there [N], (P,).
        teeth: of the contact force of each tendon: where each tooth starts and ends, (P, 2) each; none of a
            tendon in space that guides hold.
        markers: places of the robot's markers, (markers, 2).
        recorded: where the tip and they were recorded, of those that were, (n, 2).
    """

    axes: str
    outline: list[np.ndarray]
    middle: np.ndarray
    channels: list[np.ndarray]
    tension: list[np.ndarray]
    teeth: list[tuple[np.ndarray, np.ndarray]]
    markers: np.ndarray
    recorded: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Along:
    """What one tendon does along its channel at P points: arc length [mm], tension [N], contact force and
    friction [N/m], (P,) each.
    """

    s: np.ndarray
    tension: np.ndarray
    normal: np.ndarray
    friction: np.ndarray


@dataclasses.dataclass(frozen=True, eq=False)
class Drawing:
    """The body at one step: from one side or three, and each tendon along its channel."""

    views: list[View]
    along: list[Along]


@eqx.filter_jit
def _at(robot: Robot, run: Simulation, step: jax.Array):
    eq = equilibrium_at(robot, run, step)
    each = [eq.of_tendon(i) for i in range(len(robot.tendons))] if robot.tendon_names else [eq]
    if eq.shape is None:
        shape = shape_in_plane(robot, eq.curvature[None], eq.angle[None])
    else:
        shape = jax.tree_util.tree_map(lambda values: values[None], eq.shape)
    markers = markers_on(robot, eq.s, shape)[0, :, :3]
    return eq, [channel_forces(own) for own in each], robot.backbone.radius(eq.s), markers


@eqx.filter_jit
def _positions(robot: Robot, run: Simulation, steps: jax.Array) -> jax.Array:
    if run.shape is None:
        return shape_in_plane(robot, run.curvature[steps], run.angle[steps]).position
    return run.shape.position[steps]


def midlines(curves: Curves, steps: Sequence[int]) -> list[list[np.ndarray]]:
    """The midline at up to MIDLINES of some steps, from each side that the body is drawn from [mm], (N, 2)
    each: of more steps those that lie evenly among them, the first and the last included.
    """
    sides = SIDES if curves.robot.space else SIDES[:1]
    if not steps:
        return [[] for _ in sides]
    kept = np.unique(np.linspace(0, len(steps) - 1, MIDLINES).round().astype(int))
    # As many for any choice, so that one program serves it.
    at = np.resize(np.asarray(steps)[kept], MIDLINES)
    found = 1e3 * np.asarray(_positions(curves.robot.for_any_terms(), curves.run, jnp.asarray(at)))
    return [[line[:, side] for line in found[: len(kept)]] for side in sides]


def drawing(curves: Curves, step: int) -> Drawing:
    """The body of a simulation at a step, counted from 0."""
    robot = curves.robot.for_any_terms()
    found = _at(robot, curves.run, jnp.asarray(step))
    eq, forces, radius, markers = jax.tree_util.tree_map(np.asarray, found)
    places = 1e3 * markers, _recorded(curves, step)
    several = bool(robot.tendon_names)
    each = [eq.of_tendon(i) for i in range(len(robot.tendons))] if several else [eq]
    if eq.shape is not None:
        return _in_space(curves, strung_of(robot, found[0]), eq, each, forces, places)
    shapes = [_coarser(curve_of(own, radius, notches_of(curves.robot))) for own in each]
    along = [_along(own, shape, force) for own, shape, force in zip(each, shapes, forces, strict=True)]
    scale = _height(curves, eq, along)
    view = View(
        "xy",
        [shapes[0].outline],
        shapes[0].middle,
        [shape.channel for shape in shapes],
        [a.tension for a in along],
        [_teeth(shape, scale * a.normal) for shape, a in zip(shapes, along, strict=True)],
        *(_finite(place[:, :2]) for place in places),
    )
    return Drawing([view], along)


def _finite(points: np.ndarray) -> np.ndarray:
    return points[np.all(np.isfinite(points), axis=1)]


def _recorded(curves: Curves, step: int) -> np.ndarray:
    """Where the tip and the robot's markers were recorded at a step [mm], (1 + markers, 3); NaN where they
    were not.
    """
    recording, space = curves.history.recording, curves.robot.space
    places = np.full((1 + len(curves.robot.markers), 3), np.nan)
    if recording is None:
        return places
    names = ["tip", *(marker.name for marker in curves.robot.markers)]
    for place, name in zip(places, names, strict=True):
        for i, axis in enumerate("xyz"):
            of = f"{name}_{axis}"
            values = getattr(recording, of) if name == "tip" else recording.markers.get(of)
            place[i] = np.nan if values is None else 1e3 * values[step]
        if not space:
            place[2] = 0.0
    return places


def _height(curves: Curves, eq: Equilibrium, along: list[Along]) -> float:
    """Of the comb [mm] by contact force [N/m], of about one scale along the history: what presses grows with
    the tension.
    """
    pressed = max(SLACK, *(float(np.max(a.normal, initial=0.0)) for a in along))
    now = max(float(np.max(a.tension, initial=0.0)) for a in along)
    return COMB * 1e3 * float(eq.s[-1]) / pressed * now / max(curves.most, SLACK)


def _coarser(shape: Curve) -> Curve:
    """The shape at fewer points: every EVERY-th, and both ends of each panel."""
    last = np.append(np.diff(shape.panel) != 0, True)
    kept = np.flatnonzero((np.arange(len(shape.s)) % EVERY == 0) | last | np.roll(last, 1))
    left, right = np.split(shape.outline[:-1], 2)
    outline = np.concatenate([left[kept], right[::-1][kept][::-1], left[:1]])
    return Curve(shape.s[kept], shape.panel[kept], shape.middle[kept], shape.channel[kept], outline)


def _along(own: Equilibrium, shape: Curve, forces: ChannelForces) -> Along:
    normal, friction = (along_curve(shape, forces, np.asarray(v)) for v in (forces.normal, forces.friction))
    tension = np.interp(shape.s, np.asarray(own.s), np.asarray(own.tension))
    return Along(1e3 * shape.s, tension, normal, friction)


def _teeth(shape: Curve, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A comb at the channel, to the side that the tendon presses to."""
    at = shape.channel
    ends = at.copy()
    for panel in np.unique(shape.panel):
        here = np.flatnonzero(shape.panel == panel)
        heading = np.unwrap(np.arctan2(*np.gradient(at[here], axis=0).T[::-1]))
        across = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        ends[here] += (np.sign(np.gradient(heading)) * height[here])[:, None] * across
    return at, ends


def _teeth_in_space(channel: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Where the teeth of a comb at a channel end, (P, 3): to the side that the tendon presses to, which is
    the one that its channel turns to.
    """
    along = np.gradient(channel, axis=0)
    heading = along / np.linalg.norm(along, axis=1, keepdims=True)
    turning = np.gradient(heading, axis=0)
    size = np.linalg.norm(turning, axis=1, keepdims=True)
    return channel + height[:, None] * np.divide(turning, size, out=np.zeros_like(turning), where=size > 0)


def _in_space(
    curves: Curves,
    body: Strung,
    eq: Equilibrium,
    each: list,
    forces: list[ChannelForces],
    places: tuple[np.ndarray, np.ndarray],
) -> Drawing:
    assert eq.shape is not None
    posture = Posture("", *map(np.asarray, (eq.shape.position, eq.shape.rotation, np.atleast_2d(eq.tension))))
    shape = drawn(body, posture, SECTIONS, CORNERS)
    runs = [shape.s <= end * (1 + 1e-9) for end in body.ends]
    tension = [own[run] for own, run in zip(shape.tension, runs, strict=True)]
    along = [
        _along_in_space(own, force, end) for own, force, end in zip(each, forces, body.ends, strict=True)
    ]
    # Guides press in points, which no comb shows.
    tendons = curves.robot.tendons
    scale = _height(curves, eq, [own for own, t in zip(along, tendons, strict=True) if t.guides is None])
    combs = []
    for channel, own, run, tendon in zip(shape.channels, along, runs, tendons, strict=True):
        there = run if tendon.guides is None and len(own.s) else np.zeros_like(run)
        height = scale * np.interp(1e3 * shape.s[there], own.s, own.normal) if there.any() else np.zeros(0)
        starts = channel[there]
        combs.append((starts, _teeth_in_space(starts, height) if len(starts) > 1 else starts))
    views = []
    for side in SIDES:
        rims = shape.sections[:, :, side]
        channels = [channel[run][:, side] for channel, run in zip(shape.channels, runs, strict=True)]
        outline = [*rims, *_between(rims)]
        teeth = [(starts[:, side], ends[:, side]) for starts, ends in combs]
        axes, middle = "".join(AXES[i] for i in side), shape.middle[:, side]
        views.append(
            View(
                axes,
                outline,
                middle,
                channels,
                tension,
                teeth,
                *(_finite(place[:, side]) for place in places),
            )
        )
    return Drawing(views, along)


def _along_in_space(own: Equilibrium, force: ChannelForces, end: float) -> Along:
    there = (np.asarray(force.length) > 0) & (np.asarray(force.s) <= end * (1 + 1e-9))
    at = np.asarray(force.s)[there]
    tension = np.interp(at, np.asarray(own.s), np.asarray(own.tension))
    return Along(1e3 * at, tension, np.asarray(force.normal)[there], np.asarray(force.friction)[there])


def _between(rims: np.ndarray) -> list[np.ndarray]:
    """What joins each drawn section with the next one: their farthest corners across the way between them."""
    middle = rims.mean(axis=1)
    way = np.diff(middle, axis=0)
    across = np.stack([-way[:, 1], way[:, 0]], axis=1)[:, None, :]
    ends = []
    for rim in (rims[:-1], rims[1:]):
        out = np.sum(rim * across, axis=2)
        rows = np.arange(len(rim))
        ends.append((rim[rows, out.argmax(axis=1)], rim[rows, out.argmin(axis=1)]))
    return list(np.stack([ends[0][0], ends[1][0], ends[1][1], ends[0][1]], axis=1))
