"""From a validated robot file to the traced robot, and the choice of its mesh."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from gtr_jax.config.channel_check import check_channel
from gtr_jax.config.config import RobotConfig, load_config
from gtr_jax.config.sections import (
    BackboneConfig,
    LoadsConfig,
    MarkerConfig,
    NotchesConfig,
    PieceConfig,
    RectangleConfig,
    SectionShape,
    TendonConfig,
)
from gtr_jax.errors import InputError
from gtr_jax.mechanics.program_spec import in_order
from gtr_jax.terms import known_acting

from . import routing, spatial_routing
from .backbone import Backbone, Piece, Stiffness
from .clearance import TOUCHING, distances
from .notches import Notches
from .parts import Base, Loads, Marker, Tendon
from .robot import STANDARD_GRAVITY, Robot, inner_kinks, sections
from .shapes import Rectangle, Tube

# Mesh intervals along the body, per half wave of a channel, and at least in each panel; errors of this mesh
# are in docs/solver.md.
INTERVALS_ALONG = 48
INTERVALS_PER_HALF_WAVE = 20
FEWEST = 6


def _array(x) -> jnp.ndarray:
    return jnp.asarray(x, dtype=float)


def _routing(config, in_space: bool) -> routing.Routing:
    if config.kind == "helix":
        return spatial_routing.Helix(
            radius=_array(config.radius),
            turns=_array(config.turns),
            start_angle=_array(config.start_angle),
            tip_radius=None if config.tip_radius is None else _array(config.tip_radius),
        )
    if config.kind == "straight":
        return spatial_routing.Straight(_array(config.radius), _array(config.angle))
    if config.kind == "curve":
        return spatial_routing.curve_routing(*np.asarray(config.knots, float).T)
    turned = {"plane_angle": _array(config.plane_angle) if in_space else None}
    if config.kind == "parallel":
        return routing.Parallel(_array(config.offset), **turned)
    if config.kind == "converging-sine":
        numbers = (config.R_max, config.r_min, config.n_sine, config.sigma)
        return routing.ConvergingSine(*map(_array, numbers), **turned)
    if config.kind == "crossing-sine":
        return routing.CrossingSine(*map(_array, (config.R_max, config.r_min, config.n_sine)), **turned)
    if config.kind == "straight-sine-straight":
        numbers = (config.r1, config.r2, config.w1, config.w2)
        return routing.StraightSineStraight(*map(_array, numbers), **turned)
    knots = np.asarray(config.knots, float)
    return dataclasses.replace(routing.table_routing(knots[:, 0], knots[:, 1]), **turned)


def _tendon(name: str, tendon: TendonConfig, channel: Any, in_space: bool) -> Tendon:
    stiffness = math.inf if tendon.axial_stiffness is None else tendon.axial_stiffness
    return Tendon(
        _routing(channel, in_space),
        _array(tendon.friction_coefficient),
        _array(tendon.preload),
        name,
        drive=tendon.drive,
        to=None if tendon.to is None else _array(tendon.to),
        guides=_array(tendon.guides) if tendon.guides else None,
        axial_stiffness=_array(stiffness) if in_space else None,
        free_length=_array(tendon.free_length) if in_space else None,
    )


def _knots(along: Any) -> np.ndarray:
    """A constant, or rows [s, value, ...], as rows."""
    return np.asarray(along if isinstance(along, tuple) else [(0.0, along)], float)


def _stiffness(bending: Any, torsion: Any) -> Stiffness | None:
    """The stiffness that a body or a piece is given; None if it follows from modulus and radius."""
    if bending is None:
        return None
    if not isinstance(bending, tuple):
        rows: Any = [(0.0, bending)]
    else:
        rows = bending if isinstance(bending[0], tuple) else [(0.0, *bending)]
    both = np.asarray(rows, float)
    twist = None if torsion is None else _knots(torsion)
    return Stiffness(
        bending_s=_array(both[:, 0]),
        bending=_array(both[:, -1]),
        bending_y=_array(both[:, 1]) if both.shape[1] > 2 else None,
        torsion_s=None if twist is None else _array(twist[:, 0]),
        torsion=None if twist is None else _array(twist[:, 1]),
    )


def _piece(piece: PieceConfig) -> Piece:
    return Piece(
        _array(piece.from_),
        _array(piece.to),
        outer_radius=None if piece.outer_radius is None else _array(piece.outer_radius),
        youngs_modulus=None if piece.youngs_modulus is None else _array(piece.youngs_modulus),
        stiffness=_stiffness(piece.bending_stiffness, piece.torsional_stiffness),
    )


def _notches(row: NotchesConfig) -> Notches:
    return Notches(
        start=_array(row.from_),
        height=_array(row.height),
        spacing=_array(row.spacing),
        depth=_array(row.depth),
        end_correction=_array(row.end_correction),
        natural_angle=_array(row.natural_angle),
        side=1.0 if row.side == "left" else -1.0,
    )


def _shape(section: SectionShape | None) -> Tube | Rectangle | None:
    """The section that carries the load; None: all within the outer radius."""
    if section is None:
        return None
    if isinstance(section, RectangleConfig):
        return Rectangle(_array(section.height), _array(section.width))
    return Tube(_array(section.outer_diameter), _array(section.inner_diameter))


def _marker(marker: MarkerConfig) -> Marker:
    return Marker(_array(marker.at), _array(marker.offset), _array(marker.angle_from), marker.name)


def _backbone(body: BackboneConfig, in_space: bool) -> Backbone:
    bent, up, twisted = map(_knots, (body.natural_curvature, body.natural_curvature_y, body.natural_twist))
    across = {
        "natural_curvature_y_s": _array(up[:, 0]),
        "natural_curvature_y": _array(up[:, 1]),
        "natural_twist_s": _array(twisted[:, 0]),
        "natural_twist": _array(twisted[:, 1]),
    }
    return Backbone(
        length=_array(body.length),
        outer_radius=_array(body.outer_radius),
        bore_start=_array([bore.from_ for bore in body.bores]),
        bore_end=_array([bore.to for bore in body.bores]),
        bore_diameter=_array([bore.diameter for bore in body.bores]),
        youngs_modulus=_array(body.youngs_modulus),
        density=_array(body.density),
        natural_curvature_s=_array(bent[:, 0]),
        natural_curvature=_array(bent[:, 1]),
        rigid=body.rigid,
        poissons_ratio=_array(body.poissons_ratio),
        **(across if in_space else {}),
        stiffness=_stiffness(body.bending_stiffness, body.torsional_stiffness),
        stiffness_factor=None if body.stiffness_factor is None else _array(body.stiffness_factor),
        pieces=tuple(map(_piece, body.sections)),
        notches=tuple(map(_notches, body.notches)),
        extensible=body.stretches,
        axial_stiffness=None if body.axial_stiffness is None else _array(body.axial_stiffness),
        shape=_shape(body.section),
    )


def _loads(loads: LoadsConfig, in_space: bool) -> Loads:
    """Loads with vectors of two entries in the plane, of three in space."""
    axes = 3 if in_space else 2
    moment = np.atleast_1d(np.asarray(loads.tip_moment, float))
    about_z = moment[-1]
    moments = np.concatenate([np.zeros(3 - moment.size), moment])
    force = np.concatenate([np.asarray(loads.tip_force, float), [0.0]])[:axes]
    angled = loads.gravity_angle is not None
    return Loads(
        gravity=_array(STANDARD_GRAVITY if angled else 0.0),
        gravity_angle=_array(loads.gravity_angle if angled else 0.0),
        more_gravity=_array(np.asarray(loads.gravity or np.zeros(3))[:axes]),
        tip_force=_array(force),
        tip_moment=_array(moments if in_space else about_z),
        payload=_array(loads.payload),
    )


def choose_intervals(robot: Robot, resolution: float = 1.0) -> tuple[int, ...]:
    """Mesh intervals per panel: by length, and by the half waves of the channel in it.

    The defaults come from `benchmarks/solver_study.py` (work against precision).

    Args:
        robot: the robot; its present `intervals` are ignored.
        resolution: factor on all counts.
    """
    length = float(robot.backbone.length)
    ends = np.concatenate([[0.0], np.sort(np.asarray(inner_kinks(robot))), [length]])
    counts = []
    for start, end in itertools.pairwise(ends):
        if end - start <= 1e-12 * length:
            counts.append(1)
            continue
        channels = [t.routing for t in robot.tendons if t.guides is None]
        waves = max((c.half_waves(float(start), float(end), length) for c in channels), default=0.0)
        wanted = max(INTERVALS_ALONG * (end - start) / length, INTERVALS_PER_HALF_WAVE * waves, FEWEST)
        counts.append(math.ceil(resolution * wanted - 1e-9))
    return tuple(counts)


def build_robot(config: RobotConfig, *, resolution: float = 1.0) -> Robot:
    """The traced robot of a validated robot file.

    Args:
        config: from `load_config`.
        resolution: factor on the number of mesh intervals.

    Raises:
        InputError: a tendon leaves the body, or two run in one channel.
    """
    body, loads = config.backbone, _loads(config.loads, config.in_space)
    length = body.length
    kinks = tuple(
        (f"{kind}_{end}", i)
        for kind, stretches in (
            ("bore", [(bore.from_, bore.to) for bore in body.bores]),
            ("piece", [(piece.from_, piece.to) for piece in body.sections]),
            ("notch", [ends for row in body.notches for ends in row.ends]),
        )
        for i, stretch in enumerate(stretches)
        for end, at in zip(("start", "end"), stretch, strict=True)
        if 1e-9 * length < at < (1 - 1e-9) * length
    )
    terms = {kind: {name: _array(v) for name, v in p.items()} for kind, p in config.term_values.items()}
    weighs = config.loads.gravity_angle is not None or config.loads.gravity is not None
    pushed = bool(np.any(np.asarray(loads.tip_force) != 0))
    robot = Robot(
        backbone=_backbone(body, config.in_space),
        tendons=tuple(_tendon(*strung, config.in_space) for strung in config.strung),
        loads=loads,
        terms=terms,
        name=config.name,
        intervals=(),
        bore_kinks=kinks,
        loaded=(weighs or pushed) and not body.rigid,
        acting=in_order(known_acting(terms, config.laws), config.laws),
        base=Base(_array(config.base.position), _array(config.base.rotation)),
        markers=tuple(map(_marker, config.markers)),
        space=config.in_space,
        laws=config.laws,
    )

    _check_channels(config, robot)
    robot = dataclasses.replace(robot, intervals=choose_intervals(robot, resolution))
    _refuse_closed_notches(config, robot)
    return robot


def check_built(config: RobotConfig, robot: Robot) -> None:
    """Refuse what only the built robot shows: `build_robot` of the same file would.

    Args:
        config: the robot file.
        robot: as built from it, or another with the same numbers.

    Raises:
        InputError: a tendon leaves the body, two run in one channel, or a notch is closed without load.
    """
    _check_channels(config, robot)
    _refuse_closed_notches(config, robot)


def _check_channels(config: RobotConfig, robot: Robot) -> None:
    """InputError if a channel leaves the body, or two tendons run in the same one."""
    length = robot.backbone.length
    for tendon in robot.tendons:

        def offset(s: np.ndarray, routing=tendon.routing) -> np.ndarray:
            passed = routing.kinks()[:, None] <= s[None, :]
            return np.asarray(routing.section_offset(_array(s), passed, length).value)

        check_channel(config, offset, tendon=tendon.name or None)
    _refuse_one_channel_of_two(config, robot)


def _refuse_closed_notches(config: RobotConfig, robot: Robot) -> None:
    """InputError if a notch is bent beyond where it closes without load."""
    s = sections(robot) if robot.backbone.notches else None
    if s is None or s.closing is None:
        return
    bent = np.asarray(s.closing.side * s.rest)
    limit = np.where(np.asarray(s.closing.side) != 0, np.asarray(s.closing.limit), np.inf)
    if not np.any(bent > limit):
        return
    node = int(np.argmax(bent / limit))
    for i, row in enumerate(config.backbone.notches):
        if any(start <= s.mesh.s[node] <= end for start, end in row.ends):
            angle, most = (np.degrees(k * row.height) for k in (bent[node], limit[node]))
            raise InputError(
                f"{config.source}: backbone.notches[{i}].natural_angle: without load a notch is bent by "
                f"{angle:.4g} deg, and closed at {most:.4g} deg; give less"
            )


def _refuse_one_channel_of_two(config: RobotConfig, robot: Robot) -> None:
    """InputError if two tendons run in the same channel all along."""
    for pair in distances(robot) if robot.space else ():
        if pair.most <= TOUCHING:
            raise InputError(
                f"{config.source}: tendons.{pair.second}.routing: runs in the channel of "
                f"tendons.{pair.first} all along; move one of the two"
            )


def load_robot(path: str | Path, *, resolution: float = 1.0) -> Robot:
    """Read a robot file.

    Args:
        path: `robot.toml`.
        resolution: factor on the number of mesh intervals; 1 meets the accuracies in the documentation.

    Raises:
        InputError: the file is missing or wrong; one line with file, key and remedy.
    """
    return build_robot(load_config(path), resolution=resolution)
