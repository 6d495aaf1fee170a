"""How friction grips several tendons that share a body in the plane.

A tendon may slip although its base tension is held, because the body under the others carries its channel
along: the slip decides. Friction builds up over a slip of `PRESLIDING` of the length (`coulomb`), or as the
term `presliding` states it, and a tendon gives by `STRETCH` where no term states more.

Where a tendon is locked, a march that starts from a slip at the base would let the least error grow without
bound. So the unknown is not the slip at the base but, in each interval, one number xi = z + u/L: within
[-1, 1] it is the share z of friction that is mobilised, beyond it the slip u in the load step over the
length. Given xi, one march from the base to the tip solves the body. What is left in each interval is the
slip that xi states minus the slip that follows from the shape, summed from the anchor:

    u(s) = integral over [s, L] of (nu_before - nu + strain gained) + displacement of the anchor.

Newton's method finds xi of all intervals at once. Its linear system couples a node to its predecessor and to
the sum from the tip, and is solved in one pass from the tip to the base and one back (a Riccati recursion,
see `Linear`), at a cost that grows with the nodes, not with their cube.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jaxtyping import Array, Float

from .case import Case
from .coulomb import STRETCH, unit_tension
from .loop_lanes import in_lanes_of
from .march import NEWTON_WITH_TERMS, Passed, closed, closing_of, solved_at_node
from .mesh import following
from .node import Carry, prepared, rise_per_newton, total
from .sections import largest
from .small_matrices import inverse, product, times


class Linear(NamedTuple):
    """The equations of one load step, linearised about a march, with xi given in each interval.

    What the march carries from node to node, flattened, is called rest here, (d,). A change of it follows

        rest_i = onward_i rest_(i-1) + by_grip_i xi_i + by_given_i g,        g: what is unknown at the base,

    the slip over the length in interval i, S_i = S_(i+1) + gone_i rest_i, ends at the anchor with
    S_N = anchor rest_(N-1), and xi_i obeys gives_i xi_i - S_i = -left_i.

    Attributes:
        onward: (N, d, d).
        by_grip: (N, d, T); zero at the base, which no interval precedes.
        by_given: (N, d, g).
        first: change of what the march starts from with g, (d, g).
        gone: (N, T, d).
        anchor: (T, d).
        gives: slip over the length per xi, (N, T).
        tip: change of what is left of the conditions at the tip, by rest_(N-1), (g, d).
        tip_by: the same by g, (g, g).
    """

    onward: Float[Array, "N d d"]
    by_grip: Float[Array, "N d T"]
    by_given: Float[Array, "N d g"]
    first: Float[Array, "d g"]
    gone: Float[Array, "N T d"]
    anchor: Float[Array, "T d"]
    gives: Float[Array, "N T"]
    tip: Float[Array, "g d"]
    tip_by: Float[Array, "g g"]


class Gripped(NamedTuple):
    """One march with xi given: curvature at the nodes [1/m], (N,); what is left of the law in each interval,
    over the length, (N, T), and of the conditions at the tip, (g,); the largest error of a node's balance,
    as curvature times length; and the equations linearised.
    """

    kappa: Float[Array, " N"]
    left: Float[Array, "N T"]
    at_tip: Float[Array, " g"]
    error: Float[Array, ""]
    linear: Linear


def _flat(carry: Carry) -> Float[Array, " d"]:
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jtu.tree_leaves(carry)])


def _columns(tangent, size: int) -> Any:
    """A linear map as a matrix."""
    return jax.vmap(tangent, out_axes=-1)(jnp.eye(size))


def _cells(case: Case) -> Float[Array, " N"]:
    """The share of the length that a node stands for in a sum from the tip: half of both intervals beside it,
    over the length. With any wider stencil, a stretch without slip would leave the strain free to alternate
    from node to node.
    """
    mesh = case.sections.mesh
    return 0.5 * (mesh.interval.length + following(mesh.interval.length)) / mesh.s[-1]


def anchor_moved(case: Case, T_tip: Float[Array, "*tendons"]) -> Float[Array, "*tendons"]:
    """How far the anchors move towards the base in the load step [m], (tendons,)."""
    before, s = case.memory.T_tip, case.sections
    stated = total(case, "anchor", T_tip) - total(case, "anchor", before)
    least, own = STRETCH / unit_tension(s) * s.mesh.s[-1], rise_per_newton(case, "anchor", before)
    return stated + jnp.where(own < least, least - own, 0.0) * (T_tip - before)


def left_of(case: Case, marched: Passed) -> Float[Array, "N T"]:
    """What is left of the friction law in each interval: the slip that xi states minus that which follows
    from the shape, over the length, (N, T); zero at the base.
    """
    equations, _, rows = prepared(case, closing_of(case, jnp.zeros(case.structure.unknowns)))
    nodes, length = marched.nodes, case.sections.mesh.s[-1]
    gone = jax.vmap(equations.gains)(rows, nodes.state.kappa, nodes.tension) * _cells(case)[:, None]
    return _left(case, rows.grip.slipped, gone, anchor_moved(case, marched.T_tip) / length)


def _left(case: Case, slipped, gone, anchor) -> Float[Array, "N T"]:
    """As `left_of`, from the slip that xi states [m], (N, T), what each node adds to that of the intervals
    ahead of it, (N, T), and the anchors' displacement, (T,), both over the length.
    """
    mesh = case.sections.mesh
    own = _flipped(jnp.cumsum(_flipped(gone), axis=0)) + anchor[None]
    return (slipped / mesh.s[-1] - own) * mesh.interval.joined[:, None]


def march_gripped(
    case: Case,
    by_xi: tuple[Float[Array, "N T"], Float[Array, "N T"]],
    flat: Float[Array, " g"],
    guess: Float[Array, " N"],
    use_guess,
) -> Gripped:
    """One march from the base to the tip with xi given, and its linearisation.

    Args:
        case: the load step, with the grip at xi.
        by_xi: how that changes with xi, of `node.grip_of`.
        flat: what is unknown at the base besides, (g,).
        guess: curvature to start from [1/m], (N,).
        use_guess: whether to start from it.
    """
    length, size = case.sections.mesh.s[-1], flat.shape[0]
    cells = _cells(case)

    def start(flat):
        equations, carry, rows = prepared(case, closing_of(case, flat))
        return (equations.stop, carry), (equations, rows)

    (_, carry), along, (equations, rows) = jax.linearize(start, flat, has_aux=True)
    leaves, tree = jtu.tree_flatten(carry)
    ends = np.cumsum([0, *(leaf.size for leaf in leaves)])
    count = int(ends[-1])

    def unflat(rest):
        parts = (rest[a:b].reshape(leaf.shape) for a, b, leaf in zip(ends, ends[1:], leaves, strict=False))
        return jtu.tree_unflatten(tree, list(parts))

    moved = jax.vmap(along, out_axes=-1)(jnp.eye(size)) if size else None
    first = _flat_columns(moved[1], size) if moved is not None else jnp.zeros((count, 0))
    stop_by = None if moved is None or equations.stop is None else moved[0]

    def node(carry, x):
        row, guess, cell, joined, (slipped_by, mobilised_by) = x
        kappa = solved_at_node(equations, carry, row, guess, use_guess, NEWTON_WITH_TERMS)

        def at(kappa, rest, xi, stop):
            """Near xi, given by its change."""
            now = eqx.tree_at(lambda e: e.stop, equations, stop, is_leaf=lambda x: x is None)
            grip = row.grip._replace(
                slipped=row.grip.slipped + slipped_by * xi, mobilised=row.grip.mobilised + mobilised_by * xi
            )
            error, new = now(unflat(rest), row._replace(grip=grip), kappa)[:2]
            return error, _flat(new)

        given = (_flat(carry), jnp.zeros_like(slipped_by), equations.stop)
        (error, new), tangent = jax.linearize(at, kappa, *given)
        rest, xi, stop = jtu.tree_map(jnp.zeros_like, given)
        slope, by_kappa = tangent(jnp.ones_like(kappa), rest, xi, stop)

        def followed(*dots):
            error_dot, new_dot = tangent(jnp.zeros_like(kappa), *dots)
            return new_dot - error_dot / slope * by_kappa

        onward = _columns(lambda d: followed(d, xi, stop), rest.size)
        by_grip = _columns(lambda d: followed(rest, d, stop), xi.size) * joined
        by_stop = None if stop is None else followed(rest, xi, jnp.ones_like(stop))

        def gone(rest):
            end = unflat(rest)
            return equations.gains(row, end.kappas[0], end.tension) * cell

        more, more_by = jax.linearize(gone, new)
        return unflat(new), (onward, by_grip, by_stop, _columns(more_by, count), more, kappa, error)

    begin = in_lanes_of((case.varied, by_xi, flat, guess), carry)
    rows_in = (rows, guess, cells, case.sections.mesh.interval.joined, by_xi)
    end, out = jax.lax.scan(node, begin, rows_in)
    onward, by_grip, by_stop, gone, more, kappa, error = out

    def tip(flat, rest):
        end = unflat(rest)
        residual, T_tip = closed(case, flat, end, equations.modes)
        return residual, anchor_moved(case, T_tip) / length

    (at_tip, moved_tip), tangent = jax.linearize(tip, flat, _flat(end))
    by_rest, anchor = _columns(lambda d: tangent(jnp.zeros_like(flat), d), count)
    by_flat = _columns(lambda d: tangent(d, jnp.zeros(count))[0], size) if size else jnp.zeros((0, 0))
    left = _left(case, rows.grip.slipped, more, moved_tip)
    by_given = jnp.zeros((kappa.shape[0], count, size))
    if by_stop is not None and stop_by is not None:
        by_given = by_stop[:, :, None] * stop_by[None, None, :]
    linear = Linear(onward, by_grip, by_given, first, gone, anchor, by_xi[0] / length, by_rest, by_flat)
    return Gripped(kappa, left, at_tip, largest(error) * length, linear)


def _flat_columns(carry: Carry, size: int) -> Float[Array, "d g"]:
    """Tangents of a carry along their last axis as columns."""
    return jnp.concatenate([jnp.reshape(leaf, (-1, size)) for leaf in jtu.tree_leaves(carry)])


class Factors(NamedTuple):
    """What does not depend on the right-hand side: xi_i = by_rest_i rest_(i-1) + solve_i (...), and S_(i+1) +
    gone_i rest_i by rest_i, `pull`.
    """

    by_rest: Float[Array, "N T d"]
    solve: Float[Array, "N T T"]
    pull: Float[Array, "N T d"]


def _factored(m: Linear) -> Factors:
    """From the tip to the base: how xi and the slip in each interval follow from the rest before it."""

    def back(slope, x):
        onward, by_grip, gone, gives = x
        pull = slope + gone
        solve = inverse(jnp.diag(gives) - product(pull, by_grip))
        by_rest = product(solve, product(pull, onward))
        return gives[:, None] * by_rest, (by_rest, solve, pull)

    rows = _flipped((m.onward, m.by_grip, m.gone, m.gives))
    found = jax.lax.scan(back, in_lanes_of(tuple(m), m.anchor), rows)[1]
    return Factors(*_flipped(found))


def _flipped(tree):
    """Rows in the other order; native code has no loop that goes backwards."""
    return jtu.tree_map(lambda a: jnp.flip(a, 0), tree)


def _answered(m: Linear, by: Factors, left, forced, first):
    """xi, (N, T, k), and the rest at the tip, (d, k), for k right-hand sides.

    Args:
        m, by: the equations.
        left: of the friction law, (N, T, k).
        forced: what else changes the rest in each interval, (N, d, k).
        first: and at the base, (d, k).
    """

    def back(level, x):
        solve, pull, gives, left, forced = x
        own = product(solve, product(pull, forced) + level - left)
        return gives[:, None] * own + left, own

    def forward(rest, x):
        onward, by_grip, by_rest, own, forced = x
        xi = product(by_rest, rest) + own
        return product(onward, rest) + product(by_grip, xi) + forced, xi

    # Not `in_lanes_of`: what is left may be a derivative, of which only what is linear can be transposed.
    none = 0.0 * left[0]
    rows = _flipped((by.solve, by.pull, m.gives, left, forced))
    own = jax.lax.scan(back, none, rows)[1]
    rows = (m.onward, m.by_grip, by.by_rest, _flipped(own), forced)
    rest, xi = jax.lax.scan(forward, first + none[:1], rows)
    return jnp.concatenate([jnp.zeros_like(xi[:1]), xi[1:]]), rest


def solved_linear(
    m: Linear, left: Float[Array, "N T"], at_tip: Float[Array, " g"]
) -> tuple[Float[Array, "N T"], Float[Array, " g"]]:
    """The changes of xi, (N, T), and of what is unknown at the base, (g,), that take away what is left.

    From the tip to the base it finds how xi_i and S_i follow from rest_(i-1); from the base to the tip, the
    rest. Where more is unknown at the base, it does so for each of these too.
    """
    by = _factored(m)
    nodes, count, size = m.by_given.shape
    none = jnp.zeros((nodes, count, 1))
    xi, rest = _answered(m, by, left[:, :, None], none, none[0])
    if not size:
        return xi[:, :, 0], at_tip
    each, end = _answered(m, by, jnp.zeros((*left.shape, size)), m.by_given, m.first)
    matrix = product(m.tip, end) + m.tip_by
    given = -times(inverse(matrix), at_tip + times(m.tip, rest[:, 0]))
    return xi[:, :, 0] + jnp.sum(each * given[None, None, :], axis=-1), given
