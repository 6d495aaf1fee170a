"""The search for the unknowns at the base: Newton's method along a path that leads to the load step.

Without unknowns one or two marches solve the step. Otherwise Newton's method is tried on the whole step
first. If it does not converge, the change of base tension and external loads since the previous step is made
in parts, each started from the last one solved.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
from jaxtyping import Array, Bool, Float, Int

from .bodies import chords_of
from .case import Case, Grip
from .coulomb import EXACT, ROUND, SHORT, WHOLE, kept_near
from .grip import left_of, march_gripped, solved_linear
from .loop_lanes import in_lanes_of
from .march import Closing, Passed, march, march_differenced, march_plainly, passed
from .node import grip_of
from .program_spec import SolverOptions
from .sections import either_of, largest
from .small_matrices import inverse as inverse_of
from .small_matrices import times

REACH = 4e-3  # of the length: largest change of the displacement at a time while it is not bracketed
SHORTEST = 2.0**-12  # share of a Newton step below which a try is given up
MOST_PLAIN = 8  # most marches where nothing is unknown
PATIENCE, MOST_MARCHES = 60, 6000  # most marches at one part of the step, and in all
SHORTENED = 0.25  # Newton step over the previous one, below which it is trusted more than the bracket
MOST_CLOSINGS = 60  # most searches of a step until the chords of guided tendons are closed
STRAIGHT = 1e-4  # h sqrt(T/EI) below which a tendon does not bend a segment
LEAST_STIFF = 0.05  # least sin x/x with which a chord is corrected
FINER = 4  # factor on the number of parts of a load step that could not be solved
MOST_GRIPS = 64  # most steps of the search for the grip of several tendons, for a part of the load step
MOST_SLIDING = 4  # most parts in which a step is tried as predicted


class EquilibriumSearch(eqx.Module):
    """Where the search stands.

    Attributes:
        trial: the next point to try, in scaled unknowns, (n,).
        kappa: curvature to go with it [1/m], (N,).
        error: largest residual of the latest point, for its part of the load step.
        marches, tries: marches taken in all, and tries at this part of the load step.
        low, high: displacements at the base known to be too small and too large.
        step: the last Newton step; if damped, the whole one, of which a share is tried.
        point, inverse, level, share: the last point that damped steps accepted, the inverse of its Jacobian,
            the length of the step from there, and the share of it that is tried.
        parts, part: number of parts of the load step, and how many of them are done.
        damped: whether Newton's steps are damped.
        solved: whether the last part is solved.
        told: whether the tendon slips as predicted, `Case.sliding`, or is held where its tension may stay.
    """

    trial: Float[Array, " n"]
    kappa: Float[Array, "N *strain"]
    error: Float[Array, ""]
    marches: Int[Array, ""]
    tries: Int[Array, ""]
    low: Float[Array, ""]
    high: Float[Array, ""]
    point: Float[Array, " n"]
    step: Float[Array, " n"]
    inverse: Float[Array, "n n"]
    level: Float[Array, ""]
    share: Float[Array, ""]
    parts: Int[Array, ""]
    part: Int[Array, ""]
    damped: Bool[Array, ""]
    solved: Bool[Array, ""]
    told: Bool[Array, ""]


def scales(case: Case) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Scales of the unknowns, and of the residuals at the tip: the length for slip; moment and force that
    bend the body by about one radian; for the held stretch one for its level, and for its residual a
    hundredth of the length, about what that level changes the channel by.
    """
    what, length = case.structure, case.sections.mesh.s[-1]
    compliance = jnp.max(case.sections.compliance) * length
    moment = 1.0 / jnp.where(compliance > 0, compliance, 1.0)
    both = (
        jnp.broadcast_to(length, case.mu.shape) if what.seeks_slip else None,
        jnp.broadcast_to(moment, case.tip_moment.shape) if what.bends else None,
        moment / length if what.has_stop else None,
    )
    one, slip = (jnp.ones_like(length), 0.01 * length) if what.carries else (None, None)
    return Closing(*both, one).flat(), Closing(*both, slip).flat()


def _bracketed(at: EquilibriumSearch, left: Float[Array, " n"], inverse, by_unknowns) -> EquilibriumSearch:
    """The next point for one tendon: a Newton step whose displacement is kept between values known to be too
    small and too large. The slip at the anchor rises with the displacement, but where friction builds up over
    a short slip its slope changes so much that Newton's method alone would not find the root.
    """
    u = at.trial[0]
    low = jnp.where(left[0] < 0, jnp.maximum(at.low, u), at.low)
    high = jnp.where(left[0] > 0, jnp.minimum(at.high, u), at.high)
    # Moments and forces found meanwhile may have moved the root out of the bracket.
    lost = high - low < 1e-15
    low, high = jnp.where(lost, -jnp.inf, low), jnp.where(lost, jnp.inf, high)
    step = -times(inverse, left)
    new = u + step[0]
    both = jnp.isfinite(low) & jnp.isfinite(high)
    farther = jnp.where(left[0] < 0, u + REACH, u - REACH)
    within = jnp.where(both, 0.5 * (low + high), farther)
    known = both | (jnp.abs(step[0]) > REACH) | ~jnp.isfinite(new)
    cut = known & ~((new > low) & (new < high))
    if left.shape[0] > 1:
        # The other unknowns move the root, too. Keeping the bracket once Newton steps become short took 10 to
        # 40 marches beside a stop instead of 4 to 6.
        cut = cut & ~((at.tries > 0) & (jnp.abs(step[0]) <= SHORTENED * jnp.abs(at.step[0])))
    new = jnp.where(cut, within, new)
    if left.shape[0] > 1:
        # With the displacement cut, the other unknowns take the Newton step for this displacement.
        others = -times(inverse_of(by_unknowns[1:, 1:]), left[1:] + by_unknowns[1:, 0] * (new - u))
        step = jnp.where(cut, jnp.concatenate([(new - u)[None], others]), step)
    else:
        step = (new - u)[None]
    return _with(at, trial=at.trial + step, step=step, low=low, high=high)


def _damped(at: EquilibriumSearch, left: Float[Array, " n"], inverse) -> EquilibriumSearch:
    """The next point: a damped Newton step, shortened until the step that follows it is shorter (Deuflhard's
    natural monotonicity test).
    """
    good = (at.tries == 0) | (largest(times(at.inverse, left)) <= (1.0 - 0.25 * at.share) * at.level)
    step = -times(inverse, left)
    share = jnp.where(good, jnp.minimum(1.0, 2.0 * at.share), 0.5 * at.share)
    point, step = jnp.where(good, at.trial, at.point), jnp.where(good, step, at.step)
    return _with(
        at,
        trial=point + share * step,
        point=point,
        step=step,
        inverse=jnp.where(good, inverse, at.inverse),
        level=jnp.where(good, largest(step), at.level),
        share=share,
    )


def _with(at: EquilibriumSearch, **changed) -> EquilibriumSearch:
    return eqx.tree_at(lambda a: [getattr(a, name) for name in changed], at, list(changed.values()))


def _fresh(at: EquilibriumSearch) -> EquilibriumSearch:
    """The search before its first try at a part of the load step."""
    one = jnp.ones_like(at.error)
    return _with(
        at,
        tries=jnp.zeros_like(at.tries),
        low=-jnp.inf * one,
        high=jnp.inf * one,
        share=one,
    )


def case_at(case: Case, aim: Float[Array, ""]) -> Case:
    """The load step up to the share `aim`; for an `aim` from 1 to 2 the whole step, with `against` from 0 to
    1.
    """
    memory, s = case.memory, case.sections
    share = jnp.minimum(aim, 1.0)
    T_base = jnp.where(
        share < 1, memory.T_base + share * (case.load.T_base - memory.T_base), case.load.T_base
    )
    now = eqx.tree_at(lambda c: c.load.T_base, case, T_base)
    if case.structure.bends:
        carried = memory.carried + share * (1.0 - memory.carried)
        forces = (tuple(force * carried for force in s.force), case.tip_moment * carried)
        now = eqx.tree_at(lambda c: (c.sections.force, c.tip_moment), now, forces)
    if case.structure.has("by_speed"):
        now = eqx.tree_at(lambda c: c.against, now, jnp.clip(aim - 1.0, 0.0, 1.0))
    return now


class Found(NamedTuple):
    """A solved load step: the unknowns at the base, (n,), curvature [1/m], (N,), the last pass, the largest
    residual, the number of marches, the slopes of the chords of guided tendons, None without any, whether
    the tendon slips as predicted, None where nothing is, and how friction grips tendons that share their
    slip, None of others.
    """

    unknowns: Float[Array, " n"]
    kappa: Float[Array, "N *strain"]
    passed: Passed
    error: Float[Array, ""]
    marches: Int[Array, ""]
    slopes: Float[Array, "*tendons S 2"] | None = None
    told: Bool[Array, ""] | None = None
    grip: Grip | None = None


def with_slopes(case: Case, slopes) -> Case:
    """The load step with other slopes of the chords of guided tendons."""
    return eqx.tree_at(lambda c: c.sections.guides.slopes, case, slopes)


def with_sliding(case: Case, told: Bool[Array, ""] | None) -> Case:
    """The load step in which the tendon slips as predicted; as if nothing were predicted unless `told`."""
    if case.sliding is None or told is None:
        return case
    return eqx.tree_at(lambda c: c.sliding.confidence, case, jnp.where(told, case.sliding.confidence, 0.0))


def search(case: Case, how: SolverOptions) -> Found:
    """Solve a load step from the one before.

    Args:
        case: the load step.
        how: far the search goes.
    """
    return _open(case, how) if case.sections.guides is None else _closed(case, how)


def _open(case: Case, how: SolverOptions) -> Found:
    """As `search`, with the chords of guided tendons as they are."""
    if case.structure.shares_slip:
        return _by_grip(case, how)
    if case.structure.terms or case.structure.unknowns:
        return _by_path(case, how)
    return _at_once(case, how)


def _closed(case: Case, how: SolverOptions) -> Found:
    """As `search`, of guided tendons: until their chords are those of the shape that they were found with.

    A chord that starts steeper by da ends steeper by (1 - sin x/x) da, x = h sqrt(T/EI), as the beam that it
    bends over a segment of length h does; the step is Newton's with this derivative. At x = pi the tendon
    would bend the body between two guides without bound, and there is no such equilibrium.
    """
    s, guides = case.sections, case.sections.guides
    assert guides is not None

    def steps(found: Found, slopes):
        """Slopes of the chords of a shape, and of those to try next."""
        own = chords_of(s, found.kappa).slopes
        tension = jnp.moveaxis(found.passed.nodes.tension, 0, -1)
        soft = jnp.max(s.compliance[:, 1:3], axis=1)
        pull = jnp.take_along_axis(tension, guides.starts, axis=-1) * soft[guides.starts]
        square = pull * (s.mesh.s[guides.ends] - s.mesh.s[guides.starts]) ** 2
        x = jnp.sqrt(jnp.where(square > 0, square, 0.0))
        stiff = jnp.where(x > STRAIGHT, jnp.sin(x) / jnp.where(x > STRAIGHT, x, 1.0), 1.0)
        stiff = jnp.where(stiff > LEAST_STIFF, stiff, LEAST_STIFF)
        return own, slopes + (own - slopes) / stiff[..., None]

    def tried(slopes, unknowns):
        now = with_slopes(case, slopes)
        if unknowns is not None:
            now = eqx.tree_at(lambda c: c.memory.unknowns, now, unknowns)
        found = _open(now, how)
        return found, largest(jnp.where(guides.held[..., None, None], steps(found, slopes)[0] - slopes, 0.0))

    def unfinished(at):
        _, found, gap, count = at
        return ((gap > how.atol) | jnp.isnan(gap)) & (found.error <= how.atol) & (count < MOST_CLOSINGS)

    def again(at):
        slopes, found, _, count = at
        slopes = steps(found, slopes)[1]
        unknowns = found.unknowns if case.structure.unknowns else None
        new, gap = tried(slopes, unknowns)
        return slopes, new._replace(marches=found.marches + new.marches), gap, count + 1

    slopes = chords_of(s, case.memory.kappa).slopes
    found, gap = tried(slopes, None)
    slopes, found, gap, _ = jax.lax.while_loop(unfinished, again, (slopes, found, gap, jnp.asarray(1)))
    return found._replace(error=jnp.maximum(found.error, _finite(gap)), slopes=slopes)


def _finite(error):
    return jnp.where(jnp.isnan(error), jnp.inf, error)


def _at_once(case: Case, how: SolverOptions) -> Found:
    """The base model without external loads: one march solves it; further ones remove rounding."""

    def again(at):
        passed, count = at
        return march_plainly(case, passed.nodes.state.kappa, count > 0), count + 1

    def unfinished(at):
        passed, count = at
        return (count == 0) | (passed.error > how.atol) & (count < MOST_PLAIN)

    # Every march in the loop, so that it is compiled once.
    shapes = jax.eval_shape(march_plainly, case, case.memory.kappa, jnp.asarray(False))
    nothing = jtu.tree_map(lambda a: jnp.zeros(a.shape, a.dtype), shapes)
    start = in_lanes_of(case.varied, (nothing, jnp.asarray(0)))
    passed, count = jax.lax.while_loop(unfinished, again, start)
    return Found(jnp.zeros(0), passed.nodes.state.kappa, passed, _finite(passed.error), count)


def _by_path(case: Case, how: SolverOptions) -> Found:
    """Newton's method on the whole step; where it fails, on more and more parts, for one tendon first with
    damped steps, then with plain ones.

    Neither is better everywhere. Of 155 tip forces on soft robots, like those of `tests/sweep/test_sweep.py`,
    plain steps alone missed 3 and damped ones from four parts on 6, both in turn 2; of the two robots of
    `tests/mechanics/test_census.py` that do not converge, plain steps missed 24 steps and damped ones 12.
    Damped steps without parts are not tried: beside a stop they went to a root far from the previous step.
    """
    what = case.structure
    sizes, lefts = scales(case)
    both = bool(what.unknowns) and not what.tendons  # damped steps and plain ones
    whole = 2 if what.has("by_speed") else 1
    one, zero = jnp.ones(()), jnp.asarray(0)
    known = case.memory.unknowns
    first = jnp.zeros(0) if known is None else known / sizes
    begin = EquilibriumSearch(
        trial=first,
        kappa=case.memory.kappa,
        error=jnp.inf * one,
        marches=zero,
        tries=zero,
        low=-jnp.inf * one,
        high=jnp.inf * one,
        point=first,
        step=jnp.zeros_like(first),
        inverse=jnp.eye(first.shape[0]),
        level=jnp.inf * one,
        share=one,
        parts=zero + 1,
        part=zero,
        damped=jnp.asarray(bool(what.tendons)),
        solved=jnp.asarray(False),
        told=jnp.asarray(False) if case.sliding is None else jnp.any(case.sliding.confidence > 0),
    )

    def unfinished(at: EquilibriumSearch):
        within = at.parts.astype(float) <= 1.0 / how.smallest_stride
        return ~at.solved & (at.marches < MOST_MARCHES) & within

    def improved(at: EquilibriumSearch):
        now = case_at(with_sliding(case, at.told), (at.part + 1) / at.parts)
        if what.unknowns:
            flat, use = at.trial * sizes, at.marches > 0
            if what.space:
                m = march_differenced(now, flat, at.kappa, use, sizes)
            else:
                m = march(now, flat, at.kappa, use)
            left = m.left / lefts
            by_unknowns = m.by_unknowns / lefts[:, None] * sizes[None, :]
            inverse = inverse_of(by_unknowns)
            on = damped = _damped(at, left, inverse)
            if what.seeks_slip and not what.tendons:
                on = either_of(at.damped, damped, _bracketed(at, left, inverse, by_unknowns))
            elif not what.tendons:
                on = either_of(at.damped, damped, _with(at, trial=at.trial - times(inverse, left)))
            # The step counts as solved only if a pass with the curvature that it predicts confirms it.
            moved = (on.trial - at.trial) * sizes
            by = moved.reshape(-1, *[1] * m.kappa.ndim)
            corrected = m.kappa + jnp.sum(m.kappa_by * by, axis=0)
            check = passed(now, on.trial * sizes, corrected)
            error = _finite(jnp.maximum(largest(check.left / lefts), check.error))
            kappa = jnp.where(error <= how.atol, corrected, m.kappa)
            kappa = jnp.where(jnp.isfinite(kappa), kappa, at.kappa)
            broken = ~jnp.isfinite(largest(on.trial))
        else:
            m = march_plainly(now, at.kappa, at.marches > 0)
            on, kappa, error = at, m.nodes.state.kappa, _finite(m.error)
            kappa = jnp.where(jnp.isfinite(kappa), kappa, at.kappa)
            broken = ~jnp.isfinite(error)
        solved = error <= how.atol
        tries = at.tries + 1
        over = solved | (tries >= PATIENCE) | (on.share <= SHORTEST) | broken
        part = jnp.where(over, at.part + 1, at.part)
        last = part >= whole * at.parts
        # Several tendons often go on well from a part that was not quite solved.
        failed = over & ~solved & (last if what.tendons else True)
        again = either_of(over, _fresh(on), _with(on, tries=tries))
        parts = jnp.where(failed & (~at.damped if both else True), FINER * at.parts, at.parts)
        damped = at.damped ^ failed if both else at.damped
        told = at.told & (parts <= MOST_SLIDING)
        if case.sliding is not None:
            dropped = at.told & ~told
            parts, damped = jnp.where(dropped, 1, parts), damped & ~dropped
        return _with(
            again,
            trial=jnp.where(failed, first, jnp.where(broken, at.trial, on.trial)),
            kappa=jnp.where(failed, case.memory.kappa, kappa),
            error=error,
            marches=at.marches + 1,
            parts=parts,
            damped=damped,
            part=jnp.where(failed, 0, part),
            solved=solved & last,
            told=told,
        )

    done = jax.lax.while_loop(unfinished, improved, in_lanes_of(case.varied, begin))
    unknowns = done.trial * sizes
    last = passed(case_at(with_sliding(case, done.told), whole * one), unknowns, done.kappa)
    error = _finite(jnp.maximum(largest(last.left / lefts), last.error) if what.unknowns else last.error)
    return Found(unknowns, done.kappa, last, error, done.marches, told=done.told)


class Gripping(eqx.Module):
    """Where the search for how friction grips several tendons stands.

    Attributes:
        xi, base, kappa: the next point to try: how friction grips, (N, *tendons), the scaled unknowns at the
            base, (n,), and curvature to go with them [1/m], (N,).
        best, error: the best point of this part of the load step, its grip, base and curvature, and its
            largest residual.
        last: that of the point before.
        marches, tries: marches taken in all, and tries at this part.
        parts, part: number of parts of the load step, and how many of them are done.
        solved: whether the last part is solved.
    """

    xi: Float[Array, "N *tendons"]
    base: Float[Array, " n"]
    kappa: Float[Array, " N"]
    best: tuple[Grip, Array, Array]
    error: Float[Array, ""]
    last: Float[Array, ""]
    marches: Int[Array, ""]
    tries: Int[Array, ""]
    parts: Int[Array, ""]
    part: Int[Array, ""]
    solved: Bool[Array, ""]


def with_grip(case: Case, grip: Grip | None) -> Case:
    """The load step in which friction grips tendons that share their slip as told."""
    return case if grip is None else dataclasses.replace(case, grip=grip)


def _by_grip(case: Case, how: SolverOptions) -> Found:
    """Newton's method for how friction grips several tendons, on the whole load step; where it fails, on more
    and more parts of it. They often go on well from a part that was not quite solved.
    """
    sizes, lefts = scales(case)
    one, zero = jnp.ones(()), jnp.asarray(0)
    known, xi = case.memory.unknowns, case.memory.xi
    assert xi is not None
    begun = (xi, jnp.zeros(0) if known is None else known / sizes, case.memory.kappa)
    none = jnp.zeros_like(xi)
    best = (Grip(xi, none, none, case.memory.elements), *begun[1:])
    begin = Gripping(*begun, best, jnp.inf * one, jnp.inf * one, zero, zero, zero + 1, zero, zero > 0)

    def unfinished(at: Gripping):
        within = at.parts.astype(float) <= 1.0 / how.smallest_stride
        return ~at.solved & (at.marches < MOST_MARCHES) & within

    def improved(at: Gripping):
        now = case_at(case, (at.part + 1) / at.parts)
        grip, by_xi = grip_of(now, at.xi)
        m = march_gripped(with_grip(now, grip), by_xi, at.base * sizes, at.kappa, at.marches > 0)
        error = _finite(largest(jnp.concatenate([m.left.ravel(), m.at_tip / lefts, m.error[None]])))
        better = error < at.error
        best = either_of(better, (grip, at.base, m.kappa), at.best)
        least = jnp.minimum(error, at.error)
        met = least <= how.atol
        tries = at.tries + 1
        over = (
            (error <= EXACT) | (met & (error > 0.5 * at.last)) | (tries >= MOST_GRIPS) | ~jnp.isfinite(error)
        )
        step, on = solved_linear(m.linear, m.left, m.at_tip)
        share = jnp.where(at.tries % ROUND < WHOLE, 1.0, SHORT)
        stepped = (kept_near(at.xi + share * step, at.xi), at.base + share * on / sizes, m.kappa)
        nearest = (best[0].xi, *best[1:])
        part = jnp.where(over, at.part + 1, at.part)
        last = part >= at.parts
        failed = over & ~met & last
        start = either_of(failed, begun, either_of(over, nearest, stepped))
        fresh = over & ~last | failed
        return Gripping(
            *start,
            best=best,
            error=jnp.where(fresh, jnp.inf, least),
            last=jnp.where(fresh, jnp.inf, error),
            marches=at.marches + 1,
            tries=jnp.where(over, 0, tries),
            parts=jnp.where(failed, FINER * at.parts, at.parts),
            part=jnp.where(failed, 0, part),
            solved=over & met & last,
        )

    done = jax.lax.while_loop(unfinished, improved, in_lanes_of(case.varied, begin))
    grip, base, kappa = done.best
    whole = with_grip(case_at(case, one), grip)
    last = passed(whole, base * sizes, kappa)
    left = jnp.concatenate([left_of(whole, last).ravel(), last.left / lefts, last.error[None]])
    return Found(base * sizes, kappa, last, _finite(largest(left)), done.marches, grip=grip)
