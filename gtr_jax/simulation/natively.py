"""Load histories without derivatives, as native code: tip tension, pose, displacement and slip."""

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
from ..mechanics import FOREVER, Load, March, Settled, Step, Structure, advance, begin, loads_before
from ..native.program import Program, packed, sources
from ..robot.robot import Robot, sections
from .programs import at_nodes
from .slipping import front_of, large_tension, moves_of
from .solution import drawn_out, loaded_of

__all__ = ["Brief", "Native", "Ready", "ready", "sources", "steps_natively"]


class Brief(NamedTuple):
    """A load history of K steps of a robot of one tendon, SI; as in `Simulation`.

    Attributes:
        T_tip: true tension at the anchor, (K,).
        tip_pose: x, y, angle of the midline's tip, (K, 3).
        displacement: tendon drawn out at the base, (K,).
        slip_direction: of the tendon at the base, (K,).
        slip_front: the tendon slips on [0, slip_front], (K,).
        converged: whether each step met its tolerance, (K,).
        residual_norm, iterations: per step, (K,).
        bent: largest curvature that the tendon gave the body since it settled [1/m], (K,).
    """

    T_tip: Float[np.ndarray, " K"]
    tip_pose: Float[np.ndarray, "K 3"]
    displacement: Float[np.ndarray, " K"]
    slip_direction: Float[np.ndarray, " K"]
    slip_front: Float[np.ndarray, " K"]
    converged: Bool[np.ndarray, " K"]
    residual_norm: Float[np.ndarray, " K"]
    iterations: Int[np.ndarray, " K"]
    bent: Float[np.ndarray, " K"]


class _Row(NamedTuple):
    load: Load
    settling: Bool[Array, ""]
    stringing: Bool[Array, ""]
    scale: Float[Array, ""]


def _left(robot: mechanics.Robot, structure: Structure, rigid: bool, settled: Settled, step: Step, row: _Row):
    """What a step leaves, as numbers."""
    s = robot.sections
    done = loaded_of(s, structure, settled, step)
    direction, front = front_of(s.mesh.s, moves_of(s, structure, rigid, step, done, row.scale))
    x, y = (jnp.sum(mechanics.increments(s.mesh.weights, f(done.state.phi))) for f in (jnp.cos, jnp.sin))
    bent = jnp.max(jnp.abs(done.state.kappa - settled.kappa))
    pose = jnp.stack([x, y, done.state.phi[-1]])
    drawn = drawn_out(robot.terms, done.slip[0], row.load.T_base, robot.preload)
    moved = jnp.zeros(()) if step.moved is None else jnp.where(step.met, step.moved, 0.0)
    return step.T_tip, pose, drawn, direction, front, step.met, step.error, step.marches, bent, moved


@functools.lru_cache(maxsize=256)
def _program(structure: Structure, how: March, rigid: bool, nodes: int, shapes: tuple) -> Program:
    """The program for a structure and a number of nodes."""
    leaves, tree = shapes
    fixed = jtu.tree_unflatten(tree, [jax.ShapeDtypeStruct(*leaf) for leaf in leaves])

    def step(robot: mechanics.Robot, settled: Settled, row: _Row):
        after, out = advance(robot, structure, how, settled, row.load, (row.settling, row.stringing))
        return after, _left(robot, structure, rigid, settled, out, row)

    def row():
        one, flag = jnp.zeros(()), jnp.asarray(False)
        return _Row(Load(one, one, one, one), flag, flag, one)

    key = (structure, how, rigid, nodes)
    return Program(lambda robot: begin(robot, structure), step, fixed, jax.eval_shape(row), key)


class Ready(NamedTuple):
    """Inputs of a native program: a robot of one tendon, and a load history.

    Attributes:
        given: the robot at its nodes, `packed`, (n,).
        preload: of its tendon [N].
        large: a tension that counts as large in the history [N].
    """

    given: Float[Array, " n"]
    preload: Float[Array, ""]
    large: Float[Array, ""]


def ready(robot: Robot, T_base: Float[Array, " K"]) -> Ready:
    """A robot made ready for a history of base tensions [N]; to be compiled."""
    at = at_nodes(robot, sections(robot))
    return Ready(packed(at), at.preload, large_tension(T_base, at.preload))


_ready = eqx.filter_jit(ready)


class Native:
    """The native programs of a robot of one tendon: one for each structure, for any numbers.

    Args:
        robot: the robot, or one that differs from it in its numbers only.
    """

    def __init__(self, robot: Robot):
        shapes = eqx.filter_eval_shape(lambda robot: at_nodes(robot, sections(robot)), robot)
        leaves, tree = jtu.tree_flatten(shapes)
        self._shapes = (tuple((leaf.shape, leaf.dtype) for leaf in leaves), tree)
        self._nodes, self._rigid = shapes.sections.rest.shape[0], robot.backbone.rigid

    def __call__(self, ready: Ready, structure: Structure, loads: Load, how: March = March()) -> Brief:  # noqa: B008
        """Go through K load steps.

        Args:
            ready: of the robot and these loads.
            structure: which equations act.
            loads: K of them.
            how: when a search stops.
        """
        program = _program(structure, how, self._rigid, self._nodes, self._shapes)
        columns = [np.asarray(column, float) for column in (loads.T_base, loads.dt, loads.time, loads.cycle)]
        # Of each step: T_base, dt, time, cycle, whether the robot settles, whether it is strung, and `large`.
        large = float(ready.large)
        before = loads_before(structure, float(ready.preload))
        ahead = np.asarray([[T_base, FOREVER, 0, 0, *flags, large] for T_base, *flags in before], float)
        rows = np.pad(np.stack(columns, axis=1), ((0, 0), (0, 3)))
        rows[:, -1] = large
        out = program(np.asarray(ready.given), np.concatenate([ahead.reshape(-1, 7), rows]))[len(before) :]
        return Brief(
            T_tip=out[:, 0],
            tip_pose=out[:, 1:4],
            displacement=out[:, 4] + np.cumsum(out[:, 11]),
            slip_direction=out[:, 5],
            slip_front=out[:, 6],
            converged=out[:, 7] != 0,
            residual_norm=out[:, 8],
            iterations=out[:, 9].astype(int),
            bent=out[:, 10],
        )


def steps_natively(robot: Robot, structure: Structure, loads: Load, how: March = March()) -> Brief:  # noqa: B008
    """As `Native`, for a robot whose numbers are known."""
    return Native(robot)(_ready(robot, loads.T_base), structure, loads, how)
