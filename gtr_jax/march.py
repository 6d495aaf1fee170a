"""The march: the equilibrium solver. From the base to the tip, one scalar Newton per node; shooting for external forces.

Given the external moment at the base, every node's curvature is the root of one scalar equation in what lies between it and the
base, so a single pass solves the nonlinear problem, whatever the tension loss, and needs no good start. With external forces
the moment at the base is shot for: its tangent is carried along, the closing error at the tip updates it, and the pass repeats.
Written as an optimistix root finder, so that results, step counts and implicit gradients are optimistix's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Float

from . import channel, friction
from .mesh import STENCIL
from .problem import Problem, State, moment_slope, residual_norm
from .routing import Offset

NODE_NEWTON_STEPS = 3


def march(p: Problem, kappa_guess: Float[Array, " N"], moment_base: Float[Array, ""]) -> State:
    """One pass base to tip.

    Args:
        p: the problem.
        kappa_guess: start of each node's scalar Newton [1/m], (N,).
        moment_base: external moment at the base [N m]; without external force, the tip moment.

    Returns:
        The state; without external force it is the solution, with it M_ext(L) still differs from the tip moment.
    """
    s = p.sections

    def node(carry, x):
        kappas, slopes, phi_before, tension_before, moment_before, R_before = carry
        R, compliance, rest, fx, fy, w, length, joined, memory, guess = x
        turn_known = w[1] * kappas[0] + w[2] * kappas[1] + w[3] * kappas[2]
        moment_known = moment_before + w[1] * slopes[0] + w[2] * slopes[1] + w[3] * slopes[2]

        def balance(kappa):
            turn = turn_known + w[0] * kappa
            wrap = channel.wrap_increment(turn, kappa, kappas[0], R, R_before, length, joined)
            tension = friction.transmit(tension_before, wrap, memory, p.mu)
            phi = phi_before + turn
            if p.loaded:
                slope = moment_slope(phi, fx, fy)
                moment = moment_known + w[0] * slope
            else:
                slope, moment = jnp.zeros_like(phi), moment_before
            error = kappa - rest - compliance * (tension * channel.moment_arm(kappa, R) + moment)
            return error, (phi, tension, moment, slope)

        kappa = guess
        for _ in range(NODE_NEWTON_STEPS):
            error, rate, _ = jax.jvp(balance, (kappa,), (jnp.ones_like(kappa),), has_aux=True)
            kappa = kappa - error / jnp.maximum(rate, 0.3)
        _, (phi, tension, moment, slope) = balance(kappa)
        carry = ((kappa, *kappas[:-1]), (slope, *slopes[:-1]), phi, tension, moment, R)
        return carry, State(kappa, phi, tension, moment)

    zero = jnp.zeros_like(p.T_base)
    R_base = Offset(*(r[0] for r in s.R))
    history = (zero,) * (STENCIL - 1)
    start = (history, history, zero, p.T_base, zero + moment_base, R_base)
    rows = (s.R, s.compliance, s.rest, s.force_x, s.force_y, s.mesh.weights, s.mesh.length, s.mesh.joined)
    return jax.lax.scan(node, start, (*rows, p.memory, kappa_guess))[1]


class _MarchState(eqx.Module):
    error: Float[Array, ""]
    error_before: Float[Array, ""]


class March(optx.AbstractRootFinder):
    """optimistix root finder by marching; `args` must be a `Problem`, `y` a `State`.

    Attributes:
        atol: largest `residual_norm` at which it stops; rtol is not used.
    """

    rtol: float = 0.0
    atol: float = 1e-10
    norm: Callable = optx.max_norm

    def init(self, fn, y, args: Problem, options: dict[str, Any], f_struct, aux_struct, tags):
        del fn, y, options, f_struct, aux_struct, tags
        return _MarchState(jnp.full_like(args.T_base, jnp.inf), jnp.full_like(args.T_base, jnp.inf))

    def step(self, fn, y: State, args: Problem, options, state, tags):
        del options, tags
        if args.loaded:
            tangent = jnp.ones_like(args.T_base)
            new, by_moment = jax.jvp(lambda m: march(args, y.kappa, m), (y.moment[0],), (tangent,))
            shot = (args.tip_moment - new.moment[-1]) / by_moment.moment[-1]
            new = jtu.tree_map(lambda a, b: a + shot * b, new, by_moment)
        else:
            new = march(args, y.kappa, args.tip_moment)
        f, aux = fn(new, args)
        return new, _MarchState(residual_norm(f, args), state.error), aux

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        broken = jnp.isnan(state.error)
        result = optx.RESULTS.where(broken, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return broken | (state.error <= self.atol), result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, tags, result
        return y, aux, {"residual_norm": state.error}
