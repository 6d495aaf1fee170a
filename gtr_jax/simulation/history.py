"""A load history, step by step: base tension in; tip tension, pose and the state of the tendon out."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
import optimistix as optx
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from ..errors import InputError
from ..mechanics import Load, ProgramSpec, SolverOptions, steps
from ..mechanics.bodies import turning_of
from ..mechanics.sections import State
from ..notebook import as_card
from ..robot.robot import Robot, sections
from ..robot.validity import is_robot
from ..terms import OWN, known_on
from ..terms.term import NO_TUG
from ..terms.unmoved import NO_SLIP
from .arrays import SimulationArrays
from .displacement import by_tension, displacement_drives, driven
from .missed import trusted
from .outcome import unless_missed, unless_outside
from .programs import at_nodes, known_to_act, structure_of, unmoved_in
from .sensing import Reading, cells_show, shown
from .slipping import front_of, large_tension, moves_of
from .solution import (
    Equilibrium,
    Loaded,
    describe,
    drawn_out,
    loaded_of,
    stretch_of,
)
from .tables import simulation_dataset, simulation_frame

if TYPE_CHECKING:
    import pandas
    import xarray

Tree = TypeVar("Tree")
SHORTEST = 1e-9  # s, assumed between samples with equal times


class Simulation(SimulationArrays):
    """A load history of K steps on N nodes, SI units. Quantities of a tendon have a tendon axis where the
    robot has several tendons.

    Tensions are true tensions, except in `reading`, which holds what the load cells show, as do
    `simulation.csv` of the command `gtr simulate` and every recording. The two differ where a physics term of
    the cells (`tip-gain`, `zero-drift`, ...) acts.

    Attributes:
        T_base: true tension at the base, as given, (K, *tendons).
        time: since the first step [s], (K,); without given times one second per step.
        T_tip: true tension at the anchor, (K, *tendons).
        reading: T_base and T_tip as the load cells show them, (K, *tendons) each.
        tip_pose: x [m], y [m], angle [rad] of the midline's tip in the plane, (K, 3); in space those of its
            projection on the plane of x and y, which are not a position: take `tip`.
        displacement: tendon drawn out at the base since the robot settled with slack tendons, (K, *tendons).
        slip_direction: +1 where the tendon at the base slips towards the base in the step, -1 towards the
            tip, 0 at rest, (K, *tendons).
        slip_front: the tendon slips on [0, slip_front] and is locked beyond, (K, *tendons); L when all of it
            slips. Beside others, a tendon may slip again farther out; this is the front nearest the base.
        s: nodes, (N,).
        tension: along the tendons, (K, *tendons, N).
        slip: of the tendons towards the base, since the robot settled with slack tendons, (K, *tendons, N).
        curvature, angle: along the robot, (K, N); in space as of `Equilibrium`.
        external_moment: of the external loads, along the robot, (K, N); in space (K, N, 3).
        mobilisation: of friction, (K, tendons, N), as `Equilibrium.mobilisation`; None for one tendon.
        result: optimistix result per step, or `outside_physics`.
        residual_norm, iterations: per step, (K,).
        shape: of a robot in space at each step; None in the plane.
    """

    _repr_html_ = as_card

    def to_xarray(self, robot: Robot | None = None) -> xarray.Dataset:
        """The simulation as a dataset with labels and units: tensions (step, tendon), along the tendons
        (step, tendon, s), the body (step, s); without the dimension `tendon` where there is one.

        `T_base` and `T_tip` are what the load cells show, as in `simulation.csv` and in sweeps, `T_base_true`
        and `T_tip_true` the true tensions. Where two nodes are at one place, before and after a kink, the
        label of the latter is the next larger number.

        Args:
            robot: as simulated: its tendons give their names, and in the plane the places x and y of the
                body, and its markers, are there too. Without it tendons are numbered from "1".

        Raises:
            ValueError: it is traced by JAX, or a batch of simulations.
        """
        return simulation_dataset(self, robot)

    def to_pandas(self, robot: Robot | None = None) -> pandas.DataFrame:
        """A row for each step, with the columns of `simulation.csv`: SI, units in their names; arguments and
        errors as of `to_xarray`.
        """
        return simulation_frame(self, robot)

    def of_tendon(self, index: int) -> Simulation:
        """This run for one of several tendons, without the tendon axis."""
        own = ("T_base", "T_tip", "displacement", "slip_direction", "slip_front", "tension", "slip")
        taken = {name: getattr(self, name)[:, index] for name in own}
        cells = Reading(*(column[:, index] for column in self.reading))
        return dataclasses.replace(self, **taken, reading=cells, mobilisation=None)


def reading(robot: Robot, run: Simulation) -> Reading:
    """What the robot's load cells show of a simulation; the true tensions where no term of the cells acts.

    `run.reading` belongs to the robot that was simulated; this function takes any robot, for example one with
    other load cells.
    """
    return cells_show(robot, run.T_base, run.T_tip, run.time)


def padded_length(steps: int) -> int:
    """Length that a history is padded to, so that a few compiled programs serve all: 16, or at most a quarter
    more than its own.
    """
    if steps <= 16:
        return 16
    unit = 2 ** ((steps - 1).bit_length() - 3)
    return -(-steps // unit) * unit


@functools.partial(jax.jit, static_argnums=1)
def padded(history: Tree, steps: int) -> Tree:
    """A history of so many steps, arrays with the steps in their first axis, made `padded_length` long by
    repeating the last step.
    """
    missing = padded_length(steps) - steps

    def longer(values):
        return jnp.concatenate([values, jnp.broadcast_to(values[-1], (missing, *values.shape[1:]))])

    return jtu.tree_map(longer, history)


@functools.partial(jax.jit, static_argnums=1)
def _first(run: Simulation, steps: int) -> Simulation:
    """So many steps of a run."""
    own = {k: v if k == "s" else jtu.tree_map(lambda a: a[:steps], v) for k, v in vars(run).items()}
    return Simulation(**own)


def _solved(structure: ProgramSpec, robot: Robot, loads: Load, how: SolverOptions):
    """The steps, and the direction of slip along the tendons in each."""
    s = sections(robot)
    done, _, settled = steps(at_nodes(robot, s), structure, loads, how)
    loaded = jax.vmap(lambda step: loaded_of(s, structure, settled, step))(done)
    if done.moved is not None:
        # What was moved from outside moved the whole tendon that friction holds.
        away = jnp.cumsum(jnp.where(done.met, done.moved, 0.0))
        loaded = eqx.tree_at(lambda loaded: loaded.slip, loaded, loaded.slip + away[:, None])
    scale = large_tension(loads.T_base, settled.preload)
    rigid = robot.backbone.rigid
    return loaded, jax.vmap(lambda step, now: moves_of(s, structure, rigid, step, now, scale))(done, loaded)


@eqx.filter_jit
def _run(
    robot: Robot, loads: Load, how: SolverOptions, structure: ProgramSpec, drawn: Bool[Array, " K"]
) -> Simulation:
    """The run; `drawn` says which steps have the base tensions that were asked for."""
    done, moves = _solved(structure, robot, loads, how)
    valid = is_robot(robot)
    # What is read off the states is computed for all steps at once, outside the loop.
    s = sections(robot)
    eq = jax.vmap(lambda done: describe(s, robot.base, done))(done)
    fronts = jax.vmap(lambda sign: front_of(s.mesh.s, sign))
    preload = robot.per_tendon(lambda tendon: tendon.preload)
    stretch = jax.vmap(lambda eq: stretch_of(robot.tendons, s.mesh.s, eq.tension, eq.metric))(eq)
    direction, front = (fronts if moves.ndim == 2 else jax.vmap(fronts))(moves)
    met = (eq.result == optx.RESULTS.successful) & drawn
    good = trusted(structure, met, loads.T_base, preload, (direction, front), s.mesh.s[-1])
    return Simulation(
        T_base=loads.T_base,
        time=loads.time,
        T_tip=eq.T_tip,
        reading=Reading(loads.T_base, eq.T_tip),
        tip_pose=eq.tip_pose,
        displacement=drawn_out(robot.terms, eq.slip[..., 0], loads.T_base, preload) + stretch,
        slip_direction=direction,
        slip_front=front,
        s=s.mesh.s,
        tension=eq.tension,
        slip=eq.slip,
        curvature=eq.curvature,
        angle=eq.angle,
        external_moment=eq.external_moment,
        mobilisation=eq.mobilisation,
        result=unless_outside(unless_missed(eq.result, good), valid),
        residual_norm=eq.residual_norm,
        iterations=eq.iterations,
        shape=eq.shape,
    )


@jax.jit
def loads_of(
    T_base: Float[Array, "K *tendons"], time: Float[Array, " K"], cycle: Float[Array, " K"] | None
) -> Load:
    """A load history with its time steps and cycles."""
    first = jnp.where(time.shape[0] > 1, time[1:2] - time[:1], 1.0) if time.shape[0] > 1 else jnp.ones(1)
    dt = jnp.concatenate([first, jnp.diff(time)])
    dt = jnp.where(dt > 0, dt, SHORTEST)
    cycle = cycles(T_base) if cycle is None else cycle
    return Load(T_base, dt, time - time[0], cycle, jnp.diff(cycle, prepend=cycle[:1]))


def cycles(T_base: Float[Array, "K *tendons"]) -> Float[Array, " K"]:
    """Pulls and releases done at each step of a history, half a cycle each, (K,): the sum of the changes of
    base tension so far, over twice its range; of several tendons, the largest.
    """
    known = jnp.isfinite(T_base)
    change = jnp.abs(jnp.diff(T_base, axis=0, prepend=T_base[:1]))
    gone = jnp.cumsum(jnp.where(jnp.isfinite(change), change, 0.0), axis=0)
    most, least = (jnp.max, jnp.inf), (jnp.min, -jnp.inf)
    top, bottom = (f(jnp.where(known, T_base, -far), axis=0, keepdims=True) for f, far in (most, least))
    span = top - bottom
    done = gone / jnp.where(span > 0, 2 * span, 1.0)
    return done if done.ndim == 1 else jnp.max(done, axis=1)


def simulate(
    robot: Robot,
    T_base: ArrayLike | Sequence[float] | Sequence[Sequence[float]],
    *,
    time: ArrayLike | Sequence[float] | None = None,
    cycle: ArrayLike | Sequence[float] | None = None,
    displacement: ArrayLike | None = None,
    with_terms: bool | Collection[str] | None = None,
    solver: SolverOptions = SolverOptions(),  # noqa: B008
) -> Simulation:
    """Run a robot through a load history; any sequence of pulls, releases, re-pulls and holds.

    The tendon starts at its preload (slack unless the robot file says otherwise), the robot settled under its
    external loads. Differentiable in every number of the robot and in T_base.

    Args:
        robot: from `load_robot`, or built in Python.
        T_base: base tension at each step [N], (K,), K >= 1; with several tendons (K, tendons). Negative
            values count as slack.
        time: of each step [s], (K,), increasing; needed where a physics term depends on it.
        cycle: pulls and releases done at each step, (K,), for wear; counted from T_base unless given.
        displacement: how far the tendons that displacement drives (`Tendon.drive`) are drawn out at the base
            since they were strung [m], of the shape of T_base; neither it nor T_base is read where the other
            drives. A tendon that would have to push is slack.
        with_terms: which physics terms the program holds: True for all, though none may act, False for those
            of the load cells only, or their names. Unless given: those that act; under a transformation that
            traces their numbers, those that may act (`robot.acting`). There the numbers of another term that
            is not of the load cells have no effect, and derivatives of zero.
        solver: as for `equilibrium`.

    Returns:
        One entry per step: true tensions, and in `reading` what the load cells show of them. A step that
        does not converge is flagged in `result` and leaves the tendon's memory as it was; so are the steps
        after it, until nothing is left of what was missed (`simulation.missed`). Where the numbers are of no
        robot, the `result` of every other step is `outside_physics`.

    Raises:
        ValueError: T_base is not a history of at least one step, time or cycle not of its length, or there is
            no time for a term that needs it; time that goes back; no displacement of a tendon that it
            drives, or a term that moves its other end; a law of the slip (presliding, viscous friction)
            in a rigid sheath with a tendon that does not stretch, which never slips.
    """
    history, names = jnp.asarray(T_base, dtype=float), robot.tendon_names
    if names and history.shape[1:] != (len(names),):
        raise ValueError(
            f"T_base: a history of the tendons {', '.join(names)} has shape (steps, {len(names)}), "
            f"not {history.shape}"
        )
    if history.size == 0 or (not names and history.ndim != 1):
        raise ValueError(f"T_base: a history is one row of at least one tension, not shape {history.shape}")
    steps = history.shape[0]
    if time is None:
        _refuse_timed(robot)
    clock = jnp.arange(steps, dtype=float) if time is None else jnp.asarray(time, dtype=float)
    given = {"time": clock} | ({} if cycle is None else {"cycle": jnp.asarray(cycle, dtype=float)})
    for name, values in given.items():
        if values.shape != (steps,):
            raise ValueError(f"{name}: one value for each of the {steps} steps, not shape {values.shape}")
    back = np.zeros(0) if isinstance(clock, Tracer) else np.diff(np.asarray(clock)) < 0
    if np.any(back):
        at = int(np.argmax(back)) + 1
        raise ValueError(f"time: goes back at step {at + 1}; put the steps in the order of time")
    _refuse_unable(robot)
    structure, met = structure_of(robot, with_terms), jnp.ones(steps, bool)
    if displacement_drives(robot, history, displacement):
        drawn = jnp.asarray(displacement, dtype=float)
        moved = [tendon.drive == "displacement" for tendon in robot.tendons]
        ways = jnp.where(jnp.asarray(moved if names else moved[0]), drawn, history)
        given["cycle"] = given.get("cycle", cycles(ways))
        history, met = _tensions(robot, loads_of(history, clock, given["cycle"]), drawn, solver, structure)
    loads = loads_of(history, clock, given.get("cycle"))
    # One program serves every drive.
    loads, met = padded((loads, met), steps)
    run = _first(_run(by_tension(robot).for_any_terms(), loads, solver, structure, met), steps)
    # Without the padding, which a cell that lags or reads ahead would see.
    return dataclasses.replace(run, reading=shown(robot, run.T_base, run.T_tip, run.time))


def _tensions(
    robot: Robot, loads: Load, drawn: Float[Array, "K *tendons"], how: SolverOptions, structure: ProgramSpec
) -> tuple[Float[Array, "K *tendons"], Bool[Array, " K"]]:
    """Base tensions that draw the tendons out as far as wanted, and whether they do at each step.

    Where all numbers are known and native code has the equations, it finds them: for three tendons in space
    it compiles in 3 s, the program that has derivatives in 40 s. The latter has the last word where the
    former misses a displacement.
    """
    known = not any(isinstance(leaf, Tracer) for leaf in jtu.tree_leaves((robot, loads, drawn)))
    if known and not OWN & {*structure.terms}:
        from .natively import base_tensions  # imported here, since it takes a compiler that few runs need

        found = base_tensions(robot, structure, loads, how, drawn)
        if found is not None:
            return jnp.asarray(found), jnp.ones(found.shape[:1], bool)
    steps = loads.time.shape[0]
    pulled, wanted = padded((loads, drawn), steps)
    found = driven(robot.for_any_terms(), pulled, wanted, how, structure)
    return found.T_base[:steps], found.met[:steps]


def _refuse_unable(robot: Robot) -> None:
    """ValueError if a law of the slip acts where none can occur, or if an end is moved that no sliding
    friction holds.
    """
    by_slip = any(term.mobilise and known_on(term, robot.terms[term.id]) for term in robot.catalogue.values())
    for term in robot.catalogue.values():
        if term.tugged and known_on(term, robot.terms[term.id]) and (by_slip or robot.tendon_names):
            raise ValueError(f"{term.id}: {NO_TUG}")
    if not robot.backbone.rigid:
        return
    for kind in unmoved_in(robot):
        raise InputError(f"terms.{kind}: {NO_SLIP}")
    if robot.tendon_names and known_to_act(robot):
        raise ValueError("physics terms: a rigid sheath of several tendons takes those of the cells only")


def _refuse_timed(robot: Robot) -> None:
    """ValueError if a term acts that needs times; values that are traced are not checked."""
    for term in robot.catalogue.values():
        if term.timed and known_on(term, robot.terms[term.id]):
            raise ValueError(f"time: {term.id} depends on it; give the time of each step")


@eqx.filter_jit
def equilibrium_at(robot: Robot, run: Simulation, step: int | Int[Array, ""]) -> Equilibrium:
    """The equilibrium of one step of a simulation, with all that `Equilibrium` offers.

    Args:
        robot: as simulated.
        run: its simulation.
        step: counted from 0; negative ones from the end. One program serves all steps that are arrays.
    """
    s = sections(robot)
    at = {
        name: getattr(run, name)[step]
        for name in ("curvature", "angle", "external_moment", "tension", "T_tip", "slip", "mobilisation")
        if getattr(run, name) is not None
    }
    strain, direction = at["curvature"], at["angle"]
    if run.shape is not None:
        strain = run.shape.whole_strain[step]
        direction = jnp.einsum("ji,njk->nik", robot.base.rotation, run.shape.rotation[step])
    wrap = s.to_anchor(jnp.cumsum(turning_of(s, strain), axis=-1))
    return describe(
        s,
        robot.base,
        Loaded(
            state=State(strain, direction, wrap, at["external_moment"]),
            tension=at["tension"],
            T_tip=at["T_tip"],
            slip=at["slip"],
            wrap=wrap,
            mobilisation=at.get("mobilisation"),
            result=jtu.tree_map(lambda a: a[step], run.result),
            residual_norm=run.residual_norm[step],
            iterations=run.iterations[step],
        ),
    )
