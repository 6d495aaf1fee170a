"""Coulomb friction by slip: the law for several tendons, which slide because the body bends under the others.

A single tendon slips only where its tension exceeds what friction can hold, so its tension can be clipped
against the base (`friction.tension`). Beside others, a tendon may slip although its base tension is held,
because the body moves its channel. Then the slip itself decides. A tendon anchored at the tip slips towards
the base, in a load step, by

    u(s) = integral over [s, L] of (nu_before - nu) + STRETCH (T - T_before)/T_unit,

to which the anchor adds STRETCH L (T - T_before)/T_unit of its own tension. Friction opposes the slip: ln T
falls by mu z |psi'| per length, where the mobilisation z follows u until friction is exhausted:

    z = clip(z_before + u/(PRESLIDING L), -1, 1)

Coulomb's law on a tendon that does not stretch is the limit PRESLIDING, STRETCH -> 0, which is not unique:
two tendons locked at one place may share the moment in any proportion, and a channel that never changes
length (straight through the axis, a rigid sheath) would never slip. T_unit is the tension that bends the
robot by about one radian. Written with one unknown xi per interval (z = clip(xi), u = PRESLIDING L (z -
z_before) + L (xi - z)), Newton's method needs neither smoothing nor a list of sticking intervals. Each
evaluation marches once; the Jacobian is dense.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from .. import channel
from ..coulomb import (
    EXACT,
    PRESLIDING,
    ROUND,
    SHORT,
    STRETCH,
    WHOLE,
    kept_near,
    mobilisation,
    slip_of_law,
    unit_tension,
)
from ..mesh import Mesh, shifted
from ..sections import State, at_tendons, largest
from ..tangents import split_tangents
from .adjoint import CausalAdjoint
from .problem import Problem, residual, tension_of

TOLERANCE = 1e-3 * PRESLIDING  # mismatch at which it is solved
MAX_STEPS = 64  # most Newton steps of one search
MOST_PARTS = 64  # most parts of the change of base tension


class Kept(eqx.Module):
    """What tendons remember of the previous step, each (*tendons, N).

    Attributes:
        tension: [N].
        metric: nu = ds_c/ds of the channel.
        mobilisation: of friction between each node and the one before it; None for one tendon, which needs
            its tension only.
    """

    tension: Float[Array, "*tendons N"]
    metric: Float[Array, "*tendons N"]
    mobilisation: Float[Array, "*tendons N"] | None


class Grip(NamedTuple):
    """How friction holds the tendons.

    Attributes:
        xi: the unknown, whose clip to [-1, 1] is the mobilisation between each node and the one before it,
            (*tendons, N).
        error: largest mismatch of slip, relative to the length of the robot, ().
        steps: Newton steps taken, ().
    """

    xi: Float[Array, "*tendons N"]
    error: Float[Array, ""]
    steps: Int[Array, ""]

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether the mismatch met the tolerance."""
        return self.error <= TOLERANCE


def slip(mesh: Mesh, change: Float[Array, "*tendons N"]) -> Float[Array, "*tendons N"]:
    """Slip towards the base [m] between each node and the one before it, (*tendons, N).

    Args:
        mesh: the nodes.
        change: the channel's loss of length plus the tendon's gain, per length of the midline, at the nodes,
            (*tendons, N). The value at a node counts for half of both adjacent intervals: with any wider
            stencil, a stretch without slip would leave `change` free to alternate from node to node.
    """
    half = 0.5 * mesh.interval.length
    cells = half + jnp.concatenate([half[1:], jnp.zeros(1)])
    weighted = change * jnp.broadcast_to(cells, change.shape)
    return jnp.flip(jnp.cumsum(jnp.flip(weighted, -1), axis=-1), -1)


def turning(y: State, p: Problem) -> Float[Array, "*tendons N"]:
    """Turning of the tendons between each node and the one before it [rad], (*tendons, N)."""
    s = p.sections
    midline = (y.phi - shifted(y.phi), y.kappa, shifted(y.kappa), s.mesh.interval)
    turns, kappa, kappa_before, between = at_tendons(midline, s.R)
    return channel.wrap_increment(turns, kappa, kappa_before, s.R, s.R.before(), between)


class _Args(eqx.Module):
    problem: Problem
    kept: Kept
    start: State
    solver: optx.AbstractRootFinder
    max_steps: int = eqx.field(static=True)


def _march(xi, a: _Args) -> tuple[State, Problem]:
    p = dataclasses.replace(a.problem, mobilisation=mobilisation(xi))
    start = jax.lax.stop_gradient(a.start)
    sol = optx.root_find(
        residual, a.solver, start, args=p, adjoint=CausalAdjoint(), max_steps=a.max_steps, throw=False
    )
    return sol.value, p


def mismatch(xi: Float[Array, "*tendons N"], a: _Args) -> Float[Array, "*tendons N"]:
    """Slip required by the friction law minus slip that follows from the body's shape, over its length."""
    y, p = _march(xi, a)
    s, kept = p.sections, a.kept
    assert kept.mobilisation is not None, "several tendons remember how far friction is mobilised"
    metric = channel.metric_factor(at_tendons(y.kappa, s.R), s.R)
    tension = tension_of(y, p)
    stretch = STRETCH * (tension - kept.tension) / unit_tension(s)
    given = slip(s.mesh, kept.metric - metric + stretch) / s.mesh.s[-1] + stretch[..., -1:]
    wanted = slip_of_law(xi, kept.mobilisation)
    base = at_tendons(s.mesh.interval.joined, s.R) == 0.0  # no interval before it
    return jnp.where(base, xi, wanted - given)


def _jacobian(xi, a: _Args):
    def flat(x):
        return mismatch(x.reshape(xi.shape), a).ravel()

    return jax.jacfwd(flat)(xi.ravel())


def _newton(xi, a: _Args) -> Grip:
    """Newton's method from `xi`."""

    def unfinished(carry):
        _, error, before, steps = carry
        improves = (error > TOLERANCE) | (error < 0.5 * before)
        return (error > EXACT) & improves & jnp.isfinite(error) & (steps < MAX_STEPS)

    def newton(carry):
        xi, error, _, steps = carry
        change = jnp.linalg.solve(_jacobian(xi, a), mismatch(xi, a).ravel()).reshape(xi.shape)
        share = jnp.where(steps % ROUND < WHOLE, 1.0, SHORT)
        xi = kept_near(xi - share * change, xi)
        return xi, largest(mismatch(xi, a).ravel()), error, steps + 1

    error = largest(mismatch(xi, a).ravel())
    start = (xi, error, jnp.full_like(error, jnp.inf), jnp.asarray(0))
    xi, error, _, steps = jax.lax.while_loop(unfinished, newton, start)
    return Grip(xi, error, steps)


@eqx.filter_custom_jvp
def _solve(inputs) -> Grip:
    """Newton's method; where it fails, again by way of more and more base tensions in between."""
    xi, a = inputs
    before, after = a.kept.tension[..., 0], a.problem.T_base

    def by_way_of(parts):
        def closer(i, grip):
            share = (i + 1.0) / parts
            between = jnp.where(i + 1 == parts, after, before + share * (after - before))
            done = _newton(
                grip.xi, dataclasses.replace(a, problem=dataclasses.replace(a.problem, T_base=between))
            )
            return done._replace(steps=done.steps + grip.steps)

        return closer

    def unsolved(carry):
        grip, parts = carry
        return ~grip.converged & (parts <= MOST_PARTS)

    def again(carry):
        grip, parts = carry
        return jax.lax.fori_loop(0, parts, by_way_of(parts), grip._replace(xi=xi)), parts * 4

    untried = Grip(xi, jnp.asarray(jnp.inf), jnp.asarray(0))
    return jax.lax.while_loop(unsolved, again, (untried, jnp.asarray(1)))[0]


@_solve.def_jvp
def _solve_jvp(primals, tangents):
    """d xi = -J^-1 (dm/dp) dp at the root of the mismatch m(xi, p)."""
    (xi0, a), a_dot = primals[0], tangents[0][1]
    grip = _solve((xi0, a))
    moving, fixed = split_tangents(a, a_dot)
    change = jax.jvp(lambda m: mismatch(grip.xi, eqx.combine(m, fixed)), (moving,), (a_dot,))[1]
    xi_dot = -jnp.linalg.solve(_jacobian(grip.xi, a), change.ravel()).reshape(change.shape)
    zero = jax.custom_derivatives.zero_from_primal(Grip(grip.xi, grip.error, grip.steps), symbolic_zeros=True)
    return grip, zero._replace(xi=xi_dot)


def hold(
    p: Problem,
    kept: Kept,
    start: State,
    xi: Float[Array, "*tendons N"],
    solver: optx.AbstractRootFinder,
    max_steps: int,
) -> Grip:
    """Find how friction holds the tendons in one load step; differentiable in the problem and what is kept.

    Args:
        p: the problem, whose mobilisation is ignored.
        kept: what the tendons remember.
        start: state to start from.
        xi: unknown to start from, that of the previous step or zero.
        solver, max_steps: for the equilibrium with known mobilisation.
    """
    a = _Args(p, kept, start, solver, max_steps)
    return _solve((jax.lax.stop_gradient(xi), a))
