"""The loop: tension at the tip against tension at the base."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .style import GREY, INK, figure, legend_above, line_by_phase, phase_keys, styled


@styled
def plot_loop(
    T_base: np.ndarray,
    T_tip: np.ndarray,
    *,
    phases: np.ndarray,
    frictionless: np.ndarray | None = None,
    switch: tuple[float, float] | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Tip against base tension, coloured by phase, with the frictionless model beside it, if given.

    Args:
        T_base: tension at the base [N], (K,).
        T_tip: tension at the tip [N], (K,).
        phases: label of each step, (K,).
        frictionless: tip tension of the model without friction [N], (K,).
        switch: base and tip tension [N] where release reaches the tip; marked unless None.
        axes: to draw into; a figure is made unless given.
    """
    into = axes
    fig, (axes,) = figure(3.9, into=into)
    keys = phase_keys(phases[1:])
    if frictionless is not None:
        order, dashed = np.argsort(T_base), (0, (4, 3))
        axes.plot(T_base[order], frictionless[order], color=GREY, linestyle=dashed, linewidth=1.3)
        keys.append(Line2D([], [], color=GREY, linestyle=dashed, label="no friction"))
    line_by_phase(axes, T_base, T_tip, phases)
    if switch is not None:
        axes.plot(*switch, marker="x", color=INK, markersize=9, markeredgewidth=2.2, linestyle="", zorder=5)
        axes.annotate(
            f"$T_{{base,switch}}$ = {switch[0]:.3g} N",
            switch,
            xytext=(-4, 10),
            textcoords="offset points",
            ha="left" if switch[0] < 0.5 * np.max(T_base) else "right",
            va="bottom",
            color=INK,
            zorder=4,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.0},
        )
    axes.set_xlabel("tension at the base $T_{base}$ [N]")
    axes.set_ylabel("tension at the tip $T_{tip}$ [N]")
    axes.set_xlim(min(0.0, float(np.min(T_base))), None)
    axes.set_ylim(min(0.0, float(np.min(T_tip))), None)
    legend_above(fig, keys, into, "lower right")
    return fig
