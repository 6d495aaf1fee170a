"""What a command answers: the facts as JSON, the verdict as a sentence, and one self-contained HTML page."""

from .diagnosis import diagnosis_report
from .fit import FitAnswer, fit_report
from .page import Figure, Link, Report, Table, render, render_index
from .profile import profile
from .simulation import SimulationAnswer, answer_simulation, simulation_report

__all__ = [
    "Figure",
    "FitAnswer",
    "Link",
    "Report",
    "SimulationAnswer",
    "Table",
    "answer_simulation",
    "diagnosis_report",
    "fit_report",
    "profile",
    "render",
    "render_index",
    "simulation_report",
]
