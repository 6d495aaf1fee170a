"""What an experiment drives, and what it would show under each model that may be true."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gtr_jax.plots.style import BLUE, GREEN, ORANGE, PALE, PURPLE, VERMILLION, figure, legend_above, styled

COLOURS = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE)
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1)))
# Colours of models differ from the band of the noise; a curve that lies on another shows between its dashes.


@styled
def plot_expected(
    drive: np.ndarray,
    rows: np.ndarray,
    names: Sequence[str],
    *,
    left: tuple[np.ndarray, np.ndarray] | None,
    sd: float,
    labels: tuple[str, str, str],
) -> Figure:
    """What would be read under each model, and what each of the others would leave once it is refitted to
    what the first one shows.

    Args:
        drive: what is driven, (K,).
        rows: readings under each model, (m, K).
        names: of the models.
        left: times [s], (K,), and what each model leaves, (m, K); None where there is one model.
        sd: standard deviation of the noise.
        labels: of what is driven, of the readings, and of what is left.
    """
    fig, axes = figure(5.4 if left is not None else 3.6, 1 if left is None else 2)
    keys = []
    for row, name, colour, dash in zip(rows, names, COLOURS, DASHES, strict=False):
        axes[0].plot(drive, row, color=colour, linestyle=dash, linewidth=1.3)
        keys.append(Line2D([], [], color=colour, linestyle=dash, label=name))
    axes[0].set_xlabel(labels[0])
    axes[0].set_ylabel(labels[1])
    if left is not None:
        time, apart = left
        axes[1].axhspan(-2 * sd, 2 * sd, color=PALE, linewidth=0, zorder=0)
        for row, colour, dash in zip(apart, COLOURS, DASHES, strict=False):
            axes[1].plot(time, row, color=colour, linestyle=dash, linewidth=1.3)
        axes[1].set_xlabel("time [s]")
        axes[1].set_ylabel(labels[2])
    legend_above(fig, keys)
    return fig
