"""Load histories without derivatives, as native code: what instruments would show, and where slip goes."""

from __future__ import annotations

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .. import mechanics
from ..mechanics import Load, March, Settled, Step, Structure, advance, begin, with_steps_before
from ..native.program import Program
from ..robot.robot import Robot, sections
from .programs import at_nodes
from .slipping import front_of, large_tension, moves_of
from .solution import loaded_of


class Brief(NamedTuple):
    """A load history of K steps of a robot of one tendon, SI; as in `Simulation`.

    Attributes:
        T_tip: true tension at the anchor, (K,).
        tip_pose: x, y, angle of the midline's tip, (K, 3).
        displacement: tendon drawn out at the base, (K,).
        slip_direction: of the tendon at the base, (K,).
        slip_front: the tendon slips up to there, (K,).
        converged: whether each step met its tolerance, (K,).
        residual_norm, iterations: per step, (K,).
    """

    T_tip: Float[np.ndarray, " K"]
    tip_pose: Float[np.ndarray, "K 3"]
    displacement: Float[np.ndarray, " K"]
    slip_direction: Float[np.ndarray, " K"]
    slip_front: Float[np.ndarray, " K"]
    converged: Bool[np.ndarray, " K"]
    residual_norm: Float[np.ndarray, " K"]
    iterations: Int[np.ndarray, " K"]


class _Row(NamedTuple):
    load: Load
    settling: Bool[Array, ""]
    stringing: Bool[Array, ""]
    scale: Float[Array, ""]


def _left(robot: mechanics.Robot, structure: Structure, rigid: bool, settled: Settled, step: Step, scale):
    """What a step leaves, as numbers."""
    s = robot.sections
    done = loaded_of(s, structure, settled, step)
    direction, front = front_of(s.mesh.s, moves_of(s, structure, rigid, step, done, scale))
    x, y = (jnp.sum(mechanics.increments(s.mesh.weights, f(done.state.phi))) for f in (jnp.cos, jnp.sin))
    pose = jnp.stack([x, y, done.state.phi[-1]])
    return step.T_tip, pose, done.slip[0], direction, front, step.met, step.error, step.marches


@functools.lru_cache(maxsize=256)
def _program(structure: Structure, how: March, rigid: bool, nodes: int, shapes: tuple) -> Program:
    """The program of a structure on so many nodes."""
    leaves, tree = shapes
    fixed = jtu.tree_unflatten(tree, [jax.ShapeDtypeStruct(*leaf) for leaf in leaves])

    def step(robot: mechanics.Robot, settled: Settled, row: _Row):
        after, out = advance(robot, structure, how, settled, row.load, (row.settling, row.stringing))
        return after, _left(robot, structure, rigid, settled, out, row.scale)

    def row():
        one, flag = jnp.zeros(()), jnp.asarray(False)
        return _Row(Load(one, one, one, one), flag, flag, one)

    key = (structure, how, rigid, nodes)
    return Program(lambda robot: begin(robot, structure), step, fixed, jax.eval_shape(row), key)


@eqx.filter_jit
def _prepared(robot: Robot, loads: Load):
    at = at_nodes(robot, sections(robot))
    return at, large_tension(loads.T_base, at.preload)


def steps_natively(robot: Robot, structure: Structure, loads: Load, how: March = March()) -> Brief:  # noqa: B008
    """Go through load steps natively.

    Args:
        robot: of one tendon, its numbers known.
        structure: which equations act.
        loads: K of them.
        how: far a search goes.
    """
    at, scale = _prepared(robot, loads)
    leaves, tree = jtu.tree_flatten(at)
    shapes = (tuple((leaf.shape, leaf.dtype) for leaf in leaves), tree)
    program = _program(structure, how, robot.backbone.rigid, at.sections.rest.shape[0], shapes)
    whole, (settling, stringing) = with_steps_before(at, structure, loads)
    K = whole.time.shape[0]
    columns = [whole.T_base, whole.dt, whole.time, whole.cycle, settling, stringing, np.full(K, float(scale))]
    out = program([np.asarray(leaf) for leaf in leaves], np.stack([np.asarray(c, float) for c in columns], 1))
    out = out[K - loads.time.shape[0] :]
    return Brief(
        out[:, 0],
        out[:, 1:4],
        out[:, 4],
        out[:, 5],
        out[:, 6],
        out[:, 7] != 0,
        out[:, 8],
        out[:, 9].astype(int),
    )
