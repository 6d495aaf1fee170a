"""How many evaluations the march should spend on each node: residual left after one pass against its cost.

The march repeats itself until the residual is met, so a rule that leaves too much costs a second pass.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gtr_jax import SolverOptions
from gtr_jax.mechanics import channel

from . import measure, systems
from .whole_pull import Pull, tension

FLATTEST = 0.3


def _fixed_point(count: int) -> Callable:
    def solve(balance, kappa):
        for _ in range(count):
            kappa = kappa - balance(kappa)
        return kappa

    return solve


def _secant(count: int) -> Callable:
    def solve(balance, kappa):
        error = balance(kappa)
        before, error_before = kappa, error
        kappa = kappa - error
        for _ in range(count):
            error = balance(kappa)
            step = jnp.where(kappa == before, 1.0, kappa - before)
            rate = jnp.where(kappa == before, 1.0, (error - error_before) / step)
            before, error_before = kappa, error
            kappa = kappa - error / jnp.maximum(rate, FLATTEST)
        return kappa

    return solve


def _newton(count: int) -> Callable:
    def solve(balance, kappa):
        for _ in range(count):
            error, slope = jax.jvp(balance, (kappa,), (jnp.ones_like(kappa),))
            kappa = kappa - error / jnp.maximum(slope, FLATTEST)
        return kappa

    return solve


# Rules for a node, by name; each ends with one more evaluation that gives tension and residual.
RULES: dict[str, Callable] = {
    "fixed point": _fixed_point(1),
    "two fixed-point steps": _fixed_point(2),
    "fixed point, secant": _secant(1),
    "fixed point, two secants": _secant(2),
    "Newton": _newton(1),
    "two Newton steps": _newton(2),
}


def one_pass(p: Pull, rule: Callable) -> tuple[jnp.ndarray, jnp.ndarray]:
    """Tip tension [N] and largest residual (as kappa L) after one pass without external forces."""
    s = p.sections

    def node(carry, x):
        kappas, wrap_before, tension_before = carry
        R, R_before, compliance, rest, w, between, memory = x
        known = w[1] * kappas[0] + w[2] * kappas[1] + w[3] * kappas[2]

        def tension_at(kappa):
            turn = known + w[0] * kappa
            wrap = wrap_before + channel.wrap_increment(turn, kappa, kappas[0], R, R_before, between)
            return tension(p.T_base, wrap, memory, p.mu), wrap

        def balance(kappa):
            moment = tension_at(kappa)[0] * channel.moment_arm(kappa, R) + p.tip_moment
            return kappa - rest - compliance * moment

        near = rest
        for _ in range(2):
            near = rest + compliance * (tension_before * channel.moment_arm(near, R) + p.tip_moment)
        kappa = rule(balance, near)
        here, wrap = tension_at(kappa)
        return ((kappa, *kappas[:-1]), wrap, here), (here, balance(kappa))

    zero = jnp.zeros_like(p.T_base)
    rows = (
        s.R,
        s.R.before(),
        s.compliance,
        s.rest,
        s.mesh.weights,
        s.mesh.interval,
        p.memory,
    )
    along, missing = jax.lax.scan(node, ((zero,) * 3, zero, p.T_base), rows)[1]
    return along[-1], jnp.max(jnp.abs(missing)) * s.mesh.s[-1]


def node_equation(quick: bool = False) -> dict[str, Any]:
    """For each rule: time of a pass, single and per lane, and the residuals left on random problems."""
    studied = (systems.TDCM_1,) if quick else (systems.TDCM_1, systems.PARALLEL, systems.CONE_WAVE)
    out: dict[str, Any] = {}
    for system in studied:
        robot = system.robot()
        batch = systems.draws(system, 128 if quick else 1024, seed=2)

        def solve(x, rule, robot=robot):
            return one_pass(Pull.of(robot.with_values(mu=x["mu"], E=x["E"]), x["T_base"]), rule)

        out[system.name] = {}
        for name, rule in RULES.items():
            first = jax.tree_util.tree_map(lambda a: a[0], batch)
            one = jax.jit(lambda x, rule=rule, solve=solve: solve(x, rule))
            many = jax.jit(jax.vmap(lambda x, rule=rule, solve=solve: solve(x, rule)))
            left = np.asarray(many(batch)[1])
            out[system.name][name] = {
                "single_s": measure.shortest(one, first, budget=0.1),
                "lane_s": measure.shortest(many, batch, budget=0.1) / left.size,
                "residual_median": float(np.median(left)),
                "residual_worst": float(left.max()),
                "share_done": float(np.mean(left <= SolverOptions().atol)),
            }
    return out
