"""A sweep in words, tables and pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gtr_jax.numbers import number, quantity
from gtr_jax.plots.sweep import plot_curves, plot_maps, plot_parallel, plot_sensitivity
from gtr_jax.sweep.axes import Axis
from gtr_jax.sweep.sensitivity import Index
from gtr_jax.sweep.summary import Summary
from gtr_jax.sweep.task import Task

from .page import Figure, Report, Table

if TYPE_CHECKING:
    import xarray

SHOWN = 6  # outputs in pictures


def sweep_report(answer: Summary, task: Task, data: xarray.Dataset, *, plot: bool = True) -> Report:
    """Verdict, figures and tables of a sweep.

    Args:
        answer: what it found.
        task: the sweep.
        data: its dataset.
        plot: whether to draw.
    """
    warnings = []
    if not answer.converged and answer.ranges:
        warnings.append("Some points did not converge: result is not 0 there, and their numbers are missing.")
    if answer.sensitivity.idle:
        warnings.append(f"Nothing computed depends on {', '.join(answer.sensitivity.idle)}.")
    return Report(
        title=f"{task.file.name}: sweep of {task.config.name}",
        verdict=answer.says,
        warnings=warnings,
        figures=_figures(answer, task, data) if plot and answer.ranges else [],
        tables=_tables(answer, task),
    )


def _figures(answer: Summary, task: Task, data: xarray.Dataset) -> list[Figure]:
    outputs = [v.name for v in task.outputs if v.name in answer.ranges][:SHOWN]
    arrays = {name: _pulled(data[name], task) for name in outputs}
    figures = []
    if arrays and task.plan.gridded:
        figures.append(_of_grid(task, arrays))
    elif arrays:
        some = slice(None, None, -(-task.plan.points // 20_000))
        points = {axis.name: data[axis.name][some] for axis in task.axes}
        figures += [
            Figure(
                f"parallel-{name}",
                plot_parallel(points, array[some]),
                f"Each line is a point of the sample, coloured by {name}, the last column.",
            )
            for name, array in list(arrays.items())[:3]
        ]
    indices = {k: v for k, v in answer.sensitivity.indices.items() if k in outputs}
    if indices:
        figures.append(Figure("sensitivity", plot_sensitivity(indices), answer.sensitivity.says))
    return figures


def _pulled(array: xarray.DataArray, task: Task) -> xarray.DataArray:
    return array.isel(step=task.history.shown) if "step" in array.dims else array


def _of_grid(task: Task, arrays: dict[str, xarray.DataArray]) -> Figure:
    last = _where(task)
    if sum(n > 1 for n in task.plan.shape) < 2:
        return Figure("curves", plot_curves(arrays), f"What was computed{last}.")
    others = " Other parameters are at their middle values." if len(task.plan.shape) > 2 else ""
    return Figure("maps", plot_maps(arrays), f"What was computed{last}.{others} Tinted: no number there.")


def _where(task: Task) -> str:
    """At which of several steps kept the numbers are."""
    pulled = "displacement" if task.drawn else "base tension"
    return f" at the largest {pulled} kept" if len(task.history.kept) > 1 else ""


def _tables(answer: Summary, task: Task) -> list[Table]:
    varied = [(axis.name, axis.parameter.key, *_range(axis)) for axis in task.axes]
    by_name = {v.name: v for v in task.stored}
    found = [
        (name, *(quantity(value, by_name[name].unit) for value in ends), by_name[name].says)
        for name, ends in answer.ranges.items()
    ]
    tables = [
        Table("Varied", ("name", "key", "from", "to", "values"), varied),
        Table(f"Found{_where(task)}", ("output", "least", "mean", "largest", "what"), found),
    ]
    for output, indices in answer.sensitivity.indices.items():
        rows = [(name, *(number(v, digits=3) for v in _columns(index))) for name, index in indices.items()]
        some = next(iter(indices.values()))
        heads = (
            ("mean change", "spread [SI]") if some.effect is not None else ("alone", "± sd", "in all", "± sd")
        )
        tables.append(Table(f"What {output} depends on", ("parameter", *heads), rows))
    if not answer.sensitivity.indices:
        tables.append(Table("Sensitivity", ("",), [(answer.sensitivity.says,)]))
    return tables


def _columns(index: Index) -> tuple[float | None, ...]:
    if index.effect is not None:
        return index.effect, index.spread
    return index.first, index.first_sd, index.total, index.total_sd


def _range(axis: Axis) -> tuple[str, str, str]:
    low, high = (quantity(value, axis.parameter.unit) for value in axis.ends)
    if axis.values is None:
        words = {"normal": "normal", "log": "drawn on a log scale"}.get(axis.scale, "drawn")
        if axis.scale == "normal":
            low, high = (
                quantity(axis.low, axis.parameter.unit),
                "± " + quantity(axis.high, axis.parameter.unit),
            )
        return low, high, words
    return low, high, str(len(np.asarray(axis.values)))
