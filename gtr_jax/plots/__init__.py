"""Figures of simulations and fits, as matplotlib figures; nothing is shown or written here."""

from .diagnosis import plot_before_after, plot_branches, plot_history, plot_residual_map, plot_rivals
from .fit import plot_channels, plot_draws, plot_fit, plot_profiles, plot_residual, plot_time
from .loop import plot_loop
from .shape import Posture, Pressed, plot_shape
from .style import png
from .tendons import plot_tendons
from .tension import plot_tension

__all__ = [
    "Posture",
    "Pressed",
    "plot_before_after",
    "plot_branches",
    "plot_channels",
    "plot_draws",
    "plot_fit",
    "plot_history",
    "plot_loop",
    "plot_profiles",
    "plot_residual",
    "plot_residual_map",
    "plot_rivals",
    "plot_shape",
    "plot_tendons",
    "plot_tension",
    "plot_time",
    "png",
]
