"""What a command answers: the facts as JSON, the verdict as a sentence, and one self-contained HTML page."""

from .fit import FitAnswer, fit_report
from .page import Figure, Report, Table, render
from .profile import profile
from .simulation import SimulationAnswer, answer_simulation, simulation_report

__all__ = [
    "Figure",
    "FitAnswer",
    "Report",
    "SimulationAnswer",
    "Table",
    "answer_simulation",
    "fit_report",
    "profile",
    "render",
    "simulation_report",
]
