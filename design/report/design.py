"""A design in words, tables and pictures."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure as Drawn

from gtr_jax.notebook import draws
from gtr_jax.numbers import number, quantity
from gtr_jax.plots.straight import plot_straight
from gtr_jax.plots.tension import plot_tension
from gtr_jax.report.card import card
from gtr_jax.report.object_cards import DOTS
from gtr_jax.report.page import Figure, Report, Table
from gtr_jax.robot.build import build_robot
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.equilibrium import equilibrium
from gtr_jax.simulation.history import Simulation, equilibrium_at
from gtr_jax.simulation.phases import label_phases
from gtr_jax.units import display_of

from ..compare import Comparison
from ..limits import LOSS
from ..option import Margin, Option
from ..result import GOAL_UNITS, Design
from ..robustness import Robustness
from ..tensions import Pull, pull_says
from .figures import Mark, Near, plot_channels, plot_targets, plot_tip
from .playback import design_playback, pull_and_release
from .spatial import pictures

SHOWN = 12  # designs listed, at most
LEAST = 1e-4  # mm or degrees, below which a check has no digits


def design_report(answer: Design) -> Report:
    """Verdict, figures and tables of a design.

    Args:
        answer: from `design.optimise`.
    """
    if answer.config.in_space or answer.config.tendons:
        figures, scenes, playbacks = pictures(answer, _alternatives_of(answer))
    else:
        robot = build_robot(answer.config)
        run = pull_and_release(answer, robot)
        phases = label_phases(run)
        figures, scenes = _figures(answer, robot, run, phases), []
        playbacks = [design_playback(robot, run, phases, answer.best.errors)]
    return Report(
        title=f"{answer.problem.target.name}: design of {answer.config.name}",
        verdict=answer.says,
        warnings=_warnings(answer),
        figures=figures,
        tables=_tables(answer),
        scenes=scenes,
        playbacks=playbacks,
    )


def _warnings(answer: Design) -> list[str]:
    said = []
    if answer.verdict == "not-reached":
        said.append("This is the nearest design found, not one that meets the target.")
    if not answer.verification.converged:
        said.append("Not everything could be verified: some equilibrium did not converge.")
    return said


def _quantity(value: float, unit: str, digits: int = 4) -> str:
    return "any" if value is not None and np.isinf(value) else quantity(value, unit, digits)


def _limit(name: str, value: float, unit: str, digits: int = 4) -> str:
    """The number of a limit: a share of the tension in per cent."""
    return number(100 * value, "%", digits) if name == LOSS else _quantity(value, unit, digits)


def _check(value: float, unit: str) -> str:
    """A small difference between two solutions, in words."""
    display, size = display_of(unit)
    if value < LEAST * size:
        return f"less than {LEAST:g} {display}"
    return _quantity(value, unit, 2)


def _figures(answer: Design, robot: Robot, run: Simulation, phases: np.ndarray) -> list[Figure]:
    best = answer.best
    T = np.asarray(run.T_base)
    top = int(np.argmax(T))
    states, seen = [("at rest", equilibrium(robot, 0.0))], set()
    for number_, released in sorted(answer.problem.objective.states, key=lambda state: state[1]):
        value = float(best.tensions[number_])
        if (value, released) in seen or len(states) > 3:
            continue
        seen.add((value, released))
        steps = np.flatnonzero(np.isclose(T, value, rtol=1e-12, atol=1e-12))
        after = steps[steps > top] if released else steps[steps <= top]
        if len(after):
            word = f"{value:.4g} N" + (", releasing" if released else "")
            states.append((word, equilibrium_at(robot, run, int(after[0]))))
    radius = np.asarray(robot.backbone.radius(run.s))
    cloud = None
    if answer.robustness is not None:
        cloud = np.concatenate([s.ellipse for s in answer.robustness.spreads])
    marks, near, others = _marks(answer), _near(answer), ""
    if answer.comparison is not None:
        found = [e.found for e in answer.comparison.actual.errors if e.found[0] == e.found[0]]
        marks += [Mark(1e3 * x, 1e3 * y, np.nan, 0.0, True) for x, y, _ in found]
        others = " Diamonds: where the tip would be with the design of the plain model."
    if near:
        others += " Below, magnified: the tolerance as a circle and the tip that the design has as a dot."
    pose = np.asarray(run.tip_pose)
    return [
        Figure(
            "target",
            plot_targets(states, radius, pose[:, :2], phases, marks, near, cloud),
            "The deformed shape at each target, the path of the tip through the whole pull and release "
            "(coloured by phase), and what is wanted: crosses, arrows of the angle"
            + ("; dots, the tip at the edge of what is not known." if cloud is not None else ".")
            + others,
        ),
        Figure(
            "tip",
            plot_tip(T, pose, phases, _tip_marks(answer)),
            "Tip against base tension, pulled and released; where the two differ is hysteresis. Bars are the "
            "tolerances, where these are larger than the marks.",
        ),
        Figure(
            "channel",
            _channel(answer),
            "The channel in the unloaded body, its bores white."
            + (" Alternatives reach the targets within the limits too." if _alternatives_of(answer) else ""),
        ),
        Figure(
            "tension",
            plot_tension(run, phases),
            "Tension along the tendon at several steps; dotted where the tendon is locked.",
        ),
    ]


def _alternatives_of(answer: Design) -> list[Option]:
    """The other designs that can be offered; none where even the best is only the nearest."""
    return list(answer.options[1:]) if answer.verdict in ("reached", "optimal") else []


def _near(answer: Design) -> list[Near]:
    """The places that are asked for, each with its tolerance and what the design has there."""
    out = []
    for e in answer.best.errors:
        if e.distance == e.distance:
            off = e.distance_says + (f", {e.turn_says}" if e.turn == e.turn else "")
            out.append(
                Near(
                    (1e3 * e.wanted[0], 1e3 * e.wanted[1]),
                    (1e3 * e.found[0], 1e3 * e.found[1]),
                    e.wanted[2],
                    1e3 * e.tip_tolerance,
                    f"{e.name}: off by\n{off}",
                )
            )
    return out


def _marks(answer: Design) -> list[Mark]:
    marks, target = [], answer.problem.target
    for e in answer.best.errors:
        if e.name.startswith("pose") and e.wanted[0] == e.wanted[0]:
            marks.append(Mark(1e3 * e.wanted[0], 1e3 * e.wanted[1], e.wanted[2], 1e3 * e.tip_tolerance))
        elif e.name.startswith("pose"):
            marks.append(Mark(1e3 * e.found[0], 1e3 * e.found[1], e.wanted[2], 0.0))
    for i, shape in enumerate(target.shape):
        tolerance = next(e.tip_tolerance for e in answer.best.errors if e.name == f"shape[{i}]")
        marks += [Mark(1e3 * x, 1e3 * y, np.nan, 1e3 * tolerance) for _, x, y, *_ in shape.points]
    return marks


def _tip_marks(answer: Design) -> list[tuple[float, str, int, float, float]]:
    marks = []
    for e in answer.best.errors:
        if e.name.startswith("pose"):
            tolerances = (e.tip_tolerance, e.tip_tolerance, e.angle_tolerance)
            for column in range(3):
                if e.wanted[column] == e.wanted[column]:
                    marks.append((e.T_base, e.branch, column, e.wanted[column], tolerances[column]))
    return marks


def _channel(answer: Design) -> Drawn:
    """Offsets of the chosen channel and of the alternatives that can be offered."""
    lines = []
    s = np.linspace(0.0, answer.config.backbone.length, 401)
    for config in [answer.config, *(o.config for o in _alternatives_of(answer))]:
        routing = build_robot(config).routing
        passed = routing.kinks()[:, None] <= jnp.asarray(s)[None, :]
        R = routing.offset(jnp.asarray(s), passed, jnp.asarray(config.backbone.length)).value
        lines.append(1e3 * np.stack([s, np.asarray(R)], axis=1))
    body = answer.config.backbone
    radius = 1e3 * np.interp(s, [0.0, body.length], body.outer_radius)
    bores = []
    for b in body.bores:
        x, y = 1e3 * np.array([b.from_, b.to]), 0.5e3 * b.diameter
        bores.append(np.array([[x[0], -y], [x[1], -y], [x[1], y], [x[0], y], [x[0], -y]]))
    limits = answer.problem.target.limits
    clearance = 1e3 * (limits.wall_clearance + 0.5 * limits.channel_diameter)
    chosen = "chosen" if answer.verdict in ("reached", "optimal") else "nearest"
    return plot_channels(lines, (1e3 * s, radius), bores, clearance, chosen)


def design_table(answer: Design) -> Table:
    """The numbers of the best design, and the ranges that were searched."""
    best, allowed = answer.best, {t.parameter.name: t.allowed for t in answer.tolerances}
    rows = [
        (
            v.name,
            _quantity(best.values[v.name], v.unit, _digits(best.values[v.name], allowed.get(v.name))),
            f"{_quantity(v.lower, v.unit)} … {_quantity(v.upper, v.unit)}",
        )
        for v in answer.problem.space.all
    ]
    return Table("The design", ("", "value", "searched"), rows)


@draws(Design)
def design_card(answer: Design) -> str:
    """For a notebook: what was found, the channels of the straight body, and the numbers."""
    picture = plot_straight(build_robot(answer.config))
    return card(
        Report(
            title=f"{answer.problem.target.name}: design of {answer.config.name}",
            verdict=answer.says,
            warnings=_warnings(answer),
            figures=[Figure("channels", picture, "The straight body with its channels.", DOTS)],
            tables=[design_table(answer)],
        )
    )


def _tables(answer: Design) -> list[Table]:
    tables = [design_table(answer)]
    best = answer.best
    if best.errors:
        heads = ("target", "base tension", "branch", "tip off by", "allowed", "angle off by", "allowed", "")
        rows = [
            (
                e.name,
                _pull(answer, e.T_base),
                e.branch,
                e.distance_says,
                _quantity(e.tip_tolerance, "m", 3) if e.distance == e.distance else "–",
                e.turn_says,
                _quantity(e.angle_tolerance, "rad", 3) if e.turn == e.turn else "–",
                "within" if e.within else "missed",
            )
            for e in best.errors
        ]
        tables.append(Table("Targets", heads, rows, "On a mesh four times finer than the default."))
    if answer.config.in_space or answer.config.tendons:
        tables.append(_tendons(answer))
    rows = [
        (
            m.name,
            "straight" if _is_straight(m) else _limit(m.name, m.value, m.unit),
            _limit(m.name, m.limit, m.unit),
            "–" if _is_straight(m) else _limit(m.name, m.margin, m.unit, 3),
            _quantity(m.where, "m", 3),
            "kept" if m.kept else "broken",
        )
        for m in best.margins
    ]
    note = f"Of the tension, {number(100 * best.loss, '%', 3)} is lost on the way to the tip."
    tables.append(Table("Limits", ("", "value", "limit", "margin", "at s", ""), rows, note))
    if answer.binding:
        rows = [(b.says,) for b in answer.binding]
        tables.append(Table("What the design depends on", ("",), rows))
    if answer.relaxed:
        rows = [
            (
                r.name,
                _limit(r.name, r.limit, r.unit),
                _limit(r.name, r.value, r.unit),
                "reached" if r.reached else "not reached",
            )
            for r in answer.relaxed
        ]
        tables.append(Table("If one limit were put aside", ("limit", "is", "would be", "targets"), rows))
    tables.append(_alternatives(answer))
    if answer.comparison is not None:
        tables.append(_comparison(answer, answer.comparison))
    if answer.robustness is not None:
        tables.append(_robustness(answer, answer.robustness))
    rows = [
        (
            t.parameter.name,
            _quantity(t.value, t.parameter.unit),
            _per_percent(t.moves, t.value, "m"),
            _per_percent(t.turns, t.value, "rad"),
            _quantity(t.allowed, t.parameter.unit, 2),
        )
        for t in answer.tolerances
    ]
    tables.append(
        Table(
            "Manufacturing tolerances",
            ("", "value", "tip moves per 1 %", "and turns", "allowed by itself"),
            rows,
            "To first order, at the worst target. The last column is the deviation that alone uses up the "
            "tolerance of a target; where the value is 0 there is no 1 % of it.",
        )
    )
    tables.append(_verification(answer))
    return tables


def _digits(value: float, allowed: float | None) -> int:
    """Digits of a value of which two are within the deviation that a tolerance allows; four to seven."""
    if not allowed or not value or not np.isfinite(allowed):
        return 5
    return int(np.clip(2 + np.floor(np.log10(abs(value))) - np.floor(np.log10(allowed)), 4, 7))


def _is_straight(margin: Margin) -> bool:
    return margin.name == "min_channel_radius" and margin.value > 1e3


def _per_percent(slope: float, value: float, unit: str) -> str:
    return "–" if value == 0 else _quantity(0.01 * slope * abs(value), unit, 2)


def _alternatives(answer: Design) -> Table:
    names = [v.name for v in answer.problem.space.all]
    units = {v.name: v.unit for v in answer.problem.space.all}
    goal = answer.problem.target.goal
    heads = (
        *names,
        "worst error [tolerances]",
        "tension lost",
        *(("goal",) if answer.best.goal == answer.best.goal else ()),
    )
    rows = []
    for o in answer.options[:SHOWN]:
        row = [_quantity(o.values[n], units[n], 4) for n in names]
        miss = number(o.miss, digits=2) if o.miss >= 0.01 or not o.errors else "less than 0.01"
        row += [miss, number(100 * o.loss, "%")]
        if goal is not None and o.goal == o.goal:
            row.append(_quantity(o.goal, GOAL_UNITS[goal.kind]))
        rows.append(tuple(row))
    robust = answer.problem.objective.spread != "nominal"
    if answer.verdict not in ("reached", "optimal"):
        note = "None meets the targets within the limits; the nearest comes first."
    elif answer.best.goal == answer.best.goal:
        note = "All keep the limits. The first, the one chosen, comes nearest to the goal."
    elif robust:
        note = "All keep the limits. The first, the one chosen, has the least error over what is not known."
    else:
        note = "All meet the targets within the limits. The first, the one chosen, loses the least tension."
    return Table("Designs found", heads, rows, note)


def _pull(answer: Design, pull: Pull) -> str:
    """Base tensions of one load, of several tendons each by its name."""
    names = answer.problem.space.config.tendon_names
    return pull_says(pull, names) if isinstance(pull, tuple) else number(pull, "N")


def _tendons(answer: Design) -> Table:
    """Tension at both ends of every tendon at every state, and how far it is drawn out."""
    names = answer.problem.space.config.tendon_names or ("",)
    rows = []
    for i, (_, released) in enumerate(answer.problem.objective.states):
        T_base, T_tip, drawn = (
            np.atleast_1d(np.asarray(values)[i])
            for values in (
                answer.best.states.T_base,
                answer.best.states.T_tip,
                answer.verification.displacement,
            )
        )
        for k, name in enumerate(names):
            rows.append(
                (
                    str(i + 1),
                    "releasing" if released else "pulling",
                    name,
                    number(float(T_base[k]), "N"),
                    number(float(T_tip[k]), "N"),
                    _quantity(float(drawn[k]), "m"),
                )
            )
    heads = ("state", "branch", "tendon", "base tension", "tip tension", "drawn out")
    note = "Several tendons are pulled together from their preloads." if len(names) > 1 else ""
    return Table("Tendons", heads, rows, note)


def _comparison(answer: Design, c: Comparison) -> Table:
    rows = [
        (
            believed.name,
            _pull(answer, actual.T_base),
            actual.branch,
            believed.distance_says,
            actual.distance_says,
            believed.turn_says,
            actual.turn_says,
        )
        for believed, actual in zip(c.believed.errors, c.actual.errors, strict=True)
    ]
    return Table(
        "Designed with the plain model instead",
        (
            "target",
            "base tension",
            "branch",
            "tip off, believed",
            "in truth",
            "angle off, believed",
            "in truth",
        ),
        rows,
        f"Plain model: {c.source}. In truth: in the robot with all its physics.",
    )


def _robustness(answer: Design, r: Robustness) -> Table:
    rows = [
        (
            s.name,
            _pull(answer, s.T_base),
            s.branch,
            _quantity(s.rms, "m", 2),
            _quantity(s.worst, "m", 2),
            _quantity(s.rms_turn, "rad", 2),
            _quantity(s.worst_turn, "rad", 2),
        )
        for s in r.spreads
    ]
    heads = ("target", "base tension", "branch", "tip off, rms", "worst", "angle off, rms", "worst")
    note = f"With {r.open} ({r.source}); worst within {number(r.deviations)} standard deviations." + (
        f" Nothing is said of {r.exact}, taken as exact." if r.exact else ""
    )
    return Table("What friction and modulus leave open", heads, rows, note)


def _verification(answer: Design) -> Table:
    v = answer.verification
    moved = [
        ("mesh four times finer", *v.fine_moved),
        ("many load steps instead of one", *v.steps_moved),
        ("the paper's literal integrals", *v.literal_moved),
    ]
    rows = [(name, _check(tip, "m"), _check(turn, "rad")) for name, tip, turn in moved]
    s = answer.search
    note = (
        f"{s.method}: {s.lanes} starts, {s.settled} settled, {s.evaluations} evaluations with derivatives, "
        f"{s.seconds:.3g} s in all." + (f" Literal integrals: {v.literal_says}." if v.literal_says else "")
    )
    return Table("Verification", ("solved with", "moves the tip by", "and turns it by"), rows, note)
