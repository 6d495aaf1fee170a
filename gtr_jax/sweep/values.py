"""The outputs of a point, read off its solved states."""

from __future__ import annotations

import functools
from collections.abc import Collection, Sequence

import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array

from gtr_jax.recordings.formats.quantities import AXES, QUATERNION
from gtr_jax.robot.robot import Robot, sections
from gtr_jax.robot.rotation import quaternion_of

from ..mechanics import metric_of
from ..mechanics.bodies import line_of
from ..simulation.history import Simulation
from ..simulation.markers import marker_rows, markers_on, shape_in_plane
from ..simulation.sensing import cells_show
from ..simulation.shape import Shape
from ..simulation.solution import Equilibrium, drawn_out, stretch_beyond, stretch_of
from .outputs import NODE_QUATERNION, PER_TENDON, POSE, of_markers


def at_rest(robot: Robot, eq: Equilibrium, T_base: Array, wanted: Collection[str]) -> dict[str, Array]:
    """The outputs of one equilibrium, by name, with a leading axis of one step.

    Args:
        robot: the robot.
        eq: its equilibrium.
        T_base: base tension [N], (*tendons).
        wanted: names of the arrays wanted; others may be among what is returned.
    """
    shown = cells_show(robot, T_base[None], eq.T_tip[None], jnp.zeros(1))
    preload = robot.per_tendon(lambda tendon: tendon.preload)
    out = drawn_out(robot.terms, eq.slip[..., 0], T_base, preload)
    said = {
        "T_base": shown.T_base,
        "T_tip": shown.T_tip,
        "loss": (1.0 - _share(eq.T_tip, T_base))[None],
        "displacement": out[None],
        "s": eq.s,
        "tension": eq.tension[None],
    }
    shape = None if eq.shape is None else jtu.tree_map(lambda values: values[None], eq.shape)
    if shape is not None:
        said["displacement"] += stretch_of(robot.tendons, eq.s, eq.tension, eq.metric)[None]
        said |= _in_space(shape, wanted)
    else:
        pose = eq.tip_pose
        said |= {v.name: pose[None, i] for i, v in enumerate(POSE)}
        said |= {"x": eq.x[None], "y": eq.y[None], "angle": eq.angle[None]}
    said |= _markers(robot, eq.s, shape, eq.curvature[None], eq.angle[None], wanted)
    return _named(robot, said)


def along(robot: Robot, run: Simulation, kept: Sequence[int], wanted: Collection[str]) -> dict[str, Array]:
    """The outputs of some steps of a load history, by name.

    Args:
        robot: as simulated.
        run: its simulation.
        kept: which steps.
        wanted: names of the arrays wanted; others may be among what is returned.
    """
    at = jnp.asarray(kept)
    shown = cells_show(robot, run.T_base, run.T_tip, run.time)
    said = {
        "T_base": shown.T_base[at],
        "T_tip": shown.T_tip[at],
        "loss": 1.0 - _share(run.T_tip, run.T_base)[at],
        "displacement": run.displacement[at],
        "s": run.s,
        "tension": run.tension[at],
        "dissipation": dissipation(robot, run),
    }
    shape = None if run.shape is None else jtu.tree_map(lambda values: values[at], run.shape)
    if shape is not None:
        said |= _in_space(shape, wanted)
    else:
        said |= {v.name: run.tip_pose[at, i] for i, v in enumerate(POSE)} | {"angle": run.angle[at]}
        if "x" in wanted:
            x, y = jax.vmap(functools.partial(line_of, sections(robot)))(run.angle[at], run.curvature[at])
            said |= {"x": x, "y": y}
    said |= _markers(robot, run.s, shape, run.curvature[at], run.angle[at], wanted)
    return _named(robot, said)


def _in_space(shape: Shape, wanted: Collection[str]) -> dict[str, Array]:
    """Where tip and nodes are and how they are turned at every step; the nodes if they are wanted."""
    nodes = slice(None) if "x" in wanted else slice(-1, None)
    place, turned = shape.position[:, nodes], quaternion_of(shape.rotation[:, nodes])
    said = {f"tip_{axis}": place[:, -1, i] for i, axis in enumerate(AXES)}
    said |= {name: turned[:, -1, i] for i, name in enumerate(QUATERNION)}
    if "x" in wanted:
        said |= {axis: place[..., i] for i, axis in enumerate(AXES)}
        said |= {name: turned[..., i] for i, name in enumerate(NODE_QUATERNION)}
    return said


def _markers(
    robot: Robot, s: Array, shape: Shape | None, curvature: Array, angle: Array, wanted: Collection[str]
) -> dict[str, Array]:
    """Where the markers are at every step, if they are wanted."""
    found = of_markers(robot)
    if not {v.name for v in found} & {*wanted}:
        return {}
    places = markers_on(robot, s, shape_in_plane(robot, curvature, angle) if shape is None else shape)
    rows = marker_rows(robot, places)
    return {v.name: rows[v.name] for v in found}


def dissipation(robot: Robot, run: Simulation) -> Array:
    """Work lost to friction of the tendons in their channels over a load history [J], ().

    The friction force between two nodes is the drop of tension between them; it does work where the tendon
    slips, by its own stretch too. Integrated by the trapezoidal rule along the tendon and over the steps;
    friction lumped at the tendon's ends is not counted.
    """
    slid = run.slip
    if run.shape is not None:
        s = sections(robot)
        metric = jax.vmap(lambda strain: metric_of(s, strain))(run.shape.whole_strain)
        slid = slid + jax.vmap(lambda T, nu: stretch_beyond(robot.tendons, run.s, T, nu))(run.tension, metric)
    grip = run.tension[..., :-1] - run.tension[..., 1:]
    slip = 0.5 * (slid[..., :-1] + slid[..., 1:])
    grip, slip = (jnp.concatenate([jnp.zeros_like(a[:1]), a]) for a in (grip, slip))
    return jnp.sum(0.5 * (grip[1:] + grip[:-1]) * jnp.diff(slip, axis=0))


def _share(T_tip: Array, T_base: Array) -> Array:
    """Share of the base tension that reaches the tip; 1 of a slack tendon."""
    return jnp.where(T_base > 0, T_tip / jnp.where(T_base > 0, T_base, 1.0), 1.0)


def _named(robot: Robot, said: dict[str, Array]) -> dict[str, Array]:
    """Of several tendons, one entry for each where it has its own."""
    names = robot.tendon_names
    if not names:
        return said
    parted = {}
    for name, values in said.items():
        if name in PER_TENDON:
            parted |= {f"{name}.{tendon}": values[:, i] for i, tendon in enumerate(names)}
        else:
            parted[name] = values
    return parted
