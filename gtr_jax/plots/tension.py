"""Tension along the tendon, and where it is locked."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gtr_jax.numbers import number

from ..simulation.history import Simulation
from .style import INK, PHASE_COLOUR, figure, legend_above, phase_keys, styled

FRACTIONS = (1 / 3, 2 / 3)
LOCKED = (0, (1, 1.5))


def stations(T_base: np.ndarray) -> list[int]:
    """Steps worth showing: on the way to the largest base tension, there, on the way down, and at the end."""
    top = int(np.argmax(T_base))
    chosen = [top, len(T_base) - 1]
    for fraction in FRACTIONS:
        below = T_base <= fraction * T_base[top]
        chosen += [int(i) for i in np.flatnonzero(below[:top])[-1:]]
        chosen += [top + int(i) for i in np.flatnonzero(below[top:])[:1]]
    later = np.flatnonzero(T_base[top:] <= T_base[top] / 6)[:1]
    return sorted({*chosen, *(top + int(i) for i in later)})


@styled
def plot_tension(
    run: Simulation,
    phases: np.ndarray,
    *,
    pulled: tuple[str, np.ndarray] | None = None,
    axes: Axes | None = None,
) -> Figure:
    """Tension along the tendon at several steps; dotted where the tendon is locked.

    Args:
        run: the simulation.
        phases: label of each step, (K,).
        pulled: name and base tension [N], (K,), of the tendon by which steps are chosen and called; this one
            unless given.
        axes: to draw into; a figure is made unless given.
    """
    into = axes
    fig, (axes,) = figure(3.9, into=into)
    name, T_base = pulled or ("", np.asarray(run.T_base))
    s = np.asarray(run.s)
    chosen = stations(T_base)
    for k in chosen:
        tension, front = np.asarray(run.tension[k]), float(run.slip_front[k])
        colour = PHASE_COLOUR[str(phases[k])]
        slips = s <= front
        axes.plot(1e3 * s[slips], tension[slips], color=colour, linewidth=2)
        if front < s[-1]:
            locked = slice(max(int(np.sum(slips)) - 1, 0), None)
            axes.plot(1e3 * s[locked], tension[locked], color=colour, linewidth=2, linestyle=LOCKED)
    axes.set_xlim(0, 1e3 * s[-1])
    axes.set_ylim(0, 1.04 * max(float(np.max(run.tension)), 1e-9))
    axes.set_xlabel("s along the backbone [mm]")
    axes.set_ylabel("tension of the tendon [N]")
    _name_ends(axes, [(k, float(run.tension[k, -1]), float(T_base[k]), str(phases[k])) for k in chosen], name)
    keys = phase_keys(phases[chosen])
    keys.append(Line2D([], [], color=INK, linestyle=LOCKED, linewidth=2, label="locked"))
    legend_above(fig, keys, into)
    return fig


def _name_ends(axes: Axes, ends: list[tuple[int, float, float, str]], pulled: str) -> None:
    """The base tension of each line at its tip end, in the order of the history, apart from one another."""
    gap = 0.05 * axes.get_ylim()[1]
    height = -gap
    for k, T_tip, T_base, phase in sorted(ends, key=lambda end: (end[1], -end[0])):
        height = max(T_tip, height + gap)
        place = [end[0] for end in ends].index(k) + 1
        axes.annotate(
            f"{place}: {number(T_base, 'N', 3)}",
            (1, height),
            xycoords=("axes fraction", "data"),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.5,
            color=PHASE_COLOUR[phase],
            annotation_clip=False,
        )
    title = f"at $T_{{base}}$ of {pulled}" if pulled else "at $T_{base}$"
    axes.annotate(
        title,
        (1, 1),
        xycoords="axes fraction",
        xytext=(5, 4),
        textcoords="offset points",
        fontsize=8.5,
        color=INK,
        annotation_clip=False,
    )
