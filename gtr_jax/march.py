"""The march: the equilibrium solver. From the base to the tip, one scalar equation per node; shooting for external forces.

Given the external moment at the base, every node's curvature is the root of one scalar equation in what lies between it and the
base, so a single pass solves the nonlinear problem, whatever the tension loss, and needs no good start. With external forces
the moment at the base is shot for: its tangent is carried along, the closing error at the tip updates it, and the pass repeats.
Written as an optimistix root finder, so that results, step counts and implicit gradients are optimistix's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Bool, Float

from . import channel, friction
from .linear_solver import linearise, response_to_base_moment
from .mesh import STENCIL
from .problem import Problem, State, moment_slope, offset_before, residual_norm

FLATTEST = 0.3


class Marched(NamedTuple):
    """What a march leaves: the state, and what is still missing in each node's moment balance [1/m], (N,)."""

    state: State
    error: Float[Array, " N"]


def march(
    p: Problem, moment_base: Float[Array, ""], guess: Float[Array, " N"], use_guess: Bool[Array, ""] | bool
) -> Marched:
    """One pass base to tip.

    Each node's moment balance is one scalar equation in its curvature with a slope close to 1. It starts from the curvature the
    node would have without friction since its predecessor (or from `guess`) and takes a fixed-point and a secant step.
    Angle, tension and moment follow exactly from the curvature, so the error returned is the whole residual.

    Args:
        p: the problem.
        moment_base: external moment at the base [N m]; without external force, the tip moment.
        guess: curvature to start from [1/m], (N,).
        use_guess: whether to start from it.

    Returns:
        The state; without external force it is the solution, with it M_ext(L) still differs from the tip moment.
    """
    s = p.sections

    def node(carry, x):
        kappas, slopes, phi_before, tension_before, moment_before = carry
        R, R_before, compliance, rest, fx, fy, w, between, memory, guess = x
        turn_known = w[1] * kappas[0] + w[2] * kappas[1] + w[3] * kappas[2]

        def balance(kappa):
            turn = turn_known + w[0] * kappa
            wrap = channel.wrap_increment(turn, kappa, kappas[0], R, R_before, between)
            tension = friction.transmit(tension_before, wrap, memory, p.mu)
            phi = phi_before + turn
            if p.loaded:
                slope = moment_slope(phi, fx, fy)
                known = w[1] * slopes[0] + w[2] * slopes[1] + w[3] * slopes[2]
                moment, slope_history = moment_before + known + w[0] * slope, (slope, *slopes[:-1])
            else:
                moment, slope_history = moment_before, ()
            error = kappa - rest - compliance * (tension * channel.moment_arm(kappa, R) + moment)
            return error, (phi, tension, moment, slope_history)

        near = rest + compliance * (tension_before * channel.moment_arm(rest, R) + moment_before)
        near = rest + compliance * (tension_before * channel.moment_arm(near, R) + moment_before)
        first = jnp.where(use_guess, guess, near)
        error_first = balance(first)[0]
        second = first - error_first
        error_second = balance(second)[0]
        rate = 1.0 - error_second / jnp.where(error_first == 0, 1.0, error_first)
        kappa = second - error_second / jnp.maximum(rate, FLATTEST)
        error, (phi, tension, moment, slopes) = balance(kappa)
        carry = (kappa, *kappas[:-1]), slopes, phi, tension, moment
        return carry, Marched(State(kappa, phi, tension, moment), error)

    zero = jnp.zeros_like(p.T_base)
    history = (zero,) * (STENCIL - 1)
    start = (history, history if p.loaded else (), zero, p.T_base, zero + moment_base)
    rows = (s.R, offset_before(s.R), s.compliance, s.rest, s.force_x, s.force_y)
    rows = (*rows, s.mesh.weights, s.mesh.interval, p.memory, guess)
    return jax.lax.scan(node, start, rows)[1]


class _MarchState(eqx.Module):
    error: Float[Array, ""]
    taken: Bool[Array, ""]


class March(optx.AbstractRootFinder):
    """optimistix root finder by marching; `args` must be a `Problem`, `y` a `State`.

    Attributes:
        atol: largest `residual_norm` at which it stops; rtol is not used.
    """

    rtol: float = 0.0
    atol: float = 1e-9
    norm: Callable = optx.max_norm

    def init(self, fn, y, args: Problem, options: dict[str, Any], f_struct, aux_struct, tags):
        del fn, y, options, f_struct, aux_struct, tags
        return _MarchState(jnp.full_like(args.T_base, jnp.inf), jnp.asarray(False))

    def step(self, fn, y: State, args: Problem, options, state, tags):
        del options, tags
        base = y.moment[0] if args.loaded else args.tip_moment
        new, missing = march(args, base, y.kappa, state.taken)
        error = jnp.max(jnp.abs(missing)) * args.sections.mesh.s[-1]
        if args.loaded:
            a = linearise(new, args)
            by_moment = response_to_base_moment(a)
            shot = (args.tip_moment - new.moment[-1]) / by_moment.moment[-1]
            new = jtu.tree_map(lambda v, d: v + shot * d, new, by_moment)
        f, aux = fn(new, args)
        if args.loaded:
            error = residual_norm(f, args)
        return new, _MarchState(error, jnp.asarray(True)), aux

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        broken = jnp.isnan(state.error)
        result = optx.RESULTS.where(broken, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return broken | (state.error <= self.atol), result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, tags, result
        return y, aux, {"residual_norm": state.error}
