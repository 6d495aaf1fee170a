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

from . import channel
from .case import Case
from .node import Carry, Equations, Modes, Node, Row, clip, prepared, pressing, total
from .sections import at_tendons, largest, over_tendons

NEWTON_PLAIN, NEWTON_WITH_TERMS = 2, 3  # steps per node; two reach rounding in the base model
FLATTEST = 0.3  # slope of the moment balance below which a step is shortened


class Closing(NamedTuple):
    """The unknowns at the base, or the residuals at the tip that belong to them: displacement of each tendon
    at the base, or slip at its anchor [m]; external moment at the base, or its error at the tip [N m]; force
    of the stop (`node.pressing`), or its error [N]; relative rise of the tension of the held stretch, or
    growth of the channel there minus that of its tendon [m]. None where the structure has no such unknown.
    """

    slip: Float[Array, "*tendons"] | None
    moment: Float[Array, ""] | None
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
    moment = flat[count] if what.bends else case.tip_moment
    stop = flat[count + 1] if what.has_stop else None
    return Closing(slip, moment, stop, flat[-1] if what.carries else None)


class Marched(NamedTuple):
    """One march that solves for the nodes' curvatures.

    Attributes:
        kappa: curvature [1/m], (N,).
        left: residuals at the tip, (n,).
        by_unknowns: their derivatives with respect to the unknowns at the base, (n, n).
        kappa_by: derivatives of the curvature with respect to the same unknowns, (n, N).
        error: largest error of the node equations, as curvature times length.
    """

    kappa: Float[Array, " N"]
    left: Float[Array, " n"]
    by_unknowns: Float[Array, "n n"]
    kappa_by: Float[Array, "n N"]
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
        moment = end.moment - case.tip_moment
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
        # Where nothing is held, the level has no effect; this residual keeps it as it is.
        still = case.sections.mesh.s[-1] * (x.level - jax.lax.stop_gradient(x.level))
        longer = end.held.longer
        if what.has("anchor"):
            longer = longer - total(case, "anchor", T_tip) + total(case, "anchor", case.memory.T_tip)
        level = jnp.where(end.held.length > 0, longer, still)
    return Closing(slip, moment, stop, level).flat(), T_tip


def _without_friction(carry: Carry, row: Row):
    """Curvature the node would have if no friction acted since its predecessor [1/m]."""
    near = row.rest
    for _ in range(2):
        arm = channel.moment_arm(at_tendons(near, row.R), row.R)
        near = row.rest + row.compliance * (over_tendons(carry.tension * arm, 0) + carry.moment)
    return near


def _solved(equations: Equations, carry: Carry, row: Row, guess, use_guess, steps: int):
    """Curvature of a node [1/m]."""
    kappa = jnp.where(use_guess, guess, _without_friction(carry, row))
    for _ in range(steps):
        error, slope = jax.jvp(lambda k: equations(carry, row, k)[0], (kappa,), (jnp.ones_like(kappa),))
        kappa = kappa - error / jnp.where(slope > FLATTEST, slope, FLATTEST)
    return kappa


def march(case: Case, flat: Float[Array, " n"], guess: Float[Array, " N"], use_guess) -> Marched:
    """One march from base to tip, with its derivatives with respect to the n > 0 unknowns at the base.

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
        kappa = _solved(equations, carry, row, guess, use_guess, NEWTON_WITH_TERMS)

        def at(kappa, carry, given):
            now = eqx.tree_at(lambda e: (e.stop, e.level), equations, given, is_leaf=lambda x: x is None)
            return now(carry, row, kappa)[:2]

        (error, new), tangent = jax.linearize(at, kappa, carry, given)
        nothing = jtu.tree_map(jnp.zeros_like, (carry, given))
        slope, by_kappa = tangent(jnp.ones_like(kappa), *nothing)

        def along(carry_dot, given_dot):
            error_dot, new_dot = tangent(jnp.zeros_like(kappa), carry_dot, given_dot)
            return jtu.tree_map(lambda d, k: d - error_dot / slope * k, new_dot, by_kappa)

        new_dot = jax.vmap(along)(carry_dot, given_dot)
        return (new, new_dot), (kappa, new_dot.kappas[0], error)

    (end, end_dot), (kappa, kappa_by, error) = jax.lax.scan(node, (carry, carry_dot), (rows, guess))

    def tip(flat, end):
        return closed(case, flat, end, equations.modes)[0]

    left, tangent = jax.linearize(tip, flat, end)
    by_unknowns = jax.vmap(tangent, out_axes=1)(directions, end_dot)
    return Marched(kappa, left, by_unknowns, kappa_by.T, largest(error) * case.sections.mesh.s[-1])


def march_plainly(case: Case, guess: Float[Array, " N"], use_guess) -> Passed:
    """One march where nothing is unknown at the base; arguments as for `march`."""
    steps = NEWTON_WITH_TERMS if case.structure.terms else NEWTON_PLAIN
    return _along(case, jnp.zeros(0), guess, lambda e, c, r, k: _solved(e, c, r, k, use_guess, steps))


def passed(case: Case, flat: Float[Array, " n"], kappa: Float[Array, " N"]) -> Passed:
    """One pass with the given curvatures [1/m], (N,)."""
    return _along(case, flat, kappa, lambda equations, carry, row, kappa: kappa)


def described(case: Case, flat: Float[Array, " n"], kappa: Float[Array, " N"]) -> Passed:
    """One pass at a solution, differentiable in everything: one Newton step from `kappa`, which is its root,
    makes each node's curvature depend on the preceding nodes.

    The slope of that step is taken here, not from the march: where nothing slips the laws have a kink, and
    rounding may have put the march on the other side of it.
    """

    def followed(equations, carry, row, kappa):
        error, slope = jax.jvp(lambda k: equations(carry, row, k)[0], (kappa,), (jnp.ones_like(kappa),))
        return kappa - error / jax.lax.stop_gradient(slope)

    return _along(case, flat, kappa, followed)


def _along(case: Case, flat: Float[Array, " n"], kappa: Float[Array, " N"], at_node) -> Passed:
    """One pass in which `at_node` gives each node's curvature from the one in `kappa`."""
    equations, carry, rows = prepared(case, closing_of(case, flat))

    def node(carry, x):
        row, kappa = x
        error, new, out = equations(carry, row, at_node(equations, carry, row, kappa))
        return new, (out, error)

    end, (nodes, error) = jax.lax.scan(node, carry, (rows, kappa))
    left, T_tip = closed(case, flat, end, equations.modes)
    return Passed(left, nodes, carry.tension, T_tip, end.slip, largest(error) * case.sections.mesh.s[-1])
