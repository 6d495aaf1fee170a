"""One equilibrium of rod and tendon, and what is read off it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import optimistix as optx
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from gtr_jax.robot.robot import Robot, sections

from . import channel, mechanics, slip
from .adjoint import CausalAdjoint, split_tangents
from .linear_solver import node_first
from .march import March
from .mechanics import EVERY, FOREVER, Load, Memory, Settled, Step, Structure, in_order, rest_state, untouched
from .mesh import cumulative, increments
from .outcome import outcome
from .problem import Problem, Sections, State, at_tendons, residual, tension_of
from .terms import REGISTRY, any_on, known_on

MAX_STEPS = 256


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


def structure_of(robot: Robot, with_terms: bool | Collection[str] | None) -> Structure | None:
    """The equations that a robot asks for; None if numbers are being traced that decide it.

    Args:
        robot: the robot.
        with_terms: as for `simulate`.
    """
    if with_terms is None:
        acting = {kind: known_on(REGISTRY[kind], robot.terms[kind]) for kind in EVERY}
        if None in acting.values():
            return None
        with_terms = [kind for kind, on in acting.items() if on]
    elif isinstance(with_terms, bool):
        with_terms = EVERY if with_terms else ()
    terms = in_order(with_terms)
    loads = any(REGISTRY[kind].loads for kind in terms)
    return Structure(terms, len(robot.tendon_names), robot.loaded or loads)


def at_nodes(robot: Robot, s: Sections) -> mechanics.Robot:
    """The robot as the mechanics takes it."""
    return mechanics.Robot(
        sections=s,
        mu=robot.per_tendon(lambda tendon: tendon.friction_coefficient),
        preload=robot.per_tendon(lambda tendon: tendon.preload),
        tip_moment=robot.loads.tip_moment,
        terms=robot.terms,
    )


def loaded_of(s: Sections, structure: Structure, settled: Settled, done: Step) -> Loaded:
    """A load step, the nodes last; its slip in the base model is that of tendons that do not stretch."""

    def nodes_last(values):
        return jnp.moveaxis(values, 0, -1)

    wrap = nodes_last(jnp.cumsum(done.state.wrap, axis=0))
    if done.slip is None:
        slipped = slip_of(s, dataclasses.replace(done.state, kappa=settled.kappa), done.state)
    else:
        slipped = nodes_last(done.slip)
    several = done.mobilised is not None and bool(structure.tendons)
    return Loaded(
        state=dataclasses.replace(done.state, wrap=wrap),
        tension=nodes_last(done.tension),
        T_tip=done.T_tip,
        slip=slipped,
        wrap=wrap,
        mobilisation=nodes_last(done.mobilised) if several else None,
        result=optx.RESULTS.where(done.met, optx.RESULTS.successful, optx.RESULTS.nonlinear_max_steps_reached),
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


def by_structure(solved, pair, structure: Structure | None, robot: Robot, *rest):
    """What a program of some structure gives; where that is not known while tracing, one program has the base
    model and all physics terms and decides when it runs.

    Its derivatives by numbers of the terms are those with all terms, which at the null values is the same
    function.

    Args:
        solved: from a structure, the robot and the rest.
        pair: the base model of several tendons, from the robot and the rest.
        structure: which equations act, or None.
        robot, rest: the arguments.
    """

    def of(structure: Structure):
        if structure.tendons and not structure.terms:
            return pair
        return functools.partial(solved, structure)

    if structure is not None:
        return of(structure)(robot, *rest)
    both = tuple(of(Structure(terms, len(robot.tendon_names), robot.loaded or bool(terms))) for terms in ((), EVERY))
    return _either(both, (robot, *rest))


def _terms_act(robot: Robot) -> Bool[Array, ""]:
    """Whether any physics term is on that is not of the load cells."""
    return any_on(robot.terms, lambda term: not term.of_cells)


@eqx.filter_custom_jvp
def _either(choices, inputs):
    plain, with_terms = choices
    return jax.lax.cond(_terms_act(inputs[0]), with_terms, plain, *inputs)


@_either.def_jvp
def _either_jvp(primals, tangents):
    (plain, with_terms), inputs = primals
    inputs_dot = tangents[1]
    moving, fixed = split_tangents(inputs, inputs_dot)
    by_terms = jtu.tree_leaves(inputs_dot[0].terms)

    def chosen(moving):
        robot, *rest = eqx.combine(moving, fixed)
        if by_terms:
            return with_terms(robot, *rest)
        return jax.lax.cond(_terms_act(robot), with_terms, plain, robot, *rest)

    return eqx.filter_jvp(chosen, (moving,), (inputs_dot,))


def known_to_act(robot: Robot) -> bool | None:
    """Whether any physics term acts that is not of the load cells; None if that is being traced."""
    structure = structure_of(robot, None)
    return None if structure is None else bool(structure.terms)


@eqx.filter_jit
def _solve(
    robot: Robot,
    T_base: Float[Array, "*tendons"],
    before: Equilibrium | Float[Array, " N"] | None,
    atol: float,
    structure: Structure | None,
) -> Equilibrium:
    one = jnp.ones_like(robot.loads.tip_moment)

    def pair(robot, T_base, before):
        s, solver = sections(robot), March(atol=atol)
        settled, kept = at_preload(robot, s, solver)
        if isinstance(before, Equilibrium):
            kept = slip.Kept(before.tension, before.metric, before.mobilisation)
        done, _ = load_step(robot, s, T_base, kept, rest_state(s), settled, solver)
        plain = Structure((), len(robot.tendon_names), robot.loaded)
        memory = untouched(plain, done.state, node_first(done.tension), one)
        memory = dataclasses.replace(memory, T_base=T_base)
        return describe(s, done, mechanics.complete(memory, plain, done.state, node_first(done.slip)))

    def solved(structure: Structure, robot, T_base, before):
        s = sections(robot)

        def remembered(settled, never_pulled):
            if isinstance(before, Equilibrium) and before.memory is not None:
                return mechanics.part_of(before.memory, structure)
            if before is None:
                return never_pulled
            tension = before.tension if isinstance(before, Equilibrium) else before
            kept = untouched(structure, settled, node_first(tension), one)
            same = ("slip", "middle", "bent", "unknowns")
            return dataclasses.replace(kept, **{name: getattr(never_pulled, name) for name in same})

        forever = jnp.full((1,), FOREVER)
        load = Load(T_base[None], forever, 0 * forever, 0 * forever)
        done, memory, settled = mechanics.steps(at_nodes(robot, s), structure, load, atol, remembered)
        step = loaded_of(s, structure, settled, jtu.tree_map(lambda a: a[0], done))
        whole = mechanics.complete(memory, structure, step.state, node_first(step.slip))
        return describe(s, step, whole)

    return by_structure(solved, pair, structure, robot, T_base, before)


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
    return _solve(robot, load, memory, solver.atol, structure_of(robot, with_terms))
