"""The equilibrium from the paper's own integrals, solved independently of the simulator.

Moments are the anchor's (15) and that of the distributed forces (16), with the factor nu that the printed
form lacks, force by force; gravity and tip loads likewise by their arms. Nothing of the local moment
identity, of the march, or of its mesh weights is used: trapezoids, sums, and Newton's method with
differences, in numpy.
"""

from __future__ import annotations

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np

from gtr_jax.robot.robot import Robot, inner_kinks, loads_of

TOLERANCE = 1e-9  # largest residual: error of a curvature times the length
STEPS = 60  # of Newton's method, at most
COARSE = 120  # intervals of the coarser mesh, about


@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """The robot at N places: arc length [m], channel offset and slope, 1/EI, natural curvature, distal mass
    [kg], each (N,), and the loads.
    """

    s: np.ndarray
    R: np.ndarray
    slope: np.ndarray
    compliance: np.ndarray
    rest: np.ndarray
    weight: np.ndarray  # force of gravity on each interval [N], (N-1, 2)
    tip_force: np.ndarray
    tip_moment: float
    mu: float
    preload: float


@dataclasses.dataclass(frozen=True)
class Literal:
    """A state by the literal integrals: tip x [m], y [m], angle [rad], tension [N]; whether it settled."""

    pose: np.ndarray
    T_tip: float
    settled: bool


def places(robot: Robot, count: int) -> tuple[np.ndarray, np.ndarray]:
    """About `count` even arc lengths, and both sides of every kink [m], (N,); and for each a place inside its
    panel, which tells the two sides of a kink apart, (N,).
    """
    length = float(robot.backbone.length)
    kinks = np.unique(np.asarray(inner_kinks(robot)))
    kinks = kinks[(kinks > 1e-9 * length) & (kinks < length * (1 - 1e-9))]
    ends = np.concatenate([[0.0], kinks, [length]])
    pieces = [
        np.linspace(a, b, max(int(np.ceil(count * (b - a) / length)), 4) + 1)
        for a, b in itertools.pairwise(ends)
    ]
    s = np.concatenate(pieces)
    inside = np.concatenate(
        [0.5 * (a + b) * np.ones(len(p)) for a, b, p in zip(ends[:-1], ends[1:], pieces, strict=True)]
    )
    return s, inside


def extrapolated(coarse: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """The limit of results of second order on two meshes, one of half the spacing of the other."""
    return (4.0 * fine - coarse) / 3.0


def line_of(robot: Robot, count: int) -> Line:
    """The robot at about `count` even places, and at both sides of every kink."""
    body, tendon = robot.backbone, robot.tendon
    s, inside = places(robot, count)
    own = np.asarray(tendon.routing.kinks())
    passed = jnp.asarray(own[:, None] < inside[None, :])
    R = tendon.routing.offset(jnp.asarray(s), passed, body.length)
    start, end = map(np.asarray, body.stretches)
    bored = (start[:, None] < inside[None]) & (inside[None] < end[:, None])
    middles = 0.5 * (s[1:] + s[:-1])
    among = (start[:, None] < middles[None]) & (middles[None] < end[:, None])
    mass = float(body.density) * np.asarray(body.area(jnp.asarray(middles), jnp.asarray(among))) * np.diff(s)
    loads = loads_of(robot)
    angle = float(loads.gravity_angle)
    pull = float(loads.gravity) * np.array([np.cos(angle), np.sin(angle)]) + np.asarray(loads.more_gravity)
    tip = np.asarray(loads.tip_force) + float(loads.payload) * pull
    return Line(
        s=s,
        R=np.asarray(R.value),
        slope=np.asarray(R.slope),
        compliance=np.asarray(body.compliance(jnp.asarray(s), jnp.asarray(bored))),
        rest=np.asarray(body.curvature_at_rest(jnp.asarray(s))),
        weight=mass[:, None] * pull[None, :],
        tip_force=tip,
        tip_moment=float(loads.tip_moment),
        mu=float(tendon.friction_coefficient),
        preload=float(tendon.preload),
    )


def _sums(line: Line, values: np.ndarray) -> np.ndarray:
    steps = np.diff(line.s) * 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[0.0], np.cumsum(steps)])


def _shape(line: Line, kappa: np.ndarray):
    phi = _sums(line, kappa)
    midline = np.stack([_sums(line, np.cos(phi)), _sums(line, np.sin(phi))])
    psi = phi + np.arctan2(line.slope, 1.0 - line.R * kappa)
    return phi, midline, psi


def _tension(line: Line, psi: np.ndarray, T_base: float, memory: np.ndarray) -> np.ndarray:
    grip = np.exp(line.mu * np.concatenate([[0.0], np.cumsum(np.abs(np.diff(psi)))]))
    return np.clip(memory, T_base / grip, T_base * grip)


def _moment(line: Line, phi, midline, psi, tension) -> np.ndarray:
    """Bending moment at each place from every force beyond it [N m], (N,)."""
    across = np.stack([-np.sin(phi), np.cos(phi)])
    holes = midline + line.R * across
    # On each interval the tendon pushes the channel with d(T t_c): normal force and friction together.
    pull = tension * np.stack([np.cos(psi), np.sin(psi)])
    force = np.diff(pull, axis=1)
    at = 0.5 * (holes[:, 1:] + holes[:, :-1])
    arms = [(at, force), (0.5 * (midline[:, 1:] + midline[:, :-1]), line.weight.T)]
    ends = [(holes[:, -1], -pull[:, -1]), (midline[:, -1], line.tip_force)]
    moment, push = np.full(len(phi), line.tip_moment), np.zeros_like(midline)
    for place, f in ends:
        moment += place[0] * f[1] - place[1] * f[0]
        push += f[:, None]
    for place, f in arms:
        moment[:-1] += np.cumsum((place[0] * f[1] - place[1] * f[0])[::-1])[::-1]
        push[:, :-1] += np.cumsum(f[:, ::-1], axis=1)[:, ::-1]
    return moment - (midline[0] * push[1] - midline[1] * push[0])


def _residual(line: Line, kappa: np.ndarray, T_base: float, memory: np.ndarray) -> np.ndarray:
    phi, midline, psi = _shape(line, kappa)
    tension = _tension(line, psi, T_base, memory)
    return (kappa - line.rest - line.compliance * _moment(line, phi, midline, psi, tension)) * line.s[-1]


def _solve(line: Line, kappa: np.ndarray, T_base: float, memory: np.ndarray) -> tuple[np.ndarray, bool]:
    """Newton's method with differences, halving steps that do not help."""
    left = _residual(line, kappa, T_base, memory)
    h = 1e-6 / line.s[-1]
    for _ in range(STEPS):
        size = np.max(np.abs(left))
        if size < TOLERANCE:
            return kappa, True
        columns = [
            (_residual(line, kappa + h * unit, T_base, memory) - left) / h for unit in np.eye(len(kappa))
        ]
        step = np.linalg.solve(np.stack(columns, axis=1), -left)
        for share in 0.5 ** np.arange(12):
            after = _residual(line, kappa + share * step, T_base, memory)
            if np.max(np.abs(after)) < size:
                break
        kappa, left = kappa + share * step, after
    return kappa, bool(np.max(np.abs(left)) < TOLERANCE)


def solve_literal(
    robot: Robot, T_base: float, *, released_from: float | None = None, start: tuple[np.ndarray, np.ndarray]
) -> Literal:
    """One state by the literal integrals.

    The results of two meshes, one of half the spacing, are extrapolated: the trapezoidal rule is of second
    order.

    Args:
        robot: of one tendon, without physics terms.
        T_base: base tension [N].
        released_from: largest base tension before [N], where it is released from there.
        start: arc length [m] and curvature [1/m] to start from, each (M,).

    Returns:
        The state; `settled` is False if Newton's method did not find it.
    """
    found = []
    for count in COARSE, 2 * COARSE:
        line = line_of(robot, count)
        kappa = np.interp(line.s, *start)
        memory, ok = np.full(len(line.s), line.preload), True
        if released_from is not None:
            kappa_max, ok = _solve(line, kappa, released_from, memory)
            memory = _tension(line, _shape(line, kappa_max)[2], released_from, memory)
        kappa, met = _solve(line, kappa, T_base, memory)
        phi, midline, psi = _shape(line, kappa)
        T_tip = _tension(line, psi, T_base, memory)[-1]
        found.append((np.array([midline[0, -1], midline[1, -1], phi[-1], T_tip]), ok and met))
    best = extrapolated(found[0][0], found[1][0])
    return Literal(best[:3], float(best[3]), found[0][1] and found[1][1])
