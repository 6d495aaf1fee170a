"""The rivals of the march: other root finders for one residual, `whole_pull.residual`.

`equilibrium` takes each of them and the march. They solve the same discrete equations from the same
start, so their solutions agree and only their cost and their reach differ.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float, Int

from gtr_jax import Equilibrium, Robot, SolverOptions
from gtr_jax import equilibrium as gtr_equilibrium
from gtr_jax.mechanics import channel, rest_state
from gtr_jax.mechanics.mesh import increments, shifted
from gtr_jax.mechanics.sections import State, moment_slope
from gtr_jax.simulation.solution import Loaded, describe

from .causal_solve import linearise, solve_linearised
from .whole_pull import Pull, residual, residual_norm, tension_of

MAX_STEPS = 256  # of a root finder


class _RootFinder(optx.AbstractRootFinder):
    """What the candidates share: they stop at `atol` in `residual_norm`, or when it is no longer a number."""

    rtol: float = 0.0
    atol: float = 1e-9
    norm: Callable = optx.max_norm

    def terminate(self, fn, y, args, options, state, tags):
        del fn, y, args, options, tags
        broken = jnp.isnan(state.error)
        result = optx.RESULTS.where(broken, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return broken | (state.error <= self.atol), result

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        del fn, args, options, tags, result
        return y, aux, {"residual_norm": state.error}


class _NewtonState(eqx.Module):
    error: Float[Array, ""]


class StructuredNewton(_RootFinder):
    """Newton's method on all nodes at once, each step one causal recursion (two with external forces)."""

    def init(self, fn, y: State, args: Pull, options: dict[str, Any], f_struct, aux_struct, tags):
        del fn, y, options, f_struct, aux_struct, tags
        return _NewtonState(jnp.full_like(args.T_base, jnp.inf))

    def step(self, fn, y: State, args: Pull, options, state, tags):
        del options, state, tags
        f, aux = fn(y, args)
        change = solve_linearised(linearise(y, args), f)
        new = jtu.tree_map(lambda v, d: v - d, y, change)
        return new, _NewtonState(residual_norm(fn(new, args)[0], args)), aux


class DenseNewton(optx.Newton):
    """`optimistix.Newton` as it comes, with the dense Jacobian of all four unknowns per node; for scale."""

    def __init__(self, rtol: float = 1e-9, atol: float = 1e-9):
        super().__init__(rtol=rtol, atol=atol, linear_solver=lx.LU())

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        y, aux, stats = super().postprocess(fn, y, aux, args, options, state, tags, result)
        return y, aux, stats | {"residual_norm": residual_norm(fn(y, args)[0], args)}


def state_of(kappa: Float[Array, " N"], p: Pull) -> State:
    """Angle, wrap and external moment that belong to a curvature: three sums along the backbone."""
    s = p.sections
    phi = jnp.cumsum(increments(s.mesh.weights, kappa))
    wrap = channel.wrap_increment(
        phi - shifted(phi), kappa, shifted(kappa), s.R, s.R.before(), s.mesh.interval
    )
    if p.loaded:
        sums = jnp.cumsum(increments(s.mesh.weights, moment_slope(phi, *s.force)))
        moment = p.tip_moment + sums - sums[-1]
    else:
        moment = jnp.broadcast_to(p.tip_moment, kappa.shape)
    return State(kappa, phi, jnp.cumsum(wrap), moment)


class _AndersonState(eqx.Module):
    """The last curvature and what it missed, their differences over the last steps, and the count."""

    error: Float[Array, ""]
    kappa: Float[Array, " N"]
    missing: Float[Array, " N"]
    kappa_steps: Float[Array, "depth N"]
    missing_steps: Float[Array, "depth N"]
    count: Int[Array, ""]


class Anderson(_RootFinder):
    """Accelerated fixed point: kappa <- rest + compliance (T arm + M), Anderson mixing over the last steps.

    Attributes:
        depth: steps remembered; 0 is the plain fixed point (Picard).
        damping: share of the fixed-point step taken.
    """

    depth: int = 5
    damping: float = 1.0

    def init(self, fn, y: State, args: Pull, options: dict[str, Any], f_struct, aux_struct, tags):
        del fn, options, f_struct, aux_struct, tags
        n = y.kappa.shape[0]
        none, steps = jnp.zeros_like(y.kappa), jnp.zeros((self.depth, n), y.kappa.dtype)
        return _AndersonState(jnp.full_like(args.T_base, jnp.inf), none, none, steps, steps, jnp.asarray(0))

    def step(self, fn, y: State, args: Pull, options, state: _AndersonState, tags):
        del options, tags
        s = args.sections
        now = state_of(y.kappa, args)
        aux = fn(y, args)[1]
        bending = s.compliance * (tension_of(now, args) * channel.moment_arm(now.kappa, s.R) + now.moment)
        missing = s.rest + bending - now.kappa
        error = jnp.max(jnp.abs(missing)) * s.mesh.s[-1]
        kappa = now.kappa + self.damping * missing
        kappa_steps, missing_steps = state.kappa_steps, state.missing_steps
        if self.depth:
            slot, seen = jnp.maximum(state.count - 1, 0) % self.depth, state.count > 0
            kappa_steps = jnp.where(seen, kappa_steps.at[slot].set(now.kappa - state.kappa), kappa_steps)
            missing_steps = jnp.where(
                seen, missing_steps.at[slot].set(missing - state.missing), missing_steps
            )
            gram = missing_steps @ missing_steps.T
            gram = gram + (1e-14 * jnp.trace(gram) + 1e-300) * jnp.eye(self.depth)
            mix = jnp.linalg.solve(gram, missing_steps @ missing)
            kappa = kappa - mix @ (kappa_steps + self.damping * missing_steps)
        # Hand on the next curvature; once the error is small enough, the one that was measured.
        out = eqx.tree_at(lambda v: v.kappa, now, jnp.where(error <= self.atol, now.kappa, kappa))
        return (
            out,
            _AndersonState(error, now.kappa, missing, kappa_steps, missing_steps, state.count + 1),
            aux,
        )


def equilibrium(
    robot: Robot, T_base: Float[Array, ""], solver: SolverOptions | optx.AbstractRootFinder
) -> Equilibrium:
    """`gtr_jax.equilibrium` of a robot of one tendon, by the march or by one of its rivals."""
    if isinstance(solver, SolverOptions):
        return gtr_equilibrium(robot, T_base, solver=solver)
    p = Pull.of(robot, jnp.asarray(T_base))
    s = p.sections
    found = optx.root_find(residual, solver, rest_state(s), args=p, max_steps=MAX_STEPS, throw=False)
    y, tension = found.value, tension_of(found.value, p)
    done = Loaded(
        state=y,
        tension=tension,
        T_tip=tension[-1],
        slip=jnp.zeros_like(tension),
        wrap=y.wrap,
        mobilisation=None,
        result=found.result,
        residual_norm=found.stats["residual_norm"],
        iterations=found.stats["num_steps"],
    )
    return describe(s, robot.base, done)


CANDIDATES: dict[str, SolverOptions | optx.AbstractRootFinder] = {
    "march": SolverOptions(),
    "structured Newton": StructuredNewton(),
    "Anderson": Anderson(),
    "Picard": Anderson(depth=0, damping=0.7),
    "dense Newton": DenseNewton(),
}
