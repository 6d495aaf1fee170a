"""Load histories without derivatives, as native code: what the tendons do, the pose, and the slip."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .. import mechanics
from ..errors import InputError
from ..kept import Kept
from ..mechanics import (
    FOREVER,
    Load,
    ProgramSpec,
    SolverOptions,
    Step,
    Unloaded,
    advance,
    begin,
    loads_before,
)
from ..mechanics.bodies import line_of, metric_of
from ..native.program import Program, origin, packed, sources
from ..native.values import Untranslatable
from ..robot.parts import Tendon
from ..robot.robot import Robot, sections
from ..terms import OWN
from .displacement import TOLERANCE, compliance, search
from .missed import trusted
from .programs import at_nodes
from .slipping import front_of, large_tension, moves_of
from .solution import drawn_out, loaded_of, stretch_of

__all__ = [
    "Brief",
    "Native",
    "ProgramSpec",
    "Ready",
    "Run",
    "base_tensions",
    "ready",
    "sources",
    "steps_natively",
]

# Step of the differences by which a displacement answers to tensions, as a share of a large tension.
STEP = 1e-6
# Load histories that go side by side; one costs as much as four. With eight, each costs 0.9 times as much as
# with four where the processor's vectors hold eight numbers, and one alone nearly twice as much.
LANES = 4


class Place(NamedTuple):
    """Where the body of a robot in space is at K steps, as in `Shape`, at N nodes.

    Attributes:
        strain: in the axes of the section [1/m], (K, N, 3).
        rotation: directors of the section as columns, in the axes of the world, (K, N, 3, 3).
        position: of the midline in the world [m], (K, N, 3).
        stretch: of the axis [-], (K, N); None of a body that does not stretch.
    """

    strain: Float[np.ndarray, "K N 3"]
    rotation: Float[np.ndarray, "K N 3 3"]
    position: Float[np.ndarray, "K N 3"]
    stretch: Float[np.ndarray, "K N"] | None = None


class Along(NamedTuple):
    """Where the body of a robot in the plane is at K steps: curvature [1/m] and angle [rad], (K, N) each."""

    curvature: Float[np.ndarray, "K N"]
    angle: Float[np.ndarray, "K N"]


class Brief(NamedTuple):
    """A load history of K steps, SI; as in `Simulation`.

    Attributes:
        T_base: true tension at the base, (K, *tendons).
        T_tip: true tension at the anchor, (K, *tendons).
        tip_pose: x, y, angle of the midline's tip, (K, 3); in space those of its projection on the plane of x
            and y.
        displacement: tendon drawn out at the base, (K, *tendons).
        slip_direction: of the tendon at the base, (K, *tendons).
        slip_front: the tendon slips on [0, slip_front], (K, *tendons).
        converged: whether each step met its tolerance, (K,).
        residual_norm, iterations: per step, (K,).
        bent: largest curvature that the tendons gave the body since it settled [1/m], (K,).
        along: the body of a robot in the plane that has markers; else None.
        shape: the body of a robot in space: at all its N nodes if it has markers, else at its tip alone; None
            in the plane.
    """

    T_base: Float[np.ndarray, "K *tendons"]
    T_tip: Float[np.ndarray, "K *tendons"]
    tip_pose: Float[np.ndarray, "K 3"]
    displacement: Float[np.ndarray, "K *tendons"]
    slip_direction: Float[np.ndarray, "K *tendons"]
    slip_front: Float[np.ndarray, "K *tendons"]
    converged: Bool[np.ndarray, " K"]
    residual_norm: Float[np.ndarray, " K"]
    iterations: Int[np.ndarray, " K"]
    bent: Float[np.ndarray, " K"]
    along: Along | None = None
    shape: Place | None = None


class _Row(NamedTuple):
    """One step: its load, how far tendons are to be drawn out [m], (*tendons,), or None where tension drives
    all, whether the robot settles, whether it is strung, and a tension that counts as large [N].
    """

    load: Load
    drawn: Float[Array, "*tendons"] | None
    settling: Bool[Array, ""]
    stringing: Bool[Array, ""]
    scale: Float[Array, ""]


class _Given(NamedTuple):
    """Numbers of a robot: at its nodes; its tendons where they may stretch by themselves or displacement
    drives any, else none; and their typical compliance [m/N], (tendons,), where it drives any, else None.
    """

    robot: mechanics.NodalRobot
    tendons: tuple[Tendon, ...]
    give: Float[Array, " tendons"] | None


def _given(robot: Robot) -> _Given:
    drawn = _drawn(robot.tendons)
    tendons = robot.tendons if robot.space or drawn else ()
    return _Given(at_nodes(robot, sections(robot)), tendons, compliance(robot) if drawn else None)


def _drawn(tendons: tuple[Tendon, ...]) -> bool:
    return any(tendon.drive == "displacement" for tendon in tendons)


class _Kind(NamedTuple):
    """What a program has to leave: of a rigid body or not, and of its whole midline or of its tip alone."""

    rigid: bool
    whole: bool


def _left(given: _Given, structure: ProgramSpec, kind: _Kind, settled: Unloaded, step: Step, row: _Row):
    """What a step leaves, as numbers."""
    robot = given.robot
    s = robot.sections
    done = loaded_of(s, structure, settled, step)
    moves = moves_of(s, structure, kind.rigid, step, done, row.scale)
    fronts = functools.partial(front_of, s.mesh.s)
    direction, front = (fronts if moves.ndim == 1 else jax.vmap(fronts))(moves)
    state = done.state
    if structure.space:
        at = slice(None) if kind.whole else slice(-1, None)
        place = jnp.stack(line_of(s, state.phi, state.kappa), axis=-1)
        body = [state.kappa[at].ravel(), state.phi[at].ravel(), place[at].ravel()]
        bent = jnp.max(jnp.sqrt(jnp.sum((state.kappa - settled.kappa)[:, 1:3] ** 2, axis=-1)))
    else:
        x, y = (along[-1] for along in line_of(s, state.phi, state.kappa))
        body = [jnp.stack([x, y, state.phi[-1]]), *([state.kappa, state.phi] if kind.whole else [])]
        bent = jnp.max(jnp.abs(state.kappa - settled.kappa))
    out = drawn_out(robot.terms, done.slip[..., 0], row.load.T_base, robot.preload)
    if given.tendons:
        metric = metric_of(s, state.kappa)
        out = out + stretch_of(given.tendons, s.mesh.s, s.ended(done.tension), metric)
    moved = jnp.zeros(()) if step.moved is None else jnp.where(step.met, step.moved, 0.0)
    each = (row.load.T_base, done.T_tip, out, direction, front)
    return each, (step.met, step.error, step.marches, bent, moved), body


def _driven(given: _Given, structure: ProgramSpec, how: SolverOptions, settled: Unloaded, row: _Row, before):
    """One load step of tendons some of which displacement drives: the base tensions at which these are drawn
    out as far as they should be, and whether they are.

    Args:
        given, structure, how, settled, row: as for a step.
        before: base tensions of the previous step [N], (tendons,); negative where a tendon would have to
            push.
    """
    assert given.give is not None and row.drawn is not None
    give, drawn = given.give, row.drawn
    by_draw = jnp.asarray([tendon.drive == "displacement" for tendon in given.tendons])
    known = jnp.atleast_1d(row.load.T_base)
    # The steps that settle and string the robot are driven by tension.
    free = by_draw & ~(row.settling | row.stringing)
    length = given.robot.sections.mesh.s[-1]

    def load_at(x):
        return dataclasses.replace(row.load, T_base=jnp.where(x > 0, x, 0.0).reshape(drawn.shape))

    def miss(x):
        load = load_at(x)
        _, step = advance(given.robot, structure, how, settled, load, (row.settling, row.stringing))
        s = given.robot.sections
        done = loaded_of(s, structure, settled, step)
        out = drawn_out(given.robot.terms, done.slip[..., 0], load.T_base, given.robot.preload)
        metric = metric_of(s, done.state.kappa)
        out = out + stretch_of(given.tendons, s.mesh.s, s.ended(done.tension), metric)
        out = jnp.atleast_1d(out - drawn) + give * jnp.where(x > 0, 0.0, x)
        return jnp.where(free, out, give * (x - known))

    def tried(x):
        # In a loop, so that the load step is compiled once. Differences go the way that the search has to go:
        # where a tendon turns, its slope is another on the other side.
        size = STEP * row.scale

        def once(here, way):
            aside = jnp.where(here > 0, -size, size)
            found = miss(x + way * aside)
            return jnp.where(jnp.any(way != 0), here, found), found

        ways = jnp.concatenate([jnp.zeros((1, x.size)), jnp.eye(x.size)])
        here, each = jax.lax.scan(once, jnp.zeros_like(x), ways)
        return here, (each[1:] - each[:1]).T / jnp.where(here > 0, -size, size)[None]

    least = TOLERANCE * length
    found = search(tried, jnp.where(free, before, known), give, least)
    return found.x, load_at(found.x), jnp.max(jnp.abs(found.miss)) <= least


@functools.lru_cache(maxsize=256)
def _program(structure: ProgramSpec, how: SolverOptions, kind: _Kind, shapes: tuple, lanes: int) -> Program:
    """The program for a structure and robots of some shape."""
    structure = dataclasses.replace(structure, skips=True)
    leaves, tree = shapes
    fixed = jtu.tree_unflatten(tree, [jax.ShapeDtypeStruct(*leaf) for leaf in leaves])
    drawn = fixed.give is not None
    tendons = (structure.tendons,) if structure.tendons else ()

    def first(given: _Given):
        start = begin(given.robot, structure)
        return (start, jnp.atleast_1d(given.robot.preload)) if drawn else start

    def step(given: _Given, carried, row: _Row):
        at = (row.settling, row.stringing)
        if not drawn:
            after, out = advance(given.robot, structure, how, carried, row.load, at)
            return after, _left(given, structure, kind, carried, out, row)
        settled, x = carried
        x, load, close = _driven(given, structure, how, settled, row, x)
        row = row._replace(load=load)
        after, out = advance(given.robot, structure, how, settled, load, at)
        out = dataclasses.replace(out, met=out.met & close)
        return (after, x), _left(given, structure, kind, settled, out, row)

    def row():
        one, flag, each = jnp.zeros(()), jnp.asarray(False), jnp.zeros(tendons)
        return _Row(Load(each, one, one, one, one), each if drawn else None, flag, flag, one)

    given = fixed.robot.sections
    drives = tuple(tendon.drive for tendon in fixed.tendons) if drawn else ()
    parts = (given.beyond is None, given.guides is None, given.closing is None)
    key = (structure, how, kind, leaves, parts, drives)
    # What is on disk was compiled from other files than those of a user's term.
    kept = None if OWN & {*structure.terms} else _kept()
    return Program(first, step, fixed, jax.eval_shape(row), key, kept=kept, lanes=lanes)


@functools.cache
def _kept() -> Kept:
    return Kept("native", origin(), _beside_those_of_jax)


def _beside_those_of_jax() -> Path | None:
    kept = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    return Path(kept) if kept else None


@functools.lru_cache(maxsize=256)
def _needed(structure: ProgramSpec, shapes: tuple) -> tuple[ProgramSpec, tuple, np.ndarray | None]:
    """The structure with the laws that it has equations of, as `Law.equation`; the shapes of robots without
    the numbers of other laws, and of users' terms that it lacks; and where what is left stands among the
    packed numbers, None for all. So a program is one for all robots that differ in what it does not have.
    """
    own = tuple(law.equation for law in structure.laws if law.name in structure.terms)
    others = ({law.name for law in structure.laws} | OWN) - {*structure.terms}
    structure = dataclasses.replace(structure, laws=own)
    if not others:
        return structure, shapes, None
    leaves, tree = shapes
    ends = list(itertools.accumulate((int(np.prod(shape, dtype=int)) for shape, _ in leaves), initial=0))

    def without(whole: list) -> tuple[list, Any]:
        given = jtu.tree_unflatten(tree, whole)
        terms = {name: values for name, values in given.robot.terms.items() if name not in others}
        return jtu.tree_flatten(given._replace(robot=given.robot._replace(terms=terms)))

    kept, small = without(list(range(len(leaves))))
    places = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in kept])
    return structure, (tuple(leaves[k] for k in kept), small), places


class Ready(NamedTuple):
    """Inputs of a native program: a robot, and a load history.

    Attributes:
        given: the robot, `packed`, (n,).
        preload: of its tendons [N], (*tendons,).
        large: a tension that counts as large in the history [N].
        place, turn: of the base in the world: position [m], (3,), and directors as columns, (3, 3).
        length: of the body [m].
    """

    given: Float[Array, " n"]
    preload: Float[Array, "*tendons"]
    large: Float[Array, ""]
    place: Float[Array, "3"]
    turn: Float[Array, "3 3"]
    length: Float[Array, ""]


def ready(
    robot: Robot, T_base: Float[Array, "K *tendons"], drawn: Float[Array, "K *tendons"] | None = None
) -> Ready:
    """A robot made ready for a history of base tensions [N], and of displacements [m] of the tendons that
    these drive; to be compiled.
    """
    given = _given(robot)
    if drawn is not None and given.give is not None:
        by_draw = jnp.asarray([tendon.drive == "displacement" for tendon in robot.tendons])
        asked = drawn / (given.give[None] if robot.tendon_names else given.give[0])
        T_base = jnp.where(by_draw if robot.tendon_names else by_draw[0], asked, T_base)
    preload = given.robot.preload
    large = large_tension(T_base, preload)
    length = given.robot.sections.mesh.s[-1]
    return Ready(packed(given), preload, large, robot.base.position, robot.base.rotation, length)


_ready = eqx.filter_jit(ready)
_trusted = jax.jit(trusted, static_argnums=0)


class Run(NamedTuple):
    """A load history to go through: as the arguments of `Native`."""

    ready: Ready
    loads: Load
    drawn: Float[np.ndarray, "K *tendons"] | None = None


class _Body(NamedTuple):
    """The part of a `Brief` that says where the body is."""

    tip_pose: Float[np.ndarray, "K 3"]
    along: Along | None = None
    shape: Place | None = None


class Native:
    """The native programs of a robot: one for each structure, for any numbers.

    Args:
        robot: the robot, or one that differs from it in its numbers only.
    """

    def __init__(self, robot: Robot):
        shapes = eqx.filter_eval_shape(_given, robot)
        leaves, tree = jtu.tree_flatten(shapes)
        self._shapes = (tuple((leaf.shape, leaf.dtype) for leaf in leaves), tree)
        self._nodes = shapes.robot.sections.rest.shape[0]
        self._kind = _Kind(robot.backbone.rigid, bool(robot.markers))
        self._space, self._tendons = robot.space, len(robot.tendons)

    def __call__(
        self,
        ready: Ready,
        structure: ProgramSpec,
        loads: Load,
        how: SolverOptions = SolverOptions(),  # noqa: B008
        drawn: Float[np.ndarray, "K *tendons"] | None = None,
    ) -> Brief:
        """Go through K load steps.

        Args:
            ready: of the robot and these loads.
            structure: which equations act.
            loads: K of them.
            how: when a search stops.
            drawn: how far the tendons that displacement drives are drawn out [m], (K, *tendons).

        Raises:
            InputError: a user's term computes what native code does not.
        """
        return self._gone_through([Run(ready, loads, drawn)], structure, how, 1)[0]

    def side_by_side(
        self,
        runs: Sequence[Run],
        structure: ProgramSpec,
        how: SolverOptions = SolverOptions(),  # noqa: B008
    ) -> list[Brief]:
        """Go through several load histories of equally many steps in the lanes of the processor's vectors.
        What each gives depends on nothing of the others, to the last bit.

        Args:
            runs: up to `LANES` of them.
            structure: which equations act in all.
            how: when a search stops.

        Raises:
            InputError: a user's term computes what native code does not.
        """
        return self._gone_through(runs, structure, how, LANES)

    def _gone_through(
        self, runs: Sequence[Run], structure: ProgramSpec, how: SolverOptions, lanes: int
    ) -> list[Brief]:
        structure, shapes, places = _needed(structure, self._shapes)
        program = _program(structure, how, self._kind, shapes, lanes)
        each = [self._inputs(run.ready, structure, run.loads, run.drawn, places) for run in runs]
        each += each[-1:] * (lanes - len(runs))
        # The lanes of each number lie side by side.
        given, rows = (np.stack(arrays, axis=-1) for arrays in zip(*each, strict=True))
        try:
            out = program(given, rows).reshape(len(rows), -1, lanes)
        except Untranslatable as fault:
            own = sorted(OWN & {*structure.terms})
            if not own:
                raise
            raise InputError(
                f"term '{' or '.join(own)}': computes '{fault}', which native code does not; write it with "
                "arithmetic, exp, log, sqrt, trigonometric functions and where"
            ) from None
        return [
            self._brief(np.ascontiguousarray(out[..., i]), run.ready, structure, len(run.loads.time))
            for i, run in enumerate(runs)
        ]

    def _inputs(
        self,
        ready: Ready,
        structure: ProgramSpec,
        loads: Load,
        drawn: Float[np.ndarray, "K *tendons"] | None,
        places: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The fixed values and the rows that a program takes; the first rows settle and string the robot."""
        K, n = len(loads.time), self._tendons
        columns = [np.asarray(loads.T_base, float).reshape(K, n)]
        columns += [np.asarray(c, float)[:, None] for c in (loads.dt, loads.time, loads.cycle, loads.turned)]
        columns += [] if drawn is None else [np.asarray(drawn, float).reshape(K, n)]
        # Of each step, as `_Row` has them: T_base, dt, time, cycle, cycles since the step before, what is
        # drawn, whether the robot settles, whether it is strung, and `large`.
        large = float(ready.large)
        before = loads_before(structure, np.asarray(ready.preload, float).reshape(n))
        none = np.zeros(0 if drawn is None else n)
        ahead = [np.concatenate([T, [FOREVER, 0, 0, 0], none, [*flags, large]]) for T, *flags in before]
        rows = np.pad(np.concatenate(columns, axis=1), ((0, 0), (0, 3)))
        rows[:, -1] = large
        rows = np.concatenate([np.asarray(ahead).reshape(-1, rows.shape[1]), rows])
        given = np.asarray(ready.given)
        return given if places is None else given[places], rows

    def _brief(self, out: Float[np.ndarray, "P n"], ready: Ready, structure: ProgramSpec, K: int) -> Brief:
        """What a program leaves of the last K of its steps."""
        n = self._tendons
        each, rest = np.split(out[len(out) - K :], [5 * n], axis=1)
        shape = (K, n) if structure.tendons else (K,)
        T_base, T_tip, displacement, direction, front = (e.reshape(shape) for e in np.split(each, 5, axis=1))
        met, error, marches, bent, moved = rest[:, :5].T
        good = met != 0
        if not good.all():
            slip = (direction, front)
            good = np.asarray(_trusted(structure, good, T_base, ready.preload, slip, ready.length))
        away, body = np.cumsum(moved), self._body(rest[:, 5:], ready)
        return Brief(
            T_base=T_base,
            T_tip=T_tip,
            displacement=displacement + (away[:, None] if structure.tendons else away),
            slip_direction=direction,
            slip_front=front,
            converged=good,
            residual_norm=error,
            iterations=marches.astype(int),
            bent=bent,
            tip_pose=body.tip_pose,
            along=body.along,
            shape=body.shape,
        )

    def _body(self, out: Float[np.ndarray, "K n"], ready: Ready) -> _Body:
        """Where the body is, from what a program leaves of it."""
        K = len(out)
        if not self._space:
            along = Along(*np.split(out[:, 3:], 2, axis=1)) if self._kind.whole else None
            return _Body(out[:, :3], along)
        nodes = self._nodes if self._kind.whole else 1
        each = out.shape[1] // nodes - 12  # components of the strain
        strain, turned, place = np.split(out, [each * nodes, (each + 9) * nodes], axis=1)
        strain = strain.reshape(K, nodes, each)
        turn = np.asarray(ready.turn)
        rotation = np.einsum("ij,knjl->knil", turn, turned.reshape(K, nodes, 3, 3))
        position = np.asarray(ready.place) + np.einsum("ij,knj->kni", turn, place.reshape(K, nodes, 3))
        angle = np.arctan2(rotation[:, -1, 1, 0], rotation[:, -1, 0, 0])
        stretch = strain[..., 3] if each > 3 else None
        shape = Place(strain[..., :3], rotation, position, stretch)
        return _Body(np.column_stack([position[:, -1, :2], angle]), None, shape)


def steps_natively(
    robot: Robot,
    structure: ProgramSpec,
    loads: Load,
    how: SolverOptions = SolverOptions(),  # noqa: B008
    drawn: Float[Array, "K *tendons"] | None = None,
) -> Brief:
    """As `Native`, for a robot whose numbers are known."""
    given = None if drawn is None else np.asarray(drawn)
    return Native(robot)(_ready(robot, loads.T_base, drawn), structure, loads, how, given)


def base_tensions(
    robot: Robot, structure: ProgramSpec, loads: Load, how: SolverOptions, drawn: Float[Array, "K *tendons"]
) -> Float[np.ndarray, "K *tendons"] | None:
    """Base tensions [N], (K, *tendons), that draw tendons out as far as wanted; None where a step does not
    meet its tolerance, or native code has no such equations. Arguments as of `steps_natively`.
    """
    try:
        found = steps_natively(robot, structure, loads, how, drawn)
    except Untranslatable:
        return None
    return found.T_base if found.converged.all() else None
