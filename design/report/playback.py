"""A design to go through on its page: the pull and release of one tendon, or the ways of several."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import jax.tree_util as jtu
import numpy as np
from numpy.typing import ArrayLike

from gtr_jax.plots.chart import Chart, Column, Line, Span
from gtr_jax.plots.style import INK, VERMILLION
from gtr_jax.plots.tendons import COLOURS
from gtr_jax.report.motion import body_of
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import playback
from gtr_jax.report.spatial import tip_angle
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.history import Simulation, simulate

from ..option import TargetError
from ..pose import DIRECTION
from ..result import Design

STEPS = 40  # load steps of the pull, beside those to the targets
BASE, TIP = "tension at the base [N]", "tension at the tip [N]"
BAND = ("#F2F2F2", "#E2E8EE")  # of one way and of the next


class Way(NamedTuple):
    """The way of several tendons, or of one, to a state that targets ask for.

    Attributes:
        name: of the state.
        run: from the preloads to it, K steps.
        pull: base tensions [N], (K, *tendons).
        errors: of the targets that ask for this state.
    """

    name: str
    run: Simulation
    pull: np.ndarray
    errors: Sequence[TargetError] = ()


def pull_and_release(answer: Design, robot: Robot) -> Simulation:
    """The whole pull and release of a design of one tendon."""
    top, start = float(np.max(answer.best.tensions)), float(robot.tendon.preload)
    pull = np.unique(np.concatenate([np.linspace(start, top, STEPS + 1), np.ravel(answer.best.tensions)]))
    pull = pull[(pull >= start) & (pull <= top)]
    history = np.concatenate([pull, pull[-2::-1] if start > 0 else np.append(pull[-2:0:-1], 0.0)])
    return simulate(robot, history, time=1e6 * np.arange(len(history)))


def design_playback(
    robot: Robot, run: Simulation, phases: np.ndarray, errors: Sequence[TargetError]
) -> Playback:
    """Where the tip is as the tendon is pulled and released, beside what the targets ask for.

    Args:
        robot: the design.
        run: its pull and release, K steps.
        phases: of the steps, (K,) labels.
        errors: of the targets.
    """
    T = np.asarray(run.T_base)
    step = Column("step", "", np.arange(1.0, len(T) + 1))
    base, tip = Column("T_base", "N", T), Column("T_tip", "N", np.asarray(run.T_tip))
    reached = [_step_at(T, float(np.max(e.T_base)), released=e.branch == "releasing") for e in errors]
    pose = _Pose(robot, run)
    charts = pose.charts(base, BASE, list(map(Asked, errors, reached)), phases)
    charts.append(Chart("Loop", BASE, TIP, [Line(base, tip, INK, phases=phases)]))
    poses = [k for k, e in zip(reached, errors, strict=True) if e.name.startswith("pose")]
    first = poses[0] if poses else int(np.argmax(T))
    return playback(
        charts,
        clock=step,
        told=[base, tip, *pose.places, pose.angle],
        unit="step",
        first=first,
        body=body_of(robot, run, first=first),
        stills=["tip"],
    )


def tendons_playback(robot: Robot, ways: Sequence[Way]) -> Playback:
    """Where the tip is as several tendons are pulled to each target, one way after the other, beside what
    the targets ask for, and how far each tendon is to be drawn out.

    Args:
        robot: the design.
        ways: to the states that targets ask for; each starts at the preloads again.
    """
    run, names = _one_after_another([way.run for way in ways]), robot.tendon_names
    step = Column("step", "", np.arange(1.0, len(run.time) + 1))
    ends = np.cumsum([len(way.pull) for way in ways])
    spans = [
        Span(end - len(way.pull) + 0.5, end + 0.5, f"{i}: {way.name}", str(i), BAND[i % len(BAND)])
        for i, (way, end) in enumerate(zip(ways, ends, strict=True), 1)
    ]
    asked = [
        Asked(e, int(end) - 1, slice(int(end) - len(way.pull), int(end)))
        for way, end in zip(ways, ends, strict=True)
        for e in way.errors
    ]

    def each(values: ArrayLike, label: str, unit: str) -> list[Column]:
        table = np.asarray(values).T
        return [Column(f"{label} {name}", unit, own) for name, own in zip(names, table, strict=True)]

    base, tip = each(run.T_base, "T_base", "N"), each(run.T_tip, "T_tip", "N")
    drawn = each(1e3 * np.asarray(run.displacement), "drawn out", "mm")
    colours = [COLOURS[i % len(COLOURS)] for i in range(len(names))]
    tensions = [
        line
        for b, t, colour in zip(base, tip, colours, strict=True)
        for line in (Line(step, b, colour, "dashed"), Line(step, t, colour))
    ]
    pose = _Pose(robot, run)
    charts = [
        *pose.charts(step, "step", asked, None, spans),
        Chart("Tensions", "step", "tension [N]", tensions, spans=spans),
        Chart(
            "Drawn out",
            "step",
            "drawn out at the base [mm]",
            [Line(step, own, colour) for own, colour in zip(drawn, colours, strict=True)],
            spans=spans,
        ),
    ]
    first = int(ends[0]) - 1
    return playback(
        charts,
        clock=step,
        told=[*(column for three in zip(base, tip, drawn, strict=True) for column in three), *pose.places],
        unit="step",
        first=first,
        body=body_of(robot, run, first=first),
        starts=ends[:-1].tolist(),
    )


class Asked(NamedTuple):
    """A target, the step of a history, from 0, that reaches it, and the steps that lead there."""

    error: TargetError
    step: int
    way: slice = slice(None)


class _Pose:
    """The tip at every step of a run, as columns of charts."""

    def __init__(self, robot: Robot, run: Simulation):
        place = 1e3 * np.asarray(run.tip_position)
        self.axes = "xyz" if robot.space else "xy"
        self.places = [Column(f"tip {axis}", "mm", place[:, i]) for i, axis in enumerate(self.axes)]
        self.angle = Column("angle of the tip", "°", np.degrees(tip_angle(run)))
        self.along = np.asarray(run.tip_rotation)[..., 0]

    def charts(
        self,
        across: Column,
        label: str,
        asked: Sequence[Asked],
        phases: np.ndarray | None,
        spans: Sequence[Span] = (),
    ) -> list[Chart]:
        """Place and orientation over something, with what is asked for at the steps that reach it.

        Args:
            across: what they are drawn over. label: of that axis.
            asked: the targets.
            phases: of the steps, (K,) labels; None for lines of one colour.
            spans: of that axis.
        """
        K = len(self.along)
        lines = [[Line(across, own, INK, phases=phases)] for own in self.places]
        turns, off = [Line(across, self.angle, INK, phases=phases)], []
        for e, step, way in asked:
            if not e.name.startswith("pose"):
                continue
            wanted = [(own, 1e3 * value, "mm") for own, value in zip(lines, e.wanted, strict=False)]
            if self.axes == "xy":
                wanted.append((turns, np.degrees(e.wanted[2]), "°"))
            for own, value, unit in wanted:
                if np.isfinite(value):
                    mark = _at(step, value, K)
                    own.append(Line(across, Column(f"{e.name} asks for", unit, mark), VERMILLION, "crosses"))
            if self.axes == "xyz" and np.all(np.isfinite(direction := np.asarray(e.wanted)[DIRECTION])):
                between = np.full(K, np.nan)
                between[way] = np.degrees(np.arccos(np.clip(self.along[way] @ direction, -1.0, 1.0)))
                hue = COLOURS[len(off) // 2 % len(COLOURS)]
                off.append(Line(across, Column(f"to that of {e.name}", "°", between), hue, phases=phases))
                mark = _at(step, 0.0, K)
                off.append(Line(across, Column(f"{e.name} asks for", "°", mark), VERMILLION, "crosses"))
        places = zip(self.axes, lines, strict=True)
        charts = [Chart(f"Tip {axis}", label, f"tip {axis} [mm]", own, spans=spans) for axis, own in places]
        charts.append(Chart("Angle", label, "angle of the tip [°]", turns, spans=spans))
        if off:
            charts.append(Chart("Direction", label, "off the direction asked for [°]", off, spans=spans))
        return charts


def _at(step: int, value: float, steps: int) -> np.ndarray:
    """A value at one step, and none at the others."""
    values = np.full(steps, np.nan)
    values[step] = value
    return values


def _one_after_another(runs: Sequence[Simulation]) -> Simulation:
    """Runs of one robot as one, each from its own start."""
    joined = jtu.tree_map(lambda *each: jnp.concatenate(each), *runs)
    return eqx.tree_at(lambda run: run.s, joined, runs[0].s)


def _step_at(T: np.ndarray, tension: float, *, released: bool) -> int:
    """The step of a pull and release, on one of the branches, that is nearest to a tension."""
    top = int(np.argmax(T))
    start, end = (top, len(T)) if released else (0, top + 1)
    return start + int(np.argmin(np.abs(T[start:end] - tension)))
