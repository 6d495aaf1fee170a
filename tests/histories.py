"""A made-up history as reports play it."""

import numpy as np

from gtr_jax.plots.chart import Chart, Column, Line, Span
from gtr_jax.report.playback import playback

SETTINGS = {"command": "gtr", "inputs": {}, "started": "", "versions": {}}


def made_up(K, **more):
    """A history of K samples: a pull, a hold and a release."""
    time = np.linspace(0.0, 60.0, K)
    base = np.interp(time, [0, 20, 40, 60], [0, 40, 40, 0])
    phases = np.where(time < 20, "pulling", np.where(time < 40, "rest", "releasing"))
    clock, T_base = Column("time", "s", time), Column("T_base", "N", base)
    T_tip = Column("T_tip", "N", 0.7 * base)
    gap = Column("gap", "N", np.where(time > 50, np.nan, 0.01 * np.sin(time)))
    charts = [
        Chart("Loop", "base [N]", "tip [N]", [Line(T_base, T_tip, "#111111", phases=phases)]),
        Chart("Tensions", "time [s]", "tension [N]", [Line(clock, T_base), Line(clock, T_tip, style="dots")]),
        Chart("Rest", "time [s]", "left [N]", [Line(clock, gap)], 0.01, [Span(20, 40, "hold", "1", "#eee")]),
    ]
    return playback(charts, clock=clock, told=[T_base, T_tip, gap], unit="sample", **more)
