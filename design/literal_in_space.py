"""The equilibrium in space from the integrals of the forces, solved independently of the simulator.

As `literal` in the plane: the moment in a section is that of the anchor and of the forces d(T t) with which
the tendon pushes its channel, force by force, with gravity and tip loads by their arms. Nothing of the local
moment identity, of the march or of its mesh is used: trapezoids, sums, rotations by scipy, and scipy's Newton
and Krylov method, in numpy.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
from scipy.optimize import NoConvergence, newton_krylov
from scipy.spatial.transform import Rotation

from gtr_jax.robot.clearance import offsets
from gtr_jax.robot.robot import Robot, loads_of

from .literal import extrapolated, places

TOLERANCE = 1e-9  # largest residual: error of a strain times the length
STEPS = 60  # of Newton's method, at most
COARSE = 120  # intervals of the coarser mesh, about


@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """The robot at N points along its midline, in the axes of the base, SI: arc length, offset of the channel
    (N, 2) and slope, 1/GJ, 1/EI_y, 1/EI_z (N, 3) and natural strain (N, 3), of a body that stretches beside
    them 1/EA and 0, (N, 4), force of gravity on each interval (N-1, 3), and the loads.
    """

    s: np.ndarray
    R: np.ndarray
    slope: np.ndarray
    compliance: np.ndarray
    rest: np.ndarray
    weight: np.ndarray
    tip_force: np.ndarray
    tip_moment: np.ndarray
    mu: float
    preload: float


@dataclasses.dataclass(frozen=True)
class Literal:
    """A state: place [m] and rotation of the tip in the world, tension there [N]; whether it settled."""

    place: np.ndarray
    rotation: np.ndarray
    T_tip: float
    settled: bool


def line_of(robot: Robot, count: int) -> Line:
    """The robot at about `count` even places, and at both sides of every kink."""
    body, tendon = robot.backbone, robot.tendon
    s, inside = places(robot, count)
    own = np.asarray(tendon.routing.kinks())
    passed = jnp.asarray(own[:, None] < inside[None, :])
    R = offsets(tendon.routing, jnp.asarray(s), passed, body.length)
    start, end = map(np.asarray, body.stretches)
    bored = (start[:, None] < inside[None]) & (inside[None] < end[:, None])
    middles = 0.5 * (s[1:] + s[:-1])
    among = (start[:, None] < middles[None]) & (middles[None] < end[:, None])
    mass = float(body.density) * np.asarray(body.area(jnp.asarray(middles), jnp.asarray(among))) * np.diff(s)
    loads, base = loads_of(robot), np.asarray(robot.base.rotation)
    pull = np.asarray(loads.gravity_vector()) @ base
    return Line(
        s=s,
        R=np.asarray(R.value),
        slope=np.asarray(R.slope),
        compliance=np.asarray(body.compliances(jnp.asarray(s), jnp.asarray(bored))),
        rest=np.asarray(body.strain_at_rest(jnp.asarray(s))),
        weight=mass[:, None] * pull[None, :],
        tip_force=np.asarray(loads.tip_force) @ base + float(loads.payload) * pull,
        tip_moment=np.asarray(loads.tip_moment) @ base,
        mu=float(tendon.friction_coefficient),
        preload=float(tendon.preload),
    )


def _shape(line: Line, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Midline, directors as columns, and directions of the tendon, in the axes of the base."""
    steps = np.diff(line.s)[:, None]
    middle = 0.5 * (strain[1:, :3] + strain[:-1, :3])
    length = 1.0 + strain[:, 3] if strain.shape[1] == 4 else np.ones(len(line.s))
    frames = [np.eye(3)]
    for turn in Rotation.from_rotvec(steps * middle).as_matrix():
        frames.append(frames[-1] @ turn)
    D = np.array(frames)
    axis = length[:, None] * D[:, :, 0]
    line_ = np.concatenate([np.zeros((1, 3)), np.cumsum(steps * 0.5 * (axis[1:] + axis[:-1]), axis=0)])
    offset = np.column_stack([np.zeros(len(line.s)), line.R])
    course = np.cross(strain[:, :3], offset) + np.column_stack([length, line.slope])
    along = np.einsum("nij,nj->ni", D, course)
    return line_, D, along / np.linalg.norm(along, axis=1, keepdims=True)


def _tension(line: Line, along: np.ndarray, T_base: float, memory: np.ndarray) -> np.ndarray:
    across = np.linalg.norm(np.cross(along[1:], along[:-1]), axis=1)
    turn = np.arctan2(across, np.sum(along[1:] * along[:-1], axis=1))
    grip = np.exp(line.mu * np.concatenate([[0.0], np.cumsum(turn)]))
    return np.clip(memory, T_base / grip, T_base * grip)


def _moment(line: Line, middle: np.ndarray, D: np.ndarray, pull: np.ndarray) -> np.ndarray:
    """Moment in each section from every force beyond it, in its axes [N m], (N, 3); where the body stretches,
    beside it the force along its axis [N].
    """
    holes = middle + np.einsum("nij,nj->ni", D[:, :, 1:], line.R)
    inside = [
        (0.5 * (holes[1:] + holes[:-1]), np.diff(pull, axis=0)),
        (0.5 * (middle[1:] + middle[:-1]), line.weight),
    ]
    moment = np.tile(line.tip_moment, (len(middle), 1))
    push = np.zeros_like(middle)
    for place, force in ((holes[-1], -pull[-1]), (middle[-1], line.tip_force)):
        moment += np.cross(place, force)
        push += force
    for place, force in inside:
        moment[:-1] += np.cumsum(np.cross(place, force)[::-1], axis=0)[::-1]
        push[:-1] += np.cumsum(force[::-1], axis=0)[::-1]
    moment = np.einsum("nji,nj->ni", D, moment - np.cross(middle, push))
    if line.compliance.shape[1] == 3:
        return moment
    return np.column_stack([moment, np.sum(D[:, :, 0] * push, axis=1)])


def _solve(line: Line, T_base: float, memory: np.ndarray) -> tuple[np.ndarray, bool]:
    """Strain at a base tension, from rest, and whether it was found."""

    def residual(strain):
        middle, D, along = _shape(line, strain)
        pull = _tension(line, along, T_base, memory)[:, None] * along
        return (strain - line.rest - line.compliance * _moment(line, middle, D, pull)) * line.s[-1]

    try:
        return newton_krylov(residual, line.rest, f_tol=TOLERANCE, maxiter=STEPS), True
    except NoConvergence as last:
        return np.asarray(last.args[0]), False


def solve_in_space(robot: Robot, T_base: float, *, released_from: float | None = None) -> Literal:
    """One state from the integrals of the forces.

    The results of two meshes, one of half the spacing, are extrapolated: the trapezoidal rule is of second
    order.

    Args:
        robot: of one tendon anchored at the tip, without physics terms and guides.
        T_base: base tension [N].
        released_from: largest base tension before [N], where it is released from there.

    Returns:
        The state; `settled` is False if Newton's method did not find it.
    """
    found, settled = [], True
    for count in COARSE, 2 * COARSE:
        line = line_of(robot, count)
        memory, ok = np.full(len(line.s), line.preload), True
        if released_from is not None:
            strain, ok = _solve(line, released_from, memory)
            memory = _tension(line, _shape(line, strain)[2], released_from, memory)
        strain, met = _solve(line, T_base, memory)
        middle, D, along = _shape(line, strain)
        T_tip = _tension(line, along, T_base, memory)[-1]
        found.append(np.array([*middle[-1], *D[-1].ravel(), T_tip]))
        settled = settled and ok and met
    best = extrapolated(*found)
    base = np.asarray(robot.base.rotation)
    return Literal(
        np.asarray(robot.base.position) + base @ best[:3],
        base @ best[3:12].reshape(3, 3),
        float(best[12]),
        settled,
    )
