"""Least squares within bounds and limits: Levenberg and Marquardt's method on the residuals of the targets
and on those of an augmented Lagrangian for the limits, many starts at once.

For limits c(z) >= 0 with multipliers l and penalty r, the augmented Lagrangian is half the sum of squares of
sqrt(r) max(0, l/r - c) (Hestenes, Powell, Rockafellar), so that with the targets it is one least squares
problem. Where the targets are met, the multipliers vanish and one round is enough.

The loop is not that of `calibrate/inference/least_squares.py`, which goes from step to step on the host: this
one runs inside a compiled program, rounds of the Lagrangian included, and its damping and its linear solver
lead to designs of other digits.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from gtr_jax.mechanics.small_matrices import inverse, times

from .objective import Evaluation, Objective, evaluate

# Penalty of the augmented Lagrangian: at first, at most, and the factor by which it is raised.
FIRST_PENALTY, LARGEST_PENALTY, RAISE = 1e4, 1e9, 10.0
BACK_OFF = 1e-3  # margins aim this far inside, in their scale, to keep limits despite rounding and meshes
KEPT = 1e-4  # by which the aim may be missed
MET = 1e-3  # residual, in tolerances, at which there is nothing left to do
SMALLEST_STEP = 1e-7  # of the space; a shorter step ends a round
LONGEST_STEP = 0.25  # of the space
DIFFERENCE = 1e-5  # of the space
HARDEST = 1e10  # damping beyond which a round is given up
ROUNDS = 8  # of the augmented Lagrangian
JUDGED = 64  # designs in space that one program judges


class Found(NamedTuple):
    """Where a search ended, of L lanes.

    z: coordinates, (L, c). cost: half the sum of squares, (L,). rows: margins, (L, K). multipliers: of the
    limits, with what the penalty adds, (L, K).
    gradient: of the augmented Lagrangian by z, (L, c). settled: whether it stopped by itself with the limits
    kept or unable to keep them, (L,). steps: evaluations, (L,).
    """

    z: Float[Array, "*L c"]
    cost: Float[Array, "*L"]
    rows: Float[Array, "*L K"]
    multipliers: Float[Array, "*L K"]
    gradient: Float[Array, "*L c"]
    settled: Bool[Array, "*L"]
    steps: Int[Array, "*L"]


class _Search(NamedTuple):
    z: Array
    trial: Array
    cost: Array
    plain: Array
    gradient: Array
    hessian: Array
    rows: Array
    damping: Array
    multipliers: Array
    penalty: Array
    missed: Array
    rounds: Array
    done: Array
    settled: Array
    steps: Array


def value_and_slopes(objective: Objective, z: Float[Array, " c"]):
    """Residuals and margins of one design, their derivatives by each coordinate, (c, m) and (c, K), and
    whether all converged.

    Forward mode through the equilibrium by the implicit function theorem. With physics terms by forward
    differences: a design has a few coordinates, and the derivative of a march with slip takes long to
    compile.
    """

    def judged(x):
        e = evaluate(objective, x)
        return (e.residuals, e.margins), e.converged

    if not objective.with_terms:
        directions = jnp.eye(z.shape[0])
        return jax.vmap(lambda d: jax.jvp(judged, (z,), (d,), has_aux=True), out_axes=(None, 0, None))(
            directions
        )
    steps = jnp.where(z > 0.5, -DIFFERENCE, DIFFERENCE)
    points = jnp.concatenate([z[None], z[None] + jnp.diag(steps)])
    values, ok = jax.lax.map(judged, points)
    slopes = jax.tree_util.tree_map(lambda v: (v[1:] - v[:1]) / steps[:, None], values)
    return jax.tree_util.tree_map(lambda v: v[0], values), slopes, jnp.all(ok)


def _step(objective: Objective, free, s: _Search) -> _Search:
    (residuals, margins), (by_residual, by_margin), ok = value_and_slopes(objective, s.trial)
    root = jnp.sqrt(s.penalty)
    short = s.multipliers / s.penalty - (margins - BACK_OFF)
    bound = jnp.where(short > 0, root * short, 0.0)
    by_bound = jnp.where((short > 0)[None], -root * by_margin, 0.0)
    cost = 0.5 * (jnp.sum(residuals**2) + jnp.sum(bound**2))
    gradient = (by_residual @ residuals + by_bound @ bound) * free
    hessian = (by_residual @ by_residual.T + by_bound @ by_bound.T) * free[:, None] * free[None, :]
    finite = ok & jnp.isfinite(cost) & jnp.all(jnp.isfinite(gradient)) & jnp.all(jnp.isfinite(hessian))
    better = finite & (cost < s.cost)
    gain = jnp.where(jnp.isfinite(s.cost), (s.cost - cost) / jnp.where(s.cost > 0, s.cost, 1.0), 1.0)

    z = jnp.where(better, s.trial, s.z)
    moved = jnp.where(better, jnp.max(jnp.abs(s.trial - s.z)), 0.0)
    first = ~jnp.isfinite(s.cost)
    cost = jnp.where(better, cost, s.cost)
    gradient = jnp.where(better, gradient, s.gradient)
    hessian = jnp.where(better, hessian, s.hessian)
    rows = jnp.where(better, margins, s.rows)
    plain = jnp.where(better, 0.5 * jnp.sum(residuals**2), s.plain)
    damping = jnp.where(better, s.damping / 5.0, s.damping * 6.0)
    damping = jnp.clip(damping, 1e-12, None)

    held = ((z <= 0.0) & (gradient > 0)) | ((z >= 1.0) & (gradient < 0))
    open_ = free * jnp.where(held, 0.0, 1.0)
    scale = jnp.diagonal(hessian)
    scale = jnp.where(scale > 0, scale, 0.0) + 1e-6 * jnp.max(scale) + 1e-12
    system = hessian * open_[:, None] * open_[None, :] + jnp.diag(damping * scale + (1.0 - open_))
    step = -times(inverse(system), gradient * open_)
    step = step * jnp.minimum(1.0, LONGEST_STEP / jnp.maximum(jnp.max(jnp.abs(step)), 1e-300))
    trial = jnp.clip(z + step, 0.0, 1.0)
    little = jnp.max(jnp.abs(trial - z)) < SMALLEST_STEP
    slow = better & ~first & (gain < 1e-9) & (moved < 1e-3)
    over = little | slow | (cost < 0.5 * MET**2) | (damping > HARDEST)
    over = over & jnp.isfinite(cost)
    lost = ~jnp.isfinite(cost) & (damping > HARDEST)

    worst = jnp.max(jnp.maximum(0.0, BACK_OFF - rows), initial=0.0)
    last = (worst < KEPT) | (s.rounds + 1 >= ROUNDS)
    again = over & ~last
    multipliers = jnp.where(
        again, jnp.maximum(0.0, s.multipliers - s.penalty * (rows - BACK_OFF)), s.multipliers
    )
    raised = again & (worst > 0.25 * s.missed)
    penalty = jnp.where(raised, jnp.minimum(RAISE * s.penalty, LARGEST_PENALTY), s.penalty)
    return _Search(
        z=z,
        trial=jnp.where(again, z, trial),
        cost=jnp.where(again, jnp.inf, cost),
        plain=plain,
        gradient=gradient,
        hessian=hessian,
        rows=rows,
        damping=jnp.where(again, 1e-3, damping),
        multipliers=multipliers,
        penalty=penalty,
        missed=jnp.where(again, worst, s.missed),
        rounds=s.rounds + jnp.where(again, 1, 0),
        done=(over & last) | lost,
        settled=over & last,
        steps=s.steps + 1,
    )


def search(
    objective: Objective, z: Float[Array, " c"], free: Float[Array, " c"], most_steps: Int[Array, ""]
) -> Found:
    """Search from one start.

    Args:
        objective: the problem; a goal counts by its distance from utopia.
        z: start, (c,).
        free: 1 for coordinates that may change, 0 for those that stay, (c,).
        most_steps: evaluations after which it gives up.
    """
    c = z.shape[0]
    shapes = eqx.filter_eval_shape(evaluate, objective, z)
    none = jnp.zeros(shapes.margins.shape)
    zero = jnp.zeros(())
    start = _Search(
        z=z,
        trial=z,
        cost=zero + jnp.inf,
        plain=zero + jnp.inf,
        gradient=jnp.zeros(c),
        hessian=jnp.zeros((c, c)),
        rows=none,
        damping=zero + 1e-3,
        multipliers=none,
        penalty=zero + FIRST_PENALTY,
        missed=zero + jnp.inf,
        rounds=jnp.asarray(0),
        done=jnp.asarray(False),
        settled=jnp.asarray(False),
        steps=jnp.asarray(0),
    )
    end = jax.lax.while_loop(
        lambda s: ~s.done & (s.steps < most_steps), lambda s: _step(objective, free, s), start
    )
    force = jnp.maximum(0.0, end.multipliers - end.penalty * (end.rows - BACK_OFF))
    return Found(end.z, end.plain, end.rows, force, end.gradient, end.settled, end.steps)


@eqx.filter_jit
def _search_all(objective: Objective, z, free, most_steps) -> Found:
    # One lane after another: each takes the steps it needs, and a lane of a batch costs no less on a CPU.
    return jax.lax.map(lambda start: search(objective, start[0], start[1], most_steps), (z, free))


def search_all(
    objective: Objective, z: Float[Array, "L c"], free: Float[Array, "L c"], most_steps: int
) -> Found:
    """Search from L starts; one compiled program for tasks of one structure."""
    return _search_all(objective, jnp.asarray(z), jnp.asarray(free), jnp.asarray(most_steps))


@eqx.filter_jit
def _judge_all(objective: Objective, z: Float[Array, "L c"]) -> Evaluation:
    if objective.with_terms:
        return jax.lax.map(lambda z: evaluate(objective, z), z)
    return jax.vmap(lambda z: evaluate(objective, z))(z)


def judge_all(objective: Objective, z: Float[Array, "L c"]) -> Evaluation:
    """Judge L designs at once; in space, where a program takes long to compile, by one program for any L."""
    if not objective.robot.space:
        return _judge_all(objective, z)
    count = z.shape[0]
    padded = jnp.concatenate([z, jnp.broadcast_to(z[:1], (-count % JUDGED, z.shape[1]))])
    parts = [_judge_all(objective, part) for part in jnp.split(padded, padded.shape[0] // JUDGED)]
    return jax.tree_util.tree_map(lambda *own: jnp.concatenate(own)[:count], *parts)
