"""Figures of simulations and fits, as matplotlib figures; nothing is shown or written here."""

from .fit import plot_fit, plot_residual
from .loop import plot_loop
from .shape import Posture, plot_shape
from .style import png
from .tension import plot_tension

__all__ = ["Posture", "plot_fit", "plot_loop", "plot_residual", "plot_shape", "plot_tension", "png"]
