"""What a frozen case is, and what the cases have in common."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import gtr_jax as gtr

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
REFERENCE = ROOT / "tests/data/reference"

# Largest change that is allowed, relative to the largest magnitude of the quantity in its case. Compiled
# without XLA's optimisation, today's load histories move by 1e-14 of the base model and 3e-7 with terms.
BASE, TERMS = 1e-9, 1e-6
# Shares of the nodes, counted from the base, at which quantities along the robot are kept.
KEPT_NODES = (0.0, 0.25, 0.5, 0.75, 0.9)

Answers = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Case:
    """One computation whose answers are frozen.

    Attributes:
        group, name: by which it is asked for.
        run: computes its answers, an array of numbers or words for each quantity.
        allowed: largest relative change of a number.
        floors: least magnitude that changes of a quantity are taken relative to, by a pattern of its name
            (`fnmatch`); for quantities that may be rounding errors of zero.
        looser: largest relative change of quantities for which it is another one, by a pattern; the first
            that fits counts.
        steps_allowed: share of the entries of a discrete quantity (`DISCRETE`) that may differ.
    """

    group: str
    name: str
    run: Callable[[], Answers]
    allowed: float
    floors: Mapping[str, float] = dataclasses.field(default_factory=dict)
    looser: Mapping[str, float] = dataclasses.field(default_factory=dict)
    steps_allowed: float = 0.0


# Quantities that jump from node to node or between signs: a rounding error may move one of them visibly.
DISCRETE = ("slip_direction", "slip_front")


def history(largest: float) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and base tension [N] of a pull, a release, a second pull, a hold and a last release, (60,)."""
    legs = [(0.0, 1.0, 20, 0.5), (1.0, 0.15, 18, 0.3), (0.15, 0.8, 12, 0.15), (0.8, 0.8, 3, 1.0)]
    legs.append((0.8, 0.0, 7, 0.4))
    tension, time = [0.0], [0.0]
    for start, end, steps, dt in legs:
        tension += np.linspace(start, end, steps + 1)[1:].tolist()
        time += (time[-1] + dt * np.arange(1, steps + 1)).tolist()
    return np.asarray(time[1:]), largest * np.asarray(tension[1:])


def typical(*kinds: str) -> dict[str, float]:
    """Numbers of physics terms at their typical values, by name."""
    from gtr_jax.terms import REGISTRY

    return {f"{kind}.{q.name}": float(q.typical) for kind in kinds for q in REGISTRY[kind].quantities}


def at_nodes(values: Any) -> np.ndarray:
    """A quantity along the robot, nodes last, at some of the nodes."""
    values = np.asarray(values)
    last = values.shape[-1] - 1
    return values[..., [round(share * last) for share in KEPT_NODES] + [last]]


def of_run(run: gtr.Simulation) -> Answers:
    """What is kept of a simulation."""
    found = {
        "T_tip": run.T_tip,
        "tip_x": run.tip_pose[:, 0],
        "tip_y": run.tip_pose[:, 1],
        "tip_angle": run.tip_pose[:, 2],
        "displacement": run.displacement,
        "slip_direction": run.slip_direction,
        "slip_front": run.slip_front,
        "tension": at_nodes(run.tension)[..., 1:-1],  # without its ends, which are T_base and T_tip
        "converged": run.converged,
    }
    cells = {"reading.T_base": (run.reading[0], run.T_base), "reading.T_tip": (run.reading[1], run.T_tip)}
    for name, (shown, true) in cells.items():
        if not np.array_equal(np.asarray(shown), np.asarray(true)):
            found[name] = shown
    return {name: np.asarray(values) for name, values in found.items()}


def flattened(data: Any, leave_out: tuple[str, ...] = ()) -> Answers:
    """Numbers, and lists of numbers, of nested plain values, by keys joined with dots; text is left out, and
    None counts as NaN.
    """
    found: Answers = {}

    def visit(value: Any, name: str) -> None:
        if name.rpartition(".")[2] in leave_out:
            return
        if isinstance(value, Mapping):
            for key, inner in value.items():
                visit(inner, f"{name}.{key}" if name else str(key))
        elif isinstance(value, (list, tuple)):
            try:
                found[name] = np.asarray([np.nan if v is None else v for v in value], dtype=float)
            except (TypeError, ValueError):
                for k, inner in enumerate(value):
                    visit(inner, f"{name}.{k}")
        elif value is None or isinstance(value, (bool, int, float, np.number, np.bool_)):
            found[name] = np.asarray(np.nan if value is None else value, dtype=float)

    visit(data, "")
    return found
