"""Counts, ranges and sensitivities of a finished sweep."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from .lanes import CONVERGED, NO_ROBOT, NOT_CONVERGED, NOT_FINITE
from .outputs import NODE, RESULT, STEP
from .run import Done
from .sensitivity import Sensitivity, sensitivity_of
from .store import Store
from .task import Task


@dataclasses.dataclass(frozen=True)
class Summary:
    """Counts, ranges and sensitivities of a sweep.

    Attributes:
        points: of the sweep.
        counts: points by result code.
        ranges: least, mean and largest value [SI] of every array without nodes, over the points that
            converged; of several steps kept, at the one that figures and sensitivities show.
        sensitivity: how much each parameter matters to each of them, or why that is not known.
        done: what the last run computed.
    """

    points: int
    counts: dict[int, int]
    ranges: dict[str, tuple[float, float, float]]
    sensitivity: Sensitivity
    done: Done

    @property
    def converged(self) -> bool:
        """Whether every point that is a robot was solved."""
        return not self.counts[NOT_CONVERGED] and not self.counts[NOT_FINITE] and self.counts[CONVERGED] > 0

    @property
    def says(self) -> str:
        """The verdict in a sentence."""
        failed = self.counts[NOT_CONVERGED] + self.counts[NOT_FINITE]
        parts = [f"{self.counts[CONVERGED]:,} of {self.points:,} points converged"]
        if failed:
            parts.append(f"{failed:,} did not and hold no numbers")
        if self.counts[NO_ROBOT]:
            parts.append(
                f"{self.counts[NO_ROBOT]:,} are no robot (a channel or a bore does not fit the body)"
            )
        text = "; ".join(parts)
        if self.done.points:
            took = f"{self.done.seconds:.1f} s, {self.done.rate:,.0f} per second"
            text += f". {self.done.points:,} computed in {took}"
        return text + "."

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "says": self.says,
            "points": self.points,
            "converged": self.counts[CONVERGED],
            "not_converged": self.counts[NOT_CONVERGED],
            "not_finite": self.counts[NOT_FINITE],
            "no_such_robot": self.counts[NO_ROBOT],
            "ranges": {
                k: dict(zip(("least", "mean", "largest"), v, strict=True)) for k, v in self.ranges.items()
            },
            "sensitivity": self.sensitivity.to_json(),
            "computed": {
                "points": self.done.points,
                "seconds": self.done.seconds,
                "compiling_seconds": self.done.compiling,
            },
        }


def summary_of(task: Task, store: Store, done: Done) -> Summary:
    """Read a finished store through, a block at a time."""
    counts: dict[int, int] = dict.fromkeys((CONVERGED, NOT_CONVERGED, NOT_FINITE, NO_ROBOT), 0)
    scalars = [v for v in task.stored if v is not RESULT and NODE not in v.dims]
    least = {v.name: np.inf for v in scalars}
    most, total = {v.name: -np.inf for v in scalars}, {v.name: 0.0 for v in scalars}
    number = {v.name: 0 for v in scalars}
    for block in range(task.plan.blocks):
        for code, count in zip(*np.unique(store.read(RESULT.name, block), return_counts=True), strict=True):
            counts[int(code)] += int(count)
        for v in scalars:
            values, dims = store.read(v.name, block), task.extra_dims(v)
            if STEP in dims:
                values = np.take(values, task.history.shown, axis=dims.index(STEP) - len(dims))
            values = values[np.isfinite(values)]
            if values.size:
                least[v.name] = min(least[v.name], float(values.min()))
                most[v.name] = max(most[v.name], float(values.max()))
                total[v.name] += float(values.sum())
                number[v.name] += values.size
    ranges = {name: (least[name], total[name] / number[name], most[name]) for name in number if number[name]}
    return Summary(task.plan.points, counts, ranges, sensitivity_of(task, store), done)
