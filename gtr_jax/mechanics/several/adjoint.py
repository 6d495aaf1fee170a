"""Derivatives of the equilibrium by the implicit function theorem, through the structured linear solve.

optimistix's own `ImplicitAdjoint` solves through lineax, which reports failures by calling back into Python:
such programs cannot be kept in JAX's compilation cache, and pay for the call. The causal recursion cannot
fail other than by giving NaN, so it is used directly.
"""

from __future__ import annotations

import functools

import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx

from ..sections import State
from ..tangents import split_tangents
from .linear_solver import linearise, solve_linearised
from .problem import Problem, residual

ARGS = 3  # place of args in what optimistix passes to adjoints: (fn, solver, y0, args, ...)


class CausalAdjoint(optx.AbstractAdjoint):
    """Implicit adjoint for root finds on `problem.residual` with `args=Problem`; forward and reverse mode."""

    def apply(self, primal_fn, rewrite_fn, inputs, tags):
        del rewrite_fn, tags
        if not isinstance(inputs[ARGS], Problem):
            raise TypeError("CausalAdjoint differentiates root finds with args=Problem only")
        return _solved(primal_fn, (*inputs, functools.partial(eqxi.while_loop, kind="lax")))


@eqx.filter_custom_jvp
def _solved(primal_fn, inputs):
    return jtu.tree_map(jnp.asarray, primal_fn(inputs))


@_solved.def_jvp
def _solved_jvp(primals, tangents):
    """dy = -J^-1 (dF/dp) dp at the root y(p) of F(y, p)."""
    primal_fn, inputs = primals
    root, rest = _solved(primal_fn, inputs)
    p, p_dot = inputs[ARGS], tangents[1][ARGS]
    moving, fixed = split_tangents(p, p_dot)
    change = jax.jvp(lambda m: residual(root, eqx.combine(m, fixed)), (moving,), (p_dot,))[1]
    root_dot: State = jtu.tree_map(jnp.negative, solve_linearised(linearise(root, p), change))
    return (root, rest), (root_dot, jax.custom_derivatives.zero_from_primal(rest, symbolic_zeros=True))
