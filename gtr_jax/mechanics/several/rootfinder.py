"""The march: the equilibrium solver, from the base to the tip, one scalar equation per node.

Given the external moment at the base, every node's curvature is the root of one scalar equation that depends
on the preceding nodes only, so a single pass solves the nonlinear problem, whatever the tension loss, and
needs no good start. With external forces the moment at the base is found by shooting: the closing error at
the tip, divided by its derivative along the linearised pass, updates it, and the pass repeats. Written as an
optimistix root finder, so that results, step counts and implicit gradients are optimistix's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from .. import channel
from ..mesh import STENCIL
from ..sections import State, at_tendons, largest, moment_slope, node_first, over_tendons
from .linear_solver import linearise, response_to_base_moment
from .problem import Problem, mobilised, residual, residual_norm, tension_at

NEWTON_STEPS = 2  # per node; see `march`
FLATTEST = 0.3  # slope of the moment balance below which a step is shortened


class Marched(NamedTuple):
    """Result of a march: the state, and the residual of each node's moment balance [1/m], (N,)."""

    state: State
    error: Float[Array, " N"]


def march(
    p: Problem, moment_base: Float[Array, ""], guess: Float[Array, " N"], use_guess: Bool[Array, ""] | bool
) -> Marched:
    """One pass base to tip.

    Each node's moment balance is one scalar equation in its curvature with a slope close to 1. It starts from
    the curvature the node would have without friction since its predecessor (or from `guess`) and takes two
    Newton steps, which reach rounding; cheaper rules often need a second pass
    (`benchmarks/node_equation.py`). Angle, tension and moment follow exactly from the curvature, so the error
    returned is the whole residual.

    Args:
        p: the problem.
        moment_base: external moment at the base [N m]; without external force, the tip moment.
        guess: curvature to start from [1/m], (N,).
        use_guess: whether to start from it.

    Returns:
        The state; without external force it is the solution, with it M_ext(L) still differs from the tip
        moment.
    """
    s = p.sections

    def node(carry, x):
        kappas, slopes, phi_before, wrap_before, tension_before, moment_before = carry
        R, R_before, compliance, rest, fx, fy, w, between, memory, mobilisation, guess = x
        turn_known = w[1] * kappas[0] + w[2] * kappas[1] + w[3] * kappas[2]

        def balance(kappa):
            turn = turn_known + w[0] * kappa
            midline = at_tendons((turn, kappa, kappas[0]), R)
            turned = channel.wrap_increment(*midline, R, R_before, at_tendons(between, R))
            wrap = wrap_before + mobilised(turned, mobilisation)
            tension = tension_at(p.T_base, wrap, memory, p.mu)
            phi = phi_before + turn
            if p.loaded:
                slope = moment_slope(phi, fx, fy)
                known = w[1] * slopes[0] + w[2] * slopes[1] + w[3] * slopes[2]
                moment, slope_history = moment_before + known + w[0] * slope, (slope, *slopes[:-1])
            else:
                moment, slope_history = moment_before, slopes
            pulled = over_tendons(tension * channel.moment_arm(midline[1], R), 0)
            error = kappa - rest - compliance * (pulled + moment)
            return error, (phi, wrap, tension, moment, slope_history)

        near = rest
        for _ in range(2):
            pulled = over_tendons(tension_before * channel.moment_arm(at_tendons(near, R), R), 0)
            near = rest + compliance * (pulled + moment_before)
        kappa = jnp.where(use_guess, guess, near)
        for _ in range(NEWTON_STEPS):
            error, slope = jax.jvp(lambda k: balance(k)[0], (kappa,), (jnp.ones_like(kappa),))
            kappa = kappa - error / jnp.maximum(slope, FLATTEST)
        error, (phi, wrap, tension, moment, slopes) = balance(kappa)
        carry = (kappa, *kappas[:-1]), slopes, phi, wrap, tension, moment
        return carry, Marched(State(kappa, phi, wrap, moment), error)

    zero = jnp.zeros_like(moment_base)
    history = (zero,) * (STENCIL - 1)
    slopes = history[: len(history) * p.loaded]
    start = (history, slopes, zero, jnp.zeros_like(p.T_base), p.T_base, moment_base)
    R, R_before, *law = s.R.rows(), s.R.before().rows(), *node_first((p.memory, p.mobilisation))
    rows = (R, R_before, s.compliance, s.rest, *s.force)
    rows = (*rows, s.mesh.weights, s.mesh.interval, *law, guess)
    y, error = jax.lax.scan(node, start, rows)[1]
    return Marched(State(y.kappa, y.phi, jnp.moveaxis(y.wrap, 0, -1), y.moment), error)


class _MarchState(eqx.Module):
    """Where the search stands.

    Attributes:
        error: residual norm at the present share of the load.
        share, share_done: share of the external load being solved, and the largest one solved.
        stride: next increase of the share.
        tries: marches taken at this share.
        done: curvature and base moment solved at `share_done`.
    """

    error: Float[Array, ""]
    share: Float[Array, ""]
    share_done: Float[Array, ""]
    stride: Float[Array, ""]
    tries: Int[Array, ""]
    done: tuple[Float[Array, " N"], Float[Array, ""]]


def _with_share(p: Problem, share: Float[Array, ""]) -> Problem:
    """The problem with its external forces and tip moment scaled."""
    s = p.sections
    return eqx.tree_at(
        lambda q: (q.sections.force, q.tip_moment),
        p,
        (tuple(force * share for force in s.force), p.tip_moment * share),
    )


class RootFinder(optx.AbstractRootFinder):
    """optimistix root finder by marching; `args` must be a `Problem`, `y` a `State`.

    Without external force one or two marches solve it. With one, Newton's method finds the moment at the
    base, starting from `y`; if that does not converge, the load is applied in shares, each started from the
    last one solved.

    Attributes:
        atol: largest `residual_norm` at which it stops; rtol is not used.
        patience: marches at one share of the load before a smaller share is tried.
        smallest_stride: share of the load below which it gives up (result `nonlinear_divergence`).
    """

    rtol: float = 0.0
    atol: float = 1e-9
    norm: Callable = optx.max_norm
    patience: int = 8
    smallest_stride: float = 1e-3

    def init(self, fn, y: State, args: Problem, options: dict[str, Any], f_struct, aux_struct, tags):
        del fn, options, f_struct, aux_struct, tags
        one = jnp.ones_like(args.tip_moment)
        return _MarchState(
            error=one * jnp.inf,
            share=one,
            share_done=0.0 * one,
            stride=0.5 * one,
            tries=jnp.asarray(0),
            done=(y.kappa, 0.0 * one),
        )

    def step(self, fn, y: State, args: Problem, options, state: _MarchState, tags):
        del options, tags
        _, aux = fn(y, args)
        if not args.loaded:
            new, missing = march(args, args.tip_moment, y.kappa, state.tries > 0)
            error = largest(missing) * args.sections.mesh.s[-1]
            return new, eqx.tree_at(lambda s: (s.error, s.tries), state, (error, state.tries + 1)), aux

        p = _with_share(args, state.share)
        new, _ = march(p, y.moment[0], y.kappa, state.tries > 0)
        by_moment = response_to_base_moment(linearise(new, p))
        shot = (p.tip_moment - new.moment[-1]) / by_moment.moment[-1]
        new = jtu.tree_map(lambda v, d: v + shot * d, new, by_moment)
        error = residual_norm(residual(new, p), p)

        solved = error <= self.atol
        onward = solved & (state.share < 1.0)
        lost = ~solved & ((state.tries + 1 >= self.patience) | ~jnp.isfinite(error))
        kappa_done = jnp.where(onward, new.kappa, state.done[0])
        moment_done = jnp.where(onward, new.moment[0], state.done[1])
        share_done = jnp.where(onward, state.share, state.share_done)
        stride = jnp.where(onward, 1.5 * state.stride, jnp.where(lost, 0.5 * state.stride, state.stride))
        share = jnp.where(onward | lost, jnp.minimum(share_done + stride, 1.0), state.share)
        y = State(
            kappa=jnp.where(lost, kappa_done, new.kappa),
            phi=jnp.where(lost, y.phi, new.phi),
            wrap=jnp.where(lost, y.wrap, new.wrap),
            moment=jnp.where(lost, moment_done, new.moment),
        )
        tries = jnp.where(onward | lost, 0, state.tries + 1)
        # Solving an intermediate share does not solve the problem.
        error = jnp.where(onward, jnp.inf, error)
        return y, _MarchState(error, share, share_done, stride, tries, (kappa_done, moment_done)), aux

    def terminate(self, fn, y, args, options, state: _MarchState, tags):
        del fn, y, options, tags
        if args.loaded:
            broken = state.stride < self.smallest_stride
        else:
            broken = jnp.isnan(state.error)
        result = optx.RESULTS.where(broken, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return broken | (state.error <= self.atol), result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, tags, result
        return y, aux, {"residual_norm": state.error}
