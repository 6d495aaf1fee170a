"""Linear solves of `whole_pull.residual`: one causal recursion instead of an N x N factorisation.

Linearised, each node's curvature, angle, tension and external moment follow from its predecessors; only the
external moment at the base is unknown, and a second recursion carries its effect to the tip, where it is
closed. Cost O(N); exact.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Float

from gtr_jax.mechanics import channel
from gtr_jax.mechanics.mesh import STENCIL, shifted
from gtr_jax.mechanics.sections import State, moment_slope

from .whole_pull import Pull, tension, tension_of


class Linearisation(eqx.Module):
    """Partial derivatives of the node equations at a state, each (N,).

    Attributes:
        weights: quadrature weights (N, 4).
        diagonal: d(moment balance)/d(kappa) at fixed tension and moment.
        compliance: 1/EI.
        rate: d(bending)/d(wrap), compliance times moment arm times dT/d(wrap).
        by_turn, by_kappa, by_kappa_before: d(wrap increment)/d(phi_i - phi_(i-1)), /d(kappa_i),
            /d(kappa_(i-1)).
        load: d(M_ext')/d(phi).
        loaded: as in `Pull`.
    """

    weights: Float[Array, "N 4"]
    diagonal: Float[Array, " N"]
    compliance: Float[Array, " N"]
    rate: Float[Array, " N"]
    by_turn: Float[Array, " N"]
    by_kappa: Float[Array, " N"]
    by_kappa_before: Float[Array, " N"]
    load: Float[Array, " N"]
    loaded: bool = eqx.field(static=True)


def _partials(fn, *args):
    """Elementwise partial derivatives of fn(*args) with respect to each argument."""
    zeros = [jnp.zeros_like(a) for a in args]
    out = []
    for i, a in enumerate(args):
        tangents = [*zeros[:i], jnp.ones_like(a), *zeros[i + 1 :]]
        out.append(jax.jvp(fn, args, tuple(tangents))[1])
    return out


def linearise(y: State, p: Pull) -> Linearisation:
    """Partial derivatives of the residual at y; elementwise, so it costs a few residuals."""
    s = p.sections

    def wrap(turn, kappa, kappa_before):
        return channel.wrap_increment(turn, kappa, kappa_before, s.R, s.R.before(), s.mesh.interval)

    turn = y.phi - shifted(y.phi)
    by_turn, by_kappa, by_kappa_before = _partials(wrap, turn, y.kappa, shifted(y.kappa))
    arm, arm_slope = jax.jvp(lambda k: channel.moment_arm(k, s.R), (y.kappa,), (jnp.ones_like(y.kappa),))
    (by_wrap,) = _partials(lambda w: tension(p.T_base, w, p.memory, p.mu), y.wrap)
    return Linearisation(
        weights=s.mesh.weights,
        diagonal=1.0 - s.compliance * tension_of(y, p) * arm_slope,
        compliance=s.compliance,
        rate=s.compliance * arm * by_wrap,
        by_turn=by_turn,
        by_kappa=by_kappa,
        by_kappa_before=by_kappa_before,
        load=_partials(moment_slope, y.phi, *s.force)[0] if p.loaded else jnp.zeros_like(y.phi),
        loaded=p.loaded,
    )


def _recursion(a: Linearisation, r: State, moment_base) -> State:
    """Forward recursion for a given change of the external moment at the base (ignored without external
    force).
    """
    w = a.weights

    def node(carry, x):
        kappas, loads, wrap_before, phi_before, moment_before = carry
        w_i, diagonal, compliance, rate, by_turn, by_k, by_kb, load, rk, rp, rw, rm = x
        turn = rp + w_i[1] * kappas[0] + w_i[2] * kappas[1] + w_i[3] * kappas[2]
        wrap = rw + wrap_before + by_turn * turn + by_kb * kappas[0]
        wrap_k = by_turn * w_i[0] + by_k
        if a.loaded:
            moment = rm + moment_before + w_i[1] * loads[0] + w_i[2] * loads[1] + w_i[3] * loads[2]
            moment = moment + w_i[0] * load * (phi_before + turn)
            moment_k = w_i[0] * load * w_i[0]
        else:
            moment, moment_k = rm, 0.0
        kappa = rk + rate * wrap + compliance * moment
        kappa = kappa / (diagonal - rate * wrap_k - compliance * moment_k)
        phi = phi_before + turn + w_i[0] * kappa
        out = State(kappa, phi, wrap + wrap_k * kappa, moment + moment_k * kappa)
        carry = ((kappa, *kappas[:-1]), (load * phi, *loads[:-1]), out.wrap, out.phi, out.moment)
        return carry, out

    zero = jnp.zeros_like(r.kappa[0])
    start = ((zero,) * (STENCIL - 1), (zero,) * (STENCIL - 1), zero, zero, zero + moment_base)
    rm = r.moment.at[0].set(0.0) if a.loaded else r.moment
    rows = (w, a.diagonal, a.compliance, a.rate, a.by_turn, a.by_kappa, a.by_kappa_before, a.load)
    return jax.lax.scan(node, start, (*rows, r.kappa, r.phi, r.wrap, rm))[1]


def solve_linearised(a: Linearisation, r: State) -> State:
    """Solve J x = r for the Jacobian J of the residual."""
    if not a.loaded:
        return _recursion(a, r, 0.0)
    particular = _recursion(a, r, 0.0)
    zero = jnp.zeros_like(a.diagonal)
    by_moment = _recursion(a, State(zero, zero, zero, zero), 1.0)
    moment_base = (r.moment[0] - particular.moment[-1]) / by_moment.moment[-1]
    return jtu.tree_map(lambda x, h: x + moment_base * h, particular, by_moment)
