"""The march: one pass from the base to the tip, with its derivatives with respect to the unknowns at the
base.

Each node's moment balance is one scalar equation in its curvature with a slope close to 1. Its solution
starts from the curvature the node would have without friction since its predecessor (or from a guess) and
takes a few Newton steps. Angle, tension, moment and slip follow exactly from the curvature, so the residuals
of the node equations and those at the tip are the whole residual.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Float

from .bodies import geometry_of
from .case import Case
from .loop_lanes import in_lanes_of
from .node import Carry, Equations, Modes, Node, Row, clip, joined_state, prepared, pressing, total
from .program_spec import ProgramSpec
from .sections import either_of, largest

STEP = 1e-5  # of an unknown, relative to its scale, for differences
NEWTON_PLAIN, NEWTON_WITH_TERMS = 2, 3  # steps per node; two reach rounding in the base model
# The same where a law of the body has a kink or its slope falls far, and where that may be: each step adds to
# the time that a program takes to compile.
NEWTON_BENT, NEWTON_MAY_BEND = 8, 5
FLATTEST, FLATTEST_SOFT = 0.3, 0.005  # slope of the moment balance below which a step is shortened


class Closing(NamedTuple):
    """The unknowns at the base, or the residuals at the tip that belong to them: displacement of each tendon
    at the base, or slip at its anchor [m]; external moment at the base, or its error at the tip [N m]; force
    of the stop (`node.pressing`), or its error [N]; relative rise of the tension of the held stretch, or
    growth of the channel there minus that of its tendon [m]. None where the structure has no such unknown.
    """

    slip: Float[Array, "*tendons"] | None
    moment: Float[Array, "*moment"] | None
    stop: Float[Array, ""] | None
    level: Float[Array, ""] | None

    def flat(self) -> Float[Array, " n"]:
        """As one vector."""
        parts = [part.ravel() for part in self if part is not None]
        return jnp.concatenate(parts) if parts else jnp.zeros(0)


def closing_of(case: Case, flat: Float[Array, " n"]) -> Closing:
    """The unknowns from a vector; known values are filled in."""
    what, count = case.structure, case.mu.size * case.structure.seeks_slip
    slip = flat[:count].reshape(case.mu.shape) if what.seeks_slip else jnp.zeros_like(case.mu)
    after, moment = count + what.moments * what.bends, case.tip_moment
    if what.bends:
        moment = flat[count:after] if what.space else flat[count]
    stop = flat[after] if what.has_stop else None
    return Closing(slip, moment, stop, flat[-1] if what.carries else None)


class Marched(NamedTuple):
    """One march that solves for the nodes' curvatures.

    Attributes:
        kappa: curvature, in space strain [1/m], (N, *strain).
        left: residuals at the tip, (n,).
        by_unknowns: their derivatives with respect to the unknowns at the base, (n, n).
        kappa_by: derivatives of the curvature with respect to the same unknowns, (n, N,
            *strain).
        error: largest error of the node equations, as curvature times length.
    """

    kappa: Float[Array, "N *strain"]
    left: Float[Array, " n"]
    by_unknowns: Float[Array, "n n"]
    kappa_by: Float[Array, "n N *strain"]
    error: Float[Array, ""]


class Passed(NamedTuple):
    """One pass with given curvatures.

    Attributes:
        left: residuals at the tip, (n,).
        nodes: what it leaves at the nodes.
        entry, T_tip: tension past the friction lumped ahead of the channel, and at the anchor [N],
            (*tendons,).
        slip: of the tendon at the anchor [m], (*tendons,); None where no slip is followed.
        error: largest error of the node equations, as curvature times length.
    """

    left: Float[Array, " n"]
    nodes: Node
    entry: Float[Array, "*tendons"]
    T_tip: Float[Array, "*tendons"]
    slip: Float[Array, "*tendons"] | None
    error: Float[Array, ""]


def closed(case: Case, flat: Float[Array, " n"], end: Carry, modes: Modes):
    """Residuals at the tip, (n,), and tension at the anchor [N]."""
    what, terms, x = case.structure, case.terms, closing_of(case, flat)
    low, high = end.tension if end.pulled is None else end.pulled, end.released
    high = end.tension if high is None else high
    if what.creeping or what.presliding:
        local = jnp.logical_or(modes.by_slip, modes.neighbour)
        low, high = jnp.where(local, end.tension, low), jnp.where(local, end.tension, high)
    T_tip = end.tension
    if what.has("tip_grip"):
        grip = jnp.exp(-total(case, "tip_grip"))
        before = case.memory.T_tip
        if end.held is not None:
            # The anchor's tension is scaled like that held at the last node.
            before = before * jnp.where(modes.carried, end.held.share, 1.0)
        T_tip = clip(before, low * grip, high / grip)
    slip = moment = stop = level = None
    if what.seeks_slip:
        slip = end.slip
        if what.has("anchor"):
            slip = slip - total(case, "anchor", T_tip) + total(case, "anchor", case.preload)
    if what.bends:
        moment = geometry_of(case.sections).join(end.moment) - case.tip_moment
    if what.has_stop:
        assert x.stop is not None
        ((kind, push),) = what.hooks("stop")
        pushed, stiffness = jax.jvp(
            lambda place: push(terms[kind], place), (end.place,), (jnp.ones_like(end.place),)
        )
        length = case.sections.mesh.s[-1]
        eased = 1.0 + stiffness * jnp.max(case.sections.compliance) * length**3 / 3
        stop = (pressing(x.stop) + eased * (x.stop - pressing(x.stop)) - pushed) / eased
    if what.carries:
        assert x.level is not None and end.held is not None
        # Where nothing is held, the level has no effect; this residual keeps it as it is, or zero where
        # derivatives are by differences.
        kept = 0.0 if what.space else jax.lax.stop_gradient(x.level)
        still = case.sections.mesh.s[-1] * (x.level - kept)
        longer = end.held.longer
        if what.has("anchor"):
            longer = longer - total(case, "anchor", T_tip) + total(case, "anchor", case.memory.T_tip)
        level = jnp.where(end.held.length > 0, longer, still)
    return Closing(slip, moment, stop, level).flat(), T_tip


def _steps(what: ProgramSpec, closes: bool, plain: int) -> int:
    """Newton steps of a node."""
    if closes or (what.softens and what.acting):
        return NEWTON_BENT
    return NEWTON_MAY_BEND if what.softens else plain


def solved_at_node(equations: Equations, carry: Carry, row: Row, guess, use_guess, steps: int):
    """Curvature of a node [1/m]."""
    geometry, what, closing = equations.geometry, equations.case.structure, row.closing
    # Without friction since its predecessor.
    moment = equations.expected(carry, row)
    if what.lags:
        near = row.kappa
    else:
        start = either_of(row.interval.joined > 0, carry.kappas[0], row.rest)
        tension = equations.in_channels(carry.tension)
        near = geometry.slackened(start, row.rest, row.compliance, tension, moment, row.R)
        near = near if closing is None else closing.stopped(row.rest, near)
    flattest = FLATTEST_SOFT if what.softens else FLATTEST
    return geometry.root(
        lambda k: equations(carry, row, k)[0],
        either_of(use_guess, guess, near),
        lambda k: equations.near(carry, row, k),
        _steps(what, closing is not None, steps),
        flattest,
        None if closing is None else closing.stopped,
        jnp.where(use_guess, flattest, 1.0) if what.lags else None,
    )


def march(case: Case, flat: Float[Array, " n"], guess: Float[Array, "N *strain"], use_guess) -> Marched:
    """One march in the plane from base to tip, with its derivatives with respect to the n > 0 unknowns at the
    base.

    Args:
        case: the load step.
        flat: the unknowns at the base, (n,).
        guess: curvature to start from [1/m], (N,).
        use_guess: whether to start from it.
    """

    def start(flat):
        equations, carry, rows = prepared(case, closing_of(case, flat))
        return ((equations.stop, equations.level), carry), (equations, rows)

    directions = jnp.eye(flat.shape[0])
    (given, carry), along, (equations, rows) = jax.linearize(start, flat, has_aux=True)
    given_dot, carry_dot = jax.vmap(along)(directions)

    def node(state, x):
        (carry, carry_dot), (row, guess) = state, x
        kappa = solved_at_node(equations, carry, row, guess, use_guess, NEWTON_WITH_TERMS)

        def at(kappa, carry, given):
            now = eqx.tree_at(lambda e: (e.stop, e.level), equations, given, is_leaf=lambda x: x is None)
            return now(carry, row, kappa)[:2]

        (error, new), tangent = jax.linearize(at, kappa, carry, given)
        still, *nothing = jtu.tree_map(jnp.zeros_like, (kappa, carry, given))
        slope, by_kappa = tangent(jnp.ones_like(kappa), *nothing)

        def along(carry_dot, given_dot):
            error_dot, new_dot = tangent(still, carry_dot, given_dot)
            return jtu.tree_map(lambda d, k: d - error_dot / slope * k, new_dot, by_kappa)

        new_dot = jax.vmap(along)(carry_dot, given_dot)
        return (new, new_dot), (kappa, new_dot.kappas[0], error)

    first = in_lanes_of((case.varied, flat, guess), (carry, carry_dot))
    (end, end_dot), (kappa, kappa_by, error) = jax.lax.scan(node, first, (rows, guess))

    def tip(flat, end):
        return closed(case, flat, end, equations.modes)[0]

    left, tangent = jax.linearize(tip, flat, end)
    by_unknowns = jax.vmap(tangent, out_axes=1)(directions, end_dot)
    return Marched(kappa, left, by_unknowns, kappa_by.T, largest(error) * case.sections.mesh.s[-1])


def march_differenced(case: Case, flat: Float[Array, " n"], guess, use_guess, sizes) -> Marched:
    """As `march`, with derivatives by differences: marches beside one another, one for each unknown. In space
    the derivatives of a node cost more than these, and take a minute to compile.

    Args:
        case, flat, guess, use_guess: as for `march`.
        sizes: scales of the unknowns, (n,).
    """
    steps = STEP * sizes
    tried = jnp.concatenate([flat[None, :], flat[None, :] + jnp.diag(steps)])

    def at_node(e, c, r, k):
        return solved_at_node(e, c, r, k, use_guess, NEWTON_WITH_TERMS)

    def one(flat):
        found = _along(case, flat, guess, at_node)
        return found.left, found.nodes.state.kappa, found.error

    left, kappa, error = jax.vmap(one)(tried)
    by_unknowns = ((left[1:] - left[:1]) / steps[:, None]).T
    kappa_by = (kappa[1:] - kappa[:1]) / steps.reshape(-1, *[1] * guess.ndim)
    return Marched(kappa[0], left[0], by_unknowns, kappa_by, error[0])


def march_plainly(case: Case, guess: Float[Array, "N *strain"], use_guess) -> Passed:
    """One march where nothing is unknown at the base; arguments as for `march`."""
    steps = NEWTON_WITH_TERMS if case.structure.terms else NEWTON_PLAIN
    return _along(case, jnp.zeros(0), guess, lambda e, c, r, k: solved_at_node(e, c, r, k, use_guess, steps))


def passed(case: Case, flat: Float[Array, " n"], kappa: Float[Array, "N *strain"]) -> Passed:
    """One pass with the given curvatures [1/m], (N,)."""
    return _along(case, flat, kappa, lambda equations, carry, row, kappa: kappa)


def described(case: Case, flat: Float[Array, " n"], kappa: Float[Array, "N *strain"]) -> Passed:
    """One pass at a solution, differentiable in everything: one Newton step from `kappa`, which is its root,
    makes each node's curvature depend on the preceding nodes.

    The slope of that step is taken here, not from the march: where nothing slips the laws have a kink, and
    rounding may have put the march on the other side of it.
    """

    def followed(equations, carry, row, kappa):
        geometry = equations.geometry
        error, slope = geometry.slope(lambda k: equations(carry, row, k)[0], kappa)
        return kappa - geometry.quotient(error, jax.lax.stop_gradient(slope))

    return _along(case, flat, kappa, followed)


def _along(case: Case, flat: Float[Array, " n"], kappa: Float[Array, "N *strain"], at_node) -> Passed:
    """One pass in which `at_node` gives each node's curvature from the one in `kappa`."""
    equations, carry, rows = prepared(case, closing_of(case, flat))
    geometry = equations.geometry

    def node(carry, x):
        row, kappa = x
        error, new, out = equations(carry, row, at_node(equations, carry, row, kappa))
        return new, (out, error)

    start = in_lanes_of((case.varied, flat, kappa), carry)
    end, (nodes, error) = jax.lax.scan(node, start, (rows, geometry.split(kappa)))
    nodes = nodes._replace(state=joined_state(geometry, nodes.state))
    left, T_tip = closed(case, flat, end, equations.modes)
    size = largest(geometry.join(error)) * case.sections.mesh.s[-1]
    return Passed(left, nodes, carry.tension, T_tip, end.slip, size)
