"""The compiled program of a sweep: many points side by side, in batches of a fixed shape."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from gtr_jax.robot.robot import Robot
from gtr_jax.robot.validity import is_robot

from ..mechanics import SolverOptions
from ..simulation.displacement import drawn_at_once
from ..simulation.equilibrium import equilibrium
from ..simulation.history import simulate
from .loadpath import drive_of, end_of
from .switch import switch_tension
from .task import LOADED, Task
from .values import along, at_rest

CONVERGED, NOT_CONVERGED, NOT_FINITE, NO_ROBOT = 0, 1, 2, 3  # result codes in the store
# The whole load at once, or not at all: lanes that need it in shares would hold up the others of their batch.
BRIEF = SolverOptions(smallest_stride=0.4)


class Lanes:
    """Solves points of a sweep, a block at a time.

    Args:
        task: the sweep.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        self._usual = _usual(task)
        self._brief = task.kind == LOADED
        self._lock = threading.Lock()
        self._first = self._program(BRIEF if self._brief else SolverOptions(), task.batch)

    def _program(self, solver: SolverOptions, batch: int) -> Callable:
        """The compiled program for `batch` points."""
        task, (numbers, structure) = self.task, eqx.partition(self.task.robot, eqx.is_array)

        def all_lanes(numbers, points):
            robot = eqx.combine(numbers, structure)
            return jax.lax.map(
                functools.partial(_lane, task, robot, solver, self._usual),
                points,
                batch_size=None if task.drawn else min(task.lanes, batch),
            )

        shaped = jax.ShapeDtypeStruct((batch, len(task.axes)), jnp.float64)
        return functools.partial(jax.jit(all_lanes).lower(numbers, shaped).compile(), numbers)

    @functools.cached_property
    def _thorough(self) -> Callable:
        return self._program(SolverOptions(), self.task.lanes)

    def solve(self, points: np.ndarray) -> dict[str, np.ndarray]:
        """Arrays of the store at some points, by name.

        Args:
            points: values of what is varied [SI], (n, axes), n at most the task's batch.

        Returns:
            (n, ...) each; NaN where `result` is not 0.
        """
        found = self._padded(self._first, points, self.task.batch)
        left = np.flatnonzero(found["result"] == NOT_CONVERGED) if self._brief else ()
        for start in range(0, len(left), self.task.lanes):
            some = left[start : start + self.task.lanes]
            with self._lock:  # compiled once, by whichever thread comes first
                thorough = self._thorough
            again = self._padded(thorough, points[some], self.task.lanes)
            for name, values in again.items():
                found[name][some] = values
        self._refuse(points, found)
        return found

    def _refuse(self, points: np.ndarray, found: dict[str, np.ndarray]) -> None:
        """Mark points at which the numbers of a physics term contradict one another."""
        task = self.task
        for term in task.config.catalogue.values():
            own = {axis.name: i for i, axis in enumerate(task.axes) if axis.name.startswith(f"{term.id}.")}
            if term.fault is None or not own:
                continue
            given, length = task.config.term_values[term.id], task.config.backbone.length
            along = next((i for i, axis in enumerate(task.axes) if axis.name == "length"), None)
            names = task.config.tendon_names
            each = names if any(np.ndim(value) for value in given.values()) else ("",)
            for row, point in enumerate(points):
                long = length if along is None else float(point[along])
                if any(term.fault(_of_tendon(given, own, point, names, whose), long) for whose in each):
                    found["result"][row] = NO_ROBOT
                    for name in found.keys() - {"result"}:
                        found[name][row] = np.nan

    def _padded(self, program: Callable, points: np.ndarray, batch: int) -> dict[str, np.ndarray]:
        missing = batch - len(points)
        whole = np.concatenate([points, np.broadcast_to(points[-1:], (missing, points.shape[1]))])
        return {name: np.array(values)[: len(points)] for name, values in program(whole).items()}


def _lane(
    task: Task, robot: Robot, solver, usual: np.ndarray, point: Float[Array, " axes"]
) -> dict[str, Array]:
    """The outputs of one point of the sweep, by name; `usual` is a point at which the robot is valid."""
    within = jnp.stack([axis.allows(point[i]) for i, axis in enumerate(task.axes)])
    there = is_robot(_robot_at(task, robot, point)) & jnp.all(within)
    point = jnp.where(there, point, jnp.asarray(usual))
    stored = {v.name for v in task.stored}

    def outputs(point):
        said, met, pulled = _solved(task, robot, point, solver)
        said = {name: _squeezed(task, name, values) for name, values in said.items() if name in stored}
        return {v.name: said[v.name] for v in task.gradients}, (said, met, pulled)

    if task.gradients:
        slopes, (said, met, pulled) = jax.jacfwd(outputs, has_aux=True)(point)
        said |= {
            f"d{v.name}_d{axis.name}": slopes[v.name][..., i]
            for v in task.gradients
            for i, axis in enumerate(task.axes)
        }
    else:
        _, (said, met, pulled) = outputs(point)
    if "T_base_switch" in stored:
        said["T_base_switch"], found = switch_tension(_robot_at(task, robot, point), pulled, solver)
        met = met & found
    finite = jnp.all(jnp.stack([jnp.all(jnp.isfinite(values)) for values in said.values()]))
    result = jnp.where(finite, CONVERGED, NOT_FINITE)
    result = jnp.where(there, jnp.where(met, result, NOT_CONVERGED), NO_ROBOT).astype(jnp.uint8)
    answered = result == CONVERGED
    return {name: jnp.where(answered, said[name], jnp.nan) for name in sorted(said)} | {"result": result}


def _usual(task: Task) -> np.ndarray:
    """Values [SI] at which the robot is valid: those of its file, and the least ones of the load history."""
    return np.array(
        [axis.ends[0] if axis.of_history else float(task.robot.value(axis.name)) for axis in task.axes]
    )


def _robot_at(task: Task, robot: Robot, point: Float[Array, " axes"]) -> Robot:
    own = {axis.name: point[i] for i, axis in enumerate(task.axes) if not axis.of_history}
    return robot.with_values(**own)


def _solved(task: Task, robot: Robot, point: Float[Array, " axes"], solver):
    """The outputs of one point by name, whether all its states were solved, and the true base tension at the
    end of the pull.
    """
    robot, path = _robot_at(task, robot, point), task.history
    varied = {axis.name: point[i] for i, axis in enumerate(task.axes) if axis.of_history}
    T_base, out = drive_of(path, robot, varied)
    wanted = {v.name for v in task.outputs}
    if task.single:
        pulled, met = T_base[0], jnp.asarray(True)
        if out is not None:
            pulled, met = drawn_at_once(robot, pulled, out[0], solver, sloped=bool(task.gradients))
        eq = equilibrium(robot, pulled, solver=solver)
        return at_rest(robot, eq, pulled, wanted), met & eq.converged, pulled
    time = None if path.time is None else jnp.asarray(path.time) * varied.get("dt", 1.0)
    run = simulate(robot, T_base, time=time, displacement=out, solver=solver)
    given = out is not None or path.given is not None
    pulled = run.T_base[len(path.up) - 1] if given else end_of(path, varied, "pull")
    return along(robot, run, path.kept, wanted), jnp.all(run.converged), pulled


def _squeezed(task: Task, name: str, values: Array) -> Array:
    """An array without the axis of steps where only one is kept."""
    per_step = next((v for v in task.stored if v.name == name), None)
    if per_step is None or "step" not in per_step.dims or len(task.history.kept) > 1:
        return values
    return values[0]


def _of_tendon(
    given: Mapping[str, Any],
    varied: Mapping[str, int],
    point: np.ndarray,
    names: Sequence[str],
    whose: str,
) -> dict[str, float]:
    """The numbers of a term at a point, of one tendon where each has its own.

    Args:
        given: as the file has them.
        varied: columns of the point by names of the numbers that vary.
        point: values of the axes.
        names: of all tendons.
        whose: the tendon; "" where the term is of all.
    """
    values = {name: float(value[names.index(whose)] if whose else value) for name, value in given.items()}
    for name, column in varied.items():
        _, number, *tendon = name.split(".")
        if "".join(tendon) == whose:
            values[number] = float(point[column])
    return values
