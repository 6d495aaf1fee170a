"""A sweep checked against its robot: varied parameters, points, load history and outputs."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import itertools
import json
import math
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gtr_jax.errors import InputError, listed
from gtr_jax.files.config import RobotConfig, config_text, load_config
from gtr_jax.files.quantities import split_unit
from gtr_jax.files.recording import read_recording
from gtr_jax.files.table import read_table
from gtr_jax.robot.build import build_robot, choose_intervals
from gtr_jax.robot.in_plane import refuse_space
from gtr_jax.robot.parameters import term_of
from gtr_jax.robot.robot import Robot
from gtr_jax.terms import REGISTRY, known_on

from .axes import Axis, axes_of, check_values, find
from .config import SweepConfig, sweep_text
from .outputs import (
    BASE,
    GRADIENTS,
    NODE,
    RESULT,
    STEP,
    Variable,
    check_outputs,
    of_tendons,
    variables,
)
from .plan import Plan, block_size, plan_of

STEPS = 40  # load steps of each branch unless given
# Work of a load step in equilibria without external loads, and lanes solved side by side:
# benchmarks/results/lanes.md has the measurements.
PLAIN, LOADED, SLIP = 1.0, 5.0, 250.0
LANES = {PLAIN: 16, LOADED: 16, SLIP: 1}
ACCELERATED = 2**16  # lanes times steps on an accelerator; not measured


@dataclasses.dataclass(frozen=True)
class LoadPath:
    """The load history of every point, as shares of its branches or as tensions.

    Attributes:
        pull, release: [N]; None where varied, or for release where there is none.
        up, down: shares of the two branches done at each step.
        given: base tension instead of both [N], (K, *tendons).
        time: of the steps [s], (K,); None where nothing depends on it.
        kept: the steps that are stored.
        tendon: index of the tendon pulled; None for one tendon.
    """

    pull: float | None
    release: float | None
    up: np.ndarray
    down: np.ndarray
    given: np.ndarray | None
    time: np.ndarray | None
    kept: tuple[int, ...]
    tendon: int | None = None

    @property
    def steps(self) -> int:
        """Load steps."""
        return len(self.given) if self.given is not None else len(self.up) + len(self.down)

    @property
    def shown(self) -> int:
        """Which of the steps kept has the largest base tension: used for figures and sensitivity indices."""
        if self.given is not None:
            pulled = self.given if self.given.ndim == 1 else self.given.sum(axis=1)
        else:
            pulled = np.concatenate([self.up, 1 - self.down])
        return int(np.argmax(pulled[list(self.kept)]))


@dataclasses.dataclass(frozen=True)
class Task:
    """Everything that decides the contents of the store.

    Attributes:
        file: the sweep file.
        config: the robot file.
        robot: built from it, on the mesh of the sweep.
        plan: points and blocks.
        history: of every point.
        outputs: arrays of the store but for coordinates and results.
        gradients: of these arrays by what is varied.
        by_slip: whether physics terms act that are not of the cells.
        table: points from a file [SI], (points, axes).
    """

    file: SweepConfig
    config: RobotConfig
    robot: Robot
    plan: Plan
    history: LoadPath
    outputs: tuple[Variable, ...]
    gradients: tuple[Variable, ...]
    by_slip: bool
    table: np.ndarray | None

    @property
    def axes(self) -> tuple[Axis, ...]:
        """What is varied."""
        return self.plan.axes

    @property
    def nodes(self) -> int:
        """Nodes of the mesh."""
        return sum(self.robot.intervals) + len(self.robot.intervals)

    @property
    def single(self) -> bool:
        """Whether every point is one equilibrium and not a history."""
        return self.history.steps == 1 and self.history.given is None

    @property
    def kind(self) -> float:
        """Which of PLAIN, LOADED and SLIP a load step is."""
        return SLIP if self.by_slip else LOADED if self.robot.loaded else PLAIN

    @property
    def lanes(self) -> int:
        """Points solved side by side: as many as help, spread evenly over the largest block."""
        return -(-self.plan.largest // self._rounds)

    @property
    def _rounds(self) -> int:
        return -(-self.plan.largest // lanes_of(self.kind, self.history.steps))

    @property
    def batch(self) -> int:
        """Points that the compiled program takes: the largest block, filled up to whole lanes."""
        return self._rounds * self.lanes

    @property
    def base_varies(self) -> bool:
        """Whether the base tension differs between points, or its cell shows something else."""
        if any(axis.name.partition(".")[0] in ("pull", "release", "preload") for axis in self.axes):
            return True
        cells = [term.id for term in REGISTRY.values() if term.base is not None]
        return any(term.kind in cells for term in self.config.terms) or any(
            getattr(term_of(axis.parameter), "id", None) in cells for axis in self.axes
        )

    @property
    def stored(self) -> tuple[Variable, ...]:
        """Arrays of the store with a value at every point, the result last."""
        base = of_tendons(BASE, self.robot.tendon_names) if self.base_varies else ()
        return (*self.outputs, *self.slopes, *base, RESULT)

    @property
    def slopes(self) -> tuple[Variable, ...]:
        """The derivatives that are stored."""
        return tuple(slope(v, axis) for v in self.gradients for axis in self.axes)

    def extra_shape(self, variable: Variable) -> tuple[int, ...]:
        """Shape of an array at one point; no axis for a single step."""
        return tuple(self._extra(variable).values())

    def extra_dims(self, variable: Variable) -> tuple[str, ...]:
        """Names of these axes."""
        return tuple(self._extra(variable))

    def _extra(self, variable: Variable) -> dict[str, int]:
        lengths = {STEP: len(self.history.kept), NODE: self.nodes}
        return {dim: lengths[dim] for dim in variable.dims if dim != STEP or lengths[dim] > 1}

    @property
    def bytes_each(self) -> int:
        """Bytes that a point leaves, before compression."""
        return sum(_size(v) * math.prod(self.extra_shape(v)) for v in self.stored)

    @functools.cached_property
    def fingerprint(self) -> str:
        """Hash of all that decides the contents of the store."""
        import jax

        decides = {
            "sweep": sweep_text(self.file.model_copy(update={"name": ""})),
            "robot": config_text(self.config),
            "table": None if self.table is None else hashlib.sha256(self.table.tobytes()).hexdigest(),
            "given": None if self.history.given is None else self.history.given.tolist(),
            "time": None if self.history.time is None else self.history.time.tolist(),
            "chunk": self.plan.chunk,
            "batch": (self.lanes, self.batch),
            "versions": {name: version(name) for name in ("gtr-jax", "jax", "jaxlib", "scipy", "SALib")},
            "device": jax.default_backend(),
        }
        return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()


def slope(variable: Variable, axis: Axis) -> Variable:
    """The derivative of an array by a parameter."""
    unit = axis.parameter.unit
    per = (
        f"{variable.unit or '1'}/({unit})" if " " in unit or "/" in unit else f"{variable.unit or '1'}/{unit}"
    )
    return dataclasses.replace(
        variable,
        name=f"d{variable.name}_d{axis.name}",
        unit=per if unit else variable.unit,
        says=f"derivative of {variable.name} by {axis.name}",
    )


def _size(variable: Variable) -> int:
    return 1 if variable is RESULT else 8


def lanes_of(kind: float, steps: int) -> int:
    """Points solved side by side: as many as stay in the caches; one where slip is solved for, since lanes
    would wait for the slowest at every step; many on an accelerator.
    """
    import jax

    if jax.default_backend() != "cpu":
        return max(ACCELERATED // max(steps, 1), 8)
    return LANES[kind]


def task_of(file: SweepConfig) -> Task:
    """Check a sweep file against its robot, and plan it.

    Raises:
        InputError: naming file and key.
    """
    check_outputs(file)
    config = load_config(file.folder / file.robot)
    robot = build_robot(config, resolution=file.resolution)
    refuse_space(robot, "a sweep", source=config.source)
    table = None
    if file.points is None:
        axes = axes_of(file, robot)
    else:
        axes, table = _table(file, robot)
    robot = _ready(file, robot, axes)
    by_slip = _by_slip(config, axes)
    _check_rigid(file, config, axes)
    history = _history(file, config, axes, by_slip, table)
    _check_switch(file, config, by_slip, history)
    names = robot.tendon_names
    outputs = variables(file.outputs, names)
    slopes = tuple(v for v in outputs if v.smooth) if GRADIENTS in file.outputs else ()
    rows = None if table is None else len(table)
    whole = plan_of(file, axes, rows, 1)
    task = Task(file, config, robot, whole, history, outputs, slopes, by_slip, table)
    weight = task.kind * max(history.steps, 1) * (1 + len(axes) * bool(slopes))
    block = block_size(whole.points, weight, task.bytes_each, lanes_of(task.kind, history.steps))
    return dataclasses.replace(task, plan=plan_of(file, axes, rows, block))


def _ready(file: SweepConfig, robot: Robot, axes: Sequence[Axis]) -> Robot:
    """The robot on a mesh that suits all that is varied, loaded where any point is."""
    own = [axis for axis in axes if not axis.of_history]
    intervals = np.asarray(robot.intervals)
    for axis in own:
        part = axis.parameter.at.split(".")
        ends = [f"{field}.{i}" for field, i in robot.bore_kinks]
        if part[-2:-1] in (["bore_start"], ["bore_end"]) and ".".join(part[1:]) not in ends:
            raise file.fault(
                f"vary.{axis.name}",
                "this end of the bore is an end of the body in the robot file; put it inside there",
            )
        robot = robot.with_values(**{axis.name: robot.value(axis.name)})  # external forces make it loaded
        for value in axis.ends:
            changed = robot.with_values(**{axis.name: value})
            intervals = np.maximum(intervals, choose_intervals(changed, file.resolution))
    return dataclasses.replace(robot, intervals=tuple(int(n) for n in intervals))


def _by_slip(config: RobotConfig, axes: Sequence[Axis]) -> bool:
    """Whether at any point a physics term acts that is not of the load cells."""
    for term in REGISTRY.values():
        given = config.term_values[term.id]
        ends = [
            given | {q.name: value}
            for q in term.sizes
            for axis in axes
            if axis.name == f"{term.id}.{q.name}"
            for value in axis.ends
        ]
        if not term.of_cells and any(known_on(term, values) for values in (given, *ends)):
            return True
    return False


def _check_rigid(file: SweepConfig, config: RobotConfig, axes: Sequence[Axis]) -> None:
    """InputError if a physics term is varied that a rigid sheath cannot have."""
    for axis in axes if config.backbone.rigid else ():
        if term_of(axis.parameter) is not None:
            try:
                config.with_values({axis.parameter.key: axis.ends[1]})
            except InputError as fault:
                raise file.fault(f"vary.{axis.name}", str(fault).partition(": ")[2]) from None


def _history(
    file: SweepConfig,
    config: RobotConfig,
    axes: Sequence[Axis],
    by_slip: bool,
    table: np.ndarray | None,
) -> LoadPath:
    said = file.history
    varied = {axis.name: axis for axis in axes if axis.of_history}
    for name in varied:
        if getattr(said, name) is not None:
            raise file.fault(f"history.{name}", "is varied as well; leave it out of one, [vary] or [history]")
        if said.file is not None:
            raise file.fault(f"vary.history.{name}", "has no effect beside history.file; leave one out")
    if said.file is not None:
        return _given(file, config)
    if said.pull is None and "pull" not in varied:
        raise file.fault("history.pull", 'missing; add for example pull = "45 N" under [history]')
    releases = said.release is not None or "release" in varied
    lasting = "dissipation" in file.outputs or said.keep == "all" or by_slip
    steps = said.steps or (STEPS if releases or lasting else 1)
    if "dissipation" in file.outputs and steps < 10:
        raise file.fault("history.steps", f"{steps} are too few for dissipation; {STEPS} for example")
    tendon = _tendon(file, config)
    _check_branches(file, config, axes, table, tendon, releases)
    up = np.linspace(0, 1, steps + 1) if steps > 1 else np.ones(1)
    down = np.linspace(0, 1, steps + 1)[1:] if releases else np.zeros(0)
    total = len(up) + len(down)
    ends = (len(up) - 1, total - 1) if releases else (total - 1,)
    kept = {"all": tuple(range(total)), "last": ends[-1:], "turns": ends}[said.keep]
    timed = _timed(config, axes)
    if timed and said.dt is None and "dt" not in varied and total > 1:
        raise file.fault("history.dt", f'missing; {timed} depends on time; add for example dt = "0.1 s"')
    if total == 1 and (said.dt is not None or "dt" in varied):
        raise file.fault("history.dt", "has no effect on a single step, which comes to rest; add steps = 40")
    time = None if said.dt is None else said.dt * np.arange(total)
    if "dt" in varied:
        time = np.arange(total, dtype=float)
    return LoadPath(said.pull, said.release, up, down, None, time, kept, tendon)


def _check_branches(
    file: SweepConfig,
    config: RobotConfig,
    axes: Sequence[Axis],
    table: np.ndarray | None,
    tendon: int | None,
    releases: bool,
) -> None:
    """InputError unless the preload is below the pull, and the release between nothing and the pull."""
    name, strung, _ = config.strung[tendon or 0]
    usual = {"preload": strung.preload, "pull": file.history.pull, "release": file.history.release}
    names = {"preload": f"preload.{name}" if name else "preload", "pull": "pull", "release": "release"}
    number = {axis.name: i for i, axis in enumerate(axes)}

    def among(what: str) -> np.ndarray:
        """Its values at the points of a table, or its ends."""
        i = number.get(names[what])
        if i is None:
            return np.array([float(usual[what] or 0.0)])
        return np.asarray(axes[i].ends) if table is None else table[:, i]

    def above(high: np.ndarray, low: np.ndarray) -> bool:
        return bool(np.all(high >= low) if table is not None else high.min() >= low.max())

    preload, pull, release = (among(what) for what in ("preload", "pull", "release"))
    if not above(pull, preload):
        raise file.fault(
            "history.pull", f"must be above the preload of {preload.max():g} N, is {pull.min():g} N"
        )
    if releases and not above(pull, release):
        raise file.fault(
            "history.release", f"must lie between 0 N and the pull of {pull.min():g} N; change one of the two"
        )


def _tendon(file: SweepConfig, config: RobotConfig) -> int | None:
    names, wanted = config.tendon_names, file.history.tendon
    if not names and wanted is not None:
        raise file.fault("history.tendon", "the robot has one tendon; leave it out")
    if names and wanted not in names:
        raise file.fault(
            "history.tendon", f"which of {listed(names)} to pull? name one, or give all in a file"
        )
    return None if not names else names.index(str(wanted))


def _given(file: SweepConfig, config: RobotConfig) -> LoadPath:
    """A history from a CSV file."""
    path = file.folder / str(file.history.file)
    read = read_recording(path, need_tip=False, tendons=config.tendon_names, keep_glitches=True)
    if read.masked:
        raise InputError(f"{path}: {read.masked[0].says}; complete the history or delete the row")
    T = np.asarray(read.T_base, dtype=float)
    moves = np.sign(np.diff(T if T.ndim == 1 else T.sum(axis=1)))
    moving = np.flatnonzero(moves)
    turns = [int(a) + 1 for a, b in itertools.pairwise(moving) if moves[a] != moves[b]]
    ends = tuple(sorted({*turns, len(T) - 1}))
    kept = {"all": tuple(range(len(T))), "last": (len(T) - 1,), "turns": ends}[file.history.keep]
    timed = _timed(config, ())
    if timed and read.time is None:
        raise InputError(f"{path}: {timed} depends on time; give the file a column time_s")
    return LoadPath(None, None, np.zeros(0), np.zeros(0), T, read.time, kept, None)


def _timed(config: RobotConfig, axes: Sequence[Axis]) -> str | None:
    """A physics term that depends on time, if any acts."""
    for term in REGISTRY.values():
        acts = any(config.term_values[term.id][q.name] != q.null for q in term.sizes)
        varied = any(axis.name.startswith(f"{term.id}.") for axis in axes)
        if term.timed and (acts or varied):
            return term.id
    return None


def _check_switch(file: SweepConfig, config: RobotConfig, by_slip: bool, history: LoadPath) -> None:
    if "T_base_switch" not in file.outputs:
        return
    if by_slip or config.tendon_names:
        raise file.fault(
            "outputs",
            "T_base_switch is for one tendon without physics terms; sweep the history with keep = 'all'",
        )
    if history.given is not None:
        raise file.fault("outputs", "T_base_switch needs the pull it follows; give history.pull, not a file")


def _table(file: SweepConfig, robot: Robot) -> tuple[tuple[Axis, ...], np.ndarray]:
    """Parameters and points [SI], (points, axes), of a CSV file."""
    path = file.folder / str(file.points)
    table = read_table(path)
    axes: list[Axis] = []
    columns = []
    for i, header in enumerate(table.header):
        where, bare = f"{path}: column '{header}'", header.partition("[")[0].strip()
        parameter = find(robot, bare, where)
        si = parameter.unit or "dimensionless"
        unit = split_unit(header, si)[1] if "[" in header else None
        if "[" in header and unit is None:
            raise InputError(f"{where}: cannot read its unit; write for example {bare}[{si}]")
        values = np.array(
            table.quantity(i, unit, si, remedy=lambda bare=bare, si=si: f"write for example {bare}[{si}]")
        )
        if any(parameter == other.parameter for other in axes):
            raise InputError(f"{where}: {parameter.name} stands twice; keep one")
        axes.append(Axis(parameter, low=float(values.min()), high=float(values.max())))
        check_values(np.asarray(axes[-1].ends), axes[-1], where)
        columns.append(values)
    return tuple(axes), np.stack(columns, axis=1)


def inputs_of(file: SweepConfig) -> dict[str, Path]:
    """Files that a sweep file names, by role."""
    named = {"robot": file.robot, "points": file.points, "history": file.history.file}
    return {role: file.folder / name for role, name in named.items() if name is not None}


def named_beside(file: SweepConfig) -> SweepConfig:
    """The sweep file as it stands in a run folder, beside copies of the files that it names."""
    history = file.history
    if history.file is not None:
        history = history.model_copy(update={"file": "history.csv"})
    points = None if file.points is None else "points.csv"
    return file.model_copy(update={"robot": "robot.toml", "points": points, "history": history})


def settings_of(task: Task) -> dict[str, Any]:
    """Attributes of the store: how it was made."""
    return {
        "title": task.file.name,
        "sweep": sweep_text(task.file),
        "robot": config_text(task.config),
        "fingerprint": task.fingerprint,
        "gtr_jax": version("gtr-jax"),
        "jax": version("jax"),
    }
