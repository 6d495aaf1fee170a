"""A simulation to go through on its page: the loop, the tensions, the tip and the body, step by step."""

from __future__ import annotations

import numpy as np

from gtr_jax.plots.chart import Chart, Column, Line
from gtr_jax.plots.style import BLUE, GREY, INK, VERMILLION
from gtr_jax.plots.tendons import COLOURS

from . import spatial
from .motion import body_of
from .page import Playback
from .playback import playback
from .simulation_answer import SimulationAnswer

BASE, TIP = "tension at the base [N]", "tension at the tip [N]"


def simulation_playback(answer: SimulationAnswer, time: np.ndarray | None) -> Playback:
    """The history of a simulation.

    Args:
        answer: what the simulation found.
        time: of the steps [s], (K,), where it was given.
    """
    run, K = answer.run, len(answer.run.T_base)
    steps = Column("step", "", np.arange(1.0, K + 1))
    clock = steps if time is None else Column("time", "s", np.asarray(time))
    names = answer.robot.tendon_names if answer.several else ("",)

    def each(values, label: str) -> list[Column]:
        table = np.asarray(values).reshape(K, -1).T
        return [Column(f"{label} {name}".strip(), "N", own) for name, own in zip(names, table, strict=True)]

    base, tip = each(run.T_base, "T_base"), each(run.T_tip, "T_tip")
    without = each(answer.frictionless.T_tip, "T_tip without friction")
    angle = Column("angle of the tip", "°", np.degrees(spatial.tip_angle(run)))
    if answer.several:
        loops = [Line(b, t, c) for b, t, c in zip(base, tip, _colours(len(names)), strict=True)]
        tensions = [
            line
            for b, t, c in zip(base, tip, _colours(len(names)), strict=True)
            for line in (Line(clock, b, c, "dashed"), Line(clock, t, c))
        ]
    else:
        phases = np.asarray(answer.phases)
        loops = [Line(base[0], without[0], GREY, "dashed"), Line(base[0], tip[0], INK, phases=phases)]
        tensions = [Line(clock, base[0], VERMILLION, "dashed"), Line(clock, tip[0], BLUE)]
    along = "step" if time is None else "time [s]"
    charts = [
        Chart("Loop", BASE, TIP, loops),
        Chart("Tensions", along, "tension [N]", tensions),
        Chart("Tip", along, "angle of the tip [°]", [Line(clock, angle, INK)]),
    ]
    return playback(
        charts,
        clock=clock,
        told=[*(column for pair in zip(base, tip, strict=True) for column in pair), angle],
        unit="step",
        first=answer.top,
        body=body_of(answer.robot, run, first=answer.top),
        stills=["tendons", *(f"loop-{name}" for name in names)] if answer.several else ["loop"],
    )


def _colours(count: int) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(count)]
