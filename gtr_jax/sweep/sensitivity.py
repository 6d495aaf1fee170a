"""How much each parameter matters: shares of the variance of an output over the sweep, or its mean change."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any

import numpy as np

from .axes import Axis
from .outputs import NODE, STEP
from .plan import LEVELS, sensitivity_problem, sensitivity_sample
from .store import Store
from .task import Task

MOST = 2_000_000  # points whose indices are computed: all are held at once
MOST_GIVEN = 20_000  # points given to RBD-FAST: with more, its bootstrap takes longer than the sweep
FEWEST = 64  # least points of a sample from which shares of the variance can be estimated
TWO_SIDED = 1.959964  # standard deviations in SALib's half widths, of 95 %
_METHODS = {
    "grid": "Shares of the variance over the grid, exact for its points.",
    "saltelli": "Sobol's indices, by Saltelli's sample (SALib).",
    "morris": "Elementary effects over the whole range, by Morris's sample (SALib).",
    "drawn": "First-order shares of the variance, by RBD-FAST from at most 20,000 of the points (SALib); "
    "it takes the parameters as drawn independently.",
}


@dataclasses.dataclass(frozen=True)
class Index:
    """How much one parameter matters to one output.

    Attributes:
        first: share of the variance due to it alone (Sobol's first-order index); NaN with `morris`.
        total: share due to it alone and together with others; None where the sample cannot give it.
        first_sd, total_sd: standard deviations of these estimates; None on a grid, where they are exact.
        effect, spread: of a `morris` sample the mean size and the standard deviation of the output's change
            over the parameter's whole range [SI].
    """

    first: float = float("nan")
    total: float | None = None
    first_sd: float | None = None
    total_sd: float | None = None
    effect: float | None = None
    spread: float | None = None


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Indices by output and parameter; what method they come from, or why there are none."""

    says: str
    indices: dict[str, dict[str, Index]]

    @property
    def idle(self) -> list[str]:
        """Parameters known to change nothing that was computed."""
        sizes: dict[str, list[float | None]] = {}
        for of in self.indices.values():
            for name, index in of.items():
                sizes.setdefault(name, []).append(index.total if index.effect is None else index.effect)
        return [name for name, all_ in sizes.items() if all(x is not None and abs(x) < 1e-12 for x in all_)]

    def to_json(self) -> dict[str, Any]:
        """The same as plain values."""
        return {
            "says": self.says,
            "indices": {
                output: {
                    name: {k: v for k, v in vars(i).items() if v is not None and v == v}
                    for name, i in of.items()
                }
                for output, of in self.indices.items()
            },
        }


def sensitivity_of(task: Task, store: Store) -> Sensitivity:
    """Indices of every number that a point has, at the step kept that is pulled hardest.

    On a grid, exact over its points; from a saltelli or morris sample by SALib's estimators of these names,
    from any other by its RBD-FAST.
    """
    plan, kind = task.plan, task.file.sample
    varied = [axis for axis in task.axes if axis.values is None or len(axis.values) > 1]
    if len(varied) < 2:
        return Sensitivity("Only one parameter is varied: everything goes with it.", {})
    if plan.points > MOST:
        return Sensitivity(f"Not computed for more than {MOST:,} points.", {})
    wanted = [v for v in task.outputs if NODE not in v.dims]
    found: dict[str, dict[str, Index]] = {}
    points: np.ndarray | None = None
    says = _METHODS["grid" if plan.gridded else kind if kind in ("saltelli", "morris") else "drawn"]
    for v in wanted:
        values = np.asarray(store.array(v.name)[...])
        if STEP in task.extra_dims(v):
            values = values[..., task.history.shown]
        known = np.isfinite(values)
        if not known.any() or np.ptp(values[known]) <= 1e-12 * np.max(np.abs(values[known])):
            continue
        if kind in ("saltelli", "morris") or plan.gridded:
            if not known.all():
                missing = int(np.sum(~known))
                return Sensitivity(f"Not computed: {missing:,} points have no numbers.", {})
            found[v.name] = _on_grid(values, task.axes) if plan.gridded else _by_salib(kind, values, task)
        elif known.sum() >= FEWEST:
            if points is None:
                points = np.stack([np.asarray(store.array(axis.name)[...]) for axis in task.axes], axis=1)
            found[v.name] = _given(points[known], values[known], task.axes)
    if not found:
        return Sensitivity("No output varies, or too few points have numbers.", {})
    return Sensitivity(says, found)


def _on_grid(values: np.ndarray, axes: tuple[Axis, ...]) -> dict[str, Index]:
    """Sobol's indices of a function known on a whole grid: variances of conditional means."""
    whole, found = values.var(), {}
    for i, axis in enumerate(axes):
        others = tuple(j for j in range(values.ndim) if j != i)
        first = values.mean(axis=others).var() / whole
        rest = values.mean(axis=i).var() / whole
        found[axis.name] = Index(first=float(first), total=float(1 - rest))
    return found


def _by_salib(kind: str, values: np.ndarray, task: Task) -> dict[str, Index]:
    from SALib.analyze import morris, sobol

    axes = task.axes
    problem = sensitivity_problem([axis.name for axis in axes])
    seed, count = task.file.seed, task.file.count or 0
    if kind == "saltelli":
        told = sobol.analyze(problem, values, calc_second_order=False, seed=seed)
        columns = zip(told["S1"], told["ST"], told["S1_conf"], told["ST_conf"], strict=True)
        return {
            axis.name: Index(float(a), float(b), float(c) / TWO_SIDED, float(d) / TWO_SIDED)
            for axis, (a, b, c, d) in zip(axes, columns, strict=True)
        }
    shares = sensitivity_sample("morris", len(axes), count, seed)
    told = morris.analyze(problem, shares, values, num_levels=LEVELS, seed=seed)
    return {
        axis.name: Index(effect=float(a), spread=float(b))
        for axis, a, b in zip(axes, told["mu_star"], told["sigma"], strict=True)
    }


def _given(points: np.ndarray, values: np.ndarray, axes: tuple[Axis, ...]) -> dict[str, Index]:
    from SALib.analyze import rbd_fast

    points, values = points[:MOST_GIVEN], values[:MOST_GIVEN]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        told = rbd_fast.analyze(sensitivity_problem([a.name for a in axes]), points, values, seed=0)
    return {
        axis.name: Index(first=float(a), first_sd=float(c) / TWO_SIDED)
        for axis, a, c in zip(axes, told["S1"], told["S1_conf"], strict=True)
    }
