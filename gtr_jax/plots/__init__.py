"""Figures of simulations, as matplotlib figures; nothing is shown or written here."""

from .loop import plot_loop
from .shape import Posture, Pressed, plot_shape
from .style import png
from .tendons import plot_tendons
from .tension import plot_tension

__all__ = [
    "Posture",
    "Pressed",
    "plot_loop",
    "plot_shape",
    "plot_tendons",
    "plot_tension",
    "png",
]
