"""What a physics term does to a loop."""

from __future__ import annotations

import dataclasses

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gtr_jax.terms import Term

from .style import BLUE, GREY, PALE, VERMILLION, legend_above, png, styled


@dataclasses.dataclass(frozen=True)
class Loops:
    """A load history with and without a term, for its picture.

    Attributes:
        time: (K,), [s].
        true_base, T_base: tension at the base, and what its cell shows with the term [N], (K,).
        T_tip, angle, displacement: what the tip's cell shows [N], the tip's angle [rad] and the tendon drawn
            out at the base [m], without and with it, (K,) each.
    """

    time: np.ndarray
    true_base: np.ndarray
    T_base: np.ndarray
    T_tip: tuple[np.ndarray, np.ndarray]
    angle: tuple[np.ndarray, np.ndarray]
    displacement: tuple[np.ndarray, np.ndarray]


@styled
def plot_term(term: Term, loops: Loops, fast: float) -> Figure:
    """Tip tension and tip angle against the base tension, with and without a term; of a tendon that stretches
    its displacement instead of the angle, of an event the tip tension over time.

    Args:
        term: the term.
        loops: a history with and without it.
        fast: time at which the fast loop begins [s].
    """
    fig = Figure(figsize=(7.6, 3.5), layout="constrained")
    axes = fig.subplots(1, 2)
    slow = loops.time <= fast
    both = (slow, np.append(~slow[1:], True))
    right, scale, label = loops.angle, 180 / np.pi, "angle of the tip [°]"
    if term.strain is not None or term.ahead is not None:
        right, scale, label = loops.displacement, 1e3, "tendon drawn out at the base [mm]"
    base, across = (loops.true_base, loops.T_base), "tension shown at the base [N]"
    panels = [(base, loops.T_tip, across), (base, tuple(scale * a for a in right), across)]
    if term.event:
        panels[1], label = ((loops.time, loops.time), loops.T_tip, "time [s]"), ""
    for ax, ((x, x_with), (without, with_it), below) in zip(axes, panels, strict=True):
        for part in both:
            ax.plot(x[part], without[part], color=GREY, linewidth=2.6, alpha=0.45)
        for part, colour in zip(both, (BLUE, VERMILLION), strict=True):
            ax.plot(x_with[part], with_it[part], color=colour, linewidth=1.3)
        ax.axhline(0.0, color=PALE, linewidth=0.8, zorder=0)
        ax.set_xlabel(below)
    axes[0].set_ylabel("tension shown at the tip [N]")
    axes[1].set_ylabel(label)
    keys = [
        Line2D([], [], color=BLUE, label=f"with {term.id}, slow loop"),
        Line2D([], [], color=VERMILLION, label="fast loop"),
        Line2D([], [], color=GREY, linewidth=2.6, alpha=0.45, label="without"),
    ]
    legend_above(fig, keys)
    return fig


def term_figure(term: Term, loops: Loops, fast: float) -> bytes:
    """The same as PNG."""
    return png(plot_term(term, loops, fast), dots=110)
