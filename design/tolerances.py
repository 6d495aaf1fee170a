"""The manufacturing tolerance table: how far each dimension moves the tip, and how far the dimension may be
off.
"""

from __future__ import annotations

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from gtr_jax.robot.parameters import Parameter, parameters_of, places_of
from gtr_jax.simulation.programs import terms_act

from .model import states_of
from .option import Option, loads_of
from .pose import DIRECTION, distance, turning
from .problem import DesignProblem
from .space import on_common_mesh
from .target import TIP_TOLERANCE

DIFFERENCE = 1e-4  # relative
# Sections of the robot file whose numbers are dimensions.
SECTIONS = ("backbone.", "routing.", "tendon.", "tendons.")
# Of a tendon, what changes nothing where its base tension is given.
OF_DRIVE = ("preload", "EA", "free_length")


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """One dimension.

    Attributes:
        parameter: name, key and unit. value: SI.
        moves: of the tip at the worst target, per unit of the dimension [m per unit]. turns: [rad per unit].
        allowed: deviation that by itself uses up the tolerance of a target, SI; infinite if none would.
    """

    parameter: Parameter
    value: float
    moves: float
    turns: float
    allowed: float


@eqx.filter_jit
def _poses_by(robot, index, T, released, largest):
    flat, unravel = ravel_pytree(robot)

    def poses(values):
        return states_of(unravel(flat.at[index].set(values)), T, released, largest).pose

    # As in `gauss_newton.value_and_slopes`; in space derivatives by so many numbers take a minute to compile.
    if terms_act(robot) or robot.space:
        values = flat[index]
        steps = DIFFERENCE * jnp.where(values == 0.0, 1.0, jnp.abs(values))
        ends = jax.lax.map(lambda d: poses(values + d), jnp.concatenate([jnp.diag(steps), -jnp.diag(steps)]))
        return (ends[: steps.size] - ends[steps.size :]) / (2 * steps[:, None, None])

    def along(direction):
        return jax.jvp(poses, (flat[index],), (direction,))[1]

    return jax.vmap(along)(jnp.eye(index.shape[0]))


def pose_slopes(problem: DesignProblem, option: Option) -> tuple[list[Parameter], np.ndarray, np.ndarray]:
    """Derivatives of the tip's pose at every state by every dimension of body, channel and tendon.

    Forward mode through the equilibrium by the implicit function theorem; in space and with physics terms
    central differences.

    Returns:
        The p parameters, their values, SI, (p,), and d pose / d parameter, (p, S, pose).
    """
    robot = on_common_mesh(problem.space, option.config, 1.0)
    found = [
        p
        for p in parameters_of(robot).values()
        if p.key.startswith(SECTIONS) and p.name.partition(".")[0] not in OF_DRIVE
    ]
    found = [p for p in found if p.name != "density" or robot.loaded]
    values = np.array([float(robot.value(p.name)) for p in found])
    index = places_of(robot, [p.name for p in found])
    slopes = _poses_by(robot, index, *loads_of(problem, option.tensions))
    return found, values, np.asarray(slopes)


def tolerance_table(problem: DesignProblem, option: Option) -> tuple[Sensitivity, ...]:
    """How each dimension moves the tip, the tightest tolerance, relative to the value, first."""
    parameters, values, slopes = pose_slopes(problem, option)
    wanted = problem.objective.wanted
    states = list(wanted.pose_state) or list(range(slopes.shape[1]))
    length = problem.space.config.backbone.length
    by_state = {state: i for i, state in enumerate(wanted.pose_state)}
    rows = []
    for p, value, slope in zip(parameters, values, slopes, strict=True):
        moves = distance(slope[states])
        turns = turning(slope[states])
        allowed = np.inf
        for state, move, turn in zip(states, moves, turns, strict=True):
            i = by_state.get(state)
            pose = problem.target.pose[i] if i is not None else None
            tip = TIP_TOLERANCE * length if pose is None else pose.near(length)
            if (pose is None or pose.tip is not None) and move > 0:
                allowed = min(allowed, tip / move)
            if pose is not None and pose.turn == "direction":
                turn = float(np.linalg.norm(slope[state][DIRECTION]))
            if pose is not None and pose.turn is not None and turn > 0:
                allowed = min(allowed, pose.angle_tolerance / turn)
        rows.append(Sensitivity(p, float(value), float(moves.max()), float(turns.max()), float(allowed)))
    return tuple(sorted(rows, key=lambda r: r.allowed / max(abs(r.value), 1e-12)))
