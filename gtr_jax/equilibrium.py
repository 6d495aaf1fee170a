"""One equilibrium of rod and tendon, and what is read off it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from gtr_jax.robot.robot import Robot, sections

from . import channel, slip
from .adjoint import CausalAdjoint, split_tangents
from .linear_solver import node_first
from .march import March
from .mesh import cumulative, increments, shifted
from .outcome import outcome
from .problem import Problem, Sections, State, at_tendons, residual, tension_of
from .slip_march import Case, Load, Memory, Solved, slip_step, untouched
from .terms import REGISTRY, any_on, known_on

MAX_STEPS = 256
FOREVER = 1e15  # s, in which everything that creeps has crept


class Equilibrium(eqx.Module):
    """Solution of one equilibrium, SI units; N nodes from base to tip, panel ends twice. May carry batch axes
    in front. What belongs to a tendon has a tendon axis where the robot has several.

    Attributes:
        s: arc length of the nodes, (N,).
        curvature, angle: of the midline, (N,).
        tension: of the tendon, (*tendons, N).
        T_tip: tension at the tip's anchor, (*tendons,); what grips there may hold some of it back.
        slip: of the tendon towards the base, since the robot settled with slack tendons, (*tendons, N).
        external_moment: moment of the external loads, (N,).
        x, y: midline, (N,).
        wrap: total turning of the tendon since the base, (*tendons, N).
        tendon_angle: psi of the tendon's tangent from the x axis [rad], (*tendons, N).
        metric: nu = ds_c/ds of the channel, (*tendons, N).
        R: channel offset, (*tendons, N).
        tendon_length: length of the channel, (*tendons,).
        mobilisation: of friction between each node and the one before it, +1 slipping towards the base, -1
            towards the tip, between where locked, (tendons, N); None for one tendon.
        result: optimistix result; compare with `optimistix.RESULTS.successful`.
        residual_norm: dimensionless, see `problem.residual_norm`; ().
        iterations: marches taken, ().
        memory: what physics terms remember, for the next equilibrium; None if read off a simulation.
    """

    s: Float[Array, " N"]
    curvature: Float[Array, " N"]
    angle: Float[Array, " N"]
    tension: Float[Array, "*tendons N"]
    T_tip: Float[Array, "*tendons"]
    slip: Float[Array, "*tendons N"]
    external_moment: Float[Array, " N"]
    x: Float[Array, " N"]
    y: Float[Array, " N"]
    wrap: Float[Array, "*tendons N"]
    tendon_angle: Float[Array, "*tendons N"]
    metric: Float[Array, "*tendons N"]
    R: Float[Array, "*tendons N"]
    tendon_length: Float[Array, "*tendons"]
    mobilisation: Float[Array, "tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]
    memory: Memory | None = None

    @property
    def tip_pose(self) -> Float[Array, "*batch 3"]:
        """Midline tip: x [m], y [m], angle [rad]."""
        return jnp.stack([self.x[..., -1], self.y[..., -1], self.angle[..., -1]], axis=-1)

    @property
    def converged(self) -> Bool[Array, "*batch"]:
        """True where the solver met its tolerance."""
        return self.result == optx.RESULTS.successful

    def of_tendon(self, index: int) -> Equilibrium:
        """What this solution is for one of several tendons: the same, without the tendon axis."""
        own = ("tension", "T_tip", "slip", "wrap", "tendon_angle", "metric", "R", "tendon_length")
        taken = {name: getattr(self, name)[index] for name in own}
        return dataclasses.replace(self, **taken, mobilisation=None, memory=None)


def rest_state(s: Sections) -> State:
    """Start for the solver: the stress-free shape, with the moment the external load would have on a straight
    arm.
    """
    phi = cumulative(s.mesh.weights, s.rest)
    lever = jnp.sum(s.mesh.interval.length * (s.force_y * jnp.cos(phi) - s.force_x * jnp.sin(phi)))
    return State(
        s.rest,
        phi,
        jnp.zeros_like(s.R.value),
        jnp.broadcast_to(jnp.where(jnp.any(s.compliance > 0), lever, 0.0), s.rest.shape),
    )


def solve_problem(p: Problem, start: State, solver: optx.AbstractRootFinder) -> optx.Solution:
    """Solve one problem from a start, with the implicit adjoint through the structured linear solver; never
    raises.
    """
    return optx.root_find(
        residual,
        solver,
        jax.lax.stop_gradient(start),
        args=p,
        adjoint=CausalAdjoint(),
        max_steps=MAX_STEPS,
        throw=False,
    )


def metric_of(s: Sections, y: State) -> Float[Array, "*tendons N"]:
    """nu = ds_c/ds of the channels, (*tendons, N)."""
    return channel.metric_factor(at_tendons(y.kappa, s.R), s.R)


def tendon_length(s: Sections, y: State) -> Float[Array, "*tendons"]:
    """Length of the channels from base to tip [m], (*tendons,)."""

    def length(metric):
        return jnp.sum(increments(s.mesh.weights, metric))

    metric = metric_of(s, y)
    return length(metric) if metric.ndim == 1 else jax.vmap(length)(metric)


def slip_of(s: Sections, settled: State, y: State) -> Float[Array, "*tendons N"]:
    """Slip of the tendons towards the base since the robot settled [m], if they do not stretch."""

    def beyond(shortened):
        drawn = cumulative(s.mesh.weights, shortened)
        return drawn[-1] - drawn

    shortened = metric_of(s, settled) - metric_of(s, y)
    return beyond(shortened) if shortened.ndim == 1 else jax.vmap(beyond)(shortened)


class Loaded(eqx.Module):
    """A load step solved: the state, the tendons, and how far the solver came; attributes as those of
    `Equilibrium`.
    """

    state: State
    tension: Float[Array, "*tendons N"]
    T_tip: Float[Array, "*tendons"]
    slip: Float[Array, "*tendons N"]
    wrap: Float[Array, "*tendons N"]
    mobilisation: Float[Array, "tendons N"] | None
    result: optx.RESULTS
    residual_norm: Float[Array, ""]
    iterations: Int[Array, ""]

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether everything met its tolerance."""
        return self.result == optx.RESULTS.successful


def load_step(
    robot: Robot,
    s: Sections,
    T_base: Float[Array, "*tendons"],
    kept: slip.Kept,
    start: State,
    settled: State,
    solver: optx.AbstractRootFinder,
    xi: Float[Array, "*tendons N"] | None = None,
) -> tuple[Loaded, Float[Array, "*tendons N"] | None]:
    """Solve one load step of the base model: by tension against the base for one tendon, by slip for several.

    Args:
        robot, s: the robot, and it at its nodes.
        T_base: base tension [N], (*tendons,).
        kept: what the tendons remember of the step before.
        start: state to start from.
        settled: state with slack tendons, from which slip counts.
        solver: see `equilibrium`.
        xi: for several tendons, unknown of the friction law to start from; zero if None.

    Returns:
        The step, and that unknown; None for one tendon.
    """
    if not robot.tendon_names:
        p = problem_of(robot, s, T_base, kept.tension)
        sol = solve_problem(p, start, solver)
        norm, count, held, wrap = (
            sol.stats["residual_norm"],
            sol.stats["num_steps"],
            sol.result,
            sol.value.wrap,
        )
        gripped = None
    else:
        p = problem_of(robot, s, T_base, None)
        first = jnp.zeros_like(kept.tension) if xi is None else xi
        grip = slip.hold(p, kept, start, first, solver, MAX_STEPS)
        p = dataclasses.replace(p, mobilisation=slip.mobilisation(grip.xi))
        sol = solve_problem(p, start, solver)
        held = optx.RESULTS.where(grip.converged, sol.result, optx.RESULTS.nonlinear_max_steps_reached)
        norm, count = jnp.maximum(sol.stats["residual_norm"], grip.error), grip.steps
        wrap, gripped = jnp.cumsum(slip.turning(sol.value, p), axis=-1), grip.xi
    tension = tension_of(sol.value, p)
    mobilised = None if gripped is None else slip.mobilisation(gripped)
    slipped = slip_of(s, settled, sol.value)
    done = Loaded(sol.value, tension, tension[..., -1], slipped, wrap, mobilised, held, norm, count)
    return done, gripped


def at_preload(robot: Robot, s: Sections, solver: optx.AbstractRootFinder) -> tuple[State, slip.Kept]:
    """The base model before its first load: settled with its tendons slack, then strung to their preloads
    without friction.
    """
    slack = jnp.zeros_like(preload_of(robot, s))
    p = problem_of(robot, s, slack[..., 0], slack)
    settled = solve_problem(p, rest_state(s), solver).value
    if not robot.tendon_names:
        return settled, slip.Kept(preload_of(robot, s), metric_of(s, settled), None)
    p = problem_of(robot, s, preload_of(robot, s)[..., 0], None, slack)
    strung = solve_problem(p, settled, solver).value
    return settled, slip.Kept(preload_of(robot, s), metric_of(s, strung), slack)


def terms_act(robot: Robot) -> Bool[Array, ""]:
    """Whether any physics term is on that is not of the load cells."""
    return any_on(robot.terms, lambda term: not term.of_cells)


def steps_by_slip(
    robot: Robot,
    s: Sections,
    loads: Load,
    solver: optx.AbstractRootFinder,
    before: Callable[[State, Memory], Memory] | None = None,
) -> tuple[Loaded, Memory, Memory]:
    """Solve load steps with physics terms, one after another.

    The robot first settles with slack tendons, which are then strung to their preloads without friction:
    steps like any other, so that one program does all.

    Args:
        robot, s: the robot, and it at its nodes.
        loads: K of them.
        solver: see `equilibrium`; its tolerance is used.
        before: what is remembered at the first load, from the settled state and what a robot remembers that
            was never pulled; that unless given.

    Returns:
        The steps, what is remembered before each, and what after, all with a leading axis K. A step that does
        not converge leaves the memory as it was.
    """
    preload = preload_of(robot, s)
    strung_to = preload[..., 0]
    slack, one = jnp.zeros_like(preload), jnp.ones_like(robot.loads.tip_moment)
    p = dataclasses.replace(problem_of(robot, s, slack[..., 0], slack), loaded=not robot.backbone.rigid)
    start = jax.lax.stop_gradient(solve_problem(p, rest_state(s), solver).value)
    # What bends the body has bent it from its natural shape; only the search starts from `start`.
    memory = dataclasses.replace(untouched(s, start, slack), kappa=s.rest)
    nothing = Load(slack[..., 0], FOREVER * one, 0 * one, 0 * one)
    case = Case(
        sections=s,
        mu=robot.per_tendon(lambda tendon: tendon.friction_coefficient),
        preload=slack[..., 0],
        tip_moment=robot.loads.tip_moment,
        terms=robot.terms,
        metric=node_first(jnp.ones_like(preload)),
        load=nothing,
        memory=memory,
        against=one,
    )
    atol = getattr(solver, "atol", 1e-9)

    def step(carry, at):
        memory, metric, preloaded = carry
        load, (settling, stringing) = at
        now = dataclasses.replace(
            case,
            metric=metric,
            preload=preloaded,
            mu=jnp.where(stringing, 0.0, case.mu),
            terms=_where(stringing, _without_friction(robot.terms), robot.terms),
        )
        done = slip_step(now, load, memory, atol)
        met = (done.error <= atol) & jnp.all(jnp.isfinite(load.T_base)) & jnp.isfinite(load.dt + load.time)
        settled = dataclasses.replace(
            untouched(s, done.state, slack),
            bent=done.memory.bent,
            unknowns=done.memory.unknowns.at[: strung_to.size].set(0.0),
        )
        strung = dataclasses.replace(
            done.memory, **{name: 0 * getattr(memory, name) for name in ("speed", "mobilised", "elements")}
        )
        strung = strung if before is None else before(done.state, strung)
        after = _where(settling, settled, _where(met, _where(stringing, strung, done.memory), memory))
        metric = _where(settling, node_first(metric_of(s, done.state)), metric)
        preloaded = _where(settling, strung_to, preloaded)
        return (after, metric, preloaded), (_loaded(done, met), memory, after)

    first = jtu.tree_map(
        lambda a, b: jnp.stack([a, b]), nothing, dataclasses.replace(nothing, T_base=strung_to)
    )
    loads = jtu.tree_map(lambda a, b: jnp.concatenate([a, b]), first, loads)
    at = jnp.arange(loads.time.shape[0])
    steps = jax.lax.scan(step, (memory, case.metric, case.preload), (loads, (at == 0, at == 1)))[1]
    return jtu.tree_map(lambda a: a[2:], steps)


def _without_friction(terms: dict[str, dict[str, Array]]) -> dict[str, dict[str, Array]]:
    """The numbers of the terms, those that are friction at null."""
    hooks = ("drag", "base_grip", "tip_grip", "by_speed")

    def values(term):
        if all(getattr(term, hook) is None for hook in hooks):
            return terms[term.id]
        return {q.name: jnp.full_like(terms[term.id][q.name], q.null) for q in term.quantities}

    return {term.id: values(term) for term in REGISTRY.values()}


def _where(holds: Bool[Array, ""], this, that):
    return jtu.tree_map(lambda a, b: jnp.where(holds, a, b), this, that)


def _loaded(done: Solved, met: Bool[Array, ""]) -> Loaded:
    """A step with physics terms, the nodes last."""

    def nodes_last(values):
        return jnp.moveaxis(values, 0, -1)

    wrap = nodes_last(jnp.cumsum(done.state.wrap, axis=0))
    return Loaded(
        state=dataclasses.replace(done.state, wrap=wrap),
        tension=nodes_last(done.memory.tension),
        T_tip=done.memory.T_tip,
        slip=nodes_last(done.memory.slip),
        wrap=wrap,
        mobilisation=nodes_last(done.memory.mobilised) if done.memory.T_tip.ndim else None,
        result=optx.RESULTS.where(met, optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached),
        residual_norm=done.error,
        iterations=done.marches,
    )


def describe(s: Sections, loaded: Loaded, memory: Memory | None = None) -> Equilibrium:
    """Everything an equilibrium offers, from the solved state."""
    y = loaded.state
    return Equilibrium(
        s=s.mesh.s,
        curvature=y.kappa,
        angle=y.phi,
        tension=loaded.tension,
        T_tip=loaded.T_tip,
        slip=loaded.slip,
        external_moment=y.moment,
        x=cumulative(s.mesh.weights, jnp.cos(y.phi)),
        y=cumulative(s.mesh.weights, jnp.sin(y.phi)),
        wrap=loaded.wrap,
        tendon_angle=at_tendons(y.phi, s.R) + channel.tangent_lead(at_tendons(y.kappa, s.R), s.R),
        metric=metric_of(s, y),
        R=s.R.value,
        tendon_length=tendon_length(s, y),
        mobilisation=loaded.mobilisation,
        result=outcome(loaded.result),
        residual_norm=loaded.residual_norm,
        iterations=loaded.iterations,
        memory=memory,
    )


def problem_of(
    robot: Robot,
    s: Sections,
    T_base: Float[Array, "*tendons"],
    memory: Float[Array, "*tendons N"] | None,
    mobilisation: Float[Array, "*tendons N"] | None = None,
) -> Problem:
    """One load step of the robot as a problem; a base tension below zero counts as slack."""
    return Problem(
        sections=s,
        mu=robot.per_tendon(lambda tendon: tendon.friction_coefficient),
        T_base=jnp.where(T_base < 0.0, 0.0, T_base),  # not maximum: its derivative at 0 is one half
        memory=memory,
        mobilisation=mobilisation,
        tip_moment=robot.loads.tip_moment,
        loaded=robot.loaded,
    )


def preload_of(robot: Robot, s: Sections) -> Float[Array, "*tendons N"]:
    """Tension along the tendons before the first load [N], (*tendons, N)."""
    return jnp.broadcast_to(robot.per_tendon(lambda tendon: tendon.preload)[..., None], s.R.value.shape)


def either(plain, by_slip, with_terms: bool | None, robot: Robot, *rest):
    """plain(robot, *rest) while no physics term acts, else by_slip(robot, *rest).

    Args:
        plain, by_slip: the base model, and the one with physics terms.
        with_terms: True or False for one of the two; None for one program that has both and decides when it
            runs. Its derivatives by numbers of the terms are those of `by_slip`, which at the null values is
            the same function.
        robot, rest: their arguments.
    """
    if with_terms is None:
        return _either((plain, by_slip), (robot, *rest))
    return by_slip(robot, *rest) if with_terms else plain(robot, *rest)


@eqx.filter_custom_jvp
def _either(choices, inputs):
    plain, by_slip = choices
    return jax.lax.cond(terms_act(inputs[0]), by_slip, plain, *inputs)


@_either.def_jvp
def _either_jvp(primals, tangents):
    (plain, by_slip), inputs = primals
    inputs_dot = tangents[1]
    moving, fixed = split_tangents(inputs, inputs_dot)
    by_terms = jtu.tree_leaves(inputs_dot[0].terms)

    def chosen(moving):
        robot, *rest = eqx.combine(moving, fixed)
        if by_terms:
            return by_slip(robot, *rest)
        return jax.lax.cond(terms_act(robot), by_slip, plain, robot, *rest)

    return eqx.filter_jvp(chosen, (moving,), (inputs_dot,))


def known_to_act(robot: Robot) -> bool | None:
    """Whether any physics term acts that is not of the load cells; None if that is being traced."""
    acting = [known_on(term, robot.terms[term.id]) for term in REGISTRY.values() if not term.of_cells]
    return None if None in acting else any(acting)


@eqx.filter_jit
def _solve(
    robot: Robot,
    T_base: Float[Array, "*tendons"],
    before: Equilibrium | Float[Array, " N"] | None,
    solver: optx.AbstractRootFinder,
    with_terms: bool | None,
) -> Equilibrium:
    def plain(robot, T_base, before):
        s = sections(robot)
        settled, kept = at_preload(robot, s, solver)
        if isinstance(before, Equilibrium):
            kept = slip.Kept(before.tension, before.metric, before.mobilisation)
        elif before is not None:
            kept = slip.Kept(before, kept.metric, None)
        done, _ = load_step(robot, s, T_base, kept, rest_state(s), settled, solver)
        memory = dataclasses.replace(
            untouched(s, done.state, done.tension),
            slip=node_first(done.slip),
            middle=node_first(0.5 * (done.slip + shifted(done.slip, 1, done.slip[..., :1]))),
            T_base=T_base,
        )
        return describe(s, done, memory)

    def by_slip(robot, T_base, before):
        s = sections(robot)

        def remembered(settled, never_pulled):
            if isinstance(before, Equilibrium) and before.memory is not None:
                return before.memory
            if before is None:
                return never_pulled
            tension = before.tension if isinstance(before, Equilibrium) else before
            kept = untouched(s, settled, tension)
            same = ("slip", "middle", "bent", "unknowns")
            return dataclasses.replace(kept, **{name: getattr(never_pulled, name) for name in same})

        forever = jnp.full((1,), FOREVER)
        load = Load(T_base[None], forever, 0 * forever, 0 * forever)
        steps = steps_by_slip(robot, s, load, solver, remembered)
        done, _, memory = jtu.tree_map(lambda a: a[0], steps)
        return describe(s, done, memory)

    return either(plain, by_slip, with_terms, robot, T_base, before)


def equilibrium(
    robot: Robot,
    T_base: ArrayLike | Sequence[float],
    *,
    memory: Equilibrium | Float[Array, " N"] | None = None,
    with_terms: bool | None = None,
    solver: optx.AbstractRootFinder = March(),  # noqa: B008
) -> Equilibrium:
    """Equilibrium of the robot under a base tension.

    Physics terms act as they do once everything has come to rest: nothing moves, what creeps has crept.

    Without `memory` the tendon is pulled once from its preload (slack unless the robot says otherwise);
    several tendons are pulled together, in one step.
    Differentiable in every number of the robot and in T_base, by the implicit function theorem; one-sided at
    stick fronts.

    Args:
        robot: from `load_robot`, or built in Python.
        T_base: tension at the base [N], scalar; with several tendons one each, (tendons,).
        memory: the equilibrium before this load; for one tendon its tension [N], (N,), will do.
        with_terms: as for `simulate`.
        solver: any optimistix root finder that takes a `Problem`; tolerances live there.

    Returns:
        The solution. It never raises on non-convergence: look at `result`, `converged` and `residual_norm`.

    Raises:
        ValueError: T_base has another shape, or the memory of several tendons is no equilibrium.
    """
    load, names = jnp.asarray(T_base, dtype=float), robot.tendon_names
    if names and load.shape != (len(names),):
        raise ValueError(
            f"T_base: one base tension for each of the tendons {', '.join(names)}, not shape {load.shape}"
        )
    if not names and load.ndim != 0:
        raise ValueError(
            f"T_base: one base tension, not shape {load.shape}; jax.vmap over several, or simulate"
        )
    if names and memory is not None and not isinstance(memory, Equilibrium):
        raise ValueError(
            "memory: several tendons remember more than their tension; give the equilibrium before"
        )
    return _solve(robot, load, memory, solver, known_to_act(robot) if with_terms is None else with_terms)
