"""From a validated robot file to the traced robot, and the choice of its mesh."""

from __future__ import annotations

import dataclasses
import itertools
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from gtr_jax.files.channel_check import check_channel
from gtr_jax.files.config import RobotConfig, load_config
from gtr_jax.mechanics.structure import in_order
from gtr_jax.terms import known_acting

from . import routing
from .backbone import Backbone
from .parts import Loads, Tendon
from .robot import STANDARD_GRAVITY, Robot, inner_kinks

# Mesh intervals along the body, per half wave of a channel, and at least in each panel; errors of this mesh
# are in docs/solver.md.
INTERVALS_ALONG = 48
INTERVALS_PER_HALF_WAVE = 20
FEWEST = 6


def _array(x) -> jnp.ndarray:
    return jnp.asarray(x, dtype=float)


def _routing(config, length: float) -> routing.Routing:
    if config.kind == "parallel":
        return routing.Parallel(_array(config.offset))
    if config.kind == "converging-sine":
        return routing.ConvergingSine(*map(_array, (config.R_max, config.r_min, config.n_sine, config.sigma)))
    if config.kind == "crossing-sine":
        return routing.CrossingSine(*map(_array, (config.R_max, config.r_min, config.n_sine)))
    if config.kind == "straight-sine-straight":
        return routing.StraightSineStraight(*map(_array, (config.r1, config.r2, config.w1, config.w2)))
    knots = np.asarray(config.knots, float)
    return routing.table_routing(knots[:, 0], knots[:, 1])


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
        waves = max(t.routing.half_waves(float(start), float(end), length) for t in robot.tendons)
        wanted = max(INTERVALS_ALONG * (end - start) / length, INTERVALS_PER_HALF_WAVE * waves, FEWEST)
        counts.append(math.ceil(resolution * wanted - 1e-9))
    return tuple(counts)


def build_robot(config: RobotConfig, *, resolution: float = 1.0) -> Robot:
    """The traced robot of a validated robot file.

    Args:
        config: from `load_config`.
        resolution: factor on the number of mesh intervals.

    Raises:
        InputError: the tendon leaves the body.
    """
    body, loads = config.backbone, config.loads
    length = body.length
    bores = [(b.from_, b.to, b.diameter) for b in body.bores]
    kinks = tuple(
        (field, i)
        for i, b in enumerate(bores)
        for field, at in (("bore_start", b[0]), ("bore_end", b[1]))
        if 1e-9 * length < at < (1 - 1e-9) * length
    )
    rest = body.natural_curvature
    knots = np.asarray(rest if isinstance(rest, (list, tuple)) else [(0.0, rest)], float)
    has_gravity = loads.gravity_angle is not None
    tip_force = _array(loads.tip_force)
    terms = {kind: {name: _array(v) for name, v in p.items()} for kind, p in config.term_values.items()}
    robot = Robot(
        backbone=Backbone(
            length=_array(length),
            outer_radius=_array(body.outer_radius),
            bore_start=_array([b[0] for b in bores]),
            bore_end=_array([b[1] for b in bores]),
            bore_diameter=_array([b[2] for b in bores]),
            youngs_modulus=_array(body.youngs_modulus),
            density=_array(body.density),
            natural_curvature_s=_array(knots[:, 0]),
            natural_curvature=_array(knots[:, 1]),
            rigid=body.rigid,
        ),
        tendons=tuple(
            Tendon(
                _routing(routing, length), _array(tendon.friction_coefficient), _array(tendon.preload), name
            )
            for name, tendon, routing in config.strung
        ),
        loads=Loads(
            gravity=_array(STANDARD_GRAVITY if has_gravity else 0.0),
            gravity_angle=_array(loads.gravity_angle if has_gravity else 0.0),
            more_gravity=jnp.zeros(2),
            tip_force=tip_force,
            tip_moment=_array(loads.tip_moment),
            payload=_array(loads.payload),
        ),
        terms=terms,
        name=config.name,
        intervals=(),
        bore_kinks=kinks,
        loaded=(has_gravity or bool(np.any(np.asarray(tip_force) != 0))) and not body.rigid,
        acting=in_order(known_acting(terms)),
    )

    for tendon in robot.tendons:

        def offset(s: np.ndarray, routing=tendon.routing) -> np.ndarray:
            passed = routing.kinks()[:, None] <= s[None, :]
            return np.asarray(routing.offset(_array(s), passed, _array(length)).value)

        check_channel(config, offset, tendon=tendon.name or None)
    return dataclasses.replace(robot, intervals=choose_intervals(robot, resolution))


def load_robot(path: str | Path, *, resolution: float = 1.0) -> Robot:
    """Read a robot file.

    Args:
        path: `robot.toml`.
        resolution: factor on the number of mesh intervals; 1 meets the accuracies in the documentation.

    Raises:
        InputError: the file is missing or wrong; one line with file, key and remedy.
    """
    return build_robot(load_config(path), resolution=resolution)
