"""The pull and release of a design of one tendon, to go through on its page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gtr_jax.plots.style import INK, VERMILLION
from gtr_jax.report.motion import body_of
from gtr_jax.report.page import Playback
from gtr_jax.report.playback import Chart, Column, Line, playback
from gtr_jax.report.spatial import tip_angle
from gtr_jax.robot.robot import Robot
from gtr_jax.simulation.history import Simulation, simulate

from ..option import TargetError
from ..result import Design

STEPS = 40  # load steps of the pull, beside those to the targets


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
    T, place = np.asarray(run.T_base), 1e3 * np.asarray(run.tip_position)
    K = len(T)
    step = Column("step", "", np.arange(1.0, K + 1))
    base, tip = Column("T_base", "N", T), Column("T_tip", "N", np.asarray(run.T_tip))
    angle = Column("angle of the tip", "°", np.degrees(tip_angle(run)))
    axes = "xyz" if robot.space else "xy"
    places = [Column(f"tip {axis}", "mm", place[:, i]) for i, axis in enumerate(axes)]
    lines = [[Line(base, own, INK, phases=phases)] for own in places]
    turns = [Line(base, angle, INK, phases=phases)]
    first = int(np.argmax(T))
    for e in errors:
        if not e.name.startswith("pose"):
            continue
        reached = _step_at(T, float(np.max(e.T_base)), released=e.branch == "releasing")
        first = reached if e is errors[0] else first
        asked = [(own, 1e3 * value, "mm") for own, value in zip(lines, e.wanted, strict=False)]
        if not robot.space:
            asked.append((turns, np.degrees(e.wanted[2]), "°"))
        for own, value, unit in asked:
            if np.isfinite(value):
                wanted = np.full(K, np.nan)
                wanted[reached] = value
                own.append(Line(base, Column(f"{e.name} asks for", unit, wanted), VERMILLION, "dots"))
    pulled = "tension at the base [N]"
    charts = [
        *(
            Chart(f"Tip {axis}", pulled, f"tip {axis} [mm]", own)
            for axis, own in zip(axes, lines, strict=True)
        ),
        Chart("Angle", pulled, "angle of the tip [°]", turns),
        Chart("Loop", pulled, "tension at the tip [N]", [Line(base, tip, INK, phases=phases)]),
    ]
    return playback(
        charts,
        clock=step,
        told=[base, tip, *places, angle],
        unit="step",
        first=first,
        body=body_of(robot, run, first=first),
        stills=["tip"],
    )


def _step_at(T: np.ndarray, tension: float, *, released: bool) -> int:
    """The step of a pull and release, on one of the branches, that is nearest to a tension."""
    top = int(np.argmax(T))
    start, end = (top, len(T)) if released else (0, top + 1)
    return start + int(np.argmin(np.abs(T[start:end] - tension)))
