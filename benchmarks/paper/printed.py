"""Eq. (16) as printed: its integral over s of forces per length of tendon lacks the factor nu = ds_c/ds.

The paper's equilibrium (18) takes the bending moment at s from the anchor (15) and from the channel's
distributed forces beyond s (16). Those, f_n and f_f of (12) and (13), are forces per length of tendon ds_c;
(16) integrates them over ds. With the factor the two moments collapse to the tension at the cut times its
arm, which is what the simulator solves; without it the equilibrium is another one. Here (12), (13), (15),
(16) and (18) are solved as they stand, with the force on each interval times nu^-q: q = 0 is right, q = 1 is
printed.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from gtr_jax.mechanics import channel
from gtr_jax.mechanics.mesh import cumulative, shifted
from gtr_jax.mechanics.sections import Sections
from gtr_jax.robot.robot import Robot, sections

from .paths import T_BASE, states

SOLVER = optx.Newton(rtol=1e-10, atol=1e-10)
STAGES = (0.0, 0.25, 0.5, 0.75, 1.0)  # q, from the right moment to the printed one


class Shape(NamedTuple):
    """What a moment leads to: curvature [1/m] at the nodes, (N,); tip x [m], y [m], angle [rad], (3,); tip
    tension [N]; whether Newton's method settled.
    """

    curvature: Any
    tip: Any
    T_tip: Any
    settled: Any


def _middle(values: Float[Array, " N"]) -> Float[Array, " M"]:
    return 0.5 * (values[1:] + values[:-1])


def _shape(s: Sections, kappa, mu, T_base):
    """Angle, midline, tangent angle, metric and tension at the nodes, from the curvature."""
    phi = cumulative(s.mesh.weights, kappa)
    midline = jnp.stack([cumulative(s.mesh.weights, jnp.cos(phi)), cumulative(s.mesh.weights, jnp.sin(phi))])
    turned = channel.wrap_increment(
        phi - shifted(phi), kappa, shifted(kappa), s.R, s.R.before(), s.mesh.interval
    )
    psi = phi + channel.tangent_lead(kappa, s.R)
    return phi, midline, psi, channel.metric_factor(kappa, s.R), T_base * jnp.exp(-mu * jnp.cumsum(turned))


def literal_moment(s: Sections, kappa: Float[Array, " N"], mu, T_base, q) -> Float[Array, " N"]:
    """Moment on the cut at each node [N m], (N,): (15) plus (16), the latter with nu^-q; of second order.

    Args:
        s: the robot at its nodes.
        kappa: curvature of the midline [1/m].
        mu, T_base: friction coefficient, base tension [N]; the tendon is pulled.
        q: 0 with the factor, 1 as printed.
    """
    phi, midline, psi, metric, tension = _shape(s, kappa, mu, T_base)
    holes = midline + s.R.value[None] * jnp.stack([-jnp.sin(phi), jnp.cos(phi)])
    t, T = _middle(psi), _middle(tension)
    tangent, normal = jnp.stack([jnp.cos(t), jnp.sin(t)]), jnp.stack([-jnp.sin(t), jnp.cos(t)])
    # f_n ds_c = T dpsi, f_f ds_c = dT: the force on the channel between two nodes.
    force = (T * jnp.diff(psi))[None] * normal + jnp.diff(tension)[None] * tangent
    force = force * (_middle(metric) ** -q)[None]
    at = jax.vmap(_middle)(holes)
    anchor = -tension[-1] * jnp.stack([jnp.cos(psi[-1]), jnp.sin(psi[-1])])

    def beyond(values, last):
        """Sum from the tip to each node."""
        return jnp.concatenate([jnp.flip(jnp.cumsum(jnp.flip(values))), jnp.zeros(1)]) + last

    end = holes[:, -1]
    turn = beyond(at[0] * force[1] - at[1] * force[0], end[0] * anchor[1] - end[1] * anchor[0])
    push = jnp.stack([beyond(force[0], anchor[0]), beyond(force[1], anchor[1])])
    return turn - (midline[0] * push[1] - midline[1] * push[0])


@eqx.filter_jit
def solve_literal(robot: Robot, T_base: Float[Array, ""], start: Float[Array, " N"]) -> Shape:
    """The equilibrium (18) with the moments (15) and (16), at each of STAGES; no external load.

    Args:
        robot: as for `equilibrium`, with one tendon and no load.
        T_base: base tension [N].
        start: curvature to start from, (N,).

    Returns:
        A `Shape` of (stages,). A stage that did not settle spoils those after it.
    """
    s, mu = sections(robot), robot.tendon.friction_coefficient
    scale = jnp.max(jnp.abs(start))

    def residual(scaled, q):
        kappa = scale * scaled
        return (kappa - s.rest - s.compliance * literal_moment(s, kappa, mu, T_base, q)) / scale

    def stage(scaled, q):
        found = optx.root_find(residual, SOLVER, scaled, args=q, max_steps=60, throw=False)
        phi, midline, _, _, tension = _shape(s, scale * found.value, mu, T_base)
        tip = jnp.stack([midline[0, -1], midline[1, -1], phi[-1]])
        settled = found.result == optx.RESULTS.successful
        return found.value, Shape(scale * found.value, tip, tension[-1], settled)

    return jax.lax.scan(stage, start / scale, jnp.asarray(STAGES))[1]


class Error(NamedTuple):
    """What the missing factor does to one path.

    moved [m], turned [rad]: of the tip. tension: more at the tip [N]. curvature: largest change, relative to
    the largest curvature. metric: smallest and largest nu. settled: whether all was solved. right, printed:
    tip x [m], y [m], angle [rad] of both equilibria. discretised: how far the tip of the literal form with
    the factor is off that of the identity [m].
    """

    moved: float
    turned: float
    tension: float
    curvature: float
    metric: tuple[float, float]
    settled: bool
    right: np.ndarray
    printed: np.ndarray
    discretised: float


def factor_error(robot: Robot, T_base: float, eq) -> Error:
    """Compare the printed form with the right one on the same nodes.

    Args:
        robot, T_base: the path and its base tension [N].
        eq: its `Equilibrium`.
    """
    shapes = jax.tree_util.tree_map(np.asarray, solve_literal(robot, jnp.asarray(T_base), eq.curvature))
    right, printed = (Shape(*(field[i] for field in shapes)) for i in (0, -1))
    change = np.abs(printed.curvature - right.curvature)
    return Error(
        moved=float(np.hypot(*(printed.tip - right.tip)[:2])),
        turned=float(printed.tip[2] - right.tip[2]),
        tension=float(printed.T_tip - right.T_tip),
        curvature=float(change.max() / np.abs(right.curvature).max()),
        metric=(float(np.min(np.asarray(eq.metric))), float(np.max(np.asarray(eq.metric)))),
        settled=bool(np.all(shapes.settled)) and bool(eq.converged),
        right=right.tip,
        printed=printed.tip,
        discretised=float(np.hypot(*(right.tip - np.asarray(eq.tip_pose))[:2])),
    )


@functools.cache
def errors() -> dict[int, Error]:
    """Of all eight paths, with friction in the fitted material."""
    return {path: factor_error(state.robot, T_BASE[path], state.pulled) for path, state in states().items()}
