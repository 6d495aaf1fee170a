"""A sweep checked against its robot: varied parameters, points, load history and outputs."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from gtr_jax.config.checks import refused_for_section
from gtr_jax.config.config import RobotConfig, config_text, load_config
from gtr_jax.config.space_checks import refused_in_space
from gtr_jax.errors import InputError
from gtr_jax.recordings.formats.quantities import split_unit
from gtr_jax.recordings.formats.table import read_table
from gtr_jax.robot.build import build_robot, choose_intervals
from gtr_jax.robot.robot import Robot
from gtr_jax.terms import OWN, known_on, own_mark

from .axes import Axis, axes_of, check_values, find
from .config import SweepConfig, sweep_text
from .loadpath import LoadPath, given_history, load_path, unit_of_pull
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

# Work of a load step in equilibria without external loads, and lanes solved side by side:
# benchmarks/results/lanes.md has the measurements.
PLAIN, LOADED, DRAWN, SLIP = 1.0, 5.0, 300.0, 250.0
LANES = {PLAIN: 16, LOADED: 16, DRAWN: 1, SLIP: 1}
# On an accelerator: lanes times load steps, and bytes of its memory for each, by the measurements in
# benchmarks/results/accelerator.md: more lanes are faster until some million steps go on at once, and a step
# takes 2.6 kB of TD-CM I, some 10 kB of a helix in space. Memory of one that does not tell [bytes].
MOST_ACCELERATED, BYTES_EACH, MEMORY = 2**21, 2e4, 2**32


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
        """Which of PLAIN, LOADED, DRAWN and SLIP a load step is."""
        plainly = DRAWN if self.drawn else LOADED if self.robot.loaded else PLAIN
        return SLIP if self.by_slip else plainly

    @property
    def drawn(self) -> bool:
        """Whether displacement drives any tendon, so that base tensions are found and not given."""
        return any(self.history.drawn)

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
        if self.pull_varies or any(axis.name.partition(".")[0] == "preload" for axis in self.axes):
            return True
        cells = [term.id for term in self.config.catalogue.values() if term.base is not None]
        return any(term.id in cells for term in self.config.terms) or any(
            getattr(axis.parameter.term, "id", None) in cells for axis in self.axes
        )

    @property
    def pull_varies(self) -> bool:
        """Whether the pull or the release differs between points."""
        return any(axis.name in ("pull", "release") for axis in self.axes)

    @property
    def stored(self) -> tuple[Variable, ...]:
        """Arrays of the store with a value at every point, the result last."""
        base = tuple(v for _, v in self.given_bases) if self.base_varies else ()
        return (*self.outputs, *self.slopes, *base, RESULT)

    @property
    def given_bases(self) -> list[tuple[int, Variable]]:
        """The base tensions of the tendons that tension drives, each after the tendon's number."""
        each = enumerate(of_tendons(BASE, self.robot.tendon_names))
        return [(i, v) for i, v in each if not self.history.drawn[i]]

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
            **(
                {}
                if self.history.displacement is None
                else {"displacement": self.history.displacement.tolist()}
            ),
            **({"terms": own_mark()} if OWN else {}),
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
        known = jax.local_devices()[0].memory_stats() or {}
        most = min(known.get("bytes_limit", MEMORY) / BYTES_EACH, MOST_ACCELERATED)
        # The derivatives that a search for base tensions needs take more.
        return max(int(most / (8 if kind == DRAWN else 1)) // max(steps, 1), 8)
    return LANES[kind]


def task_of(file: SweepConfig) -> Task:
    """Check a sweep file against its robot, and plan it.

    Raises:
        InputError: naming file and key.
    """
    check_outputs(file)
    config, given = given_history(file, load_config(file.beside(file.robot, "robot")))
    robot = build_robot(config, resolution=file.resolution)
    table, unit = None, unit_of_pull(file, config)
    if file.points is None:
        axes = axes_of(file, robot, unit)
    else:
        axes, table = _table(file, robot, unit)
    robot = _ready(file, robot, axes)
    by_slip = _by_slip(config, axes)
    _check_terms(file, config, axes)
    history = load_path(file, config, axes, by_slip, table, given)
    _check_switch(file, config, by_slip, history)
    outputs = variables(file, robot, history.drawn)
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
    for term in config.catalogue.values():
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


def _check_terms(file: SweepConfig, config: RobotConfig, axes: Sequence[Axis]) -> None:
    """InputError if a physics term is varied that a rigid sheath, a section or a robot in space cannot
    have.
    """
    for axis in axes:
        term = axis.parameter.term
        fault = None if term is None else refused_for_section(config.backbone, term)
        if config.in_space and term is not None:
            fault = fault or refused_in_space(config, term)
        if fault:
            raise file.fault(f"vary.{axis.name}", fault)
        if config.backbone.rigid and term is not None:
            try:
                config.with_values({axis.parameter.key: axis.ends[1]})
            except InputError as fault:
                raise file.fault(f"vary.{axis.name}", str(fault).partition(": ")[2]) from None


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


def _table(file: SweepConfig, robot: Robot, unit: str) -> tuple[tuple[Axis, ...], np.ndarray]:
    """Parameters and points [SI], (points, axes), of a CSV file; `unit` is that of pull and release."""
    path = file.beside(str(file.points), "points")
    table = read_table(path)
    table.refuse_unless_numbers()
    axes: list[Axis] = []
    columns = []
    for i, header in enumerate(table.header):
        where, bare = f"{path}: column '{header}'", header.partition("[")[0].strip()
        parameter = find(robot, bare, where, unit)
        si = parameter.unit or "dimensionless"
        written = split_unit(header, si)[1] if "[" in header else None
        if "[" in header and written is None:
            raise InputError(f"{where}: cannot read its unit; write for example {bare}[{si}]")
        values = np.array(
            table.quantity(i, written, si, remedy=lambda bare=bare, si=si: f"write for example {bare}[{si}]")
        )
        if any(parameter == other.parameter for other in axes):
            raise InputError(f"{where}: {parameter.name} is given twice; remove one")
        axes.append(Axis(parameter, low=float(values.min()), high=float(values.max())))
        check_values(np.asarray(axes[-1].ends), axes[-1], where)
        columns.append(values)
    return tuple(axes), np.stack(columns, axis=1)


def inputs_of(file: SweepConfig) -> dict[str, Path]:
    """Files that a sweep file names, by role."""
    named = {"robot": file.robot, "points": file.points, "history.file": file.history.file}
    return {key.partition(".")[0]: file.beside(name, key) for key, name in named.items() if name is not None}


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
