"""The answer of a design: what was found, in words and as plain values for JSON."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from gtr_jax.config.config import RobotConfig
from gtr_jax.notebook import as_card
from gtr_jax.numbers import quantity
from gtr_jax.to_jsonable import to_jsonable

from .compare import Comparison
from .distinct import by_loss
from .limits import APART, BORE, LOSS, OBSTACLE, WALL
from .option import Margin, Option, TargetError
from .pose import ANGLE, PLANE, place_of, rotation_matrix
from .problem import DesignProblem
from .robustness import Robustness, Spread
from .tables import options_frame
from .tensions import pull_says
from .tolerances import Sensitivity
from .verify import Verification

if TYPE_CHECKING:
    import pandas

REACHED, NEAREST, OPTIMAL, UNSETTLED = "reached", "not-reached", "optimal", "not-converged"
GOAL_UNITS = {"reach": "m", "bend": "rad", "tension": "N"}


@dataclasses.dataclass(frozen=True)
class Binding:
    """A limit or a bound that binds the design.

    Attributes:
        name: of the limit, or of the number at its bound.
        kind: "limit", "least" or "largest".
        force: size of the multiplier, by which bindings are ordered.
        bound, unit: of the number at its bound, SI.
    """

    name: str
    kind: str
    force: float
    bound: float = float("nan")
    unit: str = ""

    @property
    def says(self) -> str:
        """In words."""
        if self.kind == "limit":
            return self.name
        return f"{self.name} at its {self.kind} value of {quantity(self.bound, self.unit)}"


@dataclasses.dataclass(frozen=True)
class Relaxed:
    """What putting one limit aside would do: whether the targets are reached, and the value the design would
    then have in place of the limit, SI.
    """

    name: str
    reached: bool
    value: float
    limit: float
    unit: str


@dataclasses.dataclass(frozen=True)
class SearchFacts:
    """How it was found: method, lanes and how many of them settled, evaluations of all; for a robust design,
    whether the targets can be met without uncertainty; seconds.
    """

    method: str
    lanes: int
    settled: int
    evaluations: int
    reachable: bool
    seconds: float


@dataclasses.dataclass(frozen=True, eq=False)
class Design:
    """All that a design found.

    Attributes:
        problem: the files and what was searched.
        options: distinct designs, the best first, each on the mesh four times finer than the default; all
            of them valid, or none is and they are the nearest (`distinct_options`).
        verification: of the best.
        binding: what it leans on. relaxed: what putting a limit aside would do, if the targets are not met.
        tolerances: of its dimensions. robustness: None if nothing is uncertain.
        comparison: with the design of a plainer model; None without one.
        search: how it was found.
    """

    problem: DesignProblem
    options: tuple[Option, ...]
    verification: Verification
    binding: tuple[Binding, ...]
    relaxed: tuple[Relaxed, ...]
    tolerances: tuple[Sensitivity, ...]
    robustness: Robustness | None
    comparison: Comparison | None
    search: SearchFacts

    @property
    def best(self) -> Option:
        """The design that was chosen, on the mesh four times finer than the default."""
        return self.options[0]

    @property
    def config(self) -> RobotConfig:
        """The designed robot."""
        return self.best.config

    @property
    def verdict(self) -> str:
        """reached, optimal, not-reached or not-converged."""
        goal = self.problem.target.goal is not None
        robust = self.problem.objective.spread != "nominal" and not goal
        aims = goal or robust
        arrived = self.best.reached and self.best.kept and not aims  # it needs no more than that
        if not self.verification.converged or (self.search.settled == 0 and not arrived):
            return UNSETTLED
        if not self.best.kept or not (self.search.reachable if robust else self.best.reached):
            return NEAREST
        return OPTIMAL if aims else REACHED

    @property
    def converged(self) -> bool:
        """Whether there is an answer."""
        return self.verdict != UNSETTLED

    @property
    def says(self) -> str:
        """The answer in a sentence or three."""
        return " ".join(_sentences(self))

    _repr_html_ = as_card

    def to_pandas(self) -> pandas.DataFrame:
        """The designs found, the best first, a row each: what was searched and the base tensions, SI with
        units in the names, the largest error in units of its tolerance, the share of the tension that is
        lost, and whether targets and limits are kept.
        """
        return options_frame(self.options, self.problem.space)

    def to_json(self) -> dict[str, Any]:
        """The answer as plain values, SI, units in the keys."""
        v, search = self.verification, self.search
        names = self.problem.space.config.tendon_names
        return to_jsonable(
            {
                "schema": 1,
                "verdict": self.verdict,
                "says": self.says,
                "parameters": [
                    {
                        "name": s.name,
                        "key": s.key or s.name,
                        "value": self.best.values[s.name],
                        "unit": s.unit,
                        "lower": s.lower,
                        "upper": s.upper,
                    }
                    for s in self.problem.space.all
                ],
                "T_base_N": self.best.tensions,
                "goal": None if self.problem.target.goal is None else self._goal(),
                "targets": [_target(e, names) for e in self.best.errors],
                "states": _states(self),
                "limits": [_margin(m) for m in self.best.margins],
                "tension_loss": self.best.loss,
                "binding": [
                    {"name": b.name, "kind": b.kind, "bound": b.bound, "unit": b.unit} for b in self.binding
                ],
                "without_a_limit": [dataclasses.asdict(r) for r in self.relaxed],
                "alternatives": [_option(o, names) for o in self.options],
                "verification": {
                    "converged": v.converged,
                    "mesh_four_times_finer": _moved(v.fine_moved),
                    "many_load_steps": _moved(v.steps_moved),
                    "literal_integrals": {**_moved(v.literal_moved), "says": v.literal_says},
                },
                "tolerances": [
                    {
                        "name": t.parameter.name,
                        "key": t.parameter.key,
                        "value": t.value,
                        "unit": t.parameter.unit,
                        "tip_moves_m_per_unit": t.moves,
                        "tip_turns_rad_per_unit": t.turns,
                        "allowed": t.allowed,
                    }
                    for t in self.tolerances
                ],
                "robustness": None if self.robustness is None else _robustness(self.robustness, names),
                "plain_model": None if self.comparison is None else _comparison(self.comparison, names),
                "search": dataclasses.asdict(search),
            }
        )

    def _goal(self) -> dict[str, Any]:
        goal = self.problem.target.goal
        assert goal is not None
        return {"kind": goal.kind, "value": self.best.goal, "unit": GOAL_UNITS[goal.kind]}


def miss_says(error: TargetError) -> str:
    """By how much a target is missed."""
    parts = []
    if error.distance == error.distance:
        parts.append(error.distance_says)
    if error.turn == error.turn:
        parts.append(error.turn_says)
    return " and ".join(parts)


def limit_says(name: str, value: float, unit: str, digits: int = 3) -> str:
    """The number of a limit: a share of the tension in per cent, anything else in its unit."""
    return f"{100 * value:.{digits}g} %" if name == LOSS else quantity(value, unit, digits)


def freed_says(answer: Design) -> str:
    """What was chosen besides the channel, tensions first: " with T_base 12.3 N, E 1.1 MPa"; "" if nothing
    was. Each of several tensions is followed by its targets.
    """
    space, best = answer.problem.space, answer.best
    names = [v.name for v in space.free_tensions]
    goal = answer.problem.target.goal
    if goal is not None and goal.kind == "tension" and len(names) == 1:
        names = []  # the goal's own number says it
    parts = []
    for name in names:
        value = best.values[name]
        of = [e.name for e in best.errors if not space.config.tendons and e.T_base == value]
        if len(names) > 1 and not space.config.tendons:
            parts.append(f"{name} {quantity(value, 'N')} ({', '.join(of) or 'before release'})")
        else:
            parts.append(f"{name} {quantity(value, 'N')}")
    parts += [
        f"{v.name} {quantity(best.values[v.name], v.unit)}" for v in space.variables if not v.of_channel
    ]
    return f" with {', '.join(parts)}" if parts else ""


def _sentences(answer: Design) -> list[str]:
    best, target = answer.best, answer.problem.target
    name = target.name
    if answer.verdict == UNSETTLED and not answer.verification.converged:
        return [
            f"{name}: an equilibrium of the design was not found again, on a finer mesh, in many steps or "
            "from the literal integrals. Do not use the design; narrow the bounds or lower T_base."
        ]
    if answer.verdict == UNSETTLED:
        return [
            f"{name}: the search did not converge; {answer.search.settled} of {answer.search.lanes} starts "
            "settled. Do not use the design; give more starts or narrower bounds."
        ]
    out = []
    worst = max(best.errors, key=lambda e: e.size, default=None)
    if answer.verdict == NEAREST:
        out.append(_not_reached(answer, worst))
        limits = [b for b in answer.binding if b.kind == "limit"]
        bounds = [b for b in answer.binding if b.kind != "limit"]
        if limits or bounds:
            out.append(f"What binds: {', '.join(b.says for b in [*limits, *bounds])}.")
        for r in answer.relaxed:
            if r.reached:
                out.append(
                    f"Without {r.name} it would be reached, with {limit_says(r.name, r.value, r.unit, 4)} "
                    f"instead of {limit_says(r.name, r.limit, r.unit, 4)}."
                )
        if answer.relaxed and not any(r.reached for r in answer.relaxed):
            out.append("Putting one limit aside does not help.")
        return out
    robust = answer.problem.objective.spread != "nominal" and target.goal is None
    lost = f"; {100 * best.loss:.3g} % of the tension is lost" if best.loss == best.loss else ""
    loss = f"{freed_says(answer)}{lost}"
    known = answer.robustness
    off = "; ".join(_spread_says(s, best.errors) for s in known.spreads) if known is not None else ""
    if known is not None and robust:
        out.append(
            f"{name}: least {answer.problem.objective.spread} error over what is not known of friction and "
            f"modulus: {off}{loss}."
        )
        if worst is not None:
            out.append(f"With both as in the file {worst.name} is missed by {miss_says(worst)}.")
    elif target.goal is not None:
        goal = answer._goal()
        word = {"reach": "reach", "bend": "bend of the tip", "tension": "least base tension"}[goal["kind"]]
        out.append(f"{name}: {word} {quantity(goal['value'], goal['unit'])}{loss}.")
        if known is not None:
            out.append(f"With {known.open}, {off}.")
    elif worst is None:
        out.append(f"{name}: reached{loss}.")
    elif known is not None:
        out.append(
            f"{name}: with {known.open}, {off}; by the numbers of the file alone reached to "
            f"{miss_says(worst)}{loss}."
        )
    else:
        out.append(f"{name}: reached to {miss_says(worst)}{loss}.")
    tight = min(best.margins, key=lambda m: m.margin / _scale(answer, m), default=None)
    if tight is not None:
        word = f"tightest is {tight.name}, {_margin_says(tight)}"
        out.append(f"All limits are kept; {word}.")
    others = len(answer.options) - 1
    if others:
        keep = "keep" if others > 1 else "keeps"
        reach = f"reach{'' if others > 1 else 'es'} the targets and {keep}"
        reach = reach if best.errors and not robust else keep
        least = "; none loses less tension" if by_loss(answer.problem) and best.loss == best.loss else ""
        word = f"{others} other design{'s' if others > 1 else ''} found that {reach} the limits{least}"
        out.append(f"{word}.")
    if answer.comparison is not None:
        actual = max(answer.comparison.actual.errors, key=lambda e: e.size, default=None)
        if actual is not None:
            word = "" if answer.comparison.believed.reached else ", of which it expects a part"
            out.append(
                f"Designed with {answer.comparison.source}, the tip would miss by {miss_says(actual)}{word}."
            )
    return out


def _spread_says(s: Spread, errors: tuple[TargetError, ...]) -> str:
    """How far a target is off over what is not known: in position, in angle, or in both, as asked."""
    parts = []
    own = next((e for e in errors if e.name == s.name), None)
    if own is None or own.distance == own.distance:
        parts.append(f"by {quantity(s.rms, 'm', 2)} rms, {quantity(s.worst, 'm', 2)} at worst")
    if own is not None and own.turn == own.turn:
        parts.append(f"by {quantity(s.rms_turn, 'rad', 2)} rms, {quantity(s.worst_turn, 'rad', 2)} at worst")
    return f"{s.name} is off {' and '.join(parts)}"


def _scale(answer: Design, m: Margin) -> float:
    """What a margin is large or small against."""
    if m.name in (WALL, BORE, APART, OBSTACLE):
        return max(answer.config.backbone.outer_radius)
    return abs(m.limit) or 1.0


def _margin_says(m: Margin) -> str:
    return f"{limit_says(m.name, m.value, m.unit)} for {limit_says(m.name, m.limit, m.unit)}"


def _not_reached(answer: Design, worst: TargetError | None) -> str:
    name = answer.problem.target.name
    broken = [m for m in answer.best.margins if not m.kept]
    if broken:
        said = ", ".join(f"{m.name} ({_margin_says(m)})" for m in broken)
        return f"{name}: no design found keeps all limits; the nearest{_with(answer)} breaks {said}."
    if worst is None:
        return f"{name}: no design found."
    names = answer.problem.space.config.tendon_names
    where = f"at {pull_says(worst.T_base, names)}, {worst.branch}"
    place, angle = place_of(worst.found), worst.found[ANGLE]
    tip = f"({', '.join(f'{1e3 * x:.4g}' for x in place)}) mm" if np.all(np.isfinite(place)) else ""
    turned = quantity(angle, "rad") if len(worst.found) == PLANE and angle == angle else ""
    there = ", ".join(part for part in (tip, turned) if part).replace("-", "−")
    return (
        f"{name}: not reachable within these limits and bounds, as far as {answer.search.lanes} starts tell. "
        f"The nearest{_with(answer)} misses {worst.name} ({where}) by {miss_says(worst)}, at {there}."
    )


def _with(answer: Design) -> str:
    """What was chosen besides the channel, set off by commas."""
    freed = freed_says(answer)
    return f",{freed}," if freed else ""


def _pull(pull: Any, names: tuple[str, ...]) -> Any:
    """Base tensions of one load: a number, or of several tendons by their names."""
    return dict(zip(names, pull, strict=True)) if names else pull


def _pose(pose: tuple[float, ...]) -> dict[str, Any]:
    if len(pose) == PLANE:
        return {"x_m": pose[0], "y_m": pose[1], "angle_rad": pose[2]}
    rotation = rotation_matrix(pose)
    whole = bool(np.all(np.isfinite(rotation)))
    return {
        **{f"{axis}_m": value for axis, value in zip("xyz", pose[:3], strict=True)},
        "direction": rotation[:, 0],
        "rotation_rad": Rotation.from_matrix(rotation).as_rotvec() if whole else None,
    }


def _states(answer: Design) -> list[dict[str, Any]]:
    """Every state that a target asks for, and how far its tendons are drawn out."""
    names, displacement = answer.problem.space.config.tendon_names, answer.verification.displacement
    return [
        {
            "T_base_N": _pull(answer.best.tensions[number], names),
            "branch": "releasing" if released else "pulling",
            "displacement_m": _pull(drawn, names),
        }
        for (number, released), drawn in zip(answer.problem.objective.states, displacement, strict=True)
    ]


def _target(e: TargetError, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        "name": e.name,
        "T_base_N": _pull(e.T_base, names),
        "branch": e.branch,
        "wanted": _pose(e.wanted),
        "found": _pose(e.found),
        "distance_m": e.distance,
        "angle_rad": e.turn,
        "tip_tolerance_m": e.tip_tolerance,
        "angle_tolerance_rad": e.angle_tolerance,
        "within": e.within,
    }


def _margin(m: Margin) -> dict[str, Any]:
    return {**dataclasses.asdict(m), "kept": m.kept}


def _option(o: Option, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        "parameters": o.values,
        "T_base_N": o.tensions,
        "reached": o.reached,
        "limits_kept": o.kept,
        "worst_error_in_tolerances": o.miss,
        "tension_loss": o.loss,
        "goal": o.goal,
        "targets": [_target(e, names) for e in o.errors],
        "limits": [_margin(m) for m in o.margins],
    }


def _moved(by: tuple[float, float]) -> dict[str, float]:
    return {"tip_moves_m": by[0], "tip_turns_rad": by[1]}


def _robustness(r: Robustness, names: tuple[str, ...]) -> dict[str, Any]:
    return {
        "sd_relative": {"friction_coefficient": r.sd[0], "youngs_modulus": r.sd[1]},
        "correlation": r.correlation,
        "source": r.source,
        "deviations": r.deviations,
        "converged": r.converged,
        "targets": [
            {
                "name": s.name,
                "T_base_N": _pull(s.T_base, names),
                "branch": s.branch,
                "rms_m": s.rms,
                "worst_m": s.worst,
                "rms_rad": s.rms_turn,
                "worst_rad": s.worst_turn,
            }
            for s in r.spreads
        ],
    }


def _comparison(c: Comparison, names: tuple[str, ...]) -> dict[str, Any]:
    return {"source": c.source, "believed": _option(c.believed, names), "actual": _option(c.actual, names)}
