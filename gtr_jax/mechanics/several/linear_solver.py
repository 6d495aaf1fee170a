"""The structured linear solver: one causal recursion instead of an N x N factorisation.

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

from .. import channel
from ..mesh import STENCIL, shifted
from ..sections import State, at_tendons, moment_slope, node_first, over_tendons
from .problem import Problem, mobilised, tension_at, tension_of


class Linearisation(eqx.Module):
    """Partial derivatives of the node equations at a state, each (N,), or (*tendons, N) where stated.

    Attributes:
        weights: quadrature weights (N, 4).
        diagonal: d(moment balance)/d(kappa) at fixed tension and moment.
        compliance: 1/EI.
        rate: d(bending)/d(wrap_i), compliance times moment arm times dT_i/d(wrap_i), (*tendons, N).
        by_turn, by_kappa, by_kappa_before: d(wrap increment)/d(phi_i - phi_(i-1)), /d(kappa_i),
            /d(kappa_(i-1)), (*tendons, N).
        load: d(M_ext')/d(phi).
        loaded: as in Problem.
    """

    weights: Float[Array, "N 4"]
    diagonal: Float[Array, " N"]
    compliance: Float[Array, " N"]
    rate: Float[Array, "*tendons N"]
    by_turn: Float[Array, "*tendons N"]
    by_kappa: Float[Array, "*tendons N"]
    by_kappa_before: Float[Array, "*tendons N"]
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


def linearise(y: State, p: Problem) -> Linearisation:
    """Partial derivatives of `problem.residual` at y; elementwise, so it costs a few residuals."""
    s = p.sections
    geometry = at_tendons((y.phi - shifted(y.phi), y.kappa, shifted(y.kappa)), s.R)
    before, between = s.R.before(), at_tendons(s.mesh.interval, s.R)

    def wrap(turn, kappa, kappa_before):
        turned = channel.wrap_increment(turn, kappa, kappa_before, s.R, before, between)
        return mobilised(turned, p.mobilisation)

    kappa = geometry[1]
    arm, arm_slope = jax.jvp(lambda k: channel.moment_arm(k, s.R), (kappa,), (jnp.ones_like(kappa),))
    by_turn, by_kappa, by_kappa_before = _partials(wrap, *geometry)
    T_base, mu = p.T_base[..., None], p.mu[..., None]
    (by_wrap,) = _partials(lambda w: tension_at(T_base, w, p.memory, mu), y.wrap)
    return Linearisation(
        weights=s.mesh.weights,
        diagonal=1.0 - s.compliance * over_tendons(tension_of(y, p) * arm_slope, 1),
        compliance=s.compliance,
        rate=at_tendons(s.compliance, s.R) * arm * by_wrap,
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
        kappa = rk + over_tendons(rate * wrap, 0) + compliance * moment
        kappa = kappa / (diagonal - over_tendons(rate * wrap_k, 0) - compliance * moment_k)
        phi = phi_before + turn + w_i[0] * kappa
        out = State(kappa, phi, wrap + wrap_k * kappa, moment + moment_k * kappa)
        carry = ((kappa, *kappas[:-1]), (load * phi, *loads[:-1]), out.wrap, out.phi, out.moment)
        return carry, out

    zero = jnp.zeros_like(r.kappa[0])
    no_wrap = jnp.zeros_like(r.wrap[..., 0])
    start = ((zero,) * (STENCIL - 1), (zero,) * (STENCIL - 1), no_wrap, zero, zero + moment_base)
    rm = r.moment.at[0].set(0.0) if a.loaded else r.moment
    per_tendon = (a.rate, a.by_turn, a.by_kappa, a.by_kappa_before)
    rate, by_turn, by_kappa, by_kappa_before, rw = node_first((*per_tendon, r.wrap))
    rows = (w, a.diagonal, a.compliance, rate, by_turn, by_kappa, by_kappa_before, a.load)
    y = jax.lax.scan(node, start, (*rows, r.kappa, r.phi, rw, rm))[1]
    return State(y.kappa, y.phi, jnp.moveaxis(y.wrap, 0, -1), y.moment)


def response_to_base_moment(a: Linearisation) -> State:
    """Change of the state per external moment at the base [1/(N m)]; only the tip's equation is violated."""
    zero = jnp.zeros_like(a.diagonal)
    return _recursion(a, State(zero, zero, jnp.zeros_like(a.rate), zero), 1.0)


def solve_linearised(a: Linearisation, r: State) -> State:
    """Solve J x = r for the Jacobian J of `problem.residual`."""
    if not a.loaded:
        return _recursion(a, r, 0.0)
    particular = _recursion(a, r, 0.0)
    homogeneous = response_to_base_moment(a)
    moment_base = (r.moment[0] - particular.moment[-1]) / homogeneous.moment[-1]
    return jtu.tree_map(lambda x, h: x + moment_base * h, particular, homogeneous)
