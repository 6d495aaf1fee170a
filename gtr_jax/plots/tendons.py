"""Several tendons through one history: tensions at the base and at the tip, and how the tip turns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .style import BLUE, GREEN, INK, PURPLE, VERMILLION, figure, legend_above, styled

COLOURS = (BLUE, VERMILLION, GREEN, PURPLE)


@styled
def plot_tendons(
    T_base: np.ndarray,
    T_tip: np.ndarray,
    angle: np.ndarray,
    names: Sequence[str],
    *,
    axes: Sequence[Axes] | None = None,
) -> Figure:
    """Tensions of every tendon at base and tip, and the angle of the tip, step by step.

    Args:
        T_base: tensions at the base [N], (K, tendons).
        T_tip: tensions at the tip [N], (K, tendons).
        angle: of the tip [rad], (K,).
        names: of the tendons.
        axes: two to draw into, tensions and angle; a figure is made unless given.
    """
    fig, (tensions, turn) = figure(5.0, 2, axes, sharex=True, height_ratios=[1.7, 1])
    steps = np.arange(1, len(angle) + 1)
    keys = []
    for i, name in enumerate(names):
        colour = COLOURS[i % len(COLOURS)]
        tensions.plot(steps, T_base[:, i], color=colour, linewidth=1.0, linestyle=(0, (4, 2)))
        tensions.plot(steps, T_tip[:, i], color=colour, linewidth=2.2)
        keys.append(Line2D([], [], color=colour, linewidth=2.2, label=f"{name}, at the tip"))
    keys.append(Line2D([], [], color=INK, linewidth=1.0, linestyle=(0, (4, 2)), label="at the base"))
    turn.plot(steps, np.degrees(angle), color=INK, linewidth=1.8)
    tensions.set_ylabel("tension [N]")
    tensions.set_ylim(0, None)
    turn.set_ylabel("angle of the tip [°]")
    turn.set_xlabel("step")
    legend_above(fig, keys, axes)
    return fig
